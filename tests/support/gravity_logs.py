"""Logs of robots under a gravity that is not the one of their file, and a robot that hardly feels any."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from plausible_parameters import random_parameters

from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.robot import Joint, Limits, Mdh, Robot
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run
from gtau.simulation.trajectories import envelope, sines

Gravity = tuple[float, float, float]
LIMITS = Limits(position=(-2.0, 2.0), velocity=3.0)


def scara() -> Robot:
    """Two vertical axes and a slide along them: gravity is a constant force on the slide."""
    return Robot(
        "scara",
        (
            Joint("1", "ground", "revolute", Mdh(), limits=LIMITS),
            Joint("2", "1", "revolute", Mdh(d=0.3), limits=LIMITS),
            Joint("3", "2", "prismatic", Mdh(d=0.25), limits=Limits(position=(0.0, 0.2), velocity=0.5)),
        ),
    )


def logged(robot: Robot, true: Gravity, currents: bool, seconds: float = 8.0, seed: int = 0) -> list[Run]:
    """Torques of one run, or currents of two, one of them with a payload, under the ``true`` gravity."""
    model, rng = InverseDynamics(replace(robot, gravity=true)), np.random.default_rng([5, seed])
    chi, time = random_parameters(model, rng), np.arange(round(200 * seconds) + 1) / 200
    gains, runs = rng.uniform(1, 5, len(model.actuated)) if currents else 1.0, []
    for mass in (0.0, 2.0) if currents else (0.0,):
        q, qd, qdd = sines(envelope(robot, 0.7), seconds, rng)(time)
        tau = model.torques(q, qd, qdd, {**chi, f"m_{robot.tool}": chi[f"m_{robot.tool}"] + mass})
        tau += 0.003 * np.sqrt(np.mean(tau**2, axis=0)) * rng.standard_normal(tau.shape)
        payload = Payload(name="disc", mass=mass) if mass else None
        kind = "current" if currents else "torque"
        runs.append(Run(f"{mass:g} kg", model.actuated, time, q, tau / gains, kind=kind, payload=payload))
    return runs

"""Logs of a five-bar whose motors have friction of any shape: presliding, bent, by load."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from five_bar_logs import CHI, GAINS, JOINTS, RATE, STEEL, TOOL, five_bar, path

from gtau.estimation.friction.law import FrictionLaw
from gtau.robots.parameter import Parameter
from gtau.robots.robot import Robot
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run

PLAIN = {name: value for name, value in CHI.items() if name.split("_", 1)[0] in ("fv", "fs", "off")}
NOISE = 0.01  # A


def robot() -> Robot:
    """The five-bar."""
    return five_bar().robot


def run(
    name: str,
    shapes: Mapping[Parameter, float],
    values: Mapping[str, float],
    seed: int,
    loaded: bool = False,
    seconds: float = 10.0,
    noise: float = NOISE,
) -> Run:
    """A run whose friction is that of a law with these shapes; ``values`` are others than those of the plain one."""
    model, time = five_bar(), np.arange(round(seconds * RATE)) / RATE
    chi = {name: 0.0 if name in PLAIN else value for name, value in CHI.items()}
    for kind, value in STEEL.items() if loaded else ():
        chi[f"{kind}_{TOOL}"] = chi.get(f"{kind}_{TOOL}", 0.0) + value
    q, qd, qdd = path(time, seed)
    motion = model.motion(*(np.ascontiguousarray(each.T) for each in (q, qd, qdd)))
    load = model.torques(q, qd, qdd, chi)
    law = FrictionLaw(model, {}, shapes)
    tau = load + law.torques(motion, PLAIN | dict(values), load.T, law.followers(lambda _: q.T)(time)).T
    current = tau / GAINS + noise * np.random.default_rng(seed + 1000).normal(size=tau.shape)
    made = Run(name, JOINTS, time, q, current)
    return replace(made, payload=Payload(name="steel", mass=STEEL["m"])) if loaded else made


def experiment(shapes: Mapping[Parameter, float], values: Mapping[str, float], seed: int = 1) -> list[Run]:
    """A run without and one with the known payload."""
    return [run("free", shapes, values, seed), run("loaded", shapes, values, seed + 1, loaded=True)]

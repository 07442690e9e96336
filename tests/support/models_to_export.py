"""Identified models of any robot, made without identification: parameters of bodies that could be built."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from engines import random_parameters
from robots_for_tests import slider_crank

from gtau.estimation.diagnostics.verdict import GOOD
from gtau.estimation.estimators.physical_consistency import Consistency
from gtau.estimation.friction.curves import FrictionCurve
from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.payload_body import PayloadEstimate
from gtau.model.base_parameters import Equations
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.result import Result
from gtau.robots.parameter import Parameter, torque_unit, unit_of
from gtau.robots.robot import SPRING, Attachment, Pose, Robot, Spring
from gtau.signals.preparation.filters import Decimator, Preparation
from gtau.uses.identified import Identified, torques_of

PAYLOAD = {"m": 1.5, "mx": 0.1, "my": -0.05, "mz": 0.2, "xx": 0.1, "yy": 0.2, "zz": 0.15}


def model_of(
    robot: Robot, seed: int = 0, terms: bool = True, consistent: bool = True, chi: dict[str, float] | None = None
) -> Result:
    """A result with random parameters, friction terms f3 and fl if ``terms``, and a payload on the tool."""
    rng, model = np.random.default_rng(seed), InverseDynamics(robot)
    standard = dict.fromkeys(model.parameter_names, 0.0) | (random_parameters(robot, rng) if chi is None else chi)
    size = {"k": 3.0, "f0": 2.0, "c": 0.4}
    standard |= {name: size[name.split("_")[0]] for name in standard if name.split("_")[0] in size}
    equations = Equations(model)
    base = equations.base
    values = base.matrix @ [standard[name] for name in model.parameter_names]
    joints, units = robot.actuated, [torque_unit(robot, joint) for joint in robot.actuated]
    gains = rng.uniform(1.5, 4.0, len(joints)) * np.where(np.arange(len(joints)) % 3 == 1, -1.0, 1.0)

    def unit(name: str) -> str:
        kind, body = name.split("_", 1)
        return unit_of(kind, robot, body)

    parameters = {
        name: Estimate(
            name, float(value), abs(float(value)) / 50 + 1e-4, unit(own), base.regroupings[name], essential=True
        )
        for name, own, value in zip(base.names, base.standard, values, strict=True)
    }
    friction = {}
    if terms:
        for joint in joints:
            friction[Parameter("f3", joint)] = Estimate(
                f"f3_{joint}", float(rng.uniform(0.01, 0.1)), 0.005, "N m s3/rad3"
            )
        friction[Parameter("fl", joints[0])] = Estimate(f"fl_{joints[0]}", 0.07, 0.002, "1")
    payload = {kind: Estimate(kind, value, 0.01, unit_of(kind, robot, robot.tool)) for kind, value in PAYLOAD.items()}
    pairs = zip(joints, gains, units, strict=True)
    return Result(
        equations,
        drive_gains={joint: Estimate(joint, float(gain), 0.01, f"{unit}/A") for joint, gain, unit in pairs},
        delays={joint: Estimate(joint, 0.0, None, "s") for joint in joints},
        parameters=parameters,
        friction=friction,
        payloads=(PayloadEstimate("tool 2", "loaded", payload, frozenset({"m"}), GOOD),),
        covariance_names=tuple(Parameter("gain", joint) for joint in joints),
        covariance=np.eye(len(joints)) * 1e-4,
        consistency=Consistency(
            standard=standard,
            payloads={},
            gains={joint: (float(gain), 0.01) for joint, gain in zip(joints, gains, strict=True)},
            moves=(),
            eigenvalues={},
            loss={},
            open=base.without_effect,
        )
        if consistent
        else None,
        method="ml",
        kind="current",
        runs=("free", "loaded"),
        preparation=Preparation(10.0, 50.0, Decimator(10, "fir"), 0.05),
        residuals=(),
        logged_speeds=dict.fromkeys(joints, 100.0),
        statistics={"lack_of_fit": 1.0, "reduction_loss": 0.0},
    )


def preslid(result: Result) -> Result:
    """The model with friction on all samples in its motors: presliding in all of them, bent in the first."""
    curves, values = {}, {}
    for k, joint in enumerate(result.robot.actuated):
        shown = {"fv": 0.4, "fs": 2.0, "fl": 0.03, "width": 0.004} | ({} if k else {"fb": 1.5, "vs": 0.1})
        values |= {Parameter(kind, joint): value for kind, value in shown.items()}
        curves[joint] = FrictionCurve(joint, {"presliding": 9.0}, 1.0, 2.0)
    names = dict(zip(result.base.names, result.base.standard, strict=True))
    parameters = {
        name: replace(each, value=values.pop(names[name])) if names[name] in values else each
        for name, each in result.parameters.items()
    }
    friction = {name: Estimate(name, value, 1e-4, "N m") for name, value in values.items()}
    return result.replaced(parameters=parameters, friction=friction, curves=curves)


def of_equations(result: Result) -> Result:
    """The same model with the friction of its equations of identification, that is with the plain law."""
    found = result.equation_friction
    parameters = {name: found.get(name, each) for name, each in result.parameters.items()}
    parameters = {
        name: replace(each, regrouping=result.parameters[name].regrouping, essential=result.parameters[name].essential,
                      between_run_std=result.parameters[name].between_run_std)
        for name, each in parameters.items()
    }  # fmt: skip
    friction = {name: each for name, each in found.items() if name not in parameters}
    return result.replaced(parameters=parameters, friction=friction, curves={}, equation_friction={})


def sprung() -> Robot:
    """The slider-crank with springs across its crank and its slider, a coil and a gas spring between two points."""
    robot = slider_crank()
    rests = {"1": 0.3, "3": 0.5}
    joints = tuple(replace(joint, spring=rests.get(joint.name)) for joint in robot.joints)
    coil = Spring("coil", Attachment("ground", Pose((0.3, 0.5, 0.2))), Attachment("2", Pose((0.1, 0.05, 0.0))), SPRING)
    gas = Spring("gas", Attachment("1", Pose((0.0, 0.1, 0.1))), Attachment("3", Pose((0.2, 0.0, 0.0))), ("f0", "c"))
    return replace(robot, name="sprung", joints=joints, springs=(coil, gas))


def torques(
    model: Identified, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, values: np.ndarray | None = None
) -> np.ndarray:
    """Torques (N, n) along a path of the actuated joints, (N, n) each, that begins near home; of other parameters."""
    motion = model.result.idm.motion(q.T, qd.T, qdd.T)
    return torques_of(model, motion, model.values if values is None else values).T

"""Physically consistent standard parameters of a result, for rigid-body engines, and what these engines lack.

A file without loops states the inertia at the motors with loops closed instead: ``M = J^T I J``, where I is the inertia
of all bodies and rotors in the coordinates of the tree, and J their motion by the motors.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any
from xml.etree.ElementTree import Comment

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.results.result import NO_BODIES, IdentifiedModel
from gtau.model.singularities import random_motion
from gtau.robots.parameter import KINDS, Parameter, torque_unit
from gtau.robots.robot import PLAIN_FRICTION, Robot
from gtau.uses.identified import identified, torques_of

WITHOUT = "the model has base parameters alone; identify it with --consistent (in Python consistent=True)"
STATES = 500
POSES = 200  # at random within the workspace


@dataclass(frozen=True, eq=False)
class ConsistentModel:
    """Physically consistent parameters by name, friction cubic in speed (f3) included, and drive gains by joint.

    Friction dissipates at every speed: no ``fv``, ``fs`` or ``f3`` is negative. If an identified one is, or friction is
    curved (``fb``), ``fv`` and ``fs`` are the straight line closest to the friction up to the fastest logged speed, and
    ``straight`` names the joint.
    """

    result: IdentifiedModel
    values: Mapping[str, float]
    gains: Mapping[str, float]
    straight: tuple[str, ...]

    def of(self, kind: str, joint: str) -> float:
        """Return a parameter of a joint, or 0 if it has none."""
        return self.values.get(Parameter(kind, joint), 0.0)

    @property
    def cubic(self) -> list[str]:
        """Joints whose friction is cubic in speed."""
        return [joint.name for joint in self.result.robot.joints if self.of("f3", joint.name)]


def consistent_model(result: IdentifiedModel, target: str) -> ConsistentModel:
    """Return the consistent parameters of a result; raises GtauError where it has none, naming the ``target``."""
    consistency = result.consistency
    if consistency is None:
        why = next((str(note) for note in result.notes if note.kind == NO_BODIES), WITHOUT)
        raise GtauError(f"an export to {target} needs the parameters of every body, but {why}.")
    values, straight = _on_motors(result, consistency.standard), []
    terms = {name: term.value or 0.0 for name, term in result.friction_parameters.items()}
    for joint in (joint.name for joint in result.robot.joints):
        if joint in result.curves:  # its friction comes from the model, not from the fit of rigid bodies
            plain = [Parameter(kind, joint) for kind in PLAIN_FRICTION]
            values |= {name: terms[name] for name in plain if name in terms}
        viscous, coulomb, cubic = (Parameter(kind, joint) for kind in ("fv", "fs", "f3"))
        friction = values | terms
        least = min(friction.get(name, 0.0) for name in (viscous, coulomb, cubic))
        if least < 0 or terms.get(Parameter("fb", joint)):
            values[viscous], values[coulomb] = result.friction_law.straight(friction, joint)
            straight.append(joint)
        elif terms.get(cubic):
            values[cubic] = terms[cubic]
    gains = {joint: gain for joint, (gain, _) in consistency.gains.items()}
    return ConsistentModel(result, values, gains, tuple(straight))


def _on_motors(result: IdentifiedModel, standard: Mapping[str, float]) -> dict[str, float]:
    """Move friction that joints coupled to a motor share with it onto the joint by which it is identified."""
    values, base, index = dict(standard), result.base, {name: k for k, name in enumerate(result.idm.parameter_names)}
    for name, row in zip(base.standard, base.matrix, strict=True):
        for other, k in index.items():
            if name.kind == other.kind in PLAIN_FRICTION and other != name and row[k]:
                values[name] += float(row[k]) * standard[other]
                values[other] = 0.0
    return values


def differences(model: ConsistentModel, expressed: Mapping[str, float]) -> tuple[dict[str, float], str]:
    """Compute the rms difference from the identified torques at random states, % by joint, and a note on it."""
    result, idm = model.result, model.result.idm
    motors = idm.layout.actuated
    motion = random_motion(idm, STATES, np.random.default_rng(0))
    logged = np.array([[result.logged_speeds.get(joint, 0.0)] for joint in idm.actuated])
    ratio = np.abs(motion.yd[motors]) / np.where(logged > 0, logged, np.inf)
    slower = 1 / np.maximum(ratio.max(axis=0), 1.0)  # same path, longer duration
    motion = replace(motion, yd=motion.yd * slower, ydd=motion.ydd * slower**2)
    exact = identified(result)
    tau = torques_of(exact, motion, exact.values)
    values = np.array([expressed.get(name, 0.0) for name in idm.parameter_names])
    cubic = np.array([[expressed.get(Parameter("f3", joint), 0.0)] for joint in idm.actuated])
    made = idm.full.torques_along(idm.layout, motion, values) + cubic * motion.yd[motors] ** 3
    rms, size = (np.sqrt(np.mean(torques**2, axis=1)) for torques in (made - tau, tau))
    per_cent = dict(zip(idm.actuated, (100 * rms / size).tolist(), strict=True))
    worst = max(per_cent, key=per_cent.__getitem__)
    return per_cent, (
        f"over {STATES} random states within the logged speeds the exported torques differ from the identified "
        f"ones by at most {per_cent[worst]:.2g} % rms (joint '{worst}')"
    )


def friction_notes(model: ConsistentModel) -> list[str]:
    """Note where exported friction is a straight line instead of the identified one, and where it is extrapolated."""
    law, notes = model.result.friction_law, []
    if model.straight:
        unlogged = "at any speed, as none is logged"  # of a joint in a loop, whose line is constant
        ends = {joint: f"up to {law.logged(joint)}" if law.fastest(joint) else unlogged for joint in model.straight}
        listed = ", ".join(map(" ".join, ends.items()))
        notes.append(
            "friction that bends, or has negative coefficients that would propel a joint, is no straight line: "
            f"damping and friction are the straight line nearest to it within the logged speeds ({listed}), "
            "extrapolated beyond"
        )
    if model.cubic:
        listed = ", ".join(f"{joint} above {law.logged(joint)}" for joint in model.cubic)
        notes.append(f"friction cubic in speed is extrapolated beyond the logged speeds: {listed}")
    return notes


def friction_comments(model: ConsistentModel) -> list[Any]:
    """Make the notes on friction comments of an XML file."""
    return [Comment(f" {note.replace('--', '- -')} ") for note in friction_notes(model)]


def chosen_bodies(model: ConsistentModel) -> list[str]:
    """Note the masses that the data leave open, beside those that the robot's file states."""
    stated, matrix, chosen = model.result.robot.inertias, model.result.base.matrix, []
    for name, share in zip(model.result.idm.parameter_names, np.diag(np.linalg.pinv(matrix) @ matrix), strict=True):
        if name.kind == "m" and share < 1 - 1e-6:
            beside = f" (file {stated[name]:.3g})" if name in stated else ""
            chosen.append(f"{name.body} {model.values[name]:.3g} kg{beside}")
    words = (
        "the data determine only sums of masses, centres of mass and inertias; each body's own are chosen, near equal "
        f"masses or, identified with --prior-inertias 0.3, near the file's: {', '.join(chosen)}"
    )
    return [words] if chosen else []


def term_notes(model: ConsistentModel, target: str, expressed: Mapping[str, float], delays: bool = False) -> list[str]:
    """Note open masses, and what no rigid-body format holds: friction not ``expressed``, delays unless elsewhere."""
    result = model.result
    widths = [(name.body, width) for name, width in result.friction.items() if name.kind == "width"]
    missing = [name for name in (Parameter("f3", joint) for joint in model.cubic) if name not in expressed]
    missing += [name for name in result.friction_parameters if name.kind not in (*PLAIN_FRICTION, "f3", "fb")]
    late = {} if delays else {joint: delay.value for joint, delay in result.delays.items() if delay.value}
    notes = {
        "{} has no friction before sliding, of these widths": [
            f"{joint} ({width.value:.2g} {width.unit})" for joint, width in widths
        ],
        "{} cannot express this friction, left out": [f"{name} ({KINDS[name.kind].words})" for name in missing],
        "delays between current and torque are not part of the file": [
            f"{1e3 * delay:.2g} ms ('{joint}')" for joint, delay in late.items()
        ],
    }
    listed = [f"{note.format(target)}: {', '.join(names)}" for note, names in notes.items() if names]
    return chosen_bodies(model) + friction_notes(model) + listed


def motor_inertias(model: ConsistentModel) -> np.ndarray:
    """Compute the inertias M (1 + POSES, n, n) at the motors, with loops closed, at home and at random poses."""
    idm = model.result.idm
    assert idm.loops is not None
    c = np.column_stack([idm.loops.home, random_motion(idm, POSES, np.random.default_rng(0)).c])
    n, poses = len(idm.actuated), c.shape[1]
    qdd = np.repeat(np.eye(n, n + 1, 1), poses, axis=1)  # no motor, then one motor at a time
    motion = idm.rates(np.tile(c, n + 1), np.zeros_like(qdd), qdd)
    values = np.array([model.values.get(name, 0.0) for name in idm.parameter_names])
    tau = idm.full.torques_along(idm.layout, motion, values).reshape(n, n + 1, poses)
    return np.asarray((tau[:, 1:] - tau[:, :1]).transpose(2, 0, 1))


def serial_equivalent(model: ConsistentModel) -> dict[str, Any]:
    """Describe the inertia at each motor with loops closed: at home, its range, and its parts."""
    M, robot = motor_inertias(model), model.result.robot
    described = {}
    for k, joint in enumerate(robot.actuated):
        inertia, armature = M[:, k, k], model.of("ia", joint)
        described[joint] = {
            "inertia": float(inertia[0]),
            "range": [float(inertia.min()), float(inertia.max())],
            "armature": armature,
            "reflected": float(inertia[0]) - armature,
            "coupling": dict(zip(robot.actuated, M[0, k].tolist(), strict=True)),
            "unit": torque_unit(robot, joint).replace("N m", "kg m2").replace("N", "kg"),
        }
    return described


def what_is_lost(robot: Robot, target: str, name: str, loops: str = "") -> str:
    """Note that the files of a ``target`` have no loops, except in ``NAME.yaml`` or ``loops``; empty without loops."""
    if not robot.closures:
        return ""
    count = len(robot.closures)
    passive = [joint.name for joint in robot.joints if not joint.actuated]
    passive += [platform.name for platform in robot.platforms]
    tied = "; ".join(f"'{closure.a.body}' to '{closure.b.body}'" for closure in robot.closures)
    return (
        f"OPEN TREE: {target} has no closed loops, so the files lack {count} closure{'s' * (count > 1)} ({tied}), and "
        f"{', '.join(passive)} swing freely: without the closures in {loops or f'{name}.yaml'} this is another "
        "robot; the inertia at each motor with loops closed, at home and its range, is under 'serial_equivalent' in "
        f"{name}_drives.yaml"
    )

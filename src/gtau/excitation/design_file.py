"""The design file, with the robot to identify, payloads and limits, and the design problem that it states."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, FiniteFloat, field_validator, model_validator

from gtau.documents.files import DESIGN, refuse_other_kind
from gtau.documents.markup import read_yaml
from gtau.documents.validation import PATH, Keys, Positive, some_of, takes, validate
from gtau.errors import GtauError
from gtau.estimation.electrical import COMMUTATION
from gtau.excitation.clearance import Capsule, Shape, hull
from gtau.excitation.guards import guard, speed_of_tool
from gtau.excitation.prior import ARM, ERROR, DesignPrior, FilePath, PriorModel, prior_of, stated_bodies
from gtau.excitation.task import DesignProblem, MotionLimits
from gtau.excitation.trajectory import FourierSeries
from gtau.model.base_parameters import base_parameters
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.geometry import refuse_floating
from gtau.robots.readers.read import catalog_names
from gtau.robots.robot import Limits, Pose, Robot
from gtau.signals.reading.experiment import RobotName
from gtau.signals.reading.statements import FIRST_MOMENTS, CarriedPayload, Drive, Payload

Interval = tuple[FiniteFloat, FiniteFloat]
Triple = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
CONDITION = 100.0  # default limit of the condition number of the closures
SHARE = 0.8  # default share of the limits of the robot's file that a motion may use


class PlannedRun(Keys):
    """A run of the motion, with or without a payload."""

    payload: CarriedPayload = None


class ShapeEntry(Keys):
    """Shape of a body, in its frame: a capsule about a segment, or the convex hull of a mesh."""

    capsule: tuple[Triple, Triple] | None = None
    radius: Positive | None = None
    mesh: FilePath | None = None
    scale: Positive = 1.0
    xyz: Triple = (0.0, 0.0, 0.0)
    rpy: Triple = (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _one_kind(self) -> ShapeEntry:
        if (self.capsule is None) == (self.mesh is None):
            raise ValueError("a shape is either 'capsule: [[x, y, z], [x, y, z]]' with a 'radius', or 'mesh: FILE'")
        if (self.capsule is None) != (self.radius is None):
            raise ValueError("a capsule has a 'radius', m, and a mesh has none; write or remove it")
        if self.capsule is not None and not self.model_fields_set.isdisjoint({"scale", "xyz", "rpy"}):
            raise ValueError("'scale', 'xyz' and 'rpy' place a mesh; the two points place a capsule")
        return self

    @property
    def shape(self) -> Shape:
        """Capsule or hull; raises GtauError if the mesh cannot be read."""
        if self.capsule is not None and self.radius is not None:
            start, end = map(np.array, self.capsule)
            return Capsule(start, end, self.radius)
        assert self.mesh is not None
        return hull(self.mesh, self.scale, Pose(self.xyz, self.rpy))


class LimitsEntry(Keys):
    """Limits by joint that replace the robot's limits, and limits of the whole motion."""

    position: dict[str, Interval] = Field(default_factory=dict)
    velocity: dict[str, Positive] = Field(default_factory=dict)
    acceleration: dict[str, Positive] = Field(default_factory=dict)
    jerk: dict[str, Positive] = Field(default_factory=dict)
    current: dict[str, Positive] = Field(default_factory=dict)
    workspace: dict[Literal["x", "y", "z"], Interval] = Field(default_factory=dict)
    condition: Annotated[FiniteFloat, Field(gt=1)] = CONDITION
    away_from_reversals: Annotated[FiniteFloat, Field(ge=0, lt=1)] = 0.3
    clearance: Positive = 0.02
    shapes: dict[str, tuple[ShapeEntry, ...]] | Literal["none"] = Field(default_factory=dict)
    floor: FiniteFloat | Literal["none"] | None = None
    tool_speed: Positive | None = None
    share: Annotated[FiniteFloat, Field(gt=0, le=1)] = SHARE

    @field_validator("position", "workspace")
    @classmethod
    def _in_order(cls, intervals: dict[str, Interval]) -> dict[str, Interval]:
        for name, (low, high) in intervals.items():
            if not low < high:
                raise ValueError(f"the limits of '{name}' are {low:g} to {high:g}; write the lower limit first")
        return intervals


class DesignFile(Keys):
    """Content of a design file; the voltages of ``drives`` will be logged, and give their gains."""

    robot: RobotName
    rate: Positive
    period: Positive = 10.0
    harmonics: Annotated[int, Field(ge=2)] = 5
    repetitions: Annotated[int, Field(ge=1)] = 1
    approach: bool = True
    rest: dict[str, FiniteFloat] = Field(default_factory=dict)
    runs: tuple[PlannedRun, ...] = Field(min_length=1)
    limits: LimitsEntry = LimitsEntry()
    prior: DesignPrior = DesignPrior()
    drives: dict[str, Drive] = Field(default_factory=dict)

    @property
    def payloads(self) -> tuple[Payload | None, ...]:
        """Payloads of the runs."""
        return tuple(run.payload for run in self.runs)

    @model_validator(mode="after")
    def _payloads_give_the_scale(self) -> DesignFile:
        for joint, drive in self.drives.items():
            if drive.model_fields_set.isdisjoint(("convention", "commutation", "resistance")):
                raise ValueError(
                    f"the drive of '{joint}' states nothing of its voltages, which a design takes as logged; add "
                    "'commutation', or remove the drive ('prior.gains' takes gains)"
                )
        if self.drives:
            return self
        names = {payload and payload.name for payload in self.payloads}
        if len(names) < 2 or not any(payload and payload.mass for payload in self.payloads):
            raise ValueError(
                "the drive gains need a run with a payload of known mass and one with another load or none; "
                "add it to 'runs', or 'drives' whose voltages are logged"
            )
        return self


RISE = 0.3  # s, assumed time to the speed limit for a joint without a limit of acceleration
TURN = np.pi  # rad, reach of a joint without position limits

EXAMPLE = "{robot: %s, rate: 1000, runs: [{payload: none}, {payload: {name: disc, mass: 1}}]}"  # a design file


@takes(path=PATH)
def read_design(path: str | Path) -> tuple[DesignProblem, dict[str, str]]:
    """Read a design file; return the design problem, and sentences on what the file leaves to assume.

    The keys of the sentences are ``parameters``, ``massless``, ``gains``, ``noise`` and ``voltages``. Raises GtauError.

    Examples
    --------
    >>> task, assumed = gtau.read_design("design.yaml")
    >>> "gains" in assumed  # no prior knowledge of them is stated
    True
    """
    if str(path) in catalog_names():
        raise GtauError(f"'{path}' is a robot; write a design file (gtau docs design-file), such as {EXAMPLE % path}.")
    refuse_other_kind(path, DESIGN)
    return make_task(validate(DesignFile, read_yaml(path), context=Path(path).parent))


def make_task(file: DesignFile) -> tuple[DesignProblem, dict[str, str]]:
    """Make the design problem of a design file; see :func:`read_design`."""
    robot = load_robot(file.robot)
    refuse_floating(robot, "exciting trajectories are")
    _require_actuated(file, robot)
    rest = np.array([file.rest.get(name, robot.joint(name).home) for name in robot.actuated])
    robot, notes = _with_limits(robot, file.limits, dict(zip(robot.actuated, rest, strict=True)))
    model = InverseDynamics(robot)
    base = base_parameters(model)
    assumed: dict[str, str] = {}
    prior = replace(prior_of(file.prior, model, base, file.payloads, assumed), drives=file.drives)
    if unstated := [joint for joint, drive in file.drives.items() if drive.commutation is None]:
        constants = f"{100 * COMMUTATION:g} % between torque and back-EMF constant of {', '.join(unstated)}"
        assumed["voltages"] = f"voltages: {constants}; state 'commutation' under 'drives'"
    if "gains" in assumed and file.limits.current:
        raise GtauError("limits.current needs the drive gains; add prior.gains or prior.model, or limit torques.")
    limits, shapes = _limits(file.limits, robot), file.limits.shapes
    stated = None if shapes == "none" else {body: [entry.shape for entry in shapes[body]] for body in shapes}
    still = np.zeros((len(rest), 1))
    try:
        poses = model.motion(rest[:, None], still, still).c
    except GtauError:
        raise GtauError(
            f"robot '{robot.name}': the loops cannot be closed where runs begin, or only beyond a singular pose; give "
            "positions that the robot can reach from home under 'rest'."
        ) from None
    apart, words = guard(model, poses, file.limits.clearance, stated, file.limits.floor, Path(file.robot))
    fastest, tool = speed_of_tool(robot, file.limits.tool_speed)
    guards = (*words, tool, *notes, *_torques(model, file, prior, assumed), *_rest(robot, rest, file, limits))
    limits = replace(limits, clearance=apart, guards=guards, tool_speed=fastest)
    period = round(file.period * file.rate) / file.rate  # a whole number of samples
    home = np.array([[robot.joint(name).home] for name in robot.actuated])
    reach = np.where(np.isfinite(limits.position).all(axis=1)[:, None], limits.position, np.add(home, (-TURN, TURN)))
    series = FourierSeries(reach.mean(axis=1), np.ptp(reach, axis=1) / 2, 1 / period, file.harmonics)
    start = rest if file.approach else None
    problem = DesignProblem(model, base, series, file.rate, file.repetitions, start, file.payloads, limits, prior)
    return problem, assumed


def _rest(robot: Robot, rest: np.ndarray, file: DesignFile, limits: MotionLimits) -> Iterator[str]:
    """Say where runs begin and end, and refuse a place outside the position limits."""
    if not file.approach:
        return
    for name, pose, (low, high) in zip(robot.actuated, rest, limits.position, strict=True):
        if not low <= pose <= high:
            raise GtauError(
                f"a run would begin and end with joint '{name}' at {pose:.4g}, outside its limits {low:.4g} to "
                f"{high:.4g}; give its position under 'rest', or write 'approach: false'."
            )
    poses = (f"'{name}' {q:.4g} {robot.joint(name).unit}" for name, q in zip(robot.actuated, rest, strict=True))
    yield f"rest: runs begin and end at {', '.join(poses)}; to change: rest"


def _torques(model: InverseDynamics, file: DesignFile, prior: PriorModel, assumed: Mapping[str, str]) -> Iterator[str]:
    """Say on what torque limits depend: inertias of links, and the centres of payloads."""
    stated, state = stated_bodies(model), "state prior.parameters or prior.model"
    names = model.parameter_names
    rods = [f"'{body}'" for body in model.robot.bodies if body not in stated and f"m_{body}" in names]
    if "parameters" in assumed and not stated:
        yield f"torque: guessed for links that are rods, real links may need more; {state}"
    elif "parameters" in assumed:
        guessed = f", rods for {some_of(rods, 4)}" if rods else ""
        yield (
            f"torque: with the inertias of the robot's file and {100 * (ERROR - 1):.0f} % for their error{guessed}, "
            f"friction and rotors guessed from the limits of effort; {state}"
        )
    loads = {payload.name: payload for payload in file.payloads if payload is not None}
    located = {name for name, load in loads.items() if {*FIRST_MOMENTS} & {*load.parameters}} | {*prior.centers}
    if central := [f"'{name}'" for name in loads if name not in located]:
        off = f"{ARM:g} m off along each axis of '{model.robot.tool}'"
        yield f"payload: the centre of {some_of(central, 4)} is unknown: assumed {off}; give mx, my, mz"


def _require_actuated(file: DesignFile, robot: Robot) -> None:
    """Refuse limits, rest and prior knowledge for names that are no actuated joints."""
    limits, prior = ("position", "velocity", "acceleration", "jerk", "current"), ("gains", "noise")
    named = {f"limits.{key}": getattr(file.limits, key) for key in limits} | {"rest": file.rest, "drives": file.drives}
    named |= {f"prior.{key}": getattr(file.prior, key) for key in prior}
    for key, joint in ((key, joint) for key, values in named.items() for joint in values):
        if joint not in robot.actuated:
            raise GtauError(
                f"{key} names '{joint}', which is no actuated joint of robot '{robot.name}'; choose from "
                f"{', '.join(robot.actuated)}."
            )


def _with_limits(robot: Robot, entry: LimitsEntry, rest: Mapping[str, float]) -> tuple[Robot, tuple[str, ...]]:
    """Take the limits of the design file, or a share of the robot's; say which are taken and which are missing."""
    near, limits = list[str](), dict[str, Limits]()
    for joint in robot.joints:
        name, given = joint.name, joint.limits
        share = entry.share if joint.actuated else 1.0  # where passive joints rest follows from the others
        position = given.position
        if position is not None and share < 1:
            middle, half = (position[0] + position[1]) / 2, share * (position[1] - position[0]) / 2
            start = rest[name] if position[0] <= rest[name] <= position[1] else middle
            near += [f"'{name}'"] * bool(abs(start - middle) > half)
            # runs begin within the limits
            position = min(middle - half, start), max(middle + half, start)
        limits[name] = replace(
            given,
            position=entry.position.get(name, position),
            velocity=entry.velocity.get(name, share * (given.velocity or 0.0) or None),
            acceleration=entry.acceleration.get(name, share * (given.acceleration or 0.0) or None),
            effort=share * (given.effort or 0.0) or None,
        )
    joints = tuple(replace(joint, limits=limits[joint.name]) for joint in robot.joints)
    limits = {name: limits[name] for name in robot.actuated}
    beyond = f" (but for {some_of(near, 4)} out to where it rests)" if near else ""
    notes = [f"limits: {100 * entry.share:.3g} % of the robot file's{beyond}, yours in full; change with limits.share"]
    if free := [f"'{name}'" for name, limit in limits.items() if limit.position is None]:
        notes.append(f"position: no limit in the file for {some_of(free, 4)}; state limits.position")
    efforts = {name: limit.effort or entry.current.get(name) for name, limit in limits.items()}
    if weak := [f"'{name}'" for name, effort in efforts.items() if effort is None]:
        state = "state its effort, or prior.gains and limits.current"
        notes.append(f"torque: no limit in the file for {some_of(weak, 4)}; {state}")
    if slow := [f"'{name}'" for name, limit in limits.items() if limit.acceleration is None]:
        reached = f"guessed for {some_of(slow, 4)}: the speed limit is reached in {RISE:g} s"
        notes.append(f"acceleration: {reached}; state limits.acceleration")
    if not entry.jerk:
        notes.append("jerk: not limited; state limits.jerk")
    return replace(robot, joints=joints), tuple(notes)


def _limits(entry: LimitsEntry, robot: Robot) -> MotionLimits:
    limits = [robot.joint(name).limits for name in robot.actuated]
    velocity, acceleration, effort = (
        np.array([getattr(limit, key) or np.inf for limit in limits]) for key in ("velocity", "acceleration", "effort")
    )
    if np.isinf(velocity).any():
        lacking = [name for name, most in zip(robot.actuated, velocity, strict=True) if np.isinf(most)]
        form = f"limits: {{velocity: {{{some_of([f'{name}: ...' for name in lacking], 8)}}}}}"
        raise GtauError(f"the robot's file has no velocity limit of {some_of(lacking, 8)}; add '{form}', rad/s or m/s.")
    current, jerk = (
        np.array([stated.get(name, np.inf) for name in robot.actuated]) for stated in (entry.current, entry.jerk)
    )
    return MotionLimits(
        position=np.array([limit.position or (-np.inf, np.inf) for limit in limits]),
        rates=np.array([velocity, np.where(np.isinf(acceleration), velocity / RISE, acceleration), jerk]),
        current=current,
        torque=np.where(np.isfinite(current), np.inf, effort),
        workspace={str(axis): interval for axis, interval in entry.workspace.items()},
        condition=entry.condition,
        away=entry.away_from_reversals,
    )

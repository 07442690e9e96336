"""The simulation file: robot, true parameters, drives and sensors, and the runs to simulate."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, FiniteFloat, field_validator, model_validator

from gtau.documents.files import SIMULATION, refuse_other_kind
from gtau.documents.validation import Keys, Positive, expect, validate
from gtau.documents.yaml_document import Document, read_yaml
from gtau.robots.parameter import Parameter, parameter_of
from gtau.robots.robot import DAMPING, Robot
from gtau.signals.reading.experiment import RobotName
from gtau.signals.reading.statements import Payload
from gtau.simulation.closed_loop import BANDWIDTH, JointHardware
from gtau.simulation.joint_friction import WIDTH
from gtau.simulation.trajectories import Existing, MotionEntry, PerJoint, require_joints


class SimulatedRun(Keys):
    """A run to simulate; with ``weigh: true``, the experiment file does not contain the mass of the payload."""

    name: str
    trajectory: MotionEntry
    payload: Payload | None = None
    weigh: bool = False

    @field_validator("name")
    @classmethod
    def _file_name(cls, name: str) -> str:
        if not re.fullmatch(r"\w[\w.-]*", name, re.ASCII):
            raise ValueError(f"'{name}' names a log; write it with letters, digits, '.', '_' and '-'")
        return name

    @model_validator(mode="after")
    def _payload_has_a_mass(self) -> SimulatedRun:
        if self.payload is not None and self.payload.mass is None:
            raise ValueError(f"the payload '{self.payload.name}' has no mass; a simulation needs it")
        if self.weigh and self.payload is None:
            raise ValueError("'weigh' is given without 'payload'; add a payload or remove it")
        return self


class Friction(Keys):
    """Ranges of speed in which Coulomb friction changes its sign, m/s and rad/s."""

    prismatic: Positive = WIDTH["prismatic"]
    revolute: Positive = WIDTH["revolute"]


class FrictionEntry(Keys):
    """Shape of a joint's friction, see :class:`gtau.estimation.friction.law.Shape`; rad or m, rad/s or m/s."""

    width: Positive | None = None
    speed: Positive | None = None


class Simulation(Keys):
    """Content of a simulation file, whose paths are relative to the file.

    The robot has the ``parameters`` and the friction of ``curves``, or an identified ``model``. ``control`` lists
    trajectories for the comparison of control laws, without logs.
    """

    robot: RobotName
    engine: Literal["gtau", "mujoco"] = "gtau"
    model: Existing | None = None
    parameters: dict[str, FiniteFloat] = Field(default_factory=dict)
    curves: dict[str, FrictionEntry] = Field(default_factory=dict)
    drives: dict[str, JointHardware] = Field(min_length=1)
    friction_width: Friction = Friction()
    rate: Annotated[FiniteFloat, Field(ge=50, le=20000)] = 1000.0
    bandwidth: Positive = Field(default_factory=lambda fields: min(BANDWIDTH, fields.get("rate", 1000.0) / 5))
    seed: Annotated[int, Field(ge=0)] = 0
    prior_gains: PerJoint = Field(default_factory=dict)
    runs: tuple[SimulatedRun, ...] = Field(min_length=1)
    validation: tuple[SimulatedRun, ...] = ()
    control: tuple[SimulatedRun, ...] = ()

    def __repr__(self) -> str:
        return f"Simulation({self.robot!r}, runs: {', '.join(run.name for run in self.runs)})"

    @field_validator("parameters")
    @classmethod
    def _friction_takes_energy(cls, parameters: dict[str, float]) -> dict[str, float]:
        for name, value in parameters.items():
            kind, rest = parameter_of(name).kind, Parameter("fs", parameter_of(name).body)
            if kind in ("fv", "fs", "fl", DAMPING) and value < 0:
                raise ValueError(f"the friction '{name}' is negative, and would drive the robot; write 0 or more")
            if kind == "fb" and parameters.get(rest, 0.0) + value < 0:
                raise ValueError(
                    f"the friction at rest, '{rest}' + '{name}', is negative, and would drive the robot; "
                    "write 0 or more"
                )
        return parameters

    @model_validator(mode="after")
    def _model_or_parameters(self) -> Simulation:
        if self.model is None and not self.parameters:
            raise ValueError("the robot has no parameters; give 'parameters', or a 'model' of 'gtau identify'")
        if self.model is not None and (self.parameters or self.curves):
            raise ValueError(
                "'model' states all parameters and friction; remove 'parameters' and 'curves', or the model"
            )
        return self

    @model_validator(mode="after")
    def _names_once(self) -> Simulation:
        names = [run.name for run in (*self.runs, *self.validation, *self.control)]
        if twice := next((name for name in names if names.count(name) > 1), None):
            raise ValueError(f"two runs are called '{twice}'; give every run a different name")
        if self.bandwidth > self.rate / 5:
            raise ValueError(
                f"a bandwidth of {self.bandwidth:g} rad/s is impossible at a rate of {self.rate:g} Hz; write at most "
                f"{self.rate / 5:g}"
            )
        return self


def read_simulation(path: str | Path) -> Simulation:
    """Read a simulation file."""
    refuse_other_kind(path, SIMULATION)
    return validate(Simulation, read_yaml(path), context=Path(path).parent)


def as_simulation(source: str | Path | Simulation | Mapping[str, Any]) -> Simulation:
    """Read a simulation file, or a mapping with its keys; raises GtauError."""
    if isinstance(source, (str, Path)):
        return read_simulation(source)
    if isinstance(source, Simulation):
        return source
    expect("a simulation", source, ("the path of a simulation file, or a mapping with its keys", (Mapping,)))
    return validate(Simulation, Document("simulation", source), context=Path())


def check_joints(simulation: Simulation, robot: Robot, path: str | Path) -> None:
    """Check that drives and prior gains belong to the robot's actuated joints; raises GtauError."""
    require_joints(simulation.drives, robot, f"{path}, drives")
    if simulation.prior_gains:
        require_joints(simulation.prior_gains, robot, f"{path}, prior_gains")

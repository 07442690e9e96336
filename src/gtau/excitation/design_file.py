"""The design file: which robot is to be identified, with which loads, within which limits."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, FiniteFloat, ValidationInfo, field_validator, model_validator

from gtau.documents.keys import Keys, Positive
from gtau.signals.logged_run import RobotName
from gtau.signals.payload import Payload

Interval = tuple[FiniteFloat, FiniteFloat]
Triple = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
CONDITION = 100.0  # default of the largest condition number of the closures


class PlannedRun(Keys):
    """A run of the motion, with a payload or with none."""

    payload: Payload | Literal["none"]


class DesignPrior(Keys):
    """What is known beforehand: a model, or standard parameters and drive gains; and the currents' noise, A."""

    model: Path | None = None
    gains: dict[str, FiniteFloat] = Field(default_factory=dict)
    parameters: dict[str, FiniteFloat] = Field(default_factory=dict)
    noise: dict[str, Positive] = Field(default_factory=dict)

    @field_validator("model")
    @classmethod
    def _beside_the_file(cls, model: Path | None, info: ValidationInfo) -> Path | None:
        return model if model is None or info.context is None else info.context / model

    @model_validator(mode="after")
    def _one_source(self) -> DesignPrior:
        if self.model is not None and (self.gains or self.parameters):
            raise ValueError("a model has gains and parameters of its own; give the model, or these")
        return self


class ShapeEntry(Keys):
    """A shape of a body, in its frame: a capsule about the line between two points, or the convex hull of a mesh."""

    capsule: tuple[Triple, Triple] | None = None
    radius: Positive | None = None
    mesh: Path | None = None
    scale: Positive = 1.0
    xyz: Triple = (0.0, 0.0, 0.0)
    rpy: Triple = (0.0, 0.0, 0.0)

    @field_validator("mesh")
    @classmethod
    def _beside_the_file(cls, mesh: Path | None, info: ValidationInfo) -> Path | None:
        return mesh if mesh is None or info.context is None else info.context / mesh

    @model_validator(mode="after")
    def _one_kind(self) -> ShapeEntry:
        if (self.capsule is None) == (self.mesh is None):
            raise ValueError("a shape is either 'capsule: [[x, y, z], [x, y, z]]' with a 'radius', or 'mesh: FILE'")
        if (self.capsule is None) != (self.radius is None):
            raise ValueError("a capsule has a 'radius', m, and a mesh has none; write or remove it")
        if self.capsule is not None and not self.model_fields_set.isdisjoint({"scale", "xyz", "rpy"}):
            raise ValueError("'scale', 'xyz' and 'rpy' place a mesh; a capsule stands where its points are")
        return self


class LimitsEntry(Keys):
    """Limits in place of the robot's, by joint; and those of the motion as a whole."""

    position: dict[str, Interval] = Field(default_factory=dict)
    velocity: dict[str, Positive] = Field(default_factory=dict)
    acceleration: dict[str, Positive] = Field(default_factory=dict)
    jerk: dict[str, Positive] = Field(default_factory=dict)
    current: dict[str, Positive] = Field(default_factory=dict)
    workspace: dict[Literal["x", "y", "z"], Interval] = Field(default_factory=dict)
    condition: Annotated[FiniteFloat, Field(gt=1)] = CONDITION
    away_from_reversals: Annotated[FiniteFloat, Field(ge=0, lt=1)] = 0.3
    clearance: Positive = 0.02
    shapes: dict[str, tuple[ShapeEntry, ...]] = Field(default_factory=dict)

    @field_validator("position", "workspace")
    @classmethod
    def _in_order(cls, intervals: dict[str, Interval]) -> dict[str, Interval]:
        for name, (low, high) in intervals.items():
            if not low < high:
                raise ValueError(f"the limits of '{name}' are {low:g} to {high:g}; write the lower one first")
        return intervals


class DesignFile(Keys):
    """What stands in a design file."""

    robot: RobotName
    rate: Positive
    period: Positive = 10.0
    harmonics: Annotated[int, Field(ge=2)] = 5
    repetitions: Annotated[int, Field(ge=1)] = 1
    space: Literal["joint", "platform"] = "joint"
    approach: bool = True
    rest: dict[str, FiniteFloat] = Field(default_factory=dict)
    runs: tuple[PlannedRun, ...] = Field(min_length=1)
    motions: Literal["one", "each run"] = "one"
    limits: LimitsEntry = LimitsEntry()
    prior: DesignPrior = DesignPrior()

    @model_validator(mode="after")
    def _payloads_give_the_scale(self) -> DesignFile:
        payloads = [None if run.payload == "none" else run.payload for run in self.runs]
        if len({None if each is None else each.name for each in payloads}) < 2 or not any(
            each and each.mass for each in payloads
        ):
            raise ValueError(
                "the drive gains need a run with a payload of known mass and one with another load or none; "
                "add it to 'runs'"
            )
        return self

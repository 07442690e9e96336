"""Write a result to ``model.json``, and read it back, refusing a damaged file."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    FiniteFloat,
    NonNegativeFloat,
    PositiveInt,
    model_validator,
)

from gtau.documents.files import MODEL, refuse_other_kind, write_atomically
from gtau.documents.validation import Positive, unknown, validate
from gtau.documents.yaml_document import Document
from gtau.errors import GtauError
from gtau.estimation.diagnostics.finding import Finding
from gtau.estimation.diagnostics.geometry_findings import GeometryTest
from gtau.estimation.diagnostics.inertia_audit import InertiaAudit
from gtau.estimation.diagnostics.sentences import advice, reason
from gtau.estimation.diagnostics.verdict import Outcome, Verdict
from gtau.estimation.estimators.physical_consistency import Consistency, Move
from gtau.estimation.estimators.registry import GROUP, NAMES
from gtau.estimation.friction.law import SHAPES
from gtau.estimation.results.estimate import (
    AlternativeMoves,
    Estimate,
    FrictionCurve,
    NearestPose,
    ReferenceTemperatures,
    Requirement,
    SensorEstimate,
    TorqueError,
)
from gtau.estimation.results.groups import Model
from gtau.estimation.results.model_document import OLDER, SCHEMA, to_document
from gtau.estimation.results.payload import PayloadEstimate
from gtau.estimation.results.result import Result, result_of
from gtau.extensions import registered
from gtau.robots.parameter import Parameter, parameter_of
from gtau.robots.readers.native import parse_native
from gtau.signals.channel import SENSOR, ChannelKind, link_side_kind
from gtau.signals.notes import Note
from gtau.signals.preparation.filters import Decimator
from gtau.signals.preparation.prepared_run import Preparation


class _Group(BaseModel):
    """A group of ``model.json``, of which what follows from other values is not read."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False, arbitrary_types_allowed=True, defer_build=True)


def _gathered(entry: Any) -> Any:
    """Give the entry of an estimate the keys of :class:`Estimate`: its name, as of a joint, and its verdict."""
    if not isinstance(entry, dict):
        return entry
    for key in ("value", "std", "freedom", "model_std", "outcome", "finding"):
        if key not in entry:
            raise ValueError(f"the key '{key}' is missing; add it")
    return {"name": entry.get("joint"), **entry, "verdict": entry}


def _by_name(estimates: tuple[Estimate, ...]) -> dict[str, Estimate]:
    named = {each.name: each for each in estimates}
    if len(named) < len(estimates):
        raise ValueError("a name is used twice; remove one entry")
    return named


def _by_parameter(estimates: dict[str, Estimate]) -> dict[Parameter, Estimate]:
    return {
        parameter_of(name, regrouped=len(estimate.regrouping.split()) > 1): estimate
        for name, estimate in estimates.items()
    }


def _method(name: str) -> str:
    if name not in NAMES and name not in registered(GROUP):
        raise ValueError(unknown(f"method '{name}'", name, NAMES))
    return name


_Estimate = Annotated[Estimate, BeforeValidator(_gathered)]
_Estimates = Annotated[tuple[_Estimate, ...], AfterValidator(_by_name)]
_Parameters = Annotated[tuple[_Estimate, ...], AfterValidator(_by_name), AfterValidator(_by_parameter)]
NoteEntry = Annotated[
    Note,
    BeforeValidator(lambda note: {k: v for k, v in note.items() if v is not None} if isinstance(note, dict) else note),
]
"""A note as :func:`gtau.estimation.grades.to_document` writes it, null for what it lacks."""


class _Known(_Group):
    known: bool


class _Payload(_Group):
    name: str
    run: str
    outcome: Outcome
    finding: Finding | None
    parameters: dict[str, _Estimate]
    known: dict[str, _Known] = Field(validation_alias="parameters")

    def made(self) -> PayloadEstimate:
        known = frozenset(kind for kind, each in self.known.items() if each.known)
        return PayloadEstimate(self.name, self.run, self.parameters, known, Verdict(self.outcome, self.finding))


class _Sensor(_Group):
    joint: str
    parameters: _Parameters
    delay: _Estimate
    residual: TorqueError
    ratio: _Estimate | None
    kind: Annotated[ChannelKind, BeforeValidator(link_side_kind)] = SENSOR

    def made(self) -> SensorEstimate:
        return SensorEstimate(**dict(self))


class _Curve(_Group):
    joint: str
    evidence: dict[str, float]
    error: NonNegativeFloat
    plain_error: NonNegativeFloat

    def made(self) -> FrictionCurve:
        return FrictionCurve(**dict(self))


class _Preparation(_Group):
    bandwidth: Positive
    cutoff: Positive | None
    decimation: PositiveInt
    decimator: Literal["fir", "chebyshev"]
    speed_fraction: NonNegativeFloat
    rate: NonNegativeFloat
    given: tuple[str, ...]
    prediction_cutoffs: tuple[Positive | None, ...] = ()
    position_noise: tuple[NonNegativeFloat, ...] = ()

    def made(self) -> Preparation:
        decimator = Decimator(self.decimation, self.decimator)
        rest = self.speed_fraction, self.rate, self.given, self.prediction_cutoffs, self.position_noise
        return Preparation(self.bandwidth, self.cutoff, decimator, *rest)


class _Parameter(_Group):
    name: str
    value: float
    open: bool


class _PayloadParameters(_Group):
    name: str
    parameters: dict[str, float]


class _Gain(_Group):
    joint: str
    value: float
    std: float


class _Standard(_Group):
    parameters: tuple[_Parameter, ...]
    payloads: tuple[_PayloadParameters, ...]
    drive_gains: tuple[_Gain, ...]
    moves: tuple[Move, ...]
    smallest_eigenvalues: dict[str, float]
    loss: dict[str, float]

    def made(self) -> Consistency:
        return Consistency(
            standard={each.name: each.value for each in self.parameters},
            payloads={each.name: each.parameters for each in self.payloads},
            gains={each.joint: (each.value, each.std) for each in self.drive_gains},
            moves=self.moves,
            eigenvalues=self.smallest_eigenvalues,
            loss=self.loss,
            open=tuple(each.name for each in self.parameters if each.open),
        )


class _Covariance(_Group):
    names: tuple[str, ...]
    matrix: tuple[tuple[float, ...], ...]

    @model_validator(mode="after")
    def _is_square(self) -> Self:
        if {len(self.names), *map(len, self.matrix)} != {len(self.matrix)}:
            raise ValueError("the covariance does not have the size of its names; write a row and a column a name")
        return self


def _statistics(found: dict[str, float]) -> dict[str, float]:
    if "lack_of_fit" not in found:
        raise ValueError("'lack_of_fit' is missing")
    return found


class _Model(_Group):
    robot_file: str
    stated_inertias: dict[str, FiniteFloat] = {}
    method: Annotated[str, AfterValidator(_method)]
    kind: Literal["current", "torque"]
    drive_gains: _Estimates
    delays: _Estimates
    parameters: _Parameters
    friction: _Parameters
    equation_friction: _Parameters = Field(default=(), validate_default=True)
    curves: tuple[_Curve, ...] = ()
    sensors: tuple[_Sensor, ...] = ()
    payloads: tuple[_Payload, ...]
    residuals: tuple[TorqueError, ...]
    covariance: _Covariance
    preparation: _Preparation
    logged_speeds: dict[str, NonNegativeFloat]
    statistics: Annotated[dict[str, FiniteFloat], AfterValidator(_statistics)]
    runs: tuple[str, ...]
    notes: tuple[NoteEntry, ...]
    temperatures: ReferenceTemperatures | None = None
    geometry: GeometryTest | None = None
    standard: _Standard | None
    alternatives: tuple[AlternativeMoves, ...]
    singularities: tuple[NearestPose, ...]
    requirements: tuple[Requirement, ...] = ()
    audit: InertiaAudit | None = None

    def made(self, path: Path) -> Result:
        """Assemble the result."""
        rest = dict(self)
        del rest["robot_file"], rest["standard"], rest["stated_inertias"]
        robot = replace(parse_native(self.robot_file, path), inertias=tuple(self.stated_inertias.items()))
        return result_of(
            Model(robot, tuple(sensor.joint for sensor in self.sensors)),
            **rest
            | {
                "curves": {each.joint: each.made() for each in self.curves},
                "sensors": tuple(each.made() for each in self.sensors),
                "payloads": tuple(each.made() for each in self.payloads),
                "covariance_names": tuple(map(parameter_of, self.covariance.names)),
                "covariance": np.array(self.covariance.matrix),
                "preparation": self.preparation.made(),
                "consistency": None if self.standard is None else self.standard.made(),
            },
        )


def model_text(result: Result) -> str:
    """Write the text of a result's file."""
    return json.dumps(to_document(result), indent=1, allow_nan=False) + "\n"


def save(result: Result, path: str | Path) -> None:
    """Write ``result`` to ``path``, atomically."""
    write_atomically(path, model_text(result))


def load(path: str | Path) -> Result:
    """Read a result.

    Raises
    ------
    GtauError
        Where the file cannot be read, or is no model of this schema.
    """
    refuse_other_kind(path, MODEL)
    path = Path(path)
    try:
        document = json.loads(path.read_text(encoding="utf-8"), parse_constant=_refuse, parse_float=_finite)
    except OSError as error:
        raise GtauError(
            f"{path} cannot be read ({error.strerror}); give the model.json that 'gtau identify' wrote."
        ) from None
    except (ValueError, RecursionError):
        raise GtauError(f"{path} is not a JSON file; give the model.json that 'gtau identify' wrote.") from None
    if not isinstance(document, dict) or "schema" not in document:
        raise GtauError(f"{path} is not a model; give the model.json that 'gtau identify' wrote.")
    if document["schema"] not in (SCHEMA, *OLDER):
        raise GtauError(
            f"{path} has the schema '{document['schema']}', but this version reads '{SCHEMA}'; identify again "
            "with this version."
        )
    if document["schema"] == "gtau-model/3":
        document = _one_friction(document)
    result = validate(_Model, Document(path, document, {})).made(path)
    for problem in _problems(result):
        raise GtauError(f"{path} is damaged ({problem}); write it again with 'gtau identify'.")
    return result


def _one_friction(document: dict[str, Any]) -> dict[str, Any]:
    """Rewrite a document of schema 3, whose curves have the friction that predicts, as one of schema 4."""
    try:
        curves = document["curves"]
        predicted = {each["name"]: each for curve in curves for each in curve["parameters"]}
        shapes = [curve[key] for curve in curves for key in ("width", "speed") if curve[key] is not None]
        parameters = {each["name"]: each for each in document["parameters"]}
        of_base = {
            name: name.removesuffix("R") if len(each["regrouping"].split()) > 1 else name
            for name, each in parameters.items()
        }
        replaced = {name: predicted.pop(own) for name, own in of_base.items() if own in predicted}
    except (KeyError, TypeError, AttributeError):
        return document  # which the schema then refuses
    if not curves:
        return document
    equations = [*(parameters[name] for name in replaced), *document["friction"]]
    kept = [parameters[name] | {k: v for k, v in replaced.get(name, {}).items() if k != "name"} for name in parameters]
    return document | {"parameters": kept, "friction": [*predicted.values(), *shapes], "equation_friction": equations}


def _refuse(constant: str) -> float:
    raise ValueError(f"{constant} is not a JSON number")


def _finite(text: str) -> float:
    return float(text) if isfinite(float(text)) else _refuse(text)


def _problems(result: Result) -> Iterator[str]:
    robot = result.robot
    for what, estimates, joints in (
        ("drive gains", result.drive_gains, robot.motors),
        ("delays", result.delays, robot.actuated),
    ):
        if tuple(estimates) != joints:
            yield f"the {what} are not those of the joints {', '.join(joints)}"
        if any(each.value is None for each in estimates.values()):
            yield f"one of the {what} is null"
    strange = set(result.curves) - {joint.name for joint in robot.joints}
    if strange:
        yield f"'curves' has the friction of '{sorted(strange)[0]}', which is no joint"
    for name, each in result.friction.items():
        if name.kind in SHAPES and not (each.value or 0.0) > 0:
            yield f"'{name}' is not positive"
    if any(each.value == 0 for each in result.drive_gains.values()):
        yield "a drive gain is zero"
    if not {Parameter("gain", joint) for joint in robot.motors} <= set(result.covariance_names):
        yield "the covariance lacks the drive gains"
    verdicts = [each.verdict for each in _estimates(result)] + [each.verdict for each in result.payloads]
    causes = (cause for each in result.alternatives for cause in each.causes)
    for finding in (*(each.finding for each in verdicts if each.finding), *causes):
        try:
            reason(finding), advice(finding)
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError):  # of a template and its values
            yield f"the values of the finding '{finding.kind}' are not those of its sentence"


def _estimates(result: Result) -> Iterator[Estimate]:
    for group in (result.drive_gains, result.delays, result.parameters, result.friction, result.equation_friction):
        yield from group.values()
    for payload in result.payloads:
        yield from payload.parameters.values()
    for sensor in result.sensors:
        yield from (*sensor.parameters.values(), sensor.delay, *((sensor.ratio,) if sensor.ratio else ()))

"""Write a result to ``model.json``, and read it back, refusing a damaged file."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, fields
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
    PlainSerializer,
    PositiveInt,
    TypeAdapter,
    model_validator,
)

from gtau.documents.files import MODEL, json_in, refuse_other_kind, system_refusals, write_atomically
from gtau.documents.markup import Document
from gtau.documents.validation import LARGEST, Positive, unknown, validate
from gtau.errors import GtauError
from gtau.estimation.diagnostics.geometry import GeometryTest, from_document, to_document as geometry_document
from gtau.estimation.diagnostics.inertia_audit import InertiaAudit
from gtau.estimation.effects.effect import EstimatedEffect
from gtau.estimation.estimators import GROUP, NAMES
from gtau.estimation.estimators.physical_consistency import Consistency
from gtau.estimation.friction.curves import FrictionCurve, ReferenceTemperatures
from gtau.estimation.results.estimate import Estimate, NearestPose, Requirement, SensorEstimate, TorqueError
from gtau.estimation.results.payload_body import PayloadEstimate
from gtau.estimation.results.result import IdentifiedModel
from gtau.extensions import registered
from gtau.findings import Finding, finding_document, note_document, read_note
from gtau.model.base_parameters import Equations
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.parameter import SHAPES, Parameter, parameter_of, unit_of
from gtau.robots.readers.native import native_text, parse_native
from gtau.signals.channel import SENSOR, ChannelKind, link_side_kind
from gtau.signals.preparation.filters import Decimator, Preparation
from gtau.signals.reading.experiment import Recording

SCHEMA = "gtau-model/5"


def _with(*properties: str) -> PlainSerializer:
    return PlainSerializer(lambda record: asdict(record) | {name: getattr(record, name) for name in properties})


def _entry(read: Callable[[Any], Any]) -> BeforeValidator:
    """Give an entry of the file the names of a record's fields, by ``read``; refuse an entry of another form."""

    def fields_of(entry: Any) -> Any:
        try:
            return read(entry)
        except KeyError as key:
            raise ValueError(f"the key {key} is missing; add it") from None
        except (AttributeError, TypeError):
            raise ValueError(f"{entry!r:.40} has another form; write what 'gtau identify' writes") from None

    return BeforeValidator(fields_of)


def _estimate_fields(entry: Any) -> dict[str, Any]:
    """Give the entry of an estimate the fields of :class:`Estimate`; its name may be the name of a joint."""
    required = {key: entry[key] for key in ("value", "std", "freedom", "model_std")}
    more = {"between_run_std": entry.get("spread"), "verdict": _judged(entry)}
    return {"name": entry.get("joint"), **entry, **required, **more}


def _judged(entry: Any) -> Any:
    return entry["finding"] or {"kind": entry["outcome"], "grade": entry["outcome"]}


def _scales(gains: Any) -> dict[str, Any]:
    return {gain["joint"]: gain["scale"] for gain in gains if gain.get("scale")}


def _payload_fields(entry: Any) -> dict[str, Any]:
    parameters = entry["parameters"]
    return {
        "name": entry["name"],
        "run": entry["run"],
        "parameters": {kind: _estimate_fields(parameter) for kind, parameter in parameters.items()},
        "known": frozenset(kind for kind, parameter in parameters.items() if parameter["known"]),
        "verdict": _judged(entry),
    }


def _consistency_fields(entry: Any) -> dict[str, Any]:
    return {
        "standard": {parameter["name"]: parameter["value"] for parameter in entry["parameters"]},
        "payloads": {payload["name"]: payload["parameters"] for payload in entry["payloads"]},
        "gains": {gain["joint"]: (gain["value"], gain["std"]) for gain in entry["drive_gains"]},
        "moves": entry["moves"],
        "eigenvalues": entry["smallest_eigenvalues"],
        "loss": entry["loss"],
        "open": [parameter["name"] for parameter in entry["parameters"] if parameter["open"]],
    }


def _estimate(estimate: Estimate, *more: str, key: str = "name") -> dict[str, Any]:
    """Describe an estimate, by its name or joint, with ``more`` of its fields; ``rel_std`` in per cent."""
    return {
        key: estimate.name,
        "value": estimate.value,
        "std": estimate.std,
        "rel_std": estimate.rel_std,
        "interval": estimate.interval(),
        "freedom": None if estimate.std is None else estimate.freedom,
        "model_std": estimate.model_std,
        "unit": estimate.unit,
        **_verdict(estimate.verdict),
        **{name.replace("between_run_std", "spread"): getattr(estimate, name) for name in more},
    }


def _verdict(verdict: Finding) -> dict[str, Any]:
    finding = verdict.finding and finding_document(verdict.finding)
    return {"outcome": verdict.outcome.value, "finding": finding, "why": verdict.why, "advice": verdict.advice}


def _listed(*more: str, key: str = "name") -> PlainSerializer:
    return PlainSerializer(lambda named: [_estimate(estimate, *more, key=key) for estimate in named.values()])


def _by_name(estimates: tuple[Estimate, ...]) -> dict[str, Estimate]:
    if len(named := {estimate.name: estimate for estimate in estimates}) < len(estimates):
        raise ValueError("a name is used twice; remove one entry")
    return named


def _effect(effect: EstimatedEffect) -> dict[str, Any]:
    return asdict(effect) | {"subject": effect.subject, "cause": finding_document(effect.cause)}


def _method(name: str) -> str:
    if name not in NAMES and name not in registered(GROUP):
        raise ValueError(unknown(f"method '{name}'", name, NAMES))
    return name


def _statistics(figures: dict[str, float]) -> dict[str, float]:
    if "lack_of_fit" not in figures:
        raise ValueError("'lack_of_fit' is missing")
    return figures


_Estimate = Annotated[Estimate, _entry(_estimate_fields), PlainSerializer(_estimate)]
_Joint = Annotated[
    Estimate, _entry(_estimate_fields), PlainSerializer(lambda estimate: _estimate(estimate, key="joint"))
]
_ByName = Annotated[tuple[_Estimate, ...], AfterValidator(_by_name)]
_ByParameter = Annotated[
    _ByName, AfterValidator(lambda named: {parameter_of(name, bool(one.regroups)): one for name, one in named.items()})
]
_TorqueError = Annotated[TorqueError, _with("relative", "relative_all", "relative_raw")]
_Recording = Annotated[Recording, PlainSerializer(lambda kept: kept.model_dump(mode="json", exclude_defaults=True))]
NoteEntry = Annotated[Finding, _entry(read_note), PlainSerializer(note_document)]


class _Group(BaseModel):
    """A group of keys, of which what follows from other values is not read."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False, arbitrary_types_allowed=True, defer_build=True)


def payload_documents(payloads: tuple[PayloadEstimate, ...]) -> list[dict[str, Any]]:
    """Describe payloads as in ``model.json`` and in what ``gtau payload --json`` prints."""
    return [
        {
            "name": payload.name,
            "run": payload.run,
            **_verdict(payload.verdict),
            "parameters": {
                kind: _estimate(estimate, "regrouping") | {"known": kind in payload.known}
                for kind, estimate in payload.parameters.items()
            },
        }
        for payload in payloads
    ]


class _Sensor(_Group):
    joint: str
    parameters: Annotated[_ByParameter, _listed()]
    delay: _Joint
    residual: _TorqueError
    ratio: _Joint | None
    kind: Annotated[ChannelKind, BeforeValidator(link_side_kind), PlainSerializer(lambda kind: kind.name)] = SENSOR


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
        rest = {name: value for name, value in self if name != "decimation"}
        return Preparation(**rest | {"decimator": Decimator(self.decimation, self.decimator)})


def _standard(result: IdentifiedModel) -> dict[str, Any] | None:
    bodies, robot = result.consistency, result.robot
    if bodies is None:
        return None
    units = {name: unit_of(parameter_of(name).kind, robot, parameter_of(name).body) for name in bodies.standard}
    return {
        "parameters": [
            {"name": name, "value": value, "unit": units[name], "open": name in bodies.open}
            for name, value in bodies.standard.items()
        ],
        "payloads": [{"name": name, "parameters": dict(values)} for name, values in bodies.payloads.items()],
        "drive_gains": [{"joint": joint, "value": g, "std": std} for joint, (g, std) in bodies.gains.items()],
        "moves": bodies.moves,
        "smallest_eigenvalues": bodies.eigenvalues,
        "loss": bodies.loss,
    }


class _Covariance(_Group):
    names: tuple[str, ...]
    matrix: Annotated[tuple[tuple[float, ...], ...], PlainSerializer(np.ndarray.tolist)]

    @model_validator(mode="after")
    def _is_square(self) -> Self:
        if {len(self.names), *map(len, self.matrix)} != {len(self.matrix)}:
            raise ValueError("the covariance does not have the size of its names; write a row and a column a name")
        return self


class ModelDocument(_Group):
    """The keys of the document: how each is written, and read."""

    robot_file: str
    stated_inertias: dict[str, FiniteFloat] = {}
    method: Annotated[str, AfterValidator(_method)]
    kind: Literal["current", "torque"]
    runs: tuple[str, ...]
    drive_gains: Annotated[_ByName, _listed(key="joint")]
    scale: Annotated[dict[str, dict[str, float]], _entry(_scales)] = Field(validation_alias="drive_gains", exclude=True)
    delays: Annotated[_ByName, _listed(key="joint")]
    parameters: Annotated[_ByParameter, _listed("regrouping", "between_run_std", "essential")]
    friction: Annotated[_ByParameter, _listed()]
    equation_friction: Annotated[_ByParameter, _listed()] = Field(default=(), validate_default=True)
    motors: Annotated[_ByParameter, _listed()] = Field(default=(), validate_default=True)
    curves: tuple[FrictionCurve, ...] = ()
    sensors: tuple[_Sensor, ...] = ()
    payloads: Annotated[
        tuple[Annotated[PayloadEstimate, _entry(_payload_fields)], ...], PlainSerializer(payload_documents)
    ]
    residuals: tuple[_TorqueError, ...]
    preparation: _Preparation
    logged_speeds: dict[str, NonNegativeFloat]
    statistics: Annotated[dict[str, FiniteFloat], AfterValidator(_statistics)]
    requirements: tuple[Annotated[Requirement, _with("met")], ...] = ()
    effects: tuple[Annotated[EstimatedEffect, PlainSerializer(_effect)], ...]
    singularities: tuple[NearestPose, ...]
    recording: _Recording | None = None
    temperatures: ReferenceTemperatures | None = None
    geometry: Annotated[GeometryTest, _entry(from_document), PlainSerializer(geometry_document)] | None = None
    audit: Annotated[InertiaAudit, _with("stated_error", "identified_error")] | None = None
    notes: tuple[NoteEntry, ...]
    covariance: _Covariance
    standard: Annotated[
        Annotated[Consistency, _entry(_consistency_fields)] | None, PlainSerializer(lambda document: document)
    ]

    def made(self, path: Path) -> IdentifiedModel:
        """Assemble the result."""
        robot = parse_native(self.robot_file, path).with_file(inertias=tuple(self.stated_inertias.items()))
        values = dict(self) | {
            "curves": {curve.joint: curve for curve in self.curves},
            "sensors": tuple(SensorEstimate(**dict(sensor)) for sensor in self.sensors),
            "covariance_names": tuple(map(parameter_of, self.covariance.names)),
            "covariance": np.array(self.covariance.matrix),
            "preparation": self.preparation.made(),
            "consistency": self.standard,
        }
        known = {field.name: values[field.name] for field in fields(IdentifiedModel) if field.name in values}
        equations = Equations(InverseDynamics(robot), tuple(sensor.joint for sensor in values["sensors"]))
        return IdentifiedModel(equations, **known)


def to_document(result: IdentifiedModel) -> dict[str, Any]:
    """Describe a result as a JSON document; ``rel_std`` in per cent, null where a value is known."""
    decimator = result.preparation.decimator
    prepared = vars(result.preparation) | {"decimation": decimator.factor, "decimator": decimator.kind}
    values = {name: getattr(result, name, None) for name in ModelDocument.model_fields} | {
        "robot_file": native_text(result.robot),
        "stated_inertias": dict(result.robot.inertias),
        "curves": tuple(result.curves.values()),
        "sensors": tuple(_Sensor.model_construct(**vars(sensor)) for sensor in result.sensors),
        "preparation": _Preparation.model_construct(**prepared),
        "covariance": _Covariance.model_construct(names=result.covariance_names, matrix=result.covariance),
        "standard": _standard(result),
    }
    document = ModelDocument.model_construct(**values).model_dump(mode="json")
    for entry in document["drive_gains"]:
        entry["scale"] = dict(result.scale.get(entry["joint"], {}))
    return {"schema": SCHEMA, "robot": result.robot.name, **document}


def torque_error(error: TorqueError) -> dict[str, Any]:
    """Describe a torque error as in ``model.json``: ``relative`` in per cent."""
    return dict(TypeAdapter(_TorqueError).dump_python(error, mode="json"))


def model_text(result: IdentifiedModel) -> str:
    """Write the text of a result's file."""
    return json.dumps(to_document(result), indent=1, allow_nan=False) + "\n"


def save(result: IdentifiedModel, path: str | Path) -> None:
    """Write ``result`` to ``path``, atomically."""
    write_atomically(path, model_text(result))


def load(path: str | Path) -> IdentifiedModel:
    """Read a result; raises GtauError where the file cannot be read, or is not a model of this schema."""
    refuse_other_kind(path, MODEL)
    path = Path(path)
    with system_refusals(path, "give the model.json that 'gtau identify' wrote"):
        try:
            document = json_in(path.read_text(encoding="utf-8"), parse_constant=_refuse, parse_float=_finite)
        except OverflowError as size:
            raise _damaged(path, f"{size} is out of range") from None
        except ValueError:
            raise GtauError(f"{path} is not a JSON file; give the model.json that 'gtau identify' wrote.") from None
    if not isinstance(document, dict) or "schema" not in document:
        raise GtauError(f"{path} is not a model; give the model.json that 'gtau identify' wrote.")
    if document["schema"] != SCHEMA:
        raise GtauError(
            f"{path} has the schema '{document['schema']}', but this version reads '{SCHEMA}'; identify again "
            "with this version."
        )
    result = validate(ModelDocument, Document(path, document)).made(path)
    for problem in _problems(result):
        raise _damaged(path, problem)
    return result


def _damaged(path: Path, problem: str) -> GtauError:
    return GtauError(f"{path} is damaged ({problem}); write it again with 'gtau identify'.")


def _refuse(constant: str) -> float:
    raise ValueError(f"{constant} is not a JSON number")


def _finite(text: str) -> float:
    if not abs(number := float(text)) < LARGEST:
        raise OverflowError(text)
    return number


def _problems(result: IdentifiedModel) -> Iterator[str]:
    """List what the keys of a file cannot show: values that do not belong together."""
    robot = result.robot
    listed = {"drive gains": (result.drive_gains, robot.motors), "delays": (result.delays, robot.actuated)}
    for what, (estimates, joints) in listed.items():
        if tuple(estimates) != joints:
            yield f"the {what} are not of the joints {', '.join(joints)}"
        if any(estimate.value is None for estimate in estimates.values()):
            yield f"one of the {what} is null"
    preparation = result.preparation
    if preparation.cutoff and 0 < preparation.rate <= 2 * preparation.cutoff:
        yield f"'preparation.cutoff' is {preparation.cutoff:g} Hz, more than half the rate"
    cutoffs, noise = len(preparation.prediction_cutoffs), len(preparation.position_noise)
    if not {cutoffs, noise} <= {0, len(robot.actuated)} or cutoffs > noise:
        yield "'prediction_cutoffs' and 'position_noise' do not have a value for each joint"
    for key, named in (("curves", result.curves), ("logged_speeds", result.logged_speeds)):
        if strange := named.keys() - {joint.name for joint in robot.joints}:
            yield f"'{key}' names '{min(strange)}', which is no joint"
    for name, estimate in result.friction.items():
        if name.kind in SHAPES and not (estimate.value or 0.0) > 0:
            yield f"'{name}' is not positive"
    if any(gain.value == 0 for gain in result.drive_gains.values()):
        yield "a drive gain is zero"
    if not {Parameter("gain", joint) for joint in robot.motors} <= set(result.covariance_names):
        yield "the covariance lacks the drive gains"

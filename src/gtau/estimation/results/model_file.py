"""``model.json``: a result written to a file, and read back with all that a damaged file may hold refused."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from gtau.documents.files import MODEL, refuse_other_kind, write_atomically
from gtau.errors import GtauError
from gtau.estimation.diagnostics.finding import read_finding
from gtau.estimation.diagnostics.geometry_findings import from_document as read_geometry
from gtau.estimation.diagnostics.verdict import Outcome, Verdict
from gtau.estimation.estimators.physical_consistency import Consistency, Move
from gtau.estimation.grades import from_document as read_note
from gtau.estimation.results.estimate import (
    AlternativeMoves,
    Estimate,
    PayloadEstimate,
    ReferenceTemperatures,
    SensorEstimate,
    TorqueError,
)
from gtau.estimation.results.identified_model import IdentifiedModel
from gtau.estimation.results.model_document import SCHEMA, to_document
from gtau.estimation.results.singularity_distances import NearestPose
from gtau.robots.parameter import Parameter
from gtau.robots.readers.native import parse_native
from gtau.signals.decimation import Decimator
from gtau.signals.preparation import Preparation

Model = TypeVar("Model", bound=IdentifiedModel)


def _read_standard(document: Mapping[str, Any]) -> Consistency:
    return Consistency(
        standard={each["name"]: float(each["value"]) for each in document["parameters"]},
        payloads={each["name"]: each["parameters"] for each in document["payloads"]},
        gains={each["joint"]: (float(each["value"]), float(each["std"])) for each in document["drive_gains"]},
        moves=tuple(Move(**each) for each in document["moves"]),
        eigenvalues=document["smallest_eigenvalues"],
        loss=document["loss"],
        open=tuple(each["name"] for each in document["parameters"] if each["open"]),
    )


def model_text(result: IdentifiedModel) -> str:
    """Write the text of a result's file."""
    return json.dumps(to_document(result), indent=1, allow_nan=False) + "\n"


def save(result: IdentifiedModel, path: str | Path) -> None:
    """Write ``result`` to ``path``, atomically."""
    write_atomically(path, model_text(result))


def load(path: str | Path, make: type[Model]) -> Model:
    """Read a result, which ``make`` makes.

    Raises
    ------
    GtauError
        Where the file cannot be read, or is no model of this schema.
    """
    refuse_other_kind(path, MODEL)
    try:
        document = json.loads(Path(path).read_text(encoding="utf-8"), parse_constant=_refuse)
    except OSError as error:
        raise GtauError(
            f"{path} cannot be read ({error.strerror}); give the model.json that 'gtau identify' wrote."
        ) from None
    except (ValueError, RecursionError):
        raise GtauError(f"{path} is not a JSON file; give the model.json that 'gtau identify' wrote.") from None
    if not isinstance(document, dict) or "schema" not in document:
        raise GtauError(f"{path} is not a model; give the model.json that 'gtau identify' wrote.")
    if document["schema"] != SCHEMA:
        raise GtauError(
            f"{path} has the schema '{document['schema']}', but this version reads '{SCHEMA}'; identify again "
            "with this version."
        )
    try:
        result = _result(document, path, make)
    except KeyError as error:
        raise _damaged(path, f"{error} is missing") from None
    except (TypeError, ValueError, AttributeError) as error:
        raise _damaged(path, str(error).split(". ")[0]) from None
    for problem in _problems(result):
        raise _damaged(path, problem)
    return result


def _refuse(constant: str) -> float:
    raise ValueError(f"{constant} is not a JSON number")


def _damaged(path: str | Path, problem: str) -> GtauError:
    return GtauError(f"{path} is damaged ({problem}); write it again with 'gtau identify'.")


def _problems(result: IdentifiedModel) -> Iterator[str]:
    robot, preparation = result.robot, result.preparation
    for what, estimates, joints in (
        ("drive gains", result.drive_gains, robot.motors),
        ("delays", result.delays, robot.actuated),
    ):
        if tuple(estimates) != joints:
            yield f"the {what} are not those of the joints {', '.join(joints)}"
        if any(each.value is None for each in estimates.values()):
            yield f"one of the {what} is null"
    if any(each.value == 0 for each in result.drive_gains.values()):
        yield "a drive gain is zero"
    every = (*result.drive_gains.values(), *result.delays.values(), *result.parameters.values())
    if not np.isfinite([each.value or 0.0 for each in every]).all():
        yield "a value is not finite"
    if not all(np.isfinite(speed) and speed >= 0 for speed in result.logged_speeds.values()):
        yield "a logged speed is negative or not finite"
    size = len(result.covariance_names)
    if result.covariance.shape != (size, size) or not np.isfinite(result.covariance).all():
        yield "the covariance does not have the size of its names"
    if not {Parameter("gain", joint).name for joint in robot.motors} <= set(result.covariance_names):
        yield "the covariance lacks the drive gains"
    if result.kind not in ("current", "torque"):
        yield f"the kind '{result.kind}' is neither current nor torque"
    if preparation.bandwidth <= 0 or preparation.decimator.kind not in ("fir", "chebyshev"):
        yield "the preparation of the signals is not one that this version knows"


def _result(document: Mapping[str, Any], path: str | Path, make: type[Model]) -> Model:
    preparation = document["preparation"]
    return make(
        robot=parse_native(document["robot_file"], path),
        method=document["method"],
        kind=document["kind"],
        drive_gains=_estimates(document["drive_gains"], "joint"),
        delays=_estimates(document["delays"], "joint"),
        parameters=_estimates(document["parameters"]),
        friction=_estimates(document["friction"]),
        sensors=tuple(
            SensorEstimate(
                each["joint"],
                _estimates(each["parameters"]),
                _read(each["delay"], "joint"),
                _read_error(each["residual"]),
                None if each["ratio"] is None else _read(each["ratio"], "joint"),
            )
            for each in document.get("sensors", [])
        ),
        payloads=tuple(
            PayloadEstimate(
                each["name"],
                each["run"],
                {kind: _read(entry) for kind, entry in each["parameters"].items()},
                frozenset(kind for kind, entry in each["parameters"].items() if entry["known"]),
                _read_verdict(each),
            )
            for each in document["payloads"]
        ),
        residuals=tuple(_read_error(each) for each in document["residuals"]),
        covariance_names=tuple(document["covariance"]["names"]),
        covariance=np.array(document["covariance"]["matrix"], dtype=float),
        preparation=Preparation(
            float(preparation["bandwidth"]),
            None if preparation["cutoff"] is None else float(preparation["cutoff"]),
            Decimator(int(preparation["decimation"]), preparation["decimator"]),
            float(preparation["speed_fraction"]),
            float(preparation["rate"]),
            tuple(preparation["given"]),
        ),
        logged_speeds={joint: float(speed) for joint, speed in document["logged_speeds"].items()},
        statistics=document["statistics"],
        runs=tuple(document["runs"]),
        notes=tuple(map(read_note, document["notes"])),
        temperatures=document.get("temperatures") and ReferenceTemperatures(**document["temperatures"]),
        geometry=document.get("geometry") and read_geometry(document["geometry"]),
        consistency=None if document["standard"] is None else _read_standard(document["standard"]),
        alternatives=tuple(map(_read_alternative, document["alternatives"])),
        singularities=tuple(NearestPose(**each) for each in document["singularities"]),
    )


def _read_error(entry: Mapping[str, Any]) -> TorqueError:
    return TorqueError(entry["joint"], float(entry["rms"]), float(entry["signal"]), entry["unit"])


def _estimates(entries: list[Mapping[str, Any]], key: str = "name") -> dict[str, Estimate]:
    return {entry[key]: _read(entry, key) for entry in entries}


def _read(entry: Mapping[str, Any], key: str = "name") -> Estimate:
    value, std = (None if entry[k] is None else float(entry[k]) for k in ("value", "std"))
    return Estimate(
        entry[key],
        value,
        std,
        entry["unit"],
        entry.get("regrouping", ""),
        entry.get("spread"),
        _read_verdict(entry),
        entry["freedom"],
        entry["model_std"],
        entry.get("essential"),
        entry.get("scale", {}),
    )


def _read_verdict(entry: Mapping[str, Any]) -> Verdict:
    finding = None if entry["finding"] is None else read_finding(entry["finding"])
    return Verdict(Outcome(entry["outcome"]), finding)


def _read_alternative(entry: Mapping[str, Any]) -> AlternativeMoves:
    others = {key: value for key, value in entry.items() if key not in ("subject", "causes")}
    return AlternativeMoves(causes=tuple(map(read_finding, entry["causes"])), **others)

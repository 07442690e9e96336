"""Write a result to ``model.json``, and read it back, refusing a damaged file."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gtau.documents.files import MODEL, json_in, refuse_other_kind, system_refusals, write_atomically
from gtau.documents.validation import LARGEST, validate
from gtau.documents.yaml_document import Document
from gtau.errors import GtauError
from gtau.estimation.results.model_document import ModelDocument, described
from gtau.estimation.results.result import IdentifiedModel
from gtau.robots.parameter import SHAPES, Parameter

SCHEMA = "gtau-model/5"


def to_document(result: IdentifiedModel) -> dict[str, Any]:
    """Describe a result as a JSON document; ``rel_std`` in per cent, null where a value is known."""
    document = described(result).model_dump(mode="json")
    for entry in document["drive_gains"]:
        entry["scale"] = dict(result.scale.get(entry["joint"], {}))
    return {"schema": SCHEMA, "robot": result.robot.name, **document}


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
    for what, estimates, joints in (
        ("drive gains", result.drive_gains, robot.motors),
        ("delays", result.delays, robot.actuated),
    ):
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
    strange = set(result.curves) - {joint.name for joint in robot.joints}
    if strange:
        yield f"'curves' has the friction of '{sorted(strange)[0]}', which is no joint"
    for name, estimate in result.friction.items():
        if name.kind in SHAPES and not (estimate.value or 0.0) > 0:
            yield f"'{name}' is not positive"
    if any(gain.value == 0 for gain in result.drive_gains.values()):
        yield "a drive gain is zero"
    if not {Parameter("gain", joint) for joint in robot.motors} <= set(result.covariance_names):
        yield "the covariance lacks the drive gains"

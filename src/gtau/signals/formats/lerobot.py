"""Read ``meta/info.json`` of a LeRobot data set: frame rate, and names of the list items.

https://huggingface.co/docs/lerobot: ``fps``, and by feature its ``names``, a list or lists by their kind
(``{"motors": [...]}``). Frames are in ``data/chunk-000/file-000.parquet``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gtau.errors import GtauError

INFO = "meta/info.json"
DEPTH = 3  # folders between a file of frames and the data set


@dataclass(frozen=True)
class DataSet:
    """Rate of the frames, Hz, and names of the items of each feature; empty where a log is of no data set."""

    rate: float | None = None
    names: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


def data_set_of(log: Path) -> DataSet:
    """Read the data set to which a file of frames, or their folder, belongs.

    Raises
    ------
    GtauError
        Its description is damaged.
    """
    folders = [log, *log.absolute().parents[:DEPTH]]
    file = next((folder / INFO for folder in folders if (folder / INFO).is_file()), None)
    if file is None:
        return DataSet()
    try:
        info = json.loads(file.read_text(encoding="utf-8"))
        features, rate = info.get("features", {}), info.get("fps")
        names = {name: tuple(_flat(feature.get("names"))) for name, feature in features.items()}
        return DataSet(None if rate is None else float(rate), names)
    except (OSError, ValueError, TypeError, AttributeError):
        raise GtauError(
            f"{file} is not a readable description of a LeRobot data set; correct it, or move {log.name} out of "
            "its folder."
        ) from None


def _flat(names: Any) -> list[str]:
    if isinstance(names, Mapping):
        return [each for of in names.values() for each in _flat(of)]
    if isinstance(names, list):
        return [each for of in names for each in _flat(of)]
    return [names] if isinstance(names, str) else []

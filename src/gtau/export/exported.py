"""Files of an export: how they are written, and what is returned."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from gtau.documents.files import folder_of, write_atomically


@dataclass(frozen=True)
class Exported:
    """Files written, notes on what the target cannot express, and figures by name (``rms_percent_11``).

    ``lost`` is the first of the notes where the files are not the whole robot, to be said before all else.
    """

    files: tuple[Path, ...]
    notes: tuple[str, ...] = ()
    figures: Mapping[str, float] = field(default_factory=dict)
    lost: str = ""


def written(out: Path, texts: Mapping[str, str | bytes]) -> tuple[Path, ...]:
    """Write files by name into the folder ``out``, each atomically; raises GtauError where that fails."""
    folder = folder_of(out)
    for name, text in texts.items():
        write_atomically(folder / name, text)
    return tuple(folder / name for name in texts)

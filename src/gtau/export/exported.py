"""What a kind of export is: its files, their names, how they are written, and what is returned."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, indent, tostring

import numpy as np

from gtau.documents.files import folder_of, write_atomically
from gtau.errors import GtauError
from gtau.estimation.results.result import Result


@dataclass(frozen=True)
class Exported:
    """Files written, notes on what the target cannot express, and figures by name (``rms_percent_11``).

    ``lost`` is the first of the notes where the files are not the whole robot, to be said before all else.
    """

    files: tuple[Path, ...]
    notes: tuple[str, ...] = ()
    figures: Mapping[str, float] = field(default_factory=dict)
    lost: str = ""


@dataclass(frozen=True)
class Export:
    """A kind of export.

    Attributes
    ----------
    write : callable
        Writes a result into a folder.
    into : callable, optional
        Writes a copy of the robot's own file with the identified parameters (result, file, folder).
    simulates : bool
        Whether a simulator reads it, so that models can be drawn.
    floating : bool
        Whether it holds parameters alone, so that the robot's base may float.
    """

    write: Callable[[Result, Path], Exported]
    into: Callable[[Result, Path, Path], Exported] | None = None
    simulates: bool = False
    floating: bool = False


def refuse_unknown(kind: str, kinds: Collection[str]) -> None:
    """Refuse a ``kind`` that is not among ``kinds``."""
    if kind not in kinds:
        close = get_close_matches(kind, kinds, n=1)
        hint = f"did you mean '{close[0]}'?" if close else f"choose from {', '.join(kinds)}."
        raise GtauError(f"there is no export to '{kind}'; {hint}")


def digits(values: Any) -> str:
    """Write numbers with round-trip precision."""
    numbers = [float(value) for value in np.atleast_1d(values)]
    return " ".join(repr(number) if number != int(number) else f"{number:.0f}" for number in numbers)


def xml_text(root: Element) -> str:
    """Write an XML element, indented."""
    indent(root)
    return tostring(root, encoding="unicode") + "\n"


def written(out: Path, texts: Mapping[str, str | bytes]) -> tuple[Path, ...]:
    """Write files by name into the folder ``out``, each atomically; raises GtauError where that fails."""
    folder = folder_of(out)
    for name, text in texts.items():
        write_atomically(folder / name, text)
    return tuple(folder / name for name in texts)

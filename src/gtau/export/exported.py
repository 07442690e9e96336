"""Kinds of export, named in the constant ``EXPORTS`` of the modules of this folder or by entry points."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from xml.etree.ElementTree import Element, indent, tostring

import numpy as np

from gtau.documents.files import folder_of, refuse_as_folder, write_atomically
from gtau.documents.validation import PATH, TEXT, WHOLE, takes
from gtau.errors import GtauError, meant
from gtau.estimation.results.model_file import load
from gtau.estimation.results.result import IdentifiedModel
from gtau.extensions import find, homes, names
from gtau.robots.geometry import refuse_floating
from gtau.uses.prediction import doubts

HOME = ("gtau.exports", "gtau.export")  # group of entry points, and the package of the built-in kinds
MODELS = 16  # default number of draws written as models


@dataclass(frozen=True, repr=False)
class Exported:
    """Files written, notes on what the target cannot express, and figures by name (``rms_percent_11``).

    ``lost``, also the first note, says what part of the robot the files lack; it is shown before all else.
    """

    files: tuple[Path, ...]
    notes: tuple[str, ...] = ()
    figures: Mapping[str, float] = field(default_factory=dict)
    lost: str = ""

    def __repr__(self) -> str:
        notes = "".join(f"; {note}" for note in self.notes)
        return f"Exported({', '.join(map(str, self.files))}{notes})"


@dataclass(frozen=True)
class Export:
    """A kind of export: ``write`` writes a result into a folder.

    ``into``, if any, writes a copy of the robot's own file with the identified parameters (result, file, folder).
    ``simulates`` says whether a simulator reads it, so that models can be drawn, and ``floating`` whether the robot's
    base may float, because it holds parameters only.
    """

    write: Callable[[IdentifiedModel, Path], Exported]
    into: Callable[[IdentifiedModel, Path, Path], Exported] | None = None
    simulates: bool = False
    floating: bool = False


def refuse_unknown(kind: str, kinds: Collection[str]) -> None:
    """Refuse an unknown ``kind``."""
    if kind not in kinds:
        hint = meant(kind, kinds, f"choose from {', '.join(kinds)}.")
        raise GtauError(f"there is no export to '{kind}'; {hint}")


def digits(values: Any) -> str:
    """Write numbers with round-trip precision."""
    numbers = [float(value) for value in np.atleast_1d(values)]
    return " ".join(repr(number) if number != int(number) else f"{number:.0f}" for number in numbers)


def xml_text(root: Element) -> str:
    """Write an XML element, indented."""
    indent(root)
    return tostring(root, encoding="unicode") + "\n"


def written(out: Path, texts: Mapping[str, str | bytes] | Mapping[Path, bytes]) -> tuple[Path, ...]:
    """Write files by name into the folder ``out``, each atomically; raises GtauError where that fails."""
    files = {out / name: text for name, text in texts.items()}
    for path, text in files.items():
        write_atomically(folder_of(path.parent) / path.name, text)
    return tuple(files)


@takes(
    model=("a result or the path of its file", (IdentifiedModel, str, Path)),
    kind=TEXT,
    out=PATH,
    into=PATH,
    samples=WHOLE,
    models=WHOLE,
    seed=WHOLE,
)
def export_model(
    model: IdentifiedModel | str | Path,
    kind: str,
    out: str | Path,
    into: str | Path | None = None,
    samples: int = 0,
    models: int = MODELS,
    seed: int = 0,
) -> Exported:
    """Export an identified model for a controller, simulator or paper.

    Parameters
    ----------
    model : IdentifiedModel or path
        A result, or its ``model.json``.
    kind : str
        One of the kinds that ``gtau export --help`` lists, ``c`` for instance.
    out : path
        Folder of the files.
    into : path, optional
        For the kinds ``urdf`` and ``mjcf``: the robot's own file; a copy with the identified parameters, otherwise
        unchanged, is written into another folder.
    samples : int
        Number of models to draw as well, see :func:`gtau.export.samples.draw`: ``samples.npz``, and
        for the kinds that simulate the first ``models`` of them, each in a folder of its own (``samples/0000``).
    models, seed : int
        Number of draws written as models, and the seed of the draws.

    Returns
    -------
    Exported
        Files written, and notes on what the target cannot express.

    Raises
    ------
    GtauError
        If the model lacks what the kind needs, or the files cannot be written; existing files are then unchanged.

    Examples
    --------
    >>> [file.name for file in gtau.export_model("result/model.json", "csv", "exported").files]
    ['five_bar.csv']
    """
    refuse_unknown(kind, names(*HOME))
    refuse_as_folder(out)
    export: Export = find(*HOME, kind, Export)
    result = model if isinstance(model, IdentifiedModel) else load(model)
    if not export.floating:
        refuse_floating(result.robot, f"export to '{kind}' is")
    if into is not None and export.into is None:
        raise GtauError(f"--into puts a model back into a URDF or MJCF file, not into '{kind}'; leave it out.")
    if samples and not export.simulates:
        simulated = ", ".join(name for name in homes(*HOME) if find(*HOME, name, Export).simulates)
        raise GtauError(f"draws are models for simulators ({simulated}), not for '{kind}'; leave out --samples.")
    if into is not None and (Path(out) / Path(into).name).resolve() == Path(into).resolve():
        raise GtauError(f"{into} would be overwritten; choose another folder for --out.")

    def write(model: IdentifiedModel, folder: Path) -> Exported:
        if into is None or export.into is None:
            return export.write(model, folder)
        return export.into(model, Path(into), folder)

    with TemporaryDirectory() as name:  # so that a refused export leaves nothing
        made = Path(name)
        exported = write(result, made)
        files = [*exported.files]
        if samples:
            drawn = import_module("gtau.export.samples").draw(result, samples, seed)
            files += written(made, {"samples.npz": drawn.npz()})
            for number, model_drawn in zip(range(models), drawn.results(), strict=False):
                files += write(model_drawn, made / "samples" / f"{number:04d}").files
            figures = {**exported.figures, "moved_share": drawn.moved_share}
            exported = replace(exported, notes=(*exported.notes, drawn.note), figures=figures)
        texts = {file.relative_to(made): file.read_bytes() for file in files}
    return replace(exported, files=written(Path(out), texts), notes=(*doubts(result), *exported.notes))

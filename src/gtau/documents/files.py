"""Finding files, reading those of a sane size, and writing them so that they are either whole or not there."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterable
from glob import glob
from pathlib import Path

from gtau.errors import GtauError


def write_atomically(path: str | Path, content: str | bytes) -> None:
    """Write ``content`` (text as UTF-8) to ``path``; an interruption leaves the old file, or none.

    Raises
    ------
    GtauError
        Where the folder does not exist or cannot be written to.
    """
    path = Path(path)
    data = content.encode() if isinstance(content, str) else content
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(data)
            os.chmod(name, 0o644)
            os.replace(name, path)
        except BaseException:
            os.unlink(name)
            raise
    except OSError as error:
        raise GtauError(
            f"{path} cannot be written ({error.strerror}); choose another folder or free some space."
        ) from None


def refuse_as_folder(path: str | Path | None) -> None:
    """Refuse a path, unless None, at which :func:`folder_of` could not make a folder, before hours of work; GtauError.

    Nothing is made yet, so that what is refused or interrupted leaves no empty folder.
    """
    if path is None:
        return
    try:
        existing = next(each for each in (Path(path), *Path(path).absolute().parents) if each.exists())
    except OSError as error:  # such as a name that is too long
        raise GtauError(f"{path} cannot be the output folder ({error.strerror}); choose another one.") from None
    if not existing.is_dir():
        raise GtauError(f"{path} cannot be the output folder, as {existing.name} is a file; choose another one.")
    if not os.access(existing, os.W_OK):
        raise GtauError(f"{path} cannot be the output folder, as {existing} is write-protected; choose another one.")


def folder_of(path: str | Path) -> Path:
    """Make a folder where it is missing, and return it; raises GtauError."""
    path = Path(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise GtauError(f"the folder {path} cannot be made ({error.strerror}); choose another one.") from None
    return path


def read_at_most(size: int, path: Path, larger: str) -> bytes:
    """Read a file of at most ``size`` bytes, so that a wrong path costs neither time nor memory.

    Raises
    ------
    GtauError
        Where the file cannot be read, or with the sentence ``larger`` where it is longer. The caller names the file.
    """
    try:
        with path.open("rb") as file:
            content = file.read(size + 1)
    except OSError as error:
        raise GtauError(
            f"the file cannot be read ({(error.strerror or str(error)).lower()}); check the path."
        ) from None
    if len(content) > size:
        raise GtauError(larger)
    return content


def in_order(paths: Iterable[Path]) -> list[Path]:
    """Sort paths as people number them: ``part_2`` before ``part_10``."""

    def key(path: Path) -> list[tuple[bool, int, str]]:
        return [(not number, int(number or 0), text) for number, text in re.findall(r"(\d+)|(\D+)", str(path))]

    return sorted(paths, key=key)


def matching(pattern: Path) -> list[Path]:
    """List the path itself if it exists, else what it matches as a pattern with ``*``, ``?``, ``[]`` or ``**``."""
    if pattern.exists():
        return [pattern]
    return in_order(Path(each) for each in glob(str(pattern), recursive=True))

"""Find, recognise and read files of bounded size, and write them atomically."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from glob import glob
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gtau.errors import GtauError, unreadable

if TYPE_CHECKING:
    import polars as pl

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

LONGEST = 40  # characters of an identifier: with a suffix it is shorter than MATLAB's 63
FORMULA = r"^(\s*[=+\-@])"  # beginning of a cell that spreadsheets evaluate


def write_atomically(path: str | Path, content: str | bytes) -> None:
    """Write ``content`` (text as UTF-8) to ``path``; an interruption leaves the old file, or none; raises GtauError."""
    path = Path(path)
    data = content.encode() if isinstance(content, str) else content
    unfinished = path.with_name(f".{path.name}.{os.urandom(4).hex()}")  # known before it exists, for its removal
    try:
        with unfinished.open("xb") as file:
            file.write(data)
        unfinished.chmod(0o644)
        unfinished.replace(path)
    except BaseException as error:
        with suppress(OSError):
            unfinished.unlink()
        if not isinstance(error, OSError):
            raise
        lacks_folder = isinstance(error, FileNotFoundError)
        advice = "make its folder" if lacks_folder else "choose another folder or free some space"
        raise GtauError(f"{path} cannot be written ({error.strerror}); {advice}.") from None


def in_csv(table: pl.DataFrame) -> str:
    """Write a table as CSV; an apostrophe before ``= + - @`` keeps spreadsheets from evaluating texts."""
    import polars as pl

    texts = table.with_columns(pl.col(pl.String).str.replace(FORMULA, "'$1"))
    odd = any(character in name for name in table.columns for character in ';\t"')  # possible separators of columns
    return texts.write_csv(quote_style="non_numeric" if odd else "necessary")


def write_table(table: pl.DataFrame, path: str | Path) -> None:
    """Write a table atomically, as Parquet if the path ends in ``.parquet``, otherwise as CSV; raises GtauError."""
    if Path(path).suffix.lower() != ".parquet":
        write_atomically(path, in_csv(table))
        return
    content = BytesIO()
    table.write_parquet(content)
    write_atomically(path, content.getvalue())


def refuse_as_folder(path: str | Path | None) -> None:
    """Refuse a path, unless None, at which :func:`folder_of` would fail, before hours of work; raises GtauError."""
    if path is None:
        return
    why = ""
    try:
        _refuse_detour(Path(path))
        existing = next(place for place in (Path(path), *Path(path).absolute().parents) if place.exists())
        if not existing.is_dir():
            why = f", because {existing.name} is a file"
        elif not os.access(existing, os.W_OK):
            why = f", because {existing} is write-protected"
    except OSError as error:  # such as a name that is too long
        why = f" ({error.strerror})"
    if why:
        raise GtauError(f"{path} cannot be the output folder{why}; choose another one.")


def hold_folder(path: str | Path) -> Callable[[], None]:
    """Make a folder, and keep other commands from writing to it; raises GtauError.

    The returned function ends this, and removes the new folders that are still empty.
    """
    refuse_as_folder(path)
    made = [place for place in (Path(path), *Path(path).parents) if not place.exists()]
    handle = None
    if fcntl is not None:
        handle = os.open(folder_of(path), os.O_RDONLY)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            raise GtauError(f"another command is writing to {path}; wait for its end, or choose another one.") from None
        except OSError:  # a file system without locks
            pass

    def release() -> None:
        if handle is not None:
            os.close(handle)
        with suppress(OSError):
            for place in made:
                place.rmdir()

    return release


def folder_of(path: str | Path) -> Path:
    """Make a folder where it is missing, and return it; raises GtauError."""
    path = Path(path)
    try:
        _refuse_detour(path)
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise GtauError(f"the folder {path} cannot be made ({error.strerror}); choose another one.") from None
    return path


def _refuse_detour(path: Path) -> None:
    """Refuse a path through a missing folder, which would be made in vain; raises GtauError."""
    for place in (p for p in reversed((path, *path.parents)) if p.name == ".." and not p.parent.exists()):
        raise GtauError(f"{path} leads through {place.parent}, which does not exist; write {os.path.normpath(path)}.")


def beside(folder: Path, path: str | Path) -> Path:
    """Resolve a path stated by a file in ``folder``, with ``a/../b`` shortened to ``b`` unless ``a`` is a link."""
    joined = folder / path
    short = Path(os.path.normpath(joined))
    return short if not joined.exists() or (short.exists() and short.samefile(joined)) else joined


def regular(path: Path) -> Path:
    """Return a path that is not a device or pipe, whose reading might never end; raises OSError otherwise."""
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise OSError(errno.EINVAL, NO_FILE)
    return path


NO_FILE = "is a device or a pipe, not a file"


@contextmanager
def system_refusals(path: Path, advice: str = "check the path") -> Iterator[None]:
    """Turn errors of the system while reading a file into a GtauError."""
    try:
        regular(path)
        yield
    except GtauError:
        raise
    except OSError as error:
        why = (error.strerror or str(error)).lower()
        what = f"{path} {NO_FILE}" if why == NO_FILE else f"{path} cannot be read: {why}"
        raise unreadable(f"{what}; {advice}.", error) from None


def read_at_most(size: int, path: Path, larger: str) -> bytes:
    """Read a file of at most ``size`` bytes; raises GtauError, with the message ``larger`` if it is longer."""
    try:
        with regular(path).open("rb") as file:
            content = file.read(size + 1)
    except OSError as error:
        why = (error.strerror or str(error)).lower()
        raise unreadable(f"the file cannot be read ({why}); check the path.", error) from None
    if len(content) > size:
        raise GtauError(larger)
    return content


def json_in(text: str, **options: Any) -> Any:
    """Read JSON; raises ValueError if it is invalid or nested too deep."""
    try:
        return json.loads(text, **options)
    except RecursionError:
        raise ValueError("nested too deep") from None


def in_order(paths: Iterable[Path]) -> list[Path]:
    """Sort paths in natural order: ``part_2`` before ``part_10``."""

    def key(path: Path) -> list[tuple[bool, int, str]]:
        return [(not number, int(number or 0), text) for number, text in re.findall(r"(\d+)|(\D+)", str(path))]

    return sorted(paths, key=key)


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a file, or of the paths and contents of the files in a folder; raises GtauError."""
    if path.is_dir():
        parts = in_order(filter(Path.is_file, path.rglob("*")))
        text = "".join(f"{part.relative_to(path)}\0{digest_of(part)}" for part in parts)
        return hashlib.sha256(text.encode(errors="surrogateescape")).hexdigest()
    with system_refusals(path), path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def identifier(name: str) -> str:
    """Make a name that C, MATLAB, Python and file systems accept: ``five-bar`` becomes ``five_bar``."""
    plain = _word(name.lower())
    return (plain if re.match(r"[a-z]", plain) else f"robot_{plain}")[:LONGEST]


def suffixes(names: Iterable[str]) -> dict[str, str]:
    """Make names unique suffixes of identifiers: ``a-b`` and ``a_b`` become ``a_b`` and ``a_b_2``."""
    unique: dict[str, str] = {}
    for name in names:
        plain, number = _word(name)[:LONGEST], 1
        while (made := plain if number == 1 else f"{plain}_{number}") in unique.values():
            number += 1
        unique[name] = made
    return unique


def _word(name: str) -> str:
    return re.sub(r"\W", "_", name, flags=re.ASCII)


def matching(pattern: Path) -> list[Path]:
    """List the path itself if it exists, else its matches as a pattern with ``*``, ``?``, ``[]`` or ``**``."""
    if pattern.exists():
        return [pattern]
    return in_order(Path(name) for name in glob(str(pattern), recursive=True))


HEAD = 1 << 16  # bytes that are inspected
LOG_LINES = 40  # lines of numbers that make a table a log; tables of MDH parameters have one line per joint
MODEL, DESIGNED = "a model that 'gtau identify' wrote", "a design that 'gtau excite' wrote"
EXPERIMENT, SIMULATION, DESIGN, FLEET = "an experiment file", "a simulation file", "a design file", "a fleet file"
ROBOT, LOG, FOLDER, PICTURE = "a robot file", "a log", "a folder", "a picture"
BINARY = "a binary file of another program"
USES = {
    MODEL: "use it with 'gtau validate MODEL.json EXPERIMENT.yaml' or 'gtau payload MODEL.json EXPERIMENT.yaml'",
    EXPERIMENT: "use it with 'gtau check', 'gtau identify' or 'gtau compare'",
    SIMULATION: "use it with 'gtau simulate'",
    DESIGN: "use it with 'gtau excite'",
    FLEET: "use it with 'gtau fleet'",
    ROBOT: "use it with 'gtau robot', or name it under 'robot' in an experiment file",
    LOG: "name it under 'runs' in an experiment file",
    DESIGNED: "the robot follows the trajectory beside it",
    FOLDER: "give the file itself",
    PICTURE: "give another file",
    BINARY: "export its content as CSV, Parquet, NPZ, MAT or HDF5",
}
"""Use of each kind of file."""
CONVERSIONS = {
    **dict.fromkeys((".zip", ".bz2", ".xz", ".zst", ".7z", ".rar", ".tar", ".tgz"), "unpack it and give its content"),
    **dict.fromkeys((".xlsx", ".xls", ".ods"), "export its table as CSV"),
    **dict.fromkeys((".mf4", ".mdf", ".ulg", ".blf", ".dat"), "export its signals as CSV or MAT"),
}
"""Conversions of files of other programs, by their endings."""
_KEYS = (
    (EXPERIMENT, {"signals"}),
    (FLEET, {"experiments", "folders"}),
    (ROBOT, {"joints", "closed_loop", "name_mot"}),
    (DESIGN, {"period", "harmonics", "repetitions", "prior", "limits", "space"}),
    (SIMULATION, {"drives"}),
)
"""Keys that only one kind of YAML file has; the first match counts."""


def kind_of(path: str | Path) -> str | None:
    """Recognise a file by its content; None if it is unknown or unreadable."""
    path = Path(path)
    try:
        if path.is_dir():
            return FOLDER
        with regular(path).open("rb") as file:
            head = file.read(HEAD)
    except OSError:
        return None
    if head.startswith((b"\x89PNG", b"\xff\xd8\xff", b"GIF8", b"%PDF")):
        return PICTURE
    if head.startswith(b"PAR1"):
        return LOG
    if b"\x00" in head and not head.startswith((b"\xff\xfe", b"\xfe\xff")):  # UTF-16 has zeros too
        return BINARY
    text = head.decode("utf-8-sig", errors="replace").lstrip()
    if text.startswith("{"):
        schema = re.search(r'"schema"\s*:\s*"gtau-(\w+)/', text)
        return {"model": MODEL, "design": DESIGNED}.get(schema[1]) if schema else None
    if text.startswith("<"):
        return ROBOT if re.search(r"<(robot|mujoco)\b", text) else None
    lines = text.splitlines()[1:-1]  # without the header and a truncated last line
    numbers = 0
    for line in lines[:LOG_LINES]:
        with suppress(ValueError):
            numbers += len([float(field) for field in re.split(r"[,;\t ]+", line.strip()) if field]) > 1
    if len(lines) >= LOG_LINES and numbers >= 0.9 * LOG_LINES:
        return LOG
    keys = {match[2] for match in re.finditer(r"^([\"']?)([A-Za-z_]\w*)\1[ \t]*:(?:\s|$)", text, re.MULTILINE)}
    return next((kind for kind, unique in _KEYS if keys & unique), None)


def refuse_other_kind(path: str | Path, wanted: str) -> None:
    """Refuse a file recognised as another kind, and name the command that accepts it; raises GtauError."""
    kind = kind_of(path)
    if kind is None or kind == wanted:
        return
    advice = CONVERSIONS.get(Path(path).suffix.lower(), USES[kind]) if kind == BINARY else USES[kind]
    if (kind, wanted) == (LOG, MODEL):
        advice = "give the MODEL.json first, then the logs"
    if kind == FOLDER:
        inside = sorted(file for file in Path(path).glob("*") if file.is_file() and kind_of(file) == wanted)
        advice += f", such as {inside[0]}" if inside else ""
    raise GtauError(f"{path} is {kind}, not {wanted}; {advice}.")

"""Provenance of a report: command, hashes of its inputs, versions, settings, run time."""

from __future__ import annotations

import hashlib
import platform
import shlex
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from gtau.report.page import Column, Facts, Kind, Page, Section, Text, section, table

PACKAGES = ("numpy", "scipy", "polars", "casadi", "numba", "clarabel", "mujoco")
LISTED = 12  # inputs that are shown unfolded
LARGEST = 1 << 31  # bytes of an input that is hashed


@dataclass(frozen=True)
class Provenance:
    """What a report was made from.

    ``inputs`` are files, by what they are for; ``settings`` values by name; ``seconds`` the time that the work took;
    ``made`` is the time of day.
    """

    command: str
    inputs: tuple[tuple[str, Path], ...] = ()
    settings: Mapping[str, str] = field(default_factory=dict)
    seconds: float | None = None
    made: str = field(default_factory=lambda: datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z"))


def command_line() -> str:
    """Reconstruct the command that runs now, as it can be typed again."""
    return shlex.join(["gtau", *sys.argv[1:]])


def stamped(page: Page, of: Provenance) -> Page:
    """Add to a page when and by which version it was made, on top, and at its end what from."""
    from gtau import __version__

    lead = (*page.lead, f"Made on {of.made} by gtau {__version__}.")
    return replace(page, sections=(*page.sections, _section(of)), lead=lead)


def _section(of: Provenance) -> Section:
    made = {"made on": of.made}
    made |= {} if of.seconds is None else {"time taken": f"{of.seconds:.1f} s"}
    rows = [(what, str(path), *fingerprint(path)) for what, path in of.inputs]
    columns = [
        Column("input"),
        Column("file"),
        Column("size"),
        Column("SHA-256", Kind.NAME),
    ]
    command = section("The command that reproduces this report", Text(of.command, style="command"))
    inputs = f"Inputs: {len(rows)} files with their hashes"
    return section(
        "Provenance",
        command if of.command else None,
        Facts(made | versions()),
        section("Settings", Facts(of.settings)) if of.settings else None,
        section(inputs, table(columns, rows), folded=len(rows) > LISTED) if rows else None,
        id="provenance",
    )


def versions() -> dict[str, str]:
    """List versions of gtau, Python and the packages that compute."""
    from gtau import __version__

    found = {"gtau": __version__, "Python": f"{platform.python_version()}, {platform.system()} {platform.machine()}"}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def fingerprint(path: Path) -> tuple[str, str]:
    """Return size in words and SHA-256 of a file; of a folder those of its files, of a missing file that it is."""
    if path.is_dir():
        parts = sorted(each for each in path.iterdir() if each.is_file())
        return f"{len(parts)} files", _digest(parts)
    if not path.is_file():
        return "–", "no longer exists"
    return _size(path.stat().st_size), _digest([path])


def _digest(paths: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for path in paths:
        if path.stat().st_size > LARGEST:
            return f"not computed: larger than {_size(LARGEST)}"
        with path.open("rb") as file:
            while part := file.read(1 << 20):
                digest.update(part)
    return digest.hexdigest()


def _size(size: int) -> str:
    for unit in ("B", "kB", "MB"):
        if size < 1000:
            return f"{size:.3g} {unit}"
        size /= 1000  # type: ignore[assignment]
    return f"{size:.3g} GB"

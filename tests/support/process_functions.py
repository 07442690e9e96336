"""Functions of an item for other processes, in a module that is quick to import."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

from gtau.errors import GtauError


def square(x: int) -> int:
    return x * x


def fragile(x: int) -> int:
    """Kills its process at 3."""
    if x == 3:
        os._exit(1)
    return x * x


def refusing(x: int) -> int:
    if x == 3:
        raise GtauError("no three.")
    return x * x


def limits(_: int) -> str:
    return os.environ["GTAU_THREADS"]


def slow(path: Path) -> None:
    """Work for longer than any test lasts."""
    path.touch()
    time.sleep(600)


def held(path: Path) -> None:
    """Work until there is a file ``go`` beside the path; the item called ``first`` at once."""
    path.touch()
    while path.name != "first" and not (path.parent / "go").exists():
        time.sleep(0.01)


def slow_square(x: int) -> int:
    """Slow enough that a worker is killed in the middle."""
    time.sleep(0.1)
    return x * x


def slow_member(method: str, item: tuple[Any, str]) -> None:
    """Identify a robot of a fleet for longer than any test lasts; its process is noted beside the experiment."""
    (item[0].experiment.parent / f"{os.getpid()}.begun").touch()
    time.sleep(600)

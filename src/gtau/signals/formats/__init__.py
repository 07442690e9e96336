"""Log formats, by family. A new one is a module here, or a function of its family, and a line in ``READERS``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from gtau.signals.formats.arrays import open_hdf5, open_mat, open_npz
from gtau.signals.formats.columnar import INFO, open_feather, open_parquet
from gtau.signals.formats.rosbag import open_rosbag
from gtau.signals.formats.table import Table
from gtau.signals.formats.text import open_text

READERS: Mapping[str, Callable[[Path], Table]] = {
    ".parquet": open_parquet,
    ".feather": open_feather,
    ".arrow": open_feather,
    ".npz": open_npz,
    ".mat": open_mat,
    ".h5": open_hdf5,
    ".hdf5": open_hdf5,
    ".db3": open_rosbag,
    ".mcap": open_rosbag,
    ".bag": open_rosbag,
}
"""By the ending of the file's name; anything else is text."""


def open_table(path: Path) -> Table:
    """Find the columns of a log, whatever its format; raises GtauError and OSError."""
    if path.is_dir():
        return open_rosbag(path) if (path / "metadata.yaml").is_file() else open_parquet(path)
    path.open("rb").close()  # the system's reason, not a library's, where there is no such file
    return READERS.get(path.suffix.lower(), open_text)(path)


def is_log_folder(path: Path) -> bool:
    """Decide whether a folder is one log: a rosbag2, Parquet files, or a LeRobot data set."""
    return any((path / each).is_file() for each in ("metadata.yaml", INFO)) or any(path.glob("*.parquet"))


def is_rosbag(path: Path) -> bool:
    """Decide by its name whether a path is a bag."""
    return (path / "metadata.yaml").is_file() or READERS.get(path.suffix.lower()) is open_rosbag

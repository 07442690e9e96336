"""Writing files so that they are either whole or not there."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from idim.errors import IdimError


def write_atomically(path: str | Path, content: str | bytes) -> None:
    """Write ``content`` (text as UTF-8) to ``path``; an interruption leaves the old file, or none.

    Raises
    ------
    IdimError
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
        raise IdimError(
            f"{path} cannot be written ({error.strerror}); choose another folder or free some space."
        ) from None

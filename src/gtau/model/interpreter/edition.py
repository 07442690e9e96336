"""The edition of the compiled functions: part of their names in the cache of Numba, new with every change of source."""

import os
from hashlib import sha256
from pathlib import Path

_HERE = Path(__file__).parent
EDITION = sha256(b"".join(path.read_bytes() for path in sorted(_HERE.glob("*.py")))).hexdigest()[:12]


def is_compiled() -> bool:
    """Return whether this edition's interpreter has been compiled on this machine before; imports nothing heavy."""
    pattern = f"*.interpret_{EDITION}-*.nbi"  # the last function that is compiled
    elsewhere = os.environ.get("NUMBA_CACHE_DIR")
    try:
        if elsewhere:
            return any(Path(elsewhere).rglob(pattern))
        return any((_HERE / "__pycache__").glob(pattern)) or any(_own_cache().rglob(pattern))
    except (OSError, RuntimeError):  # the home is another user's, or there is none
        return False


def _own_cache() -> Path:
    """Return where Numba caches for a package in a folder that this user cannot write to."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "numba"

"""The C compiler that tests of exported code use."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

GCC = shutil.which("gcc")
FLAGS = ("-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Werror")
SANITIZERS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")
MISSING = "gcc is not installed (Debian: apt install gcc)"
needs_gcc = pytest.mark.skipif(GCC is None, reason=MISSING)


def sanitizing(folder: Path) -> str:
    """A compiler with sanitizers, tried out in a folder; skips the test where there is none."""
    if GCC is None:
        pytest.skip(MISSING)
    (folder / "empty.c").write_text("int main(void) { return 0; }\n")
    program = folder / "empty"
    made = subprocess.run([GCC, *SANITIZERS, "-o", program, folder / "empty.c"], capture_output=True, text=True)
    if made.returncode or subprocess.run([program], capture_output=True).returncode:
        pytest.skip("gcc compiles without its sanitizers here (Debian: apt install libasan8 libubsan1)")
    return GCC

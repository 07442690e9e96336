"""The C code of a result, compiled and called."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from gtau.estimation.results.result import Result
from gtau.export.c import export
from gtau.export.identified import functions, identified

GCC = shutil.which("gcc")
needs_gcc = pytest.mark.skipif(GCC is None, reason="gcc is not installed (Debian: apt install gcc)")
SANITIZERS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")
FLAGS = ("-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Werror")


def sanitizing(folder: Path) -> str:
    """A compiler with sanitizers, tried out in a folder; skips the test where there is none."""
    if GCC is None:
        pytest.skip("gcc is not installed (Debian: apt install gcc)")
    (folder / "empty.c").write_text("int main(void) { return 0; }\n")
    program = folder / "empty"
    made = subprocess.run([GCC, *SANITIZERS, "-o", program, folder / "empty.c"], capture_output=True, text=True)
    if made.returncode or subprocess.run([program], capture_output=True).returncode:
        pytest.skip("gcc compiles without its sanitizers here (Debian: apt install libasan8 libubsan1)")
    return GCC


class Compiled:
    """The exported code of a result as a shared library."""

    def __init__(self, result: Result, folder: Path) -> None:
        self.model = identified(result)
        export(result, folder)
        name = self.model.name
        sources = [str(folder / f"{name}.c"), str(folder / f"{name}_controller.c")]
        library = folder / f"lib{name}.so"
        subprocess.run([GCC, *FLAGS, "-O0", "-shared", "-fPIC", "-o", library, *sources, "-lm"], check=True)
        self.library, self.n, self.n_p = ctypes.CDLL(str(library)), len(self.model.joints), len(self.model.parameters)
        self.pose = np.zeros(len(functions(self.model).home))

    def __call__(self, function: str, *arrays: np.ndarray, size: int = 0) -> np.ndarray | int:
        """Call a function with the pose and arrays; an output of ``size`` numbers, or else its status."""
        out = np.full(size, np.nan)
        inputs = [np.ascontiguousarray(array, dtype=float) for array in (self.pose, *arrays)]
        inputs[0] = self.pose
        inputs += [out] if size else []
        entry = getattr(self.library, f"{self.model.name}_{function}")
        status = entry(*(array.ctypes.data_as(ctypes.c_void_p) for array in inputs))
        return out if size else status

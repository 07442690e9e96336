"""The C code of a result, compiled and called."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from gtau.export.generated import export_c as export
from gtau.result import Result
from gtau.uses.identified import functions, identified

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


class Controller:
    """The exported controller of compiled code, at 1 kHz."""

    def __init__(
        self,
        c: Compiled,
        q: np.ndarray,
        bandwidth: float = 100.0,
        limit: float = 20.0,
        velocity: float = 5.0,
        following: float = 0.1,
    ) -> None:
        number, self._array = ctypes.c_double, ctypes.c_double * c.n

        class Configuration(ctypes.Structure):
            _fields_ = (
                ("period", number),
                ("bandwidth", number),
                ("limit", self._array),
                ("velocity", self._array),
                ("following", self._array),
                ("hold", ctypes.c_int),
            )

        every = (self._array(*[value] * c.n) for value in (limit, velocity, following))
        configuration = Configuration(1e-3, bandwidth, *every, 0)
        self._memory, self._out = ctypes.create_string_buffer(1 << 13), self._array()
        self._cycle = getattr(c.library, f"{c.model.name}_controller_cycle")
        self._parameters = (number * c.n_p)(*c.model.values)
        start = getattr(c.library, f"{c.model.name}_controller_start")
        assert start(self._memory, ctypes.byref(configuration), self._array(*q)) == 0

    def __call__(self, q_r: np.ndarray, qd_r: np.ndarray, qdd_r: np.ndarray, q: np.ndarray) -> tuple[int, np.ndarray]:
        """Run a cycle: status and currents."""
        inputs = (self._array(*values) for values in (q_r, qd_r, qdd_r, q))
        status = self._cycle(self._memory, ctypes.c_double(1e-3), *inputs, self._parameters, self._out)
        return status, np.array(self._out)

"""Evaluate CasADi functions for many samples, shared among threads: a small batched interpreter.

A symbolic function becomes a list of instructions on rows. An instruction is carried out for LANES samples before the
next, so that these samples share the interpreter's own cost and the rows stay in the cache. The same compiled loops
(:mod:`gtau.model.interpreter.kernel`) serve all robots.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache

import casadi as ca
import numpy as np
from threadpoolctl import threadpool_limits

from gtau.model.interpreter.instructions import instructions

LANES = 200  # samples: 200 and 264 are fastest of 72 to 520 on four robots; rows of a power of two thrash the cache
SHARE = 1024  # samples a thread at least
NONE = np.zeros(0)


@dataclass(frozen=True, eq=False)
class Program:
    """Instructions of a function from a vector to a vector.

    ``code`` is (instructions, 10): operation, row of the result, output that the result is, or NOWHERE, and rows of up
    to seven operands; ``signs`` (instructions, 4) are the signs of a sum's terms and products. The rows are first the
    inputs, then the ``constants``, the ``parameters`` and the registers. ``fixed`` are the outputs that are constants,
    and their values: no instruction writes them.
    """

    code: np.ndarray
    signs: np.ndarray
    constants: np.ndarray
    parameters: int
    registers: int
    inputs: int
    outputs: int
    fixed: tuple[np.ndarray, np.ndarray]

    def __call__(self, *inputs: np.ndarray, parameters: np.ndarray = NONE) -> np.ndarray:
        """Evaluate samples along the last axis: (inputs, N), given in one or more arrays, to (outputs, N).

        ``parameters`` (parameters,) are common to all samples.
        """
        from gtau.model.interpreter.kernel import evaluate

        sources, samples = self._sources(inputs)
        result = self._results(samples)
        share(lambda start, stop: evaluate(*self.bound(parameters), sources, result, start, stop, start), samples)
        return result

    def fill(self, table: np.ndarray, order: np.ndarray, places: np.ndarray, *inputs: np.ndarray) -> None:
        """Put the outputs, in ``order`` (outputs,), of every sample at ``places`` (outputs,) of its row of ``table``.

        ``table`` is (N, columns), in C order, and the places rise.
        """
        from gtau.model.interpreter.kernel import evaluate, scatter

        sources, samples = self._sources(inputs)

        def work(start: int, stop: int) -> None:
            bound, made = self.bound(), self._results(LANES)  # which stay in the cache
            for first in range(start, stop, LANES):
                last = min(first + LANES, stop)
                evaluate(*bound, sources, made, first, last, 0)
                scatter(made, order, places, table, first, last - first)

        share(work, samples)

    def bound(self, parameters: np.ndarray = NONE) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return ``code``, ``signs`` and rows to work with, which hold the constants and ``parameters``."""
        if parameters.shape != (self.parameters,):
            raise ValueError(f"expected {self.parameters} parameters, got shape {parameters.shape}")
        values = np.concatenate([self.constants, parameters])
        rows = _aligned(self.inputs + len(values) + self.registers)
        rows[self.inputs : self.inputs + len(values)] = values[:, None]
        return self.code, self.signs, rows

    def _results(self, samples: int) -> np.ndarray:
        """Allocate the outputs (outputs, samples), of which the constant ones have their values."""
        results = np.empty((self.outputs, samples))
        outputs, values = self.fixed
        results[outputs] = values[:, None]
        return results

    def _sources(self, inputs: tuple[np.ndarray, ...]) -> tuple[tuple[np.ndarray, ...], int]:
        """Return the inputs as arrays, as many as the compiled loops take, and the number of samples."""
        from gtau.model.interpreter.kernel import SOURCES

        sources = [np.asarray(array, dtype=float, order="C") for array in inputs]
        samples = sources[0].shape[-1] if sources[0].ndim else 0
        if any(source.shape[1:] != (samples,) for source in sources) or sum(map(len, sources)) != self.inputs:
            shapes = ", ".join(str(source.shape) for source in sources)
            raise ValueError(f"expected inputs of shape ({self.inputs}, N), got {shapes}")
        if len(sources) > SOURCES:
            sources[SOURCES - 1 :] = [np.concatenate(sources[SOURCES - 1 :])]
        return (*sources, *[np.empty((0, samples))] * (SOURCES - len(sources))), samples


def _aligned(rows: int) -> np.ndarray:
    """Allocate rows (rows, LANES) that begin at cache lines, as whole vectors are loaded from them."""
    memory = np.empty(rows * LANES + 8)
    first = -memory.ctypes.data % 64 // 8
    return memory[first : first + rows * LANES].reshape(rows, LANES)


def compile_program(inputs: list[ca.SX], outputs: list[ca.SX], parameters: Sequence[ca.SX] = ()) -> Program:
    """Compile instructions that compute the stacked dense ``outputs`` from the stacked ``inputs``.

    Inputs are symbols, stacked column by column; of outputs all entries are, structural zeros included. ``parameters``
    are symbols with values common to all samples. The program takes (sum of the inputs' entries, N) and gives (sum of
    the outputs' entries, N). Raises ValueError on an operation that the interpreter does not support.
    """
    x, p, y = ca.veccat(*inputs), ca.veccat(*parameters), ca.densify(ca.veccat(*outputs))
    function = ca.Function("program", [ca.vertcat(x, p)], [ca.cse(y)])
    code, signs, constants, registers, fixed = instructions(function, p.numel())
    return Program(code, signs, constants, p.numel(), registers, x.numel(), y.numel(), fixed)


_inside = threading.local()


def threads() -> int:
    """Return the number of threads: ``GTAU_THREADS``, or one for each core."""
    try:
        return max(int(os.environ["GTAU_THREADS"]), 1)
    except (KeyError, ValueError):
        return _cores()


_cores = cache(lambda: os.cpu_count() or 1)


def share(work: Callable[[int, int], None], samples: int, worth: int = SHARE) -> None:
    """Call ``work(start, stop)`` for stretches that together are ``samples``.

    In threads, where each gets at least ``worth`` samples; the results do not depend on their number. Work that
    is itself done by one of them is not shared again.
    """
    parts = 1 if hasattr(_inside, "pool") else min(threads(), samples // worth)
    if parts < 2:
        work(0, samples)
        return
    cuts = [samples * k // parts // 8 * 8 for k in range(parts)] + [samples]  # at cache lines
    list(_pool(os.getpid(), parts).map(work, cuts[:-1], cuts[1:]))


@cache
def _pool(process: int, workers: int) -> ThreadPoolExecutor:
    """Return the thread pool, created once per process; a forked process needs its own."""
    return ThreadPoolExecutor(workers, "gtau", lambda: setattr(_inside, "pool", True))


@contextmanager
def single_threaded_blas() -> Iterator[None]:
    """Run BLAS and OpenMP in one thread, as a context or a decorator.

    On small matrices and busy cores, threads mainly wait for each other (a QR takes 100 times longer).
    """
    with threadpool_limits(limits=1):
        yield

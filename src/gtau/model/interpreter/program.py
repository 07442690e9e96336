"""Evaluate CasADi functions for many samples, shared among threads: a small batched interpreter.

A symbolic function is turned into a list of instructions on rows; each instruction is carried out for a
whole lane of samples before the next, so the interpreter's own cost is shared by the lane and the
registers stay in the cache. One compiled loop (:mod:`gtau.model.interpreter.compiled`) serves all robots.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache

import casadi as ca
import numpy as np
from threadpoolctl import threadpool_limits

from gtau.model.interpreter.compiled import loops
from gtau.model.interpreter.instructions import LANES, ROW, WIDE, instructions

NONE = np.zeros(0)


@dataclass(frozen=True, eq=False)
class Program:
    """Instructions of a function from a vector to a vector.

    ``code`` is (instructions, 5): operation, row of the result and rows of up to three operands. The rows
    are first the ``constants``, then the ``parameters``, the registers, the inputs and the outputs. ``fixed`` are
    the outputs that are constants, and their values: no instruction writes them.
    """

    code: np.ndarray
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
        sources, samples = self._sources(inputs)
        result = np.empty((self.outputs, sources[0].shape[1]))
        outputs, values = self.fixed
        result[outputs] = values[:, None]

        def run(start: int, stop: int) -> None:
            bound = Bound(self, _rows(sources), addresses(result), parameters)
            moved = np.empty(bound.rows.size, dtype=np.int64)
            loops().interpret(*bound.run(), bound.own, bound.rows.size, address(moved), start, stop)

        share(run, result.shape[1])
        return result[:, :samples]

    def at(self, parameters: np.ndarray) -> Program:
        """Return the program with its ``parameters`` (parameters,) fixed at these values, as constants."""
        return replace(self, constants=np.concatenate([self.constants, parameters]), parameters=0)

    def fill(self, table: np.ndarray, order: np.ndarray, places: np.ndarray, *inputs: np.ndarray) -> None:
        """Put the outputs, in ``order`` (outputs,), of every sample at ``places`` (outputs,) of its row of ``table``.

        ``table`` is (N, columns), and the places rise.
        """
        sources, samples = self._sources(inputs)
        filled = table if samples >= LANES else np.zeros((LANES, table.shape[1]))
        order, places = np.ascontiguousarray(order, np.int64), np.ascontiguousarray(places, np.int64)

        def run(start: int, stop: int) -> None:
            made = aligned(self.outputs)  # it stays in the cache
            outputs, values = self.fixed
            made[outputs] = values[:, None]
            bound = Bound(self, _rows(sources), addresses(made))
            moved = np.empty(bound.rows.size + 2 * WIDE, dtype=np.int64)
            where = address(made), address(order), address(places), order.size, address(filled), filled.strides[0]
            long = bound.own + self.inputs
            loops().scatter(*bound.run(), bound.own, long, address(moved), start, stop, *where)

        share(run, len(filled))
        if filled is not table:
            table[:, places] = filled[:samples, places]

    def _sources(self, inputs: tuple[np.ndarray, ...]) -> tuple[list[np.ndarray], int]:
        """Return the inputs, padded to a lane, and the number of samples."""
        shapes = [np.shape(array) for array in inputs]
        samples = shapes[0][-1] if shapes[0] else 0
        if any(len(shape) != 2 or shape[1] != samples for shape in shapes) or sum(s[0] for s in shapes) != self.inputs:
            raise ValueError(f"expected inputs of shape ({self.inputs}, N), got {', '.join(map(str, shapes))}")
        if samples >= LANES:
            return [_contiguous(array) for array in inputs], samples
        filled = np.zeros((self.inputs, LANES))
        filled[:, :samples] = np.concatenate(inputs)
        if samples:
            filled[:, samples:] = filled[:, samples - 1 : samples]
        return [filled], samples


class Bound:
    """A program with registers of its own and the addresses of its inputs and outputs.

    ``own`` of the addresses ``rows`` are those of ``memory`` (own, LANES): constants, parameters and registers.
    """

    def __init__(self, program: Program, inputs: np.ndarray, outputs: np.ndarray, parameters: np.ndarray = NONE):
        if parameters.shape != (program.parameters,):
            raise ValueError(f"expected {program.parameters} parameters, got shape {parameters.shape}")
        values = np.concatenate([program.constants, parameters])
        self.code = program.code
        self.own = len(values) + program.registers
        self.memory = aligned(self.own)
        self.memory[: len(values)] = values[:, None]
        self.rows = np.concatenate([addresses(self.memory), inputs, outputs])

    def run(self) -> tuple[int, int, int, int, int]:
        """Return the addresses and sizes with which the compiled loops run the program."""
        return loops().machine, address(self.code), len(self.code), address(self.rows), self.rows.size


def aligned(rows: int) -> np.ndarray:
    """Allocate rows (rows, LANES) aligned to cache lines."""
    memory = np.empty((rows + 1) * ROW)
    first = -address(memory) % 64 // 8
    return memory[first : first + rows * ROW].reshape(rows, ROW)[:, :LANES]


def address(array: np.ndarray) -> int:
    """Return the address of an array's first entry."""
    where: int = array.ctypes.data
    return where


def addresses(array: np.ndarray) -> np.ndarray:
    """Return the addresses (rows,) of the rows of an array."""
    return address(array) + array.strides[0] * np.arange(len(array))


def _rows(arrays: list[np.ndarray]) -> np.ndarray:
    return np.concatenate([addresses(array) for array in arrays])


def _contiguous(array: np.ndarray) -> np.ndarray:
    """Return the array, or a copy if need be, contiguous along the last axis."""
    array = np.asarray(array, dtype=float)
    return array if array.strides[-1] == array.itemsize else np.ascontiguousarray(array)


def compile_program(inputs: list[ca.SX], outputs: list[ca.SX], parameters: Sequence[ca.SX] = ()) -> Program:
    """Compile instructions that compute the stacked dense ``outputs`` from the stacked ``inputs``.

    Inputs are symbols, stacked column by column; of outputs all entries are, structural zeros included. ``parameters``
    are symbols with values common to all samples. The program takes (sum of the inputs' entries, N) and gives (sum of
    the outputs' entries, N). Raises ValueError on an operation that the interpreter does not support.
    """
    x, p, y = ca.veccat(*inputs), ca.veccat(*parameters), ca.densify(ca.veccat(*outputs))
    function = ca.Function("program", [ca.vertcat(x, p)], [ca.cse(y)])
    code, constants, registers, fixed = instructions(function, p.numel())
    return Program(code, constants, p.numel(), registers, x.numel(), y.numel(), fixed)


_inside = threading.local()
SHARE = 16 * LANES  # minimum number of samples per thread


def threads() -> int:
    """Return the number of threads: ``GTAU_THREADS``, or one for each core."""
    try:
        return max(int(os.environ["GTAU_THREADS"]), 1)
    except (KeyError, ValueError):
        return _cores()


_cores = cache(lambda: os.cpu_count() or 1)


def share(work: Callable[[int, int], None], samples: int, worth: int = SHARE) -> None:
    """Call ``work(start, stop)`` for stretches of whole lanes that together are ``samples``.

    In threads, where each gets at least ``worth`` samples; the results do not depend on their number. Work that
    is itself done by one of them is not shared again.
    """
    parts = 1 if hasattr(_inside, "pool") else min(threads(), samples // worth)
    if parts < 2:
        work(0, samples)
        return
    lanes = samples // LANES
    cuts = [LANES * (lanes * k // parts) for k in range(parts)] + [samples]
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

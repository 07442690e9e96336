"""CasADi functions evaluated for many samples: a small batched interpreter.

A symbolic function is turned into a list of instructions on rows; each instruction is carried out for a
whole lane of samples before the next, so the interpreter's own cost is shared by the lane and the
registers stay in the cache. One compiled loop (Numba, cached on disk) serves all robots.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from idim.model._instructions import instructions
from idim.model._interpreter import MACHINE, contract, interpret, scatter
from idim.model._lanes import LANES
from idim.model._threads import share

PAD = 8  # strides that are powers of two thrash the cache


@dataclass(frozen=True, eq=False)
class Program:
    """Instructions of a function from a vector to a vector.

    ``code`` is (instructions, 5): operation, row of the result and rows of up to three operands. The rows
    are first the ``constants``, then the registers, the inputs and the outputs. ``fixed`` are the
    outputs that are constants, and their values: no instruction writes them.
    """

    code: np.ndarray
    constants: np.ndarray
    registers: int
    inputs: int
    outputs: int
    fixed: tuple[np.ndarray, np.ndarray]

    def __call__(self, *inputs: np.ndarray) -> np.ndarray:
        """Evaluate for samples along the last axis.

        Parameters
        ----------
        *inputs : ndarray
            Arrays (., N) that together have as many rows as the program has inputs.

        Returns
        -------
        ndarray (outputs, N)
        """
        sources, samples = self._sources(inputs)
        result = np.empty((self.outputs, sources[0].shape[1]))
        outputs, values = self.fixed
        result[outputs] = values[:, None]

        def run(start: int, stop: int) -> None:
            bound = Bound(self, _rows(sources), addresses(result))
            interpret(MACHINE, bound.code, bound.rows, bound.own, len(bound.rows), start, stop)

        share(run, result.shape[1])
        return result[:, :samples]

    def sums(self, places: np.ndarray, weights: np.ndarray, count: int, *inputs: np.ndarray) -> np.ndarray:
        """Sums (count, N) of the outputs, each times its weight and in its place; the outputs stay in the cache."""
        sources, samples = self._sources(inputs)
        found = np.empty((count, sources[0].shape[1]))
        self._consumed(contract, sources, places, weights, found)
        return found[:, :samples]

    def fill(self, table: np.ndarray, places: np.ndarray, *inputs: np.ndarray) -> None:
        """Put the outputs of every sample at ``places`` (outputs,) of its row of ``table`` (N, columns)."""
        sources, samples = self._sources(inputs)
        whole = table if samples >= LANES else np.zeros((LANES, table.shape[1]))
        self._consumed(scatter, sources, places, whole)
        if whole is not table:
            table[:, places] = whole[:samples, places]

    def _consumed(self, kernel: Callable[..., None], sources: list[np.ndarray], *arguments: np.ndarray) -> None:
        """Run a kernel that uses up the outputs lane by lane."""

        def run(start: int, stop: int) -> None:
            made = aligned(self.outputs)
            outputs, values = self.fixed
            made[outputs] = values[:, None]
            bound = Bound(self, _rows(sources), addresses(made))
            kernel(MACHINE, bound.code, bound.rows, bound.own, bound.own + self.inputs, start, stop, made, *arguments)

        share(run, sources[0].shape[1])

    def _sources(self, inputs: tuple[np.ndarray, ...]) -> tuple[list[np.ndarray], int]:
        """The inputs, at least a lane of them, and the number of samples."""
        shapes = [np.shape(each) for each in inputs]
        samples = shapes[0][-1] if shapes[0] else 0
        if any(len(shape) != 2 or shape[1] != samples for shape in shapes) or sum(s[0] for s in shapes) != self.inputs:
            raise ValueError(f"expected inputs of shape ({self.inputs}, N), got {', '.join(map(str, shapes))}")
        if samples >= LANES:
            return [_contiguous(each) for each in inputs], samples
        filled = np.zeros((self.inputs, LANES))
        filled[:, :samples] = np.concatenate(inputs)
        if samples:
            filled[:, samples:] = filled[:, samples - 1 : samples]
        return [filled], samples


class Bound:
    """A program with registers of its own and the addresses of its inputs and outputs.

    ``own`` of the addresses ``rows`` are those of ``memory`` (own, LANES): constants and registers.
    """

    def __init__(self, program: Program, inputs: np.ndarray, outputs: np.ndarray):
        self.code = program.code
        self.own = len(program.constants) + program.registers
        self.memory = aligned(self.own)
        self.memory[: len(program.constants)] = program.constants[:, None]
        self.rows = np.concatenate([addresses(self.memory), inputs, outputs])


def aligned(rows: int) -> np.ndarray:
    """Rows (rows, LANES) that begin where a cache line does."""
    memory = np.empty(rows * (LANES + PAD) + PAD)
    first = -memory.ctypes.data % 64 // 8
    return memory[first : first + rows * (LANES + PAD)].reshape(rows, LANES + PAD)[:, :LANES]


def addresses(array: np.ndarray) -> np.ndarray:
    """Addresses (rows,) of the rows of an array."""
    return array.ctypes.data + array.strides[0] * np.arange(len(array))


def _rows(arrays: list[np.ndarray]) -> np.ndarray:
    return np.concatenate([addresses(each) for each in arrays])


def _contiguous(array: np.ndarray) -> np.ndarray:
    """The array, or if need be a copy, its numbers one after the other along the last axis."""
    array = np.asarray(array, dtype=float)
    return array if array.strides[-1] == array.itemsize else np.ascontiguousarray(array)


def compile_program(inputs: list[ca.SX], outputs: list[ca.SX]) -> Program:
    """Instructions that compute the stacked dense ``outputs`` from the stacked ``inputs``.

    Parameters
    ----------
    inputs : list of SX
        Symbols, stacked column by column into one input vector.
    outputs : list of SX
        Expressions; their entries, structural zeros included, are stacked column by column.
    """
    x, y = ca.veccat(*inputs), ca.densify(ca.veccat(*outputs))
    code, constants, registers, fixed = instructions(ca.Function("program", [x], [ca.cse(y)]))
    return Program(code, constants, registers, x.numel(), y.numel(), fixed)

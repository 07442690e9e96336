"""Evaluate CasADi functions for many samples, shared among threads: a small batched interpreter.

A symbolic function becomes a list of instructions on rows: sums of products, with few registers. An instruction is
carried out for LANES samples before the next, so that these samples share the interpreter's own cost and the rows stay
in the cache. The same compiled loops (:mod:`gtau.model.kernel`) serve all robots.
"""

from __future__ import annotations

import os
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from itertools import chain

import casadi as ca
import numpy as np
from threadpoolctl import threadpool_limits

LANES = 200  # samples: fastest of 72 to 520 on four robots; powers of two thrash the cache
SHARE = 1024  # samples a thread at least
NONE = np.zeros(0)

SUMS = ((1, 0), (2, 0), (0, 1), (1, 1), (0, 2), (1, 2), (0, 3), (1, 3))
"""Sums by their numbers of terms and of products; the index in this tuple is the operation code.

They have at most eight operands: LLVM compares no more of them with the result before it computes in vectors.
"""

OTHERS = ("DIV", "SQRT", "SIGN", "FABS", "FMAX", "SINE_COSINE")
"""Other operations; their codes follow the codes of sums."""

NOWHERE = 2**32 - 1
"""Output of an instruction whose result is no output."""

_SAME = {getattr(ca, f"OP_{name}"): name for name in OTHERS if hasattr(ca, f"OP_{name}")}
_SINE_OR_COSINE = (ca.OP_SIN, ca.OP_COS)
_SIGNS = {ca.OP_ASSIGN: (1.0,), ca.OP_NEG: (-1.0,), ca.OP_ADD: (1.0, 1.0), ca.OP_SUB: (1.0, -1.0)}


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
        """Evaluate samples: (inputs, N), in one or more arrays, and common ``parameters`` to (outputs, N)."""
        from gtau.model.kernel import evaluate

        sources, samples = self._sources(inputs)
        result = self._results(samples)
        share(lambda start, stop: evaluate(self.bound(parameters), sources, result, start, stop, start), samples)
        return result

    def fill(self, table: np.ndarray, order: np.ndarray, places: np.ndarray, *inputs: np.ndarray) -> None:
        """Put the outputs, in ``order``, of every sample at rising ``places`` of its row of ``table`` (N, columns)."""
        from gtau.model.kernel import evaluate, scatter

        sources, samples = self._sources(inputs)

        def work(start: int, stop: int) -> None:
            bound, made = self.bound(), self._results(LANES)  # which stay in the cache
            for first in range(start, stop, LANES):
                last = min(first + LANES, stop)
                evaluate(bound, sources, made, first, last, 0)
                scatter(made, order, places, table, first, last - first)

        share(work, samples)

    def bound(self, parameters: np.ndarray = NONE) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return ``code``, ``signs`` and rows to work with, which hold the constants and ``parameters``."""
        if parameters.shape != (self.parameters,):
            raise ValueError(f"expected {self.parameters} parameters, got shape {parameters.shape}")
        values = np.concatenate([self.constants, parameters])
        end = self.inputs + len(values)
        memory = np.empty((end + self.registers) * LANES + 8)
        first = -memory.ctypes.data % 64 // 8  # rows begin at cache lines
        rows = memory[first : len(memory) - 8 + first].reshape(-1, LANES)
        rows[self.inputs : end] = values[:, None]
        return self.code, self.signs, rows

    def _results(self, samples: int) -> np.ndarray:
        """Allocate the outputs (outputs, samples), of which the constant ones have their values."""
        results = np.empty((self.outputs, samples))
        outputs, values = self.fixed
        results[outputs] = values[:, None]
        return results

    def _sources(self, inputs: tuple[np.ndarray, ...]) -> tuple[tuple[np.ndarray, ...], int]:
        """Return the inputs as arrays, as many as the compiled loops take, and the number of samples."""
        from gtau.model.kernel import SOURCES

        sources = [np.asarray(array, dtype=float, order="C") for array in inputs]
        samples = sources[0].shape[-1] if sources[0].ndim else 0
        if any(source.shape[1:] != (samples,) for source in sources) or sum(map(len, sources)) != self.inputs:
            shapes = ", ".join(str(source.shape) for source in sources)
            raise ValueError(f"expected inputs of shape ({self.inputs}, N), got {shapes}")
        if len(sources) > SOURCES:
            sources[SOURCES - 1 :] = [np.concatenate(sources[SOURCES - 1 :])]
        return (*sources, *[np.empty((0, samples))] * (SOURCES - len(sources))), samples


def compile_program(inputs: list[ca.SX], outputs: list[ca.SX], parameters: Sequence[ca.SX] = ()) -> Program:
    """Compile instructions that compute the stacked dense ``outputs`` from the stacked ``inputs``.

    Inputs are symbols, stacked column by column; of outputs all entries are, structural zeros included. ``parameters``
    are symbols with values common to all samples. Raises ValueError on an operation that it does not support.
    """
    x, p, y = ca.veccat(*inputs), ca.veccat(*parameters), ca.densify(ca.veccat(*outputs))
    return _program(ca.Function("program", [ca.vertcat(x, p)], [ca.cse(y)]), p.numel())


@dataclass(slots=True)
class Instruction:
    """An operation on numbered values; a sum, whose ``operation`` is empty, has signed terms and products of values."""

    operation: str
    results: list[int]
    arguments: list[int] = field(default_factory=list)
    terms: list[tuple[float, int]] = field(default_factory=list)
    products: list[tuple[float, int, int]] = field(default_factory=list)

    @property
    def operands(self) -> list[int]:
        """Values that the instruction reads."""
        factors = [value for _, a, b in self.products for value in (a, b)]
        return [*self.arguments, *(value for _, value in self.terms), *factors]

    @property
    def number(self) -> int:
        """Operation code."""
        if self.operation:
            return len(SUMS) + OTHERS.index(self.operation)
        return SUMS.index((len(self.terms), len(self.products)))


def _program(function: ca.Function, parameters: int) -> Program:
    """Translate a function of one vector, whose last ``parameters`` entries are the same for all samples."""
    inputs = function.numel_in() - parameters
    listing, constants, outputs = _read(function)
    listing = _merged(listing, outputs)
    fixed = [k for k, value in enumerate(outputs) if value in constants]
    written: dict[int, int] = {}  # output of a first result
    first = {instruction.results[0] for instruction in listing}
    for k, value in enumerate(outputs):
        if value in first and value not in written:
            written[value] = k
        elif value not in constants:  # copied
            listing.append(Instruction("", [-1 - k], terms=[(1.0, value)]))
            written[-1 - k] = k
    used = sorted({value for instruction in listing for value in instruction.operands} & constants.keys())
    registers, stands = _allocated(listing)
    row = {value: value for value in range(inputs)} | {value: inputs + k for k, value in enumerate(used)}
    row |= {inputs + k: inputs + len(used) + k for k in range(parameters)}
    row |= {value: inputs + len(used) + parameters + register for value, register in stands.items()}
    code = np.zeros((len(listing), 10), dtype=np.uint32)
    signs = np.ones((len(listing), 4))
    for line, sign, instruction in zip(code, signs, listing, strict=True):
        result, *second = instruction.results  # the cosine takes the place of a second operand
        rows = [row[value] for value in (*instruction.operands, *second)]
        line[:3] = instruction.number, row[result], written.get(result, NOWHERE)
        line[3 : 3 + len(rows)] = rows
        signed = (*instruction.terms, *instruction.products)
        sign[: len(signed)] = [value for value, *_ in signed]
    values, fixed_values = ([constants[value] for value in some] for some in (used, (outputs[k] for k in fixed)))
    constant_outputs = np.array(fixed, dtype=int), np.array(fixed_values)
    return Program(code, signs, np.array(values), parameters, registers, inputs, len(outputs), constant_outputs)


def _read(function: ca.Function) -> tuple[list[Instruction], dict[int, float], list[int]]:
    """Read a function: instructions in single-assignment form, constants, and the values that are outputs."""
    listing: list[Instruction] = []
    constants: dict[int, float] = {}
    number: dict[float, int] = {}
    outputs = [0] * function.numel_out()
    held: dict[int, int] = {}  # value in each of CasADi's registers
    turned: dict[int, Instruction] = {}  # sines and cosines by angle
    fresh = iter(range(function.numel_in(), 2**31))

    def constant(x: float) -> int:
        if x not in number:
            number[x] = next(fresh)
            constants[number[x]] = x
        return number[x]

    for k in range(function.n_instructions()):
        identity = function.instruction_id(k)
        arguments = function.instruction_input(k)
        results = function.instruction_output(k)
        if identity == ca.OP_CONST:
            held[results[0]] = constant(function.instruction_constant(k))
        elif identity == ca.OP_INPUT:
            held[results[0]] = arguments[1]
        elif identity == ca.OP_OUTPUT:
            outputs[results[1]] = held[arguments[0]]
        elif identity in _SINE_OR_COSINE:
            angle = held[arguments[0]]
            if angle not in turned:
                turned[angle] = Instruction("SINE_COSINE", [next(fresh), next(fresh)], [angle])
                listing.append(turned[angle])
            held[results[0]] = turned[angle].results[_SINE_OR_COSINE.index(identity)]
        else:
            values = [held[argument] for argument in arguments]
            held[results[0]] = next(fresh)
            instruction = Instruction("", [held[results[0]]])
            if identity in _SIGNS:
                instruction.terms = list(zip(_SIGNS[identity], values, strict=True))
            elif identity == ca.OP_TWICE:
                instruction.terms = [(1.0, values[0])] * 2
            elif identity in (ca.OP_MUL, ca.OP_SQ):
                instruction.products = [(1.0, values[0], values[-1])]
            elif identity in _SAME:
                instruction.operation, instruction.arguments = _SAME[identity], values
            elif identity == ca.OP_INV:
                instruction.operation, instruction.arguments = "DIV", [constant(1.0), *values]
            else:
                raise ValueError(
                    f"an expression has CasADi's operation {identity}, which the interpreter does not support"
                )
            listing.append(instruction)
    return list(_multiplied(listing, constants, constant, fresh)), constants, outputs


def _multiplied(
    listing: list[Instruction], constants: dict[int, float], constant: Callable[[float], int], fresh: Iterator[int]
) -> Iterator[Instruction]:
    """Replace division by constants, and by values that divide more than once, by far cheaper multiplication."""
    divides = Counter(instruction.arguments[1] for instruction in listing if instruction.operation == "DIV")
    reciprocal: dict[int, int] = {}
    for instruction in listing:
        if instruction.operation == "DIV":
            value, by = instruction.arguments
            if by in constants:
                reciprocal[by] = constant(1.0 / constants[by])
            elif divides[by] > 1 and by not in reciprocal:
                reciprocal[by] = next(fresh)
                yield Instruction("DIV", [reciprocal[by]], [constant(1.0), by])
            if by in reciprocal:
                instruction = Instruction("", instruction.results, products=[(1.0, value, reciprocal[by])])
        yield instruction


def _merged(listing: list[Instruction], outputs: list[int]) -> list[Instruction]:
    """Compute sums that are used only once, as terms of another sum, together with that sum."""
    uses = Counter(chain(outputs, *(instruction.operands for instruction in listing)))
    sums = {instruction.results[0]: instruction for instruction in listing if not instruction.operation}
    gone: set[int] = set()
    for instruction in sums.values():
        waiting = list(instruction.terms)
        while waiting:
            term = sign, value = waiting.pop()
            part = sums.get(value)
            if part is None or uses[value] > 1:
                continue
            added = [(sign * s, operand) for s, operand in part.terms]
            products = instruction.products + [(sign * s, a, b) for s, a, b in part.products]
            if (len(instruction.terms) - 1 + len(added), len(products)) in SUMS:
                instruction.terms.remove(term)
                instruction.terms += added
                instruction.products = products
                gone.add(value)
    return [instruction for instruction in listing if instruction.results[0] not in gone]


def _allocated(listing: list[Instruction]) -> tuple[int, dict[int, int]]:
    """Allocate registers: their number, and the register of each result, the one that became free last."""
    # an instruction must not write where it reads: loops over overlapping rows are not vectorised
    last = {value: k for k, line in enumerate(listing) for value in line.operands + line.results}
    free: list[int] = []
    stands: dict[int, int] = {}
    registers = 0
    for k, instruction in enumerate(listing):
        for value in instruction.results:
            if not free:
                free.append(registers)
                registers += 1
            stands[value] = free.pop()
        read = dict.fromkeys(instruction.operands + instruction.results)
        free += [stands[value] for value in read if last[value] == k and value in stands]
    return registers, stands


_inside = threading.local()


def threads() -> int:
    """Return the number of threads: ``GTAU_THREADS``, or one for each core."""
    try:
        return max(int(os.environ["GTAU_THREADS"]), 1)
    except (KeyError, ValueError):
        return os.cpu_count() or 1


def share(work: Callable[[int, int], None], samples: int, worth: int = SHARE) -> None:
    """Call ``work(start, stop)`` for stretches of the ``samples``, in threads where each gets ``worth`` at least."""
    # what a thread does is not shared again
    parts = 1 if samples < 2 * worth or hasattr(_inside, "pool") else min(threads(), samples // worth)
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
    """Run BLAS and OpenMP in one thread: on small matrices and busy cores, threads mainly wait for each other."""
    with threadpool_limits(limits=1):
        yield

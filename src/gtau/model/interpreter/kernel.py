"""Compiled loop of :mod:`gtau.model.interpreter.program`."""

import numpy as np
from numba import carray, types  # type: ignore[attr-defined]

from gtau.model.interpreter import lanes
from gtau.model.interpreter.compiled import compiled, compiled_once
from gtau.model.interpreter.lanes import LANES, WIDE, lane

OPERATIONS = (
    *("MUL", "ADD", "SUB", "MULTIPLY_ADD", "MULTIPLY_SUBTRACT", "SUBTRACT_PRODUCT"),
    *("MUL last", "ADD last", "SUB last", "SUB from last", "MULTIPLY_ADD last", "MULTIPLY_SUBTRACT last"),
    *("SUBTRACT_PRODUCT last", "MULTIPLY_ADD by last", "MULTIPLY_SUBTRACT by last", "SUBTRACT_PRODUCT by last"),
    *("NEG", "DIV", "SQRT", "ASSIGN", "SIGN", "FABS", "FMAX", "SINE_COSINE"),
)
"""Operations of the interpreter; the index in this tuple is the operation code."""

NOWHERE = 2**32 - 1
"""Row of a result that only the next instruction needs."""


@compiled_once(types.void(types.int64, types.int64, types.int64))
def run_machine(code, count, rows):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Run ``count`` instructions, at the address ``code``, on one lane of the rows whose addresses are at ``rows``.

    The previous result stays in the processor's registers as ``last``.
    """
    words, row = carray(lanes.to_words(code), (count, 5)), carray(lanes.to_addresses(rows), (2**31,))
    last = lanes.undefined()
    for k in range(count):
        op, to, a, b = words[k, 0], words[k, 1], row[words[k, 2]], row[words[k, 3]]
        if op == 0:
            last = lanes.multiply(lanes.load(a), lanes.load(b))
        elif op == 1:
            last = lanes.add(lanes.load(a), lanes.load(b))
        elif op == 2:
            last = lanes.subtract(lanes.load(a), lanes.load(b))
        elif op == 3:
            last = lanes.multiply_add(lanes.load(a), lanes.load(b), lanes.load(row[words[k, 4]]))
        elif op == 4:
            last = lanes.multiply_subtract(lanes.load(a), lanes.load(b), lanes.load(row[words[k, 4]]))
        elif op == 5:
            last = lanes.subtract_product(lanes.load(a), lanes.load(b), lanes.load(row[words[k, 4]]))
        elif op == 6:
            last = lanes.multiply(lanes.load(a), last)
        elif op == 7:
            last = lanes.add(lanes.load(a), last)
        elif op == 8:
            last = lanes.subtract(lanes.load(a), last)
        elif op == 9:
            last = lanes.subtract(last, lanes.load(a))
        elif op == 10:
            last = lanes.multiply_add(lanes.load(a), lanes.load(b), last)
        elif op == 11:
            last = lanes.multiply_subtract(lanes.load(a), lanes.load(b), last)
        elif op == 12:
            last = lanes.subtract_product(lanes.load(a), lanes.load(b), last)
        elif op == 13:
            last = lanes.multiply_add(lanes.load(a), last, lanes.load(b))
        elif op == 14:
            last = lanes.multiply_subtract(lanes.load(a), last, lanes.load(b))
        elif op == 15:
            last = lanes.subtract_product(lanes.load(a), last, lanes.load(b))
        elif op == 16:
            last = lanes.negate(lanes.load(a))
        elif op == 17:
            last = lanes.divide(lanes.load(a), lanes.load(b))
        elif op == 18:
            last = lanes.square_root(lanes.load(a))
        elif op == 19:
            last = lanes.load(a)
        elif op == 20:
            last = lanes.sign(lanes.load(a))
        elif op == 21:
            last = lanes.absolute(lanes.load(a))
        elif op == 22:
            last = lanes.maximum(lanes.load(a), lanes.load(b))
        else:
            lanes.sine_cosine(lane(row[to]), lane(b), lane(a))
            continue
        if to != NOWHERE:
            lanes.store(row[to], last)


MACHINE: int = run_machine.address


@compiled
def execute(machine, code, rows):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Run ``code`` (instructions, 5) on one lane of each row; ``machine`` is MACHINE."""
    lanes.call(machine, code.ctypes.data, code.shape[0], rows.ctypes.data)


@compiled
def _run(machine, code, rows, own, long, moved, start):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Run ``code`` on the lane at ``start``."""
    for k in range(rows.size):
        moved[k] = rows[k] + 8 * start if own <= k < long else rows[k]
    execute(machine, code, moved)


@compiled
def interpret(machine, code, rows, own, long, start, stop):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Run ``code`` over the samples ``start`` to ``stop``, at least LANES of them.

    The ``rows`` from ``own`` to ``long`` are as long as the data, the others are of one lane.
    """
    moved = np.empty(rows.size, np.int64)
    while start < stop:
        start = min(start, stop - LANES)  # the last lane ends where the data do, and repeats some samples
        _run(machine, code, rows, own, long, moved, start)
        start += LANES


@compiled
def scatter(machine, code, rows, own, long, start, stop, made, order, places, table):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Run as :func:`interpret`, and put the outputs ``made`` (outputs, LANES) at ``places`` of the rows of ``table``.

    ``table`` is (N, columns); ``places`` (outputs,) rise, and are those of the outputs in the ``order`` (outputs,).
    """
    moved = np.empty(rows.size, np.int64)
    source, target = np.empty(WIDE, np.int64), np.empty(WIDE, np.int64)
    corner, stride = table.ctypes.data, table.strides[0]
    while start < stop:
        start = min(start, stop - LANES)
        _run(machine, code, rows, own, long, moved, start)
        for first in range(0, LANES, WIDE):  # a cache line of each output
            k = 0
            while k < order.size:
                if k + WIDE <= order.size and places[k + WIDE - 1] == places[k] + WIDE - 1:
                    for i in range(WIDE):
                        source[i] = rows[long + order[k + i]] + 8 * first
                        target[i] = corner + (start + first + i) * stride + 8 * places[k]
                    lanes.transpose(source.ctypes.data, target.ctypes.data)
                    k += WIDE
                else:
                    for n in range(first, first + WIDE):
                        table[start + n, places[k]] = made[order[k], n]
                    k += 1
        start += LANES

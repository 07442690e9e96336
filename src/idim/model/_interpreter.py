"""The compiled loop behind :mod:`idim.model.program`."""

import numpy as np
from numba import carray, types  # type: ignore[attr-defined]

from idim.model import _lanes as lanes
from idim.model._compiled import compiled, compiled_once
from idim.model._lanes import LANES, lane

OPERATIONS = (
    *("MUL", "ADD", "SUB", "MULTIPLY_ADD", "MULTIPLY_SUBTRACT", "SUBTRACT_PRODUCT", "SINE_COSINE"),
    *("NEG", "DIV", "SQRT", "ASSIGN", "SIGN", "FABS", "FMAX"),
)
"""What the interpreter can do; the place in this tuple is the code of the operation."""


@compiled_once(types.void(types.int64, types.int64, types.int64))
def run_machine(code, count, rows):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Run ``count`` instructions, at the address ``code``, on one lane of the rows whose addresses are at ``rows``."""
    words, row = carray(lanes.to_words(code), (count, 5)), carray(lanes.to_addresses(rows), (2**31,))
    for k in range(count):
        op, y, a, b = words[k, 0], row[words[k, 1]], row[words[k, 2]], row[words[k, 3]]
        if op == 0:
            lanes.multiply(y, a, b)
        elif op == 1:
            lanes.add(y, a, b)
        elif op == 2:
            lanes.subtract(y, a, b)
        elif op == 3:
            lanes.multiply_add(y, a, b, row[words[k, 4]])
        elif op == 4:
            lanes.multiply_subtract(y, a, b, row[words[k, 4]])
        elif op == 5:
            lanes.subtract_product(y, a, b, row[words[k, 4]])
        elif op == 6:
            lanes.sine_cosine(lane(y), lane(b), lane(a))
        elif op == 7:
            lanes.negate(y, a)
        elif op == 8:
            lanes.divide(y, a, b)
        elif op == 9:
            lanes.square_root(y, a)
        elif op == 10:
            lanes.copy(y, a)
        elif op == 11:
            lanes.sign(y, a)
        elif op == 12:
            lanes.absolute(y, a)
        else:
            lanes.maximum(y, a, b)


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
def scatter(machine, code, rows, own, long, start, stop, made, places, table):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """As :func:`interpret`, the outputs ``made`` (outputs, LANES) put at ``places`` of the rows of ``table``.

    ``table`` is (N, columns), ``places`` (outputs,).
    """
    moved = np.empty(rows.size, np.int64)
    while start < stop:
        start = min(start, stop - LANES)
        _run(machine, code, rows, own, long, moved, start)
        for first in range(0, LANES, 8):  # a cache line of each output
            for k in range(places.size):
                for n in range(first, first + 8):
                    table[start + n, places[k]] = made[k, n]
        start += LANES


@compiled
def contract(machine, code, rows, own, long, start, stop, made, places, weights, table):  # type: ignore[no-untyped-def]  # pragma: no cover
    """As :func:`interpret`, the outputs ``made``, times ``weights``, summed in the ``places`` of ``table`` (., N)."""
    moved = np.empty(rows.size, np.int64)
    sums = np.empty((table.shape[0], LANES))
    while start < stop:
        start = min(start, stop - LANES)
        _run(machine, code, rows, own, long, moved, start)
        sums[:] = 0.0
        for k in range(places.size):
            to, each, weight = sums[places[k]], made[k], weights[k]
            for n in range(LANES):
                to[n] += weight * each[n]
        for j in range(table.shape[0]):
            for n in range(LANES):
                table[j, start + n] = sums[j, n]
        start += LANES

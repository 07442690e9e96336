"""Compiled loops: of :mod:`gtau.model.interpreter.program`, and of continuation, which closes loops along paths."""

from __future__ import annotations

from typing import NamedTuple

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


ITERATIONS = 8
TILE = 8  # samples of a path that are put into the results together: a cache line of each row


class Follower(NamedTuple):
    """Programs that read ``trial`` (n_c, LANES) and write ``made``: n_c rows, then size, condition and gap.

    The programs' rows point into ``memory``. ``actuated`` (n,) are rows of the configuration, and ``scale``
    (n_c,) is what its entries are multiplied by to become rad or lengths over the characteristic length, zero for the
    actuated. The rest are the parameters of the continuation.
    """

    machine: int
    step: np.ndarray
    step_rows: np.ndarray
    step_memory: np.ndarray
    fast_step: np.ndarray
    fast_step_rows: np.ndarray
    fast_step_memory: np.ndarray
    gap: np.ndarray
    gap_rows: np.ndarray
    gap_memory: np.ndarray
    trial: np.ndarray
    made: np.ndarray
    actuated: np.ndarray
    scale: np.ndarray
    shortest: float
    residual: float
    contraction: float
    reach: float


@compiled
def _newton(f, now, going):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Close the loops from the initial guess ``f.trial`` in the lanes ``going``; return where that succeeded.

    ``now`` is the previous closed configuration. Also return the share of the way to a singular pose.
    """
    n_c = f.trial.shape[0]
    size, condition, gap = f.made[n_c], f.made[n_c + 1], f.made[n_c + 2]
    good, done, step = np.empty(LANES, np.bool_), np.zeros(LANES, np.bool_), np.empty(LANES, np.bool_)
    last, ahead, share = np.zeros(LANES), np.zeros(LANES), np.zeros(LANES)
    for n in range(LANES):
        good[n] = going[n]
    for i in range(n_c):
        for n in range(LANES):
            ahead[n] = max(ahead[n], f.scale[i] * abs(f.trial[i, n] - now[i, n]))
    for iteration in range(ITERATIONS):
        if iteration == 0:
            execute(f.machine, f.step, f.step_rows)
        else:
            execute(f.machine, f.fast_step, f.fast_step_rows)
        busy = False
        for n in range(LANES):
            step[n] = False
            if good[n] and not done[n]:
                if iteration == 0:
                    share[n] = (ahead[n] + size[n]) * condition[n]
                    good[n] = share[n] <= f.reach
                else:
                    good[n] = size[n] <= f.contraction * last[n] or size[n] < 1e-9
                last[n] = size[n]
                step[n] = good[n]
                done[n] = size[n] < 1e-7  # it is squared by the step; the gap shows whether that is enough
                busy |= good[n] and not done[n]
        for i in range(n_c):
            for n in range(LANES):
                f.trial[i, n] = f.made[i, n] if step[n] else f.trial[i, n]
        if not busy:
            break
    execute(f.machine, f.gap, f.gap_rows)
    for n in range(LANES):
        good[n] = good[n] and done[n] and gap[n] < f.residual
    return good, share


@compiled
def _go(f, now, guess, guessed, target, going):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Move ``now`` (n_c, LANES) straight to ``target`` (n, LANES) in the lanes ``going``; return which arrived.

    In the lanes ``guessed`` the configuration there is tried to be ``guess``; where that was in one step,
    ``guessed`` is True afterwards.
    """
    begin, travelled, stride, there = np.empty(target.shape), np.zeros(LANES), np.ones(LANES), np.empty(LANES)
    moving, first, arrived = np.empty(LANES, np.bool_), np.empty(LANES, np.bool_), np.empty(LANES, np.bool_)
    busy = False
    for n in range(LANES):
        moving[n], first[n] = going[n], guessed[n]
        busy |= going[n]
        for j in range(f.actuated.size):
            begin[j, n] = now[f.actuated[j], n]
    while busy:
        for i in range(now.shape[0]):
            for n in range(LANES):
                f.trial[i, n] = guess[i, n] if first[n] else now[i, n]
        for n in range(LANES):
            there[n] = min(travelled[n] + stride[n], 1.0)
        for j in range(f.actuated.size):
            for n in range(LANES):
                if moving[n]:  # exact at the ends
                    f.trial[f.actuated[j], n] = (1.0 - there[n]) * begin[j, n] + there[n] * target[j, n]
        closed, share = _newton(f, now, moving)
        for i in range(now.shape[0]):
            for n in range(LANES):
                now[i, n] = f.trial[i, n] if closed[n] else now[i, n]
        busy = False
        for n in range(LANES):
            if moving[n]:
                if closed[n]:
                    guessed[n] = travelled[n] == 0.0 and there[n] == 1.0
                    travelled[n] = there[n]
                    stride[n] *= min(2.0, 0.9 * f.reach / share[n])
                elif not first[n]:
                    stride[n] *= max(0.1, 0.9 * f.reach / share[n]) if share[n] > f.reach else 0.5
                first[n] = False
                moving[n] = travelled[n] < 1.0 and stride[n] >= f.shortest
                busy |= moving[n]
    for n in range(LANES):
        arrived[n] = travelled[n] >= 1.0
    return arrived


@compiled
def advance_to(f, c, q, begin, end, reached):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Move the columns ``begin`` to ``end`` of ``c`` (n_c, N) towards those of ``q`` (n, N), in place.

    ``reached`` (N,) becomes True for those that arrive.
    """
    now, target = np.zeros((c.shape[0], LANES)), np.zeros((q.shape[0], LANES))
    going, guessed = np.empty(LANES, np.bool_), np.empty(LANES, np.bool_)
    for start in range(begin, end, LANES):
        lanes = min(LANES, end - start)
        for n in range(LANES):
            going[n], guessed[n] = n < lanes, False
        for n in range(lanes):
            for i in range(c.shape[0]):
                now[i, n] = c[i, start + n]
            for j in range(q.shape[0]):
                target[j, n] = q[j, start + n]
        arrived = _go(f, now, now, guessed, target, going)
        for n in range(lanes):
            reached[start + n] = arrived[n]
            for i in range(c.shape[0]):
                c[i, start + n] = now[i, n]


@compiled
def follow_path(f, c, q, starts, length, filled):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Fill ``c`` (n_c, N) along ``q`` (n, N) from each of ``starts``: ``length`` samples, or as many as can be reached.

    The initial guess extrapolates the parabola through the last three samples.
    """
    n_c, samples = c.shape
    now, guess, target = np.zeros((n_c, LANES)), np.zeros((n_c, LANES)), np.zeros((q.shape[0], LANES))
    past = np.zeros((2, n_c, LANES))  # the two samples before ``now``
    tile = np.zeros((n_c, LANES, TILE))
    known = np.empty(LANES, np.int64)  # samples before ``now`` that were led on from in one step each
    going, guessed = np.empty(LANES, np.bool_), np.empty(LANES, np.bool_)
    for first in range(0, starts.size, LANES):
        lanes = min(LANES, starts.size - first)
        for n in range(LANES):
            going[n], known[n] = n < lanes, 0
        for n in range(lanes):
            filled[first + n] = 1
            for i in range(n_c):
                now[i, n] = c[i, starts[first + n]]
        busy, offset = True, 0
        while busy and offset < length - 1:
            offset += 1
            for n in range(lanes):
                at = starts[first + n] + offset
                going[n] = going[n] and at < samples
                if going[n]:
                    for j in range(q.shape[0]):
                        target[j, n] = q[j, at]
            for n in range(LANES):
                guessed[n] = known[n] >= 2
            for i in range(n_c):
                for n in range(LANES):
                    guess[i, n] = 3.0 * (now[i, n] - past[0, i, n]) + past[1, i, n]
                    past[1, i, n] = past[0, i, n]
                    past[0, i, n] = now[i, n]
            arrived = _go(f, now, guess, guessed, target, going)
            busy = False
            for n in range(lanes):
                known[n] = known[n] + 1 if guessed[n] else 0
                going[n] = going[n] and arrived[n]
                busy |= going[n]
                if going[n]:
                    filled[first + n] = offset + 1
            for i in range(n_c):
                for n in range(LANES):
                    tile[i, n, offset % TILE] = now[i, n]
            if not busy or offset % TILE == TILE - 1 or offset == length - 1:
                low = max(offset - offset % TILE, 1)
                for i in range(n_c):
                    for n in range(lanes):
                        for k in range(low, min(offset + 1, filled[first + n])):
                            c[i, starts[first + n] + k] = tile[i, n, k % TILE]

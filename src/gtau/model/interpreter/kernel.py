"""Compiled loops: of :mod:`gtau.model.interpreter.program`, and of continuation, which closes loops along paths.

Numba compiles them, for :mod:`gtau.model.interpreter.compiled`, which alone imports this module. They take addresses
and whole numbers and allocate nothing, so that their machine code needs nothing of Numba. All arrays are in C order.
"""

from __future__ import annotations

from numba import carray  # type: ignore[attr-defined]

from gtau.model.interpreter import lanes
from gtau.model.interpreter.instructions import LANES, NOWHERE, ROW, TILE, WIDE
from gtau.model.interpreter.lanes import compiled, lane, to_addresses, to_doubles, to_flags, to_followers

ITERATIONS = 8


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


@compiled
def _run(machine, code, count, rows, size, own, long, moved, start):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Run ``count`` instructions of ``code`` on the lane at ``start``."""
    rows, there = carray(to_addresses(rows), (size,)), carray(to_addresses(moved), (size,))
    for k in range(size):
        there[k] = rows[k] + 8 * start if own <= k < long else rows[k]
    lanes.call(machine, code, count, moved)


def interpret(machine, code, count, rows, size, own, long, moved, start, stop):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Run ``code`` (count, 5) over the samples ``start`` to ``stop``, at least LANES of them.

    ``machine`` is the address of :func:`run_machine`. Of the ``rows`` (size,), those from ``own`` to ``long`` are as
    long as the data, the others are of one lane. ``moved`` (size,) is memory to work with.
    """
    while start < stop:
        start = min(start, stop - LANES)  # the last lane ends where the data do, and repeats some samples
        _run(machine, code, count, rows, size, own, long, moved, start)
        start += LANES


def scatter(  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    machine, code, count, rows, size, own, long, moved, start, stop, made, order, places, outputs, table, stride
):
    """Run as :func:`interpret`, and put the outputs ``made`` (outputs, ROW) at ``places`` of the rows of ``table``.

    ``table`` is (N, columns), a row ``stride`` bytes; ``places`` (outputs,) rise, and are those of the outputs in the
    ``order`` (outputs,). ``moved`` (size + 2 WIDE,) is memory to work with.
    """
    order, places = carray(to_addresses(order), (outputs,)), carray(to_addresses(places), (outputs,))
    source, target = moved + 8 * size, moved + 8 * (size + WIDE)
    sources, targets = carray(to_addresses(source), (WIDE,)), carray(to_addresses(target), (WIDE,))
    made_rows = carray(to_addresses(rows), (size,))
    while start < stop:
        start = min(start, stop - LANES)
        _run(machine, code, count, rows, size, own, long, moved, start)
        for first in range(0, LANES, WIDE):  # a cache line of each output
            k = 0
            while k < outputs:
                if k + WIDE <= outputs and places[k + WIDE - 1] == places[k] + WIDE - 1:
                    for i in range(WIDE):
                        sources[i] = made_rows[long + order[k + i]] + 8 * first
                        targets[i] = table + (start + first + i) * stride + 8 * places[k]
                    lanes.transpose(source, target)
                    k += WIDE
                else:
                    values = carray(to_doubles(made + 8 * ROW * order[k]), (LANES,))
                    for n in range(first, first + WIDE):
                        carray(to_doubles(table + (start + n) * stride + 8 * places[k]), (1,))[0] = values[n]
                    k += 1
        start += LANES


@compiled
def _newton(f, now, going, good, share):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Close the loops from the initial guess ``f.trial`` in the lanes ``going``; ``good`` becomes where that succeeded.

    ``now`` is the previous closed configuration, ``share`` becomes the share of the way to a singular pose.
    """
    trial, made = carray(to_doubles(f.trial), (f.n_c, ROW)), carray(to_doubles(f.made), (f.n_c + 3, ROW))
    scale = carray(to_doubles(f.scale), (f.n_c,))
    size, condition, gap = made[f.n_c], made[f.n_c + 1], made[f.n_c + 2]
    done, step = carray(lanes.flags(), (LANES,)), carray(lanes.flags(), (LANES,))
    last, ahead = carray(lanes.doubles(), (LANES,)), carray(lanes.doubles(), (LANES,))
    for n in range(LANES):
        good[n], done[n], last[n], ahead[n], share[n] = going[n], False, 0.0, 0.0, 0.0
    for i in range(f.n_c):
        for n in range(LANES):
            ahead[n] = max(ahead[n], scale[i] * abs(trial[i, n] - now[i, n]))
    for iteration in range(ITERATIONS):
        if iteration == 0:
            lanes.call(f.machine, f.step, f.step_count, f.step_rows)
        else:
            lanes.call(f.machine, f.fast_step, f.fast_step_count, f.fast_step_rows)
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
        for i in range(f.n_c):
            for n in range(LANES):
                trial[i, n] = made[i, n] if step[n] else trial[i, n]
        if not busy:
            break
    lanes.call(f.machine, f.gap, f.gap_count, f.gap_rows)
    for n in range(LANES):
        good[n] = good[n] and done[n] and gap[n] < f.residual


@compiled
def _go(f, now, guess, guessed, target, going, arrived):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Move ``now`` (n_c, LANES) straight to ``target`` (n, LANES) in the lanes ``going``; ``arrived`` becomes which do.

    In the lanes ``guessed`` the configuration there is tried to be ``guess``; where that was in one step,
    ``guessed`` is True afterwards.
    """
    trial, actuated = carray(to_doubles(f.trial), (f.n_c, ROW)), carray(to_addresses(f.actuated), (f.n,))
    begin = carray(to_doubles(f.begin), (f.n, LANES))
    travelled, stride = carray(lanes.doubles(), (LANES,)), carray(lanes.doubles(), (LANES,))
    there, share = carray(lanes.doubles(), (LANES,)), carray(lanes.doubles(), (LANES,))
    moving, first = carray(lanes.flags(), (LANES,)), carray(lanes.flags(), (LANES,))
    closed = carray(lanes.flags(), (LANES,))
    busy = False
    for n in range(LANES):
        moving[n], first[n], travelled[n], stride[n] = going[n], guessed[n], 0.0, 1.0
        busy |= going[n]
        for j in range(f.n):
            begin[j, n] = now[actuated[j], n]
    while busy:
        for i in range(f.n_c):
            for n in range(LANES):
                trial[i, n] = guess[i, n] if first[n] else now[i, n]
        for n in range(LANES):
            there[n] = min(travelled[n] + stride[n], 1.0)
        for j in range(f.n):
            for n in range(LANES):
                if moving[n]:  # exact at the ends
                    trial[actuated[j], n] = (1.0 - there[n]) * begin[j, n] + there[n] * target[j, n]
        _newton(f, now, moving, closed, share)
        for i in range(f.n_c):
            for n in range(LANES):
                now[i, n] = trial[i, n] if closed[n] else now[i, n]
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


def advance_to(follower, c, q, samples, begin, end, reached):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Move the columns ``begin`` to ``end`` of ``c`` (n_c, N) towards those of ``q`` (n, N), in place.

    ``reached`` (N,) becomes True for those that arrive. ``follower`` is a Follower.
    """
    f = carray(to_followers(follower), (1,))[0]
    c, q = carray(to_doubles(c), (f.n_c, samples)), carray(to_doubles(q), (f.n, samples))
    reached = carray(to_flags(reached), (samples,))
    now, target = carray(to_doubles(f.now), (f.n_c, LANES)), carray(to_doubles(f.target), (f.n, LANES))
    going, guessed, arrived = (
        carray(lanes.flags(), (LANES,)),
        carray(lanes.flags(), (LANES,)),
        carray(lanes.flags(), (LANES,)),
    )
    for start in range(begin, end, LANES):
        used = min(LANES, end - start)
        for n in range(LANES):
            going[n], guessed[n] = n < used, False
        for n in range(used):
            for i in range(f.n_c):
                now[i, n] = c[i, start + n]
            for j in range(f.n):
                target[j, n] = q[j, start + n]
        _go(f, now, now, guessed, target, going, arrived)
        for n in range(used):
            reached[start + n] = arrived[n]
            for i in range(f.n_c):
                c[i, start + n] = now[i, n]


def follow_path(follower, c, q, samples, starts, parts, length, filled):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Fill ``c`` (n_c, N) along ``q`` (n, N) from each of ``starts``: ``length`` samples, or as many as can be reached.

    ``starts`` and ``filled``, how many were, are (parts,). The initial guess extrapolates the parabola through the last
    three samples.
    """
    f = carray(to_followers(follower), (1,))[0]
    n_c = f.n_c
    c, q = carray(to_doubles(c), (n_c, samples)), carray(to_doubles(q), (f.n, samples))
    starts, filled = carray(to_addresses(starts), (parts,)), carray(to_addresses(filled), (parts,))
    now, guess = carray(to_doubles(f.now), (n_c, LANES)), carray(to_doubles(f.guess), (n_c, LANES))
    target = carray(to_doubles(f.target), (f.n, LANES))
    past = carray(to_doubles(f.past), (2, n_c, LANES))  # the two samples before ``now``
    tile = carray(to_doubles(f.tile), (n_c, LANES, TILE))
    known = carray(lanes.doubles(), (LANES,))  # samples before ``now`` that were led on from in one step each
    going, guessed, arrived = (
        carray(lanes.flags(), (LANES,)),
        carray(lanes.flags(), (LANES,)),
        carray(lanes.flags(), (LANES,)),
    )
    for first in range(0, parts, LANES):
        used = min(LANES, parts - first)
        for n in range(LANES):
            going[n], known[n] = n < used, 0.0
        for n in range(used):
            filled[first + n] = 1
            for i in range(n_c):
                now[i, n] = c[i, starts[first + n]]
        busy, offset = True, 0
        while busy and offset < length - 1:
            offset += 1
            for n in range(used):
                at = starts[first + n] + offset
                going[n] = going[n] and at < samples
                if going[n]:
                    for j in range(f.n):
                        target[j, n] = q[j, at]
            for n in range(LANES):
                guessed[n] = known[n] >= 2
            for i in range(n_c):
                for n in range(LANES):
                    guess[i, n] = 3.0 * (now[i, n] - past[0, i, n]) + past[1, i, n]
                    past[1, i, n] = past[0, i, n]
                    past[0, i, n] = now[i, n]
            _go(f, now, guess, guessed, target, going, arrived)
            busy = False
            for n in range(used):
                known[n] = known[n] + 1.0 if guessed[n] else 0.0
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
                    for n in range(used):
                        for k in range(low, min(offset + 1, filled[first + n])):
                            c[i, starts[first + n] + k] = tile[i, n, k % TILE]

"""The loops that Numba compiles: the interpreter, and the continuation that closes a robot's loops along paths.

Numba takes 0.4 s to import, so this module is imported only to evaluate something. All arrays are in C order. Numba
notices changes of this file alone, so it imports nothing of gtau.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, types

SOURCES = 4  # arrays that inputs come from
ITERATIONS = 8

_HALF_PI = (1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21)  # in parts of 33 bits, and the rest
_FAR = 1e6  # rad: up to here whole multiples of the parts are exact
_ROUND = 6755399441055744.0  # 1.5 * 2^52: what is added to it is rounded to an integer


def _compiled(*signature: Any) -> Any:
    """Compile a function now, or with its callers where no types are given, and cache the code where that can be."""
    contract = {"contract"}  # a product and a sum are rounded once; what is not a number stays so
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": contract}

    def decorate(function: Any) -> Any:
        compiler: Any = njit
        try:
            return compiler(*signature, cache=True, **options)(function)
        except RuntimeError:  # no folder can be written to
            return compiler(*signature, **options)(function)

    return decorate


_inlined: Any = njit(inline="always")
_NUMBERS = types.float64[:, ::1]
_BOUND = types.Tuple((types.uint32[:, ::1], _NUMBERS, _NUMBERS))
_SOURCES = types.UniTuple(types.Array(types.float64, 2, "C", readonly=True), SOURCES)


@_inlined
def _sine_cosine(rows, sine, cosine, angle, count):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Compute sines and cosines to about a unit in the last place: the library's are not vectorised, and take longer.

    The polynomials in r^2 on |r| <= pi/4 interpolate at Chebyshev's points, to 2e-17 and 7e-19 of the values.
    """
    far = False
    for n in range(count):
        x = rows[angle, n]
        far |= abs(x) > _FAR
        turns = (x * (2 / np.pi) + _ROUND) - _ROUND
        r = ((x - turns * _HALF_PI[0]) - turns * _HALF_PI[1]) - turns * _HALF_PI[2]
        z = r * r
        s = 2.755731608382574e-06 + z * (-2.505112794596564e-08 + z * 1.591784866512194e-10)
        s = r + r * z * (-0.16666666666666666 + z * (0.008333333333330925 + z * (-0.00019841269836722437 + z * s)))
        c = -2.755731726001471e-07 + z * (2.0876143829213935e-09 + z * -1.1382456865840483e-11)
        c = 0.041666666666666664 + z * (-0.0013888888888887382 + z * (2.480158729874308e-05 + z * c))
        half = 0.5 * z
        most = 1.0 - half
        c = most + (((1.0 - most) - half) + z * z * c)
        quadrant = turns - 4.0 * np.floor(0.25 * turns)
        odd = quadrant == 1.0 or quadrant == 3.0
        sin, cos = (c, s) if odd else (s, c)
        rows[sine, n] = -sin if quadrant >= 2.0 else sin
        rows[cosine, n] = -cos if quadrant == 1.0 or quadrant == 2.0 else cos
    if far:
        for n in range(count):
            if abs(rows[angle, n]) > _FAR:
                rows[sine, n], rows[cosine, n] = np.sin(rows[angle, n]), np.cos(rows[angle, n])


@_inlined
def _no_sum(rows, op, to, a, b, count):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Compute the row ``to`` of an operation that is no sum of products."""
    if op == 8:
        for n in range(count):
            rows[to, n] = rows[a, n] / rows[b, n]
    elif op == 9:
        for n in range(count):
            rows[to, n] = np.sqrt(rows[a, n])
    elif op == 10:
        for n in range(count):
            x = rows[a, n]
            rows[to, n] = 1.0 if x > 0.0 else (-1.0 if x < 0.0 else x)  # zero and nan stay what they are
    elif op == 11:
        for n in range(count):
            rows[to, n] = abs(rows[a, n])
    elif op == 12:
        for n in range(count):
            x, y = rows[a, n], rows[b, n]
            rows[to, n] = x if x > y or x != x else y  # nan if either is, so that a test on it fails
    else:
        _sine_cosine(rows, to, b, a, count)


@_compiled(types.void(_BOUND, _SOURCES, _NUMBERS, *[types.int64] * 3))
def evaluate(bound, sources, outputs, start, stop, column):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Compute ``outputs``, from a ``column`` on, of the samples ``start`` to ``stop`` of ``sources``.

    The sources, one above the other, are the inputs (inputs, N). For ``bound`` see
    :meth:`gtau.model.program.Program.bound`.
    """
    code, signs, rows = bound
    lanes = rows.shape[1]
    for first in range(start, stop, lanes):
        count, row = min(lanes, stop - first), 0
        for source in sources:
            for i in range(len(source)):
                for n in range(count):
                    rows[row + i, n] = source[i, first + n]
            row += len(source)
        for k in range(len(code)):
            op, to, out, a, b, c = code[k, 0], code[k, 1], code[k, 2], code[k, 3], code[k, 4], code[k, 5]
            d, e, f, g = code[k, 6], code[k, 7], code[k, 8], code[k, 9]
            s, t, u, v = signs[k, 0], signs[k, 1], signs[k, 2], signs[k, 3]
            if op == 0:
                for n in range(count):
                    rows[to, n] = s * rows[a, n]
            elif op == 1:
                for n in range(count):
                    rows[to, n] = s * rows[a, n] + t * rows[b, n]
            elif op == 2:
                for n in range(count):
                    rows[to, n] = s * rows[a, n] * rows[b, n]
            elif op == 3:
                for n in range(count):
                    rows[to, n] = s * rows[a, n] + t * rows[b, n] * rows[c, n]
            elif op == 4:
                for n in range(count):
                    rows[to, n] = s * rows[a, n] * rows[b, n] + t * rows[c, n] * rows[d, n]
            elif op == 5:
                for n in range(count):
                    rows[to, n] = s * rows[a, n] + t * rows[b, n] * rows[c, n] + u * rows[d, n] * rows[e, n]
            elif op == 6:
                for n in range(count):
                    part = s * rows[a, n] * rows[b, n]
                    rows[to, n] = part + t * rows[c, n] * rows[d, n] + u * rows[e, n] * rows[f, n]
            elif op == 7:
                for n in range(count):
                    part = s * rows[a, n] + t * rows[b, n] * rows[c, n]
                    rows[to, n] = part + u * rows[d, n] * rows[e, n] + v * rows[f, n] * rows[g, n]
            else:
                _no_sum(rows, op, to, a, b, count)
            if out < len(outputs):
                for n in range(count):
                    outputs[out, column + first - start + n] = rows[to, n]


@_compiled()
def scatter(made, order, places, table, start, count):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Put ``count`` columns of ``made``, in ``order``, at ``places`` of the rows of ``table`` from ``start`` on."""
    for n in range(count):
        for k in range(len(order)):
            table[start + n, places[k]] = made[order[k], n]


@_compiled(types.void(_NUMBERS, _NUMBERS))
def recur(sections, rows):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Filter ``rows`` (K, N) in place by ``sections`` (S, 5), b0, b1, b2, a1, a2, whose gain at 0 Hz is 1.

    Each row begins in the steady state of its first sample.
    """
    for k in range(len(rows)):
        for i in range(len(sections)):
            b0, b1, b2, a1, a2 = sections[i]
            state, next_state = (1.0 - b0) * rows[k, 0], (b2 - a2) * rows[k, 0]
            for n in range(rows.shape[1]):
                x = rows[k, n]
                y = b0 * x + state
                state = b1 * x - a1 * y + next_state
                next_state = b2 * x - a2 * y
                rows[k, n] = y


@_inlined
def _newton(loops, trial, now, going, good, share, used):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Close the loops from the initial guess ``trial`` on the paths ``going``; ``good`` becomes where that succeeded.

    ``now`` is the previous closed configuration, ``share`` becomes the share of the way to a singular pose.
    """
    programs, scale, _, (_, residual, contraction, reach) = loops
    n_c, paths = trial.shape
    nothing = np.empty((0, paths))
    made = np.empty((n_c + 2, paths))  # the configuration after a step, its size, and the condition number or the gap
    size, other = made[n_c], made[n_c + 1]
    last, done, stepped = np.empty(paths), np.empty(paths, np.bool_), np.empty(paths, np.bool_)
    for n in range(used):
        good[n], share[n], done[n] = going[n], 0.0, False
    for i in range(n_c):
        for n in range(used):
            share[n] = max(share[n], scale[i] * abs(trial[i, n] - now[i, n]))
    iteration, busy = 0, True
    while True:
        last_of_all = not busy or iteration == ITERATIONS
        code, signs, rows, constant, values = programs[2 if last_of_all else min(iteration, 1)]
        for k in range(len(constant)):  # such as the condition number of coupled joints
            made[constant[k]] = values[k]
        evaluate((code, signs, rows), (trial, nothing, nothing, nothing), made, 0, used, 0)
        if last_of_all:
            break
        busy = False
        for n in range(used):
            stepped[n] = False
            if good[n] and not done[n]:
                if iteration == 0:
                    share[n] = (share[n] + size[n]) * other[n]
                    good[n] = share[n] <= reach
                else:
                    good[n] = size[n] <= contraction * last[n] or size[n] < 1e-9
                last[n] = size[n]
                stepped[n] = good[n]
                done[n] = size[n] < 1e-7  # it is squared by the step; the gap shows whether that is enough
                busy |= good[n] and not done[n]
        for i in range(n_c):
            for n in range(used):
                trial[i, n] = made[i, n] if stepped[n] else trial[i, n]
        iteration += 1
    for n in range(used):
        good[n] = good[n] and done[n] and made[0, n] < residual


@_inlined
def _go(loops, now, guess, guessed, target, going, used):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Move ``now`` (n_c, paths) straight to ``target`` (n, paths) on paths ``going``; return which arrive (paths,).

    On the paths ``guessed`` the configuration there is tried to be ``guess``; where that was in one step,
    ``guessed`` is True afterwards.
    """
    _, _, actuated, (shortest, _, _, reach) = loops
    n_c, paths = now.shape
    trial, begin = np.empty((n_c, paths)), np.empty((len(actuated), paths))
    travelled, stride, there, share = np.empty(paths), np.empty(paths), np.empty(paths), np.empty(paths)
    moving, first, closed = np.empty(paths, np.bool_), np.empty(paths, np.bool_), np.empty(paths, np.bool_)
    busy = False
    for n in range(used):
        moving[n], first[n], travelled[n], stride[n] = going[n], guessed[n], 0.0, 1.0
        busy |= going[n]
        for j in range(len(actuated)):
            begin[j, n] = now[actuated[j], n]
    while busy:
        for i in range(n_c):
            for n in range(used):
                trial[i, n] = guess[i, n] if first[n] else now[i, n]
        for n in range(used):
            there[n] = min(travelled[n] + stride[n], 1.0)
        for j in range(len(actuated)):
            for n in range(used):
                if moving[n]:  # exact at the ends
                    trial[actuated[j], n] = (1.0 - there[n]) * begin[j, n] + there[n] * target[j, n]
        _newton(loops, trial, now, moving, closed, share, used)
        for i in range(n_c):
            for n in range(used):
                now[i, n] = trial[i, n] if closed[n] else now[i, n]
        busy = False
        for n in range(used):
            if moving[n]:
                if closed[n]:
                    guessed[n] = travelled[n] == 0.0 and there[n] == 1.0
                    travelled[n] = there[n]
                    stride[n] *= min(2.0, 0.9 * reach / share[n])
                elif not first[n]:
                    stride[n] *= max(0.1, 0.9 * reach / share[n]) if share[n] > reach else 0.5
                first[n] = False
                moving[n] = travelled[n] < 1.0 and stride[n] >= shortest
                busy |= moving[n]
    return travelled >= 1.0


@_compiled()
def follow(loops, c, q, starts, filled, length):  # type: ignore[no-untyped-def]  # pragma: no cover - compiled
    """Fill ``c`` (n_c, N) along ``q`` (n, N) from each of ``starts``: ``length`` samples, or as many as can be reached.

    ``filled`` becomes how many were; the sample after them is where the loops closed last. ``loops`` are programs (a
    step with its condition number, a step, and the gap), with rows to work with and their constant outputs; factors
    (n_c,) that make entries of c rad or lengths over the characteristic length; the rows of c that are q; and the
    shortest step, the largest residual, the contraction and the reach. The initial guess extrapolates the parabola
    through the last three samples.
    """
    n_c, samples, paths = len(c), c.shape[1], loops[0][0][2].shape[1]
    now, guess, target = np.empty((n_c, paths)), np.empty((n_c, paths)), np.empty((len(q), paths))
    past = np.empty((2, n_c, paths))  # the two samples before ``now``
    known = np.empty(paths)  # samples before ``now`` that were led on from in one step each
    going, guessed = np.empty(paths, np.bool_), np.empty(paths, np.bool_)
    for first in range(0, len(starts), paths):
        used = min(paths, len(starts) - first)
        for n in range(used):
            going[n], known[n], filled[first + n] = True, 0.0, 1
            for i in range(n_c):
                now[i, n] = c[i, starts[first + n]]
        offset, busy = 1, length > 1
        while busy:
            for n in range(used):
                at = starts[first + n] + offset
                going[n] = going[n] and at < samples
                guessed[n] = known[n] >= 2
                if going[n]:
                    for j in range(len(q)):
                        target[j, n] = q[j, at]
            for i in range(n_c):
                for n in range(used):
                    guess[i, n] = 3.0 * (now[i, n] - past[0, i, n]) + past[1, i, n]
                    past[1, i, n] = past[0, i, n]
                    past[0, i, n] = now[i, n]
            arrived = _go(loops, now, guess, guessed, target, going, used)
            busy = False
            for n in range(used):
                known[n] = known[n] + 1.0 if guessed[n] else 0.0
                if going[n]:
                    for i in range(n_c):
                        c[i, starts[first + n] + offset] = now[i, n]
                    going[n] = arrived[n]
                    filled[first + n] += arrived[n]
                busy |= going[n]
            offset += 1
            busy = busy and offset < length

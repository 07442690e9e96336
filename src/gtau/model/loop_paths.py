"""Close the loops numerically, for all samples, in one assembly mode (paper, eqs. 3 and 4).

Every sample is reached along a path from the home configuration: steps are halved until Newton's
corrections shrink fast, so a solution never jumps to another assembly mode unseen. Many paths are
followed at once, each in a lane of its own.
"""

from __future__ import annotations

from functools import lru_cache
from threading import get_ident

import numpy as np

from gtau.errors import GtauError
from gtau.model.interpreter.compiled import loops as compiled
from gtau.model.interpreter.instructions import FOLLOWER, LANES, TILE
from gtau.model.interpreter.program import Bound, address, addresses, aligned, share
from gtau.model.loops import Labels, Loops, numbers, pose_words

RESIDUAL = 1e-12  # of a closed loop: rad, or lengths over the characteristic length
CONTRACTION = 0.3  # a step is too long if Newton's second correction is not this much smaller
REACH = 0.5  # or if it leads this share of the way to a singular pose, where assembly modes meet
SHORTEST = 2.0**-14  # of the way between two samples: if shorter steps are needed, there is no path
SEGMENTS = 128  # of a path, followed in parallel, each of at least SEGMENT samples
SEGMENT = 16


@lru_cache(maxsize=16)  # hypotheses evaluate many short paths
def _follower(loops: Loops, shortest: float, thread: int) -> tuple[np.ndarray, list[object]]:
    """Make the working memory of the compiled loops, one per thread, and the arrays that it points to."""
    layout, n_c, n = loops.layout, loops.layout.n_c, len(loops.layout.actuated)
    trial, made = aligned(n_c), aligned(n_c + 3)  # made: the configuration, then size, condition and gap
    trial[:], made[:] = 0.0, 0.0
    at, to = addresses(trial), addresses(made)
    bound = (
        Bound(loops.step, at, to[: n_c + 2]),
        Bound(loops.fast_step, at, to[: n_c + 1]),
        Bound(loops.gap, at, to[n_c + 2 :]),
    )
    programs = [part for program in bound for part in program.run()[1:4]]
    actuated, scale = np.array(layout.actuated, np.int64), _scale(loops)
    tables = (np.zeros((rows, LANES)) for rows in (n_c, n_c, 2 * n_c, TILE * n_c, n, n))
    pointed = [trial, made, scale, actuated, *tables]
    where = [address(array) for array in pointed]
    parameters = shortest, RESIDUAL, CONTRACTION, REACH
    follower = np.array((compiled().machine, *programs, *where[:4], n_c, n, *where[4:], *parameters), dtype=FOLLOWER)
    return follower, [bound, *pointed]


def _scale(loops: Loops) -> np.ndarray:
    """Return by how much entries (n_c,) of c become rad, or lengths over the robot's; zero for the actuated ones."""
    layout, scale = loops.layout, np.full(loops.layout.n_c, 1.0 / loops.length)
    scale[np.flatnonzero(layout.angular[: len(layout.robot.joints)])] = 1.0
    scale[layout.actuated] = 0.0
    for slots in layout.platforms:
        if slots.quaternion is not None:
            scale[slots.quaternion] = 2.0  # of a turn by an angle, at most half of it
    return scale


def advance(loops: Loops, c: np.ndarray, q: np.ndarray, shortest: float = SHORTEST) -> tuple[np.ndarray, np.ndarray]:
    """Move from closed configurations ``c`` (n_c, N) straight towards ``q`` (n, N), each as far as the loops close.

    A step below the share ``shortest`` of the way is not tried.

    Returns the closed configurations arrived at (n_c, N), and which are those asked for (N,).
    """
    c, q = np.array(c, dtype=float, order="C"), np.ascontiguousarray(q, dtype=float)
    reached = np.zeros(c.shape[1], dtype=bool)

    def run(start: int, stop: int) -> None:
        follower, _pointed = _follower(loops, shortest, get_ident())
        where = address(follower), address(c), address(q), c.shape[1]
        compiled().advance_to(*where, start, stop, address(reached))

    share(run, c.shape[1], LANES)
    return c, reached


def follow(
    loops: Loops,
    q: np.ndarray,
    labels: Labels | None = None,
    start: np.ndarray | None = None,
    segments: int = SEGMENTS,
) -> np.ndarray:
    """Find the configurations (n_c, N) along the path ``q`` (n, N), rad or m, all in the assembly mode of home.

    ``labels`` name the samples in messages, ``"sample 17"`` if omitted; ``start`` is the closed configuration (n_c,) at
    the start of the path, home if omitted; ``segments`` of the path, at most, are followed in parallel. Raises
    GtauError where a sample cannot be reached within the assembly mode.
    """
    q, samples = np.ascontiguousarray(q, dtype=float), q.shape[1]
    labels = labels or numbers()
    begin = loops.home if start is None else start
    c = np.repeat(begin[:, None], samples, axis=1)
    if not samples:
        return c
    length = max(-(-samples // segments), min(SEGMENT, samples))
    starts = np.arange(0, samples, length)
    c[:, [0]], first_reached = advance(loops, begin[:, None], q[:, [0]])
    if not first_reached[0]:
        raise _unreachable(loops, q[:, 0], labels(0))
    reached = np.ones(starts.size, dtype=bool)
    half = 1 << (starts.size - 1).bit_length()
    while half := half // 2:  # the head in the middle of the way, those of its halves, and so on
        heads = np.arange(half, starts.size, 2 * half)
        c[:, starts[heads]], reached[heads] = advance(loops, c[:, starts[heads - half]], q[:, starts[heads]])
    begun = np.flatnonzero(reached)
    lost = _follow_segments(loops, q, c, starts[begun], length)
    # a segment must begin where the previous one ends
    led, joined = advance(loops, c[:, starts[1:] - 1], q[:, starts[1:]])
    redone = False
    for k in range(1, starts.size):
        if starts[k] - 1 in lost:
            break
        if redone:
            led[:, [k - 1]], joined[[k - 1]] = advance(loops, c[:, [starts[k] - 1]], q[:, [starts[k]]])
        if not joined[k - 1]:
            lost.add(starts[k])
            break
        redone = not reached[k] or np.abs(led[:, k - 1] - c[:, starts[k]]).max() > 1e-6
        if redone:
            c[:, starts[k]] = led[:, k - 1]
            lost -= set(range(starts[k], min(starts[k] + length, samples)))
            lost |= _follow_segments(loops, q, c, starts[[k]], length)
    if lost:
        first = min(lost)
        raise _unreachable(loops, q[:, first], labels(first))
    return c


def _follow_segments(loops: Loops, q: np.ndarray, c: np.ndarray, starts: np.ndarray, length: int) -> set[int]:
    """Fill ``c`` from each of ``starts`` for ``length`` samples; return those that were not reached."""
    ends = np.minimum(starts + length, q.shape[1])
    begins, filled = starts.astype(np.int64), np.zeros(starts.size, dtype=np.int64)

    def run(first: int, last: int) -> None:
        follower, _pointed = _follower(loops, SHORTEST, get_ident())
        where = address(follower), address(c), address(q), c.shape[1]
        parts, mine = begins[first:last], filled[first:last]
        compiled().follow_path(*where, address(parts), parts.size, length, address(mine))

    share(run, starts.size, LANES)
    lost: set[int] = set()
    for first_lost, end in zip(starts + filled, ends, strict=True):
        lost |= set(range(first_lost, end))
    return lost


def _unreachable(loops: Loops, q: np.ndarray, label: str) -> GtauError:
    robot = loops.layout.robot
    return GtauError(
        f"robot '{robot.name}': at {label} ({pose_words(robot, q)}) the loops cannot be closed, or only beyond a "
        "singular pose (type 2), outside the assembly mode of home; check the units, signs and zeros of the positions "
        "and the robot's geometry, or leave these samples out."
    )

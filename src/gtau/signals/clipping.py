"""Commands clipped at a limit of the drive, which say nothing of the torque."""

from __future__ import annotations

import numpy as np

from gtau.errors import GtauError
from gtau.signals.notes import Kind, Note
from gtau.signals.samples import Samples, ahead, counted, extremes
from gtau.signals.storage import block, spans

CLIPPED_RUN = 3  # samples in a row at the extreme value
PILE_UP = 5.0  # times as many samples at the extreme value as at the one next to it
MAX_CLIPPED = 0.1


def clipped(samples: Samples, notes: list[Note]) -> list[tuple[int, float]]:
    """Find joints, and levels at which their commands stay although they move, as at a limit of the drive.

    Raises
    ------
    GtauError
        More than a tenth of the samples are clipped.
    """
    source, count = samples.source, len(samples.time)
    found = []
    low, high = extremes(samples.command)
    moving = [*range(len(source.joints)), *map(source.joints.index, source.sensors)]
    for j, (what, mover) in enumerate(zip(source.measured, moving, strict=True)):
        if low[j] == high[j]:
            continue  # nothing acts on a floating base
        for level in (float(high[j]), float(low[j])):
            at = _count_at(samples.command, j, level)
            if at < CLIPPED_RUN or at < PILE_UP * _count_beside(samples.command, j, level):
                continue
            if _longest_at(samples, j, mover, level) < CLIPPED_RUN:
                continue
            if at > MAX_CLIPPED * count:
                raise GtauError(
                    f"{source.name}: {what} is clipped at {level:.4g} in "
                    f"{at} of {count} samples; record it again with slower motions or a higher limit of the drive."
                )
            masked = f"{what} is clipped at {level:.4g}: masked {counted(at, 'sample')}"
            action = "log again with smaller accelerations, or a higher limit of the drive"
            joint = source.joints[mover]
            notes.append(Note(Kind.CLIPPED, masked, action, joint=joint, share=at / count))
            found.append((j, level))
    return found


def _count_at(command: np.ndarray, j: int, level: float) -> int:
    return sum(int(np.count_nonzero(block(command, *span)[:, j] == level)) for span in spans(len(command)))


def _count_beside(command: np.ndarray, j: int, level: float) -> int:
    """Count samples at the value next to an extreme one."""
    nearest, count = np.inf, 0
    for span in spans(len(command)):
        away = np.abs(block(command, *span)[:, j] - level)
        away = away[away > 0]
        least = away.min(initial=np.inf)
        if least < nearest:
            nearest, count = least, 0
        count += int(np.count_nonzero(away == nearest))
    return count


def _longest_at(samples: Samples, j: int, mover: int, level: float) -> int:
    """Count the most samples in a row in which joint j moves and its command stays at ``level``."""
    position, command, count = samples.position, samples.command, len(samples.time)
    steps = [np.sum(np.diff(block(position, *span)[:, mover]) ** 2) for span in ahead(count)]
    least = 0.05 * np.sqrt(sum(steps) / count)
    longest = now = 0
    for start, stop in ahead(count):
        speed = np.abs(np.diff(block(position, start, stop)[:, mover]))
        at = (block(command, start, stop)[1:, j] == level) & (speed > least)
        edges = np.flatnonzero(np.diff(np.r_[False, at, False]))
        runs = edges[1::2] - edges[::2]
        if runs.size and edges[0] == 0:
            runs[0] += now
        longest = max(longest, int(runs.max(initial=0)))
        now = int(runs[-1]) if runs.size and at[-1] else 0
    return longest

"""Currents whose size no drive of the robot has, so that another unit is likely."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import pairwise

import numpy as np

from gtau.estimation.thresholds.logs import CURRENTS_APART, LARGEST_CURRENT
from gtau.signals.notes import Kind, Note
from gtau.signals.run import Run
from gtau.signals.storage import block, spans


def doubtful_currents(runs: Sequence[Run], base: Collection[str] = ()) -> list[Note]:
    """Note currents that are too large, or of joints that are far apart.

    Parameters
    ----------
    runs : sequence of Run
        All runs, their joints in the same order.
    base : collection of str
        Joints of a base that floats, on which no current acts.
    """
    if runs[0].kind != "current":
        return []
    squares, samples = np.zeros(len(runs[0].joints)), 0
    for run in runs:
        n = len(run.joints)
        squares += sum(np.sum(block(run.command, *span)[:, :n] ** 2, axis=0) for span in spans(len(run.time)))
        samples += len(run.time)
    # joints at rest may have no current
    driven = [
        (float(rms), joint)
        for joint, rms in zip(runs[0].joints, np.sqrt(squares / samples), strict=True)
        if joint not in base and rms > 0
    ]
    found = []
    if driven and max(driven)[0] > LARGEST_CURRENT:
        rms, joint = max(driven)
        what = f"the current of joint '{joint}' is {rms:.4g} A rms, more than drives of robots take"
        found.append(Note(Kind.UNIT, what, "if it is in mA, say so (units: {current: mA})", joint=joint))
    for (small, below), (large, above) in pairwise(sorted(driven)):
        if large > CURRENTS_APART * small:
            what = (
                f"the current of joint '{above}' is {large / small:.3g} times that of '{below}' "
                f"({large:.3g} and {small:.3g} A rms)"
            )
            action = "check that the columns are in the same unit (A, mA, % or counts), and convert those that are not"
            found.append(Note(Kind.UNIT, what, action, joint=above))
    return found

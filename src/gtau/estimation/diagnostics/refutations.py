"""Descriptions of robot and logs that explain the data better than the user's."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from gtau.estimation.diagnostics.examine import Examination
from gtau.estimation.diagnostics.gains import JudgedGain
from gtau.estimation.diagnostics.verdict import contradiction, motors, which_payload, wrenches_first
from gtau.estimation.effects.effect import RELATIVE, EstimatedEffect
from gtau.estimation.effects.known.torque_scale import EFFECT as TORQUE_SCALE
from gtau.estimation.effects.known.wrenches import WRENCH_OFFSETS, WRENCH_POINTS
from gtau.estimation.estimators.estimator import Fit
from gtau.findings import Finding
from gtau.findings.words import MOST_PERCENT, percent

OTHER_SCALE = 0.2  # other scale of one joint's torques, beyond three standard deviations, that contradicts them

ALL_NEGATIVE, REFUTED = "all gains negative", "description refuted"


def all_negative(
    fit: Fit, examined: Examination, gains: Sequence[JudgedGain], prior_gains: Mapping[str, float]
) -> Iterator[Finding]:
    """Find that all gains are negative, if no motor is known to turn against its joint: then all may."""
    problem = fit.system.problem
    free = [gain.value for gain in gains if problem.unknown_gains[gain.row - problem.gain_rows.start]]
    turned = any(all(move < -100 for move in part.moves.values()) for part in examined.refits)  # by another gravity
    if min(prior_gains.values(), default=1.0) > 0 and max(free, default=0.0) < 0 and not turned:
        advice = wrenches_first(fit, f"check the sign of the currents and positions, gravity{which_payload(fit)}")
        yield contradiction(ALL_NEGATIVE, motors(fit), "all drive gains are negative", advice)


def refuted_descriptions(
    fit: Fit, examined: Examination, gains: Iterable[JudgedGain], accuracy: float
) -> Iterator[Finding]:
    """Find descriptions that explain the data better, and move a gain by more than the accuracy."""
    gains = [gain for gain in gains if gain.random_half < 1]  # a gain that is noise refutes nothing
    for part in examined.contradicting:
        for gain in gains:
            move = part.moves[gain.joint] / 100
            if abs(move) > accuracy:
                turned = ", which reverses its sign" if -MOST_PERCENT / 100 < move < -1 else ""
                text, own = f"{explained_share(part)} and move the gain by {{own}}", percent(move, "+.2g") + turned
                yield refuted(fit, part, (gain.joint,), text, own)


def refuted_with_given_gains(fit: Fit, examined: Examination, wrong: Sequence[Finding]) -> Iterator[Finding]:
    """Find descriptions that explain the data better, and better than ``wrong`` values of payloads do."""
    best = min((finding.values["remains"] for finding in wrong), default=1.0)
    for part in examined.contradicting:
        harmless = part.effect == TORQUE_SCALE.name and abs(part.size) - 3 * part.std <= OTHER_SCALE
        if not harmless and part.cause.values.get("remains", 0.0) < best:
            yield refuted(fit, part, part.cause.joints or motors(fit), explained_share(part))


def explained_share(part: EstimatedEffect) -> str:
    """Say what another description explains, with its size."""
    size = ""
    if part.unit:
        size = f" ({percent(part.size)} of itself)" if part.unit == RELATIVE else f" ({part.size:z.2g} {part.unit})"
    return f"{part.subject}{size} would explain {percent(part.share, '.0f')} of the residual variance"


def refuted(fit: Fit, part: EstimatedEffect, joints: tuple[str, ...], text: str, own: str = "") -> Finding:
    """Find, against the gains of some joints, that another description explains the data better."""
    kind, advice = part.cause.kind, part.cause.advice
    if kind not in (WRENCH_OFFSETS.name, WRENCH_POINTS.name):
        advice = wrenches_first(fit, advice)
    return contradiction(REFUTED, joints, text, advice, causes=(kind,), own=own)


def small_refutations(examined: Examination, gains: Sequence[JudgedGain], accuracy: float) -> Iterator[Finding]:
    """Note parts of the description that the data refute without moving any gain by more than the accuracy."""
    least = min((gain.half for gain in gains), default=np.inf)
    for part in examined.contradicting:
        if (move := part.largest_move / 100) <= accuracy:
            yield Finding(
                "description refuted, gains unmoved",
                causes=(part.cause.kind,),
                size=move / least,
                text=f"{part.subject} would explain {percent(part.share, '.0f')} of the residual variance and move no "
                f"gain by more than {percent(move)}",
                advice=part.cause.advice,
                shown_as="model",
            )

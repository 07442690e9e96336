"""A result as a table to read, in the manner of statsmodels."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence

import numpy as np

from gtau.estimation.diagnostics.verdict import Outcome
from gtau.estimation.estimators.physical_consistency import Consistency
from gtau.estimation.estimators.registry import ESTIMATORS
from gtau.estimation.results.estimate import Estimate, PayloadEstimate
from gtau.estimation.results.identified_model import IdentifiedModel
from gtau.estimation.results.singularity_distances import NearestPose
from gtau.estimation.thresholds import INFLATED

WIDTH = 96
MOVED = 0.5  # standard deviations: a smaller move is not worth a line
LISTED = 12
UNTOLD = 1000.0  # per cent: of a larger deviation the value says nothing
VISIBLE = 0.01  # per cent: a smaller torque error is rounding
ONLY_IN_SUMS = "  * known only in sums with others: the torques need it, but its own value cannot be told"
TYPES = {1: "serial", 2: "parallel"}
OF_TORQUES = " (the logs hold torques, whose gain is 1)"


def summary(result: IdentifiedModel) -> str:
    """Drive gains, payloads, essential parameters, fit and notes, as text."""
    preparation = result.preparation
    low_pass = "none" if preparation.cutoff is None else f"{preparation.cutoff:.3g} Hz"
    lines = [
        "=" * WIDTH,
        f"Robot     {result.robot.name}",
        f"Method    {ESTIMATORS[result.method].description}{OF_TORQUES if result.kind == 'torque' else ''}",
        *textwrap.wrap(f"Runs      {', '.join(result.runs)}", WIDTH, subsequent_indent=" " * 10),
        *([f"Payload   on '{result.robot.tool}'"] if result.payloads else []),
        f"Signals   bandwidth {preparation.bandwidth:.3g} Hz, position filter {low_pass}, "
        f"decimation {preparation.decimator.factor} ({preparation.decimator.kind})",
        "=" * WIDTH,
    ]
    lines += [
        f"{'Drive gains':<26}{'value':>12}{'std':>10}{'std %':>8}   {'unit':<9}{'delay, ms':>11}{'std':>8}   verdict"
    ]
    for joint, gain in result.drive_gains.items():
        value, std = result.delays[joint].value, result.delays[joint].std
        told = result.delays[joint].verdict.outcome == Outcome.GOOD
        shown = f"{1e3 * (value or 0.0):.3f}" if told else "cannot tell"
        delay = f"{shown:>11}{'' if std is None else f'{1e3 * std:.2g}':>8}"
        lines.append(f"{_row(joint, gain)}   {gain.unit:<9}{delay}   {gain.verdict.outcome}")
    for payload in result.payloads:
        lines += ["-" * WIDTH, *payload_lines(payload)] if set(payload.parameters) - payload.known else []
    if result.friction:
        lines += ["-" * WIDTH, f"{'Further friction (BIC)':<26}{'value':>12}{'std':>10}{'std %':>8}   unit"]
        lines += [f"{_row(each.name, each)}   {each.unit}" for each in result.friction.values()]
    left_out = len(result.parameters) - len(result.essential)
    listed = [each for each in result.essential.values() if (each.rel_std or 0.0) <= UNTOLD]
    untold = len(result.essential) - len(listed)
    lines += [
        "-" * WIDTH,
        f"{'Essential parameters':<26}{'value':>12}{'std':>10}{'std %':>8}   unit",
        *(f"{_row(each.name, each)}   {each.unit}{_mark(each)}" for each in listed),
        *([ONLY_IN_SUMS] if any(map(_mark, listed)) else []),
        *([f"  and {untold} more, known only in sums with others: deviations over {UNTOLD:g} %"] if untold else []),
        f"  {left_out} of {len(result.parameters)} base parameters were cancelled, by which the worst joint's torque "
        f"errors {_growth(result.statistics['reduction_loss'])};",
        "  model.json has all, and what each one that ends in R regroups.",
        "-" * WIDTH,
        f"{'Torque fit':<26}{'error rms':>12}{'signal':>10}{'error %':>8}   unit",
    ]
    lines += [
        f"  {each.joint:<24}{each.rms:>12.4g}{each.signal:>10.4g}{each.relative:>8.2f}   {each.unit}"
        for each in result.residuals
    ]
    lines += singularity_lines(result.singularities)
    if result.consistency is not None:
        lines += ["-" * WIDTH, *_consistency_lines(result.consistency)]
    if "singular_ratio" in result.statistics:
        lines.append(f"  ratio of the two smallest singular values of W_tot: {result.statistics['singular_ratio']:.2f}")
    lines += ["=" * WIDTH, *_notes([*remarks(result), *result.notes])]
    return "\n".join(line.rstrip() for line in lines)


def payload_lines(payload: PayloadEstimate) -> list[str]:
    """One payload as lines of a table."""
    head = f"Payload '{payload.name}' of {payload.run}"
    lines = [head, f"{'':<26}{'value':>12}{'std':>10}{'std %':>8}   unit"]
    for kind, each in payload.parameters.items():
        known = "known" if kind in payload.known else each.regrouping if each.regrouping != kind else ""
        lines.append(f"{_row(kind, each)}   {each.unit:<10}{known}".rstrip())
    return lines


def singularity_lines(nearest: Sequence[NearestPose]) -> list[str]:
    """Where the runs come nearest to singularities of each type, one line a type."""
    lines = ["-" * WIDTH, f"{'Singularities':<26}{'nearest':>12}   (1 at best, 0 at one)"] if nearest else []
    for kind, name in TYPES.items():
        if chosen := [each for each in nearest if each.type == kind]:
            worst = min(chosen, key=lambda each: each.distance)
            lines.append(f"  {f'type {kind} ({name})':<24}{worst.distance:>12.3g}   {worst.run}, {worst.time:.4g} s")
    return lines


def _consistency_lines(found: Consistency) -> list[str]:
    """What rigid bodies make of the estimates: the moves worth a line, and what it costs."""
    moved = [move for move in found.moves if move.deviations >= MOVED]
    lines = [f"{'Physically consistent':<26}{'free':>12}{'consistent':>12}{'moved, std':>12}"]
    gains = [f"gain_{joint}" for joint in found.gains]
    shown = [move for move in moved if move.name not in gains][:LISTED]
    shown += [move for name in gains for move in found.moves if move.name == name]
    lines += [f"  {m.name:<24}{m.free:>12.5g}{m.consistent:>12.5g}{m.deviations:>12.2f}" for m in shown]
    joint = max(found.loss, key=lambda name: found.loss[name])
    together = 100 * (np.sqrt(np.mean([(1 + loss / 100) ** 2 for loss in found.loss.values()])) - 1)
    lines += [
        f"  {len(moved)} of {len(found.moves)} moved by {MOVED:g} standard deviations or more;",
        f"  torque errors {_growth(together)}, those of the worst joint, {joint}, {_growth(found.loss[joint])}.",
    ]
    lines.append("  model.json has every standard parameter under 'standard'; what the data leave open was chosen.")
    return lines


def _row(name: str, estimate: Estimate) -> str:
    value = "cannot tell" if estimate.value is None else f"{estimate.value:.5g}"
    std = "" if estimate.std is None else f"{estimate.std:.2g}"
    percent = estimate.rel_std
    relative = "" if percent is None else f"{percent:.2f}" if percent < UNTOLD else f"> {UNTOLD:g}"
    return f"  {name:<24}{value:>12}{std:>10}{relative:>8}"


def _mark(estimate: Estimate) -> str:
    return "   *" if (estimate.rel_std or 0.0) > 100 else ""


def _growth(loss: float) -> str:
    """By how much torque errors grow, ``loss`` in per cent."""
    return "do not grow" if loss < VISIBLE else f"grow by {loss:.2g} %"


def remarks(result: IdentifiedModel) -> list[str]:
    """What is not good, and what to do about it; one sentence for all joints that share it."""
    shared: dict[str, list[str]] = {}
    for joint, gain in result.drive_gains.items():
        if gain.verdict.why:
            shared.setdefault(gain.verdict.sentence, []).append(f"'{joint}'")
    sentences = [f"drive gain of {', '.join(joints)} {sentence}" for sentence, joints in shared.items()]
    for payload in {each.name: each for each in result.payloads}.values():
        if payload.verdict.outcome != Outcome.GOOD:
            sentences.append(f"payload '{payload.name}' {payload.verdict.sentence}")
    lack = result.statistics["lack_of_fit"]
    if lack > INFLATED and any(each.relative > VISIBLE for each in result.residuals):
        sentences.append(
            f"the errors hang together in time (by that alone deviations are {lack:.1f} times those of noise), so the "
            "model lacks something: friction of another kind, ripple of the motors, cables, elasticity. What does the "
            "same in all runs may shift the estimates by more than their deviations"
        )
    masses = {each.name for each in result.payloads if "m" in each.known}
    estimated = any(gain.std is not None for gain in result.drive_gains.values())
    if len(masses) == 1 and estimated:
        sentences.append(
            f"all gains scale with the mass given for payload '{masses.pop()}': a wrong one cannot be noticed "
            "with a single known "
            "payload, only with a second one of another mass"
        )
    turning = any(result.robot.joint(joint).kind == "revolute" for joint in result.drive_gains)
    if estimated and turning and not result.robot.closures:
        sentences.append(
            "the gains of an arm scale with its lengths too, up to twice as much, and its data seldom show a wrong "
            "one: measure the lengths of the robot file"
        )
    lost = [name for name, each in result.parameters.items() if each.value is None]
    if lost:
        sentences.append(
            f"these motions cannot tell {', '.join(lost)} from the parameters listed before them: no value is "
            "given; add runs that "
            "move all joints in other ways"
        )
    return sentences


def _notes(notes: Iterable[str]) -> list[str]:
    lines: list[str] = []
    for note in notes:
        lines += textwrap.wrap(f"- {note}", WIDTH, subsequent_indent="  ")
    return lines

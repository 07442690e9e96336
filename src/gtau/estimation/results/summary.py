"""A result as a table to read, in the manner of statsmodels."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gtau.estimation.diagnostics.sentences import percent_text
from gtau.estimation.diagnostics.verdict import Outcome
from gtau.estimation.estimators.physical_consistency import Consistency
from gtau.estimation.estimators.registry import ESTIMATORS
from gtau.estimation.grades import by_grade
from gtau.estimation.regression.friction import TEMPERATURE_TERMS
from gtau.estimation.results.estimate import Estimate, PayloadEstimate, TorqueError
from gtau.estimation.results.geometry_text import geometry_lines
from gtau.estimation.results.headline import headline
from gtau.estimation.results.identified_model import IdentifiedModel
from gtau.estimation.results.remarks import VISIBLE, findings
from gtau.estimation.results.scale_text import all_sources, scale_lines
from gtau.estimation.results.singularity_distances import NearestPose
from gtau.estimation.thresholds.estimates import ACCURACY
from gtau.model.base_parameters import whole_mass
from gtau.signals.notes import Note

WIDTH = 80
NOTES = 5  # that the short summary shows
MOVED = 0.5  # standard deviations: a smaller move is not worth a line
LISTED = 12
NOT_SHOWN = 1000.0  # per cent: with a larger standard deviation the value is not shown
ONLY_IN_SUMS = "  * known only in sums with others: its own value is not identifiable"
TYPES = {1: "serial", 2: "parallel"}
OF_TORQUES = " (the logs hold torques, whose gain is 1)"


def summary(result: IdentifiedModel) -> str:
    """Print drive gains, payloads, essential parameters, fit and notes."""
    preparation = result.preparation
    low_pass = "none" if preparation.cutoff is None else f"{preparation.cutoff:.3g} Hz"
    lines = [
        "=" * WIDTH,
        *_paragraph(headline(result)),
        "=" * WIDTH,
        f"Robot     {result.robot.name}",
        f"Method    {ESTIMATORS[result.method].description}{OF_TORQUES if result.kind == 'torque' else ''}",
        *textwrap.wrap(f"Runs      {', '.join(result.runs)}", WIDTH, subsequent_indent=" " * 10),
        *([f"Payload   on '{result.robot.tool}'"] if result.payloads else []),
        *textwrap.wrap(
            f"Signals   bandwidth {preparation.bandwidth:.3g} Hz, position filter {low_pass}, decimation "
            f"{preparation.decimator.factor} ({preparation.decimator.kind})"
            + (f"; by hand: {', '.join(preparation.given)}" if preparation.given else ""),
            WIDTH,
            subsequent_indent=" " * 10,
        ),
        "=" * WIDTH,
    ]
    lines += [*gain_lines(result), *sensor_lines(result)]
    for payload in result.payloads:
        lines += ["-" * WIDTH, *payload_lines(payload)] if set(payload.parameters) - payload.known else []
    if result.friction:
        lines += ["-" * WIDTH, f"{'Further friction (BIC)':<26}{'value':>12}{'std':>10}{'std %':>8}   unit"]
        lines += [f"{_row(each.name, each)}   {each.unit}" for each in result.friction.values()]
        lines += reference_lines(result)
    left_out = sum(not each.essential for each in result.parameters.values())
    essential = result.essential
    listed = [each for each in essential.values() if (each.rel_std or 0.0) <= NOT_SHOWN]
    hidden = len(essential) - len(listed)
    lines += [
        "-" * WIDTH,
        f"{'Essential parameters':<26}{'value':>12}{'std':>10}{'std %':>8}   unit",
        *(f"{_row(each.name, each)}   {each.unit}{_mark(each)}" for each in listed),
        *([ONLY_IN_SUMS] if any(map(_mark, listed)) else []),
        *(
            [f"  and {hidden} more, known only in sums with others: standard deviations over {NOT_SHOWN:g} %"]
            if hidden
            else []
        ),
        *textwrap.wrap(
            f"The other {left_out} of {len(result.parameters)} base parameters are not essential: without them the "
            f"worst joint's torque errors {_growth(result.statistics['reduction_loss'])}.",
            WIDTH,
            initial_indent="  ",
            subsequent_indent="  ",
        ),
        "-" * WIDTH,
        f"{'Torque fit':<26}{'error rms':>12}{'signal':>10}{'error %':>8}   unit",
    ]
    lines += [_fit_row(each) for each in result.residuals]
    lines += singularity_lines(result.singularities)
    if result.geometry is not None:
        lines += ["-" * WIDTH, *geometry_lines(result.geometry)]
    if result.consistency is not None:
        lines += ["-" * WIDTH, *_consistency_lines(result.consistency)]
    if "singular_ratio" in result.statistics:
        lines.append(f"  ratio of the two smallest singular values of W_tot: {result.statistics['singular_ratio']:.2f}")
    lines += ["=" * WIDTH, *findings_lines(findings(result))]
    return "\n".join(line.rstrip() for line in lines)


def short_summary(result: IdentifiedModel) -> str:
    """Print what can be believed, drive gains, payloads, fit and the notes that matter most: one screen of text."""
    lines = ["=" * WIDTH, *_paragraph(headline(result)), "=" * WIDTH, *gain_lines(result)]
    for payload in result.payloads:
        lines += [*payload_lines(payload, only=("m",))] if "m" in set(payload.parameters) - payload.known else []
    if result.residuals:
        best, worst = (chosen(result.residuals, key=lambda each: each.relative) for chosen in (min, max))
        lines += [
            "-" * WIDTH,
            f"Torque residuals: {best.relative:.2f} to {worst.relative:.2f} % rms, the largest at '{worst.joint}'.",
        ]
    if result.consistency is not None:
        lines.append(f"Physically consistent parameters: torque residuals {_growth(_overall(result.consistency))}.")
    notes = findings(result)
    lines += ["=" * WIDTH, *findings_lines(notes, NOTES)]
    more = len(same_in_several(notes)) - NOTES
    lines.append(
        (f"{more} more notes, all" if more > 0 else "All")
        + " parameters and the fit of each joint: --verbose, or model.json."
    )
    return "\n".join(line.rstrip() for line in lines)


def reference_lines(result: IdentifiedModel) -> list[str]:
    """Print the temperatures to which the friction parameters refer, where friction depends on them."""
    warm = result.temperatures
    if warm is None or not any(name.split("_", 1)[0] in TEMPERATURE_TERMS for name in result.friction):
        return []
    listed = ", ".join(f"'{joint}' {value:.4g}" for joint, value in warm.of_joint.items())
    same = len(set(warm.of_joint.values())) == 1
    at = f"{next(iter(warm.of_joint.values())):.4g}" if same else listed
    words = f"fvt, fst: viscous and Coulomb friction per {warm.per} above the mean, {at} {warm.unit}"
    return textwrap.wrap(words, WIDTH, initial_indent="  ", subsequent_indent="  ")


def _paragraph(text: str) -> list[str]:
    """Wrap a text so that no number is separated from its per cent sign."""
    return [line.replace("\xa0", " ") for line in textwrap.wrap(text.replace(" %", "\xa0%"), WIDTH)]


def gain_lines(result: IdentifiedModel) -> list[str]:
    """Print drive gains as lines of a table: value, 95 % interval with its two parts, delay and verdict."""
    if all(gain.std is None for gain in result.drive_gains.values()):
        return [
            f"{'Drive gains (given)':<24}{'value':>10}   unit",
            *(
                f"  {joint:<22}{gain.value or 0.0:>10.5g}   {gain.unit:<8} {gain.verdict.outcome}"
                for joint, gain in result.drive_gains.items()
            ),
        ]
    lines = [f"{'Drive gains':<22}{'value':>8} {'unit':<6}{'+-95 %':>8}{'random':>8}{'model':>8}{'delay':>9} verdict"]
    accuracy = 100 * result.statistics.get("accuracy", ACCURACY)
    for joint, gain in result.drive_gains.items():
        delay = result.delays[joint]
        shown = (
            f"{1e3 * delay.value:.1f} ms" if delay.verdict.outcome == Outcome.GOOD and delay.value is not None else "-"
        )
        half = "" if gain.half_width is None else _percent(gain.half_width, accuracy)
        parts = (_relative(gain, gain.random_std), _relative(gain, gain.model_std))
        random, model = ("" if part is None else _percent(part) for part in parts)
        lines.append(
            f"  {joint[:20]:<20}{gain.value or 0.0:>8.5g} {gain.unit:<6}{half:>8}{random:>8}{model:>8}{shown:>9} "
            f"{gain.verdict.outcome}"
        )
    lines.append("  +-95 %: half the interval; random, model: standard deviations, % of the gain")
    found = all_sources(result)
    lines += _wrapped(f"  scale: from {found}", "    ") if found else []
    return [*lines, *_mass_lines(result)]


def _mass_lines(result: IdentifiedModel) -> list[str]:
    """Tell what a floating robot weighs, the one figure that everyone can check on a scale."""
    if not result.robot.floating:
        return []
    mass = result.parameters.get(whole_mass(result.base, result.model.parameter_names))
    interval = None if mass is None else mass.interval()
    if mass is None or mass.value is None or interval is None:
        return []
    return [f"  mass of the whole robot ({mass.name}): {mass.value:.4g} +- {(interval[1] - interval[0]) / 2:.2g} kg"]


def _wrapped(text: str, indent: str) -> list[str]:
    return textwrap.wrap(text, WIDTH, subsequent_indent=indent)


def sensor_lines(result: IdentifiedModel) -> list[str]:
    """Tabulate the torque sensors as text: what each gain rests on, and the estimates of the sensors."""
    lines = [line for text in scale_lines(result) for line in _wrapped(text, "  ")]
    if not result.sensors:
        return ["-" * WIDTH, *lines] if len(lines) > 1 else []
    lines = ["-" * WIDTH, *(lines if len(lines) > 1 else [])]
    lines.append(f"{'Torque sensors':<26}{'value':>12}{'std':>10}{'std %':>8}   unit")
    for each in result.sensors:
        lines += [f"{_row(name, estimate)}   {estimate.unit}" for name, estimate in each.parameters.items()]
        if each.ratio is not None:
            lines.append(f"{_row(f'ratio_{each.joint}', each.ratio)}   {each.ratio.unit}")
    if any(each.ratio is not None for each in result.sensors):
        lines.append("  ratio: torque from all other data, over the sensor's reading")
    lines.append(f"{'Sensor fit':<26}{'error rms':>12}{'signal':>10}{'error %':>8}   unit")
    return lines + [_fit_row(each.residual) for each in result.sensors]


def _fit_row(each: TorqueError) -> str:
    return f"  {each.joint:<24}{each.rms:>12.4g}{each.signal:>10.4g}{each.relative:>8.2f}   {each.unit}"


def _percent(part: float, accuracy: float | None = None) -> str:
    """Print a share in at most seven characters."""
    return f">{NOT_SHOWN:g} %" if part > NOT_SHOWN else f"{percent_text(part, accuracy)} %"


def _relative(gain: Estimate, std: float | None) -> float | None:
    return None if std is None or not gain.value else 100 * std / abs(gain.value)


def payload_lines(payload: PayloadEstimate, only: Sequence[str] = ()) -> list[str]:
    """Print one payload as lines of a table; with ``only`` some kinds of parameters."""
    head = f"Payload '{payload.name}' of {payload.run}"
    lines = [head, f"{'':<26}{'value':>12}{'std':>10}{'std %':>8}   unit"]
    for kind, each in payload.parameters.items():
        if only and kind not in only:
            continue
        known = "known" if kind in payload.known else each.regrouping if each.regrouping != kind else ""
        lines.append(f"{_row(kind, each)}   {each.unit:<10}{known}".rstrip())
    return lines


def singularity_lines(nearest: Sequence[NearestPose]) -> list[str]:
    """Print where the runs come nearest to singularities of each type, one line a type."""
    lines = ["-" * WIDTH, f"{'Singularities':<26}{'nearest':>12}   (1 at best, 0 at one)"] if nearest else []
    for kind, name in TYPES.items():
        if chosen := [each for each in nearest if each.type == kind]:
            worst = min(chosen, key=lambda each: each.distance)
            lines.append(f"  {f'type {kind} ({name})':<24}{worst.distance:>12.3g}   {worst.run}, {worst.time:.4g} s")
    return lines


def _consistency_lines(found: Consistency) -> list[str]:
    """Print what physical consistency changes: the moves worth a line, and its cost."""
    moved = [move for move in found.moves if move.deviations >= MOVED]
    lines = [f"{'Physically consistent':<26}{'free':>12}{'consistent':>12}{'moved, std':>12}"]
    gains = [f"gain_{joint}" for joint in found.gains]
    shown = [move for move in moved if move.name not in gains][:LISTED]
    shown += [move for name in gains for move in found.moves if move.name == name]
    lines += [f"  {m.name:<24}{m.free:>12.5g}{m.consistent:>12.5g}{m.deviations:>12.2f}" for m in shown]
    joint = max(found.loss, key=lambda name: found.loss[name])
    together = _overall(found)
    lines += [
        f"  {len(moved)} of {len(found.moves)} moved by {MOVED:g} standard deviations or more;",
        f"  torque errors {_growth(together)}, those of the worst joint, {joint}, {_growth(found.loss[joint])}.",
    ]
    lines.append("  model.json has every standard parameter under 'standard'; what the data leave open was chosen.")
    return lines


def _overall(found: Consistency) -> float:
    """Compute by how much the residuals of all joints together grow, per cent."""
    return float(100 * (np.sqrt(np.mean([(1 + loss / 100) ** 2 for loss in found.loss.values()])) - 1))


def _row(name: str, estimate: Estimate) -> str:
    value = "none" if estimate.value is None else f"{estimate.value:.5g}"
    std = "" if estimate.std is None else f"{estimate.std:.2g}"
    percent = estimate.rel_std
    relative = "" if percent is None else f"{percent:.2f}" if percent < NOT_SHOWN else f"> {NOT_SHOWN:g}"
    return f"  {name:<24}{value:>12}{std:>10}{relative:>8}"


def _mark(estimate: Estimate) -> str:
    return "   *" if (estimate.rel_std or 0.0) > 100 else ""


def _growth(loss: float) -> str:
    """Describe by how much torque errors grow, ``loss`` in per cent."""
    return "do not grow" if loss < VISIBLE else f"grow by {loss:.2g} %"


def findings_lines(notes: Sequence[Note], most: int | None = None) -> list[str]:
    """List notes by grade, the worst first, at most ``most`` of them."""
    lines: list[str] = []
    # paths stay in one piece
    whole_words = textwrap.TextWrapper(WIDTH, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False)
    left = len(notes) if most is None else most
    for grade, members in by_grade(same_in_several(notes)).items():
        shown, left = members[:left], max(left - len(members), 0)
        lines += [f"{grade.value.capitalize()}:"] if shown else []
        for note in shown:
            lines += whole_words.wrap(f"- {note}")
    return lines


def same_in_several(notes: Sequence[Note]) -> list[Note]:
    """Merge notes that say the same of several logs; they keep no time, as each log has its own."""
    groups: dict[tuple[str, str], list[Note]] = {}
    for note in notes:
        groups.setdefault((note.what, note.action), []).append(note)
    return [
        replace(group[0], source=", ".join(dict.fromkeys(each.source for each in group if each.source)), time=None)
        if len(group) > 1
        else group[0]
        for group in groups.values()
    ]

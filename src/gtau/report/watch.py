"""Show a watched robot: the table on the screen, and the report with the history of each joint."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from gtau.estimation.results.estimate import Estimate
from gtau.report.chart import Axis, Chart, Panel, Rule, Series
from gtau.report.page import Column, Kind, Page, Table, Text, page, section, table
from gtau.watch.state import Alarm, Entry, Explained
from gtau.watch.watch import Status, Watch

SAFETY = (
    "This is not a safety function: it detects wear and mistakes between logs and protects nobody. Keep the robot's "
    "own safety functions."
)
CHANGES = {
    "gain": ("drive gain", "check motor, belt and gear, then identify the robot again"),
    "load": ("load", "compare the mounted load with the payload set in the controller, and weigh it by 'gtau payload'"),
    "friction": ("friction", "check temperature, lubrication, brake and gear"),
    "zero": ("encoder zero", "check the encoder's zero against its mark, and the coupling"),
    "delay": ("delay of the current", "check the current logging and its filters"),
    "clock": ("clock of the log", "check the time stamps of the log"),
    "contact": ("contact", "check for cables and obstacles that touch the robot, and run the motion again"),
}
"""Kinds of changes, their words and remedies."""
KINDS = {
    "m": "payload, mass",
    "mx": "payload, first moment x",
    "my": "payload, first moment y",
    "mz": "payload, first moment z",
    "gain": "drive gain, relative",
    "zero": "encoder zero",
    "delay": "delay",
    "fv": "viscous friction",
    "fs": "Coulomb friction",
    "rms": "residual, logarithm",
}
STRONGEST = 12  # charts on a terminal
HEALTHY = 0.95  # probability of the bands of :meth:`Baseline.bands`
BY_CHANCE = 1e-3  # of as many charts outside their bands, independent ones; the words are a hint, not an alarm


def explained_words(explained: Explained) -> str:
    """Describe an explanation, with its interval."""
    kind, quantity, size, half = explained.kind, explained.quantity, explained.size, explained.half
    joint = f" of {explained.joint}" if explained.joint else ""
    if kind == "contact":
        return f"contact{joint} (residual {size:.3g} times less even than in any healthy log)"
    if kind == "gain":
        words = f"{100 * size:+.2g} ± {100 * half:.2g} %"
    elif kind in ("delay", "clock"):
        words = f"{1000 * size:+.3g} ± {1000 * half:.2g} ms"
    else:
        words = f"{size:+.3g} ± {half:.2g} {explained.unit}"
    more = "" if explained.relative is None else f", {100 * explained.relative:+.0f} % of the model's"
    which = {"fv": "viscous ", "fs": "Coulomb "}.get(quantity, "")
    part = f" (first moment {quantity[1]})" if quantity in ("mx", "my", "mz") else ""
    return f"{which}{CHANGES[kind][0]}{joint}{part} {words}{more}"


def alarm_words(alarm: Alarm) -> tuple[str, tuple[str, ...]]:
    """Describe the change, its beginning, and what to do."""
    span = alarm.since
    if alarm.earliest != alarm.latest:
        span += f" (between {alarm.earliest} and {alarm.latest})"
    if not alarm.explanations:
        return (
            f"The robot has changed since {span}; no single explanation fits.",
            (f"Largest changes: {', '.join(alarm.charts)}.", "Identify the robot again and compare both models."),
        )
    said = [explained_words(explained) for explained in alarm.explanations]
    several = "; these explanations cannot be distinguished" if len(said) > 1 else ""
    head = f"The robot has changed since {span}{several}: {'; or '.join(said)}."
    remedies = dict.fromkeys(CHANGES[explained.kind][1] for explained in alarm.explanations)
    points = [f"{remedy[0].upper()}{remedy[1:]}." for remedy in remedies]
    if len(said) > 1:
        points.append("A reference motion from 'gtau excite' distinguishes more causes than this motion.")
    points.append("After maintenance start a new baseline by --reset DATE.")
    return head, tuple(points)


def verdict_text(watch: Watch, entry: Entry | None) -> Text:
    """State whether the robot is the one that was identified."""
    rate = watch.settings
    promise = (
        f"False alarms: at most {rate.false_alarms:g} a year among {rate.robots} robot"
        f"{'s' * (rate.robots != 1)} with {rate.logs_per_year:g} logs a year each."
    )
    if watch.alarm is not None:
        head, points = alarm_words(watch.alarm)
        return Text(head, (*points, promise, SAFETY), "bad")
    if entry is None or "baseline" in (watch.phase, entry.phase):
        missing = max(rate.baseline - watch.count, 0)
        more = f"{missing} more are needed." if missing else "the next log is compared with it."
        words = f"Baseline of {watch.count} of {rate.baseline} healthy logs; {more}"
        return Text(words, (promise, SAFETY), "neutral")
    outside = _outside(watch, entry)
    if not outside:
        return Text(f"No change since the baseline, {watch.count} logs.", (promise, SAFETY), "good")
    words = (
        f"No alarm yet: {len(outside)} of {len(entry.values)} charts of the last log are outside their healthy range, "
        f"{outside[0]} the furthest. At this rate of false alarms that is not enough evidence; record another log."
    )
    return Text(words, (promise, SAFETY), "neutral")


def _outside(watch: Watch, entry: Entry) -> list[str]:
    """List the charts of a log outside their healthy 95 % bands, the furthest first; none if chance explains them."""
    from scipy.stats import binom

    low, high = watch.baseline.bands(HEALTHY)
    distances = {
        name: abs(entry.values[name] - mean) / width
        for name, mean, width in zip(watch.names, watch.baseline.mean, high - low, strict=True)
        if name in entry.values and np.isfinite(width)
    }
    outside = sorted((name for name in distances if distances[name] > 0.5), key=lambda name: -distances[name])
    return outside if binom.sf(len(outside) - 1, len(distances), 1 - HEALTHY) < BY_CHANCE else []


def watch_page(watch: Watch, last: Status | None, count: int | None = STRONGEST) -> Page:
    """Show the state after the last log: verdict and one table of the ``count`` charts that changed most, or of all."""
    entry = watch.recent[-1] if watch.recent else None
    return page(
        f"Watching {watch.model.robot.name}",
        section("Verdict", verdict_text(watch, entry), id="verdict"),
        None if last is None else section("Charts", *_charts(watch, last, count), id="charts"),
        lead=[] if entry is None else [f"Last log {entry.log} of {entry.date}."],
    )


def _charts(watch: Watch, last: Status, count: int | None) -> Iterator[Table | Text]:
    """Tabulate charts, explain the columns, and say what the motion does not show."""
    low, high = last.baseline.bands(HEALTHY)
    columns = (
        Column("chart", Kind.NAME),
        Column("this log", Kind.SPREAD, 3),
        Column("healthy, 95 %", Kind.INTERVAL),
        Column("e", Kind.NUMBER, decimals=1, most=1e6),
        Column("CUSUM", Kind.NUMBER, decimals=2),
    )
    rows: list[tuple[Any, ...]] = []
    faint = set()
    for k in sorted(range(len(last.charts)), key=lambda k: -last.evidences[k].log_e)[:count]:
        chart = last.charts[k]
        value = last.entry.values.get(chart.name)
        if value is None:
            continue
        band = (float(low[k]), float(high[k])) if np.isfinite(low[k]) else None
        strength = float(np.exp(min(last.evidences[k].log_e, 30.0)))
        if band is not None and band[0] <= value <= band[1] and strength < 10:
            faint.add(len(rows))
        name = chart.name if chart.kind == "rms" or chart.unit == "1" else f"{chart.name}, {chart.unit}"
        rows.append((name, (value, _half(last.entry, chart.name)), band, strength, float(last.cusums[k])))
    yield table(columns, rows, name="charts", faint=frozenset(faint))
    listed = ""
    if count is not None and len(last.charts) > count:
        listed = f"The {count} of {len(last.charts)} charts that changed most; all are in report.html. "
    yield Text(
        f"{listed}This log: value ± half a 95 % interval. e: e-detector; an alarm is raised if its mean over all "
        f"charts reaches {watch.limit:g}. CUSUM: over its limit for the same rate of false alarms."
    )
    if hidden := ", ".join(last.entry.not_shown):
        remedy = "A reference motion from 'gtau excite' shows them."
        yield Text(f"Not shown by this motion: {hidden}. {remedy}", style="soft")


def watch_report(watch: Watch, last: Status | None, entries: Sequence[Entry]) -> Page:
    """Add the history of each joint, with the bands of the baseline, and the events."""
    short = watch_page(watch, last, None)
    bands = dict(zip(watch.names, zip(*watch.baseline.bands(HEALTHY), strict=True), strict=True))
    alarms = [k for k, entry in enumerate(entries) if entry.alarm and (k == 0 or entries[k - 1].alarm is None)]
    resets = [k for k, entry in enumerate(entries) if entry.begins]
    rules = (*(Rule(x=k, label="reset") for k in resets), *(Rule(x=k, label="alarm") for k in alarms))
    events = []
    for k, entry in enumerate(entries):
        if k in resets:
            events.append((entry.date, entry.log, "a new baseline begins"))
        if k in alarms and entry.alarm is not None:
            events.append((entry.date, entry.log, alarm_words(entry.alarm)[0]))
    columns = (Column("date"), Column("log", Kind.NAME), Column("event"))
    sections = [section("Events", table(columns, events), id="events")] if events else []
    groups: dict[str, list[str]] = {}
    for name in watch.names:
        groups.setdefault(name.partition("_")[2], []).append(name)
    for joint, names in groups.items():
        names.sort(key=lambda name: list(KINDS).index(name.partition("_")[0]))
        shown = [name for name in names if any(name in entry.values for entry in entries)]
        panels = tuple(_history(name, entries, bands[name], rules) for name in shown)
        title = "payload" if joint == "load" else f"Joint {joint}"
        sections += [section(title, Chart(panels, columns=2))] if panels else []
    return Page(short.title, (*short.sections, *sections), short.lead)


def _half(entry: Entry, name: str) -> float:
    """Compute half the 95 % interval of a chart's value."""
    return Estimate(name, entry.values[name], entry.std[name], "").half_interval() or 0.0


def _history(name: str, entries: Sequence[Entry], band: tuple[float, float], rules: tuple[Rule, ...]) -> Panel:
    """Draw a chart from log to log, with 95 % intervals, in its healthy band."""
    logs = [(k, entry.values[name], _half(entry, name)) for k, entry in enumerate(entries) if name in entry.values]
    x, y, half = np.array(logs, dtype=float).reshape(-1, 3).T
    return Panel(
        Axis("log"),
        Axis(KINDS[name.partition("_")[0]]),
        (Series("", x, y, "predicted", "disc", half=half, upright=True),),
        rules=rules,
        band=band if np.isfinite(band[0]) else None,
        height=1.2,
    )

"""Show watched robots: the table on the screen, the report with dated trends, and one page for a fleet."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gtau.documents.files import in_order
from gtau.errors import GtauError
from gtau.report.chart import Axis, Chart, Panel, Rule, Series
from gtau.report.page import Column, Kind, Page, Table, Text, page, section, table
from gtau.watch.alarms import std_of_model, visible_changes
from gtau.watch.history import HISTORY, Alarm, Event, Explained, summary_of
from gtau.watch.quantities import Quantity
from gtau.watch.table import FEWEST_OF_WEEK, beyond, day_of, week_of
from gtau.watch.watch import Watch

SAFETY = (
    "This is not a safety function: it detects wear and mistakes between logs and protects nobody. Keep the robot's "
    "own safety functions."
)
CHANGES = {
    "gain": ("drive gain", "check motor, belt and gear, then identify the robot again"),
    "load": ("load", "compare the mounted load with the payload set in the controller, and weigh it by 'gtau payload'"),
    "friction": ("friction", "check temperature, lubrication, brake and gear"),
    "warming": ("friction of all joints", "check the temperature of robot and hall"),
    "zero": ("encoder zero", "check the encoder's zero against its mark, and the coupling"),
    "delay": ("lag of the current", "check the current logging and its filters"),
    "clock": ("lag of all currents", "check the time stamps of the log"),
    "units": ("scale of the current", "check units, signs and order of the columns of the log"),
    "contact": ("contact", "check for cables and obstacles that touch the robot, and run the motion again"),
}
"""Kinds of changes, their words and remedies."""
STATES = ("replace", "check", "baseline", "OK")  # those to look after first
REPLACED = ("gain", "friction")  # causes in drives, which are repaired or replaced where they are beyond tolerance
KINDS = {
    "m": ("load, mass", "kg", 1.0),
    "mx": ("load, first moment x", "kg m", 1.0),
    "my": ("load, first moment y", "kg m", 1.0),
    "mz": ("load, first moment z", "kg m", 1.0),
    "gain": ("drive gain", "%", 100.0),
    "friction": ("friction", "%", 100.0),
    "zero": ("encoder zero", "", 1.0),
    "delay": ("lag of the current", "ms", 1000.0),
    "rms": ("residual, logarithm", "1", 1.0),
}
"""Watched quantities: words, the unit in which they are shown, and its factor."""
DRAWN = 400  # points of a panel, beyond which days are averaged
SPREAD = 1.5  # times what nine of ten logs stay within, that a panel shows at least
EVENTS = {
    "reset": "a new baseline begins",
    "acknowledge": "acknowledged: the new reference",
    "forget": "forgotten",
    "repaired": "repaired: inside for a week",
    "refused": "set aside",
    "undone": "undone",
    "torn": "its last line was torn and is left out",
}


def explained_words(explained: Explained) -> str:
    """Describe a cause, with its interval."""
    kind, quantity, size, half = explained.kind, explained.quantity, explained.size, explained.half
    joint = f" of {explained.joint}" if explained.joint else ""
    if kind == "contact":
        return f"contact{joint} (residual {size:.3g} times less even than in any healthy log)"
    if kind in ("gain", "warming"):
        words = f"{100 * size:+.2g} ± {100 * half:.2g} %"
    elif kind in ("delay", "clock"):
        words = f"{1000 * size:+.3g} ± {1000 * half:.2g} ms"
    elif kind == "units":
        words = f"{size:.3g} times"
    else:
        words = f"{size:+.3g} ± {half:.2g} {explained.unit}"
    more = "" if explained.relative is None else f", {100 * explained.relative:+.0f} % of the model's"
    which = {"fv": "viscous ", "fs": "Coulomb "}.get(quantity, "") if kind == "friction" else ""
    part = f" (first moment {quantity[1]})" if quantity in ("mx", "my", "mz") else ""
    second = "" if explained.and_also is None else f" and {explained_words(explained.and_also)}"
    joint = joint or (" of all drives" if kind in ("gain", "units") else "")
    return f"{which}{CHANGES[kind][0]}{joint}{part} {words}{more}{second}"


def alarm_words(alarm: Alarm) -> tuple[str, tuple[str, ...]]:
    """Describe the change, its beginning, and what to do."""
    said = [explained_words(explained) for explained in alarm.explanations]
    listed = ", ".join(alarm.charts[:5])
    causes = "; or ".join(said) or "no cause fits"
    several = " (these causes cannot be distinguished)" if len(said) > 1 else ""
    if alarm.kind == "log":
        return (
            f"Log {alarm.since} is odd by itself and set aside ({listed}): {causes}{several}.",
            ("Repeat it; if the next log agrees, both count.", *_remedies(alarm)),
        )
    what = "is beyond its tolerances" if alarm.kind == "tolerance" else "has changed"
    return (
        f"The robot {what} since {alarm.date[:10]} ({alarm.since}): {causes}{several}.",
        (
            f"Quantities: {listed}.",
            *_remedies(alarm),
            "Once it is explained, accept it by --acknowledge NOTE; after maintenance begin anew by --reset DATE.",
        ),
    )


def _remedies(alarm: Alarm) -> list[str]:
    """List what to do about the causes."""
    causes = [cause for explained in alarm.explanations for cause in (explained, explained.and_also) if cause]
    remedies = dict.fromkeys(CHANGES[cause.kind][1] for cause in causes) or ["identify again and compare both models"]
    return [f"{remedy[0].upper()}{remedy[1:]}." for remedy in remedies]


def state_of(alarm: Alarm | None, events: Iterable[Event], complete: bool) -> str:
    """State a robot in one word; ``complete`` is whether its baseline is."""
    if alarm is None:
        refused = any(event.kind == "refused" for event in events)
        return "check" if refused else "OK" if complete else "baseline"
    worn = alarm.explanations and alarm.explanations[0].kind in REPLACED and alarm.explanations[0].joint
    return "replace" if alarm.kind == "tolerance" and worn else "check"


def verdict_text(watch: Watch) -> Text:
    """State whether the robot is the one that was identified."""
    rate = watch.settings
    fleet = f"{rate.robots} robots send" if rate.robots > 1 else "the robot sends"
    promise = (
        f"False alarms of changes: on average {rate.false_alarms:.3g} a year if {fleet} "
        f"{rate.logs_per_year:g} logs a year and healthy logs scatter as an autoregression of correlation up to 0.98 "
        "beside white noise; the evidence page says what was measured for other kinds of scatter."
    )
    if watch.alarm is not None:
        head, points = alarm_words(watch.alarm)
        return Text(head, (*points, promise, SAFETY), "bad")
    within = "Within tolerance of the model. " if watch.count >= FEWEST_OF_WEEK else ""
    if watch.phase == "baseline":
        words = f"{within}Baseline of {watch.count} of {rate.baseline} healthy logs."
        return Text(words, (promise, SAFETY), "neutral")
    return Text(f"{within}No change since the baseline, {watch.count} logs.", (promise, SAFETY), "good")


def watch_page(watch: Watch) -> Page:
    """Show the state after the last log: verdict, and each quantity against its tolerance."""
    begun = len(watch.view.ids) > 0
    return page(
        f"Watching {watch.model.robot.name}",
        section("Verdict", verdict_text(watch), id="verdict"),
        section("Quantities", *_quantities(watch), id="quantities") if begun else None,
        lead=[f"Last log {watch.entry.log} of {watch.entry.date}."] if begun else [],
    )


def _shown(quantity: Quantity) -> tuple[str, str, float]:
    """Give label, unit and factor in which a quantity is shown."""
    words, unit, factor = KINDS[quantity.kind]
    joint = f" of {quantity.joint}" if quantity.joint else ""
    return f"{words}{joint}", unit or quantity.unit, factor


def _quantities(watch: Watch) -> Iterator[Table | Text]:
    """Tabulate the last week of each quantity against its tolerance, and the smallest visible change."""
    view = watch.view
    week = week_of(view, std_of_model(watch.model, view))
    far, faint = beyond(view, week), set()
    hidden: list[str] = []
    rows: list[tuple[Any, ...]] = []
    changes = visible_changes(watch.model, watch.settings, view)
    for k in sorted(range(len(view.names)), key=lambda k: (not far[k], k)):
        label, unit, factor = _shown(view.quantities[k])
        if not np.isfinite(view.values[:, k]).any():
            hidden.append(label)
            continue
        mean, half = factor * (week[0][k] - view.reference[k]), factor * week[1][k]
        limit = None if np.isinf(view.tolerance[k]) else factor * float(view.tolerance[k])
        spread = (float(mean), float(half)) if np.isfinite(mean) else None
        if not far[k]:
            faint.add(len(rows))
        smallest = [float(factor * change) if np.isfinite(change) else None for change in changes[k]]
        rows.append((label, unit, spread, limit, *smallest))
    columns = (
        Column("quantity"),
        Column("unit"),
        Column("last week", Kind.SPREAD, 3),
        Column("tolerance", Kind.NUMBER, 3),
        Column("visible in a week", Kind.NUMBER, 2, missing="no"),
        Column("in a month", Kind.NUMBER, 2, missing="no"),
    )
    yield table(columns, rows, name="quantities", faint=frozenset(faint))
    yield Text(
        "Changes since the identification, or since they were acknowledged: mean of the last week ± half its 95 % "
        "interval. Beyond tolerance: the whole interval is outside. Visible: the smallest sudden change that would be "
        "found within a week and within a month of such logs."
    )
    if hidden:
        remedy = "A reference motion from 'gtau excite' shows them."
        yield Text(f"Not visible with this motion: {', '.join(hidden)}. {remedy}", style="soft")


def watch_report(watch: Watch) -> Page:
    """Add the history of each quantity with its tolerance, and the events."""
    short, view = watch_page(watch), watch.view
    columns = (Column("date"), Column("log", Kind.NAME), Column("event"))
    events = []
    for event in watch.events:
        words = EVENTS[event.kind] + (f": {event.note}" if event.note else "") + (" (undone)" if event.undone else "")
        events.append((event.date, event.subject, words))
    if watch.alarm is not None:
        events.append((watch.alarm.date, watch.alarm.since, alarm_words(watch.alarm)[0]))
    sections = [section("Events", table(columns, sorted(events)), id="events")] if events else []
    groups: dict[str, list[int]] = {}
    for k, quantity in enumerate(view.quantities):
        if np.isfinite(view.values[:, k]).any():
            groups.setdefault(quantity.joint, []).append(k)
    for joint, quantities in groups.items():
        panels = tuple(_history(watch, k) for k in quantities)
        sections.append(section(f"Joint {joint}" if joint else "Load", Chart(panels, columns=2)))
    return Page(short.title, (*short.sections, *sections), short.lead)


def _history(watch: Watch, k: int) -> Panel:
    """Draw a quantity over the dates of its logs within its tolerance; an outlier does not set the scale."""
    view = watch.view
    label, unit, factor = _shown(view.quantities[k])
    there = np.isfinite(view.values[:, k])
    days, y = view.days[there], factor * view.values[there, k]
    if len(days) > DRAWN:
        days, at = np.unique(np.floor(days), return_inverse=True)
        y = np.bincount(at, y) / np.bincount(at)
    ticks = np.unique(np.linspace(np.floor(days.min()), np.floor(days.max()), 4).round())
    part = slice(5, None) if np.ptp(days) < 300 else slice(7)  # month and day, or year and month
    dates = {float(day): str(np.datetime64(int(day), "D"))[part] for day in ticks}
    middle, tolerance = factor * float(view.reference[k]), factor * float(view.tolerance[k])
    spread = float(np.percentile(np.abs(y - middle), 90))
    reach = max(1.3 * tolerance if np.isfinite(tolerance) else 0.0, SPREAD * spread, 1e-9)
    outside = np.abs(y - middle) > reach
    drawn = np.clip(y, middle - reach, middle + reach)
    series = [Series("", days[~outside], drawn[~outside], "predicted", "disc")]
    if outside.any():
        series.append(Series("outside the panel", days[outside], drawn[outside], "measured", "diamond"))
    alarm = watch.alarm if watch.alarm is not None and view.names[k] in watch.alarm.charts else None
    return Panel(
        Axis("", names=dates),
        Axis(f"{label}, {unit}", limits=(middle - reach, middle + reach)),
        tuple(series),
        rules=() if alarm is None else (Rule(x=day_of(alarm.date), label="alarm"),),
        band=(middle - tolerance, middle + tolerance) if np.isfinite(tolerance) else None,
        height=1.8,
    )


def fleet_lines(folder: Path) -> list[dict[str, str]]:
    """Sum up each history in the folders of a folder, named as its robot, in a line of the page; raises GtauError."""
    lines = []
    for robot in in_order(path.parent for path in folder.glob(f"*/{HISTORY}")):
        settings, events, count, last = summary_of(robot)
        alarm = Alarm.model_validate_json(last.alarm) if last is not None and last.alarm else None
        what = ", ".join(event.subject for event in events if event.kind == "refused")
        if alarm is not None:
            what = "; or ".join(map(explained_words, alarm.explanations)) or f"no cause fits {', '.join(alarm.charts)}"
        state = state_of(alarm, events, count >= settings.baseline)
        line = {"robot": robot.name, "type": settings.robot, "state": state, "what": what}
        lines.append({**line, "since": alarm.date[:10] if alarm else "", "last log": last.date[:10] if last else ""})
    if not lines:
        raise GtauError(f"no folder in {folder} holds a history; give a folder of folders given as --out.")
    return sorted(lines, key=lambda line: (STATES.index(line["state"]), line["since"]))


def fleet_page(lines: Sequence[Mapping[str, str]]) -> Page:
    """List the robots of a fleet, those to look after first."""
    waiting = sum(line["state"] in STATES[:2] for line in lines)
    words = f"{waiting} of {len(lines)} robots need attention." if waiting else f"All {len(lines)} robots are OK."
    robots = table([Column(title) for title in lines[0]], [[*line.values()] for line in lines], name="robots")
    verdict = Text(words, (SAFETY,), "bad" if waiting else "good")
    return page("Watching a fleet", section("Verdict", verdict, id="verdict"), section("Robots", robots, id="robots"))

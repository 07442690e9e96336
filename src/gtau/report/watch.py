"""Show a watched robot, on a terminal and with dated trends in a report, and a watched fleet."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gtau.documents.files import in_order
from gtau.errors import GtauError, tidy
from gtau.report.chart import Axis, Chart, Panel, Rule, Series
from gtau.report.page import Column, Kind, Page, Section, Table, Text
from gtau.watch.alarms import FEWEST_OF_WEEK, beyond, power, visible_changes, week_of
from gtau.watch.history import HISTORY, Alarm, Event, History
from gtau.watch.statistics import SHOWN, Quantity, unseen_zeros
from gtau.watch.watch import Status, Watch

VISIBLE = (
    Column("visible in a week", Kind.NUMBER, 2, missing="no"),
    Column("in a month", Kind.NUMBER, 2, missing="no"),
    Column("grown slowly", Kind.NUMBER, 2, missing="no"),
)
"""Columns of :func:`visible_changes`."""
END = "Once explained, accept with --acknowledge NOTE; after maintenance start again with --reset DATE."
NO_SAFETY_FUNCTION = (
    "This is not a safety function: it detects wear and mistakes between logs and protects nobody. Keep the robot's "
    "own safety functions."
)
STATES = ("replace", "check", "baseline", "OK")  # the most urgent first
DRAWN = 400  # most points in a panel; more are averaged by day
SPREAD = 1.5  # least height of a panel, as a multiple of the range of nine in ten logs


def concerned(alarm: Alarm) -> list[str]:
    """List the quantities of an alarm at the joints that its causes name, or all where they name none."""
    joints = {part.joint or "load" for cause in alarm.explanations for part in cause.parts}
    return [name for name in alarm.charts if name.partition("_")[2] in joints] or [*alarm.charts]


def alarm_words(alarm: Alarm) -> tuple[str, tuple[str, ...]]:
    """Describe the change, its start, and what to do."""
    causes = "; or ".join(map(str, alarm.explanations)) or "no cause fits"
    if len(alarm.explanations) > 1:
        causes += " (these causes cannot be distinguished)"
    listed, day = ", ".join(concerned(alarm)[:5]), alarm.date[:10]
    advice = dict.fromkeys(part.advice for cause in alarm.explanations for part in cause.parts)
    to_do = [f"{remedy[0].upper()}{remedy[1:]}." for remedy in advice] or ["Identify again and compare both models."]
    if alarm.kind == "log":
        head = f"Log {alarm.since} is odd by itself and set aside ({listed}): {causes}."
        return head, ("Repeat it; if the next log agrees, both count.", *to_do)
    state = "been out of tolerance" if alarm.kind == "tolerance" else "changed"
    since = day if alarm.since == day else f"{day} ({alarm.since})"
    return f"The robot has {state} since {since}: {causes}.", (f"Quantities: {listed}.", *to_do, END)


def status_words(status: Status) -> str:
    """Describe the verdict on a log in one line."""
    healthy = "no change" if status.phase == "watching" else status.phase
    return tidy(f"{status.log}: {status.skipped or (alarm_words(status.alarm)[0] if status.alarm else healthy)}")


def state_of(alarm: Alarm | None, events: Iterable[Event], complete: bool) -> str:
    """Return the state of a robot in one word; ``complete`` if the baseline has enough logs."""
    if alarm is None:
        return "check" if any(event.kind == "refused" for event in events) else "OK" if complete else "baseline"
    worn = any(cause.kind in ("gain", "friction") and cause.joint for cause in alarm.explanations[:1])
    return "replace" if alarm.kind == "tolerance" and worn else "check"  # the drive


def verdict_text(watch: Watch) -> Text:
    """State whether the robot has changed since its identification."""
    settings = watch.settings
    head = "Within tolerance of the model. " if watch.count >= FEWEST_OF_WEEK else ""
    if watch.phase == "baseline":
        head += f"Baseline of {watch.count} of {settings.baseline} healthy logs."
    else:
        head += f"No change since the baseline, {watch.count} logs."
    done = [event for event in watch.events if event.kind == "acknowledge" and not event.undone]
    points = tuple(f"Accepted as reference since log {event.subject}: {event.note}." for event in done[-1:])
    if watch.alarm is not None:
        head, points = alarm_words(watch.alarm)
    send = f"{settings.robots} robots send" if settings.robots > 1 else "the robot sends"
    promise = (
        f"False alarms of changes: on average {settings.false_alarms_per_year:.3g} a year if {send} "
        f"{settings.logs_per_year:g} logs a year and healthy logs vary as assumed."
    )
    style: Any = "bad" if watch.alarm else "neutral" if watch.phase == "baseline" else "good"
    return Text(head, (*points, promise, NO_SAFETY_FUNCTION), style)


def watch_page(watch: Watch) -> Page:
    """Show the verdict after the last log, and each quantity against its tolerance."""
    begun = len(watch.view.values) > 0
    return Page(
        f"Watching {watch.model.robot.name}",
        Section("Verdict", verdict_text(watch), id="verdict"),
        Section("Quantities", *_quantities(watch), id="quantities") if begun else None,
        lead=[f"Last log: {' of '.join(dict.fromkeys((watch.status.log, watch.status.date)))}."] if begun else [],
    )


def _shown(quantity: Quantity) -> tuple[str, str, float]:
    return quantity.title, *SHOWN.get(quantity.unit, (quantity.unit, 1.0))


def _quantities(watch: Watch) -> Iterator[Table | Text]:
    """Tabulate the last week of each quantity, its tolerance and the smallest visible change."""
    view, visible = watch.view, visible_changes(watch.view)
    (mean, half), far = week_of(view), beyond(view)
    shown = np.isfinite(view.values).any(axis=0)

    def row(k: int) -> list[object]:
        name, unit, factor = _shown(view.quantities[k])
        week = (factor * (mean[k] - view.reference[k]), factor * half[k])
        sizes = ("-",) * len(VISIBLE) if watch.phase == "baseline" else factor * visible[k]
        return [name, unit, week if np.isfinite(week[0]) else None, factor * view.tolerance[k], *sizes]

    columns = (
        Column("quantity"),
        Column("unit"),
        Column("last week", Kind.SPREAD, 3),
        Column("tolerance", Kind.NUMBER, 3),
        *VISIBLE,
    )
    first, others = np.flatnonzero(shown & far), np.flatnonzero(shown & ~far)
    faint = frozenset(range(len(first), len(first) + len(others)))
    yield Table(columns, [row(k) for k in (*first, *others)], name="quantities-table", faint=faint)
    yield Text(
        "Changes since the identification, or since they were acknowledged: mean of the last week ± half its 95 % "
        "interval. Beyond tolerance: the total interval is outside. Visible: the smallest sudden change that would be "
        "found within a week and within a month of such logs, and the smallest that is found however slowly it grows. "
        "Friction: Coulomb and viscous together, at the mean speed; log: logarithm of the growth, 0.1 for 10 %."
    )
    yield from _hidden(watch)


def _hidden(watch: Watch) -> Iterator[Text]:
    """List the quantities that this motion does not show, and the encoder zeros that no motion shows."""
    unknown = ~np.isfinite(watch.view.values).any(axis=0)
    hidden = [watch.view.quantities[k] for k in np.flatnonzero(unknown)]
    unseen = unseen_zeros(watch.model) if hidden else ()
    never = [quantity for quantity in hidden if quantity.kind == "zero" and quantity.joint in unseen]
    if names := ", ".join(_shown(quantity)[0] for quantity in hidden if quantity not in never):
        advice = "Another motion, from 'gtau excite', may show them."
        yield Text(f"Not visible with this motion: {names}. {advice}", style="soft")
    if names := ", ".join(_shown(quantity)[0] for quantity in never):
        why = "To turn the whole robot about the vertical moves no torque; check the zero against its mark."
        yield Text(f"Visible with no motion: {names}. {why}", style="soft")


def power_rows(watch: Watch) -> list[dict[str, object]]:
    """List the smallest detectable change of each quantity; None if no change is detectable."""
    rows: list[dict[str, object]] = []
    for quantity, sizes in zip(watch.view.quantities, power(watch.view), strict=True):
        name, unit, factor = _shown(quantity)
        changes = [float(factor * size) if np.isfinite(size) else None for size in sizes]
        rows.append({"quantity": name, "unit": unit} | dict(zip(("week", "month", "slowly"), changes, strict=True)))
    return rows


def power_page(watch: Watch) -> Page:
    """Show how large faults must be for watching with this motion to find them."""
    rows = [[*row.values()] for row in power_rows(watch)]
    sizes = Table((Column("quantity"), Column("unit"), *VISIBLE), rows, name="power-table")
    note = Text(
        "The smallest change of each quantity that is found in nine of ten cases: a sudden one within a week and a "
        "month of logs of this motion, and one that grows slowly. Logs are assumed to scatter by the covariance of "
        "this log alone; real ones scatter more (temperature, load, wear), and then more is needed."
    )
    shown = Section("Power", sizes, note, *_hidden(watch), id="power")
    return Page(f"What watching {watch.model.robot.name} finds", shown)


def watch_report(watch: Watch) -> Page:
    """Show the verdict, the events, and the history of each quantity."""
    short, view, alarm = watch_page(watch), watch.view, watch.alarm
    events = [] if alarm is None else [(alarm.date, alarm.since, alarm_words(alarm)[0])]
    for event in watch.events:
        words = f"{event.kind}: {event.note}" if event.note else event.kind
        events.append((event.date, event.subject, words + " (undone)" * event.undone))
    columns = (Column("date"), Column("log", Kind.NAME), Column("event"))
    sections = [Section("Events", Table(columns, sorted(events)), id="events")] if events else []
    panels = defaultdict[str, list[Panel]](list)
    for k in np.flatnonzero(np.isfinite(view.logged).any(axis=0)).tolist():
        panels[view.quantities[k].joint].append(_history(watch, k))
    for joint, shown in panels.items():
        title, chart = f"Joint {joint}" if joint else "Load", Chart(tuple(shown), columns=2)
        sections.append(Section(title, chart, id=f"of-{joint or 'load'}"))
    return Page(short.title, *short.sections, *sections, lead=short.lead)


def _history(watch: Watch, k: int) -> Panel:
    """Draw the change of a quantity from its reference over dates; outliers do not set the scale."""
    view, alarm = watch.view, watch.alarm
    name, unit, factor = _shown(view.quantities[k])
    known = np.isfinite(view.logged[:, k])
    days, y = view.logs.days[known], factor * (view.logged[known, k] - view.reference[k])
    if len(days) > DRAWN:
        days, at = np.unique(np.floor(days), return_inverse=True)
        y = np.bincount(at, y) / np.bincount(at)
    ticks = np.unique(np.linspace(np.floor(days.min()), np.floor(days.max()), 4).round())
    part = slice(5, None) if np.ptp(days) < 300 else slice(7)  # month and day, or year and month
    dates = {float(day): str(np.datetime64(int(day), "D"))[part] for day in ticks}
    tolerance = factor * float(view.tolerance[k])
    band = (-tolerance, tolerance) if np.isfinite(tolerance) else None
    reach = max(SPREAD * float(np.percentile(np.abs(y), 90)), 1.3 * tolerance if band else 1e-9)
    outside, drawn = np.abs(y) > reach, np.clip(y, -reach, reach)
    series = [Series("", days[~outside], drawn[~outside], "predicted", "disc")]
    if outside.any():
        series.append(Series("outside the panel", days[outside], drawn[outside], "measured", "diamond"))
    begun = {view.logs.place(alarm): "alarm"} if alarm is not None and view.names[k] in concerned(alarm) else {}
    counted = np.isfinite(view.values[:, k])
    if counted.argmax() > known.argmax():
        begun[int(counted.argmax())] = "new start"
    return Panel(
        Axis("", names=dates),
        Axis(f"{name}, {unit}", limits=(-reach, reach)),
        tuple(series),
        rules=tuple(Rule(x=view.logs.days[row], label=label) for row, label in begun.items()),
        band=band,
        height=1.8,
    )


def fleet_lines(folder: Path) -> list[dict[str, str]]:
    """Summarise the history in a folder, or in each subfolder, named after its robot; raises GtauError."""
    lines = []
    for robot in in_order(path.parent for path in (*folder.glob(HISTORY), *folder.glob(f"*/{HISTORY}"))):
        history = History(robot)
        alarm, events, settings = history.alarm, history.events, history.settings
        what = ", ".join(event.subject for event in events if event.kind == "refused")
        if alarm is not None:
            what = "; or ".join(map(str, alarm.explanations)) or f"no cause fits {', '.join(alarm.charts)}"
        count, last = history.extent
        line = {"robot": robot.name, "type": settings.robot}
        line |= {"state": state_of(alarm, events, count >= settings.baseline), "what": what}
        lines.append({**line, "since": alarm.date[:10] if alarm else "", "last log": last[:10]})
    if not lines:
        raise GtauError(f"no folder in {folder} holds a history; give the folder above those given as --out.")
    return sorted(lines, key=lambda line: (STATES.index(line["state"]), line["since"]))


def fleet_page(lines: Sequence[Mapping[str, str]]) -> Page:
    """List the robots of a fleet, the most urgent first."""
    waiting = sum(line["state"] in STATES[:2] for line in lines)
    words = f"Robots that need attention: {waiting} of {len(lines)}." if waiting else f"All {len(lines)} robots are OK."
    robots = Table([Column(title) for title in lines[0]], [[*line.values()] for line in lines], name="robots-table")
    verdict = Text(words, (NO_SAFETY_FUNCTION,), "bad" if waiting else "good")
    return Page("Watching a fleet", Section("Verdict", verdict, id="verdict"), Section("Robots", robots, id="robots"))

"""Show the robot, its path, distances to singular poses, and logged poses."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import combinations

import numpy as np

from gtau.estimation.diagnostics.geometry import GeometryTest, percent
from gtau.estimation.results.conclusions import NEAR_SINGULAR
from gtau.estimation.results.estimate import NearestPose
from gtau.estimation.results.result import IdentifiedModel
from gtau.report.chart import Axis, Chart, Panel, Series, colour
from gtau.report.evidence import RunEvidence
from gtau.report.page import Column, Kind, Section, Table, Text, joint_label, table_of
from gtau.robots.parameter import position_unit
from gtau.robots.robot import Robot
from gtau.signals.run import Run
from gtau.signals.storage import rows_at

POSE_DELAY_STD = 0.02  # s; pose delays with a larger standard deviation are not shown

TYPES = {1: "type 1 (serial)", 2: "type 2 (parallel)"}
"""Names of the types of singularities."""
COLOURS = {1: "c7", 2: "c6"}  # not among the colours of six joints
PATHS = 8  # most paths in a chart
FLAT = 1e-6  # of the longest side; a path shorter than this along an axis is planar
POSES = 1500  # most poses in the path of a run
TIME = Axis("time from the start of the run, s")
STYLES = {"confirmed": "good", "other constants": "bad", "unexplained": "weak"}
LISTED = 12  # most constants in the table
ROUNDING = 1e-3  # of the rms; a smaller bias is shown as zero
ESTIMATED = {
    "controller": "Besides the constants, only the delay of the poses was estimated.",
    "tool": "The position of the tool on the body was estimated too.",
    "tracker": "The positions of the tracker (in each run) and its marker were estimated beside the constants.",
}


def motion_section(result: IdentifiedModel, runs: Sequence[RunEvidence]) -> Section:
    """Show the robot, the path of the body that carries the payload, and distances to singular poses."""
    used = any(run.used for run in runs)
    drawn = [run.run for run in runs if run.used == used][:PATHS]
    paths = [(run.name, body_path(result, run)) for run in drawn]
    title = f"Path of the frame of '{result.robot.tool}', the body that carries the payload"
    starts = {run.run.name: float(run.run.time[0]) for run in runs}
    along = zip(result.runs, result.distances, strict=False)  # empty for a loaded result
    distances = distances_panels((name, starts.get(name, 0.0), run) for name, run in along) if used else []
    return Section(
        "Robot and motion",
        result.robot,
        Section(title, paths_chart(paths)) if paths else None,
        singularities_section(result.singularities) if used else None,
        *(Section(panel.title, Chart((panel,), live=True), folded=k > 0) for k, panel in enumerate(distances)),
        id="robot",
    )


def joint_panels(
    robot: Robot, joints: Sequence[str], time: np.ndarray, values: np.ndarray, what: str, height: float, per: str = ""
) -> list[Panel]:
    """Draw a quantity (K, n) of joints over time, in one panel for rotations and one for translations."""
    lines: dict[str, list[Series]] = {"rad": [], "m": []}
    for j, joint in enumerate(joints):
        line = Series(joint_label(joint), time, values[:, j], colour(j))
        lines[position_unit(robot, joint)].append(line)
    axes = {unit: Axis(f"{what}, {unit}{per}") for unit in lines}
    return [Panel(TIME, axes[unit], tuple(series), height=height) for unit, series in lines.items() if series]


def singularities_section(nearest: Sequence[NearestPose]) -> Section | None:
    """Show the poses of runs nearest to singular poses."""
    if not nearest:
        return None
    listed = table_of(
        nearest,
        (Column("run"), "run"),
        (Column("singularity"), lambda pose: TYPES[pose.type]),
        (Column("nearest", Kind.NUMBER, 3), "distance"),
        (Column("at, s", Kind.NUMBER), "time"),
        (
            Column("pose, rad or m", wide=True),
            lambda pose: ", ".join(f"{j} {round(q, 3) + 0.0:.3g}" for j, q in pose.pose.items()),
        ),
    )
    words = "Reciprocal condition numbers: 1 at best, 0 at a singular pose."
    return Section("Distance to singular poses", listed, Text(words, style="soft"))


def distances_panels(runs: Iterable[tuple[str, float, np.ndarray]]) -> list[Panel]:
    """Draw distances to singular poses along runs, given as name, start (s) and distances."""
    panels = []
    for run, start, distances in runs:
        time = distances["time"] - start
        series = [
            Series(name, time, distances[f"type_{kind}"], COLOURS[kind], width=1.4)
            for kind, name in TYPES.items()
            if np.isfinite(distances[f"type_{kind}"]).any()
        ]
        if len(series) == len(TYPES):  # type 2 magnifies errors
            limit = np.full(len(time), NEAR_SINGULAR)
            series.append(Series(f"near: {NEAR_SINGULAR:g}", time, limit, "bad", width=0.8))
        axis = Axis("distance", limits=(0.0, 1.05))
        panels += [Panel(TIME, axis, tuple(series), run, height=1.4)] if series else []
    return panels


def paths_chart(paths: Sequence[tuple[str, np.ndarray]]) -> Chart:
    """Draw paths (P, 3), m, of runs by name, in three projections, or in their common plane."""
    panels = []
    extent = np.ptp(np.concatenate([path for _, path in paths]), axis=0)
    moving = [axis for axis in range(3) if extent[axis] > FLAT * extent.max()]
    for a, b in combinations(moving if len(moving) > 1 else range(3), 2):
        x, y = "xyz"[a], "xyz"[b]
        lines = [Series(name, path[:, a], path[:, b], colour(k), width=1.0) for k, (name, path) in enumerate(paths)]
        title = f"{x}-{y} plane of the base"
        panels.append(Panel(Axis(f"{x}, m"), Axis(f"{y}, m"), tuple(lines), title, height=2.4, equal=True))
    return Chart(tuple(panels), columns=3)


def body_path(result: IdentifiedModel, run: Run) -> np.ndarray:
    """Compute positions (P, 3), m, of the body that carries the payload along a run."""
    import casadi as ca

    from gtau.model.kinematics import frames

    model = result.idm
    run = run.ordered(model.actuated)
    shown = np.arange(0, len(run.time), -(-len(run.time) // POSES))
    c = model.path(np.ascontiguousarray(rows_at(run.position, shown).T))
    symbol = ca.SX.sym("c", model.layout.n_c)
    place = ca.Function("p", [symbol], [frames(model.layout, symbol)[result.robot.tool].p_0])
    return np.asarray(place(c)).T


# Logged poses and the geometry


def geometry_section(test: GeometryTest | None) -> Section | None:
    """Show residuals of the logged pose, and the constants that would explain them."""
    if test is None:
        return None
    points = [ESTIMATED[test.source]]
    delay, std = test.delay
    if std < POSE_DELAY_STD:
        points.append(f"the poses lag {1e3 * delay:.1f} ± {1.96e3 * std:.1g} ms behind the positions")
    runs = dict.fromkeys(residual.run for residual in test.residuals if residual.time.size)
    return Section(
        "Logged pose and geometry",
        Text(str(test.note), tuple(points), STYLES[test.outcome]),  # type: ignore[arg-type]
        *(Section(run, _traces(test, run), folded=k > 0) for k, run in enumerate(runs)),
        Section(f"Residuals of the pose of '{test.body}': logged less computed", _residuals(test), folded=False),
        Section(
            "Constants one at a time, sorted by the share of the residual variance they explain",
            _constants(test),
            Text(f"{len(test.tried) - LISTED} more explain less; model.json and --json list them.")
            if len(test.tried) > LISTED
            else None,
            Text(f"Not identifiable by this pose: {', '.join(test.unseen)}.") if test.unseen else None,
            folded=False,
        ),
        id="geometry",
    )


def _traces(test: GeometryTest, run: str) -> Chart:
    components = [residual for residual in test.residuals if residual.run == run]
    shown = {"logged less computed": "before"} | ({"with the change": "after"} if test.explained_by else {})
    lines: dict[str, list[Series]] = {f"{words}, m{unit}": [] for words in shown for unit in ("m", "rad")}
    for words, which in shown.items():
        for j, component in enumerate(components):
            values, name = 1e3 * getattr(component, which), f"{component.name}, {words}"
            lines[f"{words}, m{component.unit}"].append(Series(name, component.time, values, colour(j)))
    panels = [Panel(TIME, Axis(label), tuple(series), height=2) for label, series in lines.items() if series]
    return Chart(tuple(panels), run, live=True)


def _residuals(test: GeometryTest) -> Table:
    after = (Column("rms with the changes", Kind.NUMBER, 3), lambda residual: 1e3 * residual.rms_after)
    return table_of(
        test.residuals,
        (Column("run"), "run"),
        (Column("component"), "name"),
        (Column("rms", Kind.NUMBER, 3), lambda residual: 1e3 * residual.rms),
        (Column("bias", Kind.NUMBER, 2), lambda pose: 1e3 * pose.bias * (abs(pose.bias) > ROUNDING * pose.rms)),
        *([after] if test.explained_by else []),
        (Column("unit"), lambda residual: f"m{residual.unit}"),
    )


def _constants(test: GeometryTest) -> Table:
    return table_of(
        test.tried[:LISTED],
        (Column("length or encoder zero"), "name"),
        (Column("in the robot file", Kind.NUMBER, 5), lambda constant: 1e3 * constant.value or None),
        (Column("change", Kind.NUMBER, 3), lambda constant: 1e3 * constant.change),
        (Column("std", Kind.NUMBER, 2), lambda constant: 1e3 * constant.std),
        (Column("unit"), lambda constant: f"m{constant.unit}"),
        (Column("explains", Kind.NUMBER), lambda constant: percent(constant.share)),
    )

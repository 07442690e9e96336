"""Show a robot as page and JSON document, the test of its geometry by logged poses, and its motion along runs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from gtau.estimation.diagnostics.geometry import GeometryTest, percent
from gtau.estimation.results.conclusions import NEAR_SINGULAR
from gtau.model.base_parameters import BaseParameters
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.singularities import TYPES, singular_distances
from gtau.report.chart import TIME, Axis, Chart, Panel, Series, colour
from gtau.report.page import Column, Facts, Kind, Page, Section, Table, Text, table_of
from gtau.robots.geometry import oddities, tool_note
from gtau.robots.parameter import Parameter, unit_of
from gtau.robots.robot import DAMPING, PRELOAD, STIFFNESS, Joint, Robot

if TYPE_CHECKING:
    from gtau.estimation.results.estimate import NearestPose
    from gtau.estimation.results.result import IdentifiedModel
    from gtau.report.torques import RunEvidence

POSE_DELAY_STD = 0.02  # s; pose delays with a larger standard deviation are not shown
STYLES = {"confirmed": "good", "other constants": "bad", "unexplained": "weak"}
LISTED = 12  # most constants in the table
ROUNDING = 1e-3  # of the rms; a smaller bias is shown as zero
ESTIMATED = {
    "controller": "Besides the constants, only the delay of the poses was estimated.",
    "tool": "The position of the tool on the body was estimated too.",
    "tracker": "The positions of the tracker (in each run) and its marker were estimated beside the constants.",
}
SINGULARITIES = {1: "type 1 (serial)", 2: "type 2 (parallel)"}
COLOURS = {1: "c7", 2: "c6"}  # not among the colours of six joints
TERMS = {PRELOAD: "preload", STIFFNESS: "stiffness", DAMPING: "damping"}


def robot_document(model: InverseDynamics, base: BaseParameters) -> dict[str, Any]:
    """Describe a robot as a JSON document in SI units; raises GtauError if its loops do not close."""
    robot, loops, distances = model.robot, model.loops, zip(TYPES, _distances_at_home(model), strict=True)
    return {
        "robot": robot.name,
        "source": robot.source,
        "notes": _notes(robot),
        "degrees_of_freedom": len(model.actuated),
        "floating_base": robot.floating or None,
        "joints": [
            {
                "name": joint.name,
                "antecedent": joint.antecedent,
                "kind": joint.kind,
                "actuated": joint.name in robot.motors,
                "parameters": joint.parameters,
                "home": home,
                "unit": joint.unit,
                "limits": asdict(joint.limits),
            }
            for joint, home in zip(robot.joints, model.home.tolist(), strict=False)
        ],
        "platforms": [{"name": platform.name, "dof": list(platform.dof)} for platform in robot.platforms],
        "loops": {
            "closures": [{"kind": end.kind, "between": [end.a.body, end.b.body]} for end in robot.closures],
            "couplings": [
                {"joint": coupling.joint, "ratios": dict(coupling.ratios), "offset": coupling.offset}
                for coupling in robot.couplings
            ],
            "rows": loops.rows if loops else 0,
            "rank": len(loops.layout.passive) if loops else 0,
        },
        "distances_at_home": {f"type_{kind}": distance for kind, distance in distances},
        "springs": [
            {"name": spring.name, "between": [spring.a.body, spring.b.body], "parameters": list(spring.parameters)}
            for spring in robot.springs
        ],
        "gravity": np.array(robot.gravity).tolist(),
        "payload_on": robot.tool,
        "base_parameters": {
            "count": base.count,
            "count_inertial_only": base.inertial_count,
            "standard": len(model.parameter_names),
            "without_effect": len(base.without_effect),
            "regroupings": base.regroupings,
            "units": _units(base, robot),
        },
    }


def _distances_at_home(model: InverseDynamics) -> list[float | None]:
    """Compute the distance to singularities of both types at home; None if the robot has no such singularity."""
    still = np.zeros((len(model.actuated), 1))
    near = singular_distances(model)(model.rates(model.home[:, None], still, still))[:, 0]
    return [None if np.isnan(distance) else round(float(distance), 9) for distance in near]


def _notes(robot: Robot) -> list[str]:
    return [*robot.notes, *oddities(robot), *tool_note(robot)]


def _units(base: BaseParameters, robot: Robot) -> dict[Parameter, str]:
    parameters = zip(base.names, base.standard, strict=True)
    return {name: unit_of(standard.kind, robot, standard.body) for name, standard in parameters}


def robot_page(model: InverseDynamics, base: BaseParameters, verbose: bool = False) -> Page:
    """Show a robot; with ``verbose`` list every base parameter."""
    robot, notes = model.robot, _notes(model.robot)
    source = f" ({robot.source})" if robot.source else ""
    platforms = (Text(f"{part.name}: platform, free in {' '.join(part.dof)}") for part in robot.platforms)
    count = (
        f"{base.count} base parameters of {len(model.parameter_names)} standard ones ({len(base.without_effect)} have "
        f"no effect); {base.inertial_count} without rotor inertia, friction and offset"
    )
    terms = [
        f"{spring.name}: {spring.a.body} - {spring.b.body} ({', '.join(TERMS[kind] for kind in spring.parameters)})"
        for spring in robot.springs
    ]
    listed: Table | Text = Text("Names, units and regroupings: --verbose.", style="soft")
    if verbose:
        formulas = {name: formula if formula != name else "" for name, formula in base.regroupings.items()}
        rows = [(name, unit, formulas[name]) for name, unit in _units(base, robot).items()]
        listed = Table((Column("parameter", Kind.NAME), Column("unit"), Column("regroups")), rows)
    return Page(
        f"{robot.name}: {len(model.actuated)} degrees of freedom, {len(robot.joints)} joints{source}",
        Section("Joints", _joints(model), *platforms, _facts(model), id="joints"),
        _loops(model),
        Section("Springs between two points, with the terms of their force", Text("", tuple(terms))) if terms else None,
        Section("Notes", Text("", tuple(notes))) if notes else None,
        Section("Base parameters", Text(count), listed, id="parameters"),
    )


def _facts(model: InverseDynamics) -> Facts:
    robot, (serial, parallel) = model.robot, _distances_at_home(model)
    gravity = ", ".join(f"{round(component, 10) + 0.0:.6g}" for component in robot.gravity)
    facts: dict[str, object] = {
        "gravity": f"[{gravity}] m/s2 in {'world' if robot.base else 'base'} axes",
        "payload on": robot.tool,
    }
    if robot.base:
        facts["floating base"] = f"{robot.base[-1]}; its six equations are the rows {robot.base[0]} to {robot.base[-1]}"
    more = "" if parallel is None else f", type 2 (parallel) {parallel:.2g}"
    facts["at home"] = f"distance to singularities (1 at best, 0 at one): type 1 (serial) {serial:.2g}{more}"
    return Facts(facts)


def _joints(model: InverseDynamics) -> Table:
    robot, home = model.robot, model.home

    def role(joint: Joint) -> str:
        return "actuated" if joint.name in robot.motors else "free" if joint.name in robot.base else "passive"

    return table_of(
        robot.joints,
        (Column("joint"), "name"),
        (Column("antecedent"), "antecedent"),
        (Column("kind"), "kind"),
        (Column("role"), role),
        (Column("home", Kind.NUMBER, 4), lambda joint: round(home[robot.joints.index(joint)], 10) + 0.0),
        (Column("unit"), "unit"),
        (Column("limits"), _limits),
    )


def _limits(joint: Joint) -> str:
    limits, unit = joint.limits, joint.unit
    low, high = limits.position or (None, None)
    parts = [] if low is None else [f"{low:.4g} to {high:.4g} {unit}"]
    units = {"velocity": f"{unit}/s", "acceleration": f"{unit}/s2", "effort": "N m" if unit == "rad" else "N"}
    values = {what: getattr(limits, what) for what in units}
    return ", ".join(parts + [f"{value:.4g} {units[what]}" for what, value in values.items() if value is not None])


def _loops(model: InverseDynamics) -> Section | None:
    robot, loops = model.robot, model.loops
    if loops is None or not loops.rows:
        return None
    counts = {"closure": len(robot.closures), "coupling": len(robot.couplings)}
    counted = [f"{count} {kind}{'s' if count > 1 else ''}" for kind, count in counts.items() if count]
    equations = [f"{closure.kind} {closure.a.body} - {closure.b.body}" for closure in robot.closures]
    for coupling in robot.couplings:
        terms = [f"{ratio:+g} {name}" for name, ratio in dict(coupling.ratios).items()]
        terms += [f"{coupling.offset:+.6g}"] if coupling.offset else []
        equations.append(f"{coupling.joint} = {' '.join(terms).removeprefix('+')}")
    words = f"{' and '.join(counted)}, {loops.rows} equations of rank {len(loops.layout.passive)}:"
    return Section("Loops", Text(words, tuple(equations)), id="loops")


def geometry_section(test: GeometryTest | None) -> Section | None:
    """Show residuals of the logged pose, and the constants that would explain them."""
    if test is None:
        return None
    points = [ESTIMATED[test.source]]
    delay, std = test.delay
    if std < POSE_DELAY_STD:
        points.append(f"the poses lag {1e3 * delay:.1f} ± {1.96e3 * std:.1g} ms behind the positions")
    runs = dict.fromkeys(residual.run for residual in test.residuals if residual.time.size)
    more = len(test.tried) - LISTED
    return Section(
        "Logged pose and geometry",
        Text(str(test.note), tuple(points), STYLES[test.outcome]),  # type: ignore[arg-type]
        *(Section(run, _traces(test, run), folded=k > 0) for k, run in enumerate(runs)),
        Section(f"Residuals of the pose of '{test.body}': logged less computed", _residuals(test), folded=False),
        Section(
            "Constants one at a time, sorted by the share of the residual variance they explain",
            _constants(test),
            Text(f"{more} more explain less; model.json and --json list them.") if more > 0 else None,
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


def motion_section(result: IdentifiedModel, runs: Sequence[RunEvidence]) -> Section:
    """Show the robot, and the distances of its motion to singular poses."""
    used = any(run.used for run in runs)
    starts = {run.run.name: float(run.run.time[0]) for run in runs}
    along = zip(result.runs, result.distances, strict=False)  # empty for a loaded result
    distances = distances_panels((name, starts.get(name, 0.0), run) for name, run in along) if used else []
    return Section(
        "Robot and motion",
        result.robot,
        singularities_section(result.singularities) if used else None,
        *(Section(panel.title, Chart((panel,), live=True), folded=k > 0) for k, panel in enumerate(distances)),
        id="robot",
    )


def singularities_section(nearest: Sequence[NearestPose]) -> Section | None:
    """Show the poses of runs nearest to singular poses."""
    if not nearest:
        return None
    listed = table_of(
        nearest,
        (Column("run"), "run"),
        (Column("singularity"), lambda pose: SINGULARITIES[pose.type]),
        (Column("nearest", Kind.NUMBER, 3), "distance"),
        (Column("at, s", Kind.NUMBER), "time"),
        (Column("pose, rad or m", wide=True), _pose),
    )
    words = "1 at best, 0 at a singular pose; at one of type 1 a motor can move while the tool stands still."
    return Section("Distance to singular poses", listed, Text(words, style="soft"))


def _pose(nearest: NearestPose) -> str:
    return ", ".join(f"{joint} {round(q, 3) + 0.0:.3g}" for joint, q in nearest.pose.items())


def distances_panels(runs: Iterable[tuple[str, float, np.ndarray]]) -> list[Panel]:
    """Draw distances to singular poses along runs, given as name, start (s) and distances."""
    panels = []
    for run, start, distances in runs:
        time = distances["time"] - start
        series = [
            Series(name, time, distances[f"type_{kind}"], COLOURS[kind], width=1.4)
            for kind, name in SINGULARITIES.items()
            if np.isfinite(distances[f"type_{kind}"]).any()
        ]
        if len(series) == len(SINGULARITIES):  # type 2 magnifies errors
            limit = np.full(len(time), NEAR_SINGULAR)
            series.append(Series(f"near: {NEAR_SINGULAR:g}", time, limit, "bad", width=0.8))
        axis = Axis(series[0].label if len(series) == 1 else "distance", limits=(0.0, 1.05))  # one has no key
        panels += [Panel(TIME, axis, tuple(series), run, height=1.4)] if series else []
    return panels

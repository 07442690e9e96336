"""Show base parameters, friction, the test of the inertias in the robot file, correlations, and other effects."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from functools import partial

import numpy as np

from gtau.estimation.diagnostics.inertia_audit import InertiaAudit
from gtau.estimation.effects.effect import EstimatedEffect
from gtau.estimation.friction.curves import FrictionCurve
from gtau.estimation.regression.rows import SLOPES
from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.result import IdentifiedModel, estimates_table
from gtau.report.chart import Axis, Chart, Panel, Series, intervals
from gtau.report.gains import VALUE, value_cells
from gtau.report.page import Column, Kind, Section, Table, Text, joint_label, table_of
from gtau.report.torques import RunEvidence
from gtau.robots.parameter import KINDS, TEMPERATURE_TERMS, Parameter, payload_label, torque_unit
from gtau.signals.channel import LINK_SIDE
from gtau.signals.preparation.filters import position_filter

GROUPS = ("base parameter", "friction", "motor", *(kind.name for kind in LINK_SIDE))
LAW = [kind for kind in KINDS.values() if kind.friction and not kind.slope_of and kind.symbol not in SLOPES]
POINTS = 3000  # most points in a panel
ORDER = ("contradicted", "agrees", "not stated", "not identifiable")
FRICTION = (
    "Friction of each joint, identified on all samples at the gains and inertia above: fv qd + (fs + fb exp(-|qd| / "
    "v_s) + fl |load|) z + off. Predictions and exports use it. z is the sign of the speed once a joint slides; "
    "before, a spring over the width of presliding. Width and v_s are added only if they predict held-out data better; "
    "a joint without a width keeps the sign. Errors: on held-out blocks, in per cent of the friction torque, with this "
    "law and with viscous and Coulomb friction alone. SI units; ± is half a 95 % interval."
)
CURVES = "Measured torque less the predicted inertia and gravity torques, and the predicted friction."
STRONG = 0.9  # smallest correlation that is listed
LISTED = 20
PAPER = "Briot and Gautier 2015"  # Multibody System Dynamics 33
EFFECTS = (
    "All effects are random effects of one mixed model, estimated together with the parameters. Log-likelihood: loss "
    "of a fit without the effect; below 3 the data hardly show it. The estimates and intervals include all effects. "
    "Effects are sorted by their largest move."
)
DRAWN, VISIBLE = 12, 0.02  # most effects in the chart, and the smallest move of a gain, per cent


def parameters_section(result: IdentifiedModel) -> Section:
    """Show base, friction and sensor parameters in one table that sorts and searches."""
    listed = [(group, estimate) for group, estimate in estimates_table(result) if group.startswith(GROUPS)]
    columns = (Column("parameter", Kind.NAME), *VALUE, Column("role"), Column("regroups", Kind.NAME, wide=True))
    rows = [(value.name, *value_cells(value), _role(value, group), value.regroups) for group, value in listed]
    faint = frozenset(k for k, (_, value) in enumerate(listed) if value.essential is False)
    shown = Table(columns, rows, name="parameter-table", faint=faint)
    essential, loss = len(result.essential), result.statistics.get("reduction_loss", 0.0)
    words = (
        f"{essential} of {len(result.parameters)} base parameters are essential; a fit without the other "
        f"{len(result.parameters) - essential} changes the torque residual of the worst joint by {loss:.2g} %. "
        "A value with a standard deviation above 100 % means nothing alone: only its sum with others is known."
    )
    return Section("Parameters", Text(words), shown, _reference(result), id="parameters")


def _role(estimate: Estimate, group: str) -> str:
    if estimate.value is None:
        return "not identifiable"
    if estimate.essential is None:
        return "by BIC" if group == "friction" else group
    return "essential" if estimate.essential else "not essential"


def _reference(result: IdentifiedModel) -> Text | None:
    """Name the reference temperatures of friction; None if friction does not depend on temperature."""
    temperatures = result.temperatures
    if temperatures is None or not any(name.kind in TEMPERATURE_TERMS for name in result.friction):
        return None
    values = temperatures.of_joint
    at = ", ".join(f"'{joint}' {value:.4g}" for joint, value in values.items())
    if len(set(values.values())) == 1:
        at = f"{next(iter(values.values())):.4g}"
    per = f"per {temperatures.per} above the mean, {at} {temperatures.unit}"
    return Text(f"fvt, fst: viscous and Coulomb friction {per}")


def friction_section(result: IdentifiedModel, runs: Sequence[RunEvidence] = ()) -> Section | None:
    """Show the friction of each joint, with curves if ``runs`` are given; None if only the plain law was fitted."""
    if not result.curves:
        return None
    chart = friction_chart(result, [run for run in runs if run.used])
    drawn = (Text(CURVES, style="soft"), chart) if chart.panels else ()
    friction = {**result.friction, **result.friction_parameters}

    def value(kind: str, curve: FrictionCurve) -> tuple[float, float] | None:
        estimate = friction.get(Parameter(kind, curve.joint))
        if estimate is None or estimate.value is None:
            return None
        return estimate.value, estimate.half_interval() or 0.0

    def evidence(curve: FrictionCurve) -> str:
        return ", ".join(f"{term} ({t:.1f} standard errors)" for term, t in curve.evidence.items())

    law = [kind for kind in LAW if any(value(kind.symbol, curve) for curve in result.curves.values())]
    listed = table_of(
        result.curves.values(),
        (Column("joint"), lambda curve: joint_label(curve.joint)),
        *((Column(kind.heading or kind.symbol, Kind.SPREAD), partial(value, kind.symbol)) for kind in law),
        *([(Column("shown by", wide=True), evidence)] if any(map(evidence, result.curves.values())) else []),
        (Column("error, %", Kind.NUMBER, decimals=1), "error"),
        (Column("plain law, %", Kind.NUMBER, decimals=1), "plain_error"),
    )
    return Section("Friction on all samples", Text(FRICTION), listed, *drawn, id="friction")


def friction_chart(result: IdentifiedModel, runs: Sequence[RunEvidence]) -> Chart:
    """Draw measured and predicted friction torque over the speed of each joint."""
    gathered: list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]] = []
    for evidence in runs:
        if (prediction := evidence.prediction) is None:
            continue
        run = evidence.run.ordered(result.idm.actuated)
        count = int(np.searchsorted(run.time, prediction.time[-1])) + 1
        qd = position_filter(run.position, run.rate, result.preparation.at(run.rate).cutoff, 0, count)[1]
        speed = qd[np.minimum(np.searchsorted(run.time, prediction.time), count - 1)]
        measured = prediction.measured - prediction.predicted + prediction.friction
        gathered.append((speed, measured, prediction.friction, prediction.valid))
    panels = []
    for j, joint in enumerate(result.idm.actuated if gathered else ()):
        if joint in result.robot.base:
            continue
        speed, measured, friction, valid = (np.concatenate([run[k][:, j] for run in gathered]) for k in range(4))
        shown = np.flatnonzero(valid)
        shown = shown[:: max(1, len(shown) // POINTS)]
        series = (
            Series("predicted", speed[shown], friction[shown], "predicted", "points", width=2.4),
            Series("measured", speed[shown], measured[shown], "measured", "points", width=0.0),
        )
        x = Axis(f"speed, {result.robot.joint(joint).unit}/s")
        y = Axis(f"friction, {torque_unit(result.robot, joint)}")
        panels.append(Panel(x, y, series, joint_label(joint), height=2))
    return Chart(tuple(panels), columns=2)


def inertias_section(audit: InertiaAudit | None) -> Section | None:
    """Show how well the inertias in the robot file predict, and which of them the data contradict."""
    if audit is None:
        return None
    words = (
        f"The file's inertias predict the torques to within {audit.stated_error:.2g} %, the identified ones "
        f"to within {audit.identified_error:.2g} % (rms over the joints; friction and gains as identified)."
    )
    if audit.prior:
        words += (
            f" They are priors with a standard deviation of {100 * audit.prior:.3g} %, which the intervals include; if "
            "something else gives the scale, the comparison below uses the data without them."
        )
    ranked = sorted(audit.parameters, key=lambda parameter: (ORDER.index(parameter.standing), -abs(parameter.z or 0.0)))
    listed = table_of(
        ranked,
        (Column("base parameter", Kind.NAME), "name"),
        (Column("link"), "link"),
        (Column("in the file", Kind.NUMBER, 4), lambda entry: entry.stated and round(entry.stated, 12)),
        (Column("95 % interval", Kind.INTERVAL), "interval"),
        (Column("unit"), "unit"),
        (Column("z", Kind.NUMBER, decimals=1), "z"),
        (Column("data", Kind.BADGE), "standing"),
    )
    return Section("Inertias of the robot file", Text(words, tuple(_audit_points(audit))), listed, id="inertias")


def corrections(audit: InertiaAudit | None) -> list[str]:
    """List the links to correct in the robot file, if the data contradict any."""
    if audit is None or not audit.links:
        return []
    steps = [f"{link.name} ({link.error:.2g} %)" for link in audit.links]
    words = (
        "in the robot file, correct mass, centre of mass and inertia of these links, in this order (torque error left)"
    )
    return [f"{words}: {', '.join(steps)}"]


def _audit_points(audit: InertiaAudit) -> list[str]:
    wrong, points = audit.of("contradicted"), []
    tested = len(wrong) + len(audit.of("agrees"))
    if not wrong:
        points.append(f"the data contradict none of the {tested} base parameters that they determine")
    elif audit.links:
        points.append(f"the data contradict {len(wrong)} of the {tested} base parameters that they determine")
        points += corrections(audit)
    if open_ := audit.of("not stated"):
        points.append(f"{len(open_)} include a rotor inertia (armature) that the file does not state")
    if unknown := audit.of("not identifiable"):
        several = len(unknown) > 1
        listed = ", ".join(parameter.name for parameter in unknown)
        points.append(
            f"{len(unknown)} base parameter{'s are' if several else ' is'} not identifiable from these motions to "
            f"better than +-100 % of the link: {listed}"
        )
    return points


def correlation_of(result: IdentifiedModel) -> tuple[tuple[Parameter, ...], np.ndarray]:
    """Compute names and correlation matrix (m, m) of all estimates with a variance."""
    covariance = result.covariance
    std = np.sqrt(np.clip(np.diag(covariance), 0.0, None))
    known = np.flatnonzero(std > 0)
    part = covariance[np.ix_(known, known)] / np.outer(std[known], std[known])
    return tuple(result.covariance_names[k] for k in known), np.clip(part, -1.0, 1.0)


def correlation_chart(result: IdentifiedModel) -> Chart:
    """Draw the correlation matrix of the estimates; of many, some are named."""
    names, matrix = correlation_of(result)
    axis = Axis("", names={float(k): name for k, name in enumerate(names)})
    caption = "Blue: positive, orange: negative; in full colour: 1 or -1."
    labels = {payload_label(result.robot, run): run + 1 for run in range(len(result.runs))}
    caption += next((f" {name.body}: payload of run {labels[name.body]}." for name in names if name.body in labels), "")
    return Chart((Panel(axis, axis, matrix=matrix, height=5.2),), "Correlations", caption=caption)


def correlation_section(result: IdentifiedModel) -> Section | None:
    """Show the correlation matrix of the estimates and the strongest pairs."""
    names, matrix = correlation_of(result)
    if len(names) < 2:
        return None
    upper = np.triu(np.abs(matrix), 1)
    strongest = np.argsort(upper, axis=None)[::-1]
    pairs = [np.unravel_index(k, upper.shape) for k in strongest if upper.flat[k] >= STRONG]
    rows = [(names[i], names[j], float(matrix[i, j])) for i, j in pairs[:LISTED]]
    columns = (Column("estimate", Kind.NAME), Column("and", Kind.NAME), Column("correlation", Kind.NUMBER, decimals=3))
    words = (
        f"{len(names)} estimates in the order of model.json: parameters, then drive gains, then delays. "
        f"{len(pairs) or 'No'} pair{'' if len(pairs) == 1 else 's'} with a correlation of {STRONG:g} or more"
        + (f", the {LISTED} strongest listed." if len(pairs) > LISTED else ".")
    )
    return Section(
        "Correlation",
        Text(words),
        _drift_text(names, result),
        correlation_chart(result),
        Table(columns, rows) if rows else None,
        id="correlation",
    )


def singular_values_chart(values: np.ndarray) -> Chart:
    """Draw singular values (K,) in falling order and mark the smallest."""
    order = np.arange(1.0, len(values) + 1)
    series = (
        Series("singular values", order[:-1], values[:-1], "predicted", "points"),
        Series("the smallest", order[-1:], values[-1:], "residual", "points", width=2.5),
    )
    return Chart((Panel(Axis("number"), Axis("singular value", log=True), series, height=2.2),))


def effects_chart(effects: Sequence[EstimatedEffect], kind: str) -> Chart | None:
    """Draw the largest effects by the largest move of a gain, per cent, with 95 % intervals."""
    drawn = [effect for effect in effects if effect.largest_move > VISIBLE and effect.size][:DRAWN]
    if not drawn:
        return None
    moves = [max(effect.moves.values(), key=abs) for effect in drawn]
    halves = [1.96 * abs(move * effect.std / effect.size) for move, effect in zip(moves, drawn, strict=True)]
    names = [f"{effect.effect} {effect.cause.joint}".strip() for effect in drawn]
    labels = [each.subject if names.count(name) > 1 else name for name, each in zip(names, drawn, strict=True)]
    axis = f"moves a {'scale' if kind == 'torque' else 'gain'} by, %"
    return Chart((intervals(labels, moves, halves, axis, zero=True),), "Effects")


def effects_section(result: IdentifiedModel) -> Section | None:
    """Show the effects beside the model with their sizes and the moves of the gains."""
    if not result.effects:
        return None
    ranked = sorted(result.effects, key=lambda effect: -effect.largest_move)
    move = partial(Column, kind=Kind.NUMBER, decimals=2)
    estimated = any(gain.std for gain in result.drive_gains.values())
    moves = [
        (move(f"moves {joint_label(joint)} by, %"), lambda effect, joint=joint: effect.moves.get(joint))
        for joint in (result.robot.motors if estimated else ())
    ]
    listed = table_of(
        ranked,
        (Column("effect"), "subject"),
        (Column("size", Kind.NUMBER, 2), "size"),
        (Column("std", Kind.NUMBER, 2), "std"),
        (Column("unit"), "unit"),
        (Column("log-likelihood", Kind.NUMBER, decimals=1), "likelihood"),
        (Column("share of the residual, %", Kind.SHARE, decimals=1), "share"),
        *moves,
        name="effects-table",
    )
    full_list = Section(f"All {len(ranked)} effects", listed, folded=True)
    drifting = _drift_text([effect.subject for effect in ranked], result)
    chart = effects_chart(ranked, result.kind)
    return Section("Effects beside the model", Text(EFFECTS), drifting, chart, full_list, id="effects")


def _drift_text(texts: Iterable[str], result: IdentifiedModel) -> Text | None:
    """Explain names such as ``fv_left@2``, if there are any."""
    drift = next(filter(None, (re.search(r"(\w+)@(\d+)", text) for text in texts)), None)
    if drift is None:
        return None
    name, number = drift.groups()
    run = result.runs[int(number) - 1]
    words = f"{drift[0]}: by how much {name} in run {number}, '{run}', differs from its mean over the runs"
    return Text(words, style="soft")

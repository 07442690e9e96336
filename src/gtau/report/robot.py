"""Show a robot as document and page: joints, loops, singular poses and base parameters."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from gtau.model.base_parameters import base_parameters
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.singularities import TYPES, singularities
from gtau.progress import Progress, silent
from gtau.report.page import Column, Facts, Kind, Page, Table, Text, page, section, table, table_of
from gtau.robots.parameter import Parameter, position_unit, unit_of
from gtau.robots.plausibility import oddities, tool_note
from gtau.robots.robot import DAMPING, PRELOAD, STIFFNESS, Robot, base_rows

TERMS = {PRELOAD: "preload", STIFFNESS: "stiffness", DAMPING: "damping"}


def robot_document(robot: Robot, progress: Progress = silent) -> dict[str, Any]:
    """Describe joints, limits, loops, gravity, payload's body and base parameters of ``robot`` as a JSON document.

    Lengths in m, angles in rad, gravity in m/s2 in base axes; a limit that is not known is null. ``progress`` is called
    as the work goes on, which takes minutes above a hundred joints.

    Raises
    ------
    GtauError
        Where its loops do not close or its actuation is not what gtau treats.
    """
    model = InverseDynamics(robot)
    loops = model.loops
    base = base_parameters(model, progress=progress)
    home = model.layout.home if loops is None else loops.home
    still = np.zeros((len(model.actuated), 1))
    near = singularities(model).distances(model.rates(home[:, None], still, still))[:, 0]
    return {
        "robot": robot.name,
        "source": robot.source,
        "notes": [*robot.notes, *oddities(robot), *tool_note(robot)],
        "degrees_of_freedom": len(model.actuated),
        "floating_base": robot.floating or None,
        "joints": [
            {
                "name": joint.name,
                "antecedent": joint.antecedent,
                "kind": joint.kind,
                "actuated": joint.name in robot.motors,
                "parameters": joint.parameters,
                "home": float(home[k]),
                "unit": position_unit(robot, joint.name),
                "limits": asdict(joint.limits),
            }
            for k, joint in enumerate(robot.joints)
        ],
        "platforms": [{"name": platform.name, "dof": list(platform.dof)} for platform in robot.platforms],
        "loops": {
            "closures": [
                {"kind": closure.kind, "between": [closure.a.body, closure.b.body]} for closure in robot.closures
            ],
            "couplings": [
                {"joint": coupling.joint, "ratios": dict(coupling.ratios), "offset": coupling.offset}
                for coupling in robot.couplings
            ],
            "rows": 0 if loops is None else loops.rows,
            "rank": 0 if loops is None else len(loops.layout.passive),
        },
        "distances_at_home": {
            f"type_{kind}": None if np.isnan(d) else float(d) for kind, d in zip(TYPES, near, strict=True)
        },
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
            "units": {name: _unit(own, robot) for name, own in zip(base.names, base.standard, strict=True)},
        },
    }


def robot_page(found: dict[str, Any], verbose: bool = False) -> Page:
    """Show the description that :func:`robot_document` makes, ``verbose`` with every base parameter."""
    loops, base, free = found["loops"], found["base_parameters"], base_rows(found["floating_base"] or "")
    source = f" ({found['source']})" if found["source"] else ""
    near = found["distances_at_home"]
    gravity = ", ".join(f"{round(component, 10) + 0.0:.6g}" for component in found["gravity"])
    facts: dict[str, object] = {
        "gravity": f"[{gravity}] m/s2 in {'world' if free else 'base'} axes",
        "payload on": found["payload_on"],
    }
    if free:
        facts["floating base"] = f"{free[-1]}; its six equations are the rows {free[0]} to {free[-1]}"
    parallel = "" if near["type_2"] is None else f", type 2 (parallel) {near['type_2']:.2g}"
    facts["at home"] = (
        f"distance to singularities (1 at best, 0 at one): type 1 (serial) {near['type_1']:.2g}{parallel}"
    )
    count = (
        f"{base['count']} base parameters of {base['standard']} standard ones ({base['without_effect']} have no "
        f"effect); {base['count_inertial_only']} without rotor inertia, friction and offset"
    )
    listed = _base_table(base) if verbose else Text("Their names, units and regroupings: --verbose.", style="soft")
    terms = [
        f"{each['name']}: {' - '.join(each['between'])} ({', '.join(TERMS[kind] for kind in each['parameters'])})"
        for each in found["springs"]
    ]
    return page(
        f"{found['robot']}: {found['degrees_of_freedom']} degrees of freedom, {len(found['joints'])} joints{source}",
        section("Joints", _joints(found), *_platforms(found), Facts(facts), id="joints"),
        section("Loops", Text(_loops_words(loops), tuple(_equations(loops))), id="loops") if loops["rows"] else None,
        section("Springs between two points, and the terms of their force", Text("", tuple(terms))) if terms else None,
        section("Notes", Text("", tuple(found["notes"]))) if found["notes"] else None,
        section("Base parameters", Text(count), listed, id="parameters"),
    )


def _joints(found: dict[str, Any]) -> Table:
    free = base_rows(found["floating_base"] or "")

    def role(joint: dict[str, Any]) -> str:
        return "actuated" if joint["actuated"] else "free" if joint["name"] in free else "passive"

    return table_of(
        found["joints"],
        (Column("joint"), lambda joint: joint["name"]),
        (Column("antecedent"), lambda joint: joint["antecedent"]),
        (Column("kind"), lambda joint: joint["kind"]),
        (Column("role"), role),
        (Column("home", Kind.NUMBER, 4), lambda joint: round(joint["home"], 10) + 0.0),
        (Column("unit"), lambda joint: joint["unit"]),
        (Column("limits"), _limits),
    )


def _platforms(found: dict[str, Any]) -> list[Text]:
    return [Text(f"{each['name']}: platform, free in {' '.join(each['dof'])}") for each in found["platforms"]]


def _loops_words(loops: dict[str, Any]) -> str:
    counts = [
        f"{count} {kind}{'s' if count > 1 else ''}"
        for kind in ("closure", "coupling")
        if (count := len(loops[f"{kind}s"]))
    ]
    return f"{' and '.join(counts)}, {loops['rows']} equations of rank {loops['rank']}:"


def _equations(loops: dict[str, Any]) -> list[str]:
    found = [f"{closure['kind']} {' - '.join(closure['between'])}" for closure in loops["closures"]]
    for coupling in loops["couplings"]:
        terms = [f"{ratio:+g} {name}" for name, ratio in coupling["ratios"].items()]
        terms += [f"{coupling['offset']:+.6g}"] if coupling["offset"] else []
        found.append(f"{coupling['joint']} = {' '.join(terms).removeprefix('+')}")
    return found


def _base_table(base: dict[str, Any]) -> Table:
    rows = [
        (name, base["units"][name], formula if formula != name else "") for name, formula in base["regroupings"].items()
    ]
    return table((Column("parameter", Kind.NAME), Column("unit"), Column("regroups")), rows)


def _unit(parameter: Parameter, robot: Robot) -> str:
    return unit_of(parameter.kind, robot, parameter.body)


def _limits(joint: dict[str, Any]) -> str:
    limits, unit = joint["limits"], joint["unit"]
    low, high = limits["position"] or (None, None)
    parts = [] if low is None else [f"{low:.4g} to {high:.4g} {unit}"]
    units = {"velocity": f"{unit}/s", "acceleration": f"{unit}/s2", "effort": "N m" if unit == "rad" else "N"}
    parts += [f"{limits[key]:.4g} {what}" for key, what in units.items() if limits[key] is not None]
    return ", ".join(parts)

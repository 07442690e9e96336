"""What a robot is to gtau: its joints, loops and base parameters, as data and as text."""

from __future__ import annotations

import textwrap
from dataclasses import asdict
from typing import Any

import numpy as np

from gtau.model.base_parameters import base_parameters
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.singularities import TYPES, singularities
from gtau.robots.plausibility import oddities, tool_note
from gtau.robots.robot import DAMPING, PRELOAD, STIFFNESS, Robot, base_rows
from gtau.robots.units import unit_of

WIDTH = 80
TERMS = {PRELOAD: "preload", STIFFNESS: "stiffness", DAMPING: "damping"}


def describe(robot: Robot) -> dict[str, Any]:
    """Describe joints, limits, loops, gravity, payload's body and base parameters of ``robot`` as a JSON document.

    Lengths in m, angles in rad, gravity in m/s2 in base axes; a limit that is not known is null.

    Raises
    ------
    GtauError
        Where its loops do not close or its actuation is not what gtau treats.
    """
    model = InverseDynamics(robot)
    loops = model.loops
    base = base_parameters(model)
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
                "unit": "rad" if joint.kind == "revolute" else "m",
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
            "rows": 0 if loops is None else loops.equations.rows,
            "rank": 0 if loops is None else loops.rank,
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


def robot_page(description: dict[str, Any]) -> str:
    """Print the description."""
    loops, base = description["loops"], description["base_parameters"]
    title = (
        f"{description['robot']}: {description['degrees_of_freedom']} degrees of freedom, "
        f"{len(description['joints'])} joints" + (f" ({description['source']})" if description["source"] else "")
    )
    lines = [*_wrapped(title, 2), ""]
    free = base_rows(description["floating_base"] or "")
    bodies = [*description["joints"], *description["platforms"]]
    wide = 2 + max(len("antecedent"), *(len(body["name"]) for body in bodies))
    lines += _wrapped(f"  {'joint':<{wide}}{'antecedent':<{wide}}{'kind':<10}{'':<9}{'home':>9}     limits", 28)
    for joint in description["joints"]:
        role = "actuated" if joint["actuated"] else "free" if joint["name"] in free else "passive"
        line = (
            f"  {joint['name']:<{wide}}{joint['antecedent']:<{wide}}{joint['kind']:<10}{role:<9}"
            f"{round(joint['home'], 10) + 0.0:>9.4g} {joint['unit']:<4}"
        )
        limits = _limits(joint)
        fits = len(line + limits) <= WIDTH
        lines += [(line + limits).rstrip()] if fits else [line.rstrip(), *_wrapped(" " * 28 + limits, 28)]
    for platform in description["platforms"]:
        lines.append(f"  {platform['name']:<{wide}}platform, free in {' '.join(platform['dof'])}")
    gravity = ", ".join(f"{round(component, 10) + 0.0:.6g}" for component in description["gravity"])
    axes = "world" if free else "base"
    lines += ["", f"  gravity: [{gravity}] m/s2 in {axes} axes", f"  payload on: {description['payload_on']}"]
    if free:
        lines.append(f"  floating base: {free[-1]}; its six equations are the rows {free[0]} to {free[-1]}")
    if loops["rows"]:
        counts = [
            f"{count} {kind}{'s' if count > 1 else ''}"
            for kind in ("closure", "coupling")
            if (count := len(loops[f"{kind}s"]))
        ]
        lines += ["", f"  {' and '.join(counts)}, {loops['rows']} equations of rank {loops['rank']}:"]
        lines += [f"    {closure['kind']} {' - '.join(closure['between'])}" for closure in loops["closures"]]
        lines += [f"    {_equation(coupling)}" for coupling in loops["couplings"]]
    if description["springs"]:
        lines += ["", "  springs between two points, and the terms of their force:"]
        for spring in description["springs"]:
            terms = ", ".join(TERMS[kind] for kind in spring["parameters"])
            lines.append(f"    {spring['name']}: {' - '.join(spring['between'])} ({terms})")
    near = description["distances_at_home"]
    lines += ["", f"  distance to singularities at home (1 at best, 0 at one): type 1 (serial) {near['type_1']:.2g}"]
    lines[-1] += "" if near["type_2"] is None else f", type 2 (parallel) {near['type_2']:.2g}"
    lines[-1:] = _wrapped(lines[-1], 4)
    for note in description["notes"]:
        lines += ["", *_wrapped(f"  note: {note}", 8)]
    lines += [
        "",
        f"  {base['count']} base parameters of {base['standard']} standard ones ({base['without_effect']} have no "
        "effect);",
        f"  {base['count_inertial_only']} without rotor inertia, friction and offset:",
    ]
    for name, formula in base["regroupings"].items():
        written = f"{name} [{base['units'][name]}]" + (f" = {formula}" if formula != name else "")
        lines += _wrapped("    " + written, 8)
    return "\n".join(lines)


def _unit(parameter: str, robot: Robot) -> str:
    kind, body = parameter.split("_", 1)
    return unit_of(kind, robot, body)


def _wrapped(line: str, indent: int) -> list[str]:
    return textwrap.wrap(line, WIDTH, subsequent_indent=" " * indent)


def _limits(joint: dict[str, Any]) -> str:
    limits, unit = joint["limits"], joint["unit"]
    low, high = limits["position"] or (None, None)
    parts = [] if low is None else [f"{low:.4g} to {high:.4g} {unit}"]
    units = {"velocity": f"{unit}/s", "acceleration": f"{unit}/s2", "effort": "N m" if unit == "rad" else "N"}
    parts += [f"{limits[key]:.4g} {what}" for key, what in units.items() if limits[key] is not None]
    return ", ".join(parts)


def _equation(coupling: dict[str, Any]) -> str:
    terms = [f"{ratio:+g} {name}" for name, ratio in coupling["ratios"].items()]
    terms += [f"{coupling['offset']:+.6g}"] if coupling["offset"] else []
    return f"{coupling['joint']} = {' '.join(terms).removeprefix('+')}"

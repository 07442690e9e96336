"""What a robot is to idim: its joints, loops and base parameters, as data and as text."""

from __future__ import annotations

import textwrap
from typing import Any

import numpy as np

from idim.estimation.base_parameters import base_parameters
from idim.model.inverse_dynamics import InverseDynamics
from idim.robots.robot import Robot


def describe(robot: Robot) -> dict[str, Any]:
    """Joints, loops, degrees of freedom and base parameters of ``robot`` as a JSON document.

    Raises
    ------
    IdimError
        Where its loops do not close or its actuation is not what idim treats.
    """
    model = InverseDynamics(robot)
    loops = model.loops
    base, inertial = base_parameters(model), base_parameters(InverseDynamics(robot, "inertial"))
    home = model.layout.home if loops is None else loops.home
    return {
        "robot": robot.name,
        "source": robot.source,
        "notes": list(robot.notes),
        "degrees_of_freedom": len(model.actuated),
        "joints": [
            {
                "name": joint.name,
                "antecedent": joint.antecedent,
                "kind": joint.kind,
                "actuated": joint.actuated,
                "parameters": joint.parameters,
                "home": float(home[k]),
                "unit": "rad" if joint.kind == "revolute" else "m",
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
            "condition_at_home": None if loops is None else float(loops.condition(loops.home[:, None])[0]),
        },
        "gravity": np.array(robot.gravity).tolist(),
        "base_parameters": {
            "count": base.count,
            "count_inertial_only": inertial.count,
            "standard": len(model.parameter_names),
            "without_effect": len(base.without_effect),
            "regroupings": base.regroupings,
        },
    }


def robot_page(description: dict[str, Any]) -> str:
    """The description as text."""
    loops, base = description["loops"], description["base_parameters"]
    lines = [
        f"{description['robot']}: {description['degrees_of_freedom']} degrees of freedom, "
        f"{len(description['joints'])} joints" + (f" ({description['source']})" if description["source"] else ""),
        "",
        f"  {'joint':<22}{'antecedent':<22}{'kind':<11}{'':<10}{'home':>9}",
    ]
    for joint in description["joints"]:
        role = "actuated" if joint["actuated"] else "passive"
        lines.append(
            "  "
            f"{joint['name']:<22}{joint['antecedent']:<22}{joint['kind']:<11}{role:<10}"
            f"{round(joint['home'], 10) + 0.0:>9.4g} {joint['unit']}"
        )
    for platform in description["platforms"]:
        lines.append(f"  {platform['name']:<22}platform, free in {' '.join(platform['dof'])}")
    if loops["rows"]:
        counts = [
            f"{count} {kind}{'s' if count > 1 else ''}"
            for kind in ("closure", "coupling")
            if (count := len(loops[f"{kind}s"]))
        ]
        lines += ["", f"  {' and '.join(counts)}, {loops['rows']} equations of rank {loops['rank']}:"]
        lines += [f"    {closure['kind']} {' - '.join(closure['between'])}" for closure in loops["closures"]]
        lines += [f"    {_equation(coupling)}" for coupling in loops["couplings"]]
    for note in description["notes"]:
        lines += ["", *textwrap.wrap(f"note: {note}", 100, initial_indent="  ", subsequent_indent="        ")]
    lines += [
        "",
        f"  {base['count']} base parameters of {base['standard']} standard ones ({base['without_effect']} have no "
        "effect); "
        f"{base['count_inertial_only']} without rotor inertia, friction and offset:",
    ]
    for name, formula in base["regroupings"].items():
        lines += textwrap.wrap(
            f"{name} = {formula}" if formula != name else name, 96, initial_indent="    ", subsequent_indent="        "
        )
    return "\n".join(lines)


def _equation(coupling: dict[str, Any]) -> str:
    terms = [f"{ratio:+g} {name}" for name, ratio in coupling["ratios"].items()]
    terms += [f"{coupling['offset']:+.6g}"] if coupling["offset"] else []
    return f"{coupling['joint']} = {' '.join(terms).removeprefix('+')}"

"""Inertias stated in the robot's file: as standard parameters, and as priors."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gtau.errors import GtauError
from gtau.robots.parameter import Parameter, parameter_of
from gtau.robots.robot import INERTIAL, Robot
from gtau.signals.experiment import Prior


def stated_inertias(robot: Robot) -> dict[str, float]:
    """Return the file's standard parameters of bodies and motors of the model, by name, SI units.

    A body without inertia in a file that states those of others has no mass there.
    """
    stated = dict(robot.inertias)
    if not stated:
        return {}
    found = {name: stated.get(name, 0.0) for body in _heavy(robot) for kind in INERTIAL for name in [f"{kind}_{body}"]}
    rotors = {Parameter("ia", each.name).name for each in robot.joints if each.parameters in ("all", "drive")}
    return found | {name: value for name, value in stated.items() if name in rotors}


def sizes_of(stated: dict[str, float], body: str) -> dict[str, float] | None:
    """Return the size of each inertial parameter of a body (a change of 100 %), by kind: m, m r and m r^2.

    The radius r is the root mean square distance of its mass from the frame's origin, ``m r^2 = tr(I) / 2``: so a
    centre of mass that the file puts at the origin may move too. None for a body without mass or extent.
    """
    mass = stated[Parameter("m", body).name]
    second = sum(stated[Parameter(kind, body).name] for kind in ("xx", "yy", "zz")) / 2
    if mass <= 0 or second <= 0:
        return None
    return {
        kind: mass if kind == "m" else second if len(kind) == 2 and kind[0] != "m" else np.sqrt(mass * second)
        for kind in INERTIAL
    }


def inertia_priors(robot: Robot, std: float) -> dict[str, Prior]:
    """Take the file's inertias as priors with a relative standard deviation, each parameter by its own.

    Parameters
    ----------
    robot : Robot
    std : float
        Share of m, m r and m r^2 of each body (see :func:`sizes_of`), and of the rotor inertias.

    Raises
    ------
    GtauError
        Where the file states no inertias, or the share is not positive.
    """
    if not 0 < std < np.inf:
        raise GtauError(f"a relative standard deviation of {std:g} is impossible for inertias; write 0.3 for 30 %.")
    stated = stated_inertias(robot)
    if not stated:
        where = f" ({robot.source})" if robot.source else ""
        raise GtauError(
            f"the file of robot '{robot.name}'{where} states no inertias, which 'prior_inertias' asks for; give a URDF "
            "or MJCF file with <inertial> elements, or leave it out."
        )
    return dict(_priors(robot, stated, std))


def _priors(robot: Robot, stated: dict[str, float], std: float) -> Iterator[tuple[str, Prior]]:
    for body in _heavy(robot):
        for kind, size in (sizes_of(stated, body) or {}).items():
            name = Parameter(kind, body).name
            yield name, Prior(value=stated[name], std=std * size)
    for name, value in stated.items():
        if parameter_of(name).kind == "ia" and value > 0:
            yield name, Prior(value=value, std=std * value)


def _heavy(robot: Robot) -> list[str]:
    """List the bodies that have a mass in the model."""
    return [each.name for each in robot.joints if each.has_mass] + [each.name for each in robot.platforms]

"""Tables of modified Denavit-Hartenberg parameters, in the columns of the paper's Tables 1 and 2."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from gtau.errors import GtauError
from gtau.robots.geometry import ROUNDING, compose, exact_angle
from gtau.robots.robot import GROUND, Attachment, Joint, Mdh
from gtau.robots.units import DEGREES_ADVICE, in_degrees


@dataclass(frozen=True)
class MdhRow:
    """A frame of a table, placed in the frame of its antecedent.

    ``sigma`` is 0 for a revolute joint, 1 for a prismatic one and 2 for a fixed frame; ``mu`` is 1 where a motor acts.
    ``placement`` has the constant that the joint coordinate is added to in ``theta`` or ``r``; ``short`` says that an
    angle in it was written short, see :func:`gtau.robots.geometry.exact_angle`.
    """

    name: str
    antecedent: str
    mu: int
    sigma: int
    placement: Mdh
    short: bool


def moving_parameter(name: str, sigma: float) -> str | None:
    """Return the parameter that a joint's coordinate is added to: theta, r, or None for a fixed frame.

    Raises
    ------
    GtauError
        sigma is none of 0, 1 and 2.
    """
    if sigma not in (0, 1, 2):
        raise GtauError(f"sigma of joint '{name}' is {sigma:g}; write 0 (revolute), 1 (prismatic) or 2 (fixed frame).")
    return ("theta", "r", None)[int(sigma)]


def table_row(name: str, antecedent: str, mu: float, sigma: float, parameters: Sequence[float]) -> MdhRow:
    """Make a row from numbers: mu, sigma, and (gamma, b, alpha, d, theta, r), angles in rad, lengths in m.

    Raises
    ------
    GtauError
        mu is neither 0 nor 1, or an angle looks like degrees.
    """
    if mu not in (0, 1):
        raise GtauError(f"mu of joint '{name}' is {mu:g}; write 1 (driven by a motor) or 0 (passive).")
    gamma, b, alpha, d, theta, r = parameters
    for key, angle in (("gamma", gamma), ("alpha", alpha), ("theta", theta)):
        if in_degrees(angle):
            raise GtauError(f"{key} of joint '{name}' is {angle:g}; angles are in rad, so {DEGREES_ADVICE}.")
    angles = [exact_angle(angle) for angle in (gamma, alpha, theta)]
    short = any(abs(a - b) > ROUNDING for a, b in zip(angles, (gamma, alpha, theta), strict=True))
    placement = Mdh(angles[0], b, angles[1], d, angles[2], r)
    return MdhRow(name, antecedent, int(mu), int(sigma), placement, short)


def table_joints(rows: Sequence[MdhRow]) -> tuple[tuple[Joint, ...], dict[str, Attachment]]:
    """Make the joints of a table, and place its fixed frames in the links that carry them.

    Raises
    ------
    GtauError
        A row's antecedent stands in none of the rows before it.
    """
    frames = {GROUND: Attachment(GROUND)}
    joints = []
    for row in rows:
        if row.antecedent not in frames:
            raise GtauError(
                f"joint '{row.name}' has the antecedent '{row.antecedent}', which is not a joint of an earlier row; "
                "write 0 for the base, or move the antecedent's row up."
            )
        before = frames[row.antecedent]
        placement = row.placement if before == Attachment(before.body) else compose(before.placement, row.placement)
        if row.sigma == 2:
            frames[row.name] = Attachment(before.body, placement)
            continue
        kind: Literal["revolute", "prismatic"] = "prismatic" if row.sigma else "revolute"
        joints.append(Joint(row.name, before.body, kind, placement, actuated=row.mu == 1))
        frames[row.name] = Attachment(row.name)
    return tuple(joints), frames

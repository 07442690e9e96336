"""Parameters of the model by kind, body and run, their names and SI units, and the rigid bodies that ten describe."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from gtau.robots.robot import DAMPING, INERTIAL, PRELOAD, STIFFNESS, Attachment, Robot


class Parameter(str):
    """A parameter: its kind (``mx``, ``fs``, ``gain``), its body, joint or channel, and the run it differs in.

    Its text is the printed name: ``mx_31``, ``mx_31R`` of one that regroups others, or ``fs_left@2`` for the difference
    in the second run. ``run`` is the number of a run from 0 for the difference of a drifting parameter from its mean,
    None otherwise.
    """

    __slots__ = ("body", "kind", "regrouped", "run")
    kind: str
    body: str
    run: int | None
    regrouped: bool

    def __new__(cls, kind: str, body: str, run: int | None = None, regrouped: bool = False) -> Parameter:
        """Print the name, and keep what it is made of."""
        text = (
            (f"{kind}_{body}" if body else kind) + ("R" if regrouped else "") + ("" if run is None else f"@{run + 1}")
        )
        made = super().__new__(cls, text)
        made.kind, made.body, made.run, made.regrouped = kind, body, run, regrouped
        return made

    def __getnewargs__(self) -> tuple[str, str, int | None, bool]:  # type: ignore[override]
        """Return what copies and pickles are made from."""
        return self.kind, self.body, self.run, self.regrouped


def parameter_of(name: str, regrouped: bool = False) -> Parameter:
    """Return the parameter of a name in a file; of one without a body (``m`` of a payload) the body is empty.

    ``regrouped`` says whether a base parameter that regroups others has this name, which ends in ``R``: the name
    alone does not show it.
    """
    if isinstance(name, Parameter):
        return name
    label, _, run = name.partition("@")
    if run and not (run.isdecimal() and len(run) < 9):  # of no parameter that there is
        label, run = name, ""
    kind, _, body = (label.removesuffix("R") if regrouped else label).partition("_")
    return Parameter(kind, body, int(run) - 1 if run else None, regrouped)


def payload_label(robot: Robot, run: int) -> str:
    """Return the body of a run's payload in names of parameters: ``L2`` of the second run, ``LL2`` beside a link L2."""
    label = f"L{run + 1}"
    while label in robot.bodies:
        label = f"L{label}"
    return label


def unit_of(kind: str, robot: Robot, joint: str) -> str:
    """Return the SI unit of a parameter of ``kind`` at a joint, a platform or a spring."""
    if any(spring.name == joint for spring in robot.springs):
        return {PRELOAD: "N", STIFFNESS: "N/m", DAMPING: "N s/m"}[kind]
    if kind in ("xx", "xy", "xz", "yy", "yz", "zz"):
        return "kg m2"
    if kind in ("mx", "my", "mz"):
        return "kg m"
    if kind == "m":
        return "kg"
    turns = robot.joint(joint).turns
    if kind == "ia":
        return "kg m2" if turns else "kg"
    if kind == STIFFNESS:
        return "N m/rad" if turns else "N/m"
    if kind == "fv":
        return "N m s/rad" if turns else "N s/m"
    return torque_unit(robot, joint)


def position_unit(robot: Robot, joint: str) -> str:
    """Return the unit of a joint's position, rad or m."""
    return robot.joint(joint).unit


def command_unit(robot: Robot, joint: str, kind: str) -> str:
    """Return the unit of a joint's logged command: A for the ``current`` of a motor, else the unit of its torque."""
    return "A" if kind == "current" and joint in robot.motors else torque_unit(robot, joint)


def torque_unit(robot: Robot, joint: str) -> str:
    """Return N m for a revolute joint, N for a prismatic one."""
    return "N m" if robot.joint(joint).turns else "N"


def gain_unit(robot: Robot, joint: str, kind: str) -> str:
    """Return the unit of a gain: N m/A or N per A of a ``current``; 1 of torques, true over reported."""
    return {"N m": "N m/A", "N": "N per A"}[torque_unit(robot, joint)] if kind == "current" else "1"  # N/A is no unit


@dataclass(frozen=True, eq=False)
class RigidBody:
    """Mass in kg, centre of mass (3,) in m, and inertia tensor (3, 3) about it in kg m2, in axes of the same frame."""

    mass: float
    center: np.ndarray
    inertia: np.ndarray

    def seen_from(self, rotation: np.ndarray, position: np.ndarray) -> RigidBody:
        """Express the body in another frame, whose orientation (3, 3) and origin (3,) in this one are given."""
        center = rotation.T @ (self.center - position)
        return RigidBody(self.mass, center, rotation.T @ self.inertia @ rotation)

    @property
    def about_origin(self) -> np.ndarray:
        """Inertia tensor (3, 3) about the frame's origin."""
        c = self.center
        return np.asarray(self.inertia + self.mass * (c @ c * np.eye(3) - np.outer(c, c)))

    @property
    def principal(self) -> tuple[np.ndarray, np.ndarray]:
        """Principal moments (3,), and axes as the columns of a rotation (3, 3)."""
        moments, axes = np.linalg.eigh(self.inertia)
        axes[:, 0] *= np.linalg.det(axes)
        return moments, axes


def rigid_body(chi: Mapping[str, float], body: str) -> RigidBody:
    """Make the body called ``body`` from standard parameters by name; those missing are zero."""
    xx, xy, xz, yy, yz, zz, mx, my, mz, m = (chi.get(Parameter(kind, body), 0.0) for kind in INERTIAL)
    center = np.array([mx, my, mz]) / m if m else np.zeros(3)
    about_origin = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return RigidBody(m, center, about_origin - m * (center @ center * np.eye(3) - np.outer(center, center)))


def inertial_parameters(body: RigidBody) -> dict[str, float]:
    """Compute the ten parameters by kind, at the frame's origin: the inverse of :func:`rigid_body`."""
    values = (*body.about_origin[np.triu_indices(3)], *(body.mass * body.center), body.mass)
    return dict(zip(INERTIAL, map(float, values), strict=True))


def lumped(parts: Iterable[tuple[Attachment, RigidBody]]) -> dict[str, float]:
    """Sum rigid bodies by the body that each is attached to: standard parameters by name, in the order of parts."""
    parameters: dict[str, float] = {}
    for at, part in parts:
        rotation = at.placement.rotation
        for kind, value in inertial_parameters(part.seen_from(rotation.T, -rotation.T @ at.placement.position)).items():
            name = Parameter(kind, at.body)
            parameters[name] = parameters.get(name, 0.0) + value
    return parameters

"""Parameters of the model by kind, body and run, what each kind is, and the rigid body that ten parameters describe.

``KINDS`` is the table of the kinds. Another friction term takes a row there, and its formula in
:mod:`gtau.estimation.regression.rows`. Results keep a term only with a field of its own in
:class:`gtau.estimation.friction.selection.Structure`, by which the friction on all samples selects it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from gtau.robots.robot import DAMPING, INERTIAL, PRELOAD, STIFFNESS, Attachment, Robot


class Parameter(str):
    """A parameter, by its printed name: ``mx_31``, ``mx_31R`` if it regroups others, ``fs_left@2`` of a run."""

    __slots__ = ("body", "kind", "regrouped", "run")
    kind: str  # mx, fs, gain
    body: str  # or joint or channel; empty for m of a payload
    run: int | None  # from 0, in which a drifting parameter differs
    regrouped: bool

    def __new__(cls, kind: str, body: str, run: int | None = None, regrouped: bool = False) -> Parameter:
        """Print the name, and keep what it is made of."""
        label = f"{kind}_{body}" if body else kind
        made = super().__new__(cls, label + "R" * regrouped + ("" if run is None else f"@{run + 1}"))
        made.kind, made.body, made.run, made.regrouped = kind, body, run, regrouped
        return made

    def __getnewargs__(self) -> tuple[str, str, int | None, bool]:  # type: ignore[override]
        """Return what copies and pickles are made from."""
        return self.kind, self.body, self.run, self.regrouped


def parameter_of(name: str, regrouped: bool = False) -> Parameter:
    """Return the parameter of a name in a file; ``regrouped`` says whether an ``R`` at its end is no part of it."""
    if isinstance(name, Parameter):
        return name
    label, _, run = name.partition("@")
    if run and not (run.isdecimal() and len(run) < 9):  # of no parameter that there is
        label, run = name, ""
    kind, _, body = (label.removesuffix("R") if regrouped else label).partition("_")
    return Parameter(kind, body, int(run) - 1 if run else None, regrouped)


def stated_inertias(robot: Robot) -> dict[Parameter, float]:
    """Return the parameters that the robot's file states, SI units."""
    return {parameter_of(name): value for name, value in robot.file.inertias}


def payload_label(robot: Robot, run: int) -> str:
    """Return the body of a run's payload in names of parameters: ``L2`` of the second run, ``LL2`` beside a link L2."""
    label = f"L{run + 1}"
    while label in robot.bodies:
        label = f"L{label}"
    return label


@dataclass(frozen=True)
class ParameterKind:
    """What a kind of parameter is.

    Friction is "plain" among the standard parameters, a further "term" of the equations, a "curve" of the friction on
    all samples alone, or a "shape" in which friction is nonlinear.
    """

    symbol: str  # in the names of parameters
    words: str  # in notes on exports and on pages
    units: tuple[str, str]  # at a revolute and a prismatic joint
    latex: str = ""  # where the symbol differs there
    heading: str = ""
    nonnegative: bool = False  # by physics
    friction: Literal["", "plain", "term", "curve", "shape"] = ""
    dry: bool = False  # acts by the direction of the speed, whatever its size
    by_load: bool = False  # grows with the torque that the joint transmits
    slope_of: str = ""  # the kind that changes by it with the temperature


_INERTIA, _TORQUE, _VISCOUS = ("kg m2", "kg m2"), ("N m", "N"), ("N m s/rad", "N s/m")
KINDS: Mapping[str, ParameterKind] = {
    kind.symbol: kind
    for kind in (
        *(ParameterKind(symbol, "moment of inertia", _INERTIA, nonnegative=True) for symbol in ("xx", "yy", "zz")),
        *(ParameterKind(symbol, "product of inertia", _INERTIA) for symbol in ("xy", "xz", "yz")),
        *(ParameterKind(symbol, "first moment", ("kg m", "kg m")) for symbol in ("mx", "my", "mz")),
        ParameterKind("m", "mass", ("kg", "kg"), nonnegative=True),
        ParameterKind("ia", "rotor inertia", ("kg m2", "kg"), nonnegative=True),
        ParameterKind(STIFFNESS, "stiffness", ("N m/rad", "N/m")),
        ParameterKind(PRELOAD, "preload", _TORQUE, latex="f_0"),
        ParameterKind(DAMPING, "damping", _VISCOUS, nonnegative=True),
        ParameterKind("width", "before sliding", ("rad", "m"), heading="presliding", friction="shape"),
        ParameterKind("vs", "speed of the bend", ("rad/s", "m/s"), heading="v_s", friction="shape"),
        ParameterKind("fv", "viscous", _VISCOUS, nonnegative=True, friction="plain"),
        ParameterKind("fs", "Coulomb", _TORQUE, nonnegative=True, friction="plain", dry=True),
        ParameterKind("fb", "beyond sliding, at rest", _TORQUE, friction="curve", dry=True),
        ParameterKind("f3", "cubic in speed", ("N m s3/rad3", "N s3/m3"), latex="f_3", friction="term"),
        ParameterKind(
            "fl", "proportional to the load", ("1", "1"), r"f_{\ell}", "", True, "term", dry=True, by_load=True
        ),
        ParameterKind("off", "offset", _TORQUE, friction="plain"),
        ParameterKind("ke", "back-EMF constant", ("V s/rad", "V s/m"), latex="k_e"),
        ParameterKind("R", "resistance", ("ohm", "ohm")),
        ParameterKind("fvt", "by temperature", _VISCOUS, friction="term", slope_of="fv"),
        ParameterKind("fst", "by temperature", _TORQUE, friction="term", dry=True, slope_of="fs"),
    )
}


def kinds_where(holds: Callable[[ParameterKind], object]) -> tuple[str, ...]:
    """List the symbols of the kinds for which ``holds`` is true, in the order of the table."""
    return tuple(kind.symbol for kind in KINDS.values() if holds(kind))


TERMS = kinds_where(lambda kind: kind.friction == "term" and not kind.slope_of)
"""Further friction in the equations of identification, each with a column of its own."""
TEMPERATURE_TERMS = {symbol: KINDS[symbol].slope_of for symbol in kinds_where(lambda kind: kind.slope_of)}
"""Changes of friction with the temperature, and the kinds that they change."""
SHAPES = kinds_where(lambda kind: kind.friction == "shape")
"""Kinds in which friction is nonlinear: the width of presliding, and the speed v_s over which it starts to slide."""
FURTHER_FRICTION = kinds_where(lambda kind: kind.friction and kind.friction != "plain")
"""Friction that is not among the standard parameters."""
DRY = kinds_where(lambda kind: kind.dry)
DRIFTING = tuple(TEMPERATURE_TERMS.values())
"""Friction that warm-up changes from run to run, and that the bearing of a torque sensor may have too."""
BY_LOAD = kinds_where(lambda kind: kind.by_load)
DISSIPATING = kinds_where(lambda kind: kind.nonnegative and kind.symbol not in INERTIAL)
"""Parameters of drives and springs that cannot be negative."""


def unit_of(kind: str, robot: Robot, joint: str) -> str:
    """Return the SI unit of a parameter of ``kind`` at a joint, a platform or a spring."""
    if any(spring.name == joint for spring in robot.springs):
        return KINDS[kind].units[1]
    return KINDS[kind].units[kind not in INERTIAL and not robot.joint(joint).turns]


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
        return RigidBody(self.mass, rotation.T @ (self.center - position), rotation.T @ self.inertia @ rotation)

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


def pseudo_inertia(values: np.ndarray) -> np.ndarray:
    """Build the pseudo-inertia (4, 4) of inertial parameters (10,), in the order of INERTIAL, SI units."""
    J, inertia = np.empty((4, 4)), np.empty((3, 3))
    upper = np.triu_indices(3)
    inertia[upper] = inertia.T[upper] = values[:6]
    J[:3, :3] = np.trace(inertia) / 2 * np.eye(3) - inertia
    J[3, :3] = J[:3, 3] = values[6:9]
    J[3, 3] = values[9]
    return J


BASIS = np.array([pseudo_inertia(unit) for unit in np.eye(10)])
"""Pseudo-inertias of unit parameters, (10, 4, 4)."""


def ball_row(centre: np.ndarray, radius: float) -> np.ndarray:
    """Build the row (10,) whose product with a body's parameters is not negative if its mass lies within a ball.

    It is ``tr(J Q)`` of the pseudo-inertia J, the integral of ``radius^2 - |x - centre|^2`` over the mass (Wensing, Kim
    and Slotine, 2018).
    """
    Q = np.zeros((4, 4))
    Q[:3, :3], Q[3, 3] = -np.eye(3), radius**2 - centre @ centre
    Q[:3, 3] = Q[3, :3] = centre
    return np.einsum("kij,ij->k", BASIS, Q)


def lumped(parts: Iterable[tuple[Attachment, RigidBody]]) -> dict[str, float]:
    """Sum rigid bodies by the body that each is attached to: standard parameters by name, in the order of parts."""
    parameters: dict[str, float] = {}
    for at, part in parts:
        rotation = at.placement.rotation
        for kind, value in inertial_parameters(part.seen_from(rotation.T, -rotation.T @ at.placement.position)).items():
            name = Parameter(kind, at.body)
            parameters[name] = parameters.get(name, 0.0) + value
    return parameters

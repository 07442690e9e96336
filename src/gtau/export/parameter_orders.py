"""Parameters of bodies in the orders of Pinocchio, MuJoCo, Drake, MATLAB and SYMORO, with their names, and back.

All are given in the frame of the link as gtau places it; a program that places the body's frame elsewhere wants them
moved with :meth:`gtau.robots.parameter.RigidBody.seen_from`. Products of inertia are entries of the inertia tensor
(``xy = -int x y dm``) in all five.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl

from gtau.documents.files import identifier, in_csv
from gtau.errors import GtauError
from gtau.estimation.results.result import Result
from gtau.export.consistent import consistent_model
from gtau.export.exported import Export, Exported, written
from gtau.robots.parameter import Parameter, RigidBody, inertial_parameters, rigid_body
from gtau.robots.robot import INERTIAL

_ENTRIES = {"xx": (0, 0), "xy": (0, 1), "xz": (0, 2), "yy": (1, 1), "yz": (1, 2), "zz": (2, 2)}


@dataclass(frozen=True)
class Order:
    """Names, order and meaning of a program's parameters of a body.

    ``inertia`` names the six entries in the program's order, ``about`` is its reference point, and ``moments`` whether
    first moments take the place of the centre of mass; ``per_mass`` is for inertias divided by the mass.
    """

    names: tuple[str, ...]
    inertia: tuple[str, ...]
    about: str
    moments: bool = False
    per_mass: bool = False
    explained: str = ""


ORDERS = {
    "pinocchio": Order(
        ("m", "mcx", "mcy", "mcz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz"),
        ("xx", "xy", "yy", "xz", "yz", "zz"), "origin", moments=True,
        explained="Inertia.toDynamicParameters: first moments, inertia about the joint frame's origin",
    ),
    "mujoco": Order(
        ("mass", "ipos_x", "ipos_y", "ipos_z", "fullinertia_xx", "fullinertia_yy", "fullinertia_zz",
         "fullinertia_xy", "fullinertia_xz", "fullinertia_yz"),
        ("xx", "yy", "zz", "xy", "xz", "yz"), "center",
        explained="<inertial mass pos fullinertia>: inertia about the centre of mass, in axes of the body",
    ),
    "drake": Order(
        ("mass", "p_PScm_x", "p_PScm_y", "p_PScm_z", "Gxx", "Gyy", "Gzz", "Gxy", "Gxz", "Gyz"),
        ("xx", "yy", "zz", "xy", "xz", "yz"), "origin", per_mass=True,
        explained="SpatialInertia(mass, p_PScm_E, UnitInertia G_SP_E): inertia about the origin over mass, m2",
    ),
    "matlab": Order(
        ("Mass", "CenterOfMass_x", "CenterOfMass_y", "CenterOfMass_z", "Ixx", "Iyy", "Izz", "Iyz", "Ixz", "Ixy"),
        ("xx", "yy", "zz", "yz", "xz", "xy"), "origin",
        explained="rigidBody Mass, CenterOfMass and Inertia of rigidBodyTree: inertia about the body frame's origin",
    ),
    "symoro": Order(
        ("XX", "XY", "XZ", "YY", "YZ", "ZZ", "MX", "MY", "MZ", "M"),
        ("xx", "xy", "xz", "yy", "yz", "zz"), "origin", moments=True,
        explained="standard parameters of Khalil and Kleinfinger, at the frame's origin; IA, FV and FS follow",
    ),
}  # fmt: skip
DRIVES = {"ia": "IA", "fv": "FV", "fs": "FS"}  # what SYMORO has of a joint's drive


def export(result: Result, out: Path) -> Exported:
    """Write ``NAME_PROGRAM.csv`` into ``out`` for each program: one row per body, one column per parameter, SI units.

    Raises
    ------
    GtauError
        Where the result has no physically consistent parameters.
    """
    model = consistent_model(result, "parameter orders")
    texts, notes = {}, []
    for program, order in ORDERS.items():
        table = []
        for body in result.robot.bodies:
            row: dict[str, object] = {"body": body, **to_order(model.standard, body, program)}
            if program == "symoro":
                row |= {name: model.of(kind, body) for kind, name in DRIVES.items()}
            table.append(row)
        texts[f"{identifier(result.robot.name)}_{program}.csv"] = in_csv(pl.DataFrame(table))
        notes.append(f"{program}: {order.explained}")
    notes.append("all in the frames of gtau's links: a joint's frame, after its motion")
    if result.robot.closures:
        notes.append("the tables hold bodies alone: a tree of them is not the robot before its loops are closed")
    return Exported(written(out, texts), tuple(notes))


def to_order(chi: Mapping[str, float], body: str, program: str) -> dict[str, float]:
    """Arrange parameters of a body by the names and in the order of ``program``.

    Parameters
    ----------
    chi : mapping
        Standard parameters by gtau's names (``xx_3`` .. ``m_3``), SI units; those missing are zero.
    body : str
        Joint or platform whose link it is.
    program : str
        One of ``ORDERS``.

    Raises
    ------
    GtauError
        Where the body has no mass and the program gives a centre of mass, or there is no such program.
    """
    order = _order(program)
    kinds = {kind: chi.get(Parameter(kind, body), 0.0) for kind in INERTIAL}
    if order.moments:
        values = [kinds[kind] for kind in ("m", "mx", "my", "mz", *order.inertia)]
        return _named(order, values)
    if not kinds["m"]:
        if any(kinds.values()):
            raise GtauError(
                f"body '{body}' has inertia but no mass, which {program} cannot hold; identify with --consistent."
            )
        return dict.fromkeys(order.names, 0.0)
    rigid = rigid_body(chi, body)
    tensor = rigid.inertia if order.about == "center" else rigid.about_origin
    scale = rigid.mass if order.per_mass else 1.0
    return _named(order, [rigid.mass, *rigid.center, *(tensor[_ENTRIES[kind]] / scale for kind in order.inertia)])


def from_order(values: Mapping[str, float] | Sequence[float], body: str, program: str) -> dict[str, float]:
    """Compute standard parameters of gtau by name from those of ``program``: the inverse of :func:`to_order`."""
    order = _order(program)
    named = dict(values) if isinstance(values, Mapping) else dict(zip(order.names, values, strict=True))
    listed = _listed(order, named)
    m, first, entries = listed[0], np.array(listed[1:4]), np.array(listed[4:]) * (listed[0] if order.per_mass else 1.0)
    if order.about == "center":
        tensor = np.zeros((3, 3))
        for kind, value in zip(order.inertia, entries, strict=True):
            row, column = _ENTRIES[kind]
            tensor[row, column] = tensor[column, row] = value
        parameters = inertial_parameters(RigidBody(m, first, tensor))
    else:
        moments = first if order.moments else m * first
        parameters = dict(zip(("m", "mx", "my", "mz", *order.inertia), (m, *moments, *entries), strict=True))
    return {Parameter(kind, body): float(parameters[kind]) for kind in INERTIAL}


def _order(program: str) -> Order:
    if program not in ORDERS:
        raise GtauError(f"there is no parameter order of '{program}'; choose from {', '.join(ORDERS)}.")
    return ORDERS[program]


def _named(order: Order, values: Sequence[float]) -> dict[str, float]:
    """Name values given as mass, first three, inertia in the program's order."""
    if order.names[0] == "XX":  # SYMORO begins with the inertia and ends with the mass
        values = [*values[4:], *values[1:4], values[0]]
    return dict(zip(order.names, map(float, values), strict=True))


def _listed(order: Order, named: Mapping[str, float]) -> list[float]:
    values = [named[name] for name in order.names]
    return [values[9], *values[6:9], *values[:6]] if order.names[0] == "XX" else values


EXPORTS = {"orders": Export(export)}

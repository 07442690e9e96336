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

ENTRIES = {"xx": (0, 0), "xy": (0, 1), "xz": (0, 2), "yy": (1, 1), "yz": (1, 2), "zz": (2, 2)}
MASS_FIRST = "m x y z xx yy zz xy xz yz"


@dataclass(frozen=True)
class Order:
    """Parameters of a body in a program: their ``names`` in its order, and what stands for each.

    ``kinds`` are ``m``, ``x y z`` (centre of mass, or first ``moments``) and ``xx .. zz`` (inertia ``about`` the
    ``origin`` or the ``center``, divided by the mass where it is ``per_mass``).
    """

    names: str
    kinds: str
    about: str
    explained: str
    moments: bool = False
    per_mass: bool = False

    @property
    def kind(self) -> dict[str, str]:
        """What stands for each name."""
        return dict(zip(self.names.split(), self.kinds.split(), strict=True))


ORDERS = {
    "pinocchio": Order(
        "m mcx mcy mcz Ixx Ixy Iyy Ixz Iyz Izz", "m x y z xx xy yy xz yz zz", "origin",
        "Inertia.toDynamicParameters: first moments, inertia about the joint frame's origin", moments=True,
    ),
    "mujoco": Order(
        "mass ipos_x ipos_y ipos_z fullinertia_xx fullinertia_yy fullinertia_zz "
        "fullinertia_xy fullinertia_xz fullinertia_yz", MASS_FIRST, "center",
        "<inertial mass pos fullinertia>: inertia about the centre of mass, in axes of the body",
    ),
    "drake": Order(
        "mass p_PScm_x p_PScm_y p_PScm_z Gxx Gyy Gzz Gxy Gxz Gyz", MASS_FIRST, "origin",
        "SpatialInertia(mass, p_PScm_E, UnitInertia G_SP_E): inertia about the origin over mass, m2", per_mass=True,
    ),
    "matlab": Order(
        "Mass CenterOfMass_x CenterOfMass_y CenterOfMass_z Ixx Iyy Izz Iyz Ixz Ixy",
        "m x y z xx yy zz yz xz xy", "origin",
        "rigidBody Mass, CenterOfMass and Inertia of rigidBodyTree: inertia about the body frame's origin",
    ),
    "symoro": Order(
        "XX XY XZ YY YZ ZZ MX MY MZ M", "xx xy xz yy yz zz x y z m", "origin",
        "standard parameters of Khalil and Kleinfinger, at the frame's origin; IA, FV and FS follow", moments=True,
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
        drives = DRIVES if program == "symoro" else {}
        rows = [
            {"body": body, **to_order(model.standard, body, program)}
            | {name: model.of(kind, body) for kind, name in drives.items()}
            for body in result.robot.bodies
        ]
        table = pl.DataFrame(rows)
        texts[f"{identifier(result.robot.name)}_{program}.csv"] = in_csv(table)
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
    values = {kind: chi.get(Parameter(kind, body), 0.0) for kind in INERTIAL}
    values |= {axis: values[f"m{axis}"] for axis in "xyz"}
    if not order.moments and values["m"]:
        rigid = rigid_body(chi, body)
        tensor = rigid.inertia if order.about == "center" else rigid.about_origin
        values |= dict(zip("xyz", rigid.center, strict=True))
        values |= {kind: tensor[entry] / (rigid.mass if order.per_mass else 1.0) for kind, entry in ENTRIES.items()}
    elif not order.moments and any(values.values()):
        raise GtauError(
            f"body '{body}' has inertia but no mass, which {program} cannot hold; identify with --consistent."
        )
    return {name: float(values[kind]) for name, kind in order.kind.items()}


def from_order(values: Mapping[str, float] | Sequence[float], body: str, program: str) -> dict[str, float]:
    """Compute standard parameters of gtau by name from those of ``program``: the inverse of :func:`to_order`."""
    order = _order(program)
    named = dict(values) if isinstance(values, Mapping) else dict(zip(order.kind, values, strict=True))
    given = {kind: named[name] for name, kind in order.kind.items()}
    m, first = given["m"], np.array([given[axis] for axis in "xyz"])
    inertia = {kind: given[kind] * (m if order.per_mass else 1.0) for kind in ENTRIES}
    if order.about == "center":
        tensor = np.zeros((3, 3))
        for kind, (row, column) in ENTRIES.items():
            tensor[row, column] = tensor[column, row] = inertia[kind]
        parameters = inertial_parameters(RigidBody(m, first, tensor))
    else:
        moments = first if order.moments else m * first
        parameters = {"m": m, **dict(zip(("mx", "my", "mz"), moments, strict=True)), **inertia}
    return {Parameter(kind, body): float(parameters[kind]) for kind in INERTIAL}


def _order(program: str) -> Order:
    if program not in ORDERS:
        raise GtauError(f"there is no parameter order of '{program}'; choose from {', '.join(ORDERS)}.")
    return ORDERS[program]


EXPORTS = {"orders": Export(export)}

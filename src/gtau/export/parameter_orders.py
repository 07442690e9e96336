"""Parameters of bodies in the orders of Pinocchio, MuJoCo, Drake, MATLAB and SYMORO, with their names.

All are given in gtau's frame of the link; for a program with other frames move them by
:meth:`gtau.robots.parameter.RigidBody.seen_from`. Products of inertia are entries of the inertia tensor
(``xy = -int x y dm``) in all five.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl

from gtau.documents.files import identifier, in_csv
from gtau.errors import GtauError
from gtau.estimation.results.result import IdentifiedModel
from gtau.export.consistent import consistent_model
from gtau.export.exported import Export, Exported, written
from gtau.robots.parameter import Parameter, rigid_body
from gtau.robots.robot import DRIVE, INERTIAL


@dataclass(frozen=True)
class Order:
    """Parameters of a body in a program: their ``names`` in its order, and the ``kinds`` of these.

    Kinds are named as gtau's parameters, with inertia about the origin, or ``x y z`` (centre of mass), ``xx/c``
    (inertia about it) and ``xx/m`` (about the origin, over the mass).
    """

    names: str
    kinds: str
    explained: str


ORDERS = {
    "pinocchio": Order(
        "m mcx mcy mcz Ixx Ixy Iyy Ixz Iyz Izz",
        "m mx my mz xx xy yy xz yz zz",
        "Inertia.toDynamicParameters: first moments, inertia about the joint frame's origin",
    ),
    "mujoco": Order(
        "mass ipos_x ipos_y ipos_z fullinertia_xx fullinertia_yy fullinertia_zz "
        "fullinertia_xy fullinertia_xz fullinertia_yz",
        "m x y z xx/c yy/c zz/c xy/c xz/c yz/c",
        "<inertial mass pos fullinertia>: inertia about the centre of mass, in axes of the body",
    ),
    "drake": Order(
        "mass p_PScm_x p_PScm_y p_PScm_z Gxx Gyy Gzz Gxy Gxz Gyz",
        "m x y z xx/m yy/m zz/m xy/m xz/m yz/m",
        "SpatialInertia(mass, p_PScm_E, UnitInertia G_SP_E): inertia about the origin over mass, m2",
    ),
    "matlab": Order(
        "Mass CenterOfMass_x CenterOfMass_y CenterOfMass_z Ixx Iyy Izz Iyz Ixz Ixy",
        "m x y z xx yy zz yz xz xy",
        "rigidBody Mass, CenterOfMass and Inertia of rigidBodyTree: inertia about the body frame's origin",
    ),
    "symoro": Order(
        "XX XY XZ YY YZ ZZ MX MY MZ M IA FV FS",
        "xx xy xz yy yz zz mx my mz m ia fv fs",
        "standard parameters of Khalil and Kleinfinger, at the frame's origin; IA, FV and FS follow",
    ),
}


def export(result: IdentifiedModel, out: Path) -> Exported:
    """Write ``NAME_PROGRAM.csv`` for each program: a row per body, a column per parameter, SI units; GtauError."""
    model, robot = consistent_model(result, "parameter orders"), result.robot
    texts = {}
    for program in ORDERS:
        rows = [{"body": body, **to_order(model.values, body, program)} for body in robot.bodies]
        texts[f"{identifier(robot.name)}_{program}.csv"] = in_csv(pl.DataFrame(rows))
    notes = [f"{program}: {order.explained}" for program, order in ORDERS.items()]
    notes.append("all in the frames of gtau's links: a joint's frame, after its motion")
    if robot.closures:
        notes.append("the tables hold bodies alone: a tree of them is not the robot before its loops are closed")
    return Exported(written(out, texts), tuple(notes))


def to_order(chi: Mapping[str, float], body: str, program: str) -> dict[str, float]:
    """Arrange parameters of a body, a joint or platform, by the names and in the order of a program of ``ORDERS``.

    ``chi`` are standard parameters by gtau's names (``xx_3`` .. ``m_3``), SI units; those missing are zero. Raises
    GtauError where the body has no mass and the program gives a centre of mass.
    """
    if program not in ORDERS:
        raise GtauError(f"there is no parameter order of '{program}'; choose from {', '.join(ORDERS)}.")
    names, kinds = ORDERS[program].names.split(), ORDERS[program].kinds.split()
    values = {kind: float(chi.get(Parameter(kind, body), 0.0)) for kind in (*INERTIAL, *DRIVE)}
    if "x" in kinds and values["m"]:
        rigid = rigid_body(chi, body)
        values |= dict(zip("xyz", map(float, rigid.center), strict=True))
        upper = np.triu_indices(3)
        for kind, central, about_origin in zip(INERTIAL, rigid.inertia[upper], rigid.about_origin[upper], strict=False):
            values |= {f"{kind}/c": float(central), f"{kind}/m": float(about_origin / rigid.mass)}
    elif "x" in kinds and any(values[kind] for kind in INERTIAL):
        raise GtauError(
            f"body '{body}' has inertia but no mass, which {program} cannot hold; identify with --consistent."
        )
    return {name: values.get(kind, 0.0) for name, kind in zip(names, kinds, strict=True)}


EXPORTS = {"orders": Export(export)}

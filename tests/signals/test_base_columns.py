"""Pose and wrenches of a floating base as positions and forces of the six joints by which it moves."""

from __future__ import annotations

import numpy as np
import pytest
from floating_logs import FIXED
from free_flyer import free_state
from scipy.spatial.transform import Rotation

from gtau.errors import GtauError
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.geometry import float_base
from gtau.signals.reading.body_columns import BaseColumns, at_origins
from gtau.signals.reading.units import BaseUnits

AT = (0.3, -0.2, 0.5)


def base(axes: str, yaw: float = 0.0) -> BaseColumns:
    return BaseColumns(
        position=("x", "y", "z"),
        quaternion=("qw", "qx", "qy", "qz"),
        yaw=yaw,
        wrenches=({"force": ("fx", "fy", "fz"), "moment": ("mx", "my", "mz"), "axes": axes, "at": AT},),
    )


@pytest.mark.parametrize("axes", ["world", "base"])
def test_forces_have_the_power_of_the_wrench(axes: str, rng: np.random.Generator) -> None:
    """The power at any rates is that of the force at its point and of the moment, as scipy turns them."""
    columns = base(axes)
    model = InverseDynamics(float_base(FIXED, columns.body))
    regressor = model.wrenches([each.frame for each in columns.acting])
    for _ in range(20):
        q, qd = rng.uniform(-1.2, 1.2, 6), rng.normal(size=6)
        state = free_state(q, qd, np.zeros(6))
        force, moment = rng.normal(size=(2, 3))
        quaternion = Rotation.from_matrix(state.R).as_quat(scalar_first=True) * rng.choice([-1, 1])
        six = columns.positions(np.array([[*q[:3], *quaternion]]))
        assert six[0] == pytest.approx(q)
        still = np.zeros((9, 1))
        motion = model.motion(np.concatenate([six[0], rng.normal(size=3)])[:, None], still, still)
        (w,) = at_origins(columns.acting, np.array([[*force, *moment]]))
        forces = np.zeros(9)
        for entry, row, column in zip(regressor(model.layout, motion), regressor.rows, regressor.columns, strict=True):
            forces[row] += entry[0] * w[column]
        omega = state.R @ state.omega
        arm = np.array(AT) - state.p if axes == "world" else state.R @ AT
        f, m = (force, moment) if axes == "world" else (state.R @ force, state.R @ moment)
        assert forces[:6] @ qd == pytest.approx(f @ (state.v + np.cross(omega, arm)) + m @ omega)
        assert forces[6:] == pytest.approx(0.0, abs=1e-9)


def test_yaw_turns_the_world(rng: np.random.Generator) -> None:
    """Pose and wrench of the world turned together: as if both had been logged in a world that is turned."""
    turn = Rotation.from_euler("z", 0.8)
    pose, wrench = rng.uniform(-0.5, 0.5, (5, 3)), rng.normal(size=(5, 6))
    R = Rotation.from_rotvec(rng.uniform(-0.5, 0.5, (5, 3)))
    here = np.hstack([pose, R.as_quat(scalar_first=True)])
    there = np.hstack([turn.apply(pose), (turn * R).as_quat(scalar_first=True)])
    turned = np.hstack([turn.apply(wrench[:, :3]), turn.apply(wrench[:, 3:])])
    columns = base("world").model_copy(
        update={"wrenches": (base("world").wrenches[0].model_copy(update={"at": tuple(turn.apply(AT))}),)}
    )
    assert base("world", 0.8).positions(here) == pytest.approx(columns.positions(there))
    assert at_origins(base("world").acting, wrench, 0.8) == pytest.approx(at_origins(columns.acting, turned))


def test_what_is_left_out_is_at_rest() -> None:
    still = BaseColumns(wrenches=({"force": ("fx", "fy", "fz"), "at": AT},))
    assert still.positions(np.zeros((1, 0)))[0].tolist() == [0.0] * 6
    (w,) = at_origins(still.acting, np.array([[1.0, 2.0, 3.0]]))
    assert w == pytest.approx([*np.cross(AT, [1, 2, 3]), 1, 2, 3])
    assert still.labels[:3] == ("no column",) * 3


def test_missing_values_stay_missing() -> None:
    six = base("world").positions(np.array([[0.0, 0, 0, np.nan, 0, 0, 0]]))
    assert np.isnan(six[0, 3:]).all()


def test_a_base_close_to_singular_angles_is_refused() -> None:
    quaternion = Rotation.from_euler("y", 85, degrees=True).as_quat(scalar_first=True)
    row = np.array([[0.0, 0, 0, *quaternion]])
    with pytest.raises(GtauError, match=r"within 5 degrees of the x axis of the world.*yaw: 1\.57"):
        base("world").positions(row)
    six = base("world", np.pi / 2).positions(row)
    assert np.abs(six[0, 4]) < 1e-12


def test_units_of_the_position() -> None:
    assert BaseUnits(length="mm").scale(base("world")) == [1e-3] * 3 + [1.0] * 4
    with pytest.raises(ValueError, match="'deg' is not a unit of length"):
        BaseUnits(length="deg")

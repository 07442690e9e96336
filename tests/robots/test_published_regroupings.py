"""Base parameters of named robots, on a base that stands, as their literature has them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from gtau.model.base_parameters import base_parameters
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.robot import Robot

# alpha, d and r of modified Denavit-Hartenberg parameters, whose theta is the joint's position
WAM = [(0, 0, 0), ("-pi/2", 0, 0), ("pi/2", 0, 0.55), ("-pi/2", 0.045, 0), ("pi/2", -0.045, 0.3), ("-pi/2", 0, 0),
       ("pi/2", 0, 0.06)]  # fmt: skip
PANDA = [(0, 0, 0.333), ("-pi/2", 0, 0), ("pi/2", 0, 0.316), ("pi/2", 0.0825, 0), ("-pi/2", -0.0825, 0.384),
         ("pi/2", 0, 0), ("pi/2", 0.088, 0)]  # fmt: skip

# Gaz, Cognetti, Oliva, Robuffo Giordano and De Luca 2019, doi 10.1109/LRA.2019.2931248, in the frames above: the
# coefficients of the code beside the paper (FrankaEmikaPandaDynModel), with inertias about the frames' origins
OF_PANDA = """
yy_2 + zz_1; xx_2 - yy_2 + yy_3 + 0.099856 m_3 + 0.10666225 m_4567 + 0.632 mz_3; xy_2; xz_2; yz_2;
yy_3 + zz_2 + 0.099856 m_3 + 0.10666225 m_4567 + 0.632 mz_3; xx_3 - yy_3 + yy_4 - 0.00680625 m_4; xy_3 + 0.0825 mz_4;
xz_3; yz_3; yy_4 + zz_3 + 0.00680625 m_4 + 0.0136125 m_567; xx_4 - yy_4 + yy_5 + 0.14064975 m_567 + 0.768 mz_5;
xy_4 + 0.03168 m_567 + 0.0825 mz_5; xz_4; yz_4; yy_5 + zz_4 + 0.15426225 m_567 + 0.768 mz_5;
xx_5 - yy_5 + yy_6 + 0.007744 m_7; xy_5; xz_5; yz_5; yy_6 + zz_5 + 0.007744 m_7; xx_6 - yy_6 + yy_7 - 0.007744 m_7;
xy_6 + 0.088 mz_7; xz_6; yz_6; yy_7 + zz_6 + 0.007744 m_7; xx_7 - yy_7; xy_7; xz_7; yz_7; zz_7;
mx_2; my_2 - 0.316 m_34567 - mz_3; mx_3 + 0.0825 m_4567; my_3 - mz_4; mx_4 - 0.0825 m_567; my_4 + 0.384 m_567 + mz_5;
mx_5; my_5 - mz_6; mx_6 + 0.088 m_7; my_6 - mz_7; mx_7; my_7"""

# The 60 in FIGAROH's results for a Staubli TX40 (figaroh-plus, TX40_bp_5.csv) and ia_6, which that list leaves out:
# FIGAROH's later benchmark has rank 61 of the same 87 parameters. M is motor 6, which turns with joints 5 and 6.
OF_TX40 = """
zz_1 + ia_1 + yy_2 + yy_3 + 0.07 mz_3 + 0.05185 m_3456;
xx_2 - yy_2 - 0.050625 m_3456; xy_2; xz_2 - 0.225 mz_3 - 0.007875 m_3456; yz_2; zz_2 + ia_2 + 0.050625 m_3456;
mx_2 + 0.225 m_3456; my_2; xx_3 - yy_3 + yy_4 + 0.45 mz_4 + 0.050625 m_456; xy_3; xz_3; yz_3;
zz_3 + yy_4 + 0.45 mz_4 + 0.050625 m_456; mx_3; my_3 - mz_4 - 0.225 m_456; ia_3; xx_4 - yy_4 + yy_5; xy_4; xz_4; yz_4;
zz_4 + yy_5; mx_4; my_4 + mz_5; ia_4; xx_5 - yy_5 + yy_6; xy_5; xz_5; yz_5; zz_5 + yy_6; mx_5; my_5 - mz_6; ia_5;
xx_6 - yy_6; xy_6; xz_6; yz_6; zz_6; mx_6; my_6; ia_6; ia_M; fv_M; fs_M; fv_1; fv_2; fv_3; fv_4; fv_5; fv_6;
fs_1; fs_2; fs_3; fs_4; fs_5; fs_6; off_1; off_2; off_3; off_4; off_5; off_6"""


def arm(rows: Sequence[tuple[object, float, float]], folder: Path) -> Robot:
    table = "".join(f"{k},{k - 1},1,0,0,0,{alpha},{d},q{k},{r}\n" for k, (alpha, d, r) in enumerate(rows, 1))
    path = folder / "arm.csv"
    path.write_text(f"j,a,mu,sigma,gamma,b,alpha,d,theta,r\n{table}")
    return load_robot(path)


def published(formulas: str, names: Sequence[str]) -> np.ndarray:
    """Coefficients (n_b, n_st) of the formulas; ``m_567`` stands for the sum of three masses."""
    rows = [np.zeros(len(names)) for _ in formulas.split(";")]
    for row, formula in zip(rows, formulas.split(";"), strict=True):
        for sign, factor, kind, links in re.findall(r"([+-]?) *([\d.]*) *\b([a-z]+)_(\w+)", formula):
            for link in links:
                row[names.index(f"{kind}_{link}")] += float(f"{sign}{factor or 1}")
    return np.array(rows)


def follow(expected: np.ndarray, found: np.ndarray) -> None:
    """Check that published combinations (n_b, n_st) are as many as gtau's base parameters and follow from them."""
    assert np.linalg.matrix_rank(expected) == len(expected) == len(found)
    known = np.linalg.lstsq(found.T, expected.T, rcond=None)[0]
    np.testing.assert_allclose(found.T @ known, expected.T, atol=1e-9)


def test_regroupings_of_a_panda(tmp_path: Path) -> None:
    """All 43 published combinations of standard parameters, and no other, follow from gtau's base parameters."""
    model = InverseDynamics(arm(PANDA, tmp_path), "inertial")
    expected = published(OF_PANDA, model.parameter_names)
    assert expected.shape == (43, 70)
    follow(expected, base_parameters(model).matrix)


def test_regroupings_of_a_tx40() -> None:
    """All 61 of FIGAROH, whose motors have no parameters but that of the wrist's coupling, on joints 5 and 6."""
    model = InverseDynamics(load_robot("staubli-tx40"))
    names = [name.replace("motor_6", "M").replace("joint_", "") for name in model.parameter_names]
    there = [k for k, name in enumerate(names) if "motor" not in name and name != "off_M"]
    expected = published(OF_TX40, [names[k] for k in there])
    assert expected.shape == (61, 87)
    follow(expected, base_parameters(model).matrix[:, there])


def test_counts_of_a_wam(tmp_path: Path) -> None:
    """98 standard and 69 base parameters: Sousa and Cortesao 2014, doi 10.1177/0278364913514870, in its notebook."""
    model = InverseDynamics(arm(WAM, tmp_path))
    assert len(model.parameter_names) == 98
    assert base_parameters(model).count == 69


def walkman(folder: Path) -> Path:
    """The 29 joints of WALK-MAN, as FloBaRoID moves them: its neck is fixed; a side is 1 for the left and -1."""
    rows = [("lat", "ground", "0.1115, 0, 0.195982", 0.0, "0.89879991307, 0, 0.43835911792"),
            ("sag", "lat", "0, 0, 0", 0.0, "0, 1, 0"), ("yaw", "sag", "0, 0, 0.22275", 0.0, "0, 0, 1")]  # fmt: skip
    for side, s in (("l", 1), ("r", -1)):
        leg = [(f"0.1059, {0.06 * s}, 0", "1, 0, 0"), (f"-0.0889, {0.121032 * s}, -0.217872", "0, 0, 1"),
               ("0, 0, 0", "0, 1, 0"), ("0, 0, -0.356", "0, 1, 0"), ("0, 0, -0.4", "0, 1, 0"),
               ("0, 0, 0", "1, 0, 0")]  # fmt: skip
        arm = [(f"0.045646, {0.219164 * s}, 0.001531", f"0, 0.743144825, {0.669130606 * s}"),
               (f"0, {0.116568264 * s}, 0.03364", "1, 0, 0"), ("0, 0, -0.222", "0, 0, 1"),
               ("0.036, 0, -0.15", "0, 1, 0"), ("-0.075, 0, -0.1955", "0, 0, 1"), ("0, 0, 0", "0, 1, 0"),
               ("0, 0, -0.092", "1, 0, 0")]  # fmt: skip
        for limb, first, links in (("leg", "ground", leg), ("arm", "yaw", arm)):
            turned = -0.3491 * s if limb == "arm" else 0.0
            for k, (xyz, axis) in enumerate(links):
                before = f"{side}_{limb}{k - 1}" if k else first
                rows.append((f"{side}_{limb}{k}", before, xyz, 0.0 if k else turned, axis))
    joints = "".join(
        f"  {name}: {{antecedent: {before}, xyz: [{xyz}], rpy: [0, 0, {turn}], axis: [{axis}], type: revolute}}\n"
        for name, before, xyz, turn, axis in rows
    )
    path = folder / "walkman.yaml"
    path.write_text(f"robot: walkman\njoints:\n{joints}")
    return path


def test_count_of_a_floating_humanoid(tmp_path: Path) -> None:
    """FloBaRoID finds 213 directions for WALK-MAN hung up, from joint torques and the wrench on its base."""
    robot = load_robot(walkman(tmp_path), base="floating")
    assert len(robot.joints) == 6 + 29
    assert base_parameters(InverseDynamics(robot, "inertial")).count == 213


@pytest.mark.parametrize(("name", "count"), [("puma560", 36), ("ur10e", 36)])
def test_a_base_that_floats_adds_sixteen(name: str, count: int) -> None:
    """A vertical first axis sees one parameter of its link; each joint of a free body seven: 10 + 7 n."""
    fixed, floating = (base_parameters(InverseDynamics(load_robot(name, base=base), "inertial")).count
                       for base in (None, "floating"))  # fmt: skip
    assert (fixed, floating) == (count, 10 + 7 * 6)

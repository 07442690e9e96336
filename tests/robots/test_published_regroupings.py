"""Base parameters of named robots, on a base that stands, as their literature has them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from gtau.estimation.regression.base_parameters import base_parameters
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
FORMULAS = """
yy_2 + zz_1; xx_2 - yy_2 + yy_3 + 0.099856 m_3 + 0.10666225 m_4567 + 0.632 mz_3; xy_2; xz_2; yz_2;
yy_3 + zz_2 + 0.099856 m_3 + 0.10666225 m_4567 + 0.632 mz_3; xx_3 - yy_3 + yy_4 - 0.00680625 m_4; xy_3 + 0.0825 mz_4;
xz_3; yz_3; yy_4 + zz_3 + 0.00680625 m_4 + 0.0136125 m_567; xx_4 - yy_4 + yy_5 + 0.14064975 m_567 + 0.768 mz_5;
xy_4 + 0.03168 m_567 + 0.0825 mz_5; xz_4; yz_4; yy_5 + zz_4 + 0.15426225 m_567 + 0.768 mz_5;
xx_5 - yy_5 + yy_6 + 0.007744 m_7; xy_5; xz_5; yz_5; yy_6 + zz_5 + 0.007744 m_7; xx_6 - yy_6 + yy_7 - 0.007744 m_7;
xy_6 + 0.088 mz_7; xz_6; yz_6; yy_7 + zz_6 + 0.007744 m_7; xx_7 - yy_7; xy_7; xz_7; yz_7; zz_7;
mx_2; my_2 - 0.316 m_34567 - mz_3; mx_3 + 0.0825 m_4567; my_3 - mz_4; mx_4 - 0.0825 m_567; my_4 + 0.384 m_567 + mz_5;
mx_5; my_5 - mz_6; mx_6 + 0.088 m_7; my_6 - mz_7; mx_7; my_7"""


def arm(rows: Sequence[tuple[object, float, float]], folder: Path) -> Robot:
    table = "".join(f"{k},{k - 1},1,0,0,0,{alpha},{d},q{k},{r}\n" for k, (alpha, d, r) in enumerate(rows, 1))
    path = folder / "arm.csv"
    path.write_text(f"j,a,mu,sigma,gamma,b,alpha,d,theta,r\n{table}")
    return load_robot(path)


def published(names: Sequence[str]) -> np.ndarray:
    """Coefficients (n_b, n_st) of the formulas; ``m_567`` stands for the sum of three masses."""
    rows = [np.zeros(len(names)) for _ in FORMULAS.split(";")]
    for row, formula in zip(rows, FORMULAS.split(";"), strict=True):
        for sign, factor, kind, links in re.findall(r"([+-]?) *([\d.]*) *\b([mxyz]+)_(\d+)", formula):
            for link in links:
                row[names.index(f"{kind}_{link}")] += float(f"{sign}{factor or 1}")
    return np.array(rows)


def test_regroupings_of_a_panda(tmp_path: Path) -> None:
    """All 43 published combinations of standard parameters, and no other, follow from gtau's base parameters."""
    model = InverseDynamics(arm(PANDA, tmp_path), "inertial")
    found = base_parameters(model)
    expected = published(list(model.parameter_names))
    assert expected.shape == (43, 70)
    assert np.linalg.matrix_rank(expected) == found.count == 43
    known = np.linalg.lstsq(found.matrix.T, expected.T, rcond=None)[0]
    np.testing.assert_allclose(found.matrix.T @ known, expected.T, atol=1e-9)


def test_counts_of_a_wam(tmp_path: Path) -> None:
    """98 standard and 69 base parameters: Sousa and Cortesao 2014, doi 10.1177/0278364913514870, in its notebook."""
    model = InverseDynamics(arm(WAM, tmp_path))
    assert len(model.parameter_names) == 98
    assert base_parameters(model).count == 69


@pytest.mark.parametrize(("name", "count"), [("puma560", 36), ("ur10e", 36)])
def test_a_base_that_floats_adds_sixteen(name: str, count: int) -> None:
    """A vertical first axis sees one parameter of its link; each joint of a free body seven: 10 + 7 n."""
    fixed, floating = (base_parameters(InverseDynamics(load_robot(name, base=base), "inertial")).count
                       for base in (None, "floating"))  # fmt: skip
    assert (fixed, floating) == (count, 10 + 7 * 6)

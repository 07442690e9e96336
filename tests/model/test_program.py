"""The batched interpreter against CasADi, and the batched least squares against LAPACK."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from robots_for_tests import planar_3rrr

from gtau.model.equations import parameter_names, solve as symbolic_solve, torques
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.kinematics import Coordinates
from gtau.model.program import LANES, compile_program

BATCHES = [0, 1, LANES - 1, LANES, LANES + 1, 3 * LANES + 5]


def reference(inputs, outputs, values):
    """CasADi's own evaluation, one sample after another, (outputs, N)."""
    function = ca.Function("reference", [ca.veccat(*inputs)], [ca.densify(ca.veccat(*outputs))])
    return np.column_stack([np.array(function(column)).ravel() for column in values.T])


def solve(a, pattern, b, refine):
    """Solutions (n, k, N) and condition numbers (N,) for ``a`` (m, n, N), zero off ``pattern``, and ``b`` (m, k, N)."""
    (m, n, samples), k = a.shape, b.shape[1]
    A, B = ca.SX.sym("A", ca.sparsify(ca.DM(pattern.astype(float))).sparsity()), ca.SX.sym("B", m, k)
    rows, columns = (np.array(index, dtype=int) for index in A.sparsity().get_triplet())
    x, condition = symbolic_solve(A, B, refine)
    found = compile_program([ca.vec(A.nz[:]), B.T], [condition, x.T])(a[rows, columns], b.reshape(m * k, samples))
    return found[1:].reshape(n, k, samples), found[0]


@pytest.mark.parametrize("samples", BATCHES)
def test_every_operation(samples, rng):
    x, y = ca.SX.sym("x", 3), ca.SX.sym("y", 2)
    outputs = [
        x + ca.vertcat(y, 2.5),
        ca.vertcat(x[0] - y[0], x[0] * y[1], x[1] / y[1], -x[2], x[0] * x[0], x[1] + x[1]),
        ca.vertcat(ca.sin(x[0]), ca.cos(x[1]), ca.sqrt(ca.fabs(y[0])), ca.sign(x[2]), 1 / y[0]),
        ca.vertcat(x[0], 7.0, 0.0, ca.sign(ca.SX(0))),
    ]
    values = rng.normal(size=(5, samples))
    found = compile_program([x, y], outputs)(values)
    assert found.shape == (18, samples)
    if samples:
        assert_allclose(found, reference([x, y], outputs, values), rtol=4e-16, atol=4e-16)


def test_structural_zeros_come_out_as_zeros_column_by_column():
    x = ca.SX.sym("x", 2)
    matrix = ca.SX(2, 2)
    matrix[0, 1], matrix[1, 0] = x[0], x[1]
    program = compile_program([x], [matrix])
    assert program(np.array([[3.0], [5.0]])).ravel().tolist() == [0.0, 5.0, 3.0, 0.0]


def test_sign_of_zero_is_zero():
    x = ca.SX.sym("x")
    assert compile_program([x], [ca.sign(x)])(np.array([[-2.0, 0.0, 3.0]])).tolist() == [[-1.0, 0.0, 1.0]]


def test_a_lane_does_not_see_another(rng):
    """Not-a-number in one sample stays in that sample."""
    x = ca.SX.sym("x", 2)
    program = compile_program([x], [x[0] * x[1] + ca.sin(x[0])])
    values = rng.normal(size=(2, 100))
    clean = program(values)
    values[0, 17] = np.nan
    found = program(values)
    assert np.isnan(found[0, 17])
    assert np.array_equal(np.delete(found, 17, axis=1), np.delete(clean, 17, axis=1))


def test_what_the_interpreter_does_not_know_is_refused_when_compiled():
    x = ca.SX.sym("x")
    with pytest.raises(ValueError, match="which the interpreter does not support"):
        compile_program([x], [ca.erf(x)])


@pytest.mark.parametrize("shape", [(3,), (2, 4), (4, 4)])
def test_inputs_of_another_shape_are_refused(shape):
    x = ca.SX.sym("x", 3)
    with pytest.raises(ValueError, match=r"\(3, N\)"):
        compile_program([x], [x])(np.zeros(shape))


def test_a_whole_regressor(rng):
    """The entries of a parallel robot's regressor are those that CasADi computes."""
    robot = planar_3rrr()
    layout = Coordinates(robot)
    symbols = [ca.SX.sym(*each) for each in (("c", layout.n_c), ("yd", layout.n_y), ("ydd", layout.n_y))]
    projection = ca.SX.sym("J", len(layout.passive), len(layout.actuated))
    J = ca.SX(layout.n_y, len(layout.actuated))
    J[layout.actuated.tolist(), :] = ca.SX.eye(3)
    J[layout.passive.tolist(), :] = projection
    chi = {name: ca.SX.sym(name) for name in parameter_names(robot)}
    W = ca.jacobian(torques(layout, *symbols, J, chi), ca.vertcat(*chi.values()))
    values = rng.normal(size=(layout.n_c + 2 * layout.n_y + projection.numel(), 5))
    expected = reference([*symbols, projection.T], [W], values).reshape(len(chi), 3, -1)
    full = InverseDynamics(robot).full
    found = np.zeros_like(expected)
    found[full.columns, full.rows] = full.program(values)
    assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("samples", BATCHES)
@pytest.mark.parametrize(("m", "n", "k"), [(1, 1, 1), (3, 3, 2), (18, 15, 3), (7, 2, 0)])
def test_least_squares(m, n, k, samples, rng):
    pattern = rng.uniform(size=(m, n)) < 0.6
    pattern[:n] |= np.eye(n, dtype=bool)
    a = rng.normal(size=(m, n, samples)) * pattern[:, :, None] + 3.0 * np.eye(m, n)[:, :, None]
    b = rng.normal(size=(m, k, samples))
    x, condition = solve(a, pattern, b, True)
    assert x.shape == (n, k, samples)
    for s in range(samples):
        true = np.linalg.cond(a[:, :, s])
        assert true * (1 - 1e-9) <= condition[s] <= n * true * (1 + 1e-9)
        if k:
            expected = np.linalg.lstsq(a[:, :, s], b[:, :, s], rcond=None)[0]
            assert_allclose(x[:, :, s], expected, atol=1e-14 * true**2 * np.abs(b[:, :, s]).max())


def test_refinement_gives_back_what_normal_equations_lose(rng):
    """At condition 1e5, consistent equations: 1e-6 without refinement at best, 1e-11 with it."""
    u, _, vt = np.linalg.svd(rng.normal(size=(8, 5)), full_matrices=False)
    a = (u * np.logspace(0, -5, 5)) @ vt
    exact = rng.normal(size=(5, 1))
    b = a @ exact
    pattern = np.ones(a.shape, dtype=bool)
    rough, _ = solve(a[:, :, None], pattern, b[:, :, None], False)
    fine, condition = solve(a[:, :, None], pattern, b[:, :, None], True)
    assert np.abs(fine[:, :, 0] - exact).max() < 1e-10
    assert np.abs(fine[:, :, 0] - exact).max() < 0.01 * np.abs(rough[:, :, 0] - exact).max()
    assert condition[0] == pytest.approx(1e5, rel=0.2)


def test_a_singular_sample_shows_in_its_condition_alone(rng):
    a = rng.normal(size=(4, 3, 70))
    a[:, 2, 40] = a[:, 0, 40] + a[:, 1, 40]
    x, condition = solve(a, np.ones((4, 3), dtype=bool), a[:, :1], True)
    assert not condition[40] < 1e6
    assert (np.delete(condition, 40) < 1e6).all()
    assert_allclose(np.delete(x, 40, axis=2)[:, 0], np.repeat([[1.0], [0.0], [0.0]], 69, axis=1), atol=1e-9)

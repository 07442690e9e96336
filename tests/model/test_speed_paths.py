"""What was made fast computes what it should, whatever the threads, the blocks and the number of samples."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from robots_for_tests import hexapod, seven_r, trajectory

from gtau.estimation.regression.factors import EXTRA, reduce_run, triangle
from gtau.estimation.regression.rows import stream_rows
from gtau.model import inverse_dynamics as inverse_dynamics_module
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import PATH, InverseDynamics
from gtau.model.loops import follow
from gtau.model.program import LANES, OTHERS, SUMS, compile_program
from gtau.signals.preparation.filters import Decimator
from gtau.signals.preparation.prepared_run import SampleWindow
from gtau.signals.run import Run


def program_of(function, inputs=2):
    x = ca.SX.sym("x", inputs)
    return compile_program([x], [function(x)])


@pytest.mark.parametrize("scale", [1e-9, 1.0, 50.0, 1e4, 1e8, 1e12])
def test_sine_and_cosine(scale, rng):
    """To a unit in the last place of 1, at any angle; beyond 1e6 rad as the system's library."""
    x = np.concatenate([rng.uniform(-scale, scale, 5000), scale * np.arange(-8, 9) * np.pi / 4])[None, :]
    found = program_of(lambda x: ca.vertcat(ca.sin(x), ca.cos(x)), 1)(x)
    assert_allclose(found, np.concatenate([np.sin(x), np.cos(x)]), rtol=0, atol=2.3e-16)
    small = np.array([[0.0, -0.0, 1e-300, 1e-20]])
    assert np.array_equal(program_of(ca.sin, 1)(small), small)


def test_what_is_not_a_number_is_not_hidden():
    """A residual that is not a number must not pass for a small one."""
    x = np.array([[np.nan, 1.0, np.inf], [1.0, np.nan, 2.0]])
    found = program_of(lambda x: ca.vertcat(ca.fmax(x[0], x[1]), ca.sin(x[0]), ca.fabs(x[1])))(x)
    assert np.isnan(found[0]).tolist() == [True, True, False]
    assert np.isnan(found[1]).tolist() == [True, False, True]
    assert np.isnan(found[2]).tolist() == [False, True, False]


def operations(program):
    """Operations of a program, in order; of sums the numbers of terms and of products."""
    return [(*SUMS, *OTHERS)[operation] for operation in program.code[:, 0]]


def test_sums_take_up_the_sums_and_products_used_once():
    x = ca.SX.sym("x", 4)
    product = x[0] * x[1]
    program = compile_program([x], [product + x[2], x[2] * x[3] - x[0], x[1] - x[2] * x[0], product - x[3]])
    # the first product is used twice and stays; the other two are made together with their differences
    assert sorted(operations(program)) == [(0, 1), (1, 1), (1, 1), (2, 0), (2, 0)]
    values = np.array([2.0, 3.0, 5.0, 7.0])
    assert program(values[:, None]).ravel().tolist() == [11.0, 33.0, -7.0, -1.0]


def test_sums_grow_to_what_one_instruction_computes():
    x = ca.SX.sym("x", 6)
    program = compile_program([x], [(x[0] * x[1] + x[2] * x[3] - x[4]) * x[5]])
    assert operations(program) == [(1, 2), (0, 1)]
    assert program(np.arange(2.0, 8.0)[:, None]).item() == (2 * 3 + 4 * 5 - 6) * 7
    y = ca.SX.sym("y", 12)
    terms = sum(y[k] * y[k + 1] * (-1) ** k for k in range(11)) - y[0] + y[3] - y[5]
    long = compile_program([y], [terms])
    assert len(long.code) <= 7
    values = np.arange(1.0, 13.0)
    assert long(values[:, None]).item() == sum(values[:-1] * values[1:] * (-1.0) ** np.arange(11)) - 1 + 4 - 6


def test_every_operand_may_be_a_result(rng):
    """Once or twice, also where it is an output itself."""
    x = ca.SX.sym("x", 4)
    root = ca.sqrt(x[0])
    values = rng.uniform(1.0, 2.0, (4, 3))
    a, (_, b, c, _) = np.sqrt(values[0]), values
    cases = {
        root * x[1]: a * b,
        root + x[1]: a + b,
        root - x[1]: a - b,
        x[1] - root: b - a,
        root * root: a * a,
        root * x[1] + root: a * b + a,
        root * root - x[1]: a * a - b,
        x[1] - root * root: b - a * a,
        x[1] * x[2] + root: b * c + a,
        x[1] * x[2] - root: b * c - a,
        root - x[1] * x[2]: a - b * c,
        x[1] * root + x[2]: a * b + c,
        root * x[1] - x[2]: a * b - c,
        x[2] - x[1] * root: c - a * b,
    }
    for expression, expected in cases.items():
        for used_again in ([], [root]):
            found = compile_program([x], [expression, *used_again])(values)
            assert_allclose(found[0], expected, atol=1e-15)
            for again in found[1:]:
                assert_allclose(again, a, atol=1e-15)


def test_a_change_of_sign_goes_into_the_sum():
    x = ca.SX.sym("x", 2)
    for expression, value in ((x[0] + -(x[1]), -1.0), (-x[0] + x[1], 1.0), (x[0] - -(x[1]), 5.0), (-x[0] - x[1], -5.0)):
        assert compile_program([x], [expression])(np.array([[2.0], [3.0]])).item() == value


def test_values_divided_by_the_same_share_a_reciprocal(rng):
    x = ca.SX.sym("x", 3)
    program = compile_program([x], [x[0] / x[2], x[1] / x[2], x[0] / 3.0, 1 / x[2], x[0] / x[1]])
    assert operations(program).count("DIV") == 2
    values = rng.uniform(1.0, 2.0, (3, 5))
    a, b, c = values
    assert_allclose(program(values), [a / c, b / c, a / 3, 1 / c, a / b], rtol=4e-16)


@pytest.mark.parametrize("samples", [0, 1, LANES - 1, LANES, 3 * LANES + 5])
def test_parameters_are_the_same_for_all_samples(samples, rng):
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p", 3)
    program = compile_program([x], [p[0] * x[0] + p[1] * ca.sin(x[1]), p[2], x[1]], [p])
    values, parameters = rng.normal(size=(2, samples)), rng.normal(size=3)
    expected = [
        parameters[0] * values[0] + parameters[1] * np.sin(values[1]),
        np.full(samples, parameters[2]),
        values[1],
    ]
    assert_allclose(program(values[:1], values[1:], parameters=parameters), expected, rtol=1e-15, atol=1e-15)
    with pytest.raises(ValueError, match="3 parameters"):
        program(values)


@pytest.mark.parametrize("samples", [0, 1, LANES - 1, LANES, 3 * LANES + 5])
@pytest.mark.parametrize("outputs", [4, 11, 30])
def test_outputs_put_into_a_table(samples, outputs, rng):
    """Whether their places stand together or not, and in whatever order."""
    x = ca.SX.sym("x", 2)
    program = compile_program([x], [3.0, *(x[0] * x[1] + k * x[0] for k in range(outputs - 1))])
    values = rng.normal(size=(2, samples))
    for places in (rng.permutation(outputs) + 2, rng.permutation(3 * outputs)[:outputs], np.arange(outputs)):
        table = np.full((samples, 3 * outputs), 7.0)
        order = np.argsort(places)
        program.fill(table, order, places[order], values)
        assert np.array_equal(table[:, places], program(values).T)
        assert (np.delete(table, places, axis=1) == 7.0).all()


def test_rows_need_not_stand_together(rng):
    """Inputs may be views: of every other row, or of columns of a longer array."""
    program = program_of(lambda x: ca.vertcat(x[0] - x[1], x[0] * x[1]))
    values = rng.normal(size=(4, 300))
    expected = np.stack([values[0] - values[2], values[0] * values[2]])
    assert np.array_equal(program(values[::2]), expected)
    assert np.array_equal(program(values[::2, 7:211]), expected[:, 7:211])
    assert np.array_equal(program(values[::2, ::3]), expected[:, ::3])
    assert np.array_equal(program(np.asfortranarray(values[::2])), expected)


@pytest.mark.parametrize(
    "robot",
    [load_robot("orthoglide"), pytest.param(hexapod(), marks=pytest.mark.slow), seven_r()],
    ids=lambda robot: robot.name,
)
def test_threads_change_nothing(robot, monkeypatch):
    """Bit for bit, closures included."""
    q, qd, qdd = trajectory(robot, np.linspace(0.0, 12.0, 5003))
    idm = InverseDynamics(robot)
    chi = np.linspace(-1.0, 1.0, len(idm.parameter_names))
    found = []
    for threads in ("1", "2", "3"):
        monkeypatch.setenv("GTAU_THREADS", threads)
        motion = idm.motion(q.T, qd.T, qdd.T)
        found.append((motion.c, motion.ydd, motion.J, idm.torques(q, qd, qdd, chi), idm.regressor(q, qd, qdd)))
    for others in found[1:]:
        for one, other in zip(found[0], others, strict=True):
            assert np.array_equal(one, other)


def test_blocks_change_nothing():
    """Torques along a path longer than a block, and than a part of a path, are those of all its samples at once."""
    robot = load_robot("orthoglide")
    idm = InverseDynamics(robot)
    chi = np.linspace(-1.0, 1.0, len(idm.parameter_names))
    for samples, rtol in ((5001, 1e-12), (PATH + 5001, 1e-10)):
        q, qd, qdd = trajectory(robot, np.linspace(0.0, 3.0, samples))
        whole = idm.full.torques_along(idm.layout, idm.motion(q.T, qd.T, qdd.T), chi).T
        assert_allclose(idm.torques(q, qd, qdd, chi), whole, rtol=rtol, atol=rtol * np.abs(whole).max())
    W = idm.regressor(q[:5001], qd[:5001], qdd[:5001])
    assert_allclose(W @ chi, whole[:5001], rtol=1e-10, atol=1e-10 * np.abs(whole).max())


def test_a_path_at_slow_and_at_fast_sampling_is_the_same():
    """Guesses from the samples before lead nowhere else than steps from sample to sample."""
    robot = hexapod()
    idm = InverseDynamics(robot)
    fine = trajectory(robot, np.linspace(0.0, 6.0, 6001))[0].T
    c = follow(idm.loops, fine)
    assert_allclose(follow(idm.loops, fine[:, ::50]), c[:, ::50], atol=1e-11)
    rough = fine + 1e-4 * np.sin(1e3 * np.arange(6001) ** 2)  # no parabola foresees this
    assert idm.loops.gap(follow(idm.loops, rough)).max() < 1e-12


def test_factors_are_those_of_all_rows(rng):
    """Merged block by block over each joint's own columns, they have the Gram matrices of the rows."""
    robot = load_robot("ur10e")
    idm = InverseDynamics(robot)
    n_samples, rate = 20000, 200.0
    time = np.arange(n_samples) / rate
    q, qd, qdd = trajectory(robot, time)
    command, command_d, command_dd = rng.normal(size=(3, *q.shape))
    usable = rng.uniform(size=q.shape) < 0.999
    run = Run("made up", robot.actuated, time, q, command)
    prepared = SampleWindow(run, time, q, qd, qdd, command, command_d, command_dd, usable)
    names = tuple(idm.parameter_names[k] for k in range(3, len(idm.parameter_names), 2))
    decimator = Decimator(5)
    factors = reduce_run(idm, names, prepared, decimator)
    (whole,) = [*stream_rows(idm, idm.columns(names), prepared, Decimator(5))][:1]
    assert whole.entries.shape[1] < 1000
    regressor = idm.columns(names)
    n, p = 6, len(names) + EXTRA
    gram, kept = np.zeros((n, p, p)), np.zeros(n, dtype=int)
    for part in stream_rows(idm, regressor, prepared, decimator):
        for j in range(n):
            A = np.zeros((len(part.time), p))
            mine = np.flatnonzero(regressor.rows == j)
            A[:, regressor.columns[mine]] = part.entries[mine].T
            A[:, -EXTRA:] = np.concatenate([part.terms[:, j], -part.external[[j]], part.currents[:, j]]).T
            A = A[part.keep[j]]
            gram[j] += A.T @ A
            kept[j] += len(A)
    assert np.array_equal(factors.rows.sum(axis=0), kept)
    for j in range(n):
        for R in factors.R[:, j]:
            assert np.array_equal(R, np.triu(R))
        R = triangle(*factors.R[:, j])
        scale = np.sqrt(np.diag(gram[j]))
        scale[scale == 0] = 1.0
        assert_allclose(R.T @ R / np.outer(scale, scale), gram[j] / np.outer(scale, scale), atol=1e-12)


def test_importing_gtau_imports_nothing_heavy():
    heavy = ["numba", "casadi", "scipy", "polars", "matplotlib", "pydantic"]
    code = f"import sys, gtau; print([name for name in {heavy} if name in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env={
        **os.environ, "PYTHONPATH": str(Path(inverse_dynamics_module.__file__).parents[2])})  # fmt: skip
    assert found.stdout.strip() == "[]"

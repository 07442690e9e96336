"""Derivatives of motions, weights and criteria against differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from robots_for_tests import four_bar, hexapod, palletizer, random_samples

from gtau.errors import GtauError
from gtau.excitation.constraints import constraint_usages
from gtau.excitation.information import NAMED, Window, criterion, derivative
from gtau.excitation.nlp import objective
from gtau.excitation.prior import KnownGain, PriorModel
from gtau.excitation.task import DesignProblem, MotionLimits, design_grid, evaluate
from gtau.excitation.trajectory import (
    FourierSeries,
    Pullback,
    move_duration,
    quintic,
    smooth_regressor,
)
from gtau.model.base_parameters import base_parameters
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.robot import SPRING, Attachment, Limits, Pose, Robot, Spring
from gtau.signals.reading.statements import Payload

DISC = Payload(name="disc", mass=2.0, parameters={"mx": 0.2})


def make_task(robot: Robot) -> DesignProblem:
    """Two runs of a robot of arbitrary parameters, every kind of limit given, of passive joints too."""
    swinging = Limits((-4.0, 4.0), 5.0)
    joints = [joint if joint.actuated else replace(joint, limits=swinging) for joint in robot.joints]
    robot = replace(robot, joints=tuple(joints))
    model = InverseDynamics(robot)
    base, n = base_parameters(model), len(model.actuated)
    rng = np.random.default_rng(3)
    limits = MotionLimits(
        position=np.array([robot.joint(name).limits.position for name in model.actuated]),
        rates=np.outer([1.0, 5.0, 50.0], np.ones(n)),
        current=np.full(n, 20.0),
        workspace={"x": (-2.0, 2.0), "z": (-2.0, 2.0)},
        condition=200.0,
        away=0.2,
        tool_speed=1.0,
    )
    half = 0.05 if robot.closures else 2.0
    series = FourierSeries(limits.position.mean(axis=1), np.full(n, half), 0.2, 4)
    chi = base.matrix @ rng.uniform(0.2, 1.0, len(model.parameter_names))
    prior = PriorModel(chi, (KnownGain(9.0, (9.0, 9.0), "given"),) * n, np.full(n, 0.02), chi)
    return DesignProblem(model, base, series, 500.0, 1, None, (None, DISC), limits, prior)


def slope(function, x: np.ndarray, way: np.ndarray, h: float = 1e-5) -> float:
    """Derivative along ``way`` by differences of fourth order."""
    near, far = ((function(x + k * h * way) - function(x - k * h * way)) / (2 * k * h) for k in (1, 2))
    return float((4 * near - far) / 3)


@pytest.fixture(scope="module", params=["orthoglide", "ur10e"])
def task(request) -> DesignProblem:
    return make_task(load_robot(request.param))


@pytest.mark.parametrize("name", [*NAMED, "gain"])
def test_gradients_of_criteria_agree_with_differences(task: DesignProblem, name: str, rng: np.random.Generator) -> None:
    called = f"gain_{task.model.actuated[0]}" if name == "gain" else name
    chosen, grid = criterion(called, task.information), design_grid(task)
    x = 0.3 * task.series.random(rng)
    point = evaluate(task, x, grid)
    gradient = objective(point, chosen, name == "condition")[1]
    for _ in range(3):
        way = rng.normal(size=x.size)
        computed = slope(lambda x: objective(evaluate(task, x, grid, point), chosen, name == "condition")[0], x, way)
        # the condition number of the Orthoglide's 61 columns is 1e9, and its logarithm known to 1e-6 of a unit
        precision = 1e-2 if name == "condition" and task.model.loops else 1e-6
        assert gradient @ way == pytest.approx(computed, rel=precision, abs=precision * np.linalg.norm(gradient))


def test_slopes_of_loads_agree_with_differences(task: DesignProblem, rng: np.random.Generator) -> None:
    grid, x = design_grid(task), 0.3 * task.series.random(rng)
    point, way, h = evaluate(task, x, grid), rng.normal(size=x.size), 1e-6
    ahead, behind = (list(constraint_usages(evaluate(task, x + s * h * way, grid, point))) for s in (1, -1))
    kinds, named = set(), set()
    for load, after, before in zip(constraint_usages(point), ahead, behind, strict=True):
        expected = (after.values - before.values) / (2 * h)
        computed = load.rows() @ way
        assert np.abs(computed - expected).max() <= 3e-5 * (np.abs(expected).max() + 1e-3), load.what
        kinds.add(load.what.split()[0])
        named.add(load.what)
    assert {"position", "velocity", "acceleration", "jerk", "current", "x", "z", "speed", "time"} <= kinds
    for joint in task.model.robot.joints:
        assert {f"position of joint '{joint.name}'", f"velocity of joint '{joint.name}'"} <= named


def sprung() -> Robot:
    ends = Attachment("ground", Pose((0.1, 0.3, 0.1))), Attachment(four_bar().joints[-1].name, Pose((0.1, 0.02, 0.0)))
    return replace(four_bar(), name="sprung", springs=(Spring("coil", *ends, SPRING),))


@pytest.mark.parametrize(
    "robot",
    [four_bar(), pytest.param(hexapod(), marks=pytest.mark.slow), palletizer(), sprung()],
    ids=lambda robot: robot.name,
)
def test_slopes_through_closures_agree_with_differences(robot: Robot, rng: np.random.Generator) -> None:
    model = InverseDynamics(robot)
    back = Pullback(model)
    regressor = smooth_regressor(model, model.parameter_names, np.full(len(robot.joints), 0.3))
    samples = 8
    states = [state.T.copy() for state in random_samples(robot, rng, samples)]
    weights = rng.normal(size=(len(model.actuated), samples, len(model.parameter_names)))

    def value(states: list[np.ndarray]) -> np.ndarray:
        motion = model.motion(*states)
        return np.einsum("jsk,jsk->s", weights, regressor(motion)) + 3 * np.log(motion.condition)

    motion = model.motion(*states)
    computed = back(motion, regressor.slopes(motion, weights), by_condition=3.0)
    for order in range(3):
        for j in range(len(model.actuated)):
            moved = [[state.copy() for state in states] for _ in range(2)]
            moved[0][order][j] += 1e-5
            moved[1][order][j] -= 1e-5
            expected = (value(moved[0]) - value(moved[1])) / 2e-5
            assert np.abs(computed[order][j] - expected).max() < 1e-6 * max(1.0, np.abs(expected).max())


def test_smooth_regressor_is_the_regressor_away_from_reversals(rng: np.random.Generator) -> None:
    model = InverseDynamics(load_robot("orthoglide"))
    q, qd, qdd = random_samples(model.robot, rng, 20)
    motion = model.motion(q.T.copy(), qd.T.copy(), qdd.T.copy())
    smooth = smooth_regressor(model, model.parameter_names, np.full(len(model.robot.joints), 1e-9))
    assert smooth(motion).transpose(1, 0, 2) == pytest.approx(model.regressor(q, qd, qdd), abs=1e-9)


def test_weights_fall_at_reversals_and_their_slopes_agree_with_differences(rng: np.random.Generator) -> None:
    window = Window(step=0.05, reach=0.12, fraction=0.05, floor=np.array([0.0, 0.3]))
    time = 0.05 * np.arange(80)
    qd = np.stack([np.sin(2 * np.pi * (time + 0.01) / 4), np.cos(2 * np.pi * 3 * time / 4) + 0.3])
    weights = window.weights(qd)
    crossing = np.sign(qd) != np.sign(np.roll(qd, -1, axis=1))
    assert weights[crossing].max() < 0.3
    assert weights[0, 20] == pytest.approx(1.0, abs=0.02)
    # what hardly moves beside its approach and return is lost, as identification loses it
    assert window.weights(0.01 * qd).mean(axis=1)[1] < 0.1 < window.weights(0.01 * qd).mean(axis=1)[0]
    seed, way = rng.normal(size=(2, *qd.shape))
    computed = np.sum(window.back(qd, seed) * way)
    assert computed == pytest.approx(slope(lambda x: np.sum(seed * window.weights(x)), qd, way), rel=1e-6)


def test_trajectories_begin_at_rest_and_are_their_own_derivatives(rng: np.random.Generator) -> None:
    series = FourierSeries(np.array([0.3, -1.0]), np.array([0.5, 2.0]), 0.25, 4)
    x = series.random(rng)
    time = np.linspace(0, 4, 4001)
    q, qd, qdd, jerk = series.along(x, series.basis(time))
    assert np.abs([qd[:, 0], qd[:, -1], qdd[:, 0], qdd[:, -1]]).max() < 1e-12 * np.abs(qdd).max()
    for value, rate in ((q, qd), (qd, qdd), (qdd, jerk)):
        periodic = derivative(value[:, :-1], time[1])
        assert periodic == pytest.approx(rate[:, :-1], abs=1e-6 * np.abs(rate).max())
    limits = np.array([0.7, 0.4]), np.array([2.0, 3.0]), np.array([9.0, 20.0])
    start, end = np.array([0.0, 0.5]), np.array([1.5, -0.4])
    span = move_duration(end - start, limits)
    moves = quintic(start, end, span, np.linspace(0, span, 2001))
    used = [np.abs(state).max(axis=1) / limit for state, limit in zip(moves[1:], limits, strict=True)]
    assert np.max(used) == pytest.approx(1.0, abs=1e-3)
    assert moves[0][:, -1] == pytest.approx(end)


def test_names_that_are_no_parameters_are_refused() -> None:
    task = make_task(load_robot("ur10e"))
    with pytest.raises(GtauError, match="no criterion or parameter 'gian_elbow'"):
        criterion("gian_elbow", task.information)

"""2SLS with deviations, Huber's weights, priors, and all estimators beside each other."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from five_bar_logs import CHI, EXPERIMENT, GAINS, JOINTS, STEEL, Plant, pair, write_log
from typer.testing import CliRunner

from gtau.cli.commands import app
from gtau.estimation.estimators import estimator_of, estimators
from gtau.estimation.estimators.essential import prune_friction_terms
from gtau.estimation.estimators.estimator import Gains
from gtau.estimation.estimators.least_squares import two_stage
from gtau.estimation.estimators.maximum_likelihood import ml
from gtau.estimation.estimators.newton import one_step
from gtau.estimation.estimators.physical_consistency import standard_unknowns
from gtau.estimation.identify import comparison_document
from gtau.estimation.regression.assembly import all_terms
from gtau.estimation.regression.dataset import Dataset, reduce_runs
from gtau.model.home import load_robot
from gtau.report.gains import comparison_table
from gtau.result import Result, compare, identify
from gtau.robots.parameter import Parameter
from gtau.signals.reading.statements import Payload, Prior
from gtau.signals.run import Run

FIVE_BAR = load_robot("five-bar")
KNOWN = Payload(name="steel", mass=STEEL["m"])


@pytest.fixture(scope="module")
def runs() -> list[Run]:
    return pair(Plant(noise=0.02))


@pytest.fixture(scope="module")
def data(runs: list[Run]) -> Dataset:
    return reduce_runs(FIVE_BAR, runs)


@pytest.fixture(scope="module")
def identified(runs: list[Run]) -> Callable[[str], Result]:
    """What an estimator identifies, once."""
    return cache(lambda method: identify(FIVE_BAR, runs, method=method))


def gain_errors(result: Result) -> np.ndarray:
    """Errors of the gains in standard deviations."""
    found = [result.drive_gains[joint] for joint in JOINTS]
    return np.array([(each.value - truth) / each.std for each, truth in zip(found, GAINS, strict=True)])


@pytest.mark.parametrize("method", [each.name for each in estimators().values() if each.gains != Gains.GIVEN])
def test_every_estimator_finds_the_gains(method: str, identified: Callable[[str], Result]) -> None:
    result = identified(method)
    assert result.method == method
    assert (np.abs(gain_errors(result)) < 4).all()
    assert result.summary()


# 2SLS


def test_jackknife_of_2sls_is_leaving_units_out(data: Dataset) -> None:
    problem = data.system().problem
    solution = two_stage(problem)
    here = slice(problem.n_theta, problem.n_theta + 2)
    quick = solution.replicates()[:, here]
    exact = []
    for u in range(len(problem.blocks)):
        rest = partial(np.delete, problem.blocks, u, 0)
        others = replace(problem, make_blocks=rest, rows=np.delete(problem.rows, u, axis=0))
        exact.append(two_stage(others).gains - solution.gains)
    np.testing.assert_allclose(quick.std(axis=0), np.std(exact, axis=0), rtol=0.2)
    for ours, truth in zip(quick.T, np.array(exact).T, strict=True):
        assert np.corrcoef(ours, truth)[0, 1] > 0.95


def test_one_step_leaves_a_unit_of_least_squares_out_exactly(rng: np.random.Generator) -> None:
    A, y = rng.normal(size=(6, 10, 4)), rng.normal(size=(6, 10))
    whole = np.linalg.lstsq(A.reshape(-1, 4), y.ravel(), rcond=None)[0]
    R = np.linalg.qr(A.reshape(-1, 4), mode="r")
    back = np.linalg.inv(R)
    white = A @ back
    errors = A @ whole - y
    steps = one_step((A_u.T @ A_u, A_u.T @ e_u) for A_u, e_u in zip(white, errors, strict=True)) @ back.T
    for u, step in enumerate(steps):
        others = np.arange(6) != u
        left = np.linalg.lstsq(A[others].reshape(-1, 4), y[others].ravel(), rcond=None)[0]
        np.testing.assert_allclose(whole + step, left, rtol=1e-9)


# Huber


def test_outliers_move_maximum_likelihood_and_not_huber(rng: np.random.Generator) -> None:
    spoilt = []
    for run in pair(Plant(noise=0.005)):
        command = run.command.copy()
        # the current stands out for 20 ms, always to the same side, where the joint moves outwards
        for start in rng.integers(100, len(command) - 100, 12):
            for j in range(2):
                if run.position[start + 10, j] > run.position[start, j]:
                    command[start : start + 10, j] += 1.5
        spoilt.append(replace(run, command=command))
    plain, robust = identify(FIVE_BAR, spoilt), identify(FIVE_BAR, spoilt, method="huber")

    def size(result: Result) -> float:
        found = [result.drive_gains[joint].value for joint in JOINTS]
        return float(np.abs(np.array(found) / GAINS - 1).max())

    def fs(result: Result) -> np.ndarray:  # of the equations, and of all samples
        found = result.equation_friction["fs_left"].value, result.parameters[Parameter("fs", "left")].value
        return np.abs(np.array(found) - CHI["fs_left"])

    assert (fs(robust) < fs(plain) / 2).all()
    assert size(robust) < size(plain)
    for joint in JOINTS:
        stds = (result.drive_gains[joint].random_std or 0.0 for result in (robust, plain))  # effects are no outliers
        assert next(stds) < 0.5 * next(stds)


def test_without_outliers_huber_is_nearly_maximum_likelihood(identified: Callable[[str], Result]) -> None:
    plain, robust = identified("ml"), identified("huber")
    for joint in JOINTS:
        a, b = plain.drive_gains[joint], robust.drive_gains[joint]
        assert abs((a.value or 0.0) - (b.value or 0.0)) < 0.7 * (a.std or 0.0)
    for one, other in zip(plain.residuals, robust.residuals, strict=True):  # of all rows alike, not as weighted
        assert one.rms == pytest.approx(other.rms, rel=0.02)  # estimates beside effects leave slightly more
        assert one.signal == pytest.approx(other.signal, rel=0.01)


def test_weights_that_follow_the_data_are_part_of_huber_s_scatter(data: Dataset) -> None:
    """With the weights held fixed, its standard deviations would be 14 % too small under normal noise."""
    system = data.system()
    plain, robust = (estimator_of(method).fit(system).solution for method in ("ml", "huber"))
    ratio = np.sqrt(np.diag(robust.jackknife) / np.diag(plain.jackknife))[system.problem.gain_rows]
    assert ((ratio > 0.93) & (ratio < 1.15)).all(), ratio


# Priors


def test_prior_equations_are_further_rows(data: Dataset) -> None:
    problem = data.system().problem
    free = ml(problem)
    k = problem.parameters.index("fs_left")
    tight = np.zeros((1, problem.n_theta + 1))
    tight[0, k], tight[0, -1] = 1e6, 1e6 * 0.9
    assert ml(replace(problem, known=tight)).theta[k] == pytest.approx(0.9, abs=1e-6)
    # A prior as uncertain as the estimate takes it half of the way, and the variance is halved.
    std = np.sqrt(free.covariance[k, k])
    even = np.zeros_like(tight)
    even[0, k], even[0, -1] = 1 / std, (free.theta[k] + std) / std
    solution = ml(replace(problem, known=even))
    assert solution.theta[k] == pytest.approx(free.theta[k] + std / 2, abs=0.05 * std)
    assert np.sqrt(solution.covariance[k, k]) == pytest.approx(std / np.sqrt(2), rel=0.05)


def test_a_stated_prior_counts_with_its_deviation(runs: list[Run], identified: Callable[[str], Result]) -> None:
    std = identified("ml").equation_friction["fs_left"].std or 0.0
    sure = identify(FIVE_BAR, runs, priors={"fs_left": Prior(value=0.8, std=std / 100)})
    assert sure.equation_friction["fs_left"].value == pytest.approx(0.8, abs=std / 30)
    assert (sure.equation_friction["fs_left"].std or 0.0) == pytest.approx(std / 100, rel=0.2)


def test_the_unknowns_give_the_problem_s_parameters(data: Dataset) -> None:
    system = data.system((Parameter("f3", "left"),), True)
    unknowns = standard_unknowns(system, ml(system.problem), {})
    assert unknowns.S.shape == (len(system.unreduced.parameters), len(unknowns.names))
    x = np.array([CHI.get(name, STEEL.get(name.removesuffix("_L2"), 0.0)) for name in unknowns.names])
    theta = dict(zip(system.unreduced.parameters, unknowns.S @ x, strict=True))
    solution = ml(system.problem)
    std = np.sqrt(np.diag(solution.jackknife))
    for name, value, deviation in zip(system.problem.parameters, solution.theta, std, strict=False):
        assert abs(value - theta[name]) < 6 * deviation, name


# Reduction


def test_the_price_of_the_reduction_is_said(identified: Callable[[str], Result]) -> None:
    result = identified("ml")
    loss = result.statistics["reduction_loss"]
    assert -1 < loss < 6  # with fewer parameters the same squares may make a smaller standard deviation
    assert f"changes the torque residual of the worst joint by {loss:.2g} %" in " ".join(result.summary().split())


# The command


@pytest.mark.parametrize("few", [True, pytest.param(False, marks=pytest.mark.slow)], ids=["two", "all"])
def test_compare(tmp_path: Path, few: bool, request: pytest.FixtureRequest) -> None:
    if few:
        request.getfixturevalue("two_estimators")
    names = ["ml", "wls"] if few else list(estimators())
    plant = Plant(noise=0.02)
    for name, payload, seed in (("free", None, 1), ("loaded", STEEL, 2), ("check", STEEL, 3)):
        write_log(tmp_path / f"{name}.csv", plant.run(name, 6.0, payload, seed))
    experiment = tmp_path / "experiment.yaml"
    experiment.write_text(EXPERIMENT)
    said: list[str] = []
    compared = compare(experiment, progress=lambda stage, *_: said.append(stage))
    assert {stage.partition(" (")[0] for stage in said} >= set(names)
    document, shown = comparison_document(compared), comparison_table(compared)
    assert document["joints"] == list(JOINTS)
    assert [each["method"] for each in document["estimators"]] == names
    for each in document["estimators"]:
        assert not each["refusal"]
        if each["method"] != "tls" or each["outcome"] == "good":  # TLS fails at times, and says so
            np.testing.assert_allclose(each["gains"], GAINS, rtol=0.03)
            assert max(each["residuals"]) < 10
        assert (each["std"] is None) == (estimators()[each["method"]].gains == Gains.GIVEN) == (each["outcome"] is None)
        assert each["seconds"] > 0
    assert [row[0] for row in shown.rows] == names
    assert {row[0] for row in shown.rows if row[1] == "given"} == {"ols", "wls"} & set(names)


@pytest.mark.usefixtures("two_estimators")
def test_compared_gains_are_as_uncertain_as_the_mass_behind_them(tmp_path: Path) -> None:
    plant = Plant(noise=0.02)
    for name, payload, seed in (("free", None, 1), ("loaded", STEEL, 2), ("check", STEEL, 3)):
        write_log(tmp_path / f"{name}.csv", plant.run(name, 6.0, payload, seed))
    experiment = tmp_path / "experiment.yaml"
    experiment.write_text(EXPERIMENT.replace("mass: 1.2}", "mass: 1.2, mass_std: 0.06}"))
    answer = CliRunner().invoke(app, ["compare", str(experiment), "--json"])
    assert answer.exit_code == 0, answer.stderr
    document = json.loads(answer.stdout)
    for each in document["estimators"]:
        if estimators()[each["method"]].gains != Gains.GIVEN and not each["refusal"]:
            relative = np.abs(np.array(each["std"]) / np.array(each["gains"]))
            assert relative.min() > 0.045, each["method"]  # a mass known to 5 %


@pytest.mark.slow
def test_compared_gains_are_held_against_their_priors(tmp_path: Path) -> None:
    """Milliamperes for amperes: the data agree with any unit, the prior gains do not."""
    plant = Plant(noise=0.02)
    for name, payload, seed in (("free", None, 1), ("loaded", STEEL, 2), ("check", STEEL, 3)):
        run = plant.run(name, 6.0, payload, seed)
        write_log(tmp_path / f"{name}.csv", replace(run, command=1e3 * run.command))
    experiment = tmp_path / "experiment.yaml"
    experiment.write_text(EXPERIMENT)
    document = json.loads(CliRunner().invoke(app, ["compare", str(experiment), "--json"]).stdout)
    outcomes = {each["method"]: each["outcome"] for each in document["estimators"]}
    assert outcomes["ml"] == outcomes["2sls"] == "contradictory"


# Friction


def test_only_friction_that_all_equations_tell_is_kept(runs: list[Run]) -> None:
    """Of cubic friction in both joints, that of the left is there; that of the right is noise, and left out."""
    speed = [np.gradient(run.position[:, 0], run.time) for run in runs]
    cubed = [
        replace(run, command=run.command + np.column_stack([0.2 * qd**3 / GAINS[0], 0 * qd]))
        for run, qd in zip(runs, speed, strict=True)
    ]
    data, both = reduce_runs(FIVE_BAR, cubed), all_terms(JOINTS, ("f3",))
    problem = data.system(both, per_run=True).problem
    assert prune_friction_terms(problem, both, ml) == ("f3_left",)
    solution, k = ml(problem), problem.parameters.index("f3_left")
    assert solution.theta[k] == pytest.approx(0.2, abs=4 * np.sqrt(solution.jackknife[k, k]))
    plain = reduce_runs(FIVE_BAR, runs).system(both, per_run=True).problem
    assert prune_friction_terms(plain, both, ml) == ()


@pytest.mark.parametrize(("coulomb", "cubic"), [(10.0, 0.5), (20.0, -0.4)])
def test_a_current_that_is_mostly_friction_does_not_hide_cubic_friction(coulomb: float, cubic: float) -> None:
    """Such a current is proportional to itself: it must not stand for the load in load-dependent friction."""
    rubbing = []
    for run in pair(Plant(noise=0.02)):
        speed = np.gradient(run.position[:, 0], run.time)
        friction = (coulomb * np.sign(speed) + cubic * speed**3) / GAINS[0]
        rubbing.append(replace(run, command=run.command + np.column_stack([friction, 0 * speed])))
    result = identify(FIVE_BAR, rubbing)
    assert [name for name in result.equation_friction if name not in result.parameters] == ["f3_left"]
    found = result.equation_friction["f3_left"]
    assert found.value == pytest.approx(cubic, abs=4 * found.std)
    assert result.drive_gains["left"].std < 0.01 * GAINS[0]
    assert np.abs(gain_errors(result)).max() < 4

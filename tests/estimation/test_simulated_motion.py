"""Estimators along simulated motion, IDIM-IV and DIDIM: the simulation, and what noise of the encoders does."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from five_bar_logs import CHI, GAINS, STEEL, Plant, five_bar, pair

from gtau.errors import GtauError
from gtau.estimation.estimators import estimator_of
from gtau.estimation.estimators.maximum_likelihood import ml
from gtau.estimation.estimators.simulated_motion import (
    POLE,
    Pair,
    along_simulated_motion,
    instrumental,
    paired,
    reference_cutoff,
    resimulated,
    with_instruments,
)
from gtau.estimation.regression.dataset import System, reduce_runs
from gtau.estimation.regression.factors import triangle
from gtau.estimation.regression.problem import Problem
from gtau.findings import silent
from gtau.model.base_parameters import base_parameters
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.result import identify
from gtau.signals.preparation.bandwidth import choose_preparation
from gtau.signals.preparation.filters import Decimator, Preparation, position_filter
from gtau.signals.preparation.prepared_run import prepare
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run
from gtau.simulation import plant
from gtau.simulation.closed_loop import Controller, JointHardware, Reference, close_loop, hardware

FIVE_BAR = load_robot("five-bar")
KNOWN = Payload(name="steel", mass=STEEL["m"])


@pytest.fixture(scope="module")
def clean() -> list[Run]:
    return pair(Plant())


@pytest.fixture(scope="module")
def least_squares_step() -> System:
    return reduce_runs(FIVE_BAR, pair(Plant(noise=0.02))).system(per_run=True)


# The simulation


def motion(model: InverseDynamics, time: np.ndarray, centre: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A slow motion of all joints that begins at rest."""
    w = 2 * np.pi * np.array([0.13, 0.29])[:, None, None]
    phase = np.linspace(0.0, 2.0, len(model.actuated))
    angle, first = w * time[:, None] + phase, phase + 0 * w
    start = 1 - np.exp(-((time / 0.5) ** 3))[:, None]
    q = start * (0.12 * (np.sin(angle) - np.sin(first))).sum(axis=0)
    qd = np.gradient(q, time, axis=0, edge_order=2)
    return centre + q, qd, np.gradient(qd, time, axis=0, edge_order=2)


def arm_parameters(model: InverseDynamics) -> dict[str, float]:
    values = {"m": 1.5, "mx": 0.1, "mz": 0.15, "xx": 0.08, "yy": 0.1, "zz": 0.06, "ia": 0.4, "fv": 1.5, "off": 0.2}
    return {name: values.get(name.split("_")[0], 0.0) for name in model.parameter_names}


# Without Coulomb friction: next to a reversal the plant sticks, which the loop simulated does not, and the mask hides.
SMOOTH_FIVE_BAR = {name: 0.3 if name.startswith("ia_") else value for name, value in CHI.items() if name[:3] != "fs_"}


@pytest.mark.parametrize(("source", "chi"), [("five-bar", SMOOTH_FIVE_BAR), ("puma560", None)])
def test_the_loop_is_that_of_the_integrated_plant(source: str, chi: Mapping[str, float] | None) -> None:
    model = InverseDynamics(load_robot(source))
    chi = arm_parameters(model) if chi is None else chi
    bandwidth, rate = 0.5, 500.0
    pole = 2 * np.pi * POLE * bandwidth
    time = np.arange(round(3.0 * rate) + 1) / rate
    layout = model.layout
    q, qd, qdd = motion(model, time, (model.loops.home if model.loops else layout.home)[layout.actuated])
    still = np.zeros_like(q)
    gravity = model.torques(q, still, still, chi)
    M = np.stack([model.torques(q, still, still + row, chi) - gravity for row in np.eye(len(model.actuated))], axis=2)
    reference = Reference(time, q, qd, qdd)
    law = Controller(reference, M, np.einsum("tij,tj->ti", M, qdd), np.ones(len(model.actuated)), 1.0, pole)
    drives = hardware(model.actuated, {joint: JointHardware(gain=1.0) for joint in model.actuated})
    stepped = close_loop(
        "run", plant.Plant(model, chi), law, drives, np.random.default_rng(0), joints=model.actuated
    ).error
    run = Run("run", model.actuated, time, q, np.zeros_like(q))
    base = base_parameters(model)
    values = base.matrix @ np.array([chi.get(name, 0.0) for name in model.parameter_names])
    preparation = Preparation(bandwidth, None, Decimator(1, "fir"))
    prepared = prepare(run, preparation)
    columns = model.columns(base.standard)
    smoothed = position_filter(q, rate, reference_cutoff(preparation, run))[0]
    found = resimulated(model, columns, values, prepared).samples()
    settled = found.time > 0.8  # the loop simulated has never been at rest
    first = round(found.time[0] * rate)
    error = (smoothed[first : first + len(found.q)] - found.q)[settled]
    expected = stepped[first : first + len(found.q)][settled]
    # the law of the plant is sampled, its derivative filtered, and its inertia that of the reference
    assert np.linalg.norm(error - expected) < 0.1 * np.linalg.norm(expected)


def test_an_inertia_that_is_not_positive_is_refused(clean: list[Run]) -> None:
    preparation = choose_preparation(clean)
    base = base_parameters(five_bar())
    chi = {**CHI, "ia_left": -5.0}
    values = base.matrix @ np.array([chi.get(name, 0.0) for name in five_bar().parameter_names])
    with pytest.raises(GtauError, match=r"estimated inertia is not positive \(t = .* of run 'free'\)"):
        resimulated(five_bar(), five_bar().columns(base.standard), values, prepare(clean[0], preparation))


# The estimators


@pytest.mark.parametrize("method", ["iv", "didim"])
def test_on_clean_positions_they_are_maximum_likelihood(method: str) -> None:
    """Before the effects move the latter."""
    system = reduce_runs(FIVE_BAR, pair(Plant(noise=0.02))).system()
    other, plain = (estimator_of(name).fit(system).solution for name in (method, "ml"))
    # a twentieth of the rows, in the ends of the reference's filter, is not used
    assert np.all(np.abs(other.values - plain.values) < 0.5 * np.sqrt(np.diag(plain.jackknife)))


@pytest.mark.parametrize("method", ["iv", "didim"])
def test_with_torques_they_are_least_squares(method: str, clean: list[Run]) -> None:
    rng = np.random.default_rng(2)
    runs = [
        replace(run, kind="torque", command=run.command * GAINS + 0.05 * rng.standard_normal(run.command.shape))
        for run in clean
    ]
    runs = [run if run.payload is None else replace(run, payload=Payload(name="unknown")) for run in runs]
    ours, wls = identify(FIVE_BAR, runs, method=method), identify(FIVE_BAR, runs, method="wls")
    for name, each in wls.parameters.items():
        assert abs(ours.parameters[name].value - each.value) < 0.5 * each.std, name
        assert ours.parameters[name].std == pytest.approx(each.std, rel=0.2)
    assert [gain.std for gain in ours.drive_gains.values()] == [None, None]


@pytest.mark.slow
def test_noisy_encoders_spoil_maximum_likelihood_but_not_these(clean: list[Run]) -> None:
    """Positions noisy by 0.4 mrad, behind a filter of 100 Hz: eight times, errors against their own scatter."""
    base = base_parameters(five_bar())
    truth = dict(zip(base.names, base.matrix @ _vector(CHI), strict=True))
    errors: dict[str, list[np.ndarray]] = {"ml": [], "iv": [], "didim": []}
    for seed in range(8):
        rng = np.random.default_rng(seed)
        noisy = [
            replace(
                run,
                position=run.position + 4e-4 * rng.standard_normal(run.position.shape),
                command=run.command + 0.02 * rng.standard_normal(run.command.shape),
            )
            for run in clean
        ]
        data = reduce_runs(FIVE_BAR, noisy, replace(choose_preparation(noisy), cutoff=100.0))
        system = data.system(per_run=True)
        plain = ml(system.problem)
        found = {
            "ml": plain,
            "iv": instrumental(system, plain, True, silent)[1],
            "didim": ml(along_simulated_motion(system, ml, silent).problem),
        }
        names = system.problem.parameters
        for method, solution in found.items():
            values = dict(zip(names, solution.theta, strict=True))
            friction = [values[name] / truth[name] - 1 for name in truth if name.startswith(("fs_", "fv_"))]
            errors[method].append(np.array([*friction, *(solution.gains / GAINS - 1)]))
    t = {
        method: np.mean(each, axis=0) / (np.std(each, axis=0, ddof=1) / np.sqrt(len(each)))
        for method, each in errors.items()
    }
    assert np.abs(t["ml"]).max() > 4.5
    assert np.sqrt(np.mean(t["ml"] ** 2)) > 2.3
    for method in ("iv", "didim"):
        assert np.abs(t[method]).max() < 4.5  # 10 estimates, 7 degrees of freedom
        assert np.sqrt(np.mean(t[method] ** 2)) < 1.8
        assert np.abs(np.mean(errors[method], axis=0)).max() < np.abs(np.mean(errors["ml"], axis=0)).max() / 2


def _merged(measured: Problem, simulated: Problem) -> tuple[np.ndarray, np.ndarray]:
    rows = np.concatenate([measured.blocks, simulated.blocks], axis=-1)
    both = np.stack([triangle(*rows[:, j]) for j in range(len(measured.joints))])
    return both[..., : measured.n_theta + 4], both[..., measured.n_theta + 4 :]


def _vector(chi: Mapping[str, float]) -> np.ndarray:
    return np.array([chi.get(name, 0.0) for name in five_bar().parameter_names])


def test_jackknife_of_instruments_is_leaving_units_out(least_squares_step: System) -> None:
    system = least_squares_step
    pair = paired(system, ml(system.problem))
    solution = with_instruments(pair, ml(system.problem), True)
    quick = solution.replicates()
    here = slice(pair.measured.n_theta, pair.measured.n_theta + 2)
    exact = []
    for u in range(len(pair.measured.blocks)):
        measured, simulated = (
            replace(each, make_blocks=partial(np.delete, each.blocks, u, 0), rows=np.delete(each.rows, u, axis=0))
            for each in (pair.measured, pair.simulated)
        )
        others = Pair(measured, simulated, _merged(measured, simulated))
        exact.append(with_instruments(others, solution, True).gains - solution.gains)
    np.testing.assert_allclose(quick[:, here].std(axis=0), np.std(exact, axis=0), rtol=0.1)
    for ours, truth in zip(quick[:, here].T, np.array(exact).T, strict=True):
        assert np.corrcoef(ours, truth)[0, 1] > 0.98


def test_the_regressor_as_its_own_instrument_is_maximum_likelihood(least_squares_step: System) -> None:
    system = least_squares_step
    free = ml(system.problem)
    pair = paired(system, free)
    same = with_instruments(Pair(pair.measured, pair.measured, (pair.merged[0], pair.merged[0])), free, True)
    again = ml(pair.measured)
    np.testing.assert_allclose(same.gains, again.gains, rtol=1e-5)
    variances = same.covariance.diagonal(), again.covariance.diagonal()
    np.testing.assert_allclose(*(each[:-2] for each in variances), rtol=0.05)
    # of the delays: maximum likelihood counts the curvature e e'' as well, which instruments leave out
    np.testing.assert_allclose(*(each[-2:] for each in variances), rtol=0.15)


def test_refusals(clean: list[Run]) -> None:
    with pytest.raises(GtauError, match="the paper has no method 'iv'"):
        identify(FIVE_BAR, clean, method="iv", as_paper=True)
    with pytest.raises(GtauError, match="use method='didim' or ml"):
        identify(FIVE_BAR, clean, method="iv", consistent=True)


# An independent plant


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "decimation"), [*(pytest.param(m, None, marks=pytest.mark.slow) for m in ("iv", "didim")), ("didim", 4)]
)
def test_gains_of_the_orthoglide_logs(method: str, decimation: int | None, shared: Path, tmp_path: Path) -> None:
    """Rows that hold more than four bandwidths of the motion need a reference that does."""
    folder = shared / "orthoglide_sim"
    loads = {"exciting_1_unloaded": None, "exciting_3_loaded_1983g": 1.983}
    lines = [
        f"  - {{log: {folder / name}.csv" + (f", payload: {{name: steel, mass: {mass}}}}}" if mass else "}")
        for name, mass in loads.items()
    ]
    file = tmp_path / "experiment.yaml"
    file.write_text(
        "robot: orthoglide\n"
        "signals: {time: t, position: {11: q11, 12: q12, 13: q13}, current: {11: v1, 12: v2, 13: v3}}\n"
        "runs:\n" + "\n".join(lines) + "\n" + (f"preparation: {{decimation: {decimation}}}\n" if decimation else "")
    )
    result = identify(file, method=method)
    for joint, truth in {"11": 2170.0, "12": 2100.0, "13": 2070.0}.items():
        gain = result.drive_gains[joint]
        low, high = gain.interval()
        assert low < truth < high
        assert gain.value == pytest.approx(truth, rel=4e-3)
        assert gain.verdict.outcome == "good"


def test_delays_that_are_not_estimated_leave_instruments_of_full_rank() -> None:
    """As of logs in whose currents a delay is lost in noise."""
    system = reduce_runs(FIVE_BAR, pair(Plant(noise=0.02))).system(delays=False)
    _, solution = instrumental(system, ml(system.problem), True, silent)
    np.testing.assert_allclose(solution.gains, GAINS, rtol=0.02)
    assert np.all(np.isfinite(solution.jackknife))

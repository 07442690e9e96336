"""From runs to factors to the problem: nothing is lost on the way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from five_bar_logs import CHI, GAINS, JOINTS, STEEL, TOOL, Plant
from sensed_logs import SensedPlant

from gtau.errors import GtauError
from gtau.estimation.estimators.estimator import Solution
from gtau.estimation.estimators.least_squares import ols, tls, wls
from gtau.estimation.estimators.maximum_likelihood import ml
from gtau.estimation.regression.assembly import all_terms
from gtau.estimation.regression.dataset import Dataset, reduce_runs
from gtau.estimation.regression.factors import Factors, reduce_run
from gtau.estimation.regression.priors import require_scale
from gtau.estimation.regression.problem import Problem
from gtau.estimation.regression.run_blocks import BLOCKS
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.result import Result, identify
from gtau.robots.parameter import Parameter
from gtau.robots.robot import Joint, Mdh, Robot
from gtau.signals.preparation.prepared_run import prepare
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run

PLANT = Plant(delays=(2e-3, -2e-3), noise=0.01)
KNOWN = Payload(name="steel", mass=STEEL["m"])
FIVE_BAR = load_robot("five-bar")


def logs(plant: Plant = PLANT) -> list[Run]:
    return [
        plant.run("free", seed=1),
        plant.run("loaded", payload=STEEL, seed=2),
        plant.run("loaded again", payload=STEEL, seed=3, seconds=7.0),
    ]


def with_payloads(runs: list[Run], *payloads: Payload | None) -> list[Run]:
    return [replace(run, payload=payload) for run, payload in zip(runs, payloads, strict=True)]


@pytest.fixture(scope="module")
def runs() -> list[Run]:
    return with_payloads(logs(), None, KNOWN, KNOWN)


@pytest.fixture(scope="module")
def data(runs: list[Run]) -> Dataset:
    return reduce_runs(FIVE_BAR, runs)


@pytest.fixture(scope="module")
def result(runs: list[Run]) -> Result:
    return identify(FIVE_BAR, runs)


def all_rows(data: Dataset, run: Run) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Every decimated row [W terms push v v' v''] of a run (n, K, p), which are kept (n, K), and their blocks (K,).

    Evaluated, filtered and decimated as one block, standard column by standard column.
    """
    model, decimator = data.model, data.preparation.decimator
    prepared = prepare(run, data.preparation).samples()
    W = model.regressor(prepared.q, prepared.qd, prepared.qdd)  # (N, n, n_st)
    columns = [model.parameter_names.index(name) for name in data.base.standard]
    terms = np.stack([prepared.qd**3, np.abs(prepared.command) * np.sign(prepared.qd)], axis=-1)
    currents = np.stack([prepared.command, prepared.command_d, prepared.command_dd], axis=-1)
    known = np.zeros((*prepared.q.shape, 1))  # no wrenches
    rows = np.concatenate([W[:, :, columns], terms, known, currents], axis=-1)
    rows = decimator.apply(np.ascontiguousarray(np.moveaxis(rows, 0, -1))).swapaxes(1, 2)
    instants = rows.shape[1]
    return rows, decimator.keep(prepared.usable).T, np.arange(instants) * BLOCKS // instants


def unreduced(data: Dataset, run: Run) -> Factors:
    """The rows themselves in the place of their factors, masked ones zero."""
    rows, keep, block = all_rows(data, run)
    blocks = np.zeros((BLOCKS, len(rows), 50, rows.shape[-1]))
    for s in range(BLOCKS):
        chosen = np.where(keep[:, block == s, None], rows[:, block == s], 0.0)
        blocks[s, :, : chosen.shape[1]] = chosen
    return Factors(blocks, np.array([keep[:, block == s].sum(axis=1) for s in range(BLOCKS)]))


METHODS: dict[str, Callable[[Problem], Solution]] = {
    "ols": lambda problem: ols(problem, np.array(GAINS)),
    "wls": lambda problem: wls(problem, np.array(GAINS)),
    "ml": ml,
    "tls": tls,
}


@pytest.mark.parametrize(("terms", "per_run"), [((), False), (all_terms(JOINTS), True)], ids=["paper's", "more"])
@pytest.mark.parametrize("method", METHODS)
def test_factors_of_streamed_blocks_say_what_all_rows_say(
    data: Dataset, method: str, terms: tuple[Parameter, ...], per_run: bool
) -> None:
    full = replace(data, factors=tuple(unreduced(data, run) for run in data.runs)).system(terms, per_run).problem
    problem = data.system(terms, per_run).problem
    assert full.blocks.shape[2] != problem.blocks.shape[2]
    np.testing.assert_array_equal(full.rows, problem.rows)
    few, many = METHODS[method](problem), METHODS[method](full)
    np.testing.assert_allclose(few.gains, many.gains, rtol=1e-9)
    np.testing.assert_allclose(few.theta, many.theta, rtol=1e-9, atol=1e-9 * np.abs(many.theta).max())
    np.testing.assert_allclose(few.delays, many.delays, rtol=1e-9)
    np.testing.assert_allclose(few.sigma, many.sigma, rtol=1e-9)
    for one, other in ((few.covariance, many.covariance), (few.jackknife, many.jackknife)):
        np.testing.assert_allclose(np.diag(one), np.diag(other), rtol=1e-7)
    assert dict(few.statistics) == pytest.approx(dict(many.statistics), rel=1e-9)


def gram(R: np.ndarray) -> np.ndarray:
    return R.swapaxes(-1, -2) @ R


@pytest.mark.parametrize("samples", [173, 10**6])
def test_blocks_of_any_size_give_the_same_factors(data: Dataset, samples: int) -> None:
    for prepared, other in zip(data.prepared, data.factors, strict=True):
        one = reduce_run(data.model, data.base.standard, prepared, data.preparation.decimator, fast=samples)
        np.testing.assert_array_equal(one.rows, other.rows)
        a, b = gram(one.R), gram(other.R)
        size = np.sqrt(np.einsum("...ii->...i", b))
        assert (np.abs(a - b) <= 1e-11 * (size[..., :, None] * size[..., None, :] + 1e-300)).all()


def test_stretches_merge_to_the_factor_of_all_rows(data: Dataset) -> None:
    for run, factors in zip(data.runs, data.factors, strict=True):
        rows, keep, _ = all_rows(data, run)
        assert factors.rows.sum(axis=0).tolist() == keep.sum(axis=1).tolist()
        assert (factors.rows[1:-1] > 0).all()
        for j in range(len(JOINTS)):
            stack = gram(factors.R[:, j]).sum(axis=0)
            direct = gram(rows[j, keep[j]])
            size = np.sqrt(np.diag(direct))
            assert (np.abs(stack - direct) <= 1e-11 * np.outer(size, size)).all()
            assert not np.tril(factors.R[0, j], -1).any()


def test_payload_columns_are_those_of_a_body_on_the_tool(data: Dataset) -> None:
    """The unknown payload's columns and the known column against the regressor of the tool's own parameters."""
    system, n_b = data.system(), data.base.count
    rows, keep, _ = all_rows(data, data.runs[1])
    names = [f"{kind}_{TOOL}" for kind in ("m", "zz", "mx", "my")]
    prepared = prepare(data.runs[1], data.preparation).samples()
    W = data.model.regressor(prepared.q, prepared.qd, prepared.qdd)[
        ..., [data.model.parameter_names.index(name) for name in names]
    ]
    W = data.preparation.decimator.apply(np.ascontiguousarray(np.moveaxis(W, 0, -1))).swapaxes(1, 2)
    problem = system.problem
    unknown = [problem.parameters.index(f"{kind}_L2") for kind in ("zz", "mx", "my")]
    mine = slice(BLOCKS, 2 * BLOCKS)
    for j in range(len(JOINTS)):
        ours = problem.blocks[mine, j].reshape(-1, problem.blocks.shape[-1])
        expected = np.column_stack([rows[j, keep[j], :n_b], W[j, keep[j], 1:], KNOWN.mass * W[j, keep[j], 0]])
        a, b = gram(ours[:, [*range(n_b), *unknown, problem.n_theta]]), gram(expected)
        size = np.sqrt(np.diag(b)) + 1e-300
        assert (np.abs(a - b) <= 1e-8 * np.outer(size, size)).all()


# The whole way


def truth(result: Result) -> dict[str, float]:
    """True base parameters."""
    names = result.idm.parameter_names
    chi = result.base.matrix @ np.array([CHI.get(name, 0.0) for name in names])
    return dict(zip(result.base.names, chi, strict=True))


def test_everything_is_found_within_its_deviation(result: Result) -> None:
    z = [(e.value - g) / e.std for e, g in zip(result.drive_gains.values(), GAINS, strict=True)]
    z += [(e.value - d) / e.std for e, d in zip(result.delays.values(), PLANT.delays, strict=True)]
    true = truth(result)
    z += [(e.value - true[name]) / e.std for name, e in result.parameters.items()]
    for payload in result.payloads:
        z += [(payload.parameters[kind].value - STEEL[kind]) / payload.parameters[kind].std for kind in ("mx", "zz")]
    assert np.abs(z).max() < 4.5
    assert 0.5 < np.sqrt(np.mean(np.square(z))) < 1.7
    assert max(e.rel_std for e in result.drive_gains.values()) < 1.0
    assert max(e.std for e in result.delays.values()) < 2e-4


def test_delays_are_each_joint_s_own() -> None:
    delays = (-2e-3, 1.5e-3)
    found = identify(FIVE_BAR, with_payloads(logs(Plant(delays=delays)), None, KNOWN, KNOWN))
    np.testing.assert_allclose([e.value for e in found.delays.values()], delays, atol=2e-5)
    np.testing.assert_allclose([e.value for e in found.drive_gains.values()], GAINS, rtol=1e-3)


def test_reversed_currents(runs: list[Run], result: Result) -> None:
    found = identify(FIVE_BAR, [replace(run, command=-run.command) for run in runs])
    for joint, gain in found.drive_gains.items():
        assert gain.value == pytest.approx(-result.drive_gains[joint].value, rel=1e-8)
    assert found.residuals[1].rms == pytest.approx(result.residuals[1].rms, rel=1e-6)
    assert "all drive gains are negative" in " ".join(found.summary().split())


def test_the_mass_s_deviation_is_that_of_every_gain(runs: list[Run], result: Result) -> None:
    doubtful = Payload(name="steel", mass=STEEL["m"], mass_std=0.024)
    found = identify(FIVE_BAR, with_payloads(runs, None, doubtful, doubtful))
    for joint, gain in found.drive_gains.items():
        before = result.drive_gains[joint]
        assert gain.value == before.value
        added = np.sqrt(gain.std**2 - before.std**2)
        assert added == pytest.approx(gain.value * 0.024 / STEEL["m"], rel=1e-6)
    assert found.payloads[0].parameters["m"].std == 0.024
    assert "m" in found.payloads[0].known


def test_an_unknown_payload_is_weighed_beside_a_known_one() -> None:
    lead = {"m": 0.8, "mx": 0.1, "my": -0.05, "zz": 0.03}
    free, loaded, _ = logs()
    other = PLANT.run("other", payload=lead, seed=4)
    found = identify(FIVE_BAR, with_payloads([free, loaded, other], None, KNOWN, Payload(name="lead")))
    steel, unknown = found.payloads
    assert (steel.name, steel.known, unknown.name, unknown.known) == ("steel", {"m"}, "lead", frozenset())
    # The mass acts together with the others: what is told apart is what the regroupings say.
    assert set(unknown.parameters) <= {"zz", "mx", "my", "m"}
    for kind, estimate in unknown.parameters.items():
        assert abs(estimate.value - lead[kind]) < 5 * estimate.std
    assert found.payload("lead")["m"] == unknown.parameters["m"].value
    assert unknown.parameters["m"].std < 0.02


def test_two_known_payloads_are_better_than_one(result: Result) -> None:
    lead = {"m": 0.6, "mx": 0.1, "my": -0.05, "zz": 0.03}
    free, loaded, _ = logs()
    runs = [free, loaded, PLANT.run("other", payload=lead, seed=4)]
    found = identify(FIVE_BAR, with_payloads(runs, None, KNOWN, Payload(name="lead", mass=0.6)))
    for gain, true in zip(found.drive_gains.values(), GAINS, strict=True):
        assert abs(gain.value - true) < 4.5 * gain.std
    # Without an unloaded run the difference of the two still gives the scale.
    without = identify(FIVE_BAR, with_payloads(runs[1:], KNOWN, Payload(name="lead", mass=0.6)))
    for gain, true in zip(without.drive_gains.values(), GAINS, strict=True):
        assert abs(gain.value - true) < 4.5 * gain.std


def test_further_known_parameters_of_a_payload_are_not_estimated(runs: list[Run], result: Result) -> None:
    more = Payload(name="steel", mass=STEEL["m"], parameters={kind: STEEL[kind] for kind in ("mx", "my", "zz")})
    found = identify(FIVE_BAR, with_payloads(runs, None, more, more))
    assert found.payloads[0].known == {"m", "mx", "my", "zz"}
    assert found.payloads[0].parameters["mx"].std is None
    assert not any(name.startswith("mx_L") for name in found.covariance_names)
    for (joint, gain), true in zip(found.drive_gains.items(), GAINS, strict=True):
        assert gain.std < result.drive_gains[joint].std
        assert abs(gain.value - true) < 4.5 * gain.std


def test_known_gains_or_torques(runs: list[Run], result: Result) -> None:
    true = truth(result)
    prior = dict(zip(JOINTS, GAINS, strict=True))
    for method in ("ols", "wls"):
        found = identify(FIVE_BAR, runs[:1], method, prior_gains=prior)
        assert [e.std for e in found.drive_gains.values()] == [None, None]
        z = [(e.value - true[name]) / e.std for name, e in found.parameters.items()]
        assert np.abs(z).max() < 5
    torques = replace(runs[0], command=runs[0].command * GAINS, kind="torque")
    found = identify(FIVE_BAR, [torques], "wls")
    assert [(e.value, e.unit) for e in found.drive_gains.values()] == [(1.0, "1"), (1.0, "1")]
    mx = found.parameters["mx_leftR"]
    assert abs(mx.value - true["mx_leftR"]) < 4.5 * mx.std < 0.06


def test_the_paper_s_way(runs: list[Run]) -> None:
    found = identify(
        FIVE_BAR,
        [replace(run, command=logs(Plant(noise=0.01))[k].command) for k, run in enumerate(runs)],
        "tls",
        as_paper=True,
    )
    np.testing.assert_allclose([e.value for e in found.drive_gains.values()], GAINS, rtol=0.03)
    assert found.preparation.decimator.kind == "chebyshev"
    assert not found.friction
    assert [e.value for e in found.delays.values()] == [0.0, 0.0]
    deviations = [e.rel_std for e in found.essential.values()]
    assert max(deviations) < 10 * min(deviations)


# What cannot be told


def test_without_scale_the_gains_are_refused(runs: list[Run], data: Dataset) -> None:
    with pytest.raises(GtauError, match=r"needs a scale.*payload of known mass.*method='wls' with prior_gains"):
        identify(FIVE_BAR, runs[:1])
    with pytest.raises(GtauError, match=r"two different loads.*method='wls' with prior_gains"):
        identify(FIVE_BAR, runs[1:])
    unknown = Payload(name="steel")
    with pytest.raises(GtauError, match="needs a scale"):
        identify(FIVE_BAR, with_payloads(runs, None, unknown, unknown), "tls")


def test_a_payload_that_acts_on_nothing_is_refused() -> None:
    """A turntable with a vertical axis does not feel the mass it carries."""
    table = Robot("table", (Joint("1", "ground", "revolute", Mdh()),))
    time = np.arange(4000) / 500.0
    q = np.sin(2 * np.pi * 0.7 * time)[:, None] + 0.3 * np.sin(2 * np.pi * 1.3 * time)[:, None]
    run = Run("free", ("1",), time, q, -20 * q + 0.1 * np.random.default_rng(1).normal(size=q.shape))
    loaded = replace(run, name="loaded", payload=KNOWN)
    problem = reduce_runs(table, [run, loaded]).system().problem
    with pytest.raises(GtauError, match=r"no effect of their own on any actuated joint.*--method wls"):
        require_scale(table, problem, (), [None, KNOWN], "ml")


def test_a_joint_that_stands_still_has_no_rows(runs: list[Run]) -> None:
    still = [replace(run, position=np.column_stack([run.position[:, 0], 0 * run.time + 1.0])) for run in runs]
    with pytest.raises(GtauError, match="joint 'right' has 0 usable rows in all runs together"):
        identify(FIVE_BAR, still)


def test_a_link_may_have_the_name_of_a_payload(runs: list[Run], result: Result) -> None:
    """The payload of the second run is called L2, as a link of a left arm may be."""
    names = dict(zip(JOINTS, ("L2", "L3"), strict=True))

    def renamed(joint: Joint) -> Joint:
        antecedent = names.get(joint.antecedent, joint.antecedent)
        return replace(joint, name=names.get(joint.name, joint.name), antecedent=antecedent)

    ties = [
        replace(end, body=names.get(end.body, end.body)) for end in (FIVE_BAR.closures[0].a, FIVE_BAR.closures[0].b)
    ]
    closures = (replace(FIVE_BAR.closures[0], a=ties[0], b=ties[1]),)
    robot = replace(FIVE_BAR, joints=tuple(map(renamed, FIVE_BAR.joints)), closures=closures)
    renamed_runs = [
        Run(run.name, ("L2", "L3"), run.time, run.position, run.command, payload=run.payload) for run in runs
    ]
    found = identify(robot, renamed_runs, consistent=True)
    for gain, before in zip(found.drive_gains.values(), result.drive_gains.values(), strict=True):
        np.testing.assert_allclose((gain.value, gain.std), (before.value, before.std), rtol=1e-9)
    assert set(found.consistency.payloads) == {"LL2", "LL3"}


def test_two_parameters_of_one_name_are_refused() -> None:
    joints = (Joint("arm", "ground", "revolute", Mdh()), Joint("armR", "arm", "revolute", Mdh(d=0.3)))
    robot, time = Robot("planar", joints, gravity=(0.0, -9.81, 0.0)), np.arange(2000) / 200
    q = np.stack([np.sin(3 * time), np.sin(5 * time + 1)], axis=1)
    runs = [Run(f"{mass:g} kg", ("arm", "armR"), time, q, q + mass) for mass in (0.0, 1.0)]
    with pytest.raises(GtauError, match="parameters of 'arm' and 'armR' are both called 'zz_armR'"):
        identify(robot, with_payloads(runs, None, KNOWN))


def test_cubes_of_the_speed_of_a_motor_leave_the_parameters_of_its_slide(tmp_path: Path) -> None:
    """At 600 rad/s the cube is 1e10 times the column of the slide's friction, which was taken for rounding."""
    limits, motor = "limits: {position: [-1, 1]}", "limits: {position: [-700, 700]}, parameters: drive"
    (tmp_path / "screw.yaml").write_text(
        f"""robot: screw
joints:
  slide: {{antecedent: ground, axis: [0, 0, 1], type: prismatic, {limits}}}
  motor: {{antecedent: ground, axis: [0, 0, 1], type: revolute, actuated: true, {motor}}}
couplings: [{{joint: motor, ratios: {{slide: 628.3}}}}]
""")  # fmt: skip
    model = InverseDynamics(load_robot(tmp_path / "screw.yaml"))
    chi = {"m_slide": 40.0, "ia_motor": 2e-4, "fs_motor": 0.1, "fv_motor": 1e-3}
    screw = SensedPlant(model, chi, (0.5,), (0.0,), (300.0,))
    system = reduce_runs(model.robot, [screw.run(1)]).system(all_terms(model.actuated))
    assert system.unexcited == ()

"""Weighing with a model."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import pairwise, zip_longest
from math import pi
from pathlib import Path

import numpy as np
import pytest
from five_bar_logs import CHI, EXPERIMENT, STEEL, Plant, five_bar, write_experiment, write_log
from plausible_parameters import body_parameters, random_parameters
from stated_arm import chi, plant, robot

from gtau.errors import GtauError
from gtau.estimation.results.conclusions import headline, remarks, sums_with_mass
from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.payload_body import PayloadEstimate
from gtau.findings import silent
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.report.terminal import plain
from gtau.report.validation import weighing_page
from gtau.result import Result, identify
from gtau.robots.robot import Coupling, Joint, Limits, Mdh, Pose, Robot
from gtau.signals.reading.experiment import read_experiment
from gtau.signals.reading.statements import FIRST_MOMENTS, Payload, as_payload
from gtau.signals.run import Run
from gtau.simulation.trajectories import envelope, sines
from gtau.uses.prediction import other_unit
from gtau.uses.weigh import exact_gains, undeclared_load, weigh

MASS_STD = 0.06  # 5 % of the known payload
LEAD = {"m": 0.8, "mx": 0.1, "my": -0.05, "zz": 0.03}
HEAD = EXPERIMENT[: EXPERIMENT.index("  - {log: loaded.csv")]
KNOWN = f"  - {{log: loaded.csv, payload: {{name: steel, mass: 1.2, mass_std: {MASS_STD}}}}}\n"
UNKNOWN = "  - {log: unknown.csv, payload: {name: lead}}\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("weighing")
    plant = Plant(noise=0.01)
    write_log(found / "free.csv", plant.run("free", seed=1))
    write_log(found / "loaded.csv", plant.run("loaded", payload=STEEL, seed=2))
    write_log(found / "unknown.csv", plant.run("unknown", payload=LEAD, seed=4))
    (found / "identified.yaml").write_text(HEAD + KNOWN)
    return found


@pytest.fixture(scope="module")
def model(folder: Path) -> Result:
    return identify(folder / "identified.yaml")


def weighed(model: Result, folder: Path, runs: str, gains: str) -> PayloadEstimate:
    (folder / "weighing.yaml").write_text(runs)
    (found,) = weigh(model, folder / "weighing.yaml", gains=gains)
    return found


@pytest.mark.parametrize("gains", ["identified", "prior"])
def test_a_known_payload_beside_the_unknown_one_changes_nothing(model: Result, folder: Path, gains: str) -> None:
    alone = weighed(model, folder, HEAD + UNKNOWN, gains).parameters["m"]
    beside = weighed(model, folder, HEAD + KNOWN + UNKNOWN, gains).parameters["m"]
    assert (beside.value, beside.std) == (alone.value, alone.std)


def test_the_deviation_has_that_of_the_mass_behind_the_gains(model: Result, folder: Path) -> None:
    found = weighed(model, folder, HEAD + KNOWN + UNKNOWN, "identified").parameters["m"]
    assert found.value == pytest.approx(LEAD["m"], rel=0.01)
    assert found.std / found.value == pytest.approx(MASS_STD / 1.2, rel=0.1)


def test_one_log_is_weighed_by_the_model(model: Result, folder: Path) -> None:
    """Friction today is 15 % more; the interval has the mass behind the gains, of which gains and parameters are."""
    more = {name: value * (1.15 if name.startswith("f") else 1.0) for name, value in CHI.items()}
    run = replace(Plant(noise=0.01, chi=more).run("today", payload=LEAD, seed=5), payload=Payload(name="lead"))
    (found,) = weigh(model, five_bar().robot, [run])
    mass = found.parameters["m"]
    low, high = mass.interval()
    assert low < LEAD["m"] < high
    assert 0.04 < mass.std / LEAD["m"] < 0.08
    assert found.weighed is not None
    assert found.weighed.by_model
    said = " ".join(plain(weighing_page(model, [found], "identified")).split())
    assert "the model is the reference, with gains that may have changed by 3 % and friction by 20 %" in said
    assert found.verdict.outcome == "good"
    # torque constants that fell show in what the robot itself weighs
    (after,) = weigh(model, five_bar().robot, [replace(run, command=run.command / 0.95)])
    assert after.parameters["m"].value == pytest.approx(mass.value, abs=0.01)
    warm = replace(run, command=run.command / 0.9)
    (apart,) = weigh(model, five_bar().robot, [warm])
    assert apart.verdict.finding.kind == "log apart from the model"
    (beside,) = weigh(model, five_bar().robot, [run, Plant(noise=0.01, chi=more).run("free", seed=6)])
    assert not beside.weighed.by_model


@pytest.mark.parametrize(
    ("carried", "declared", "more"), [(LEAD, None, 0.8), (STEEL, STEEL["m"], None), (None, None, None)]
)
def test_an_undeclared_load_of_a_validation_run_is_named(
    model: Result, carried: dict[str, float] | None, declared: float | None, more: float | None
) -> None:
    run = Plant(noise=0.01).run("check", payload=carried, seed=7)
    run = replace(run, payload=Payload(name="steel", mass=declared) if declared else None)
    found = undeclared_load(model, run, model.validate(run), silent)
    if more is None:
        assert found is None
        return
    assert found is not None
    said = re.search(r"an undeclared body of ([\d.]+) kg \(95 % interval ([\d.]+) to ([\d.]+) kg\)", str(found))
    assert said is not None
    low, high = float(said[2]), float(said[3])
    assert low < more < high
    assert (high - low) / 2 < 0.1


OTHERWISE = {
    "'left' and 'right' are about 1000": (1e3, 1e3),
    "'left' are about 0.001": (1e-3, 1),
    "'right' are about -1": (1, -1),
    "": (3, 3),
}


@pytest.mark.parametrize("times", OTHERWISE)
def test_columns_of_another_sign_or_unit_are_named(model: Result, times: str) -> None:
    run = Plant(noise=0.01).run("check", seed=7)
    scaled = replace(run, command=np.array(OTHERWISE[times]) * run.command)
    found = other_unit(model.predict(scaled), scaled.kind)
    named = f"currents of {times} times what the model predicts"
    assert (named in str(found)) == bool(times)
    if times:
        (weighed,) = weigh(model, model.robot, [replace(scaled, payload=Payload(name="unknown"))])
        assert named in str(weighed.verdict)


def test_a_payload_that_reverses_the_torques_of_a_balanced_joint_is_no_other_sign(model: Result) -> None:
    prediction = model.predict(Plant(noise=0.01).run("check", seed=7))
    lifted = prediction.friction - 4 * (prediction.predicted - prediction.friction)
    assert other_unit(replace(prediction, measured=lifted), "current") is None


def test_a_validation_run_too_short_to_name_a_load_is_predicted_all_the_same(model: Result) -> None:
    run = Plant(noise=0.01).run("check", payload=LEAD, seed=7)
    short = Run("short", run.joints, run.time[:200], run.position[:200], run.command[:200])
    errors = model.validate(short)
    assert max(error.rms for error in errors) > 2 * max(error.rms for error in model.residuals)
    assert undeclared_load(model, short, errors, silent) is None


def with_prior_gains(model: Result, folder: Path, left: object, right: object) -> Estimate:
    gains = f"{{left: {left}, right: {right}}}".replace("'", "")
    return weighed(model, folder, (HEAD + UNKNOWN).replace("{left: 2.5, right: 4.0}", gains), "prior").parameters["m"]


def test_the_interval_has_that_of_the_prior_gains(model: Result, folder: Path) -> None:
    """Each gain's standard deviation moves the mass as a gain that is larger by it does."""
    stated = {"value": 2.5, "std": 0.05}, {"value": 4.0, "std": 0.12}
    exact, both = with_prior_gains(model, folder, 2.5, 4.0), with_prior_gains(model, folder, *stated)
    assert both.value == exact.value
    larger = with_prior_gains(model, folder, 2.55, 4.0), with_prior_gains(model, folder, 2.5, 4.12)
    moves = [each.value - exact.value for each in larger]
    assert min(map(abs, moves)) > 2 * exact.std
    assert both.std == pytest.approx(np.hypot(exact.std, np.hypot(*moves)), rel=0.02)
    in_python = dict(zip(("left", "right"), stated, strict=True))
    (same,) = weigh(model, folder / "weighing.yaml", gains="prior", prior_gains=in_python)
    assert same.parameters["m"].std == pytest.approx(both.std)
    with pytest.raises(GtauError, match="std: -1 is out of range"):
        weigh(model, folder / "weighing.yaml", gains="prior", prior_gains=in_python | {"left": {"value": 2, "std": -1}})
    # with all gains 3 % too large, the interval holds the mass, which it does not where gains are taken for exact
    wrong = with_prior_gains(model, folder, 2.575, 4.12)
    low, high = wrong.interval(0.95)
    assert not low < LEAD["m"] < high
    low, high = with_prior_gains(model, folder, {"value": 2.575, "std": 0.075}, {"value": 4.12, "std": 0.12}).interval()
    assert low < LEAD["m"] < high


@pytest.mark.parametrize(
    ("gains", "exact"),
    [
        ("{left: 2.5, right: 4.0}", ("left", "right")),
        ("{left: 2.5, right: {value: 4.0, std: 0.1}}", ("left",)),
        ("{left: {value: 2.5, std: 0.1}, right: {value: 4.0, std: 0.1}}", ()),
    ],
)
def test_gains_that_are_taken_for_exact_are_named(
    gains: str, exact: tuple[str, ...], model: Result, folder: Path
) -> None:
    found = weighed(model, folder, (HEAD + UNKNOWN).replace("{left: 2.5, right: 4.0}", gains), "prior")
    experiment = read_experiment(folder / "weighing.yaml")
    assert exact_gains(model, experiment, "prior") == exact
    assert exact_gains(model, experiment, "identified") == ()
    said = " ".join(plain(weighing_page(model, [found], "prior", exact)).split())
    assert ("exclude the uncertainty of" in said) == ("assumed exact" in said) == bool(exact)
    assert ("of the gains of left:" in said) == (exact == ("left",))


def test_no_mass_is_negative_without_a_contradiction(model: Result, folder: Path) -> None:
    """The run without payload and that with it exchanged."""
    exchanged = (HEAD + UNKNOWN).replace("free.csv", "other.csv").replace("unknown.csv", "free.csv")
    found = weighed(model, folder, exchanged.replace("other.csv", "unknown.csv"), "identified")
    assert found.parameters["m"].value == pytest.approx(-LEAD["m"], rel=0.05)
    assert found.verdict.finding is not None
    assert found.verdict.finding.kind == "payload of negative mass"
    said = " ".join(plain(weighing_page(model, [found], "identified")).split())
    assert "weighs" not in said
    assert "The mass of 'lead' contradicts the data" in said


def test_a_mass_by_torques_of_which_nothing_tests_the_scale_says_so_in_its_sentence(tmp_path: Path) -> None:
    plant = Plant(gains=(1.25, 1.25), noise=0.02)
    runs = [plant.run("free", seed=1, kind="torque"), plant.run("lead", payload=LEAD, seed=2, kind="torque")]
    robot = five_bar().robot
    untested = identify(robot, runs[:1])
    (found,) = weigh(untested, robot, [runs[0], replace(runs[1], payload=Payload(name="lead"))])
    exact = exact_gains(untested, read_experiment(write_experiment(tmp_path, plant)), "identified")
    assert exact == ("left", "right")
    said = " ".join(plain(weighing_page(untested, [found], "identified", exact)).split())
    assert "kg (with the logged torques taken as true, whose scale was not tested, 95 % interval" in said
    assert "identified drive gains" not in said


def test_without_an_empty_run_the_known_payload_is_the_reference(model: Result, folder: Path) -> None:
    others = {kind: value for kind, value in STEEL.items() if kind != "m"}
    known = KNOWN.replace("}}", f", parameters: {others}}}}}".replace("'", ""))
    runs = HEAD[: HEAD.index("  - {log: free.csv")] + known + UNKNOWN
    found = weighed(model, folder, runs, "identified").parameters["m"]
    assert found.value == pytest.approx(LEAD["m"], rel=0.01)
    assert found.std > MASS_STD / 2  # the difference is weighed, so what is not known of the one is not of the other


# Masses that no joint feels by itself


CENTER = (0.12, -0.05, 0.03)  # m, of a payload of 1.5 kg that hangs from a parallelogram turning about a remote centre


def remote_centre() -> Robot:
    """A parallelogram on a joint whose axis passes through the remote centre: its bottom bar carries the payload."""
    limits = Limits(position=(-1.0, 1.0), velocity=2.0, acceleration=10.0)
    return Robot(
        "remote centre",
        (
            Joint("yaw", "ground", "revolute", Mdh(alpha=pi / 2), limits=limits),
            Joint("pitch", "yaw", "revolute", Mdh(alpha=-pi / 2, theta=-pi / 2), limits=limits),
            Joint("front", "pitch", "revolute", Pose((0.04, 0.1445, 0.0), (0.0, 0.0, pi)), actuated=False),
            Joint("bottom", "front", "revolute", Pose((0.516, 0.0, 0.0)), actuated=False),
        ),
        couplings=(Coupling("front", (("pitch", -1.0),)), Coupling("bottom", (("pitch", 1.0),))),
        named_tool="bottom",
    )


@pytest.fixture(scope="module")
def hung() -> list[Run]:
    """Torques without a payload, and with one."""
    model, rng, time = InverseDynamics(remote_centre()), np.random.default_rng(3), np.arange(1601) / 200
    chi, runs = random_parameters(model, rng), []
    carried = body_parameters("bottom", np.full(2, 0.75), np.add(CENTER, [[0.02, 0.0, 0.01], [-0.02, 0.0, -0.01]]))
    for name, more in (("free", {}), ("loaded", carried)):
        path = sines(envelope(model.robot, 0.8), 8.0, rng)(time)
        tau = model.torques(*path, chi | {kind: chi[kind] + value for kind, value in more.items()})
        tau += 1e-3 * np.sqrt(np.mean(tau**2, axis=0)) * rng.standard_normal(tau.shape)
        runs.append(Run(name, model.actuated, time, path[0], tau, kind="torque"))
    return runs


def test_a_mass_that_no_joint_feels_is_said_to_be_one(hung: list[Run]) -> None:
    free, loaded = hung
    result = identify(remote_centre(), [free, replace(loaded, payload=Payload(name="tip"))])
    assert "m" not in result.payloads[0].parameters
    (said,) = (each for each in remarks(result) if each.kind == "payload mass not identifiable")
    sums = sums_with_mass(result.payloads[0])
    assert sums
    assert all(each in said.what for each in sums)
    for each in sums:  # what the sums say is true
        kind, sign, factor, _ = each.split()
        truth = 1.5 * CENTER[FIRST_MOMENTS.index(kind)] + float(sign + factor) * 1.5
        found = result.payloads[0].parameters[kind]
        assert found.value == pytest.approx(truth, abs=5 * found.std)
    assert "center: [x, y, z]" in said.advice


def test_a_known_mass_that_no_joint_shows_is_why_the_torques_are_untested(hung: list[Run]) -> None:
    free, loaded = hung
    result = identify(remote_centre(), [free, replace(loaded, payload=Payload(name="tip", mass=1.5))])
    (said,) = (note for note in result.notes if note.kind == "torque scale not tested")
    assert "the mass of 'tip' by itself on 'bottom'" in said.what
    assert said.what[1:] in headline(result)
    without = identify(remote_centre(), [free])
    assert "torque scale not tested" not in {note.kind for note in without.notes}


def test_a_known_center_gives_the_mass(hung: list[Run]) -> None:
    free, loaded = hung
    payload = Payload(name="tip", center=CENTER)
    result = identify(remote_centre(), [free, replace(loaded, payload=payload)])
    found = result.payloads[0].parameters
    assert found["m"].value == pytest.approx(1.5, abs=5 * found["m"].std)
    assert found["m"].std < 0.05
    for kind, at in zip(FIRST_MOMENTS, CENTER, strict=True):
        assert found[kind].value == pytest.approx(at * found["m"].value)
        assert found[kind].std == pytest.approx(abs(at) * found["m"].std)
    assert not [each for each in remarks(result) if each.kind == "payload mass not identifiable"]
    # so the model predicts the loaded run as well as it fitted it
    for error in result.validate(replace(loaded, payload=payload)):
        assert error.relative < 0.5


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        ({"mass": 2.0}, r"for a known one write 'parameters: \{mx: 0.2, my: 0, mz: -0.4\}'"),
        ({"parameters": {"my": 0.1}}, "'center' and 'my' of the parameters state the same; remove one of them"),
    ],
)
def test_a_center_is_given_once_and_of_an_unknown_mass(more: dict, sentence: str) -> None:
    with pytest.raises(GtauError, match=sentence):
        as_payload({"name": "tip", "center": [0.1, 0.0, -0.2], **more})


def posed(true: Robot, moving: list[bool], count: int) -> Run:
    """Poses of 2 s, held by friction that may be anything between its limits, and moves of 1 s between them."""
    rng, rate = np.random.default_rng(1), 250
    goals = np.array([0.0, 0.3, 0.8, 0.0]) + np.where(moving, rng.uniform(-1.2, 1.2, (count, 4)), 0.0)
    s = np.linspace(0, 1, rate)[:, None]
    moves = [a + (b - a) * (10 * s**3 - 15 * s**4 + 6 * s**5) for a, b in pairwise(goals)]
    held = [np.repeat(goal[None], 2 * rate, axis=0) for goal in goals]
    q = np.concatenate([part for pair in zip_longest(held, moves) for part in pair if part is not None])
    qd = np.gradient(q, 1 / rate, axis=0)
    numbers = np.cumsum(np.diff(np.any(qd != 0, axis=1), prepend=False))  # of poses and moves
    friction = rng.uniform(-2.0, 2.0, (numbers[-1] + 1, 4))[numbers] * (qd == 0)
    load = {"m": 1.5, "mx": 0.05, "my": 0.02, "mz": 0.15, "xx": 0.02, "yy": 0.02, "zz": 0.005}
    loaded = chi(true) | {f"{kind}_j4": chi(true)[f"{kind}_j4"] + value for kind, value in load.items()}
    torque = InverseDynamics(true).torques(q, qd, np.gradient(qd, 1 / rate, axis=0), loaded) + friction
    time, noise = np.arange(len(q)) / rate, rng.standard_normal((2, *q.shape))
    return Run("poses", true.actuated, time, q + 1e-5 * noise[0], torque + 0.05 * noise[1], payload=Payload(name="x"))


def test_a_few_poses_are_weighed_by_the_moves_between_them(tmp_path: Path) -> None:
    """Joints that never move take no part; and a log of one pose is refused."""
    true = robot(tmp_path)
    arm, steel = replace(plant(true, noise=0.05), tool="j4"), {"m": 2.0, "mx": 0.1, "mz": 0.2, "xx": 0.03, "yy": 0.03}
    known = Payload(name="steel", mass=2.0)
    model = identify(true, [arm.run(1), arm.run(2, payload=steel, known=known)])
    for moving in ([True] * 4, [False, True, True, False]):
        (load,) = weigh(model, true, [posed(true, moving, 6)])
        assert load.parameters["m"].value == pytest.approx(1.5, abs=load.parameters["m"].half_interval())
        assert load.parameters["m"].half_interval() < 0.03
    with pytest.raises(GtauError, match=r"the robot stands still in all runs|no joint moves"):
        weigh(model, true, [posed(true, [True] * 4, 1)])

"""Faults that happen, put into good logs: each is noticed, and the sentence names it among what to check."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from five_bar_logs import GAINS as FIVE_BAR_GAINS, STEEL, Plant
from orthoglide_logs import experiment

import gtau.model.base_parameters
from gtau.demo import DRIVE_GAINS
from gtau.errors import GtauError
from gtau.estimation.diagnostics.descriptions import TOOL_BODY
from gtau.estimation.diagnostics.effort import SWAPPED_CHANNELS
from gtau.estimation.diagnostics.gravity import OTHER_GRAVITY
from gtau.estimation.diagnostics.verdict import coupled, worst
from gtau.estimation.results.conclusions import INFLATED
from gtau.findings import Grade
from gtau.model.base_parameters import BaseParameters, base_parameters
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.result import Result, identify
from gtau.robots.robot import Robot
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run, read_run

ROBOT = load_robot("orthoglide")
Fault = Callable[[list[Run]], tuple[Robot, list[Run]]]


@pytest.fixture(scope="module", autouse=True)
def base_once() -> Iterator[None]:
    """Base parameters found once for each robot, as most of these experiments are of the same."""
    found: dict[Robot, BaseParameters] = {}

    def remembered(model: InverseDynamics, sensors: tuple[str, ...] = ()) -> BaseParameters:
        if model.robot not in found:
            found[model.robot] = base_parameters(model, sensors=sensors)
        return found[model.robot]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(gtau.model.base_parameters, "base_parameters", remembered)
        yield


@pytest.fixture(scope="module")
def runs() -> list[Run]:
    return experiment(1)


def sentences(result: Result) -> str:
    return " | ".join(gain.verdict.sentence for gain in result.drive_gains.values())


def number_after(words: str, text: str) -> float:
    return float(text.partition(words)[2].split()[0])


def found_kinds(result: Result) -> list[str]:
    """Kinds of the findings behind the verdicts of the gains, and of their causes."""
    found = [gain.verdict.finding for gain in result.drive_gains.values() if gain.verdict.finding]
    return [kind for each in found for kind in (each.kind, *each.causes)]


def errors(result: Result) -> np.ndarray:
    """Errors of the gains, per cent."""
    return np.array([100 * (each.value / DRIVE_GAINS[joint] - 1) for joint, each in result.drive_gains.items()])


# No fault


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3))])
def test_no_false_alarm(seed: int, runs: list[Run]) -> None:
    result = identify(ROBOT, runs if seed == 1 else experiment(seed))
    every = [gain.verdict for gain in result.drive_gains.values()] + [each.verdict for each in result.payloads]
    assert worst(every) == Grade.GOOD
    assert not any(verdict.finding for verdict in every)
    assert result.statistics["lack_of_fit"] < INFLATED
    assert np.abs(errors(result)).max() < 0.6


# Faults of the runs


def command(run: Run, columns: Sequence[int], signs: Sequence[float] = (1, 1, 1)) -> Run:
    return replace(run, command=run.command[:, columns] * signs)


def only(runs: list[Run], k: int, fault: Callable[[Run], Run]) -> list[Run]:
    return [fault(run) if i == k else run for i, run in enumerate(runs)]


def warm_up(run: Run) -> Run:
    return replace(run, command=run.command * np.linspace(1.0, 1.05, len(run.time))[:, None])


def warmer(run: Run, share: float) -> Run:
    """Of a motor whose torque constant has fallen by a share."""
    return replace(run, command=run.command * (1 + share))


def saturating(runs: list[Run]) -> list[Run]:
    """Of motors whose torque constants fall by 5 % up to twice the rms current in motion, whatever they carry."""
    moving = [np.abs(np.gradient(run.position, run.time, axis=0)).max(axis=1) > 0.01 for run in runs]
    used = np.concatenate([run.command[at] for run, at in zip(runs, moving, strict=True)])
    large = 2 * np.sqrt(np.mean(used**2, axis=0))
    return [replace(run, command=run.command * (1 + 0.05 * np.abs(run.command) / large)) for run in runs]


def turned(robot: Robot) -> Robot:
    x, y, z = robot.gravity
    return replace(robot, gravity=(z, x, y))


GRAVITY = {
    "all gains negative",
    OTHER_GRAVITY,
    "lost in noise",
    "sign open",
}
ANY_PAYLOAD = {*GRAVITY, "contradictory payload", "gain of a run", "wide interval"}
"""Findings whose advice is to check which runs carry the payload."""

FAULTS: dict[str, tuple[Fault, Grade, set[str]]] = {
    "swapped channels": (
        lambda runs: (ROBOT, [command(run, [1, 0, 2]) for run in runs]),
        Grade.CONTRADICTORY,
        {SWAPPED_CHANNELS, "unexplained current"},
    ),
    "a sign flipped in one run": (
        lambda runs: (ROBOT, only(runs, 0, lambda run: command(run, [0, 1, 2], (1, -1, 1)))),
        Grade.CONTRADICTORY,
        {"odd run"},
    ),
    "all signs flipped": (
        lambda runs: (ROBOT, [command(run, [0, 1, 2], (-1, -1, -1)) for run in runs]),
        Grade.CONTRADICTORY,
        {"all gains negative"},
    ),
    "an unloaded run declared loaded": (
        lambda runs: (ROBOT, only(runs, 1, lambda run: replace(run, payload=runs[2].payload))),
        Grade.WEAK,
        ANY_PAYLOAD | {TOOL_BODY},
    ),
    "a loaded run declared unloaded": (
        lambda runs: (ROBOT, only(runs, 2, lambda run: replace(run, payload=None))),
        Grade.WEAK,
        ANY_PAYLOAD | {TOOL_BODY},
    ),
    "gravity along another axis": (lambda runs: (turned(ROBOT), runs), Grade.CONTRADICTORY, GRAVITY),
    "gravity upside down": (
        lambda runs: (replace(ROBOT, gravity=(0.0, 0.0, 9.80665)), runs),
        Grade.CONTRADICTORY,
        GRAVITY,
    ),
    "positions in the wrong order": (
        lambda runs: (ROBOT, [replace(run, position=run.position[:, [1, 0, 2]]) for run in runs]),
        Grade.CONTRADICTORY,
        {SWAPPED_CHANNELS, "unexplained current"},
    ),
}


LIKE_ANOTHER = {
    "gravity upside down", "positions in the wrong order", "a sign flipped in one run", "all signs flipped",
    "an unloaded run declared loaded", "swapped channels", "a loaded run declared unloaded",
    "gravity along another axis",  # beyond ten seconds
}  # fmt: skip


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if name in LIKE_ANOTHER else ()) for name in FAULTS]
)
def test_a_fault_is_noticed(name: str, runs: list[Run]) -> None:
    put_in, outcome, kinds = FAULTS[name]
    robot, faulty = put_in(runs)
    result = identify(robot, faulty)
    found = worst([gain.verdict for gain in result.drive_gains.values()])
    assert list(Grade).index(found) >= list(Grade).index(outcome), sentences(result)
    for joint, gain in result.drive_gains.items():  # no gain is believed that is off by more than its interval
        low, high = gain.interval() or (0.0, 0.0)
        assert low < DRIVE_GAINS[joint] < high or gain.verdict.outcome != Grade.GOOD
    assert kinds & set(found_kinds(result)), sentences(result)


# What motors do: it is no fault of logs or description, so it has a size, and the gain beside it is right

EXPLAINED: dict[str, tuple[Callable[[list[Run]], list[Run]], str, float, float]] = {
    "warms up in the first run": (lambda runs: only(runs, 0, warm_up), "gain of a run", 0.75 * 0.025, 0.006),
    "warms up from run to run": (
        lambda runs: [warmer(run, 0.01 * k) for k, run in enumerate(runs)],
        "gain of a run",
        0.015,
        0.015,
    ),
    "a torque constant that falls with the current": (saturating, "saturation", 0.05, 0.0),
}
"""What is done to the runs, the effect that explains it, its size, and the larger current in the mean of the runs."""


@pytest.mark.slow
@pytest.mark.parametrize("name", EXPLAINED)
def test_what_motors_do_is_explained_with_its_size(name: str, runs: list[Run]) -> None:
    put_in, effect, size, mean = EXPLAINED[name]
    result = identify(ROBOT, put_in(runs))
    assert worst([gain.verdict for gain in result.drive_gains.values()]) in (Grade.GOOD, Grade.WEAK)
    for joint, gain in result.drive_gains.items():
        low, high = gain.interval() or (0.0, 0.0)
        assert low < DRIVE_GAINS[joint] < high
        assert gain.value * (1 + mean) == pytest.approx(DRIVE_GAINS[joint], rel=0.006)
    by_likelihood = sorted(result.effects, key=lambda each: -each.likelihood)
    assert next(each for each in by_likelihood if each.effect != "ripple").effect == effect  # the plant has ripple
    sizes = [abs(each.size) for each in result.effects if each.effect == effect]
    assert sizes == pytest.approx([size] * len(DRIVE_GAINS), rel=0.12)


@pytest.mark.slow
def test_one_reversed_current_is_a_negative_gain_and_contradicts_alone(
    runs: list[Run],
) -> None:
    result = identify(ROBOT, [command(run, [0, 1, 2], (1, -1, 1)) for run in runs])
    assert result.drive_gains["12"].value == pytest.approx(-DRIVE_GAINS["12"], rel=0.006)
    outcomes = [gain.verdict.outcome for gain in result.drive_gains.values()]
    assert outcomes == [Grade.GOOD, Grade.CONTRADICTORY, Grade.GOOD]
    assert found_kinds(result) == ["negative gain"]
    assert result.drive_gains["12"].verdict.why in " ".join(result.summary().split())


def test_millimetres_read_as_metres_are_refused(runs: list[Run]) -> None:
    with pytest.raises(GtauError, match=r"look like mm taken for m; write mm under units\.position"):
        identify(ROBOT, [replace(run, position=1e3 * run.position) for run in runs])


# A wrong mass


def heavier(run: Run, name: str, factor: float) -> Run:
    if run.payload is None or run.payload.name != name or run.payload.mass is None:
        return run
    return replace(run, payload=Payload(name=name, mass=factor * run.payload.mass))


@pytest.mark.slow
def test_a_wrong_mass_is_not_noticed_with_one_payload(runs: list[Run]) -> None:
    """All gains scale with it, which docs/lookup/verdicts.md says."""
    result = identify(ROBOT, [heavier(run, "1.983 kg", 1.2) for run in runs])
    np.testing.assert_allclose(errors(result), 20.0, atol=0.6)
    assert worst([gain.verdict for gain in result.drive_gains.values()]) == Grade.GOOD


@pytest.mark.slow
def test_a_wrong_mass_is_noticed_with_two_payloads() -> None:
    two = experiment(4, (0.0, 1.136, 1.983))
    for factor, outcome in ((1.0, Grade.GOOD), (1.03, Grade.CONTRADICTORY)):
        result = identify(ROBOT, [heavier(run, "1.983 kg", factor) for run in two])
        assert worst([each.verdict for each in result.payloads]) == outcome
        kinds = {each.verdict.finding.kind for each in result.payloads if each.verdict.finding}
        assert kinds == ({"payload mass"} if factor > 1 else set())


# A wrong parameter of a payload, on a five-bar that carries it at a known place


def steel(parameters: dict[str, float]) -> list[Run]:
    plant = Plant(noise=0.02)
    free, loaded = plant.run("free", 8.0, seed=1), plant.run("loaded", 8.0, STEEL, seed=2)
    return [free, replace(loaded, payload=Payload(name="steel", mass=STEEL["m"], parameters=parameters))]


@pytest.mark.slow
def test_a_wrong_parameter_of_the_payload_is_found_and_named() -> None:
    five_bar, kinds = load_robot("five-bar"), [kind for kind in STEEL if kind != "m"]
    right = identify(five_bar, steel({kind: STEEL[kind] for kind in kinds}))
    assert worst([gain.verdict for gain in right.drive_gains.values()]) == Grade.GOOD, sentences(right)
    assert right.payloads[0].verdict.outcome == Grade.GOOD
    kind = kinds[0]
    # half of it, as no body is large enough for half more, which is refused when it is read
    wrong = identify(five_bar, steel({each: STEEL[each] * (0.5 if each == kind else 1.0) for each in kinds}))
    assert {gain.verdict.outcome for gain in wrong.drive_gains.values()} == {Grade.CONTRADICTORY}
    found = [gain.verdict.finding for gain in wrong.drive_gains.values()]
    assert ("contradictory payload", "steel") in {(each.kind, each.subject) for each in found}
    verdict = wrong.payloads[0].verdict
    assert verdict.outcome == Grade.CONTRADICTORY
    assert verdict.finding.kind == "payload parameter"
    assert number_after(f"its {kind} is ", verdict.why) == pytest.approx(STEEL[kind], rel=0.05)


@pytest.mark.parametrize(
    ("factor", "outcome", "against_gains"),
    [
        (1.0, Grade.GOOD, set()),
        (1.1, Grade.CONTRADICTORY, set()),
        pytest.param(10.0, Grade.CONTRADICTORY, {"contradictory payload"}, marks=pytest.mark.slow),
    ],
)
def test_a_wrong_mass_contradicts_logs_of_torques(factor: float, outcome: Grade, against_gains: set[str]) -> None:
    """Even of a single payload, as the torques give the scale; where joints are unexplained too, it is named."""
    robot = load_robot("five-bar")
    torques = [replace(run, command=run.command * FIVE_BAR_GAINS, kind="torque") for run in steel({})]
    result = identify(robot, [heavier(run, "steel", factor) for run in torques], method="wls")
    assert result.payloads[0].verdict.outcome == outcome
    assert result.believable == (outcome == Grade.GOOD)
    against = [gain.verdict.finding for gain in result.drive_gains.values() if gain.verdict.finding]
    assert {each.kind for each in against} == against_gains
    if factor > 1:
        finding = result.payloads[0].verdict.finding
        assert finding.kind == "payload mass"
        assert number_after("a mass of ", finding.what) == pytest.approx(STEEL["m"], rel=0.03)


# Factors of a thousand


def per_ampere(factor: float) -> dict[str, float]:
    return {joint: factor * gain for joint, gain in DRIVE_GAINS.items()}


@pytest.mark.slow
def test_milliamperes_read_as_amperes_contradict_the_prior_gains(runs: list[Run]) -> None:
    milli = [replace(run, command=1e3 * run.command) for run in runs]
    result = identify(ROBOT, milli, prior_gains=per_ampere(1.05))
    assert {gain.verdict.outcome for gain in result.drive_gains.values()} == {Grade.CONTRADICTORY}
    assert set(found_kinds(result)) == {"prior gain"}
    assert all("(mA declared as A?)" in gain.verdict.advice for gain in result.drive_gains.values())
    right = identify(ROBOT, runs, prior_gains=per_ampere(1.05))
    assert worst([gain.verdict for gain in right.drive_gains.values()]) == Grade.GOOD


@pytest.mark.slow
def test_grams_read_as_kilograms_contradict_prior_gains_and_limits(runs: list[Run]) -> None:
    grams = [heavier(run, "1.983 kg", 1e3) for run in runs]
    found = identify(ROBOT, grams, prior_gains=per_ampere(0.9)).drive_gains.values()
    assert all("(g entered as kg?)" in gain.verdict.advice for gain in found)
    joints = [
        replace(joint, limits=replace(joint.limits, effort=2000.0)) if joint.name in DRIVE_GAINS else joint
        for joint in ROBOT.joints
    ]
    limited = replace(ROBOT, joints=tuple(joints))
    result = identify(limited, grams)
    assert {gain.verdict.finding.kind for gain in result.drive_gains.values()} == {"effort limit"}
    assert not result.accepted
    assert identify(limited, runs).accepted


def test_no_gain_is_good_beside_a_contradictory_one() -> None:
    priors = {"left": FIVE_BAR_GAINS[0], "right": 5 * FIVE_BAR_GAINS[1]}
    gains = identify(load_robot("five-bar"), steel({}), prior_gains=priors).drive_gains
    assert gains["right"].verdict.outcome == Grade.CONTRADICTORY
    assert gains["left"].verdict.outcome == Grade.WEAK
    assert gains["left"].verdict == coupled("left", "right")


@pytest.mark.slow
def test_given_gains_are_said_to_be_given(runs: list[Run]) -> None:
    result = identify(ROBOT, runs, method="wls", prior_gains=per_ampere(1.0))
    assert {gain.verdict.outcome for gain in result.drive_gains.values()} == {Grade.GIVEN}


# A serial arm in the wrong unit


def test_degrees_read_as_radians() -> None:
    model = InverseDynamics(load_robot("puma560"))
    rng = np.random.default_rng(5)
    time = np.arange(2401) / 300.0
    w = 2 * np.pi * np.array([0.3, 0.8, 1.3])[:, None]
    chi = {name: 0.5 if name.startswith(("m_", "ia", "fv", "fs")) else 0.05 for name in model.parameter_names}
    logged = []
    for k, mass in enumerate((0.0, 3.0)):
        angle = w * time[:, None, None] + rng.uniform(0, 6.0, (3, 6))
        q, qd, qdd = (0.4 * np.sin(angle) / w).sum(1), (0.4 * np.cos(angle)).sum(1), (-0.4 * w * np.sin(angle)).sum(1)
        tool = f"m_{model.robot.tool}"
        tau = model.torques(q, qd, qdd, {**chi, tool: chi[tool] + mass})
        current = tau / 10.0 + 0.01 * rng.standard_normal(tau.shape)
        payload = Payload(name="steel", mass=mass) if mass else None
        logged.append(Run(f"run {k}", model.actuated, time, q, current, payload=payload))
    right = identify(model.robot, logged)
    assert worst([gain.verdict for gain in right.drive_gains.values()]) == Grade.GOOD, sentences(right)
    with pytest.raises(GtauError, match="if the log is in deg, write that under 'units'"):
        identify(model.robot, [replace(run, position=np.degrees(run.position)) for run in logged])


# Faults that the checks of a log find

SIGNALS = {
    "time": "t",
    "position": {joint: f"q{joint}" for joint in DRIVE_GAINS},
    "current": {joint: f"v{joint}" for joint in DRIVE_GAINS},
}


def logged(path: Path, run: Run) -> Run:
    names = ["t", *(f"{kind}{joint}" for kind in "qv" for joint in run.joints)]
    table = np.column_stack([run.time, run.position, run.command])
    np.savetxt(path, table, delimiter=",", header=",".join(names), comments="", fmt="%.9f")
    return read_run(path, SIGNALS, run.payload)


def limited(run: Run, share: float) -> Run:
    highest = share * np.abs(run.command).max(axis=0)
    return replace(run, command=np.round(np.clip(run.command, -highest, highest), 9))


@pytest.mark.parametrize("quantum", [1e-6, 0.1], ids=["fine", "coarse"])
def test_currents_without_sign_are_named(quantum: float, runs: list[Run], tmp_path: Path) -> None:
    unsigned = replace(runs[0], command=np.round(np.abs(runs[0].command) / quantum) * quantum)
    with pytest.raises(GtauError, match="never negative although joints reverse, so the columns hold magnitudes"):
        logged(tmp_path / "unsigned.csv", unsigned)


def test_one_current_without_sign_that_rests_at_zero_is_named(runs: list[Run], tmp_path: Path) -> None:
    highest = np.abs(runs[0].command[:, 0]).max()
    command = runs[0].command.copy()
    command[:, 0] = np.where(np.abs(command[:, 0]) < 0.3 * highest, 0.0, np.abs(command[:, 0]))
    with pytest.raises(GtauError, match="command of joint '11' is never negative"):
        logged(tmp_path / "unsigned.csv", replace(runs[0], command=command))


@pytest.mark.slow
def test_clipped_currents_are_masked_and_said(runs: list[Run], tmp_path: Path) -> None:
    clipped = [logged(tmp_path / f"run_{k}.csv", limited(run, 0.85)) for k, run in enumerate(runs)]
    masked = [int((~run.valid).sum()) for run in clipped]
    assert min(masked) > 0
    assert all("is clipped at" in " ".join(map(str, run.notes)) for run in clipped)
    result = identify(ROBOT, clipped)
    assert "is clipped at" in " ".join(result.summary().split())
    for (joint, gain), truth in zip(result.drive_gains.items(), DRIVE_GAINS.values(), strict=True):
        low, high = gain.interval(0.999) or (0.0, 0.0)
        assert low < truth < high, joint


def test_a_command_clipped_all_the_time_is_refused(runs: list[Run], tmp_path: Path) -> None:
    with pytest.raises(GtauError, match=r"is clipped at .* record it again with slower motions"):
        logged(tmp_path / "run.csv", limited(runs[1], 0.3))


def test_good_currents_are_not_taken_for_clipped(runs: list[Run], tmp_path: Path) -> None:
    for k, run in enumerate(runs):
        assert logged(tmp_path / f"run_{k}.csv", run).notes == ()
        coarse = replace(run, command=0.02 * np.round(run.command / 0.02))
        assert "clipped" not in " ".join(map(str, logged(tmp_path / "coarse.csv", coarse).notes))


@pytest.mark.parametrize("slip", [0.001, 0.005])
def test_a_slipped_encoder_is_refused(slip: float, runs: list[Run], tmp_path: Path) -> None:
    run = runs[0]
    later = np.arange(len(run.time)) > 2000
    jumped = run.position + slip * np.outer(later, [0, 1, 0])
    with pytest.raises(GtauError, match=r"joint '12' jumps by 0\.00[15].* at 5\.0025 s.* check the coupling"):
        logged(tmp_path / "run.csv", replace(run, position=jumped))


def test_a_gap_is_refused(runs: list[Run], tmp_path: Path) -> None:
    run, kept = runs[0], np.ones(len(runs[0].time), dtype=bool)
    kept[1000:1100] = False
    gap = replace(
        run, time=run.time[kept], position=run.position[kept], command=run.command[kept], valid=np.ones(0, bool)
    )
    with pytest.raises(GtauError, match=r"0\.25.* s are missing after 2\.49"):
        logged(tmp_path / "run.csv", gap)

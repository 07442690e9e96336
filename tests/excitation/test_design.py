"""Designs keep their limits, tell more than other motions, and keep what they promise."""

from __future__ import annotations

import json
import os
import signal
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from five_bar_logs import DESIGN
from repetitions import repeated_gains
from threadpoolctl import threadpool_limits
from typer.testing import CliRunner

import gtau.excitation.design as design
import gtau.excitation.nlp as nlp
from gtau.cli.commands import app
from gtau.errors import GtauError
from gtau.excitation.constraints import ConstraintUsage
from gtau.excitation.design import Design, Stopped, check, excite
from gtau.excitation.design_file import read_design
from gtau.excitation.forecast import Expected, Outlook, forecast, sampled_run
from gtau.excitation.information import root_covariance
from gtau.excitation.nlp import Programme, information, random_start
from gtau.excitation.prior import KnownGain
from gtau.excitation.task import design_grid, evaluate
from gtau.model.home import load_robot
from gtau.report.design import design_document, design_page
from gtau.report.page import Table
from gtau.report.terminal import plain
from gtau.robots.readers.read import CATALOG
from gtau.signals.reading.logs import read_log

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
ORTHOGLIDE = """
robot: orthoglide
rate: 500
period: 3
harmonics: 5
runs:
  - payload: none
  - payload: {name: disc, mass: 1.983}
limits:
  workspace: {x: [-0.09, 0.09], y: [-0.09, 0.09], z: [0.25, 0.43]}
prior:
  gains: {"11": 2170, "12": 2100, "13": 2070}
  noise: {"11": 0.0003, "12": 0.0003, "13": 0.0003}
"""


ARM = """
robot: ur10e
rate: 500
period: 8
harmonics: 2
runs: [{payload: none}, {payload: {name: a payload with a long name, mass: 2.0}}]
limits: {shapes: none, floor: none}
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "design.yaml"
    path.write_text(text)
    return path


def table_of(outlook: Outlook, name: str) -> Table:
    """The table of a section of a design's page."""
    (designed,) = (entry.items[0] for entry in design_page(outlook).sections if entry.id == name)
    return designed


@pytest.fixture(scope="module")
def search(tmp_path_factory) -> tuple[Design, list[tuple[str, int, int]]]:
    """A design and the progress of its search."""
    task, _ = read_design(write(tmp_path_factory.mktemp("design"), DESIGN))
    seen: list[tuple[str, int, int]] = []
    return excite(task, starts=1, progress=lambda *entry: seen.append(entry)), seen


@pytest.fixture(scope="module")
def designed(search: tuple[Design, list[tuple[str, int, int]]]) -> Design:
    return search[0]


@pytest.mark.slow
def test_all_limits_hold_on_a_grid_ten_times_finer(designed: Design) -> None:
    every = check(designed.task, designed.x)
    assert {load.what: load.excess for load in every if load.excess > 1} == {}
    assert max(load.excess for load in every) > 0.95  # and some are used
    kinds = {load.what.split()[0] for load in every}
    assert {"position", "velocity", "acceleration", "jerk", "torque", "x", "z", "condition", "time"} <= kinds
    # counted once more, without the design's own code, at the rate of the controller
    time, joints = sampled_run(designed.task, designed.x)
    limits = designed.task.limits
    assert np.all(joints[0] >= limits.position[:, :1])
    assert np.all(joints[0] <= limits.position[:, 1:])
    assert np.all(np.abs(np.gradient(joints[0], time, axis=1)) <= limits.rates[0][:, None] * 1.001)
    assert np.abs(joints[1:3][:, :, [0, -1]]).max() < 1e-9
    home = [designed.task.model.robot.joint(name).home for name in designed.task.model.actuated]
    assert joints[0][:, 0] == pytest.approx(home)
    assert joints[0][:, -1] == pytest.approx(home, abs=1e-6)


def test_deviations_expected_are_those_of_100_simulated_experiments(designed: Design, rng: np.random.Generator) -> None:
    gains = repeated_gains(designed.task, designed.x, 100, rng)
    gains = gains[np.isfinite(gains).all(axis=1)]
    assert len(gains) >= 95
    expected = np.array([entry.std for entry in forecast(designed.task, designed.x).gains])
    assert gains.std(axis=0, ddof=1) / expected == pytest.approx(1.0, abs=0.2)
    assert np.abs(gains.mean(axis=0) - designed.task.prior.gains).max() < 4 * expected.max() / 10


@pytest.mark.slow
@pytest.mark.parametrize(
    "robot", ["orthoglide", *(pytest.param(name, marks=pytest.mark.slow) for name in ("delta", "ur10e"))]
)
def test_forecasts_hold_for_three_motors_and_six_axes(robot: str, rng: np.random.Generator) -> None:
    task, _ = read_design(BENCHMARKS / f"excitation_{robot}.yaml")
    task = replace(task, repetitions=1)
    x = random_start(task, rng, 0.9)
    assert x is not None
    gains = repeated_gains(task, x, 100, rng)
    gains = gains[np.isfinite(gains).all(axis=1)]
    assert len(gains) >= 90
    expected = np.array([entry.std for entry in forecast(task, x).gains])
    # the standard deviation of 100 repetitions is itself known to 7 %
    assert gains.std(axis=0, ddof=1) / expected == pytest.approx(1.0, abs=0.2)


def test_a_mass_known_to_ten_per_cent_gives_gains_known_to_ten_per_cent(tmp_path: Path) -> None:
    """As all gains scale with the mass of one payload."""
    expected = {}
    for std in (0.0, 0.1):
        task, _ = read_design(write(tmp_path, DESIGN.replace("mass: 1.0", f"mass: 1.0, mass_std: {std}")))
        x = random_start(task, np.random.default_rng(0), 0.9)
        assert x is not None
        expected[std] = np.array([gain.relative for gain in forecast(task, x).gains])
    assert expected[0.1] == pytest.approx(np.hypot(expected[0.0], 10.0), rel=1e-3)


def test_values_that_are_only_assumed_are_not_printed_as_results(tmp_path: Path) -> None:
    task, assumed = read_design(write(tmp_path, DESIGN.replace("gains: {left: 1.5, right: 1.5}", "noise: {left: 9}")))
    assert set(assumed) == {"parameters", "gains", "noise"}
    x = random_start(task, np.random.default_rng(1), 0.9)
    assert x is not None
    start = Design(task, "gains", x, 1.0, (), 0)
    outlook = Outlook(start, assumed)
    gain = design_document(outlook)["gains"][0]
    assert gain["assumed"]
    (row,) = (row for row in table_of(outlook, "gains").rows if row[0] == "left")
    assert row == ("left", None, None, gain["rel_std"], "N m/A", "assumed")
    prior = replace(task.prior, known=tuple(KnownGain(1.5, (1.3, 1.7), "weak", 0.06) for _ in range(2)))
    again = Outlook(replace(start, task=replace(task, prior=prior)), {})
    (row,) = (row for row in table_of(again, "gains").rows if row[0] == "left")
    random = row[3]
    assert row[4:] == (pytest.approx(np.hypot(random, 4.0)), "N m/A", "weak, 1.3 to 1.7")
    usual = dict(zip(task.information.names, task.information.scale, strict=True))["fv_left"]
    for size, value, shown in ((22.0, usual, "> 1000"), (9.9, usual, "990"), (0.65, 0.0, "65")):
        changed, std = Outlook(start, assumed), size * usual
        parts = {"parameters": (Expected("fv_left", value, std),), "std": outlook.forecast.std | {"fv_left": std}}
        vars(changed)["forecast"] = replace(outlook.forecast, **parts)
        table = table_of(changed, "parameters")
        assert (table.rows[0][0], table.columns[3].text(table.rows[0][3])) == ("fv_left", shown)
        said = " ".join(design_page(changed).sections[0].items[0].points).replace("\N{NO-BREAK SPACE}", " ")
        assert f"fv_left ({shown} %)" in said
    known = read_design(write(tmp_path, DESIGN))[1]
    assert not any(entry["assumed"] for entry in design_document(Outlook(start, known))["gains"])


def test_the_design_criterion_agrees_with_the_forecast(designed: Design) -> None:
    unknowns = designed.task.information
    gains = [unknowns.names.index(f"gain_{joint}") for joint in designed.task.model.actuated]
    R = information(evaluate(designed.task, designed.x, design_grid(designed.task)))
    expected = np.array([entry.relative for entry in forecast(designed.task, designed.x).gains]) / 100
    std = np.linalg.norm(root_covariance(R, unknowns.known), axis=1) / unknowns.scale
    assert std[gains] == pytest.approx(expected, rel=0.3)


@threadpool_limits.wrap(limits=1, user_api="blas")
@pytest.mark.slow
def test_a_design_tells_twice_as_much_as_the_best_of_200_random_motions(tmp_path: Path) -> None:
    task, _ = read_design(write(tmp_path, ORTHOGLIDE))
    designed = excite(task, starts=1)
    programme, values = Programme(task, "gains", {load.what: 1.0 for load in designed.constraint_usages}), []
    rng = np.random.default_rng(0)
    while len(values) < 200:
        x = random_start(task, rng, 0.99)  # as far as the same limits let it
        assert x is not None
        if programme.excess(x) <= 1.0:
            values.append(np.exp(programme.value(x)[0]))
    assert designed.value < min(values) / 2


def test_limits_that_cannot_hold_are_named(tmp_path: Path) -> None:
    low = DESIGN.replace("jerk:", "current: {left: 0.01, right: 0.01}\n  jerk:") + "approach: false\n"
    task, _ = read_design(write(tmp_path, low))
    with pytest.raises(GtauError, match=r"the current of joint '(left|right)'.* must be at most 0.01 A") as refusal:
        excite(task, starts=1)
    assert "no motion within the limits was found" in str(refusal.value)


@pytest.mark.parametrize(("below", "above", "seed"), [pytest.param(1.5, 1.5, 2, marks=pytest.mark.slow), (0.3, 2.2, 0)])
def test_loops_that_cannot_be_closed_on_the_way_are_left_to_the_search(
    tmp_path: Path, below: float, above: float, seed: int
) -> None:
    """Wide limits hold singular poses: on the way from rest to a motion, or in the middle of the limits."""
    robot = (CATALOG / "3-rrr.yaml").read_text()
    (tmp_path / "wide.yaml").write_text(
        robot.replace("beta - 0.25", f"beta - {below}").replace("beta + 0.25", f"beta + {above}")
    )
    runs = "runs: [{payload: none}, {payload: {name: disc, mass: 1}}]"
    task, _ = read_design(write(tmp_path, f"robot: wide.yaml\nrate: 100\nperiod: 3\nharmonics: 2\n{runs}\n"))
    designed = excite(task, starts=1, seed=seed)
    assert max(usage.excess for usage in check(task, designed.x)) <= 1.0
    _, joints = sampled_run(task, designed.x)  # at the controller's rate
    assert np.isfinite(task.model.motion(*joints[:3]).c).all()


def test_a_pose_at_rest_that_closes_no_loop_is_refused_in_the_words_of_a_design(tmp_path: Path) -> None:
    limits = "limits: {position: {'11': [3, 9]}}\nrest: {'11': 8}\n"
    runs = "runs: [{payload: none}, {payload: {name: disc, mass: 1}}]"
    with pytest.raises(GtauError, match=r"loops cannot be closed where runs begin.*give positions that .*'rest'"):
        read_design(write(tmp_path, f"robot: 3-rrr\nrate: 100\n{limits}{runs}\n"))


@pytest.mark.slow
@pytest.mark.parametrize("asked", [1, 30, 60, 90])
def test_a_stopped_design_is_the_best_so_far_and_within_the_limits(tmp_path: Path, asked: int) -> None:
    task, _ = read_design(write(tmp_path, DESIGN))
    kept: list[Design] = []
    steps: list[int] = []

    def stop() -> bool:
        steps.append(1)
        return len(steps) > asked

    stopped = excite(task, starts=50, keep=kept.append, stop=stop)
    assert stopped.cut_short
    assert stopped.start == 0
    assert stopped.value == kept[-1].value == min(entry.value for entry in kept)
    assert max(usage.excess for usage in check(task, stopped.x)) <= 1.0
    assert "the search was cut short" in plain(design_page(Outlook(stopped, {})))


def test_progress_counts_iterations(search: tuple[Design, list[tuple[str, int, int]]]) -> None:
    designed, seen = search
    assert not designed.cut_short
    done = [entry[1] for entry in seen]
    assert done == sorted(done)
    assert len(set(done)) > 10
    assert seen[-1] == ("searching", seen[0][2], seen[0][2])


def test_a_search_stopped_before_it_has_found_anything_does_not_blame_the_limits(tmp_path: Path) -> None:
    low = DESIGN.replace("jerk:", "current: {left: 0.01, right: 0.01}\n  jerk:") + "approach: false\n"
    task, _ = read_design(write(tmp_path, low))
    with pytest.raises(Stopped, match="the search was stopped before it found a motion within the limits"):
        excite(task, starts=3, stop=lambda: True)


def test_all_weak_parameters_are_listed_with_the_figures_of_the_table(designed: Design) -> None:
    document = design_document(Outlook(designed, {}))
    weak = {entry["name"]: entry["rel_std"] for entry in document["weak"]}
    for entry in document["parameters"]:
        if entry["rel_std"] is not None:
            assert (entry["rel_std"] >= 30) == (entry["name"] in weak)
            assert weak.get(entry["name"], entry["rel_std"]) == pytest.approx(entry["rel_std"])


def test_bodies_without_parameters_are_listed(tmp_path: Path) -> None:
    given = DESIGN.replace("prior:\n", "prior:\n  parameters: {m_left: 1.0, zz_left_forearm: 0.01, fv_right: 0.1}\n")
    _, assumed = read_design(write(tmp_path, given))
    assert assumed["massless"].startswith("no mass and inertia of right, right_forearm")
    assert "left" not in assumed["massless"]
    assert "massless" not in read_design(write(tmp_path, DESIGN))[1]


@pytest.mark.parametrize(
    ("name", "advice"),
    [
        ("gain_lef", r"did you mean 'gain_left'\?"),
        ("nonsense", "choose gains, condition, logdet, trace, or names of"),
        ("", "choose gains"),
    ],
)
def test_an_unknown_criterion_is_refused_shortly(designed: Design, name: str, advice: str) -> None:
    with pytest.raises(GtauError, match=f"there is no criterion or parameter '{name}'; {advice}") as refusal:
        excite(designed.task, name)
    assert len(str(refusal.value)) < 200


def test_the_command_writes_trajectory_table_and_figure(tmp_path: Path) -> None:
    path = write(tmp_path, DESIGN)
    command = [
        "excite",
        str(path),
        "--out",
        str(tmp_path / "out"),
        "--starts",
        "1",
        "--payload-mass",
        "0.5,2",
        "--json",
    ]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    document = json.loads((tmp_path / "out" / "design.json").read_text())
    assert [entry["mass"] for entry in document["payload_masses"]] == [0.5, 2.0]
    light, heavy = (entry["rms"] for entry in document["payload_masses"])
    assert heavy < light
    log = read_log(tmp_path / "out" / "trajectory.csv", ("t", "q_left", "qd_left", "qdd_right")).arrays()
    assert np.diff(log["t"]) == pytest.approx(1 / 500)
    assert np.gradient(log["q_left"], 1 / 500) == pytest.approx(log["qd_left"], abs=0.02)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("harmonics: 4", "harmonic: 4", "did you mean 'harmonics'"),
        ("  - payload: {name: disc, mass: 1.0}\n", "", "payload of known mass"),
        ("velocity: {left: 4, right: 4}", "velocity: {lift: 4}", "limits.velocity names 'lift'"),
        ("harmonics: 4", "harmonics: 400", "highest harmonic"),
        ("period: 4", "period: 4\nrest: {left: 0}", "outside its limits"),
    ],
)  # fmt: skip
def test_design_files_that_cannot_be_are_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    with pytest.raises(GtauError, match=message):
        read_design(write(tmp_path, DESIGN.replace(old, new)))


def test_what_a_design_prints_fits_a_terminal(tmp_path: Path) -> None:
    joints = load_robot("ur10e").actuated
    masses = (1.0, 2.0, 3.0, 4.0, 5.0, 60.0)
    task, assumed = read_design(write(tmp_path, ARM))
    x = random_start(task, np.random.default_rng(1), 0.9)
    assert x is not None
    outlook = Outlook(Design(task, "gains", x, 1.0, tuple(check(task, x)), 0), assumed, masses)
    lines = plain(design_page(outlook)).splitlines()
    assert max(map(len, lines)) <= 80
    assert any("(> 1000 %)" in line for line in lines)  # no number apart from its unit
    assert {row[1].split()[0] for row in table_of(outlook, "limits").rows} == {"between", "at"}  # at most, at least
    shown, exceeded = next(entry.items for entry in design_page(outlook).sections if entry.id == "masses")
    assert [column.title for column in shown.columns][1:3] == ["as designed", "1 kg"]
    assert [row[0] for row in shown.rows] == ["rms", *joints]
    rows = {entry.name: entry.relative for entry in outlook.variants[1].forecast.gains}
    assert [row[3] for row in shown.rows[1:]] == list(rows.values())
    assert exceeded.points[-1].startswith("with 60 kg this motion exceeds: ")


def test_what_a_limit_is_called_does_not_change_what_is_reached() -> None:
    """A condition number is counted in logarithms, in whichever run and words."""
    usage = ConstraintUsage("condition", "conditioning in run 2", 100.0, "", np.array([0.5, 1.5]), lambda: np.zeros(0))
    assert usage.reached == pytest.approx(150.0)
    assert replace(usage, logarithmic=True).reached == pytest.approx(1000.0)


def test_voltages_give_gains_without_a_payload(tmp_path: Path) -> None:
    """The information of each gain is limited by its commutation; a design without either reference is refused."""
    unloaded = "robot: five-bar\nrate: 200\nperiod: 5\nharmonics: 3\nruns: [{payload: none}]\n"
    with pytest.raises(GtauError, match="or 'drives' whose voltages are logged"):
        read_design(write(tmp_path, unloaded))
    drives = "drives: {left: {convention: amplitude, commutation: 0.01}, right: {commutation: 0.02}}\n"
    task, _ = read_design(write(tmp_path, unloaded + drives))
    x = random_start(task, np.random.default_rng(0), 0.9)
    left, right = forecast(task, x).gains
    joined = 100 / np.hypot(1 / 0.01, 1 / 0.02)  # both motors move the same links
    assert joined < left.relative < 1.0
    assert joined < right.relative < 2.0
    _, assumed = read_design(write(tmp_path, unloaded + "drives: {left: {convention: dc}}\n"))
    assert "1.5 % between torque and back-EMF constant of left; state 'commutation'" in assumed["voltages"]
    stray = unloaded + "drives: {elbow: {commutation: 0.01}}\n"
    with pytest.raises(GtauError, match="drives names 'elbow', which is no actuated joint"):
        read_design(write(tmp_path, stray))
    sheet = unloaded + "drives: {left: {gear_ratio: 50, torque_constant: 0.1}}\n"
    with pytest.raises(GtauError, match="the drive of 'left' states nothing of its voltages"):
        read_design(write(tmp_path, sheet))


@pytest.mark.parametrize("error", [GtauError("the hull of the wrist is empty; correct it."), KeyboardInterrupt()])
@pytest.mark.parametrize("call", [1, 5, 40])
def test_exceptions_of_a_search_reach_the_caller(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], error: BaseException, call: int
) -> None:
    """IPOPT would print them and go on."""
    task, _ = read_design(write(tmp_path, DESIGN))
    calls: list[int] = []

    def broken(*given: object) -> tuple[float, np.ndarray]:
        calls.append(1)
        if len(calls) >= call:
            raise error
        return objective(*given)  # type: ignore[arg-type]

    def searching(programme: Programme, x: np.ndarray, stop: Callable[[], bool], near: Any) -> Any:
        monkeypatch.setattr(nlp, "objective", broken)
        return solve(programme, x, stop, near)

    objective, solve = nlp.objective, nlp.solve
    monkeypatch.setattr(design, "solve", searching)
    with pytest.raises(type(error)) as caught:
        excite(task, starts=1)
    assert caught.value is error
    assert capfd.readouterr() == ("", "")


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_ctrl_c_in_the_solver_ends_a_search(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """CasADi asks for signals before every call, and would print the exception and go on."""
    task, _ = read_design(write(tmp_path, DESIGN))
    asked: list[int] = []

    def stop() -> bool:
        asked.append(1)
        if len(asked) == 30:
            threading.Timer(0.01, signal.raise_signal, [signal.SIGINT]).start()
        return False

    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # jobs in the background ignore it
    try:
        with pytest.raises(KeyboardInterrupt):
            excite(task, starts=50, stop=stop)
    finally:
        signal.signal(signal.SIGINT, before)
    assert capfd.readouterr() == ("", "")

"""What people of the field type in Python: it works, or the answer can be typed."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars
import pytest
from engines import Pinocchio, random_parameters
from five_bar_logs import STEEL, Plant, write_experiment
from matplotlib.figure import Figure
from models_to_export import model_of
from robots_for_tests import seven_r
from typer.testing import CliRunner

import gtau
from gtau.cli.commands import app
from gtau.demo import write_tutorial
from gtau.excitation.design_file import EXAMPLE
from gtau.findings import Finding, Grade
from gtau.uses.identify import in_python

SIGNALS = {"time": "t", "position": {"left": "q1", "right": "q2"}, "current": {"left": "v1", "right": "v2"}}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_experiment(tmp_path_factory.mktemp("hand"), Plant(noise=0.01)).parent


@pytest.fixture(scope="module")
def result(folder: Path) -> gtau.Result:
    return gtau.identify(folder / "experiment.yaml")


def test_numbers_of_an_estimate(result: gtau.Result) -> None:
    gain = result.drive_gains["left"]
    assert float(gain) == gain.value
    assert f"{gain:.3f}" == f"{gain.value:.3f}"
    assert f"{gain}" == str(gain)
    assert (gain * 2, 2 * gain, gain / 2, 2 / gain) == (2 * gain.value, 2 * gain.value, gain.value / 2, 2 / gain.value)
    assert (gain * np.ones(3)).tolist() == (np.ones(3) * gain).tolist() == [gain.value] * 3
    assert (round(gain, 2), gain > 2, gain >= 2, gain < 2) == (round(float(gain), 2), True, True, False)
    assert str(replace(gain, unit="1")) == str(gain).removesuffix(" N m/A")
    assert (str(gain.verdict), repr(gain.verdict)) == ("good", "Finding(good, 'good')")


def test_a_saved_result_is_loaded(result: gtau.Result, tmp_path: Path) -> None:
    result.save(tmp_path / "model.json")
    assert gtau.load(tmp_path / "model.json").drive_gains == result.drive_gains
    assert result.export("csv", tmp_path / "csv").files


def test_logs_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With columns by name, or stated: the same result, and the notes say what was guessed."""
    monkeypatch.chdir(tmp_path)
    for name, load in (("empty", None), ("loaded", STEEL)):
        run = Plant(noise=0.01).run(name, payload=load, seed=len(name))
        table = run.to_frame().rename({"qleft": "enc_J1", "qright": "enc_J2", "vleft": "iq_J1", "vright": "iq_J2"})
        table.write_csv(f"{name}.csv")
    columns = {"position": "enc_J*", "current": "iq_J*", "time": "t"}
    experiment = gtau.draft(["empty.csv", "loaded.csv"], "five-bar", {"loaded.csv": 1.2}, columns=columns)
    assert experiment.signals.position == {"left": "enc_J1", "right": "enc_J2"}
    assert any("columns were assigned to the joints" in guess.what for guess in experiment.guesses)
    columns |= {"position": "enc_J2,enc_J1"}  # of the joints left and right, whatever their numbers
    listed = gtau.draft(["empty.csv", "loaded.csv"], "five-bar", {"loaded.csv": 1.2}, columns=columns)
    assert listed.signals.position == {"left": "enc_J2", "right": "enc_J1"}
    assert listed.signals.current == {"left": "iq_J1", "right": "iq_J2"}
    drafted = gtau.identify(experiment)
    assert any("columns were assigned" in note.what for note in drafted.notes)
    for name in ("empty", "loaded"):
        polars.read_csv(f"{name}.csv").rename({"enc_J1": "q1", "enc_J2": "q2", "iq_J1": "v1", "iq_J2": "v2"}).write_csv(
            f"{name}.csv"
        )
    result = gtau.identify(["empty.csv", "loaded.csv"], robot="five-bar", payload={"loaded.csv": 1.2})
    assert result.gains == pytest.approx(drafted.gains)
    assert result.gains == pytest.approx([2.5, 4.0], rel=0.01)
    stated: dict[str, Any] = {"robot": "five-bar", "payload": {"loaded.csv": 1.2}}
    for log in (Path("loaded.csv"), "./loaded.csv", Path("loaded.csv").resolve(), "loaded"):
        by_path = gtau.draft(["empty.csv", "loaded.csv"], "five-bar", {log: 1.2})
        assert [run.payload and run.payload.mass for run in by_path.runs] == [None, 1.2]
    checked = gtau.check(["empty.csv", "loaded.csv"], **stated)
    assert [log.run.name for log in checked.logs] == ["empty", "loaded"]
    command = ["check", "empty.csv", "loaded.csv", "--robot", "five-bar", "--payload", "loaded.csv=1.2", "--out", "out"]
    printed = " ".join(CliRunner().invoke(app, command).stdout.partition("written: ")[0].split())
    assert in_python(printed).replace("out/experiment.yaml", "the draft") == " ".join(checked.summary().split())
    monkeypatch.setattr("gtau.estimation.identify.NAMES", ("ml",))
    compared = gtau.compare(["empty.csv", "loaded.csv"], **stated)
    assert compared.rows[0].gains == pytest.approx(result.gains, rel=1e-6)
    assert [note.what for note in compared.notes] == [
        note.what for note in gtau.draft(["empty.csv"], "five-bar").guesses
    ]
    printed = CliRunner().invoke(app, ["compare", *command[1:]])
    assert "no payload is assumed for empty.csv" in " ".join(printed.stdout.split())
    shutil.rmtree("out")
    with pytest.raises(gtau.GtauError, match=r"did you mean gtau\.identify\(logs, robot=\.\.\.\)"):
        gtau.identify(["empty.csv", "loaded.csv"], "five-bar")  # type: ignore[arg-type]
    assert not list(tmp_path.glob("*.yaml"))


def test_sentences_on_logs_speak_python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_tutorial(tmp_path)
    shutil.copy("loaded_1200g.csv", "1.2kg_0.5kg.csv")
    for logs, robot, said in (
        (["empty_1.csv"], None, r"\(robot='ROBOT'\).*gtau\.draft\(\.\.\., columns=\{'position': \.\.\.\}\)"),
        (
            ["empty_1.csv", "1.2kg_0.5kg.csv"],
            "five-bar",
            r"state it by payload=\{'1\.2kg_0\.5kg\.csv': 1\.2\} \(0 for none",
        ),
    ):
        with pytest.raises(gtau.GtauError, match=said) as refused:
            gtau.identify(logs, robot=robot)
        assert "--" not in str(refused.value)
    with pytest.raises(gtau.GtauError, match="the kind of the commands is 'volt'; write 'current' or 'torque'"):
        gtau.draft(["empty_1.csv"], "five-bar", kind="volt")
    torques = gtau.draft(["empty_1.csv"], "five-bar", kind="torque")
    assert torques.signals.kind == "torque"
    guesses = gtau.draft(["empty_1.csv"], "five-bar").guesses
    assert [guess.advice for guess in guesses] == [
        "if they are torques, state gtau.draft(..., kind='torque')",
        "correct this by payload={'LOG': KG} (0 for none)",
    ]


def test_a_stated_payload_against_the_name_is_noted_once(tmp_path: Path) -> None:
    write_tutorial(tmp_path)
    log = tmp_path / "loaded_1200g.csv"
    for mass, said in ((2.0, "loaded_1200g.csv 2 kg, not 1.2"), (0.0, "loaded_1200g.csv 0 kg, not 1.2"), (1.21, "")):
        notes = [guess.text for guess in gtau.draft([log], "five-bar", {log.name: mass}).guesses]
        against = [note for note in notes if note.startswith("payload masses are taken as stated, against the file")]
        assert [note.rpartition(": ")[2] for note in against] == [said] * bool(said)


def test_what_is_returned_is_shown_in_a_line(result: gtau.Result, tmp_path: Path) -> None:
    run = result.data[0]
    shown = {
        r"TorqueError\('left': [\d.]+ % of [\d.]+ N m, raw [\d.]+ %\)": result.validate(run)[0],
        r"TorquesAlongLog\(\d+ samples; largest: left -?[\d.]+ N m at [\d.]+ s, right .*": result.external_torques(run),
        r"Exported\(\S*/five_bar.csv\)": result.export("csv", tmp_path),
        r"Watch\('five-bar': baseline, logs: 0, no alarm\)": gtau.Watch(result),
    }
    for pattern, each in shown.items():
        assert re.fullmatch(pattern, repr(each)), repr(each)


def test_figures(result: gtau.Result, folder: Path) -> None:
    run = result.data[0]
    shown = {
        "robot": gtau.plot(result.robot),
        "run": gtau.plot(run),
        "prediction": gtau.plot(result.predict(run)),
        "result": gtau.plot(result),
        "panel": result.plot(),
        "friction": result.plot.friction(),
        "of left": result.plot.friction("left", run),
        "of a log": result.plot.friction("left", str(folder / "check.csv")),
    }
    assert all(isinstance(figure, Figure) for figure in shown.values())
    assert [axes.get_ylabel() for axes in shown["run"].axes] == ["position, rad or m", "current, A"]
    assert len(shown["panel"].axes) == 3  # gains, and torques and residuals of the joint that fits worst
    assert [len(shown[name].axes) for name in ("friction", "of left", "of a log")] == [2, 1, 1]
    result.save(folder / "saved.json")
    assert len(gtau.load(folder / "saved.json").plot().axes) == 1  # of the gains: there are no runs
    with pytest.raises(gtau.GtauError, match=r"did you mean plot\.torques\('left'\)"):
        result.plot("left")  # type: ignore[arg-type]
    with pytest.raises(gtau.GtauError, match="a Plots has no 'torqes'; did you mean 'torques'"):
        result.plot.torqes()  # type: ignore[attr-defined]
    with pytest.raises(gtau.GtauError, match="an object of type str has no figure; give a result, a prediction"):
        gtau.plot("five-bar")  # type: ignore[arg-type]


def test_the_summary_says_a_cause_once(result: gtau.Result) -> None:
    text = "the 95 % interval is {own}, because the data cannot exclude a torque constant of '{joint}' that falls"
    gains = {
        joint: replace(
            gain,
            verdict=Finding(
                "wide", text=text.replace("{joint}", joint), own=f"+-{k} %", advice="log more", grade=Grade.WEAK
            ),
        )
        for k, (joint, gain) in enumerate(result.drive_gains.items(), 4)
    }
    said = " ".join(result.replaced(drive_gains=gains).summary(verbose=False).split())
    cause = "the data cannot exclude a torque constant of 'left' that falls, and similarly for others; log more"
    assert f"joint left, joint right: {cause}" in said
    assert "the 95 % interval is" not in said


def test_a_run_is_a_table_that_is_read_again(result: gtau.Result) -> None:
    run = result.data[0]
    frame = run.to_frame()
    assert frame.columns == ["t", "qleft", "qright", "vleft", "vright"]
    signals = {"time": "t"} | {
        kind: {joint: f"{letter}{joint}" for joint in run.joints}
        for kind, letter in (("position", "q"), ("current", "v"))
    }
    assert gtau.read_run(frame, signals).command == pytest.approx(run.command)
    assert isinstance(result.predict(run).to_frame(), polars.DataFrame)
    external = result.external_torques(run, frame="0 0 0.1 0 0 0", force_only=True, observer=10.0)
    assert external.wrench is not None
    assert {"external_left", "observed_left"} <= set(external.table.columns)


def test_terms_of_the_equation_of_motion(result: gtau.Result) -> None:
    """Of a robot with loops: they add up to the torques, and C is that of Christoffel's symbols."""
    rng = np.random.default_rng(0)
    home = np.array([joint.home for joint in result.robot.joints if joint.actuated])
    q, qd, qdd = (home + 0.2 * rng.normal(size=(4, 2))), rng.normal(size=(4, 2)), rng.normal(size=(4, 2))
    for payload in (None, {"name": "steel"}):
        M, C, g = result.inertia(q, payload), result.coriolis(q, qd, payload), result.gravity(q, payload)
        tau = (M @ qdd[..., None] + C @ qd[..., None])[..., 0] + g
        friction = result.torques(q, qd, 0 * qd, payload) - ((C @ qd[..., None])[..., 0] + g)
        assert tau + friction == pytest.approx(result.torques(q, qd, qdd, payload), abs=1e-9)
        assert pytest.approx(M.transpose(0, 2, 1), abs=1e-9) == M
        assert (np.linalg.eigvalsh(M) > 0).all()
        h = 1e-6
        rate = (result.inertia(q + h * qd, payload) - result.inertia(q - h * qd, payload)) / (2 * h)
        assert rate == pytest.approx(C + C.transpose(0, 2, 1), abs=1e-6)  # dM/dt - 2 C is skew-symmetric
    assert result.gravity(q[0]).shape == (2,)
    assert result.inertia(q[0]) == pytest.approx(result.inertia(q)[0])
    assert result.coriolis(q[0], qd[0]).shape == (2, 2)


def test_terms_agree_with_pinocchio() -> None:
    pin, robot, rng = pytest.importorskip("pinocchio"), seven_r(), np.random.default_rng(1)
    chi = random_parameters(robot, rng)
    arm, tree = model_of(robot, chi=chi), Pinocchio(robot, chi)
    q, qd = rng.normal(size=(2, 7))
    rotors = np.diag([chi[f"ia_{joint.name}"] for joint in robot.joints])
    M = pin.crba(tree.model, tree.data, q)
    assert arm.inertia(q) == pytest.approx(np.triu(M) + np.triu(M, 1).T + rotors, abs=1e-9)
    assert arm.coriolis(q, qd) == pytest.approx(pin.computeCoriolisMatrix(tree.model, tree.data, q, qd), abs=1e-9)
    assert arm.gravity(q) == pytest.approx(pin.computeGeneralizedGravity(tree.model, tree.data, q), abs=1e-9)


def test_the_design_file_that_a_sentence_shows_is_one(tmp_path: Path) -> None:
    (tmp_path / "design.yaml").write_text(EXAMPLE % "five-bar")
    assert len(gtau.read_design(tmp_path / "design.yaml")[0].payloads) == 2


@pytest.mark.parametrize(
    ("call", "answer"),
    [
        ("gtau.Robot('five-bar')", "did you mean gtau.load_robot('five-bar')?"),
        ("gtau.InverseDynamics('arm.urdf')", "did you mean gtau.load_robot('arm.urdf')?"),
        ("gtau.base_parameters(robot)", "give gtau.InverseDynamics(robot)."),
        ("gtau.identify('five-bar', [run])", "gtau.load_robot('five-bar'), or an experiment file alone."),
        ("gtau.identify([run, run])", "did you mean gtau.identify(gtau.load_robot(...), runs)?"),
        ("gtau.identify(robot, [run], payload={'a': 1.0})", "give their paths, ['empty.csv', 'loaded.csv']."),
        ("gtau.identify(robot, [run], method='iv', consistent=True)", "use method='didim' or ml with consistent=True."),
        ("gtau.excite(robot)", "give a design: task, _ = gtau.read_design('design.yaml')."),
        ("gtau.draft('a.csv')", "give ['empty.csv', 'loaded.csv']."),
        ("gtau.check([run, run])", "did you mean gtau.check(gtau.load_robot(...), runs)?"),
        ("gtau.read_design('five-bar')", f"such as {EXAMPLE % 'five-bar'}."),
        ("gtau.fleet('experiment.yaml')", "give ['experiment.yaml']."),
        ("result.plot.gains(2.4)", "give gains by joint, such as {'left': 2.4}."),
        ("gtau.momentum_observer(result, run, 500.0)", "from 250 Hz on, half its sampling rate; write a lower one."),
        ("robot.plot()", "did you mean gtau.plot(robot)?"),
        ("run.plot()", "did you mean gtau.plot(run)?"),
        ("robot.rnea(q, q, q)", "did you mean gtau.InverseDynamics(robot).torques(q, qd, qdd, parameters)?"),
        ("robot.nq", "did you mean len(robot.actuated)?"),
        ("gtau.InverseDynamics(robot).gravity(q)", "did you mean idm.torques(q, qd, qdd, parameters)?"),
        ("gtau.buildModelFromUrdf('arm.urdf')", "did you mean gtau.load_robot('arm.urdf')?"),
        ("gtau.identify('five-bar', ['a.csv'])", "did you mean gtau.identify(logs, robot='five-bar')?"),
        ("result.crba(q)", "did you mean result.inertia(q)?"),
        ("result.predict(run).plot()", "did you mean gtau.plot(prediction)?"),
        ("result.export('c', 'out', samples=3)", "leave out samples=."),
        ("result['left']", "did you mean result.drive_gains['left']?"),
        ("result['fv_left']", "did you mean result.parameters['fv_left']?"),
        ("result['middle']", "there is no estimate 'middle'; result.to_frame() lists all."),
        ("result.drive_gains.left", "did you mean ['left']?"),
        ("gtau.Payload(name='steel', mass=1.2, x=1)", "choose from center, mass, mass_std, name, parameters."),
        ("gtau.Payload('steel', 1.2)", "write Payload(name=..., mass=..., mass_std=..., parameters=..., center=...)."),
        ("result.drive_gains.lft", "there is no 'lft' here; choose from left, right."),
        ("result.findings", "did you mean result.notes?"),
        ("gtau.Watch(result).update('a.csv')", "give a run: gtau.read_run(log, model.recording.signals)."),
        ("gtau.read_run('a.csv', SIGNALS, payload=1.2)", "did you mean payload={'name': 'load', 'mass': 1.2}?"),
        ("gtau.read_run('a.csv', SIGNALS, payload='steel')", "did you mean payload={'name': 'steel', 'mass': ...}?"),
        ("result.torques(q, q, q, payload='steel')", "did you mean payload={'name': 'steel', 'mass': ...}?"),
    ],
)  # fmt: skip
def test_another_spelling_is_answered_by_the_one_that_works(call: str, answer: str, result: gtau.Result) -> None:
    names = {"gtau": gtau, "robot": result.robot, "run": result.data[0], "result": result, "q": np.zeros((1, 2))}
    with pytest.raises(gtau.GtauError) as refused:
        eval(call, {**names, "SIGNALS": SIGNALS})
    assert str(refused.value).endswith(answer)
    assert re.search(r"^(?!.*Traceback)", str(refused.value))

"""What people write in Python around a result: joints by number, torques at any state, tables in memory, pickles."""

from __future__ import annotations

import pickle
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars
import pytest
from five_bar_logs import Plant, path, write_experiment

import gtau
from gtau.signals.reading.experiment import read_experiment
from gtau.signals.reading.statements import as_payload

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_experiment(tmp_path_factory.mktemp("python"), Plant(noise=0.01)).parent


@pytest.fixture(scope="module")
def result(folder: Path) -> gtau.Result:
    return gtau.identify(folder / "experiment.yaml")


def test_joints_may_be_called_by_numbers(result: gtau.Result) -> None:
    gains = result.replaced(drive_gains={"11": result.drive_gains["left"]}).drive_gains
    assert gains[11] is gains["11"]  # type: ignore[index]
    with pytest.raises(gtau.GtauError, match="there is no '12' here; choose from 11"):
        gains[12]  # type: ignore[index]


def test_a_level_in_per_cent_is_refused(result: gtau.Result) -> None:
    gain = result.drive_gains["left"]
    low, high = gain.interval(0.95)  # type: ignore[misc]
    assert low < gain.value < high  # type: ignore[operator]
    for level in (95, 1.0, 0.0, float("nan")):
        with pytest.raises(gtau.GtauError, match=r"write 0\.95 for 95 %"):
            gain.interval(level)


def test_torques_and_currents_of_the_identified_model(result: gtau.Result) -> None:
    run = Plant(noise=0.0).run("path", seed=5, seconds=4.0)
    q, qd, qdd = path(run.time, seed=5)
    predicted = result.predict(run)
    tau = result.torques(q, qd, qdd)
    assert tau.shape == q.shape
    at = np.searchsorted(run.time, predicted.time - 1e-9)
    rms = np.sqrt(np.mean(predicted.predicted**2, axis=0))
    assert np.all(np.median(np.abs(tau[at] - predicted.predicted), axis=0) < 0.01 * rms)
    gains = [gain.value for gain in result.drive_gains.values()]
    assert result.currents(q, qd, qdd) == pytest.approx(tau / gains)
    heavier = result.torques(q, qd, qdd, {"name": "steel"})
    assert np.abs(heavier - tau).max() > 0.1
    loaded = replace(run, payload=as_payload({"name": "steel"}))
    of_run = result.predict(loaded).predicted
    rms = np.sqrt(np.mean(of_run**2, axis=0))
    assert np.all(np.median(np.abs(heavier[at] - of_run), axis=0) < 0.01 * rms)
    with pytest.raises(gtau.GtauError, match="carries the payload 'lead', whose mass neither"):
        result.torques(q, qd, qdd, {"name": "lead"})
    assert result.torques(q[0], qd[0], qdd[0]) == pytest.approx(result.torques(q[:1], qd[:1], qdd[:1])[0])
    with pytest.raises(gtau.GtauError, match=r"give each as \(N, 2\)"):
        result.torques(q[:, :1], qd, qdd)


def test_what_has_been_used_can_still_be_pickled(result: gtau.Result) -> None:
    q, qd, qdd = (each[:5] for each in path(np.linspace(0.0, 1.0, 5), seed=5))
    before = result.torques(q, qd, qdd)
    again = pickle.loads(pickle.dumps(result))
    assert np.array_equal(again.torques(q, qd, qdd), before)
    model = gtau.InverseDynamics(gtau.load_robot("five-bar"), "inertial")
    model.torques(q, qd, qdd, {"m_left_forearm": 1.0})
    assert pickle.loads(pickle.dumps(model)).parameter_names == model.parameter_names


def test_runs_are_read_from_tables_in_memory(folder: Path) -> None:
    frame = polars.read_csv(folder / "free.csv")
    names = frame.columns
    signals = {"time": names[0]} | {
        kind: dict(zip(("left", "right"), pair, strict=True))
        for kind, pair in (("position", names[1:3]), ("current", names[3:5]))
    }
    numbered = {"time": 1, "position": {"left": 2, "right": 3}, "current": {"left": 4, "right": 5}}
    file = gtau.read_run(folder / "free.csv", signals)
    for table, columns in (
        (frame, signals),
        (frame.lazy(), signals),
        (frame.to_dict(), signals),
        (frame.to_numpy(), numbered),
        (frame.to_numpy(structured=True), signals),
        (_LikePandas(frame), signals),
    ):
        run = gtau.read_run(table, columns)
        for array in ("time", "position", "command"):
            assert getattr(run, array) == pytest.approx(getattr(file, array))
        assert np.array_equal(pickle.loads(pickle.dumps(run)).position, run.position)
    for table, message in (
        ([1, 2, 3], "a log cannot be a list; give the path"),
        (frame.to_numpy()[:, 0], "a log cannot be a ndarray"),
        ({"t": [1.0], "q": [1.0, 2.0]}, "the table cannot be used as a log"),
        (frame.drop(names[0]), f"the table.*'{names[0]}'"),
    ):
        with pytest.raises(gtau.GtauError, match=message):
            gtau.read_run(table, signals)


class _LikePandas:
    """The part of a pandas data frame that is used."""

    def __init__(self, frame: Any) -> None:
        self.columns, self._frame = frame.columns, frame

    def __getitem__(self, name: str) -> np.ndarray:
        return self._frame[name].to_numpy()


@pytest.mark.slow
@pytest.mark.usefixtures("two_estimators")
def test_compare_takes_a_robot_with_runs_and_priors_are_mappings(folder: Path) -> None:
    signals = {"time": "t", "position": {"left": "q1", "right": "q2"}, "current": {"left": "v1", "right": "v2"}}
    steel = {"name": "steel", "mass": 1.2}
    robot = gtau.load_robot("five-bar")
    runs = [gtau.read_run(folder / f"{name}.csv", signals, load) for name, load in (("free", None), ("loaded", steel))]
    expected = read_experiment(folder / "experiment.yaml").expected_gains
    of_file, of_runs = gtau.compare(folder / "experiment.yaml"), gtau.compare(robot, runs, expected)
    for one, other in zip(of_file.rows, of_runs.rows, strict=True):
        assert (one.method, one.outcome) == (other.method, other.outcome)
        assert one.gains is None or one.gains == pytest.approx(other.gains, rel=1e-6)
    refused = gtau.compare(robot, runs).rows[1]  # without prior gains: listed, with the reason
    assert refused.gains is None
    assert "method 'wls' needs a drive gain for every joint" in refused.refusal
    priors = {"m_left": {"value": 1.0, "std": 0.4}}
    same = [gtau.identify(robot, runs, priors=each) for each in (priors, {"m_left": gtau.Prior(value=1.0, std=0.4)})]
    assert same[0].gains == pytest.approx(same[1].gains, rel=1e-12)
    for use in (gtau.identify, gtau.compare):
        with pytest.raises(gtau.GtauError, match="an object of type int cannot be identified; give the path of an exp"):
            use(3)  # type: ignore[arg-type]
        with pytest.raises(gtau.GtauError, match=r"read each log with gtau\.read_run"):
            use(robot, ["free.csv"])  # type: ignore[list-item]
        with pytest.raises(gtau.GtauError, match=r"'prior_gains' names 'lft', .*; did you mean 'left'"):
            use(robot, runs, prior_gains={"lft": 2.4})
        with pytest.raises(gtau.GtauError, match="unknown key 'deviation'"):
            use(robot, runs, priors={"m_left": {"value": 1.0, "deviation": 0.4}})


def test_a_path_in_the_place_of_a_run(result: gtau.Result, folder: Path) -> None:
    assert result.recording is not None
    run = gtau.read_run(folder / "free.csv", result.recording.signals)
    assert result.validate(folder / "free.csv") == result.validate(run)
    with pytest.raises(gtau.GtauError, match=r"no\.csv cannot be read"):
        result.predict("no.csv")
    with pytest.raises(gtau.GtauError, match=r"this takes a run, not a list; read the log with gtau\.read_run"):
        result.predict(["free.csv"])  # type: ignore[arg-type]


def test_what_is_assumed_of_a_payload_is_said(result: gtau.Result, folder: Path, tmp_path: Path) -> None:
    """A path is read as the command line reads it; a name that the model does not know is no silent point mass."""
    assert result.recording is not None
    named = shutil.copy(folder / "check.csv", tmp_path / "check_1200g.csv")
    steel = result.validate(gtau.read_run(named, result.recording.signals, {"name": "steel", "mass": 1.2}))
    with pytest.warns(UserWarning, match=r"payload 'steel' of 1\.2 kg is assumed, from the name of check_1200g"):
        assert result.validate(named) == steel
    other = gtau.read_run(named, result.recording.signals, {"name": "stel", "mass": 1.2})
    with pytest.warns(UserWarning, match=r"'stel' is not a payload of the model \('steel'\), so .* a point mass"):
        prediction = result.predict(other)
    with pytest.warns(UserWarning, match="'stel' is not a payload of the model") as warned:
        result.external_torques(other)
    assert Path(warned[0].filename).name == Path(__file__).name
    assert "'stel' is not a payload of the model" in repr(prediction)
    with pytest.raises(gtau.GtauError, match=r"may mean a payload of 1\.5 or 5 kg; give a run with it"):
        result.predict("loaded_1_5kg.csv")
    with pytest.raises(KeyError, match="the model knows no payload 'stel'; choose from steel"):
        result.payload("stel")


@pytest.mark.slow
def test_type_checkers_see_what_is_offered(tmp_path: Path) -> None:
    names = {
        "identify": "result.Result",
        "weigh": "PayloadEstimate",
        "compare": "EstimatorComparison",
        "excite": "design.Design",
    }
    reveals = "".join(f"reveal_type(gtau.{name})\n" for name in names)
    (tmp_path / "use.py").write_text(f"import gtau\n{reveals}")
    command = [sys.executable, "-m", "mypy", "--config-file", str(ROOT / "pyproject.toml"), str(tmp_path / "use.py")]
    shown = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False).stdout
    for returned in names.values():
        assert re.search(rf'Revealed type is "def \(.*-> .*{returned}', shown), shown

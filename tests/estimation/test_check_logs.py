"""The gate: findings by grade, said alike by check and identify."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from pathlib import Path

import pytest
from five_bar_logs import STEEL, Plant, write_log
from pydantic import TypeAdapter
from typer.testing import CliRunner

import gtau
from gtau.cli.commands import app
from gtau.errors import GtauError
from gtau.estimation.results.conclusions import findings
from gtau.estimation.results.model_file import NoteEntry
from gtau.findings import Finding, Grade, by_severity, note_document
from gtau.report.logs import expectation, findings_table
from gtau.result import check, identify
from gtau.signals.reading.formats import repair

EXPERIMENT = """
robot: five-bar
signals: {time: t, position: {left: q1, right: q2}, current: {left: v1, right: v2}}
runs:
  - log: free.csv
  - {log: loaded.csv, payload: {name: steel, mass: 1.2}}
"""


def test_repairs_are_graded_by_what_they_cost() -> None:
    small, large = (
        repair("stale samples", share, text=f"{1000 * share:.0f} samples are stale") for share in (0.001, 0.04)
    )
    stuck = Finding("refused", text="stuck", advice="record it again", grade=Grade.ERROR)
    assert (small.severity, large.severity) == (Grade.INFORMATION, Grade.WARNING)
    assert list(by_severity([small, large, stuck])) == [Grade.ERROR, Grade.WARNING, Grade.INFORMATION]
    assert by_severity([small, small]) == {Grade.INFORMATION: [small]}


def test_a_note_survives_pickle_json_and_the_name_of_its_log() -> None:
    said = repair("repeated rows", 0.01, text="dropped 2 repeated rows", joints=("a",), time=2.0)
    note = said.from_source("log.csv").from_source("run")
    assert str(note) == "run: log.csv: dropped 2 repeated rows"
    assert pickle.loads(pickle.dumps(note)) == note
    read = TypeAdapter(NoteEntry).validate_json(json.dumps(note_document(note)))
    assert (str(read), read.kind, note_document(read)) == (str(note), "repeated rows", note_document(note))


def test_a_note_of_an_older_file_is_read_by_its_topic() -> None:
    document = {"grade": "information", "kind": "repair", "finding": None, "source": "run", "what": "dropped 2 rows"}
    document |= {"joint": None, "time": None, "share": 0.001, "action": None}
    read = TypeAdapter(NoteEntry).validate_python(document)
    assert (str(read), read.kind, read.severity) == ("run: dropped 2 rows", "repair", Grade.INFORMATION)


def test_what_several_logs_share_is_said_once_and_no_more_than_asked_for() -> None:
    slow = Finding("sampling rate", text="slow", advice="log faster", grade=Grade.WARNING)
    notes = [replace(slow, source=name) for name in ("a", "b")]
    notes.insert(0, Finding("joint at rest", text="rests", grade=Grade.INFORMATION, source="a"))
    first = ("warning", "a, b", "", "slow", "log faster")
    assert findings_table(notes).rows == (first, ("information", "a", "", "rests", ""))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("gate")
    for name, payload, seed in (("free", None, 1), ("loaded", STEEL, 2)):
        write_log(path / f"{name}.csv", Plant(noise=0.01).run(name, 6.0, payload, seed))
    (path / "good.yaml").write_text(EXPERIMENT)
    return path


def damaged(folder: Path, name: str, old: str, new: str) -> Path:
    assert old in EXPERIMENT
    path = folder / f"{name}.yaml"
    path.write_text(EXPERIMENT.replace(old, new))
    return path


def test_every_log_that_is_refused_is_a_finding_in_the_words_of_identify(folder: Path) -> None:
    header, *rows = (folder / "free.csv").read_text().splitlines()
    (folder / "stuck.csv").write_text("\n".join([header, *(row.rsplit(",", 1)[0] + ",0.5" for row in rows)]))
    path = damaged(folder, "stuck", "free.csv", "stuck.csv")
    header, *rows = (folder / "loaded.csv").read_text().splitlines()
    (folder / "back.csv").write_text("\n".join([header, *rows[:1000], *rows[500:]]))
    path.write_text(path.read_text().replace("loaded.csv", "back.csv"))
    checked = check(path)
    with pytest.raises(GtauError) as refused:
        identify(path)
    stops = by_severity(checked.notes)[Grade.ERROR]
    assert str(refused.value) == f"{stops[0]}."
    assert "is stuck at 0.5" in stops[0].what
    assert stops[0].advice.startswith("give the column")
    assert "back.csv, line 1002: time goes back from" in stops[1].what
    assert (checked.worst, checked.logs, checked.preparation) == (Grade.ERROR, (), None)


def test_what_is_wrong_with_all_logs_is_listed_once_with_their_names(folder: Path) -> None:
    path = damaged(folder, "column", "right: v2", "right: v9")
    done = CliRunner().invoke(app, ["check", str(path)])
    assert done.exit_code == 2
    said = " ".join(done.stdout.split())
    assert said.count("there is no column 'v9'; the columns are t, q1, q2, v1, v2") == 1
    assert f"- {folder / 'free.csv'}, {folder / 'loaded.csv'}: there is no column" in said
    assert "1 error to resolve first" in said


def test_joints_faster_than_their_limits_are_found_by_check_and_by_identify(folder: Path) -> None:
    robot = (Path(gtau.__file__).parent / "robots/catalog/five-bar.yaml").read_text()
    speeds = [joint.speed_rms for log in check(folder / "good.yaml").logs for joint in log.joints]
    for limit in (f"{0.9 * min(speeds):.4f}", f"{0.1 * min(speeds):.4f}"):
        (folder / "limited.yaml").write_text(robot.replace("velocity: 6", f"velocity: {limit}"))
        path = damaged(folder, "fast", "five-bar", "limited.yaml")
        checked = check(path)
        assert checked.worst == Grade.WARNING
        limits = [note for note in checked.notes if f"times its limit of {float(limit):.4g} rad/s" in str(note)]
        assert len(limits) >= 2
    assert set(limits) <= set(findings(identify(path)))


def test_the_scale_of_the_gains_is_checked_before_they_are_identified(folder: Path) -> None:
    path = damaged(folder, "scale", ", payload: {name: steel, mass: 1.2}", "")
    (note,) = check(path).notes
    with pytest.raises(GtauError) as refused:
        identify(path)
    assert (note.kind, f"{note}.") == ("scale of the gains", str(refused.value))
    path.write_text(path.read_text() + "prior_gains: {left: 2.5, right: 4}\n")
    (same,) = check(path).notes
    assert same == note
    assert "use method='wls' with prior_gains" in same.advice
    assert check(path, method="wls").notes == ()
    (unknown,) = check(damaged(folder, "unknown", ", mass: 1.2", "")).notes
    assert unknown.severity == Grade.INFORMATION
    assert "gtau payload" in unknown.advice
    assert expectation([unknown]) == "gtau payload can use these logs as they are."


def test_exchanged_columns_are_the_cause_and_not_what_their_gains_suggest(folder: Path) -> None:
    """Of a five-bar; of a UR10e's pairs of neighbours the wrists had shown negative gains, the others nothing."""
    path = damaged(folder, "exchanged", "{left: v1, right: v2}", "{left: v2, right: v1}")
    (note,) = check(path).notes
    assert (note.kind, set(note.joints), note.severity) == ("swapped channels", {"left", "right"}, Grade.WARNING)
    assert "look swapped" in note.what


@pytest.mark.parametrize("method", [None, "ml", "wls", "tls"])
@pytest.mark.parametrize(
    "known",
    [
        "",
        "drives: {left: {torque_constant: 2.7}, right: {torque_constant: 4.2}}\n",
        "priors: {m_left: {value: 1.0, std: 0.1}}\n",
    ],
)
def test_check_refuses_what_identify_refuses_by_the_same_method(folder: Path, known: str, method: str | None) -> None:
    path = damaged(folder, "method", ", payload: {name: steel, mass: 1.2}", "")
    path.write_text(path.read_text() + known)
    arguments = [str(path), *([] if method is None else ["--method", method])]
    checked = CliRunner().invoke(app, ["check", *arguments])
    identified = CliRunner().invoke(app, ["identify", *arguments, "--out", str(folder / "out")])
    said = " ".join(checked.stdout.split())
    refused = method != "wls" or "drives" not in known
    assert (checked.exit_code, identified.exit_code) == ((2, 2) if refused else (0, 3))  # 3: the load is undeclared
    if refused:
        assert " ".join(identified.stderr.split()).removeprefix("gtau: ").rstrip(".") in said
        assert "gtau identify will refuse these logs" in said


def test_the_exit_code_follows_the_worst_grade_and_identify_repeats_the_findings(folder: Path) -> None:
    def code(path: Path) -> int:
        return CliRunner().invoke(app, ["check", str(path), "--json"]).exit_code

    header, *rows = (folder / "free.csv").read_text().splitlines()
    currents = [row.split(",", 3)[3] for row in rows]
    held = [f"{row.rsplit(',', 2)[0]},{currents[k - k % 10]}" for k, row in enumerate(rows)]
    (folder / "held.csv").write_text("\n".join([header, *held]))
    path = damaged(folder, "held", "free.csv", "held.csv")
    assert code(folder / "good.yaml") == 0
    assert code(path) == 3
    assert code(damaged(folder, "missing", "free.csv", "missing.csv")) == 2
    notes = check(path).notes
    (note,) = (note for note in notes if note.kind == "held signal")
    assert "every 10 samples" in note.what
    result = identify(path)
    assert set(notes) <= set(findings(result))
    assert str(note) in " ".join(result.summary(verbose=False).split())

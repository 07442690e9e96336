"""A robot whose base floats, identified from logs of its base's pose, the wrench that holds it, and motor currents."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from floating_logs import AT_HOOK, AT_PLATE, GAINS, HOOK, POSE, Truth, deviations, experiment, simulated

from gtau.errors import GtauError
from gtau.estimation.results.conclusions import headline, reasons
from gtau.findings import Grade
from gtau.result import identify, load
from gtau.signals.run import read_run


@pytest.fixture(scope="module")
def hung() -> Truth:
    return simulated(2)


@pytest.mark.parametrize(("wrench", "yaw"), [(AT_HOOK, 0.0), (AT_PLATE, 0.7)], ids=["hook", "plate"])
def test_gains_from_the_wrench_that_holds_the_base(wrench: str, yaw: float, hung: Truth, tmp_path: Path) -> None:
    path = experiment(tmp_path, f"{{body: trunk, {POSE}, yaw: {yaw}, wrenches: [{wrench}]}}", hung)
    result = identify(path)
    assert tuple(result.drive_gains) == ("1", "2", "3")
    assert result.robot.base == ("trunk_x", "trunk_y", "trunk_z", "trunk_rx", "trunk_ry", "trunk")
    for joint, gain in GAINS.items():
        found = result.drive_gains[joint]
        assert found.value == pytest.approx(gain, rel=0.005)
        assert found.verdict.outcome == Grade.GOOD
        assert dict(result.scale[joint]) == pytest.approx({"wrench on 'trunk'": 1.0})
    z = deviations(result, hung.chi)
    assert len(z) == 46
    assert np.sqrt(np.mean(z**2)) < 1.6
    assert np.abs(z).max() < 4.5
    assert not {name for name in result.friction if "trunk" in name}
    assert result.effects
    drives = [effect for effect in result.effects if not effect.effect.startswith("wrench")]
    assert not {effect.subject for effect in drives if "'trunk" in effect.subject}
    result.save(tmp_path / "model.json")
    again = load(tmp_path / "model.json")
    assert again.gains == pytest.approx([1.0] * 6 + [result.drive_gains[joint].value for joint in GAINS])
    errors = again.validate(read_run(tmp_path / "log.csv", **signals(path)))
    assert len(errors) == 9
    assert max(error.relative for error in errors) < 5


def signals(path: Path) -> dict:
    from gtau.signals.reading.experiment import read_experiment

    described = read_experiment(path)
    return {"signals": described.signals, "units": described.units}


def test_an_arm_at_rest_on_a_force_plate(tmp_path: Path) -> None:
    """Without columns of a pose the base does not move: the plate alone gives the scale, no payload is needed."""
    truth = simulated(3, moving=False)
    result = identify(experiment(tmp_path, f"{{body: trunk, wrenches: [{AT_PLATE}]}}", truth))
    for joint, gain in GAINS.items():
        found = result.drive_gains[joint]
        assert found.value == pytest.approx(gain, rel=0.01)
        assert abs(found.value - gain) < 4 * found.std
    assert not [note for note in map(str, result.notes) if "trunk" in note and "moves" in note]


@pytest.mark.slow
def test_a_wrong_wrench_shows(hung: Truth, tmp_path: Path) -> None:
    """Forces that the robot exerts instead of those that act on it give it a negative mass; moments about elsewhere."""
    columns = hung.columns | {name: -hung.columns[name] for name in ("hx", "hy", "hz", "hmx", "hmy", "hmz")}
    held = f"{{body: trunk, {POSE}, wrenches: [{AT_HOOK}]}}"
    result = identify(experiment(tmp_path, held, Truth(hung.chi, columns)))
    mass = sum(value for name, value in hung.chi.items() if name.startswith("m_"))
    (verdict,) = {gain.verdict for gain in result.drive_gains.values()}
    assert (verdict.outcome, verdict.finding.kind) == (Grade.CONTRADICTORY, "negative mass")
    assert float(verdict.why.split()[-2]) == pytest.approx(-mass, rel=0.05)
    (row,) = reasons(result)
    assert (set(row.joints), row.why) == (set(result.drive_gains), verdict.why)
    result = identify(experiment(tmp_path, held.replace(str(HOOK.tolist()), "[0.3, 0.05, 0]"), hung))
    (verdict,) = {gain.verdict for gain in result.drive_gains.values()}
    assert verdict.outcome == Grade.CONTRADICTORY
    assert verdict.kind == "unexplained base wrench"
    assert "of the moments" in verdict.why
    assert "trunk_" not in str(reasons(result)) + " ".join(map(str, result.notes))
    assert "is known to" not in headline(result).replace("No drive gain is known to 3 %", "")


BASE = f"{{body: trunk, {POSE}, wrenches: [{AT_HOOK}]}}"
REFUSED = [
    ("no wrench", f"{{body: trunk, {POSE}}}", {}, "no measured wrench acts on the base 'trunk' in any run"),
    ("another body", BASE.replace("trunk", "base"), {}, "write 'body: trunk' there"),
    ("tls", BASE, {"method": "tls"}, "method 'tls' does not support floating bases"),
    ("didim", BASE, {"method": "didim"}, "motion is simulated from the currents of motors"),
    ("order of the quaternion", BASE.replace("[qw, qx, qy, qz]", "[q1, qx, qy, qz]"), {}, "has the length"),
    ("twice", BASE.replace("[hx, hy, hz]", "[hx, hy, px]"), {}, "the column 'px' is given twice"),
    (
        "a pose too",
        BASE + "\n  pose: {source: tracker, position: {x: px}}",
        {},
        "a floating one; remove 'pose'",
    ),
    (
        "accelerometer",
        "{body: trunk, accelerometer: {columns: [ax, ay, az]}}",
        {},
        "unknown key 'accelerometer'",
    ),
    ("nothing", "{body: trunk}", {}, "it names no columns; give 'position' and 'quaternion'"),
]


@pytest.mark.parametrize(
    ("base", "options", "sentence"), [case[1:] for case in REFUSED], ids=[case[0] for case in REFUSED]
)
def test_refusals(base: str, options: dict, sentence: str, hung: Truth, tmp_path: Path) -> None:
    with pytest.raises(GtauError) as refused:
        identify(experiment(tmp_path, base, hung), **options)
    assert sentence in str(refused.value)


def test_a_base_wants_columns_and_a_robot_that_floats(hung: Truth, tmp_path: Path) -> None:
    path = experiment(tmp_path, BASE, hung)
    text = path.read_text()
    for changed, sentence in (
        (
            text.replace(f"  base: {BASE}\n", "").replace("units: {base: {length: mm}}\n", ""),
            "'signals' lack its motion",
        ),
        (
            text.replace("robot: arm.yaml", "robot: {file: arm.yaml, base: fixed}"),
            "is fixed; write 'robot: {file: ...,",
        ),
    ):
        path.write_text(changed)
        with pytest.raises(GtauError) as refused:
            identify(path)
        assert sentence in str(refused.value)

"""Inertias of the robot's file held against the data, and taken as priors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from stated_arm import MASSES, chi, plant, robot, torque_run

from gtau.errors import GtauError
from gtau.estimation.diagnostics.inertia_audit import PRIOR_INERTIA, AuditedParameter
from gtau.estimation.regression.priors import inertia_priors
from gtau.report.parameters import inertias_section
from gtau.result import Result, identify, load
from gtau.robots.robot import Robot
from gtau.signals.reading.statements import Payload


def identified(believed: Robot, made: object, seeds: tuple[int, ...] = (1, 2), **options: object) -> Result:
    return identify(believed, [torque_run(made, seed) for seed in seeds], **options)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def true(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return robot(tmp_path_factory.mktemp("true"))


@pytest.fixture(scope="module")
def heavier(true: Robot, tmp_path_factory: pytest.TempPathFactory) -> Result:
    """With a file whose third link is too heavy."""
    return identified(robot(tmp_path_factory.mktemp("heavier"), {"j3": 1.3 * MASSES["j3"]}), plant(true))


def test_a_file_that_is_right_is_not_contradicted(true: Robot) -> None:
    """All parameters are tested together at 5 %: of three sets of logs at most one may have a contradiction."""
    audits = [identified(true, plant(true), (seed, seed + 1)).audit for seed in (1, 3, 5)]
    wrong = [len(audit.of("contradicted")) for audit in audits]
    assert np.count_nonzero(wrong) <= 1
    assert sum(wrong) <= 0.05 * sum(len(audit.parameters) for audit in audits)
    for audit in audits:
        assert len(audit.of("agrees")) >= 8
        assert audit.stated_error < 1.2 * audit.identified_error  # noise that 30 parameters fit is small
        z = [each.z for each in audit.parameters if each.z is not None]
        assert 0.5 < np.sqrt(np.mean(np.square(z))) < 1.5


def test_a_file_is_not_blamed_for_what_drives_do(true: Robot) -> None:
    """Constants that fall by 5 % at twice the rms current: beside that effect the file predicts as well as the data."""
    made = replace(plant(true, noise=0.05), tool="j4")
    free, loaded = made.run(1), made.run(1, {"m": 3.0, "mz": 0.3}, Payload(name="load", mass=3.0))
    rms = np.sqrt(np.mean([np.mean(run.command**2, axis=0) for run in (free, loaded)], axis=0))
    runs = [replace(run, command=run.command * (1 + 0.025 * np.abs(run.command) / rms)) for run in (free, loaded)]
    audit = identify(true, runs).audit
    assert not audit.links
    assert len(audit.of("contradicted")) <= 1
    assert len(audit.of("agrees")) > 10
    assert audit.stated_error < 1.05 * audit.identified_error


def test_the_link_whose_mass_is_wrong_is_named(true: Robot, heavier: Result) -> None:
    result, audit = heavier, heavier.audit
    assert audit.stated_error > 3 * audit.identified_error
    assert [each.name for each in audit.links] == ["j3"]
    assert audit.links[0].error < 1.1 * audit.identified_error
    assert "j3" in {each.link for each in audit.of("contradicted")}
    # the value that the file would have to have
    for each in audit.of("contradicted"):
        k = result.base.names.index(each.name)
        truth = float(result.base.matrix[k] @ [chi(true).get(name, 0.0) for name in result.idm.parameter_names])
        assert abs(each.value - truth) < 5 * each.std
    shown = " ".join(result.summary(verbose=False).split())
    assert "and inertia of these links, in this order (torque error left): j3 (" in shown
    assert "The file's inertias predict the torques to" in " ".join(result.summary().split())
    unknown = [AuditedParameter(f"mx_{k}", "j3", "kg m", "not identifiable", 1.0) for k in range(2)]
    listed = inertias_section(replace(audit, parameters=tuple(unknown)))
    said = "2 base parameters are not identifiable from these motions to better than +-100 % of the link"
    assert f"{said}: mx_0, mx_1" in listed.items[0].points


def test_the_audit_is_in_the_file_of_the_model(heavier: Result, tmp_path: Path) -> None:
    heavier.save(tmp_path / "model.json")
    assert load(tmp_path / "model.json").audit == heavier.audit


@pytest.mark.parametrize("std", [0.02, 0.2])
def test_the_file_gives_the_scale_where_nothing_else_does(true: Robot, tmp_path: Path, std: float) -> None:
    """A file whose links are all 25 % too heavy: so are the gains, known as well as the file is said to be."""
    heavy = robot(tmp_path, {joint: 1.25 * mass for joint, mass in MASSES.items()})
    result = identify(heavy, [plant(true).run(seed) for seed in (1, 2)], prior_inertias=std)
    for gain in result.drive_gains.values():
        assert gain.value == pytest.approx(1.25, rel=0.02)
        assert gain.verdict.finding.kind == "uncertain scale"
        assert 196 * std < gain.half_width < 3 * 100 * std
    assert {source for shares in result.scale.values() for source in shares} == {"the inertias of the robot's file"}


def test_a_file_without_inertias_is_passed_over(true: Robot, tmp_path: Path) -> None:
    bare = robot(tmp_path, inertias=False)
    result = identified(bare, plant(true))
    assert result.audit is None
    assert "Inertias of the robot file" not in result.summary()
    with pytest.raises(GtauError, match="states no inertias, which 'prior_inertias' asks for"):
        identified(bare, plant(true), prior_inertias=0.3)


def test_an_estimator_that_takes_no_priors_says_whose_they_are(true: Robot) -> None:
    with pytest.raises(GtauError, match="'tls' takes no known parameters, and 'prior_inertias' gives some"):
        identify(true, [plant(true).run(1)], method="tls", prior_inertias=0.3)


@pytest.mark.slow
def test_priors_hold_what_is_not_excited_and_leave_the_rest(true: Robot) -> None:
    """Joints 1 and 4 hardly move, behind much noise: half of the parameters are open without the file."""
    quiet = plant(true, (0.01, 0.9, 1.2, 0.01), noise=3.0)
    priors = inertia_priors(true, 0.3)
    free, held = identified(true, quiet), identified(true, quiet, prior_inertias=0.3)
    matrix, names = held.base.matrix, held.idm.parameter_names
    stated = matrix @ [priors[name].value if name in priors else 0.0 for name in names]
    spread = np.linalg.norm(matrix * [priors[name].std if name in priors else 0.0 for name in names], axis=1)
    unknown = matrix @ [float(name not in priors and not name.startswith("off_")) for name in names] != 0
    open_, excited = [], []
    for k, name in enumerate(held.base.names):
        before, after = free.parameters[name], held.parameters[name]
        if unknown[k] or name.startswith("off"):
            continue
        if before.value is None or before.std > 10 * spread[k]:
            open_.append(name)
            assert abs(after.value - stated[k]) < 0.35 * spread[k], name
            assert 0.2 * spread[k] < after.std < 1.1 * spread[k], name
        elif before.std < 0.3 * spread[k]:
            excited.append(name)
            pull = (before.std / spread[k]) ** 2 * abs(before.value - stated[k])
            assert abs(after.value - before.value) < pull + 0.5 * before.std, name
    assert len(open_) >= 6
    assert len(excited) >= 3
    assert "priors with a standard deviation of 30 %" in " ".join(held.summary().split())
    assert not [note for note in held.notes if note.kind == PRIOR_INERTIA]


def test_a_wrong_prior_is_contradicted(true: Robot, tmp_path: Path) -> None:
    wrong = robot(tmp_path, {"j3": 1.3 * MASSES["j3"]})
    result = identified(wrong, plant(true), prior_inertias=0.02)
    found = [note for note in result.notes if note.kind == PRIOR_INERTIA]
    assert any("'j3'" in str(note) for note in found)
    loose = identified(wrong, plant(true), prior_inertias=0.3)
    assert not [note for note in loose.notes if note.kind == PRIOR_INERTIA]


def test_a_known_payload_gives_the_scale_beside_priors(true: Robot) -> None:
    """The file's inertias join in the scale of the gains, and are no reference that tests the payload."""
    from gtau.signals.reading.statements import Payload

    made = replace(plant(true, noise=0.02), gains=np.array([8.0, 8.0, 6.0, 5.0]), tool="j4")
    steel = {"m": 2.0, "mx": 0.1, "mz": 0.2, "xx": 0.04, "yy": 0.05, "zz": 0.02, "xz": -0.01}
    runs = [made.run(1), made.run(2, steel, Payload(name="steel", mass=2.0))]
    result = identify(true, runs, prior_inertias=0.3)
    for gain, value in zip(result.drive_gains.values(), made.gains, strict=True):
        assert abs(gain.value - value) < 4 * gain.std + 1e-3 * value
    assert result.believable


def test_priors_that_alone_give_the_scale_are_held_against_the_data(true: Robot, tmp_path: Path) -> None:
    """Nothing else gives it, but one scale does not fit links of which one is twice as heavy."""
    made = replace(plant(true, noise=0.02), gains=np.array([8.0, 8.0, 6.0, 5.0]))
    for believed, contradicted in ((true, False), (robot(tmp_path, {"j3": 2 * MASSES["j3"]}), True)):
        result = identify(believed, [made.run(1)], prior_inertias=0.02)
        assert any(note.kind == PRIOR_INERTIA for note in result.notes) == contradicted


def test_rounding_in_the_file_is_no_inertia(true: Robot) -> None:
    """Frames that a program turned leave values such as 3e-73, which no prior may have."""
    rounded = tuple((name, 3e-73 if name == "mx_j2" else value) for name, value in true.file.inertias)
    assert inertia_priors(replace(true, file=replace(true.file, inertias=rounded)), 0.3)["mx_j2"].value == 0.0

"""Friction takes energy from the robot in every export, beyond the logged speeds, loads and temperatures too."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
import yaml
from models_to_export import model_of, torques
from propelling_models import COULOMB, CUBIC, LOGGED, VISCOUS, held, propelling, states
from robots_for_tests import ROBOTS, home, tree

from gtau.errors import GtauError
from gtau.export.exported import export_model
from gtau.export.generated import c_files, export_fmu, matlab_files
from gtau.export.mjcf import export as export_mjcf
from gtau.export.urdf import export as export_urdf
from gtau.model.home import load_robot
from gtau.result import load
from gtau.robots.robot import Robot
from gtau.simulation.simulate import Simulation
from gtau.uses.identified import functions, identified

ROUNDING = 1e-9  # W: of terms of 1e3
FIVE_BAR = next(robot for robot in ROBOTS if robot.name == "five-bar")
CASES = [
    pytest.param(tree(), 0.0, False, id="tree"),
    pytest.param(tree(), -0.3, True, id="tree, negative fs and fl"),
    pytest.param(FIVE_BAR, -0.3, True, id="five-bar, negative fs, fl and passive fv"),
    pytest.param(load_robot("staubli-tx40"), -0.3, True, id="coupled motors"),
]


@pytest.mark.parametrize(("robot", "load", "worse"), CASES)
def test_generated_functions(robot: Robot, load: float, worse: bool, rng: np.random.Generator) -> None:
    """Of C, MATLAB and FMU, which are written from them; and what Python predicts is the same."""
    result = propelling(robot, load, worse)
    made, model = functions(identified(result)), identified(result)
    own = not (robot.closures or robot.couplings)
    scaled = 0
    for qd, qdd in zip(*states(result, rng), strict=True):
        friction = made.outputs["friction"](made.home, qd, qdd, model.values).full().ravel()
        power = friction * qd if own else np.array([friction @ qd])
        assert power.min() >= -ROUNDING
        tau = made.outputs["torques"](made.home, qd, qdd, model.values).full().ravel()
        W = made.outputs["regressor"](made.home, qd, qdd, model.values).full().T
        np.testing.assert_allclose(W @ model.values, tau, atol=1e-10 * np.abs(tau).max())
        if robot.name != "five-bar":  # q of the others is their home
            q = made.home[made.actuated]
            expected = torques(model, q[None], qd[None], qdd[None])[0]
            np.testing.assert_allclose(tau, expected, atol=1e-11 * np.abs(expected).max())
        moving = np.abs(qd) > 1e-4 if own else slice(None)
        scaled += bool(np.abs(power[moving]).min() <= ROUNDING)
    assert (scaled > 0) == worse  # some states needed it


def swing(path: Path, speed: float, duration: float = 1.0) -> np.ndarray:
    """Mechanical energy (N,) of a MuJoCo model that swings freely, ctrl = 0, from ``speed`` of all joints."""
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    data.qvel = speed
    energy = []
    for _ in range(round(duration / model.opt.timestep)):
        mujoco.mj_step(model, data)
        energy.append(data.energy.sum())
    return np.array(energy)


@pytest.mark.parametrize("speed", [0.3, 1.3, 4.0])
def test_mjcf_swings_down(speed: float, tmp_path: Path) -> None:
    exported = export_mjcf(propelling(tree()), tmp_path)
    energy = swing(exported.files[0], speed)
    assert np.isfinite(energy).all()
    assert np.diff(energy).max() <= 1e-6 * np.ptp(energy)
    assert "straight line nearest to it within the logged speeds (" in " ".join(exported.notes)
    assert "up to 1.3 rad/s" in exported.files[0].read_text()


def test_a_joint_whose_speed_is_not_logged_is_not_said_to_stand_still(tmp_path: Path) -> None:
    notes = " ".join(export_mjcf(propelling(load_robot("five-bar"), worse=True), tmp_path).notes)
    assert "left_forearm at any speed, as none is logged" in notes
    assert "up to 0 rad/s" not in notes


def test_a_polynomial_that_propels_makes_mujoco_diverge(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is held: the same file with the identified polynomial gains energy."""
    monkeypatch.chdir(tmp_path)  # where MuJoCo writes its log
    (path,) = export_mjcf(propelling(tree()), tmp_path).files
    root = ElementTree.parse(path)
    for joint in root.iter("joint"):
        if joint.get("damping"):
            joint.set("damping", f"{VISCOUS} 0 {CUBIC}")
    root.write(path)
    energy = swing(path, 4.0, 0.2)
    assert not np.isfinite(energy).all() or np.diff(energy).max() > 0.01 * np.ptp(energy)


def test_straight_lines_of_urdf_and_mjcf_are_near_the_friction(tmp_path: Path) -> None:
    result = propelling(tree())
    exported = export_urdf(result, tmp_path)
    speed = np.linspace(0.0, LOGGED, 50)
    friction = np.array([held(each) for each in speed[1:]])
    for element in ElementTree.parse(exported.files[0]).iter("dynamics"):
        viscous, coulomb = (float(element.get(key)) for key in ("damping", "friction"))
        assert viscous >= 0
        assert coulomb >= 0
        assert np.sqrt(np.mean((viscous * speed[1:] + coulomb - friction) ** 2)) < 0.06 * friction.max()
    drives = yaml.safe_load((tmp_path / "tree_drives.yaml").read_text())["joints"]
    assert not any("cubic_friction" in each for each in drives.values())
    assert "up to 1.3 rad/s" in exported.files[0].read_text()


def test_negative_friction_of_bounds_becomes_a_line_too(tmp_path: Path) -> None:
    """Bounds in 'priors' may let consistent friction be negative."""
    exported = export_urdf(propelling(tree(), worse=True), tmp_path)
    for element in ElementTree.parse(exported.files[0]).iter("dynamics"):
        assert float(element.get("damping")) >= 0
        assert float(element.get("friction")) >= 0


def test_files_say_what_is_extrapolated(tmp_path: Path) -> None:
    result = propelling(tree())
    model = identified(result)
    texts = {**c_files(model), **matlab_files(model)}
    for name in ("tree.h", "tree_torques.m", "tree_friction.m"):
        assert re.search(r"1\.3\s+([*%]\s+)?rad/s", texts[name])
        assert "extrapolated" in texts[name]
    for kind in ("yaml", "csv"):
        (path,) = export_model(result, kind, tmp_path).files
        assert "1.3" in path.read_text()
    for kind in ("c", "matlab"):
        notes = " ".join(export_model(result, kind, tmp_path).notes)
        assert "friction is extrapolated beyond the logged speeds along its slope there, or held: " in notes
    assert not export_model(model_of(tree(), terms=False), "c", tmp_path).notes  # straight friction is no news


def test_fmu_takes_energy(tmp_path: Path) -> None:
    fmpy = pytest.importorskip("fmpy")
    pytest.importorskip("pythonfmu3")
    result = propelling(tree())
    path = str(export_fmu(result, tmp_path).files[0])
    assert "1.3 rad/s" in fmpy.read_model_description(path).description
    names, n = [f"qd_{joint}" for joint in result.robot.actuated], len(result.robot.actuated)
    outputs = [f"torque_{joint}" for joint in result.robot.actuated]

    def torque(speed: float) -> np.ndarray:
        found = fmpy.simulate_fmu(path, stop_time=1e-3, step_size=1e-3, output=outputs,
                                  start_values=dict.fromkeys(names, speed))  # fmt: skip
        return np.array([found[name][-1] for name in outputs])

    for speed in (1.0, 3.1):  # torques of speed are friction, odd, and centrifugal, even
        np.testing.assert_allclose((torque(speed) - torque(-speed)) / 2, np.full(n, held(speed)), rtol=1e-9)


def test_predictions_take_energy_at_every_temperature(rng: np.random.Generator) -> None:
    """Friction that falls by temperature ends at none, and does not begin to propel."""
    result = propelling(tree(), -0.3)
    idm, law = result.idm, result.friction_law
    qd, qdd = states(result, rng)
    motion = idm.motion(np.tile(home(tree()), (len(qd), 1)).T, qd.T, qdd.T)
    load = rng.normal(0.0, 200.0, qd.T.shape)
    for above in (-100.0, 0.0, 100.0):
        values = {f"f3_{joint}": CUBIC for joint in result.robot.actuated}
        values |= {f"fl_{joint}": -0.3 for joint in result.robot.actuated}
        values |= {f"fv_{joint}": VISCOUS - 0.4 * np.full(len(qd), above) for joint in result.robot.actuated}
        values |= {f"fs_{joint}": COULOMB - 0.2 * np.full(len(qd), above) for joint in result.robot.actuated}
        assert (law.torques(motion, values, load) * qd.T).min() >= -ROUNDING


def test_friction_that_takes_energy_is_the_fitted_one(rng: np.random.Generator) -> None:
    """Up to the logged speeds for cubic friction, and at any speed for straight one."""
    robot = tree()
    result = propelling(robot, 0.1)
    joints, motions = robot.actuated, np.tile(home(robot), (100, 1))
    values = {f"{kind}_{joint}": value for joint in joints
              for kind, value in (("fv", VISCOUS), ("fs", COULOMB), ("f3", CUBIC), ("fl", 0.1))}  # fmt: skip
    for fastest, cubic in ((LOGGED, CUBIC), (50.0, 0.0)):
        v = rng.uniform(-fastest, fastest, motions.shape).T
        load = rng.normal(0.0, 50.0, v.shape)
        motion = result.idm.motion(motions.T, v, 0 * v)
        values |= {f"f3_{joint}": cubic for joint in joints}
        expected = VISCOUS * v + (COULOMB + 0.1 * np.abs(load)) * np.sign(v) + cubic * v**3
        np.testing.assert_allclose(result.friction_law.torques(motion, values, load), expected, rtol=1e-12)


def test_without_a_logged_speed_cubic_friction_does_not_count() -> None:
    result = propelling(tree()).replaced(logged_speeds={})
    n, first = len(result.robot.actuated), result.robot.actuated[0]
    still = np.zeros((n, 1))
    motion = result.idm.motion(home(tree())[:, None], still + 2.0, still)
    found = result.friction_law.torques(motion, {f"f3_{first}": 5.0, f"fv_{first}": 1.0}, still)
    assert found[:, 0] == pytest.approx([2.0] + [0.0] * (n - 1))


@pytest.mark.parametrize("name", ["fv_left", "fs_left"])
def test_a_simulation_with_friction_that_drives_is_refused(name: str) -> None:
    document = {"robot": "five-bar", "parameters": {name: -0.1}, "drives": {"left": {"gain": 1.0}}, "runs": []}
    with pytest.raises(ValueError, match=f"the friction '{name}' is negative, and would drive the robot"):
        Simulation.model_validate(document)


def test_a_model_with_a_damaged_logged_speed_is_refused(tmp_path: Path) -> None:
    result = propelling(tree())
    path = tmp_path / "model.json"
    result.save(path)
    assert load(path).logged_speeds == result.logged_speeds
    path.write_text(path.read_text().replace("1.3", "-1.3"))
    with pytest.raises(GtauError, match=r"logged_speeds\.\w+: -1.3 is out of range; write a number of at least 0"):
        load(path)

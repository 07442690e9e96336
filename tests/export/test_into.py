"""Models put back into the URDF and MJCF files that the robots came from."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from models_to_export import model_of

import gtau
from gtau.model.home import load_robot
from gtau.model.singularities import random_motion

URDF = """<?xml version="1.0"?>
<!-- the arm of the tests -->
<robot name="arm">
  <material name="blue"><color rgba="0 0 1 1"/></material>
  <link name="base"><visual><geometry><mesh filename="package://arm/base.stl"/></geometry></visual></link>
  <link name="upper">
    <inertial>
      <origin xyz="0.1 0 0" rpy="0 0 0.3"/>
      <mass value="3"/>
      <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>
    </inertial>
    <visual><geometry><mesh filename="package://arm/upper.stl" scale="0.001 0.001 0.001"/></geometry></visual>
  </link>
  <link name="lower"/> <!-- without inertia -->
  <link name="flange">
    <inertial><mass value="0.5"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
  </link>
  <joint name="shoulder" type="revolute">
    <origin xyz="0 0 0.4" rpy="0.2 -0.1 0.3"/><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="10" velocity="2"/><dynamics damping="1" friction="2"/>
    <safety_controller k_velocity="5"/>
  </joint>
  <joint name="elbow" type="continuous">
    <origin xyz="0.5 0 0"/><parent link="upper"/><child link="lower"/><axis xyz="0 0.6 0.8"/>
  </joint>
  <joint name="flange_fixed" type="fixed"><origin xyz="0.2 0.1 0"/><parent link="lower"/><child link="flange"/></joint>
  <gazebo reference="upper"><selfCollide>true</selfCollide></gazebo>
</robot>
<!-- the end -->
"""
MJCF = """<mujoco model="arm">
  <!-- the arm of the tests -->
  <compiler angle="radian" inertiafromgeom="true" meshdir="meshes"/>
  <option gravity="0.3 -0.4 -9.81"/>
  <default><joint damping="7" armature="3"/><default class="small"><geom rgba="1 0 0 1"/></default></default>
  <asset><mesh name="part" file="part.stl"/></asset>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <site name="post" pos="0.2 0.1 0.9"/>
    <body name="upper" pos="0 0 0.4" euler="0.1 0.2 0.3">
      <joint name="shoulder" axis="0 1 0" pos="0.05 0 0.02" ref="0.3" range="-1 1.5"/>
      <geom class="small" type="mesh" mesh="part"/>
      <body name="lower" pos="0.5 0.1 0" quat="0.9 0.1 0.3 0.2">
        <joint name="turn" axis="0 0 1" pos="0 0.1 0"/>
        <joint name="slide" type="slide" axis="0.6 0 0.8" pos="0.1 0 0"/>
        <geom type="box" size="0.1 0.1 0.1"/>
        <site name="hook" pos="0.1 0.2 0"/>
        <body name="flange" pos="0.2 0 0" euler="0.3 0 0"><geom type="sphere" size="0.05"/></body>
      </body>
    </body>
  </worldbody>
  <tendon>
    <spatial name="coil" stiffness="20" rgba="1 0 0 1"><site site="post"/><site site="hook"/></spatial>
  </tendon>
  <actuator>
    <motor name="m1" joint="shoulder" gear="50"/><motor joint="turn"/><position joint="slide" kp="30"/>
  </actuator>
</mujoco>
"""


def without_numbers(root: ElementTree.Element, ignored: tuple[str, ...]) -> list[tuple[str, dict[str, str]]]:
    """Tags and attributes of a file, less what an identification is about."""
    return [(each.tag, dict(each.attrib)) for each in root.iter() if each.tag not in ignored]


def test_a_urdf_keeps_all_but_inertias_and_friction(tmp_path: Path, rng: np.random.Generator) -> None:
    source = tmp_path / "arm.urdf"
    source.write_text(URDF)
    robot = load_robot(source)
    result = model_of(robot, terms=False)
    exported = gtau.export_model(result, "urdf", tmp_path / "out", into=source)
    text = exported.files[0].read_text()
    assert text.startswith('<?xml version="1.0"?>\n<!-- the arm of the tests -->\n<robot name="arm">')
    assert text.endswith("</robot>\n<!-- the end -->\n")
    assert "<!-- without inertia -->" in text
    assert (
        '<link name="base"><visual><geometry><mesh filename="package://arm/base.stl"/></geometry></visual></link>'
        in text
    )
    for line in URDF.splitlines():
        if not any(tag in line for tag in ("inertia", "mass", "dynamics", '<origin xyz="0.1 0 0"', "lower", "elbow")):
            assert line in text.splitlines()
    ignored = ("inertial", "origin", "mass", "inertia", "dynamics")
    one, other = (without_numbers(ElementTree.fromstring(each), ignored) for each in (URDF, text))
    assert one == other
    assert any("flange" in note for note in exported.notes)
    masses = [result.consistency.standard[f"m_{joint}"] for joint in robot.actuated]
    listed = "near the file's: shoulder {:.3g} kg (file 3), elbow {:.3g} kg (file 0.5)".format(*masses)
    assert any(listed in note and "--prior-inertias 0.3" in note for note in exported.notes)
    model = pin.buildModelFromUrdf(str(exported.files[0]))
    data, idm = model.createData(), result.idm
    motion = random_motion(idm, 5, rng)
    inertial = {name: v for name, v in result.consistency.standard.items() if name[:2] not in ("ia", "fv", "fs", "of")}
    tau = idm.full.torques_along(idm.layout, motion, np.array([inertial.get(name, 0) for name in idm.parameter_names]))
    model.gravity.linear = np.array(robot.gravity)
    for k in range(5):
        q = np.array([motion.c[0, k], np.cos(motion.c[1, k]), np.sin(motion.c[1, k])])
        np.testing.assert_allclose(pin.rnea(model, data, q, motion.yd[:, k], motion.ydd[:, k]), tau[:, k], atol=1e-9)
    standard = result.consistency.standard
    np.testing.assert_allclose(model.damping, [standard["fv_shoulder"], standard["fv_elbow"]])
    assert load_robot(exported.files[0]).joints == robot.joints


def test_an_mjcf_keeps_all_but_inertias_friction_and_gears(tmp_path: Path, rng: np.random.Generator) -> None:
    source = tmp_path / "arm.xml"
    source.write_text(MJCF)
    robot = load_robot(source)
    result = model_of(robot, terms=False)
    exported = gtau.export_model(result, "mjcf", tmp_path / "out", into=source)
    text = exported.files[0].read_text()
    assert "<!-- the arm of the tests -->" in text
    for line in MJCF.splitlines():
        if not any(tag in line for tag in ("<body", "<joint", "<motor", "<compiler", "<spatial")):
            assert line in text.splitlines()
    assert 'file="part.stl"' in text
    assert 'ref="0.3"' in text
    notes = " ".join(exported.notes)
    for said in ("inertiafromgeom is now 'auto'", "motors of shoulder, turn", "left unchanged: slide", "flange"):
        assert said in notes
    spec = mujoco.MjSpec.from_string(text)
    for kind in ("geoms", "meshes"):
        for each in list(getattr(spec, kind)):
            spec.delete(each)
    model = spec.compile()
    data, idm = mujoco.MjData(model), result.idm
    assert model.actuator("m1").gear[0] == result.consistency.gains["shoulder"][0]
    motion = random_motion(idm, 5, rng)
    standard = {name: 0.0 if name.startswith("off") else v for name, v in result.consistency.standard.items()}
    tau = idm.full.torques_along(idm.layout, motion, np.array([standard[name] for name in idm.parameter_names]))
    for k in range(5):
        data.qpos, data.qvel, Ma = motion.c[:, k], motion.yd[:, k], np.zeros(3)
        mujoco.mj_forward(model, data)
        mujoco.mj_mulM(model, data, Ma, motion.ydd[:, k].copy())
        found = Ma + data.qfrc_bias - data.qfrc_passive + model.dof_frictionloss * np.sign(data.qvel)
        np.testing.assert_allclose(found, tau[:, k], rtol=1e-8, atol=1e-8)


COMPACT = """<mujoco model="arm"><!-- f\u00fcr --><worldbody><body name="upper" pos="0 0 0.4"><joint name="shoulder"
axis="0 1 0"/><body name="lower" pos="0.5 0.1 0"><joint name="turn"/><inertial pos="0 0 0" mass="1"
diaginertia=".1 .1 .1"/></body><inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/></body></worldbody><actuator
><motor joint="shoulder"/><motor joint="turn"/></actuator></mujoco>"""


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "latin-1"])
@pytest.mark.parametrize(("text", "kind"), [(COMPACT, "mjcf"), (re.sub(r">\s+<", "><", URDF).strip(), "urdf")])
def test_a_file_without_line_breaks_is_edited_like_any(text: str, kind: str, encoding: str, tmp_path: Path) -> None:
    source = tmp_path / f"arm.{'xml' if kind == 'mjcf' else 'urdf'}"
    head = '<?xml version="1.0" encoding="ISO-8859-1"?>' if encoding == "latin-1" else '<?xml version="1.0"?>'
    source.write_bytes((head + text.removeprefix('<?xml version="1.0"?>')).encode(encoding))
    result = model_of(load_robot(source), terms=False)
    exported = gtau.export_model(result, kind, tmp_path / "out", into=source)
    back, identified = load_robot(exported.files[0]), result.consistency.standard
    assert back.joints == result.robot.joints
    inertias = dict(back.file.inertias)
    assert inertias
    for name, value in inertias.items():
        assert value == pytest.approx(identified[name], abs=1e-9)


def test_a_file_in_utf_16_is_refused(tmp_path: Path) -> None:
    source = tmp_path / "arm.urdf"
    source.write_bytes(URDF.replace('"1.0"?', '"1.0" encoding="UTF-16"?').encode("utf-16"))
    with pytest.raises(gtau.GtauError, match="UTF-16 text, which cannot be edited in place; save it as UTF-8"):
        gtau.export_model(model_of(load_robot(source), terms=False), "urdf", tmp_path / "out", into=source)


@pytest.mark.filterwarnings("ignore:compiler attribute")
@pytest.mark.parametrize("changed", ['settotalmass="9"', 'boundmass="8"', 'boundinertia="3"'])
def test_a_file_whose_masses_mujoco_changes_is_refused(changed: str, tmp_path: Path) -> None:
    source = tmp_path / "arm.xml"
    source.write_text(COMPACT.replace("<worldbody>", f"<compiler {changed}/><worldbody>"))
    with pytest.raises(gtau.GtauError, match="takes another mass or inertia of 'upper' than the identified one"):
        gtau.export_model(model_of(load_robot(source), terms=False), "mjcf", tmp_path / "out", into=source)
    assert not (tmp_path / "out").exists()


def test_another_robot_s_file_is_refused(tmp_path: Path) -> None:
    source = tmp_path / "arm.urdf"
    source.write_text(URDF)
    result = model_of(load_robot(source), terms=False)
    with pytest.raises(gtau.GtauError, match="would be overwritten; choose another folder"):
        gtau.export_model(result, "urdf", tmp_path, into=source)
    source.write_text(URDF.replace('xyz="0.5 0 0"', 'xyz="0.6 0 0"'))
    with pytest.raises(gtau.GtauError, match=r"is not the file of the model's robot 'arm': joint 'elbow' is placed"):
        gtau.export_model(result, "urdf", tmp_path / "out", into=source)
    source.write_text(URDF.replace("elbow", "knee"))
    with pytest.raises(gtau.GtauError, match="'elbow' is missing there; give its own file"):
        gtau.export_model(result, "urdf", tmp_path / "out", into=source)
    with pytest.raises(gtau.GtauError, match="is no URDF"):
        gtau.export_model(replace(result), "urdf", tmp_path / "out", into=tmp_path / "arm.xml")

"""Payloads for controllers, read back by parsers of the formats that know nothing of gtau."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

import gtau
from gtau.cli.models import CONTROLLERS, export_bodies
from gtau.errors import GtauError
from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.payload_body import QUANTITIES, UNITS, PayloadBody
from gtau.export.payload import WRITERS
from gtau.robots.parameter import RigidBody

TURN = Rotation.from_euler("ZYX", [0.7, -0.4, 0.2]).as_matrix()
TENSOR = TURN @ np.diag([0.004, 0.011, 0.013]) @ TURN.T
BODY = RigidBody(2.5537, np.array([0.0123, -0.0456, 0.0789]), (TENSOR + TENSOR.T) / 2)
Read = tuple[float, np.ndarray, np.ndarray]


def payload(rigid: RigidBody | None = BODY, unseen: tuple[str, ...] = ()) -> PayloadBody:
    estimates = {
        key: Estimate(key, None if key in unseen or rigid is None else 1.0, None, unit)
        for key, unit in zip(QUANTITIES, UNITS, strict=True)
    }
    return PayloadBody("gripper-2", "loaded.csv", "tool0", estimates, rigid)


def urscript(folder: Path) -> Read:
    """The call is a Python call as well."""
    (line,) = [each for each in (folder / "gripper_2.script").read_text().splitlines() if not each.startswith("#")]
    call = ast.parse(line, mode="eval").body
    assert isinstance(call, ast.Call)
    assert isinstance(call.func, ast.Name)
    assert call.func.id == "set_target_payload"
    m, center, (xx, yy, zz, xy, xz, yz) = (ast.literal_eval(each) for each in call.args)
    return m, np.array(center), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def franka(folder: Path) -> Read:
    effector = json.loads((folder / "gripper_2_endeffector-config.json").read_text())
    load = json.loads((folder / "gripper_2_set_load.json").read_text())
    assert set(load) == {"mass", "center_of_mass", "load_inertia"}
    assert effector["transformation"] == np.eye(4).flatten().tolist()
    assert effector["id"] == "gripper-2"
    keys = (("mass", "mass"), ("centerOfMass", "center_of_mass"), ("inertia", "load_inertia"))
    assert all(effector[one] == load[other] for one, other in keys)
    return load["mass"], np.array(load["center_of_mass"]), np.reshape(load["load_inertia"], (3, 3), order="F")


def krl(folder: Path) -> Read:
    """A structure of KRL: names and numbers or structures, between braces."""
    (line,) = [each for each in (folder / "gripper_2.dat").read_text().splitlines() if not each.startswith(";")]
    text = line.removeprefix("LOAD_DATA[1]=")
    fields = eval(re.sub(r"([A-Z]+) (?=[{\d-])", r'"\1":', text))
    at, J = fields["CM"], fields["J"]
    turn = Rotation.from_euler("ZYX", [at["A"], at["B"], at["C"]], degrees=True).as_matrix()
    tensor = turn @ np.diag([J[axis] for axis in "XYZ"]) @ turn.T
    return fields["M"], np.array([at[axis] for axis in "XYZ"]) / 1000, tensor


def rapid(folder: Path) -> Read:
    text = (folder / "gripper_2.mod").read_text()
    assert re.fullmatch(r"MODULE \w+\n  ! .*\n  PERS loaddata gripper_2:=\[.*\];\nENDMODULE\n", text)
    m, center, (w, x, y, z), ix, iy, iz = json.loads(text[text.index("=") + 1 : text.index(";")])
    turn = Rotation.from_quat([x, y, z, w]).as_matrix()
    return m, np.array(center) / 1000, turn @ np.diag([ix, iy, iz]) @ turn.T


def message(folder: Path) -> Read:
    read = yaml.safe_load((folder / "gripper_2.yaml").read_text())
    assert list(read) == ["m", "com", "ixx", "ixy", "ixz", "iyy", "iyz", "izz"]  # geometry_msgs/Inertia
    xx, xy, xz, yy, yz, zz = (read[f"i{key}"] for key in ("xx", "xy", "xz", "yy", "yz", "zz"))
    return read["m"], np.array(list(read["com"].values())), np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


READERS: dict[str, Callable[[Path], Read]] = {
    "ur": urscript,
    "franka": franka,
    "kuka": krl,
    "abb": rapid,
    "ros": message,
}


@pytest.mark.parametrize("kind", READERS)
def test_what_is_written_is_read_back(kind: str, tmp_path: Path) -> None:
    done = gtau.export_payload(payload(), kind, tmp_path)
    assert all(file.is_file() for file in done.files)
    mass, center, inertia = READERS[kind](tmp_path)
    assert mass == BODY.mass
    assert center == pytest.approx(BODY.center, rel=1e-14)
    assert inertia == pytest.approx(BODY.inertia, abs=1e-7)  # to 2 digits of 0.0001 of its largest entry
    assert "tool0" in done.notes[0]


@pytest.mark.parametrize("kind", READERS)
def test_what_is_not_measured_is_said(kind: str, tmp_path: Path) -> None:
    done = gtau.export_payload(payload(unseen=("Ixx", "Ixy")), kind, tmp_path)
    assert "the motion does not show Ixx, Ixy of 'gripper-2'" in done.notes[1]


def test_every_kind_is_listed_written_and_spelled() -> None:
    assert list(WRITERS) == list(READERS) == CONTROLLERS.split(", ")


def test_a_payload_weighed_twice_has_two_files(tmp_path: Path) -> None:
    heavier = RigidBody(3.0, BODY.center, BODY.inertia)
    done = export_bodies([payload(), payload(heavier)], "ur", tmp_path)
    first, second = (each.files[0].read_text() for each in done)
    assert "(2.5537, [" in first
    assert "(3.0, [" in second


def test_mass_and_centre_have_the_digits_of_their_intervals(tmp_path: Path) -> None:
    known = {"m": 0.043, "cx": 0.0012}
    certain = payload()
    shown = {key: replace(value, std=known.get(key)) for key, value in certain.parameters.items()}
    gtau.export_payload(replace(certain, parameters=shown), "kuka", tmp_path)
    assert "M 2.554,CM {X 12.3,Y -45.6," in (tmp_path / "gripper_2.dat").read_text()


def test_numbers_have_no_exponents(tmp_path: Path) -> None:
    small = RigidBody(2.0, np.array([1e-18, 0.0, -2e-7]), np.diag([1e-5, 2e-5, 2e-5]) + 1e-19)
    for kind in ("ur", "kuka", "abb"):
        (file,) = gtau.export_payload(payload(small), kind, tmp_path).files
        assert not re.search(r"\de[-+]\d|\d{14}", file.read_text())
    _, center, inertia = urscript(tmp_path)
    assert center.tolist() == [0.0, 0.0, -2e-7]
    assert inertia.tolist() == np.diag([1e-5, 2e-5, 2e-5]).tolist()


def test_an_inertia_has_the_digits_of_its_intervals_where_a_body_can_have_it(tmp_path: Path) -> None:
    def written(moments: list[float]) -> np.ndarray:
        of_tensor = {key: replace(value, std=2.5e-4) for key, value in payload().parameters.items() if key[0] == "I"}
        body = payload(RigidBody(2.0, BODY.center, np.diag(moments)))
        shown = replace(body, parameters={**body.parameters, **of_tensor})
        gtau.export_payload(shown, "ur", tmp_path)
        return np.diag(urscript(tmp_path)[2])

    assert written([0.012345678, 0.022345678, 0.030123456]).tolist() == [0.01235, 0.02235, 0.03012]
    # rounded to 5 decimals the first two would be smaller than the third together
    assert written([0.0123449, 0.0123449, 0.0246898]).tolist() == pytest.approx(
        [0.0123449, 0.0123449, 0.0246898], abs=5e-7
    )


@pytest.mark.parametrize(
    ("kind", "rigid", "sentence"),
    [
        ("fanuc", BODY, "no export to 'fanuc'; choose from ur, franka, kuka, abb, ros"),
        ("frank", BODY, "did you mean 'franka'"),
        ("ur", None, "the mass of payload 'gripper-2' is not identifiable, and ur needs one"),
    ],
)
def test_refusals(kind: str, rigid: RigidBody | None, sentence: str, tmp_path: Path) -> None:
    with pytest.raises(GtauError, match=sentence):
        gtau.export_payload(payload(rigid), kind, tmp_path)


@pytest.mark.parametrize("kind", READERS)
def test_a_frame_that_nobody_named_is_refused(kind: str, tmp_path: Path) -> None:
    """Controllers have a frame of their own; a message of ROS goes with any."""
    unnamed = replace(payload(), frame="the frame of 'wrist'", named=False)
    if kind == "ros":
        assert gtau.export_payload(unnamed, kind, tmp_path).files
        return
    with pytest.raises(GtauError, match=r"in the frame of its flange, which need not be the frame of 'wrist'; name it"):
        gtau.export_payload(unnamed, kind, tmp_path)
    assert not list(tmp_path.iterdir())

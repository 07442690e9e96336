"""MDH tables as CSV."""

from __future__ import annotations

import time
from dataclasses import replace
from math import pi
from pathlib import Path

import numpy as np
import pytest

from gtau.errors import GtauError
from gtau.model.home import load_robot
from gtau.robots.readers.native import read_native, write_native
from gtau.robots.robot import Mdh, Robot

HEADER = "j,a,mu,sigma,gamma,b,alpha,d,theta,r\n"

# Tables 1 and 2 of the paper (leg 3 corrected), motors marked by mu
ORTHOGLIDE = (
    "# the paper's tables\na = 0.34\nd4 = 0.31\n"
    + HEADER
    + "11,0,1,1,0,0,0,0,0,q11\n12,0,1,1,pi/2,a,pi/2,0,0,q12 - a\n13,0,1,1,0,a,-pi/2,0,-pi/2,q13 - a\n"
    + "".join(
        f"2{i},1{i},0,0,0,0,-pi/2,0,q2{i},0\n3{i},2{i},0,0,0,0,-pi/2,0,q3{i},0\n"
        f"4{i},3{i},0,0,0,0,0,d4,q4{i},0\n5{i},4{i},0,0,0,0,pi/2,0,q5{i},0\n"
        for i in (1, 2, 3)
    )
)


def csv(text: str, tmp_path: Path) -> Robot:
    (tmp_path / "robot.csv").write_text(text)
    return load_robot(tmp_path / "robot.csv")


def test_the_paper_s_tables(tmp_path: Path) -> None:
    robot, expected = csv(ORTHOGLIDE, tmp_path), load_robot("orthoglide")
    assert robot.actuated == expected.actuated
    ours = {joint.name: joint for joint in robot.joints}
    for joint in expected.joints:
        assert replace(ours[joint.name], home=joint.home, limits=joint.limits) == joint
    # it becomes a robot file, in which closures are added
    write_native(robot, tmp_path / "robot.yaml")
    assert read_native(tmp_path / "robot.yaml") == robot


def test_a_table_with_a_fixed_frame(tmp_path: Path, rng: np.random.Generator) -> None:
    rows = "r,a,theta,j,mu,sigma,gamma,b,alpha,d\n"  # columns in any order
    robot = csv(
        rows + "0.3,0,0.2,base,0,2,0.1,0,pi/2,0.5\nq,base,0,s,1,1,0,0,0,0\n0,s,q - pi,t,1,0,0,0,1.57079632679,0.1\n",
        tmp_path,
    )
    assert [joint.name for joint in robot.joints] == ["s", "t"]
    assert robot.joint("t").placement == Mdh(alpha=pi / 2, d=0.1, theta=-pi)
    base = Mdh(gamma=0.1, alpha=pi / 2, d=0.5, theta=0.2, r=0.3)
    np.testing.assert_allclose(robot.joint("s").placement.rotation, base.rotation, atol=1e-12)
    np.testing.assert_allclose(robot.joint("s").placement.position, base.position, atol=1e-12)


ROW = "1,0,1,0,0,0,0,0,q,0\n"
BAD_CSV: list[tuple[str, str | bytes, str]] = [
    ("empty", "", ": it has no header; write j,a,mu,sigma,gamma,b,alpha,d,theta,r above the joints."),
    ("no joints", HEADER, ": no joint is listed; write a line for each below the header."),
    (
        "column missing",
        HEADER.replace(",mu", ""),
        ": line 1: this is neither a constant ('a = 0.34') nor the header, whi",
    ),
    (
        "standard DH",
        "joint,theta [rad],d,a,alpha [rad]\n1,0,0.3,0,pi/2\n",
        ": line 1: this header of DH parameters lacks j, mu, sigma, gamma, b, alpha, theta, r; gtau reads modified DH,",
    ),
    ("column too many", HEADER.replace("\n", ",q\n"), ": line 1: the header must name each of j, a, mu,"),
    ("column twice", HEADER.replace("\n", ",r\n"), ": line 1: the header must name each of j, a, mu,"),
    ("cell missing", HEADER + "1,0,1,0,0,0,0,0,q\n", ": line 2: it has 9 cells; write 10, as in the header."),
    ("unknown name", HEADER + ROW.replace("1,0,1,0,0", "1,0,1,0,x"), ": line 2, gamma of joint '1': unknown name 'x';"),
    ("code", HEADER + ROW.replace(",q,", ",__import__('os'),"), ": line 2, theta of joint '1':"),
    ("sigma", HEADER + ROW.replace("1,0,1,0", "1,0,1,3"), ": line 2: sigma of joint '1' is 3; write 0 (revolute), 1"),
    ("half a sigma", HEADER + ROW.replace("1,0,1,0", "1,0,1,0.5"), ": line 2: sigma of joint '1' is 0.5; write 0"),
    ("mu", HEADER + ROW.replace("1,0,1,0", "1,0,2,0"), ": line 2: mu of joint '1' is 2; write 1 (driven by a motor)"),
    (
        "antecedent",
        HEADER + ROW.replace("1,0,", "1,7,", 1),
        ": joint '1' has the antecedent '7', which is not a joint of an earlier row",
    ),
    ("twice", HEADER + ROW + ROW, ": robot 'robot': the name '1' is used twice;"),
    (
        "q twice",
        HEADER + "1,0,1,0,0,0,0,0,q,q\n",
        ": line 2, r of joint '1': write the coordinate q plainly, and only in theta",
    ),
    ("q times two", HEADER + "1,0,1,0,0,0,0,0,2*q,0\n", ": line 2, theta of joint '1': write the coordinate q plainly"),
    ("q fixed", HEADER + "1,0,0,2,0,0,0,0,q,0\n", ": line 2, theta of joint '1': write the coordinate q plainly, and"),
    ("only frames", HEADER + "1,0,0,2,0,0,0,0,0,0\n", ": robot 'robot': it has no joints;"),
    ("constant", "a = b\n" + HEADER + ROW, ": line 1, a: unknown name 'b'"),
    ("constant's name", "q = 3\n" + HEADER + ROW, ": line 1: 'q' cannot name a constant;"),
    ("open quote", HEADER + '1,0,1,0,0,0,0,0,"q,0\n', ": this is not a table of comma-separated values ("),
    ("not UTF-8", b"a = 1 # caf\xe9\n", ": the text is not UTF-8; save the file in that encoding."),
    ("huge", "a" * (1 << 20) + "\n", ": the file is larger than 1 MiB;"),
    ("NUL", HEADER + "1,0,1,0,0,0,0,0,q\0,0\n", " is a binary file of another program"),
]


@pytest.mark.parametrize(("text", "sentence"), [case[1:] for case in BAD_CSV], ids=[case[0] for case in BAD_CSV])
def test_bad_csv(text: str | bytes, sentence: str, tmp_path: Path) -> None:
    path = tmp_path / "robot.csv"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    refused(path, sentence)


def refused(path: Path, sentence: str) -> None:
    start = time.process_time()  # of this process: others may keep the machine busy
    with pytest.raises(GtauError) as refusal:
        load_robot(path)
    said = str(refusal.value)
    assert said.startswith(str(path))
    assert sentence in said.removeprefix(str(path))
    assert "\n" not in said
    assert time.process_time() - start < 10.0


@pytest.mark.parametrize("ending", ["csv", "yaml", "urdf", "xml"])
def test_broken_files_are_refused_in_one_sentence(ending: str, tmp_path: Path, rng: np.random.Generator) -> None:
    """Good files with bytes changed, cut or doubled are either read or refused, and nothing else."""
    if ending == "xml":
        pytest.importorskip("mujoco")
    good = {
        "csv": ORTHOGLIDE,
        "yaml": (Path(__file__).parents[2] / "src/gtau/robots/catalog/five-bar.yaml").read_text(),
        "urdf": '<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="revolute"><parent link="a"/>'
        '<child link="b"/><origin xyz="0 0 1"/><axis xyz="0 0 1"/><limit lower="-1" upper="1"/></joint></robot>',
        "xml": '<mujoco><worldbody><body name="a"><joint name="j" axis="0 1 0" range="0 1"/></body></worldbody>'
        "</mujoco>",
    }[ending].encode()
    path = tmp_path / f"robot.{ending}"
    said = []
    for _ in range(60):
        text = bytearray(good)
        for _ in range(rng.integers(1, 4)):
            at = int(rng.integers(len(text)))
            match rng.integers(3):
                case 0:
                    text[at] = rng.choice(list(b"0{}<>:'\"-,#&\n\t\x00\xffax"))
                case 1:
                    del text[at : at + int(rng.integers(1, 30))]
                case _:
                    text[at:at] = text[at : at + int(rng.integers(1, 30))]
        path.write_bytes(bytes(text))
        try:
            load_robot(path)
        except GtauError as refusal:
            said.append(str(refusal))
    assert said
    assert not any("\n" in sentence for sentence in said)

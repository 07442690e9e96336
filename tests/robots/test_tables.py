"""MDH tables as CSV, and OpenSYMORO's parameter files."""

from __future__ import annotations

import time
from dataclasses import replace
from math import pi
from pathlib import Path

import numpy as np
import pytest
from engines import closed_torques, random_parameters

from gtau.errors import GtauError
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.readers.native import read_native, write_native
from gtau.robots.robot import Attachment, Mdh, Robot

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


def par(text: str, tmp_path: Path) -> Robot:
    (tmp_path / "robot.par").write_text(text)
    return load_robot(tmp_path / "robot.par")


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
        ": line 1: this header of DH parameters lacks j, mu, sigma, gamma, b, alpha, theta, r; in gtau's modified",
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


# OpenSYMORO: a turret, a parallelogram of lower arm 2, upper arm 3, crank 5 and rod 6, cut at joint 7, and a wrist 4


def parallelogram() -> str:
    return (
        "(* Robotname = 'parallelogram' *)\nNL = 6\nNJ = 7\nNF = 8\nType = 2\nis_mobile = 0\nL = 0.6\nC = 0.25\n"
        "ant = {0,1,2,3,1,5,6,3}\nsigma = {0,0,0,0,0,0,0,2}\nb = {0,0,0,0,0,0,0,0}\n"
        "d = {0,0.1,L,0.2,0.1,C,L,-C}\nr = {0.5,0,0,0.15,0,0,0,0}\ngamma = {0,0,0,0,0,0,0,0}\n"
        "alpha = {0,pi/2,0,pi/2,pi/2,0,0,0}\nmu = {1,1,0,1,1,0,0,0}\n"
        "theta = {th1,th2,th3,th4 + pi/2,th5,th6,th7,0}\n"
        "XX = {XX1,XX2,XX3,XX4,XX5,XX6}\nG = {0,0,-9.81}\n(* End of definition *)\n"
    )


def test_a_closed_parameter_file(tmp_path: Path, rng: np.random.Generator) -> None:
    robot = par(parallelogram(), tmp_path)
    assert robot.name == "parallelogram"
    assert robot.actuated == ("1", "2", "4", "5")
    assert robot.gravity == (0.0, 0.0, -9.81)
    assert robot.joint("4").placement == Mdh(alpha=pi / 2, d=0.2, theta=pi / 2, r=0.15)
    assert robot.joint("7").parameters == "drive"
    closure = robot.closures[0]
    assert (closure.kind, closure.a, closure.b.body) == ("weld", Attachment("7"), "3")
    assert closure.b.placement.position == pytest.approx([-0.25, 0, 0])
    chi = random_parameters(robot, rng)
    home = np.array([joint.home for joint in robot.joints if joint.actuated])
    q, (qd, qdd) = home + 0.1 * rng.uniform(-1, 1, (5, 4)), rng.normal(size=(2, 5, 4))
    idm = InverseDynamics(robot)
    assert (idm.loops.rows, len(idm.layout.passive)) == (6, 3)
    assert idm.torques(q, qd, qdd, chi) == pytest.approx(closed_torques(robot, chi, q, qd, qdd), rel=1e-9)
    write_native(robot, tmp_path / "robot.yaml")
    assert read_native(tmp_path / "robot.yaml") == robot


def test_an_open_parameter_file_with_symbols(tmp_path: Path) -> None:
    text = (
        "(* Robotname = 'RX90' *)\nNL = 3\nNJ = 3\nNF = 3\nType = 0\nD3 = 0.45\nRL4=0.07\n"
        "Ant = {0,1,2}\nSigma = {0,0,1}\nB = {0,0,0}\nd = {0,0,D3}\nR = {0,0,\n r3 + RL4}\ngamma = {0,0,0}\n"
        "Alpha = {0,pi/2,-1.57079632679}\nMu = {1,1,1}\nTheta = {th1,t2,0}\nG = {0,0,G3}\n"
    )
    robot = par(text, tmp_path)
    assert [joint.kind for joint in robot.joints] == ["revolute", "revolute", "prismatic"]
    assert robot.joint("3").placement == Mdh(alpha=-pi / 2, d=0.45, r=0.07)
    assert robot.notes == (
        "gravity is not given as numbers in the file, so it was taken as 9.80665 m/s2 along -z of the base",
    )


def test_an_open_chain_without_motors_has_them_all(tmp_path: Path) -> None:
    """Files made for kinematics leave mu at 0."""
    text = (
        "NL = 2\nNJ = 2\nNF = 2\nant = {0,1}\nsigma = {0,1}\nb = {0,0}\nd = {0,0}\nr = {0,r2}\n"
        "gamma = {0,0}\nalpha = {0,pi/2}\nmu = {0,0}\ntheta = {th1,0}\nG = {0,0,-9.81}\n"
    )
    robot = par(text, tmp_path)
    assert robot.actuated == ("1", "2")
    assert robot.notes == ("no joint has mu = 1, so all were taken as driven by motors",)


def test_a_frame_on_the_other_side_may_stand_on_such_a_frame(tmp_path: Path) -> None:
    """Two parallelograms on one plate: both loops end on link 8, the second frame at the first."""
    text = (
        "NL = 8\nNJ = 10\nNF = 12\nL3 = 0.6\nL4 = 0.3\nL7 = 0.25\nslope = 0.4\n"
        "ant = {0,1,2,3,4,1,4,3,7,6,8,11}\nsigma = {0,0,0,0,0,0,0,0,0,0,2,2}\n"
        "b = {0,0,0,0,0,L7*cos(slope),0,0,0,0,0,0}\nd = {0,0,L3,L4,0,-L7*sin(slope),L7,0,L4,L3,L7,0}\n"
        "r = {0,0,0,0,0,0,0,0,0,0,0,0}\ngamma = {0,0,0,0,0,0,slope + pi/2,0,0,0,slope + pi/2,0}\n"
        "alpha = {0,pi/2,0,0,pi/2,pi/2,0,0,0,0,0,0}\nmu = {1,1,1,0,1,0,0,0,0,0,0,0}\n"
        "theta = {th1,th2,th3,th4,th5,th6,th7,th8,th9,th10,0,0}\nG = {0,0,-9.81}\n"
    )
    robot = par(text, tmp_path)
    assert [(closure.a.body, closure.b.body) for closure in robot.closures] == [("9", "8"), ("10", "8")]
    assert robot.closures[0].b.placement.position == pytest.approx(robot.closures[1].b.placement.position)
    loops = InverseDynamics(robot).loops
    assert (len(robot.actuated), len(loops.layout.passive)) == (4, 6)


def test_a_loop_that_is_a_truss_is_refused_for_what_it_is(tmp_path: Path) -> None:
    """A file of OpenSYMORO named RX90 ends its loops on the links that they begin on: three pins hold joint 3."""
    text = (
        "NL = 7\nNJ = 9\nNF = 11\nL3 = 0.4\nL4 = 0.5\nL6 = 0.2\nL7 = 0.25\n"
        "ant = {0,1,2,3,4,2,4,7,6,3,3}\nsigma = {0,0,0,0,0,0,0,0,0,2,2}\nb = {0,0,0,0,0,0,0,0,0,0,0}\n"
        "d = {0,0,L3,L4,0,L6,L7,L4,L3,L7,L6}\nr = {0,0,0,0,0,0,0,0,0,0,0}\n"
        "gamma = {0,0,0,0,0,pi/2,pi/2,0,0,pi/2,pi}\nalpha = {0,pi/2,0,0,pi/2,0,0,0,0,0,0}\n"
        "mu = {1,1,1,0,1,0,0,0,0,0,0}\ntheta = {th1,th2,th3,th4,th5,th6,th7,th8,th9,0,0}\nG = {0,0,-9.81}\n"
    )
    with pytest.raises(GtauError, match="4 actuated joints for 3 dof, where the closures hold 3 fixed; mark 1"):
        _ = InverseDynamics(par(text, tmp_path)).loops


def changed(old: str, new: str) -> str:
    assert old in parallelogram()
    return parallelogram().replace(old, new)


BAD_PAR: list[tuple[str, str, str]] = [
    ("empty", "", ": NL is missing; this is not a complete parameter file of OpenSYMORO."),
    ("no number", changed("NL = 6", "NL = six"), ": NL is 'six'; write a number."),
    (
        "counts",
        changed("NF = 8", "NF = 7"),
        ": NL = 6, NJ = 7, NF = 7 do not fit; NF is NL and two for each of the NJ - N",
    ),
    ("huge count", changed("NF = 8", "NF = 99999999"), ": NF is '99999999'; write a number."),
    ("no theta", changed("theta =", "thetas ="), ": theta is missing;"),
    ("short list", changed("gamma = {0,", "gamma = {"), ": gamma has 7 values; write 8, one for each frame."),
    ("no value", changed("L = 0.6\n", ""), ": these symbols have no value: L (d of joint 3); write one"),
    (
        "no values",
        changed("L = 0.6\nC = 0.25\n", ""),
        ": these symbols have no value: L (d of joint 3), C (d of joint 6); write one for each on a line such as 'L = ",
    ),
    (
        "coordinate elsewhere",
        changed("d = {0,0.1,L", "d = {0,0.1,q3"),
        ": these symbols have no value: q3 (d of joint 3); write one",
    ),
    (
        "factor",
        changed("th2", "2*th2"),
        ": theta of joint 2: write the coordinate plainly, as 'th2' or 'th2 + pi/2'.",
    ),
    ("another's coordinate", changed("th2", "th1"), ": these symbols have no value: th1 (theta of joint 2); write"),
    ("sigma", changed("sigma = {0", "sigma = {4"), ": sigma of joint '1' is 4; write 0 (revolute), 1 (prismatic) or 2"),
    ("mu", changed("mu = {1", "mu = {5"), ": mu of joint '1' is 5; write 1 (driven by a motor) or 0 (passive)."),
    ("cut by nothing", changed("0,2}", "0,0}"), ": frame 8 is the other side of a loop; its sigma must be 2."),
    ("cut at a fixed joint", changed("0,0,2}", "0,2,2}"), ": joint 7 cuts a loop and is fixed (sigma 2);"),
    (
        "antecedent after",
        changed("ant = {0,1", "ant = {0,9"),
        ": joint '2' has the antecedent '9', which is not a joint of",
    ),
    (
        "mobile",
        changed("is_mobile = 0", "is_mobile = 1"),
        ": the robot's base moves; only robots on a fixed base are re",
    ),
    ("twice", parallelogram() + "d = {0}\n", ": d is written twice; keep one of them."),
    ("open comment", parallelogram() + "(* x", ": a comment begins with '(*' and does not end with '*)'; close it."),
    (
        "loop too wide",
        changed("C = 0.25", "C = 2.5").replace("C,L,-C", "0.1,L,-C"),
        ": robot 'parallelogram': the loops do not close",
    ),
    ("huge", " " * (1 << 17), ": the file is larger than 64 KiB;"),
    ("many open comments", "(*" * 30000, ": a comment begins with '(*'"),
    ("many lines", "a\n" * 30000, ": NL is missing;"),
    ("many equal signs", "a = {" * 12000, ": NL is missing;"),
    ("many words", "a" * 60000, ": NL is missing;"),
    ("many blanks", "(*" + " " * 60000 + "*)", ": NL is missing;"),
]


@pytest.mark.parametrize(("text", "sentence"), [case[1:] for case in BAD_PAR], ids=[case[0] for case in BAD_PAR])
def test_bad_par(text: str, sentence: str, tmp_path: Path) -> None:
    (tmp_path / "robot.par").write_text(text)
    refused(tmp_path / "robot.par", sentence)


@pytest.mark.parametrize("ending", ["csv", "par", "yaml", "urdf", "xml"])
def test_broken_files_are_refused_in_one_sentence(ending: str, tmp_path: Path, rng: np.random.Generator) -> None:
    """Good files with bytes changed, cut or doubled are either read or refused, and nothing else."""
    if ending == "xml":
        pytest.importorskip("mujoco")
    good = {
        "csv": ORTHOGLIDE,
        "par": parallelogram(),
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

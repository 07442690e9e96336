"""What is possible in a robot file and hardly meant: said, with the line."""

from __future__ import annotations

from pathlib import Path

import pytest

from gtau.documents.markup import line_of, read_xml
from gtau.errors import GtauError
from gtau.robots.readers.read import read_robot

LINK = """<link name="{name}"><inertial><mass value="{mass}"/>
<inertia ixx="{xx}" iyy="1" izz="{zz}" ixy="0" ixz="0" iyz="0"/></inertial></link>
"""
JOINT = """<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{name}"/>
<origin xyz="0.3 0 0" rpy="{rpy}"/><axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
"""


def urdf(tmp_path: Path, a: str = "", b: str = "", rpy: str = "0 0 0", last: str = "revolute") -> Path:
    """A robot of three links in line, one to a joint; ``a`` and ``b`` are the first two."""

    def joint(name: str, parent: str, kind: str = "revolute", turned: str = "0 0 0") -> str:
        return JOINT.format(name=name, parent=parent, kind=kind, rpy=turned)

    joints = joint("a", "base", turned=rpy) + joint("b", "a") + joint("c", "b", last)
    good = LINK.format(name="{}", mass=1, xx=1, zz=1)
    links = f'<link name="base"/>\n{a or good.format("a")}{b or good.format("b")}{good.format("c")}'
    path = tmp_path / "robot.urdf"
    path.write_text(f'<robot name="r">\n{links}{joints}</robot>\n')
    return path


def notes(path: Path) -> str:
    return " | ".join(read_robot(path).notes)


def test_nothing_is_said_of_a_good_file(tmp_path: Path) -> None:
    assert notes(urdf(tmp_path)) == ""


@pytest.mark.parametrize(
    ("link", "said"),
    [
        ({"mass": 1, "xx": 1, "zz": 5}, "link 'a' (line 3) has the principal moments 1, 1, 5 kg m2, the largest above"),
        ({"mass": 1, "xx": -1, "zz": 1}, "link 'a' (line 3) has the principal moments -1, 1, 1 kg m2, one of them neg"),
        ({"mass": 654e3, "xx": 1, "zz": 1}, "link 'a' (line 3) weighs 654,000 kg"),
        ({"mass": -2, "xx": 1, "zz": 1}, "link 'a' (line 3) weighs -2 kg"),
    ],
)
def test_inertias_that_no_body_has(link: dict[str, float], said: str, tmp_path: Path) -> None:
    found = notes(urdf(tmp_path, a=LINK.format(name="a", **link)))
    assert f"physically impossible masses and inertias: {said}" in found
    assert found.endswith("they are identified, not read, but correct them before you use the file elsewhere")


def test_a_plate_and_rounded_digits_are_bodies(tmp_path: Path) -> None:
    assert notes(urdf(tmp_path, a=LINK.format(name="a", mass=1, xx=1, zz=2.01))) == ""


def test_links_without_mass_in_a_driven_chain(tmp_path: Path) -> None:
    """Of a link on a fixed joint the mass counts for the link that carries it."""
    said = "these links have no mass in the file, though a joint moves them: 'b' (line 5);"
    assert said in notes(urdf(tmp_path, b='<link name="b"/>\n'))
    assert notes(urdf(tmp_path, b='<link name="b"/>\n', last="fixed")) == ""


def test_a_urdf_in_degrees_is_refused_with_the_line(tmp_path: Path) -> None:
    with pytest.raises(
        GtauError, match=r"robot.urdf: line 10: rpy of joint 'a' holds 90; angles are in rad, so divide"
    ):
        read_robot(urdf(tmp_path, rpy="0 90 0"))


def test_gears_of_transmissions_are_said(tmp_path: Path) -> None:
    path = urdf(tmp_path)
    transmission = """<transmission name="t"><joint name="a"/><actuator name="m">
<mechanicalReduction>{}</mechanicalReduction></actuator></transmission></robot>"""
    path.write_text(path.read_text().replace("</robot>", transmission.format(100)))
    assert "gear ratios of the file's transmissions: 'a' 100; positions and gains are those at the joint" in notes(path)
    path.write_text(path.read_text().replace(">100<", ">1<"))
    assert notes(path) == ""


MJCF = """<mujoco>{compiler}<worldbody>
<body name="a" {turn}><inertial mass="{mass}" diaginertia="{inertia}" pos="0 0 0"/><joint name="j" {limits}/>
<frame euler="0 0 -45"><geom size="1" mass="1"/></frame></body></worldbody></mujoco>"""
GOOD = {"compiler": "", "turn": "", "limits": "", "mass": "1", "inertia": "1 1 1"}
RADIANS = '<compiler angle="radian"/>'


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({}, ""),
        ({"mass": "0"}, "the masses in the file were not read, as MuJoCo does not compile them (mass and inertia of "
         "moving bodies must be larger than mjMINVAL Element name 'a', id 1, line 2)"),
        ({"inertia": "1 1 3"}, "does not compile them (inertia must satisfy A + B >= C; use 'balanceinertia' to fix "
         "Element name 'a', id 1, line 2)"),
        ({"turn": 'euler="0 1.5708 0"'}, "angles that look like radians, though the file counts in degrees (angle of "
         "<compiler>): euler of body 'a' (line 2: 1.5708); they were taken as degrees"),
        ({"turn": 'axisangle="0 0 1 3.1416"'}, "axisangle of body 'a' (line 2: 3.1416)"),
        ({"limits": 'range="-1.57 90"'}, "range of joint 'j' (line 2: -1.57)"),
        ({"turn": 'euler="0 45 0"', "limits": 'range="-90 90"'}, ""),
        ({"turn": 'euler="0 1.57 0"', "limits": 'range="-3.14 3.14"', "compiler": RADIANS},
         "rounded angles, such as 1.5708, were taken as the multiples of 15 degrees that they stand for, changed by up "
         "to 0.0008 rad: 'a'"),
    ],
)  # fmt: skip
def test_odd_mjcf_files(changed: dict[str, str], said: str, tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    path = tmp_path / "robot.xml"
    path.write_text(MJCF.format(**(GOOD | changed)))
    found = notes(path)
    assert said in found
    assert bool(said) == bool(found)


def test_an_mjcf_in_degrees_that_says_radians_is_refused(tmp_path: Path) -> None:
    """Frames of shapes alone do not matter."""
    pytest.importorskip("mujoco")
    path = tmp_path / "robot.xml"
    path.write_text(MJCF.format(**(GOOD | {"turn": 'euler="0 90 0"', "compiler": RADIANS})))
    with pytest.raises(
        GtauError, match=r"robot.xml: line 2: euler of body 'a' holds 90, but the file counts in radians"
    ):
        read_robot(path)


def test_elements_know_their_lines(tmp_path: Path) -> None:
    path = tmp_path / "a.xml"
    path.write_text("<a>\n\n  <b/><c\n x='1'/>\n  <p:d/></a>")
    root = read_xml(path)
    assert [line_of(element) for element in root.iter()] == [1, 3, 3, 5]


def test_more_parts_than_a_robot_has_are_refused_at_once(tmp_path: Path) -> None:
    """Joints that move are fewer than fixed frames: their equations cost."""
    joint = '<joint name="{0}" type="{1}"><parent link="base"/><child link="{0}"/><axis xyz="0 0 1"/></joint>'
    path = tmp_path / "robot.urdf"
    for count, kind, said in (
        (3000, "fixed", "it holds 3000 joints, and"),
        (300, "continuous", "300 joints that move"),
    ):
        links = "".join(f'<link name="l{k}"/>' for k in range(count))
        joints = "".join(joint.format(f"l{k}", kind) for k in range(count))
        path.write_text(f'<robot name="r"><link name="base"/>{links}{joints}</robot>')
        with pytest.raises(GtauError, match=said):
            read_robot(path)
    table = "j,a,mu,sigma,gamma,b,alpha,d,theta,r\n" + "".join(f"{k},0,1,0,0,0,0,0,q,0\n" for k in range(1, 3000))
    (tmp_path / "robot.csv").write_text(table)
    with pytest.raises(GtauError, match=r"it holds \d+ rows, and at most 2000 are read"):
        read_robot(tmp_path / "robot.csv")

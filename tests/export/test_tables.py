"""Tables for controllers, spreadsheets and papers, and parameters in the orders of other programs."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import polars as pl
import pytest
import yaml
from engines import random_parameters
from models_to_export import model_of
from robots_for_tests import tree

import gtau
from gtau.documents.files import identifier, in_csv, suffixes
from gtau.export.tables import ORDERS, in_latex, in_latex_index, symbol, to_order
from gtau.model.home import load_robot
from gtau.result import Result
from gtau.robots.parameter import parameter_of
from gtau.robots.robot import Robot


@pytest.fixture(scope="module")
def result() -> Result:
    return model_of(load_robot("five-bar"))


def test_yaml_holds_every_number_with_its_unit_and_interval(result: Result, tmp_path: Path) -> None:
    (path,) = gtau.export_model(result, "yaml", tmp_path).files
    document = yaml.safe_load(path.read_text())
    gain = result.drive_gains["left"]
    assert document["drive_gains"]["left"]["value"] == gain.value
    assert document["drive_gains"]["left"]["unit"] == "N m/A"
    np.testing.assert_allclose(document["drive_gains"]["left"]["interval"], gain.interval())
    every = document["base_parameters"] | document["friction"]
    assert set(every) == set(result.parameters) | set(result.friction)
    regrouped = next(name for name in result.parameters if name.endswith("R"))
    assert every[regrouped]["regrouping"] == result.parameters[regrouped].regrouping
    assert document["payload tool 2 of loaded"]["m"]["value"] == 1.5


def test_csv_has_a_row_an_estimate(result: Result, tmp_path: Path) -> None:
    (path,) = gtau.export_model(result, "csv", tmp_path).files
    table = pl.read_csv(path)
    assert table.columns[:8] == ["group", "name", "value", "std", "rel_std", "low", "high", "unit"]
    (gain,) = table.filter((pl.col("group") == "drive gain") & (pl.col("name") == "right")).to_dicts()
    assert gain["value"] == result.drive_gains["right"].value
    count = len(result.drive_gains) + len(result.delays) + len(result.parameters) + len(result.friction) + 7
    count += len(result.logged_speeds)
    assert table.height == count


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("m_11R", r"{m}_{\mathrm{11}R}"),
        ("off_21R", r"\tau_{\mathrm{off}_{\mathrm{21}R}}"),
        ("fv_left_forearm", r"{fv}_{\mathrm{left\_forearm}}"),
    ],
)
def test_symbols_are_the_field_s(name: str, expected: str) -> None:
    assert symbol(parameter_of(name, regrouped=name.endswith("R"))) == expected


@pytest.mark.parametrize("robot", [load_robot("ur10e"), tree()], ids=lambda robot: robot.name)
def test_latex_tables_are_complete(robot: Robot, tmp_path: Path) -> None:
    result = model_of(robot)
    exported = gtau.export_model(result, "latex", tmp_path)
    text = exported.files[0].read_text()
    assert text.count("{") == text.count("}")
    assert text.count("$") % 2 == 0
    for each in result.essential:
        assert symbol(each) in text
    assert ("Denavit--Hartenberg" in text) == (robot.name == "ur10e")
    if latex := shutil.which("pdflatex"):
        page = r"\documentclass{article}\usepackage{booktabs,amsmath,longtable}\begin{document}\input{%s}\end{document}"
        (tmp_path / "page.tex").write_text(page % exported.files[0].name)
        subprocess.run([latex, "-halt-on-error", "page.tex"], cwd=tmp_path, check=True, capture_output=True)


def test_odd_names_are_latex() -> None:
    assert in_latex(r"a_b {x}\^~$") == r"a\_b \{x\}\textbackslash{}\textasciicircum{}\textasciitilde{}\$"
    assert in_latex("épaule Größe 🤖") == "épaule Größe U+1F916"
    assert in_latex_index("arm 1_b") == r"\mathrm{arm\ 1\_b}"
    assert in_latex_index("~") == r"\text{\textasciitilde{}}"


SPACE = 6.0  # pt, between columns
TEXT_WIDTH = 345.0  # pt, of LaTeX's article


def width(formula: str) -> float:
    """Width of a formula in 10 pt type: 4 pt a character of an index, 6 pt of another, 10 pt a sign."""
    indices = "".join(re.findall(r"\\(?:mathrm|text)\{((?:[^{}]|\\[{}])*)\}", formula))
    plain = re.sub(r"\\(?:mathrm|text)\{(?:[^{}]|\\[{}])*\}|\\tau|\\quad|[{}_\\,$\s]", "", formula)
    return 4.0 * len(indices.replace("\\", "")) + 6.0 * len(plain) + 4.0 * len(re.findall(" [+-] ", formula))


def test_latex_numbers_long_names(tmp_path: Path) -> None:
    text = gtau.export_model(model_of(load_robot("ur10e")), "latex", tmp_path).files[0].read_text()
    geometry = text.split(r"\midrule")[1].split(r"\bottomrule")[0]
    assert "joint" not in geometry
    assert r"Joints: 1 shoulder\_pan\_joint, 2 " in text


def renamed(robot: Robot, prefix: str) -> Robot:
    """The robot with other names of its joints."""
    new = {joint.name: prefix + joint.name for joint in robot.joints}
    joints = (
        replace(joint, name=new[joint.name], antecedent=new.get(joint.antecedent, joint.antecedent))
        for joint in robot.joints
    )
    return replace(robot, joints=tuple(joints))


@pytest.mark.parametrize(
    "robot",
    [load_robot("ur10e"), load_robot("orthoglide"), renamed(load_robot("ur10e"), "x" * 80)],
    ids=["ur10e", "orthoglide", "names of 100 characters"],
)
def test_latex_tables_fit_the_page_whatever_the_names(robot: Robot, tmp_path: Path) -> None:
    text = gtau.export_model(model_of(robot), "latex", tmp_path).files[0].read_text()
    *tables, sums = re.findall(r"\\endfoot\n(.*?)\\end{longtable}", text, re.DOTALL)
    assert len(tables) == 2
    for body in tables:
        columns = zip(*(row.split(" & ") for row in body.split("\\\\\n") if row), strict=True)
        assert sum(max(map(width, column)) + SPACE for column in columns) < TEXT_WIDTH
    regrouped = [row.split(" & ") for row in sums.split("\\\\\n") if row]
    assert len(regrouped) == sum(name.endswith("R") for name in model_of(robot).parameters)
    assert max(width(name) for name, _ in regrouped) + 2 * SPACE < 0.4 * TEXT_WIDTH
    # between signs, where LaTeX breaks lines
    assert max(width(term) for _, terms in regrouped for term in re.split(" [+-] ", terms)) < 0.6 * TEXT_WIDTH
    assert (
        max(len(word) for word in re.split(r"\s|\\allowbreak{}", text.split("Standard parameters regrouped")[0])) < 60
    )


def test_a_spreadsheet_computes_no_name() -> None:
    table = pl.DataFrame({"name": ["=1+1", "+a", "-b", "@c", "\t=d", "d=e"], "value": [-1.5, 2.0, -3.0, 0.0, 1.0, 2.0]})
    back = pl.read_csv(in_csv(table).encode())
    assert back["name"].to_list() == ["'=1+1", "'+a", "'-b", "'@c", "'\t=d", "d=e"]
    assert back["value"].to_list() == table["value"].to_list()
    source = Path(gtau.__file__).parent
    writing = [path.relative_to(source) for path in source.rglob("*.py") if ".write_csv(" in path.read_text()]
    assert writing == [Path("documents/files.py")], "every CSV is made by in_csv"


def test_names_alike_are_different_identifiers() -> None:
    assert suffixes(["a-b", "a_b", "a b", "c"]) == {"a-b": "a_b", "a_b": "a_b_2", "a b": "a_b_3", "c": "c"}
    assert suffixes(["a_b", "a_b_2", "a-b"]) == {"a_b": "a_b", "a_b_2": "a_b_2", "a-b": "a_b_3"}
    assert len(identifier("x" * 100)) == 40


def test_orders_are_those_of_the_programs(rng: np.random.Generator) -> None:
    mujoco = pytest.importorskip("mujoco")
    chi = random_parameters(load_robot("five-bar"), rng)
    body = "left"
    xx, xy, xz, yy, yz, zz, mx, my, mz, m = (chi[f"{kind}_{body}"] for kind in
                                             ("xx", "xy", "xz", "yy", "yz", "zz", "mx", "my", "mz", "m"))  # fmt: skip
    inertia = pin.Inertia.FromDynamicParameters(np.array(list(to_order(chi, body, "pinocchio").values())))
    np.testing.assert_allclose(inertia.mass * inertia.lever, [mx, my, mz])
    about_origin = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    np.testing.assert_allclose(inertia.matrix()[3:, 3:], about_origin)

    values = list(to_order(chi, body, "mujoco").values())
    numbers = [" ".join(map(repr, part)) for part in (values[1:4], values[4:])]
    xml = (
        f"<mujoco><worldbody><body><freejoint/><inertial mass='{values[0]!r}' pos='{numbers[0]}' "
        f"fullinertia='{numbers[1]}'/></body></worldbody></mujoco>"
    )
    model = mujoco.MjModel.from_xml_string(xml)
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, model.body_iquat[1])
    R = R.reshape(3, 3)
    c = model.body_ipos[1]
    moved = R @ np.diag(model.body_inertia[1]) @ R.T + m * (c @ c * np.eye(3) - np.outer(c, c))
    np.testing.assert_allclose(moved, about_origin, rtol=1e-8, atol=1e-10)

    drake = to_order(chi, body, "drake")
    assert list(drake) == ["mass", "p_PScm_x", "p_PScm_y", "p_PScm_z", "Gxx", "Gyy", "Gzz", "Gxy", "Gxz", "Gyz"]
    assert drake["Gxz"] * m == pytest.approx(xz)
    matlab = to_order(chi, body, "matlab")
    assert list(matlab.values())[4:] == pytest.approx([xx, yy, zz, yz, xz, xy])
    assert drake["p_PScm_y"] * m == pytest.approx(my)
    assert list(matlab.values())[1:4] == pytest.approx([mx / m, my / m, mz / m])
    symoro = to_order(chi, body, "symoro")
    names = ("XX", "XY", "XZ", "YY", "YZ", "ZZ", "MX", "MY", "MZ", "M", "IA", "FV", "FS")
    assert list(symoro) == list(names)
    drive = [chi[f"{kind}_{body}"] for kind in ("ia", "fv", "fs")]
    assert list(symoro.values()) == pytest.approx([xx, xy, xz, yy, yz, zz, mx, my, mz, m, *drive])


def test_the_files_of_orders_name_bodies_and_parameters(result: Result, tmp_path: Path) -> None:
    exported = gtau.export_model(result, "orders", tmp_path)
    table = pl.read_csv(tmp_path / "five_bar_symoro.csv")
    assert table.columns == ["body", "XX", "XY", "XZ", "YY", "YZ", "ZZ", "MX", "MY", "MZ", "M", "IA", "FV", "FS"]
    assert table["body"].to_list() == list(result.robot.bodies)
    assert table["IA"][0] == result.consistency.standard[f"ia_{result.robot.bodies[0]}"]
    assert len(exported.files) == len(ORDERS)
    with pytest.raises(gtau.GtauError, match="choose from pinocchio"):
        to_order({}, "left", "adams")

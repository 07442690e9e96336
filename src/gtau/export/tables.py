"""Tables of gains, delays, friction, parameters and payloads: CSV, YAML, LaTeX, and the orders of other programs.

Tables in LaTeX are in the field's notation, with the geometry (MDH) and the regroupings.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import pi
from pathlib import Path
from unicodedata import normalize

import numpy as np
import polars as pl

from gtau.documents.files import identifier, in_csv
from gtau.documents.markup import yaml_text
from gtau.errors import GtauError
from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.result import IdentifiedModel, estimates_frame, estimates_table
from gtau.export.consistent import chosen_bodies, consistent_model
from gtau.export.exported import Export, Exported, written
from gtau.export.generated import wrapped
from gtau.findings import Grade
from gtau.model.base_parameters import regrouped
from gtau.robots.parameter import KINDS, Parameter, rigid_body
from gtau.robots.robot import DRIVE, GROUND, INERTIAL, Mdh, Robot

YAML_HEAD = """\
# Identified model of '{robot}', written by 'gtau export'. SI units; std: standard deviation; interval: 95 %.
# Torque of a joint = drive gain x current. Base parameters ending in R stand for the sum under 'regrouping'.
{friction}
"""
SPECIAL = {
    "\\": r"\textbackslash{}",
    "^": r"\textasciicircum{}",
    "~": r"\textasciitilde{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': "''",
} | {sign: rf"\{sign}" for sign in "_#%&${}"}
LETTERS = 0x180  # code beyond the European letters, which LaTeX reads
INDEX = 4  # characters of a joint's name that fit the table of geometry
NAME = 24  # characters that fit the index of a formula; numbers replace all names if one is longer
MDH_HEAD = (
    *("$j$", "$a(j)$", r"$\mu_j$", r"$\sigma_j$", r"$\gamma_j$"),
    *("$b_j$", r"$\alpha_j$", "$d_j$", r"$\theta_j$", "$r_j$"),
)
LATEX_HEAD = r"""% Tables of '{robot}', written by 'gtau export'; \input this file after
% \usepackage{{amsmath,booktabs,longtable}}
"""


def export_csv(result: IdentifiedModel, out: Path) -> Exported:
    """Write ``NAME.csv`` into ``out``: one row per estimate, with value, std, 95 % interval and unit."""
    return Exported(written(out, {f"{identifier(result.robot.name)}.csv": in_csv(estimates_frame(result))}))


def export_yaml(result: IdentifiedModel, out: Path) -> Exported:
    """Write ``NAME.yaml`` into ``out``."""
    groups: dict[str, dict[str, object]] = {}
    for group, estimate in estimates_table(result):
        key = group if group.startswith(("friction", "payload")) else f"{group.replace(' ', '_')}s"
        groups.setdefault(key, {})[estimate.name] = _entry(estimate)
    document = {"robot": result.robot.name, "method": result.method, "runs": list(result.runs), **groups}
    friction = wrapped(" ".join(result.friction_law.range_sentence.split()), "# ")
    head = YAML_HEAD.format(robot=" ".join(result.robot.name.split()), friction=friction)
    return Exported(written(out, {f"{identifier(result.robot.name)}.yaml": head + yaml_text(document)}))


def _entry(estimate: Estimate) -> dict[str, object]:
    entry: dict[str, object] = {"value": estimate.value, "std": estimate.std, "unit": estimate.unit}
    if (interval := estimate.interval()) is not None:
        entry["interval"] = list(interval)
    if estimate.verdict.outcome not in (Grade.GOOD, Grade.GIVEN):
        entry["verdict"] = estimate.verdict.outcome.value
    if estimate.regroups:
        entry["regrouping"] = estimate.regroups
    return entry


def export_latex(result: IdentifiedModel, out: Path) -> Exported:
    r"""Write ``NAME.tex`` into ``out``: tables for ``\input``, which need amsmath, booktabs and longtable."""
    robot, notes = result.robot, []
    parts = [LATEX_HEAD.format(robot=" ".join(robot.name.split()))]
    if all(isinstance(joint.placement, Mdh) for joint in robot.joints):
        parts.append(_geometry(robot))
    else:
        notes.append("the robot is not described by MDH parameters, so there is no table of its geometry")
    names = list(dict.fromkeys((*robot.bodies, *(payload.name for payload in result.payloads))))
    label = _labels(names, NAME)
    if list(label.values()) != names:
        parts.append(f"In formulas numbers stand for names: {_legend(label)}.\n")
    parts += [_parameters(result, label), _regroupings(result, label)]
    return Exported(written(out, {f"{identifier(robot.name)}.tex": "\n".join(parts)}), tuple(notes))


def _labels(names: Sequence[str], longest: int) -> dict[str, str]:
    brief = all(len(name) <= longest for name in names)
    return {name: name if brief else str(number) for number, name in enumerate(names, start=1)}


def _legend(label: Mapping[str, str]) -> str:
    """List the names behind numbers; a line may break within long ones."""
    entries = []
    for name, number in label.items():
        parts = re.findall(".{1,8}", name) if len(name) > NAME else [name]
        entries.append(f"{number} " + r"\allowbreak{}".join(map(in_latex, parts)))
    return ", ".join(entries)


def symbol(name: Parameter, label: Mapping[str, str] | None = None) -> str:
    """Write a parameter's name in the field's notation, with bodies called by their ``label``."""
    subscript = in_latex_index((label or {}).get(name.body, name.body)) + ("R" if name.regrouped else "")
    if name.kind == "off":
        return rf"\tau_{{\mathrm{{off}}_{{{subscript}}}}}"
    return rf"{{{KINDS[name.kind].latex or in_latex(name.kind)}}}_{{{subscript}}}"


def _number(value: float | None, digits: int = 4) -> str:
    if value is None:
        return "--"
    mantissa, _, exponent = f"{value:.{digits}g}".partition("e")
    return f"${mantissa} \\times 10^{{{int(exponent)}}}$" if exponent else f"${mantissa}$"


def _table(columns: str, head: Sequence[str], lines: Iterable[Sequence[str]], caption: str) -> str:
    body = " \\\\\n".join(" & ".join(line) for line in lines)
    top = f"\\toprule\n{' & '.join(head)} \\\\\n\\midrule\n"
    return (
        f"{{\\small\n\\setlength{{\\tabcolsep}}{{3pt}}\n\\begin{{longtable}}{{{columns}}}\n"
        f"\\caption{{{caption}}} \\\\\n{top}\\endfirsthead\n{top}\\endhead\n\\bottomrule\n\\endfoot\n"
        f"{body} \\\\\n\\end{{longtable}}}}\n"
    )


def _angle(value: float) -> str:
    for part in (1, 2, 3, 4, 6):
        multiple = value * part / pi
        if abs(multiple - round(multiple)) < 1e-9:
            number = round(multiple)
            size = "" if abs(number) == 1 else str(abs(number))
            over = f"/{part}" if part > 1 else ""
            return "0" if number == 0 else f"${'-' if number < 0 else ''}{size}\\pi{over}$"
    return _number(value)


def _sum(variable: str, constant: str) -> str:
    number = constant.strip("$")
    return f"${variable} {number.replace('-', '- ')}$" if number.startswith("-") else f"${variable} + {number}$"


def _geometry(robot: Robot) -> str:
    names = [joint.name for joint in robot.joints]
    label = _labels(names, INDEX)
    lines = []
    for joint in robot.joints:
        at = joint.placement
        assert isinstance(at, Mdh)
        variable = f"q_{{{in_latex_index(label[joint.name])}}}"
        theta, r = _angle(at.theta), _number(at.r)
        if joint.turns:
            theta = f"${variable}$" if theta == "0" else _sum(variable, theta)
        else:
            r = f"${variable}$" if not at.r else _sum(variable, r)
        antecedent = "0" if joint.antecedent == GROUND else in_latex(label[joint.antecedent])
        flags = (str(int(joint.actuated)), str(int(not joint.turns)))
        placed = (_angle(at.gamma), _number(at.b), _angle(at.alpha), _number(at.d), theta, r)
        lines.append((in_latex(label[joint.name]), antecedent, *flags, *placed))
    caption = f"Modified Denavit--Hartenberg parameters of {in_latex(robot.name)} (m, rad)."
    if list(label.values()) != names:
        caption += f" Joints: {_legend(label)}."
    return _table("cccccccccc", MDH_HEAD, lines, caption)


def _parameters(result: IdentifiedModel, label: Mapping[str, str]) -> str:
    """Tabulate drive gains and essential parameters with relative standard deviations, as in the paper's Table 3."""
    index = {name: in_latex_index(number) for name, number in label.items()}
    lines = [_line(rf"g_{{\tau\,{index[joint]}}}", gain) for joint, gain in result.drive_gains.items()]
    lines += [_line(symbol(name, label), value) for name, value in {**result.essential, **result.friction}.items()]
    for payload in result.payloads:
        if "m" in payload.parameters:
            lines.append(_line(rf"m_{{{index[payload.name]}}}", payload.parameters["m"]))
    head = ("Par.", "Val.", r"$\hat\sigma$", r"$\%\hat\sigma$", "Unit")
    return _table("lrrrl", head, lines, f"Drive gains and essential parameters of {in_latex(result.robot.name)}.")


def _line(name: str, estimate: Estimate) -> tuple[str, ...]:
    per_cent = estimate.rel_std
    relative = "--" if per_cent is None else f"{per_cent:.2f}" if per_cent < 1000 else "$> 1000$"
    words = estimate.unit if " per " in estimate.unit else estimate.unit.replace(" ", r"\,")
    unit = re.sub("(?<=[a-z])[23]", r"$^\g<0>$", words)
    return f"${name}$", _number(estimate.value), _number(estimate.std, 2), relative, unit


def _regroupings(result: IdentifiedModel, label: Mapping[str, str]) -> str:
    """Tabulate the sum that each regrouped base parameter stands for; LaTeX breaks the line before a sign."""
    sums = regrouped(result.base, result.idm.parameter_names).items()
    lines = [(f"${symbol(name, label)}$", f"${_sum_of(terms, label)}$") for name, terms in sums if len(terms) > 1]
    if not lines:
        return ""
    caption = f"Standard parameters regrouped in base parameters of {in_latex(result.robot.name)}."
    return _table(r"lp{0.6\textwidth}", ("Par.", "Sum"), lines, caption)


def _sum_of(terms: Mapping[Parameter, float], label: Mapping[str, str]) -> str:
    signed = []
    for name, factor in terms.items():
        size = rf"{abs(factor):.5g}\, ".removeprefix(r"1\, ")
        signed.append(f"{'-' if factor < 0 else '+'} {size}{symbol(name, label)}")
    return " ".join(signed).removeprefix("+ ")


def in_latex(text: str) -> str:
    """Write a text so that LaTeX prints it, what no common font has as ``U+1F916``."""
    return "".join(
        SPECIAL.get(character, character if ord(character) < LETTERS else f"U+{ord(character):04X}")
        for character in normalize("NFC", text)
    )


def in_latex_index(name: str) -> str:
    """Write a name as an upright index of a formula."""
    if re.fullmatch(r"[\w .:-]*", name, flags=re.ASCII):
        return r"\mathrm{" + in_latex(name).replace(" ", r"\ ") + "}"
    return r"\text{" + in_latex(name) + "}"  # accents and some signs are for text alone


@dataclass(frozen=True)
class Order:
    """Parameters of a body in a program: their ``names`` in its order, and the ``kinds`` of these.

    Kinds are named as gtau's parameters, with inertia about the origin, or ``x y z`` (centre of mass), ``xx/c``
    (inertia about it) and ``xx/m`` (about the origin, over the mass). All are in gtau's frame of the link: for another
    frame move them by :meth:`gtau.robots.parameter.RigidBody.seen_from`. Products of inertia are entries of the tensor
    (``xy = -int x y dm``) in all programs.
    """

    names: str
    kinds: str
    explained: str


ORDERS = {
    "pinocchio": Order(
        "m mcx mcy mcz Ixx Ixy Iyy Ixz Iyz Izz",
        "m mx my mz xx xy yy xz yz zz",
        "Inertia.toDynamicParameters: first moments, inertia about the joint frame's origin",
    ),
    "mujoco": Order(
        "mass ipos_x ipos_y ipos_z fullinertia_xx fullinertia_yy fullinertia_zz "
        "fullinertia_xy fullinertia_xz fullinertia_yz",
        "m x y z xx/c yy/c zz/c xy/c xz/c yz/c",
        "<inertial mass pos fullinertia>: inertia about the centre of mass, in axes of the body",
    ),
    "drake": Order(
        "mass p_PScm_x p_PScm_y p_PScm_z Gxx Gyy Gzz Gxy Gxz Gyz",
        "m x y z xx/m yy/m zz/m xy/m xz/m yz/m",
        "SpatialInertia(mass, p_PScm_E, UnitInertia G_SP_E): inertia about the origin over mass, m2",
    ),
    "matlab": Order(
        "Mass CenterOfMass_x CenterOfMass_y CenterOfMass_z Ixx Iyy Izz Iyz Ixz Ixy",
        "m x y z xx yy zz yz xz xy",
        "rigidBody Mass, CenterOfMass and Inertia of rigidBodyTree: inertia about the body frame's origin",
    ),
    "symoro": Order(
        "XX XY XZ YY YZ ZZ MX MY MZ M IA FV FS",
        "xx xy xz yy yz zz mx my mz m ia fv fs",
        "standard parameters of Khalil and Kleinfinger, at the frame's origin; IA, FV and FS follow",
    ),
}


def export_orders(result: IdentifiedModel, out: Path) -> Exported:
    """Write ``NAME_PROGRAM.csv`` for each program: a row per body, a column per parameter, SI units; GtauError."""
    model, robot = consistent_model(result, "parameter orders"), result.robot
    texts = {}
    for program in ORDERS:
        rows = [{"body": body, **to_order(model.values, body, program)} for body in robot.bodies]
        texts[f"{identifier(robot.name)}_{program}.csv"] = in_csv(pl.DataFrame(rows))
    notes = [*chosen_bodies(model), *(f"{program}: {order.explained}" for program, order in ORDERS.items())]
    notes.append("all in the frames of gtau's links: a joint's frame, after its motion")
    if robot.closures:
        notes.append("the tables hold bodies alone: a tree of them is not the robot before its loops are closed")
    return Exported(written(out, texts), tuple(notes))


def to_order(chi: Mapping[str, float], body: str, program: str) -> dict[str, float]:
    """Arrange parameters of a body, a joint or platform, by the names and in the order of a program of ``ORDERS``.

    ``chi`` are standard parameters by gtau's names (``xx_3`` .. ``m_3``), SI units; those missing are zero. Raises
    GtauError where the body has no mass and the program gives a centre of mass.
    """
    if program not in ORDERS:
        raise GtauError(f"there is no parameter order of '{program}'; choose from {', '.join(ORDERS)}.")
    names, kinds = ORDERS[program].names.split(), ORDERS[program].kinds.split()
    values = {kind: float(chi.get(Parameter(kind, body), 0.0)) for kind in (*INERTIAL, *DRIVE)}
    if "x" in kinds and values["m"]:
        rigid = rigid_body(chi, body)
        values |= dict(zip("xyz", map(float, rigid.center), strict=True))
        upper = np.triu_indices(3)
        for kind, central, about_origin in zip(INERTIAL, rigid.inertia[upper], rigid.about_origin[upper], strict=False):
            values |= {f"{kind}/c": float(central), f"{kind}/m": float(about_origin / rigid.mass)}
    elif "x" in kinds and any(values[kind] for kind in INERTIAL):
        raise GtauError(
            f"body '{body}' has inertia but no mass, which {program} cannot hold; identify with --consistent."
        )
    return {name: values.get(kind, 0.0) for name, kind in zip(names, kinds, strict=True)}


EXPORTS = {
    "yaml": Export(export_yaml, floating=True),
    "csv": Export(export_csv, floating=True),
    "latex": Export(export_latex),
    "orders": Export(export_orders),
}

"""Tables of gains, delays, friction, base parameters and payloads: in CSV, YAML and LaTeX.

Those in LaTeX are in the field's notation, with the geometry (MDH) and the regroupings.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from math import pi
from pathlib import Path
from types import MappingProxyType
from unicodedata import normalize

from gtau.documents.files import identifier, in_csv
from gtau.documents.yaml_document import yaml_text
from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.result import Result
from gtau.estimation.results.table import estimates_table
from gtau.export.exported import Export, Exported, written
from gtau.robots.parameter import Parameter, parameter_of
from gtau.robots.robot import Mdh, Robot

YAML_HEAD = """\
# Identified model of '{robot}', written by 'gtau export'. SI units; std: standard deviation; interval: 95 %.
# Torque of a joint = drive gain x current. Base parameters ending in R stand for the sum under 'regrouping'.
{friction}
"""
SYMBOLS = {"ia": "ia", "fv": "fv", "fs": "fs", "f3": "f_3", "f0": "f_0", "fl": r"f_{\ell}"}
UNITS = {"kg m2": r"kg\,m$^2$", "kg m": r"kg\,m", "N m": r"N\,m", "N m s/rad": r"N\,m\,s/rad", "N s/m": r"N\,s/m"}
SPECIAL = {
    "\\": r"\textbackslash{}",
    "^": r"\textasciicircum{}",
    "~": r"\textasciitilde{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': "''",
    "ß": r"\ss{}",
    "æ": r"\ae{}",
    "Æ": r"\AE{}",
    "ø": r"\o{}",
    "Ø": r"\O{}",
    "ł": r"\l{}",
    "Ł": r"\L{}",
} | {sign: rf"\{sign}" for sign in "_#%&${}"}
ACCENTS = {"\u0300": "`", "\u0301": "'", "\u0302": "^", "\u0303": "~", "\u0308": '"', "\u030a": "r", "\u0327": "c"}
ACCENTS |= {"\u030c": "v", "\u0306": "u", "\u0304": "=", "\u0307": ".", "\u030b": "H", "\u0328": "k"}
SPACE = 6.0  # pt, between columns
TEXT_WIDTH = 345.0  # pt, of LaTeX's article
NUMBER_WIDTH = 55.0  # pt: number of an equation, "=", indent and what parts them
INDEX = 4  # characters of a joint's name that fit the table of geometry
NAME = 24  # characters that fit as an index of a formula; where a name has more, numbers stand for all
LATEX_HEAD = r"""% Tables of '{robot}', written by 'gtau export'; \input this file after
% \usepackage{{amsmath,booktabs,longtable}}
"""


def export_csv(result: Result, out: Path) -> Exported:
    """Write ``NAME.csv`` into ``out``: one row per estimate, with value, std, 95 % interval and unit."""
    return Exported(written(out, {f"{identifier(result.robot.name)}.csv": in_csv(result.to_frame())}))


def export_yaml(result: Result, out: Path) -> Exported:
    """Write ``NAME.yaml`` into ``out``."""
    groups: dict[str, dict[str, object]] = {}
    for row in estimates_table(result):
        groups.setdefault(_key(row.group), {})[row.estimate.name] = _entry(row.estimate)
    document = {"robot": result.robot.name, "method": result.method, "runs": list(result.runs), **groups}
    text = yaml_text(document)
    friction = textwrap.fill(
        " ".join(result.friction_law.range_sentence.split()), 116, initial_indent="# ", subsequent_indent="# "
    )
    head = YAML_HEAD.format(robot=" ".join(result.robot.name.split()), friction=friction)
    return Exported(written(out, {f"{identifier(result.robot.name)}.yaml": head + text}))


def _key(group: str) -> str:
    return group if group in ("friction",) or group.startswith("payload") else f"{group.replace(' ', '_')}s"


def _entry(estimate: Estimate) -> dict[str, object]:
    entry: dict[str, object] = {"value": estimate.value, "std": estimate.std, "unit": estimate.unit}
    if (interval := estimate.interval()) is not None:
        entry["interval"] = list(interval)
    if estimate.verdict.outcome.value not in ("good", "given"):
        entry["verdict"] = estimate.verdict.outcome.value
    if estimate.regrouping not in ("", estimate.name):
        entry["regrouping"] = estimate.regrouping
    return entry


def export_latex(result: Result, out: Path) -> Exported:
    r"""Write ``NAME.tex`` into ``out``: tables for ``\input``, which need amsmath, booktabs and longtable."""
    parts = [LATEX_HEAD.format(robot=" ".join(result.robot.name.split()))]
    notes = []
    if all(isinstance(joint.placement, Mdh) for joint in result.robot.joints):
        parts.append(_geometry(result.robot))
    else:
        notes.append("the robot is not described by MDH parameters, so there is no table of its geometry")
    names = list(dict.fromkeys((*result.robot.bodies, *(payload.name for payload in result.payloads))))
    label = _labels(names, NAME)
    if label != {name: name for name in names}:
        parts.append(f"In formulas numbers stand for names: {_legend(label)}.\n")
    parts += [_parameters(result, label), _regroupings(result, label)]
    return Exported(written(out, {f"{identifier(result.robot.name)}.tex": "\n".join(parts)}), tuple(notes))


def _labels(names: Sequence[str], longest: int) -> dict[str, str]:
    """Use the names if none is longer than ``longest``, or else numbers from 1."""
    brief = all(len(name) <= longest for name in names)
    return {name: name if brief else str(number) for number, name in enumerate(names, start=1)}


def _legend(label: Mapping[str, str]) -> str:
    """List the names behind numbers; a line may break within long ones."""
    parts = ((number, re.findall(".{1,8}", name) if len(name) > NAME else [name]) for name, number in label.items())
    return ", ".join(f"{number} " + r"\allowbreak{}".join(map(in_latex, part)) for number, part in parts)


def symbol(name: Parameter, label: Mapping[str, str] = MappingProxyType({})) -> str:
    """Write a parameter's name in the field's notation, without dollars: ``off_21R`` is tau with the index off 21R.

    ``label`` maps a body's name to its label.
    """
    kind = name.kind
    subscript = in_latex_index(label.get(name.body, name.body)) + ("R" if name.regrouped else "")
    if kind == "off":
        return rf"\tau_{{\mathrm{{off}}_{{{subscript}}}}}"
    return rf"{{{SYMBOLS.get(kind, in_latex(kind))}}}_{{{subscript}}}"


def _number(value: float | None, digits: int = 4) -> str:
    if value is None:
        return "--"
    mantissa, _, exponent = f"{value:.{digits}g}".partition("e")
    return f"${mantissa} \\times 10^{{{int(exponent)}}}$" if exponent else f"${mantissa}$"


def _table(columns: str, head: Sequence[str], lines: Iterable[Sequence[str]], caption: str) -> str:
    body = " \\\\\n".join(" & ".join(line) for line in lines)
    top = f"\\toprule\n{' & '.join(head)} \\\\\n\\midrule\n"
    return (
        f"{{\\small\n\\setlength{{\\tabcolsep}}{{{SPACE / 2:g}pt}}\n\\begin{{longtable}}{{{columns}}}\n"
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
    """Tabulate the modified Denavit-Hartenberg parameters, as in the paper's Table 2."""
    names = [joint.name for joint in robot.joints]
    label = _labels(names, INDEX)
    lines = []
    for joint in robot.joints:
        at = joint.placement
        assert isinstance(at, Mdh)
        turns = joint.turns
        variable = f"q_{{{in_latex_index(label[joint.name])}}}"
        theta, r = _angle(at.theta), _number(at.r)
        if turns:
            theta = f"${variable}$" if theta == "0" else _sum(variable, theta)
        else:
            r = f"${variable}$" if not at.r else _sum(variable, r)
        antecedent = "0" if joint.antecedent == "ground" else in_latex(label[joint.antecedent])
        flags = ("1" if joint.actuated else "0", "0" if turns else "1")
        placed = (_angle(at.gamma), _number(at.b), _angle(at.alpha), _number(at.d), theta, r)
        lines.append((in_latex(label[joint.name]), antecedent, *flags, *placed))
    head = (
        "$j$",
        "$a(j)$",
        r"$\mu_j$",
        r"$\sigma_j$",
        r"$\gamma_j$",
        "$b_j$",
        r"$\alpha_j$",
        "$d_j$",
        r"$\theta_j$",
        "$r_j$",
    )
    caption = f"Modified Denavit--Hartenberg parameters of {in_latex(robot.name)} (m, rad)."
    if list(label.values()) != names:
        caption += f" Joints: {_legend(label)}."
    return _table("cccccccccc", head, lines, caption)


def _parameters(result: Result, label: Mapping[str, str]) -> str:
    """Tabulate drive gains and essential parameters with relative standard deviations, as in the paper's Table 3."""
    gains = ((in_latex_index(label[joint]), estimate) for joint, estimate in result.drive_gains.items())
    lines = [_line(rf"g_{{\tau\,{index}}}", estimate) for index, estimate in gains]
    parameters = {**result.essential, **result.friction}
    lines += [_line(symbol(name, label), estimate) for name, estimate in parameters.items()]
    for payload in result.payloads:
        named = rf"m_{{{in_latex_index(label[payload.name])}}}"
        lines += [_line(named, estimate) for kind, estimate in payload.parameters.items() if kind == "m"]
    head = ("Par.", "Val.", r"$\hat\sigma$", r"$\%\hat\sigma$", "Unit")
    return _table("lrrrl", head, lines, f"Drive gains and essential parameters of {in_latex(result.robot.name)}.")


def _line(name: str, estimate: Estimate) -> tuple[str, ...]:
    per_cent = estimate.rel_std
    relative = "--" if per_cent is None else f"{per_cent:.2f}" if per_cent < 1000 else "$> 1000$"
    unit = UNITS.get(estimate.unit, estimate.unit.replace("N m", r"N\,m").replace("3", "$^3$"))
    return f"${name}$", _number(estimate.value), _number(estimate.std, 2), relative, unit


def _regroupings(result: Result, label: Mapping[str, str]) -> str:
    """Write each regrouped base parameter as an equation, whose sum is broken to fit the width of a page."""
    sums = {name: estimate.regrouping for name, estimate in result.parameters.items()}
    sums = {name: text for name, text in sums.items() if text not in ("", name)}
    margin = max((width(symbol(name, label)) for name in sums), default=0.0)
    equations = [
        " \\nonumber \\\\\n&\\quad {} ".join([f"{symbol(name, label)} &= {first}", *more])
        for name, text in sums.items()
        for first, *more in [list(_lines(text, TEXT_WIDTH - NUMBER_WIDTH - margin, label))]
    ]
    joined = " \\\\\n".join(equations)
    return f"{{\\allowdisplaybreaks\n\\begin{{align}}\n{joined}\n\\end{{align}}}}\n" if sums else ""


def _lines(regrouping: str, room: float, label: Mapping[str, str]) -> Iterator[str]:
    """Break a sum before its signs into lines of at most ``room`` (pt)."""
    line = ""
    for sign, term in re.findall(r"(?:(^|[+-]) ?)(.+?)(?= [+-] |$)", regrouping):
        factor, name = re.fullmatch(r"(?:([\d.]+(?:e[+-]\d+)?) )?(.+)", term).groups()  # type: ignore[union-attr]
        written = " ".join(filter(None, (sign, factor and rf"{factor}\,", symbol(parameter_of(name), label))))
        if line and width(f"{line} {written}") > room:
            yield line
            line = ""
        line = f"{line} {written}".strip()
    yield line


def width(formula: str) -> float:
    """Estimate the width of a formula in 10 pt type: 4 pt a character of an index, 6 pt of another, 10 pt a sign."""
    indices = "".join(re.findall(r"\\(?:mathrm|text)\{((?:[^{}]|\\[{}])*)\}", formula))
    plain = re.sub(r"\\(?:mathrm|text)\{(?:[^{}]|\\[{}])*\}|\\tau|\\quad|[{}_\\,$\s]", "", formula)
    return 4.0 * len(indices.replace("\\", "")) + 6.0 * len(plain) + 4.0 * len(re.findall(" [+-] ", formula))


def in_latex(text: str) -> str:
    """Write a text so that LaTeX prints it: accents as macros, and what no common font has as ``U+1F916``."""
    made: list[str] = []
    for character in normalize("NFD", text):
        if character in ACCENTS and made:
            made[-1] = rf"\{ACCENTS[character]}{{{made[-1]}}}"
        else:
            plain = character if character.isascii() else f"U+{ord(character):04X}"
            made.append(SPECIAL.get(character, plain))
    return "".join(made)


def in_latex_index(name: str) -> str:
    """Write a name as an upright index of a formula."""
    if re.fullmatch(r"[\w .:-]*", name, flags=re.ASCII):
        return r"\mathrm{" + in_latex(name).replace(" ", r"\ ") + "}"
    return r"\text{" + in_latex(name) + "}"  # accents and some signs are for text alone


EXPORTS = {
    "yaml": Export(export_yaml, floating=True),
    "csv": Export(export_csv, floating=True),
    "latex": Export(export_latex),
}

"""LaTeX tables in the field's notation: geometry (MDH), essential parameters, and what was regrouped."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from math import pi
from pathlib import Path

from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.result import Result
from gtau.export.exported import Exported, written
from gtau.export.identified import identifier
from gtau.robots.parameter import parameter_of
from gtau.robots.robot import Mdh, Robot

SYMBOLS = {"ia": "ia", "fv": "fv", "fs": "fs", "f3": "f_3", "f0": "f_0", "fl": r"f_{\ell}"}
UNITS = {"kg m2": r"kg\,m$^2$", "kg m": r"kg\,m", "N m": r"N\,m", "N m s/rad": r"N\,m\,s/rad", "N s/m": r"N\,s/m"}
HEAD = r"""% Tables of '{robot}', written by 'gtau export': \usepackage{{amsmath,booktabs}} and \input this file.
"""


def export(result: Result, out: Path) -> Exported:
    r"""Write ``NAME.tex`` into ``out``: tables for ``\input``, which want the packages amsmath and booktabs."""
    parts = [HEAD.format(robot=" ".join(result.robot.name.split()))]
    notes = []
    if all(isinstance(joint.placement, Mdh) for joint in result.robot.joints):
        parts.append(_geometry(result.robot))
    else:
        notes.append("the robot is not described by MDH parameters, so there is no table of its geometry")
    parts += [_parameters(result), _regroupings(result)]
    return Exported(written(out, {f"{identifier(result.robot.name)}.tex": "\n".join(parts)}), tuple(notes))


def symbol(name: str) -> str:
    """Write a parameter's name in the field's notation, without dollars: ``off_21R`` is tau with the index off 21R."""
    kind, index, _ = parameter_of(name)
    plain = re.sub(r"R$", "", index) if index else ""
    subscript = r"\mathrm{" + _escaped(plain) + "}" + ("R" if index.endswith("R") else "")
    if kind == "off":
        return rf"\tau_{{\mathrm{{off}}_{{{subscript}}}}}"
    return rf"{{{SYMBOLS.get(kind, kind)}}}_{{{subscript}}}"


def _escaped(text: str) -> str:
    return re.sub(r"([_#%&$])", r"\\\1", text).replace(" ", r"\ ")


def _number(value: float | None, digits: int = 4) -> str:
    if value is None:
        return "--"
    mantissa, _, exponent = f"{value:.{digits}g}".partition("e")
    return f"${mantissa} \\times 10^{{{int(exponent)}}}$" if exponent else f"${mantissa}$"


def _table(columns: str, head: Sequence[str], lines: Iterable[Sequence[str]], caption: str) -> str:
    body = " \\\\\n".join(" & ".join(line) for line in lines)
    return (
        "\\begin{table}\n\\centering\n\\caption{" + caption + "}\n"
        f"\\begin{{tabular}}{{{columns}}}\n\\toprule\n{' & '.join(head)} \\\\\n\\midrule\n{body} \\\\\n"
        "\\bottomrule\n\\end{tabular}\n\\end{table}\n"
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
    lines = []
    for joint in robot.joints:
        at = joint.placement
        assert isinstance(at, Mdh)
        turns = joint.kind == "revolute"
        variable = f"q_{{\\mathrm{{{_escaped(joint.name)}}}}}"
        theta, r = _angle(at.theta), _number(at.r)
        if turns:
            theta = f"${variable}$" if theta == "0" else _sum(variable, theta)
        else:
            r = f"${variable}$" if not at.r else _sum(variable, r)
        antecedent = "0" if joint.antecedent == "ground" else _escaped(joint.antecedent)
        flags = ("1" if joint.actuated else "0", "0" if turns else "1")
        placed = (_angle(at.gamma), _number(at.b), _angle(at.alpha), _number(at.d), theta, r)
        lines.append((_escaped(joint.name), antecedent, *flags, *placed))
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
    return _table(
        "cccccccccc", head, lines, f"Modified Denavit--Hartenberg parameters of {_escaped(robot.name)} (m, rad)."
    )


def _parameters(result: Result) -> str:
    """Tabulate drive gains and essential parameters with relative standard deviations, as in the paper's Table 3."""
    lines = [_line(rf"g_{{\tau\,\mathrm{{{_escaped(joint)}}}}}", each) for joint, each in result.drive_gains.items()]
    lines += [_line(symbol(name), each) for name, each in {**result.essential, **result.friction}.items()]
    for payload in result.payloads:
        named = rf"m_{{\mathrm{{{_escaped(payload.name)}}}}}"
        lines += [_line(named, each) for kind, each in payload.parameters.items() if kind == "m"]
    head = ("Par.", "Val.", r"$\hat\sigma$", r"$\%\hat\sigma$", "Unit")
    return _table("lrrrl", head, lines, f"Drive gains and essential parameters of {_escaped(result.robot.name)}.")


def _line(name: str, each: Estimate) -> tuple[str, ...]:
    relative = "--" if each.rel_std is None else f"{each.rel_std:.2f}" if each.rel_std < 1000 else "$> 1000$"
    unit = UNITS.get(each.unit, each.unit.replace("N m", r"N\,m").replace("3", "$^3$"))
    return f"${name}$", _number(each.value), _number(each.std, 2), relative, unit


def _regroupings(result: Result) -> str:
    """Write each regrouped base parameter as an equation."""
    lines = []
    for name, each in result.parameters.items():
        if each.regrouping not in ("", name):
            words = (f"{w}" if w in "+-" else _word(w) for w in each.regrouping.split())
            lines.append(f"{symbol(name)} &= {' '.join(words)}")
    joined = " \\\\\n".join(lines)
    return f"\\begin{{align}}\n{joined}\n\\end{{align}}\n" if lines else ""


def _word(word: str) -> str:
    return word + r"\," if re.fullmatch(r"[\d.e+-]+", word) else symbol(word)

"""Write ``lookup/equations.csv``: where each numbered equation of the paper stands in the code.

The table is made of the citations "eq. (15)" or "eqs. 29 to 33" in docstrings and comments.
"""

from __future__ import annotations

import ast
import csv
import io
import re
import tokenize
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
TABLE = ROOT / "docs" / "lookup" / "equations.csv"
CITATION = re.compile(r"\beqs?\.\s*(\(?\d+\)?(?:\s*(?:,\s*and|,|and|to|-)\s*\(?\d+\)?)*)")
EQUATIONS = {
    1: "inverse dynamic model of the virtual tree, linear in its standard parameters",
    2: "Newton-Euler equations of the free platform",
    3: "loop-closure equations of all joints",
    4: "reduced loop-closure equations of actuated joints and platform",
    5: "platform velocity from the actuated velocities, J_p",
    6: "platform acceleration",
    7: "velocities of all joints, J_t",
    8: "accelerations of all joints",
    9: "Jacobian matrices of the closures, and T between twist and rates of the platform coordinates",
    10: "platform twist from its independent components, D",
    11: "actuated torques from the Lagrange multipliers",
    12: "Lagrange multipliers from the torques of tree and platform",
    13: "platform wrench along its degrees of freedom",
    14: "principle of virtual power",
    15: "inverse dynamic model of the closed-loop robot",
    16: "identification model: measured torque is modelled torque plus error",
    17: "drive chain: torque is drive gain times current",
    18: "inverse dynamic model with a payload",
    19: "filtered samples stacked",
    20: "decimated linear system of the standard parameters",
    21: "linear system of the base parameters",
    22: "regrouping of dependent columns into base parameters",
    23: "symmetric order of the columns over like legs",
    24: "least-squares solution",
    25: "covariance of the error: white and homoscedastic",
    26: "variance of the error",
    27: "covariance of the least-squares estimate",
    28: "equations of each joint, the groups of weighted least squares",
    29: "unloaded and loaded runs stacked, payload columns beside the robot's",
    30: "drive gains in the model with payload",
    31: "the same, sampled and decimated",
    32: "block-diagonal matrix of currents",
    33: "homogeneous system of parameters and drive gains",
    34: "total least squares: the compatible system",
    35: "singular value decomposition of the homogeneous system",
    36: "nearest matrix of lower rank",
    37: "covariance of the matrix error",
    38: "standard deviation of the matrix error",
    39: "covariance of the total-least-squares estimate",
}


def numbers(text: str) -> set[int]:
    """Equations that a text cites, ranges expanded."""
    found: set[int] = set()
    for citation in CITATION.finditer(text):
        parts = re.findall(r"\d+|to|-", citation.group(1))
        for k, part in enumerate(parts):
            if part.isdigit():
                found.add(int(part))
            elif 0 < k < len(parts) - 1:
                found |= set(range(int(parts[k - 1]), int(parts[k + 1]) + 1))
    return found


def citations(path: Path) -> Iterator[tuple[int, str]]:
    """Equations cited in a module, each with the name of the function or class; an empty name for the module's own."""
    source = path.read_text(encoding="utf-8")
    if not numbers(source):
        return
    tree = ast.parse(source)
    places = list(_places(tree, ""))
    for name, node in places:
        text = ast.get_docstring(node)
        yield from ((number, name) for number in numbers(text or ""))
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            line = token.start[0]
            inside = [name for name, node in places if name and node.lineno <= line <= (node.end_lineno or line)]
            yield from ((number, inside[-1] if inside else "") for number in numbers(token.string))


def _places(node: ast.AST, prefix: str) -> Iterator[tuple[str, ast.Module | ast.ClassDef | ast.FunctionDef]]:
    """Iterate over the module, its classes and functions, the inner ones after the outer."""
    if isinstance(node, ast.Module):
        yield "", node
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.ClassDef | ast.FunctionDef):
            name = f"{prefix}{child.name}"
            yield name, child
            yield from _places(child, f"{name}.")


@cache
def collect() -> dict[int, list[str]]:
    """Places that cite each equation: functions and classes; a module only where no function cites it."""
    functions: dict[int, set[str]] = defaultdict(set)
    modules: dict[int, set[str]] = defaultdict(set)
    for path in sorted((ROOT / "src").rglob("*.py")):
        module = ".".join(path.relative_to(ROOT / "src").with_suffix("").parts).removesuffix(".__init__")
        for number, name in citations(path):
            if name:
                functions[number].add(f"{module}.{name}")
            else:
                modules[number].add(module)
    return {number: sorted(functions[number] or modules[number]) for number in functions.keys() | modules.keys()}


def page() -> str:
    """Return the table: number, subject, and the places in the code."""
    table = io.StringIO()
    rows = csv.writer(table, lineterminator="\n")
    rows.writerow(("equation", "subject", "where"))
    rows.writerows((number, what, ", ".join(collect().get(number, []))) for number, what in EQUATIONS.items())
    return table.getvalue()


if __name__ == "__main__":
    TABLE.write_text(page(), encoding="utf-8")

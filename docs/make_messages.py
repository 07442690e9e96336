"""Write ``lookup/messages.csv``: every finding by its name, with its grade and remedy.

The words are read from where a finding is raised in the source, with ``…`` for what differs from case to case.
"""

from __future__ import annotations

import ast
import csv
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from io import StringIO
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

from gtau.estimation.effects.known import EFFECTS
from gtau.findings import VERDICTS, Finding, Grade

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "gtau"
PAGE = ROOT / "docs" / "lookup" / "messages.csv"
# functions that raise findings, and the names of their positional arguments
RAISE = {
    "Finding": ("kind",),
    "reading": ("kind", "text", "advice"),
    "repair": ("kind", "share", "text", "advice"),
    "contradiction": ("kind", "joints", "text", "advice"),
}
GRADES = {"reading": Grade.INFORMATION, "repair": Grade.INFORMATION, "contradiction": Grade.CONTRADICTORY}
ADVISE = {"write_limits", "clock_advice", "unloaded_advice", "which_payload", "log_with_gravity", "check_milliamperes"}
Line = tuple[int, ast.expr]


@dataclass(frozen=True)
class Module:
    """A file of the source: what its names stand for, and the texts that its functions return."""

    tree: ast.Module

    @cached_property
    def assigned(self) -> dict[str, list[Line]]:
        """Values of names by the lines on which they are assigned."""
        values: dict[str, list[Line]] = defaultdict(list)
        for node in ast.walk(self.tree):
            if isinstance(node, ast.Assign):
                for target in node.targets:
                    together = isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple)
                    pairs = zip(target.elts, node.value.elts, strict=False) if together else [(target, node.value)]
                    for name, value in pairs:
                        values[ast.unparse(name)].append((node.lineno, value))
        return {name: sorted(lines, key=lambda line: line[0]) for name, lines in values.items()}

    @cached_property
    def functions(self) -> list[int]:
        """First lines of the functions."""
        return sorted(node.lineno for node in ast.walk(self.tree) if isinstance(node, ast.FunctionDef))

    def lines(self, name: str, before: int) -> list[Line]:
        """List the values of a name in the function of a line before that line, or those of a constant."""
        first = 0 if name.isupper() else max((line for line in self.functions if line <= before), default=0)
        return [(line, value) for line, value in self.assigned.get(name, ()) if first <= line < before]

    def value(self, name: str, before: int, since: int = 0) -> ast.expr | None:
        """Return the first value of a name from a line on, or the last one before it."""
        lines = self.lines(name, before)
        later = [value for line, value in lines if since and line >= since]
        return later[0] if later else lines[-1][1] if lines else None


def modules() -> dict[Path, Module]:
    """Read the source."""
    trees = {path: ast.parse(path.read_text(encoding="utf-8")) for path in sorted(SOURCE.rglob("*.py"))}
    for node in (node for tree in trees.values() for node in ast.walk(tree)):
        for first, second in pairwise(node.body if isinstance(getattr(node, "body", None), list) else ()):
            match first, second:
                case ast.Assign([name], value), ast.AugAssign(same) if ast.unparse(name) == ast.unparse(same):
                    first.value = ast.BinOp(value, ast.Add(), second.value)  # text += ... right below
    return {path: Module(tree) for path, tree in trees.items()}


def findings(read: Mapping[Path, Module]) -> Iterator[Finding]:
    """Yield the findings that the source raises; those without a grade of their own are causes."""
    constants = {
        name: value.value
        for module in read.values()
        for name, lines in module.assigned.items()
        for _, value in lines
        if name.isupper() and isinstance(value, ast.Constant) and isinstance(value.value, str)
    }
    functions = {
        node.name: (module, node)
        for module in read.values()
        for node in ast.walk(module.tree)
        if isinstance(node, ast.FunctionDef) and node.name in ADVISE
    }

    def words(module: Module, node: ast.expr | None, since: int = 0, depth: int = 0) -> str:
        """Put an expression into words, with names as they stand from a line on."""
        match node:
            case ast.Constant(str(text)):
                return text
            case ast.JoinedStr(parts):
                return "".join(words(module, part, since, depth) for part in parts)
            case ast.BinOp(left, ast.Add(), right):
                return words(module, left, since, depth) + words(module, right, since, depth)
            case ast.FormattedValue(value, format_spec=None):
                return words(module, value, since, depth)
            case ast.IfExp(_, one, other):
                return max((words(module, part, since, depth) for part in (one, other)), key=len)
            case ast.Name(name) if (value := module.value(name, node.lineno, since)) is not None and depth < 5:
                return words(module, value, since, depth + 1)
            case ast.Name(name):
                return constants.get(name, "…")
            case ast.Call(ast.Name("wrenches_first"), (_, advice)):
                return words(module, advice, since, depth)
            case ast.Call(ast.Name(name)) if name in functions and depth < 5:
                home, function = functions[name]
                returned = [part.value for part in ast.walk(function) if isinstance(part, ast.Return)]
                return words(home, returned[-1], 0, depth + 1)
        return "" if node is None else "…"

    for module in read.values():
        for node in ast.walk(module.tree):
            if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in RAISE):
                continue
            given = dict(zip(RAISE[node.func.id], node.args, strict=False))
            given |= {keyword.arg: keyword.value for keyword in node.keywords if keyword.arg}
            if not {"kind", "text"} <= given.keys():
                continue
            graded = "grade" in given or "shown_as" in given or node.func.id in GRADES
            stated = ast.unparse(given["grade"]).removeprefix("Grade.") if "grade" in given else ""
            grade = Grade.__members__.get(stated, GRADES.get(node.func.id, Grade.WARNING))
            for since, kind in kinds(module, given["kind"]):
                text, advice = (words(module, given.get(part), since) for part in ("text", "advice"))
                yield Finding(words(module, kind), text=text, advice=advice, grade=grade if graded else Grade.GIVEN)


def kinds(module: Module, kind: ast.expr) -> list[Line]:
    """List the kinds that an expression stands for, with the lines from which on their words stand."""
    if isinstance(kind, ast.IfExp):
        return [(0, kind.body), (0, kind.orelse)]
    if isinstance(kind, ast.Name) and not kind.id.isupper():
        return module.lines(kind.id, kind.lineno)
    return [(0, kind)]


def effects() -> Iterator[Finding]:
    """Yield the causes of all effects, as they are named for a joint."""
    robot = SimpleNamespace(joint=lambda name: SimpleNamespace(turns=True))
    system = SimpleNamespace(payloads=("…",), joints=("…",))
    fit = SimpleNamespace(kind="current", system=system, problem=system, dataset=SimpleNamespace(robot=robot))
    column = SimpleNamespace(joint="…", subject="…", about="…", waves=(1.0,))
    for effect in EFFECTS:
        cause = effect.cause(fit, column, 0.0)  # type: ignore[arg-type]
        yield replace(cause, text=cause.text.replace("360", "…"))  # deg, the period of the wave above


def by_kind(listed: Iterable[Finding]) -> dict[str, Finding]:
    """List findings by kind, the first of each, without those whose words are given elsewhere."""
    found: dict[str, Finding] = {}
    for finding in listed:
        if (finding.text.strip("… ") or finding.grade == Grade.GIVEN) and "…" not in finding.kind:
            found.setdefault(finding.kind, finding)
    return found


def page() -> str:
    """Return the table: findings by grade, notes, and the causes that verdicts and notes name."""
    raised = list(findings(modules()))
    said = by_kind(finding for finding in raised if finding.grade != Grade.GIVEN).values()
    causes = by_kind([*effects(), *(finding for finding in raised if finding.grade == Grade.GIVEN)]).values()
    listed = [(grade.value, finding) for grade in reversed(VERDICTS) for finding in said if finding.grade == grade]
    listed += [(finding.grade.value, finding) for finding in said if not finding.decisive]
    listed += [("cause", finding) for finding in causes]
    table = StringIO()
    rows = csv.writer(table, lineterminator="\n")
    rows.writerow(("grade", "name", "message", "what to do"))
    rows.writerows((grade, finding.kind, *map(words, (finding.text, finding.advice))) for grade, finding in listed)
    return table.getvalue()


def words(text: str) -> str:
    """Return a text with … for what differs from case to case."""
    return re.sub(r"…[ %]+(?=…)", "", text.replace("{own}", "…")).strip()


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")

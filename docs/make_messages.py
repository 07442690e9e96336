"""Write ``lookup/messages.md``: every finding by its name, with an example and its remedy.

The words are those of the code: where a finding is raised, with ... for what differs from case to case; of other
findings the examples that ``tests/estimation/test_sentences.py`` asserts.
"""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from runpy import run_path

from gtau.estimation.diagnostics.verdict import OUTCOMES
from gtau.findings import Finding, Grade, Outcome
from gtau.findings.words import templates, write_limits

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "gtau"
PAGE = ROOT / "docs" / "lookup" / "messages.md"
EXAMPLES = ROOT / "tests" / "estimation" / "test_sentences.py"
HEAD = """# Messages

Every finding that can appear in a summary, a report or `gtau check`, with its remedy. This page is generated from the
source by `python docs/make_messages.py`; joints and numbers are examples, and long messages are cut.

- [Verdicts](#verdicts): findings that lower a verdict
- [Notes](#notes): other findings
- [Causes](#causes): effects that the model may lack, and errors that the description may have

The first column is the `kind` in `model.json` and `finding.kind` in Python. An error, which ends a command with exit
code 2, is one sentence that states the problem, its place and the remedy; it is not listed here.
"""


def raised(path: Path) -> Iterator[Finding]:
    """Yield the findings that a file raises with words of their own."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    constants: dict[str, list[ast.expr]] = defaultdict(list)  # by name, in the order of the file
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign):
            together = isinstance(node.targets[0], ast.Tuple) and isinstance(node.value, ast.Tuple)
            names, values = (node.targets[0].elts, node.value.elts) if together else (node.targets, [node.value])
            for name, value in zip(names, values, strict=False):
                constants[ast.unparse(name)].append(value)

    def words(node: ast.expr | None) -> str:
        match node:
            case ast.Constant(str(text)):
                return text
            case ast.JoinedStr(parts):
                return "".join(words(part) for part in parts)
            case ast.BinOp(left, ast.Add(), right):
                return words(left) + words(right)
            case ast.FormattedValue(ast.Call() as value):
                return words(value)
            case ast.IfExp(_, one, other):
                return max(words(one), words(other), key=len)
            case ast.Name(name) if before := [value for value in constants[name] if value.lineno < node.lineno]:
                return words(max(before, key=lambda value: value.lineno))
            case ast.Call(ast.Name("write_limits")):
                return write_limits("…")
        return "" if node is None else "…"

    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and ast.unparse(node.func) in ("Finding", "reading", "repair"):
            given = {keyword.arg: keyword.value for keyword in node.keywords}
            if node.args and "text" in given:
                stated = ast.unparse(given.get("grade", ast.Constant(""))).removeprefix("Grade.")
                grade = Grade.__members__.get(stated, Grade.INFORMATION)
                if "grade" not in given and ast.unparse(node.func) == "Finding":
                    grade = None  # a cause
                kind, text, advice = (words(part) for part in (node.args[0], given["text"], given.get("advice")))
                yield Finding(kind, text=text, advice=advice, grade=grade)


def examples() -> dict[str, list[Finding]]:
    """Return examples of findings by kind; of those whose words are given by others there are none."""
    made: dict[str, list[Finding]] = defaultdict(list)
    for finding, *_ in run_path(str(EXAMPLES))["SENTENCES"]:
        made[finding.kind].append(finding)
    for finding in (finding for path in sorted(SOURCE.rglob("*.py")) for finding in raised(path)):
        if "…" not in (finding.kind, finding.text):
            made[finding.kind].append(finding)
    return made


LONGEST = 12  # words of an example


def shortened(text: str) -> str:
    """Cut a long example."""
    words = text.split()
    return " ".join([*words[: LONGEST - 1], "…"]) if len(words) > LONGEST else text


def cell(text: str) -> str:
    """Write a text into a table, what is typed as code."""
    text = re.sub(r"(?<![\w'])(--[a-z-]+)", r"`\1`", (text[:1].upper() + text[1:]).replace("+-", "±")) or "-"
    return re.sub(r"([|<*_\[\]])", r"\\\1", text)


def table(kinds: Sequence[str], made: Mapping[str, list[Finding]]) -> str:
    """Return a table of findings."""
    lines = ["| name | message | what to do |", "| --- | --- | --- |"]
    for kind in kinds:
        first = made[kind][0]
        lines.append(f"| {kind} | {cell(shortened(first.what))} | {cell(first.action)} |")
    return "\n".join(lines) + "\n"


def remedies(kinds: Sequence[str], made: Mapping[str, list[Finding]]) -> str:
    """Return a table of names with remedies; names with the same one share a row."""
    actions: dict[str, list[str]] = defaultdict(list)
    for kind in kinds:
        actions[made[kind][0].action].append(kind)
    rows = (f"| {', '.join(alike)} | {cell(action)} |\n" for action, alike in actions.items())
    return "| name | what to do |\n| --- | --- |\n" + "".join(rows)


def judges(finding: Finding) -> bool:
    """Decide whether a finding lowers a verdict."""
    return finding.grade in list(Outcome)


def page() -> str:
    """Return the page."""
    made = examples()
    words = templates()
    outcomes = dict(OUTCOMES) | {kind: Outcome(first.grade) for kind, (first, *_) in made.items() if judges(first)}
    listed = [kind for section in ("verdicts", "notes", "logs") for kind in words[section]]
    listed += [kind for kind, (first, *_) in made.items() if first.grade]
    notes = [kind for kind in listed if kind not in outcomes]
    text = HEAD + "\n## Verdicts\n"
    for outcome in dict.fromkeys(outcomes.values()):
        text += f"\n### {outcome.value.capitalize()}\n\n"
        text += table([kind for kind, each in outcomes.items() if each is outcome], made)
    text += "\n## Notes\n\n" + remedies([kind for kind in notes if made[kind][0].action], made)
    text += "\nFor information, without a remedy: " + ", ".join(k for k in notes if not made[k][0].action) + ".\n"
    text += "\n## Causes\n\nVerdicts and notes name these with their size and a remedy.\n\n"
    causes = [kind for kind, (first, *_) in made.items() if first.text and first.grade is None]
    return text + remedies([*words["causes"], *causes], made)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")

"""Write ``lookup/messages.md``: every finding by its name, with an example and its remedy; and every refusal.

The words are those of the code: examples of findings are those that ``tests/estimation/test_sentences.py`` asserts, and
refusals are the texts with which ``GtauError`` is raised.
"""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from runpy import run_path

from gtau.estimation.diagnostics.verdict import OUTCOMES
from gtau.findings import Finding
from gtau.findings.words import templates

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "lookup" / "messages.md"
EXAMPLES = ROOT / "tests" / "estimation" / "test_sentences.py"
TITLES = {
    "cli": "Commands",
    "documents": "Files in general",
    "robots": "Robot files",
    "signals": "Logs and experiment files",
    "estimation": "Identification and weighing",
    "excitation": "Design of motions",
    "export": "Exports",
    "simulation": "Simulation",
    "fleet": "Fleets",
    "report": "Reports and figures",
    "model": "Models and poses",
    "errors": "Missing packages",
    "demo": "Tutorial",
}
ERRORS = {"GtauError", "UnknownName", "unreadable", "WorkerDied", "ValueError"}  # the last in checks of files
HEAD = """# Messages

This page is made by `python docs/make_messages.py` from the words of the code.

- [Verdicts](#verdicts): findings against an estimate
- [Notes](#notes): findings beside the verdicts
- [Causes](#causes): what the model may lack, or the description may have wrong
- [Refusals](#refusals): input that gtau does not take

The names are those of `kind` in `model.json` and of `finding.kind` in Python; numbers and joints are examples.
"""


def examples() -> dict[str, list[Finding]]:
    """Return examples of findings by kind."""
    found: dict[str, list[Finding]] = defaultdict(list)
    for finding, *_ in run_path(str(EXAMPLES))["SENTENCES"]:
        found[finding.kind].append(finding)
    return found


def cell(text: str) -> str:
    """Write a text into a table."""
    text = text[:1].upper() + text[1:] if text else "-"
    return re.sub(r"([|<*_\[\]])", r"\\\1", text)


def table(kinds: Sequence[str], found: Mapping[str, list[Finding]], outcome: bool) -> str:
    """Return a table of findings."""
    lines = ["| name |" + " verdict |" * outcome + " message | what to do |", "| --- |" + " --- |" * (2 + outcome)]
    for kind in kinds:
        first = found[kind][0]
        middle = f"{OUTCOMES[kind].value} | " if outcome else ""
        lines.append(f"| {kind} | {middle}{cell(first.what)} | {cell(first.action)} |")
    return "\n".join(lines) + "\n"


def refusals() -> dict[str, list[str]]:
    """Return the texts of refusals, by the folder of the package; what they fill in as dots."""
    found: dict[str, set[str]] = defaultdict(set)
    source = ROOT / "src" / "gtau"
    for path in sorted(source.rglob("*.py")):
        folder = path.relative_to(source).parts[0].removesuffix(".py")
        found[folder].update(texts(ast.parse(path.read_text(encoding="utf-8"))))
    return {folder: sorted(each) for folder, each in found.items() if each}


def texts(tree: ast.AST) -> Iterator[str]:
    """Iterate over the sentences with which errors are made."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ERRORS and node.args:
            text = " ".join(written(node.args[0]).split())
            if len(re.sub(r"\W|…", "", text)) > 12:
                yield text


def written(node: ast.AST) -> str:
    """Write a text as it stands in the code."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(map(written, node.values))
    if isinstance(node, ast.BinOp):
        return written(node.left) + written(node.right)
    return "…"


def page() -> str:
    """Return the page."""
    found = examples()
    words = templates()
    notes = [kind for kind in [*words["verdicts"], *words["notes"], *words["logs"]] if kind not in OUTCOMES]
    text = HEAD + "\n## Verdicts\n\n" + table(list(OUTCOMES), found, True)
    text += "\n## Notes\n\n" + table(notes, found, False)
    text += "\n## Causes\n\nVerdicts and notes name them with their size and what to do.\n\n"
    text += table(list(words["causes"]), found, False) + "\n## Refusals\n\n"
    text += "A refusal is one sentence: what is wrong, where, and what to do. Dots stand for names and numbers.\n"
    for folder, sentences in sorted(refusals().items()):
        text += f"\n### {TITLES.get(folder, folder.capitalize())}\n\n"
        text += "".join(f"- {cell(each)}\n" for each in sentences)
    return text


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")

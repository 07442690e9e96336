"""Write ``lookup/messages.md``: every finding by its name, with an example and its remedy.

The words are those of the code, and the examples those that ``tests/estimation/test_sentences.py`` asserts.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from runpy import run_path

from gtau.estimation.diagnostics.verdict import OUTCOMES
from gtau.findings import Finding
from gtau.findings.words import templates

ROOT = Path(__file__).parents[1]
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


def examples() -> dict[str, list[Finding]]:
    """Return examples of findings by kind."""
    made: dict[str, list[Finding]] = defaultdict(list)
    for finding, *_ in run_path(str(EXAMPLES))["SENTENCES"]:
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


def page() -> str:
    """Return the page."""
    made = examples()
    words = templates()
    notes = [kind for kind in [*words["verdicts"], *words["notes"], *words["logs"]] if kind not in OUTCOMES]
    text = HEAD + "\n## Verdicts\n"
    for outcome in dict.fromkeys(OUTCOMES.values()):
        text += f"\n### {outcome.value.capitalize()}\n\n"
        text += table([kind for kind, each in OUTCOMES.items() if each is outcome], made)
    text += "\n## Notes\n\n" + remedies([kind for kind in notes if made[kind][0].action], made)
    text += "\nFor information, without a remedy: " + ", ".join(k for k in notes if not made[k][0].action) + ".\n"
    text += "\n## Causes\n\nVerdicts and notes name these with their size and a remedy.\n\n"
    return text + remedies(list(words["causes"]), made)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")

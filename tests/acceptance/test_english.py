"""The language of messages, docstrings and pages: phrases that do not come back once they are rewritten."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EVERYWHERE = [
    r"cannot be told",
    r"\bcan(?:not)? tell\b",
    r"\btold apart\b",
    r"\bhangs? together\b",
    r"deviations that hold",
    r"what was done is said",
    r"a robot that can exist",
    r"do the same in all runs",
    r"see to the (?:contradictory|joints)",
    r"numbers that go by",
    r"should not have happened",
    r"for want of",
]
REWRITTEN = [  # in the places below: also words that are right now and then, but stood for others here
    r"\b(?:told|tells?)\b",
    r"(?<!standard )(?<!standard\n)(?<!standard\n    )(?<!absolute )\bdeviations?\b",
    r"\bwhat becomes of\b",
]
NAMES = re.compile(
    r"\{\w+[^{}]*\}|^ *\w+(?:, \w+)* : ", re.MULTILINE
)  # what a template fills in; parameters and attributes
FOLDERS = (
    *(
        "cli",
        "demo",
        "documents",
        "estimation",
        "excitation",
        "export",
        "fleet",
        "model",
        "report",
        "robots",
        "signals",
    ),
    "simulation",
    "watch",
)
PAGES = (
    "do/payload",
    "evidence/benchmarks",
    "lookup/catalog",
    "lookup/equations",
    "lookup/fleets",
    "lookup/log-checks",
    "lookup/robot-file",
    "lookup/simulation-file",
)
PLACES = {
    **{f"src/gtau/{folder}": EVERYWHERE + REWRITTEN for folder in FOLDERS},
    **{f"docs/{page}.md": EVERYWHERE + REWRITTEN for page in PAGES},
    "examples": EVERYWHERE,
    "docs/lookup/experiment-file.md": EVERYWHERE,
    "docs/evidence/case-study.md": EVERYWHERE,
}


def passages(path: Path) -> Iterator[tuple[int, str]]:
    """Iterate over what people read of a file, with its line: a page; or texts and blocks of comments of a module."""
    text = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        yield 1, text
        return
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and not node.value.isidentifier():
            yield node.lineno, NAMES.sub("", node.value)
    for block in re.finditer(r"(?:^[^\n\"']*#.*\n)+", text, re.MULTILINE):
        comments = re.findall(r"#\s*(.*)", block[0])
        yield text.count("\n", 0, block.start()) + 1, "\n".join(comments)


@pytest.mark.parametrize("place", PLACES)
def test_rewritten_phrases_do_not_come_back(place: str) -> None:
    found = set()
    for path in [ROOT / place] if (ROOT / place).is_file() else sorted((ROOT / place).rglob("*.py")):
        for first, text in passages(path):
            for phrase in PLACES[place]:
                for match in re.finditer(phrase, text, re.IGNORECASE):
                    line = first + text.count("\n", 0, match.start())
                    found.add(f"{path.relative_to(ROOT)}:{line}: {match.group()}")
    assert not found, "\n".join(sorted(found))


def test_texts_and_comments_are_read_and_names_are_not(tmp_path: Path) -> None:
    module = tmp_path / "module.py"
    module.write_text(
        '"""A standard\\ndeviation."""\n# of the standard\n# deviation\ndeviation = 1  # so it tells\n'
        "said = f'{deviation:.2g} is told'\n"
    )
    found = [match[0] for _, text in passages(module) for phrase in REWRITTEN for match in re.finditer(phrase, text)]
    assert sorted(found) == ["tells", "told"]


def test_the_phrases_are_found() -> None:
    said = "The mass CANNOT be told, the errors hang together, the deviation is large; a standard deviation is fine."
    found = [phrase for phrase in EVERYWHERE + REWRITTEN if re.search(phrase, said, re.IGNORECASE)]
    assert found == [r"cannot be told", r"\bhangs? together\b", REWRITTEN[0], REWRITTEN[1]]

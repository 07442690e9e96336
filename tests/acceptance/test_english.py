"""The language of messages, docstrings and pages: phrases that do not come back once they are rewritten."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

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
CODE = re.compile(r"^```.*?^```|`[^`\n]+`|\"deviation\"", re.MULTILINE | re.DOTALL)  # and the word that is ruled out
MODULES = sorted(path for path in (ROOT / "src/gtau").rglob("*") if path.suffix in (".py", ".yaml", ".in"))
PAGES = [*sorted((ROOT / "docs").rglob("*.md")), *sorted(ROOT.glob("*.md"))]
PHRASES = {
    **dict.fromkeys(MODULES, EVERYWHERE + REWRITTEN),
    **dict.fromkeys(PAGES, EVERYWHERE + REWRITTEN),
    **dict.fromkeys(sorted((ROOT / "examples").rglob("*.py")), EVERYWHERE),
}
PRONOUN = r"\b(?:that|those)\s+of\b"  # the noun is repeated instead
MOST_PRONOUNS = 14  # in src; more than 30 would not be the English of the field


def passages(path: Path) -> Iterator[tuple[int, str]]:
    """Iterate over what people read of a file, with its line: a page; or texts and blocks of comments of a module."""
    text = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        yield 1, CODE.sub(lambda code: "\n" * code[0].count("\n"), text) if path.suffix == ".md" else text
        return
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and not node.value.isidentifier():
            yield node.lineno, NAMES.sub("", node.value)
    for block in re.finditer(r"(?:^[^\n\"']*#.*\n)+", text, re.MULTILINE):
        comments = re.findall(r"#\s*(.*)", block[0])
        yield text.count("\n", 0, block.start()) + 1, "\n".join(comments)


def found(path: Path, phrases: list[str]) -> list[str]:
    """Each match of a phrase in a file, with its line."""
    return [
        f"{path.relative_to(ROOT)}:{first + text.count(chr(10), 0, match.start())}: {match.group()}"
        for first, text in passages(path)
        for phrase in phrases
        for match in re.finditer(phrase, text, re.IGNORECASE)
    ]


def test_rewritten_phrases_do_not_come_back() -> None:
    again = [line for path, phrases in PHRASES.items() for line in found(path, phrases)]
    assert not again, "\n".join(sorted(set(again)))


def test_pronouns_stand_for_few_nouns() -> None:
    matches = [line for path in MODULES for line in found(path, [PRONOUN])]
    assert len(matches) <= MOST_PRONOUNS, "\n".join(matches)
    outer = ("robots", "export", "cli", "documents", "uses", "watch", "fleet", "demo")
    assert not [line for line in matches if line.split("/")[2] in outer]


def test_texts_and_comments_are_read_and_names_are_not(tmp_path: Path) -> None:
    module = tmp_path / "module.py"
    module.write_text(
        '"""A standard\\ndeviation."""\n# of the standard\n# deviation\ndeviation = 1  # so it tells\n'
        "said = f'{deviation:.2g} is told'\n"
    )
    matches = [match[0] for _, text in passages(module) for phrase in REWRITTEN for match in re.finditer(phrase, text)]
    assert sorted(matches) == ["tells", "told"]


def test_the_phrases_are_found() -> None:
    said = "The mass CANNOT be told, the errors hang together, the deviation is large; a standard deviation is fine."
    matches = [phrase for phrase in EVERYWHERE + REWRITTEN if re.search(phrase, said, re.IGNORECASE)]
    assert matches == [r"cannot be told", r"\bhangs? together\b", REWRITTEN[0], REWRITTEN[1]]

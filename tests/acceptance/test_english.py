"""The language of messages, docstrings and pages: phrases that do not come back once they are rewritten."""

from __future__ import annotations

import re
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
    r"(?<!standard )(?<!standard\n)\bdeviations?\b",
    r"\bwhat becomes of\b",
]
PAGES = ("benchmarks", "catalog", "equations", "log-check", "robot-file", "scale", "simulation-file")
PLACES = {
    "the worst": (
        EVERYWHERE,
        [
            "src/gtau/demo",
            "src/gtau/excitation",
            "src/gtau/simulation",
            "docs/experiment-file.md",
            "docs/case-study.md",
        ],
    ),
    "all": (
        EVERYWHERE + REWRITTEN,
        [
            *(f"src/gtau/{folder}" for folder in ("cli", "documents", "export", "fleet", "model", "robots")),
            *(f"docs/{page}.md" for page in PAGES),
        ],
    ),
}


def files(places: list[str]) -> list[Path]:
    paths = [ROOT / place for place in places]
    return [each for path in paths for each in ([path] if path.is_file() else sorted(path.rglob("*.py")))]


@pytest.mark.parametrize("name", PLACES)
def test_rewritten_phrases_do_not_come_back(name: str) -> None:
    phrases, places = PLACES[name]
    found = []
    for path in files(places):
        text = path.read_text(encoding="utf-8")
        for phrase in phrases:
            for match in re.finditer(phrase, text, re.IGNORECASE):
                line = text.count("\n", 0, match.start()) + 1
                found.append(f"{path.relative_to(ROOT)}:{line}: {match.group()}")
    assert not found, "\n".join(found)


def test_the_phrases_are_found() -> None:
    said = "The mass CANNOT be told, the errors hang together, the deviation is large; a standard deviation is fine."
    found = [phrase for phrase in EVERYWHERE + REWRITTEN if re.search(phrase, said, re.IGNORECASE)]
    assert found == [r"cannot be told", r"\bhangs? together\b", REWRITTEN[0], REWRITTEN[1]]

"""What files say is echoed on one line, printable and short."""

from __future__ import annotations

import io
import re
from pathlib import Path

import numpy as np
import pytest

from gtau.errors import GtauError, quoted, tidy
from gtau.pages import page_text, titles
from gtau.report.page import Page, Section, Text
from gtau.report.terminal import plain
from gtau.robots.readers.read import read_robot
from gtau.signals.reading.drafting import draft_logs, draft_text
from gtau.signals.reading.logs import read_log

ROOT = Path(__file__).parents[2]
HOSTILE = "\x1b]0;owned\x07\u202e\nsecond line\r"


def test_a_value_is_quoted_printable_and_short() -> None:
    assert quoted("a\x1b[31m\nb\u202e") == "'a\\x1b[31m\\nb\\u202e'"
    assert quoted("é 5\N{NO-BREAK SPACE}N m") == "'é 5\N{NO-BREAK SPACE}N m'"
    assert quoted("x" * 60) == f"'{'x' * 60}'"
    assert quoted("x" * 100_000) == f"'{'x' * 57}...'"


def test_sentences_shorten_what_they_quote_and_nothing_else() -> None:
    kept = "the robot's joints' limits, as MuJoCo's own file of 'a' and the other's have them here, differ from 'b'."
    command = "use 'gtau validate a/very/long/path/to/a/model.json another/long/path/to/an/experiment.yaml'."
    assert (tidy(kept), tidy(command)) == (kept, command)
    assert tidy(f"the mass is '{'9' * 1200}'; write it.") == f"the mass is '{'9' * 57}...'; write it."
    assert tidy("y" * 100_000) == f"{'y' * 57}..."
    assert len(tidy("y " * 100_000)) == 3000


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("r.urdf", '<robot name="r"><link name="a"/><joint name="&#10;{}" type="odd{}"/></robot>'),
        ("r.yaml", 'robot: r\njoints:\n  "j\\e\\n{}": {{antecedent: ground, theta: "{}"}}\n'),
        ("r.csv", "j,a,mu,sigma,gamma,b,alpha,d,theta,r\n\x1b{},0,1,0,{},0,0,0,q,0\n"),
        ("r.par", "NL = \x1b{}\nNJ = {}\n"),
    ],
)
def test_robot_files_are_echoed_printable_and_short(name: str, content: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(content.format("z" * 5000, "w" * 5000))
    with pytest.raises(GtauError) as refused:
        read_robot(tmp_path / name)
    said = str(refused.value)
    assert said.isprintable()
    assert len(said) < 500


def test_columns_are_echoed_printable_and_short(tmp_path: Path) -> None:
    path = tmp_path / "log.npz"
    np.savez(path, **{HOSTILE + "x" * 5000: np.zeros(9)})
    with pytest.raises(GtauError) as refused:
        read_log(path, ["q"])
    assert str(refused.value).isprintable()
    assert len(str(refused.value)) < 500


def test_a_page_on_the_terminal_obeys_no_name() -> None:
    said = plain(Page("title", Section("", Text(f"joint {HOSTILE}: '{'x' * 5000}'"))))
    assert "\\x1b]0;owned\\x07\\u202e" in said
    assert all(line.isprintable() and len(line) < 200 for line in said.splitlines())


def test_a_name_begins_no_line_of_a_draft(tmp_path: Path) -> None:
    t = np.arange(0, 5, 0.01)
    moving = {f"{kind}{k}": np.sin(t + k) for kind in ("q", "current") for k in (1, 2)}
    np.savez(tmp_path / "log.npz", t=t, **moving, **{"temperature\nprior_gains: {a: 1}": 20 + t})
    text = draft_text(draft_logs([tmp_path / "log.npz"], "five-bar"), tmp_path)
    assert not any(line.startswith("prior_gains") for line in io.StringIO(text))


def test_pages_that_messages_name_are_there() -> None:
    """Also the sections; no message names a file of the repository, which an installed package lacks."""
    source = "\n".join(file.read_text(encoding="utf-8") for file in (ROOT / "src" / "gtau").rglob("*.py"))
    named = re.findall(r"\bpage\(['\"]([\w-]+)['\"](?:, \"([^\"]+)\")?\)", source)
    named += [(name, "") for name in re.findall(r"'gtau docs ([\w-]+)", source)]
    assert len(named) >= 5
    for name, section in named:
        assert re.search(rf"^#.* {section}$" if section else "^# ", page_text(name), re.MULTILINE), (name, section)
    assert not re.search(r"(?<!\")\"(?!\")[^\"\n]*docs/\w+/[\w-]+\.md", source)
    listed = titles().splitlines()
    assert "identify                Identify gains and parameters" in listed
    assert all(len(line.split()) > 1 for line in listed)
    assert "frozen encoder (contradictory): " in page_text("messages")
    with pytest.raises(GtauError, match="there is no page 'nothing'; choose from "):
        page_text("nothing")

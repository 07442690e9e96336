"""The site: pages made from the code are current, indexes list every page, and broken links are found."""

from __future__ import annotations

import importlib.util
import re
import runpy
import tempfile
from pathlib import Path
from types import ModuleType

import pytest

import gtau

DOCS = Path(__file__).parents[2] / "docs"


def script(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, DOCS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", ["make_commands", "make_messages"])
def test_a_page_made_from_the_code_is_current(name: str) -> None:
    made = script(name)
    assert made.PAGE.read_text(encoding="utf-8") == made.page(), f"run python docs/{name}.py"


@pytest.mark.parametrize("folder", ["start", "do", "lookup", "lookup/robots", "evidence"])
def test_an_index_lists_every_page_of_its_folder(folder: str) -> None:
    index = (DOCS / folder / "index.md").read_text(encoding="utf-8")
    listed = set(re.findall(r"\]\(([\w-]+\.md)", index))
    assert listed == {page.name for page in (DOCS / folder).glob("*.md")} - {"index.md"}
    above = (DOCS / folder).parent / "index.md"
    assert f"({Path(folder).name}/index.md)" in above.read_text(encoding="utf-8")


def test_no_page_written_by_hand_has_more_than_2500_words() -> None:
    generated = {"commands.md"}
    words = {page: len(page.read_text(encoding="utf-8").split()) for page in DOCS.rglob("*.md")}
    assert not {page.name: count for page, count in words.items() if count > 2500}.keys() - generated


def test_every_page_is_on_a_shelf() -> None:
    assert [page.name for page in DOCS.glob("*.md")] == ["index.md"]


def test_the_reference_lists_every_public_name() -> None:
    listed = re.findall(r"^   (\w+)$", (DOCS / "lookup" / "api.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert sorted(listed) == sorted(gtau.__all__)


@pytest.mark.slow
@pytest.mark.parametrize(
    "path", sorted((DOCS.parent / "examples" / "gallery").glob("plot_*.py")), ids=lambda path: path.stem
)
def test_a_script_of_the_gallery_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It makes a figure; what its page shows is not asserted."""
    for package in ("rosbags", "mujoco"):
        pytest.importorskip(package)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    assert runpy.run_path(str(path))["figure"].axes


def test_broken_links_and_anchors_are_found(tmp_path: Path) -> None:
    (tmp_path / "one.html").write_text('<h1 id="top"></h1><a href="two.html#end">to</a><a href="#top">up</a>')
    (tmp_path / "two.html").write_text('<p id="end"></p><a href="one.html#none"></a><img src="gone.png">')
    (tmp_path / "two.html").open("a").write('<a href="https://example.org/x">out</a><a href="#">top</a>')
    pages, links, wrong = script("check_links").broken(tmp_path)
    assert (pages, links) == (2, 4)
    assert wrong == ["two.html: one.html#none", "two.html: gone.png"]

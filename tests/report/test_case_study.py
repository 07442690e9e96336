"""The case study of the paper: its page and pictures, from short logs."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

pytest.importorskip("matplotlib")

PAGE = Path(__file__).parents[2] / "docs" / "evidence" / "case-study.md"


@pytest.mark.slow
def test_the_page_of_the_docs_is_what_the_script_writes(tmp_path: Path) -> None:
    """All but the numbers, which longer logs make more accurate; true values and the gains agree too."""
    import case_study

    case_study.main(tmp_path, duration=5.0)
    made, kept = (path.read_text(encoding="utf-8") for path in (tmp_path / "evidence" / PAGE.name, PAGE))
    text = [re.sub(r"^\|.*\n", "", page, flags=re.MULTILINE) for page in (made, kept)]
    assert text[0] == text[1]
    pictures = set(re.findall(r"images/([\w-]+\.png)", kept))
    assert pictures == {path.name for path in (tmp_path / "images").iterdir()}
    for joint, true in (("11", 2170.0), ("12", 2100.0), ("13", 2070.0)):
        (row,) = re.findall(rf"\| gain of {joint} \|(.*)\|", made)
        cells = [cell.strip() for cell in row.split("|")]
        assert float(cells[3]) == true
        assert float(cells[4]) == pytest.approx(true, rel=3e-3)
    errors = re.findall(r"\| CTC with identified gains \|(.*)\|", made)
    assert len(errors) == 2
    for row in errors:
        assert all(float(cell.split("/")[1]) < float(cell.split("/")[0]) for cell in row.split("|"))

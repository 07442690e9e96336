"""The board of programs: its page shows its file, and its adapters are given the robot that gtau identifies."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from engines import Pinocchio, random_parameters

from gtau.model.home import load_robot

ROOT = Path(__file__).parents[2]
EVIDENCE = ROOT / "docs" / "evidence"


@pytest.fixture
def adapters(monkeypatch: pytest.MonkeyPatch) -> None:
    for folder in ("benchmarks", "benchmarks/adapters"):
        monkeypatch.syspath_prepend(str(ROOT / folder))


def test_the_page_shows_the_file(adapters: None) -> None:
    from board import HEADER, OURS, PEERS, of_page
    from sets import NAMES

    page = (EVIDENCE / "how-fast-how-right.md").read_text(encoding="utf-8")
    with (EVIDENCE / "benchmarks" / "board.csv").open(encoding="utf-8", newline="") as file:
        head, *rows = csv.reader(file)
    assert tuple(head) == HEADER
    assert [row[:2] for row in rows] == [[words, tool] for words in NAMES.values() for tool in (*OURS, *PEERS)]
    for row in rows:  # a number for the error and the time, or a reason
        assert (row[2] == "-") == (row[6] == "-")
        assert row[2] != "-" or row[7]
    for name, lines in of_page(rows).items():
        shown = page.split(f"<!-- {name}: begin -->")[1].split(f"<!-- {name}: end -->")[0]
        assert shown.strip().splitlines() == lines
    for tool, (_, requirement) in PEERS.items():
        assert f"{tool} {requirement.split('==')[1]}" in page


@pytest.mark.parametrize("name", ["ur10e", "puma560"])
def test_the_urdf_of_the_peers_is_the_robot(name: str, adapters: None, tmp_path: Path) -> None:
    from peer_robots import write_urdf

    robot = load_robot(name)
    rng = np.random.default_rng(3)
    chi = random_parameters(robot, rng)
    ours, model = Pinocchio(robot, chi), pin.buildModelFromUrdf(str(write_urdf(robot, tmp_path / "robot.urdf", chi)))
    model.gravity.linear = np.array([0.0, 0.0, -np.linalg.norm(robot.gravity)])  # a URDF's is Pinocchio's 9.81
    for _ in range(5):
        q, v, a = rng.uniform(-2, 2, (3, model.nv))
        np.testing.assert_allclose(pin.rnea(model, model.createData(), q, v, a), ours.torques(q, v, a), rtol=1e-7)


def test_rows_replace_older_ones_in_the_order_of_the_sets(adapters: None, tmp_path: Path) -> None:
    from board import HEADER, keep
    from sets import NAMES

    first, second, *_ = NAMES.values()
    path = tmp_path / "board.csv"
    numbers = ["1", "-", "-", "-", "2", ""]
    keep(path, [[second, "gtau", *numbers], [first, "script", *numbers]])
    kept = keep(path, [[first, "gtau", *numbers], [first, "script", "9", *numbers[1:]]])
    assert [row[:3] for row in kept] == [[first, "gtau", "1"], [first, "script", "9"], [second, "gtau", "1"]]
    assert path.read_text(encoding="utf-8").splitlines()[0] == ",".join(f'"{h}"' if "," in h else h for h in HEADER)


def test_only_finite_intervals_count(adapters: None) -> None:
    from board import holding

    assert holding([(1.0, 0.2, 1.1), (1.0, 0.05, 1.1), (1.0, np.inf, 1.1), (1.0, None, 1.1), (1.0, 0.1, np.nan)]) == (
        1,
        2,
    )

"""Keys of content: equal for equal inputs wherever they lie, different after any change of them."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from gtau.errors import GtauError
from gtau.model.home import load_robot
from gtau.parallel import content_hash as content
from gtau.parallel.content_hash import content_key
from gtau.signals.payload import Payload
from gtau.signals.sizes import Sizes

BLOCK = Sizes().block


@dataclass(frozen=True)
class Pair:
    first: object
    second: object


def named(x: float) -> float:
    return x


DIFFERENT = [
    None, True, False, 0, 1, 1.0, -0.0, 0.0, float("nan"), float("inf"), "", "1", "None", b"", b"1",
    (), [], {}, (1,), [1], ((1,),), (1, 1), ("11",), ("1", "1"), {"a": 1}, {"b": 1}, {"a": "1"}, frozenset(),
    frozenset({1}), range(3), range(4), slice(0, 3), np.float64(1.0), np.float32(1.0), np.zeros(3), np.zeros((3, 1)),
    np.zeros(4), np.zeros(3, dtype=np.float32), np.zeros(3, dtype=int), np.array([0.0, 0.0, 1e-300]),
    np.array([0.0, 0.0, -0.0]), np.array(0.0), Pair(1, 2), Pair(2, 1),
    Pair((1,), 2), named, partial(named, 1), partial(named, x=1), content_key,
    Payload(name="a"), Payload(name="a", mass=1.0), Payload(name="a", mass=1.0, mass_std=1e-9),
    Payload(name="a", mass=1.0, parameters={"mx": 0.0}),
]  # fmt: skip


def test_no_two_values_share_a_key() -> None:
    keys = {content_key(value): value for value in DIFFERENT}
    assert len(keys) == len(DIFFERENT)


def test_equal_values_share_a_key() -> None:
    for robot in ("orthoglide", "ur10e", "delta"):
        assert content_key(load_robot(robot)) == content_key(load_robot(robot))
    array = np.arange(6.0).reshape(2, 3)
    assert content_key(array) == content_key(array.T.copy().T) == content_key(array[::1])
    assert content_key({2, 1}) == content_key({1, 2})


def test_a_robot_s_number_changes_its_key() -> None:
    robot = load_robot("five-bar")
    others = [replace(robot, gravity=(0.0, 1e-15, robot.gravity[2])), replace(robot, closures=())]
    assert len({content_key(each) for each in (robot, *others)}) == 3


@pytest.mark.parametrize("place", [0, BLOCK - 1, BLOCK, 2 * BLOCK + 6])
def test_every_number_of_a_long_array_counts(place: int) -> None:
    array = np.zeros(2 * BLOCK + 7)
    other = array.copy()
    other[place] = np.nextafter(0, 1)
    assert content_key(array) != content_key(other)


def test_arrays_are_read_once(monkeypatch: pytest.MonkeyPatch) -> None:
    array, digests = np.zeros(2 * BLOCK), {}
    key = content_key(array, digests)
    monkeypatch.setattr(content.hashlib, "sha256", counting := Counting(content.hashlib.sha256))
    assert content_key((array,), digests) != key
    assert counting.largest < 1000


class Counting:
    def __init__(self, original) -> None:
        self.original, self.largest = original, 0

    def __call__(self, data=b""):
        self.largest = max(self.largest, len(data))
        return self.original(data)


def test_of_files_the_bytes_count(tmp_path: Path) -> None:
    one, two = tmp_path / "one.csv", tmp_path / "two.csv"
    one.write_bytes(b"a" * 100000)
    two.write_bytes(b"a" * 100000)
    before = content_key(one)
    assert content_key(two) == before
    status = one.stat()
    one.write_bytes(b"a" * 99999 + b"b")
    os.utime(one, ns=(status.st_atime_ns, status.st_mtime_ns))  # as large and as old as before
    assert content_key(one) != before


def test_of_folders_the_order_of_the_parts_counts(tmp_path: Path) -> None:
    folders = [tmp_path / name for name in "ab"]
    for folder, texts in zip(folders, (("1", "2"), ("2", "1")), strict=True):
        folder.mkdir()
        for k, text in enumerate(texts):
            (folder / f"part_{k}.parquet").write_text(text)
    assert content_key(folders[0]) != content_key(folders[1])


def test_what_has_no_content_is_refused(tmp_path: Path) -> None:
    for value in (lambda x: x, object(), np.array([object()]), iter(())):
        with pytest.raises(TypeError, match="no content key"):
            content_key((value,))
    with pytest.raises(GtauError, match="cannot be read"):
        content_key(tmp_path / "nowhere")

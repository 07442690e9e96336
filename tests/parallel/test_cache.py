"""The cache of factors: the same numbers, never stale ones, and none from damaged entries."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from five_bar_logs import STEEL, Plant, five_bar

from gtau.errors import GtauError
from gtau.estimation.identify import identify
from gtau.estimation.regression.dataset import Shard, reduce_runs, reduce_shard
from gtau.estimation.regression.factors import FACTORS_VERSION, Factors, HuberWeights
from gtau.parallel.cache import cache_folder, caching_map, factors_key
from gtau.parallel.content_hash import content_key
from gtau.parallel.executor import ShardMap, in_order, serial_map
from gtau.signals.payload import Payload
from gtau.signals.run import Run


@pytest.fixture(scope="module")
def runs() -> list[Run]:
    plant = Plant(delays=(1e-3, 1e-3), noise=0.01)
    loaded = plant.run("loaded", 6.0, payload=STEEL, seed=2)
    return [plant.run("free", 6.0, seed=1), replace(loaded, payload=Payload(name="steel", mass=1.2))]


@pytest.fixture(scope="module")
def parts(runs: list[Run]) -> list[Shard]:
    """Three parts of each run."""
    whole = [part for of_run in reduce_runs(five_bar().robot, runs).parts() for part in of_run]
    return [replace(part, stretches=part.stretches[k : k + 7]) for part in whole for k in (0, 7, 14)]


class Counted:
    """A shard map that counts what it is given, and is interrupted where asked to."""

    def __init__(self, stop_before: int | None = None) -> None:
        self.parts: list[Shard] = []
        self.stop_before = stop_before

    def __call__(self, function: Callable, items: list[Shard]) -> Iterator[tuple[int, object]]:
        for k, item in reversed(list(enumerate(items))):  # in any order
            if len(self.parts) == self.stop_before:
                raise KeyboardInterrupt
            self.parts.append(item)
            yield k, function(item)


def same(a: Factors, b: Factors) -> bool:
    return all(np.array_equal(getattr(a, f.name), getattr(b, f.name), equal_nan=True) for f in fields(Factors))


def mapped(shard_map: ShardMap, parts: list[Shard], folder: Path, **more: int) -> list[Factors]:
    return list(in_order(caching_map(shard_map, folder, worth=0, **more))(reduce_shard, parts))


def test_what_was_computed_is_not_computed_again(parts: list[Shard], tmp_path: Path) -> None:
    straight = list(map(reduce_shard, parts))
    for expected in (len(parts), 0):
        found = mapped(counted := Counted(), parts, tmp_path / "deep" / "cache")
        assert len(counted.parts) == expected
        assert all(same(a, b) for a, b in zip(straight, found, strict=True))
    assert len(list((tmp_path / "deep" / "cache").iterdir())) == len(parts)


def test_results_are_those_without(runs: list[Run], tmp_path: Path) -> None:
    mapper = in_order(caching_map(serial_map, tmp_path, worth=0))
    found = [identify(five_bar().robot, runs, mapper=each) for each in (map, mapper, mapper)]
    assert list(tmp_path.iterdir())
    for other in found[1:]:
        assert [g.value for g in other.drive_gains.values()] == [g.value for g in found[0].drive_gains.values()]
        assert np.array_equal(other.covariance, found[0].covariance)


def test_without_a_home_nothing_is_cached(parts: list[Shard], monkeypatch: pytest.MonkeyPatch) -> None:
    def none() -> Path:
        raise RuntimeError("Could not determine home directory.")

    for name in ("GTAU_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(Path, "home", none)
    folder = cache_folder()
    found = list(caching_map(serial_map, folder, worth=0)(reduce_shard, parts))
    assert len(found) == len(parts)
    assert not folder.exists()


def test_of_an_interrupted_job_the_finished_parts_stay(parts: list[Shard], tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        mapped(Counted(stop_before=4), parts, tmp_path)
    mapped(counted := Counted(), parts, tmp_path)
    assert len(counted.parts) == len(parts) - 4


@pytest.mark.parametrize("place", [0, 31, 32, 200, -200, -1])
def test_a_damaged_entry_is_computed_again(parts: list[Shard], tmp_path: Path, place: int) -> None:
    straight = mapped(serial_map, parts[:1], tmp_path)
    (entry,) = tmp_path.iterdir()
    good = entry.read_bytes()
    for bad in (bytearray(good), good[:place], b""):
        if isinstance(bad, bytearray):
            bad[place] ^= 1
        entry.write_bytes(bad)
        found = mapped(counted := Counted(), parts[:1], tmp_path)
        assert len(counted.parts) == 1
        assert same(found[0], straight[0])
        assert entry.read_bytes() == good


def changes(part: Shard) -> dict[str, Shard]:
    """The part with one thing about it changed, everything that can change a number among them."""
    prepared, run = part.prepared, part.prepared.run
    joint = part.robot.joints[0]
    placed = replace(joint, placement=replace(joint.placement, d=joint.placement.d + 1e-15))

    def nudged(array: np.ndarray) -> np.ndarray:
        array = np.array(array)
        array.flat[array.size // 2] = not array.flat[array.size // 2] if array.dtype == bool else array.flat[0] + 1e-12
        return array

    found = {
        "stretches": replace(part, stretches=range(1, 8)),
        "columns": replace(part, columns=part.columns[::-1]),
        "filter": replace(part, decimator=replace(part.decimator, kind="chebyshev")),
        "factor": replace(part, decimator=replace(part.decimator, factor=part.decimator.factor + 1)),
        "load": replace(part, load=np.zeros(len(part.columns))),
        "another load": replace(part, load=np.full(len(part.columns), 1e-300)),
        "weights": replace(part, weigh=HuberWeights(np.zeros((2, 3)), np.ones(2))),
        "a number of the robot": replace(part, robot=replace(part.robot, joints=(placed, *part.robot.joints[1:]))),
        "gravity": replace(part, robot=replace(part.robot, gravity=(0.0, 0.0, -9.8))),
    }
    for field in fields(run):
        value = getattr(run, field.name)
        if isinstance(value, np.ndarray):
            changed = replace(run, **{field.name: nudged(value)})
            found[f"run {field.name}"] = replace(part, prepared=replace(prepared, run=changed))
    for field in fields(prepared):
        value = getattr(prepared, field.name)
        if isinstance(value, np.ndarray):
            found[f"prepared {field.name}"] = replace(part, prepared=replace(prepared, **{field.name: nudged(value)}))
    return found


def test_any_change_of_the_inputs_changes_the_key(parts: list[Shard]) -> None:
    changed = changes(parts[0])
    assert {"run position", "run command", "run time"} <= changed.keys()
    keys = {name: factors_key(reduce_shard, part) for name, part in changed.items()}
    keys["nothing"] = factors_key(reduce_shard, parts[0])
    keys["another function"] = factors_key(content_key, parts[0])
    keys["another version"] = factors_key(reduce_shard, parts[0], version=FACTORS_VERSION + 1)
    assert len(set(keys.values())) == len(keys)


def test_another_payload_or_name_needs_no_new_factors(parts: list[Shard], tmp_path: Path) -> None:
    run = replace(parts[0].prepared.run, name="another", payload=Payload(name="x", mass=3.0), notes=("repaired",))
    other = replace(parts[0], prepared=replace(parts[0].prepared, run=run))
    first, second = mapped(counted := Counted(), [parts[0]], tmp_path), mapped(counted, [other], tmp_path)
    assert len(counted.parts) == 1
    assert same(first[0], second[0])
    assert same(reduce_shard(other), first[0])


def test_what_is_refused_is_not_stored(parts: list[Shard], tmp_path: Path) -> None:
    def refusing(function: Callable, items: list[Shard]) -> Iterator[tuple[int, object]]:
        yield 0, GtauError("singular.")

    with pytest.raises(GtauError, match="singular"):
        mapped(refusing, parts[:1], tmp_path)
    assert not list(tmp_path.iterdir())


def test_short_parts_are_not_worth_it(parts: list[Shard], tmp_path: Path) -> None:
    list(in_order(caching_map(serial_map, tmp_path))(reduce_shard, parts))
    assert not list(tmp_path.iterdir())


def test_the_cache_is_bounded(parts: list[Shard], tmp_path: Path) -> None:
    mapped(serial_map, parts[:1], tmp_path)
    (first,) = tmp_path.iterdir()
    largest = int(3.5 * first.stat().st_size)
    for k in range(1, len(parts)):
        mapped(serial_map, [parts[0], parts[k]], tmp_path, largest=largest)  # the first is used every time
    assert len(list(tmp_path.iterdir())) == 3
    assert first.exists()


def test_a_cache_that_cannot_be_written_is_done_without(parts: list[Shard], tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert len(mapped(serial_map, parts[:2], tmp_path / "file" / "cache")) == 2


def test_the_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("GTAU_CACHE", raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "gtau"
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert cache_folder() == Path.home() / ".cache" / "gtau"
    monkeypatch.setenv("GTAU_CACHE", str(tmp_path / "own"))
    assert cache_folder() == tmp_path / "own"
    monkeypatch.setenv("GTAU_CACHE", "")
    assert cache_folder() == Path.home() / ".cache" / "gtau"

"""True stamps and late ones are told apart by the positions; samples find their instants under either."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gtau.errors import GtauError
from gtau.signals.preparation.bandwidth import choose_preparation, spectra
from gtau.signals.reading.statements import PreparationSettings
from gtau.signals.repair.clock import clock_of
from gtau.signals.run import Run, read_run

PERIOD, SAMPLES = 1e-3, 20000
SIGNALS = {"time": "t", "position": {"a": "qa", "b": "qb"}, "current": {"a": "va", "b": "vb"}}


def motion(time: np.ndarray) -> np.ndarray:
    return np.column_stack([np.sin(np.pi * time), 0.4 * np.cos(1.6 * np.pi * time)])


def logged(time: np.ndarray) -> np.ndarray:
    return np.round(motion(time) / 1e-5) * 1e-5


def regular() -> np.ndarray:
    return np.arange(SAMPLES) * PERIOD


def write(path: Path, time: np.ndarray, position: np.ndarray, command: np.ndarray) -> Path:
    table = np.column_stack([time, position, command])
    np.savetxt(path, table, delimiter=",", header="t,qa,qb,va,vb", comments="", fmt="%.9g")
    return path


def currents(time: np.ndarray) -> np.ndarray:
    return np.column_stack([np.cos(2.3 * time), np.sin(3.1 * time)])


def off(run: Run) -> float:
    """Largest distance of the positions from the motion, where they are valid."""
    return float(np.abs(run.position - motion(run.time))[run.valid.all(axis=1)].max())


@pytest.mark.parametrize("jitter", [0.1, 0.3, 0.6])
def test_the_positions_decide_between_true_and_late_stamps(jitter: float, rng: np.random.Generator) -> None:
    stamps = regular() + jitter * PERIOD * rng.uniform(-0.5, 0.5, SAMPLES)
    late, true = clock_of(stamps, logged(regular())), clock_of(stamps, logged(stamps))
    assert (late.regular, not late.gaps, late.missing) == (True, True, 0)
    assert late.period == pytest.approx(PERIOD, rel=1e-6)
    assert late.late == pytest.approx(jitter * PERIOD, rel=0.05)
    assert not true.regular
    np.testing.assert_array_equal(true.instants(stamps), stamps)
    assert clock_of(stamps, logged(regular()), "stamps").regular is False
    assert clock_of(stamps, logged(stamps), "regular").regular is True


@pytest.mark.parametrize("rounding", [6, 3])
def test_steps_that_scatter_as_much_as_they_are_long_are_no_faster_clock(
    rounding: int, rng: np.random.Generator
) -> None:
    """Some stamps are equal, and each step that is taken for a gap makes the others longer than usual."""
    steps = np.maximum(1 + 0.6 * rng.standard_normal(3000), 0.0) / 99
    time = np.round(np.cumsum(steps), rounding)
    clock = clock_of(time, logged(time))
    assert not clock.regular
    assert clock.rate == pytest.approx(1 / steps.mean(), rel=1e-2)
    late = np.maximum.accumulate(np.arange(3000) / 99 + 0.6 / 99 * rng.standard_normal(3000))
    clock = clock_of(late, logged(np.arange(3000) / 99))
    assert (clock.regular, clock.missing) == (True, 0)
    assert clock.rate == pytest.approx(99, rel=1e-3)


@pytest.mark.parametrize("jitter", [0.0, 0.3, 0.6])
def test_missing_samples_are_counted_behind_late_stamps(jitter: float, rng: np.random.Generator) -> None:
    kept = rng.random(SAMPLES) > 0.02
    kept[[0, -1]] = True
    kept[7000:7003] = False
    stamps = regular() + jitter * PERIOD * rng.uniform(-0.5, 0.5, SAMPLES)
    clock = clock_of(stamps[kept], logged(regular())[kept])
    instants = clock.instants(stamps[kept])
    # Where both joints reverse at once neither positions nor stamps show a missing sample.
    assert abs(len(instants) + clock.missing - SAMPLES) <= (0 if jitter == 0 else 3)
    wrong = np.abs(np.diff(instants) - np.diff(regular()[kept])) > 0.5 * PERIOD
    assert wrong.sum() <= (0 if jitter == 0 else 6)


@pytest.mark.parametrize("other", [-1, 1])
@pytest.mark.parametrize("lost", [0.0, 0.02])
def test_repeated_stamps_of_new_samples_are_no_faster_clock(other: int, lost: float, rng: np.random.Generator) -> None:
    """Stamps of the sample before, which are early, or of the one behind, which are late; some samples are missing."""
    stamps, at = regular(), np.sort(rng.choice(np.arange(10, SAMPLES - 10, 3), 400, replace=False))
    stamps[at] = stamps[at + other]
    kept = rng.random(SAMPLES) >= lost
    kept[[0, *(at + other), -1]] = True
    clock = clock_of(stamps[kept], logged(regular())[kept])
    assert (clock.regular, clock.missing) == (True, (~kept).sum())
    assert clock.rate == pytest.approx(1000, rel=1e-5)
    wrong = np.abs(np.diff(clock.instants(stamps[kept])) - np.diff(regular()[kept])) > 0.1 * PERIOD
    assert wrong.mean() <= 0.1 * lost  # beside a repeated stamp a gap may be on either side


@pytest.mark.parametrize("rate", [20.0, 50.0])
@pytest.mark.parametrize("jitter", [0.1, 0.6])
def test_slow_logs_of_fast_moves_lack_nothing(rate: float, jitter: float, rng: np.random.Generator) -> None:
    """From sample to sample the speed changes as much as where one is missing."""
    time = np.arange(int(20 * rate)) / rate
    s = np.clip((time % 1.6) / 1.2, 0, 1)
    there = (time // 1.6) % 2 * (1 - 2 * s**3 * (10 - 15 * s + 6 * s**2)) + s**3 * (10 - 15 * s + 6 * s**2)
    clock = clock_of(time + jitter / rate * rng.random(time.size), np.column_stack([there, -0.7 * there]))
    assert (clock.regular, not clock.gaps, clock.missing) == (True, True, 0)
    assert clock.rate == pytest.approx(rate, rel=1e-3)


def test_a_pause_does_not_make_packets_of_the_samples() -> None:
    time = regular() + 100.0 * (regular() > 10)
    clock = clock_of(time, logged(regular()))
    assert not clock.packets
    assert clock.rate == pytest.approx(1000)
    assert clock.extreme_steps(time)[1] == pytest.approx(100, rel=1e-3)


def test_packets(tmp_path: Path, rng: np.random.Generator) -> None:
    """40 samples at once every 16 ms, of which two packets are lost."""
    time = np.arange(SAMPLES) * 4e-4
    stamps = np.ceil((time + 1e-9) / 16e-3) * 16e-3 + rng.uniform(0, 2e-3, SAMPLES)[np.arange(SAMPLES) // 40]
    kept = np.ones(SAMPLES, dtype=bool)
    kept[4000:4040] = kept[9000:9080] = False
    run = read_run(write(tmp_path / "p.csv", stamps[kept], logged(time)[kept], currents(time)[kept]), SIGNALS)
    assert run.rate == pytest.approx(2500, rel=1e-3)
    assert "time stamps come in packets" in " ".join(map(str, run.notes))
    shift = run.time[0]  # when the first sample was taken is not known
    off_by = np.abs(run.position - motion(run.time - shift))[run.valid.all(axis=1)]
    assert off_by.max() < 0.01
    assert 60 < (~run.valid.all(axis=1)).sum() < 130


def test_packets_of_any_size_lack_no_sample_where_the_robot_rests(rng: np.random.Generator) -> None:
    """One, two, four or eight samples at once: hundreds of gaps by the stamps, which positions at rest do not show."""
    number, ends = np.arange(SAMPLES), np.cumsum(rng.choice([1, 2, 4, 8], SAMPLES))
    last = ends[np.searchsorted(ends, number, side="right")] - 1
    clock = clock_of(PERIOD * last + 2.5e-5 * (number - last), logged(np.minimum(regular(), 5.0)))
    assert (clock.packets, clock.gaps, clock.missing) == (True, (), 0)
    assert clock.period == pytest.approx(PERIOD, rel=1e-4)


def test_stale_samples_are_interpolated(tmp_path: Path, rng: np.random.Generator) -> None:
    time, position, command = regular(), logged(regular()), currents(regular())
    stale = np.flatnonzero(rng.random(SAMPLES - 2) < 0.05) + 1
    stale = stale[np.diff(stale, prepend=-5) > 1]
    for each in (position, command):
        each[stale] = each[stale - 1]
    run = read_run(write(tmp_path / "s.csv", time, position, command), SIGNALS)
    assert any("samples of the positions are stale" in str(note) for note in run.notes)
    moving = (
        np.abs(np.diff(motion(time), axis=0, prepend=0)).max(axis=1) > 1e-4
    )  # slow ones cannot be told from rounding
    assert np.abs(position - motion(time))[moving].max() > 1e-3
    assert np.abs(run.position - motion(time))[moving].max() < 3e-5


def test_stale_samples_in_a_row_are_no_slip_and_hide_none(tmp_path: Path, rng: np.random.Generator) -> None:
    """Whole rows repeat the last new one, up to three in a row; the position that follows makes up for them."""
    time, command = regular(), currents(regular())
    fresh = rng.random(SAMPLES) > 0.05
    fresh[0] = True
    for k in range(4, SAMPLES):
        fresh[k] |= not fresh[k - 3 : k].any()
    kept = np.maximum.accumulate(np.where(fresh, np.arange(SAMPLES), 0))
    assert np.diff(np.flatnonzero(fresh)).max() == 4
    run = read_run(write(tmp_path / "s.csv", time, logged(time)[kept], command[kept]), SIGNALS)
    assert np.abs(run.position - motion(time))[100:-100].max() < 2e-3
    slipped = logged(time) + 0.02 * np.outer(time > 5.25, [1, 0])  # at full speed
    with pytest.raises(GtauError, match=r"joint 'a' jumps by 0\.0.* at 5\.25"):
        read_run(write(tmp_path / "j.csv", time, slipped[kept], command[kept]), SIGNALS)


def test_a_few_stale_samples_of_a_short_log_are_found(tmp_path: Path) -> None:
    time = np.arange(400) * 0.05
    position, command = np.round(motion(time), 5), currents(time)
    stale = np.array([7, 90, 210])
    for each in (position, command):
        each[stale] = each[stale - 1]
    run = read_run(write(tmp_path / "s.csv", time, position, command), SIGNALS)
    assert any("3 samples of the positions are stale" in str(note) for note in run.notes)
    assert off(run) < 1e-3


def test_a_log_that_freezes_for_some_samples_is_bridged(tmp_path: Path) -> None:
    time, position, command = regular(), logged(regular()), currents(regular())
    for start, count in ((400, 6), (5200, 9), (9300, 15)):
        position[start : start + count], command[start : start + count] = position[start - 1], command[start - 1]
    run = read_run(write(tmp_path / "f.csv", time, position, command), SIGNALS)
    assert any("30 samples of the positions are stale" in str(note) for note in run.notes)
    assert 20 < (~run.valid.all(axis=1)).sum() < 40
    assert off(run) < 2e-5


def test_currents_that_are_held_are_recognised(tmp_path: Path) -> None:
    time = regular()
    command = currents(time)[np.arange(SAMPLES) // 10 * 10]
    run = read_run(write(tmp_path / "h.csv", time, logged(time), command), SIGNALS)
    assert any("commands are held: updated at about 100 Hz" in str(note) for note in run.notes)
    np.testing.assert_allclose(run.command[:-10], currents(time)[:-10], atol=2e-4)
    assert run.valid.all()


@pytest.mark.parametrize("hold", [4, 10])
def test_filters_stay_below_half_the_rate_of_held_signals(hold: int, tmp_path: Path) -> None:
    """Interpolated samples hold images of the motion above, which are no motion."""
    time, kept = regular(), np.arange(SAMPLES) // hold * hold
    fast = motion(time) + 0.01 * np.sin(2 * np.pi * 9 * time)[:, None]
    run = read_run(write(tmp_path / "h.csv", time, fast[kept], currents(time)[kept]), SIGNALS)
    assert run.updates == pytest.approx(1000 / hold)
    for spectrum in spectra(run):
        assert spectrum.frequency[-1] < 500 / hold
        assert spectrum.bandwidth < 10
    cutoff = choose_preparation([run]).cutoff
    assert cutoff is not None
    assert cutoff < 500 / hold


def test_slow_rounded_motions_and_rests_are_not_stale(tmp_path: Path) -> None:
    time = regular()
    position = np.round(np.column_stack([0.02 * np.sin(time), np.clip(time - 5, 0, 10)]) / 1e-4) * 1e-4
    run = read_run(write(tmp_path / "r.csv", time, position, np.round(currents(time), 1)), SIGNALS)
    assert run.notes == ()
    np.testing.assert_allclose(run.position, position, atol=1e-12)


def test_repeats_of_noise_and_a_slow_creep_after_a_move_are_not_stale(tmp_path: Path, rng: np.random.Generator) -> None:
    """One joint: noise of ten quanta repeats values now and then; it creeps by a quantum every 23 samples."""
    time = regular()[:2000]
    creep = np.maximum(np.arange(2000) - 500, 0) // 23
    position = np.round(0.01 * (1 - np.exp(-time / 0.03)) / 1e-6) * 1e-6 - 1e-6 * creep
    command = np.round(np.exp(-time / 0.03) + 1e-3 * rng.standard_normal(2000), 4)
    (tmp_path / "n.csv").write_text(
        "t,q,i\n" + "".join(f"{t:.6f},{q:.6f},{i:.4f}\n" for t, q, i in zip(time, position, command, strict=True))
    )
    run = read_run(tmp_path / "n.csv", {"time": "t", "position": {"x": "q"}, "current": {"x": "i"}})
    assert run.notes == ()
    assert (np.diff(command) == 0).sum() > 20
    np.testing.assert_allclose(run.position[:, 0], position, atol=1e-12)
    np.testing.assert_allclose(run.command[:, 0], command, atol=1e-12)


def test_a_delay_that_is_given_moves_the_commands(tmp_path: Path) -> None:
    time = regular()
    path = write(tmp_path / "d.csv", time, logged(time), currents(time - 0.0035))
    run = read_run(path, SIGNALS, settings=PreparationSettings(delay=0.0035))
    np.testing.assert_allclose(run.command[:-10], currents(time)[:-10], atol=1e-5)
    assert "moved the commands 3.5 ms forward, as preparation.delay says" in map(str, run.notes)


def test_the_panda_was_polled_at_a_regular_rate(shared: Path) -> None:
    folder = shared / "panda"
    time = np.loadtxt(folder / "exciting_traj_time.txt")
    clock = clock_of(time, np.loadtxt(folder / "exciting_traj_positions.txt").reshape(-1, 7))
    assert clock.regular
    assert clock.period == pytest.approx(1e-3, rel=1e-4)


@pytest.mark.parametrize("run", [1, 4])
def test_packets_of_all_sizes_lack_no_sample(shared: Path, run: int) -> None:
    """All 20,001 samples of each log are there, one by one for a while, then up to 8 at once."""
    signals = {"time": "t", "position": {"a": "q_shoulder"}, "current": {"a": "i_shoulder"}}
    for clock in (None, "regular"):
        settings = PreparationSettings(clock=clock)
        log = shared / "idle_and_bursts" / "arm_bursts" / f"run_{run}.parquet"
        bursts = read_run(log, signals, settings=settings)
        assert bursts.rate == pytest.approx(500, rel=1e-4)
        assert len(bursts.time) == 20_001
        assert any(str(note).endswith("give the right one (time: {rate: HZ})") for note in bursts.notes)

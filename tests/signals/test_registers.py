"""Signed registers logged as unsigned: corrected and said; other whole numbers stay as they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gtau.signals.reading.discovery import discover
from gtau.signals.reading.samples import Register, register_of
from gtau.signals.run import read_run

TIME = np.arange(2000) / 250
Q = np.column_stack([np.sin(2 * TIME), 0.4 * np.cos(3 * TIME)])
SIGNALS = {"time": "t", "position": {"a": "q1", "b": "q2"}, "current": {"a": "i1", "b": "i2"}}


def counts(size: float, rng: np.random.Generator) -> np.ndarray:
    wave = np.column_stack([np.sin(4 * TIME), -0.8 - 0.15 * np.cos(3 * TIME)])  # the second one is never positive
    return np.rint(size * wave + rng.standard_normal(wave.shape))


def logged(signed: np.ndarray, bits: int, sign: bool) -> np.ndarray:
    """Return signed numbers as a register that is read as unsigned."""
    return np.where(signed < 0, 2.0 ** (bits - 1) - signed if sign else 2.0**bits + signed, signed)


def save(path: Path, positions: np.ndarray, currents: np.ndarray) -> Path:
    np.savetxt(path, np.column_stack([TIME, positions, currents]), delimiter=",", header="t,q1,q2,i1,i2", comments="")
    return path


@pytest.mark.parametrize(
    ("bits", "sign", "size"),
    [(10, False, 300), (11, True, 900), (12, False, 500), (16, False, 200), (16, True, 900), (32, False, 1500)],
)
def test_commands_of_registers_are_corrected(
    bits: int, sign: bool, size: float, tmp_path: Path, rng: np.random.Generator
) -> None:
    """Those of a joint that holds against gravity too, as another joint shows what the register is."""
    signed = counts(size, rng)
    log = save(tmp_path / "a.csv", Q, logged(signed, bits, sign))
    run = read_run(log, SIGNALS, units={"current": "2.69 mA"})
    np.testing.assert_allclose(run.command, 0.00269 * signed, atol=1e-9)
    (note,) = (str(note) for note in run.notes)
    assert note.startswith(
        f"the command of joints 'a' and 'b' is a signed number of {bits} bits that was logged as unsigned"
    )
    assert discover([log]).signals.kind == "current"


@pytest.mark.parametrize("size", [0.1, 0.00269])
def test_commands_of_registers_that_are_scaled_already_are_corrected(
    size: float, tmp_path: Path, rng: np.random.Generator
) -> None:
    signed = counts(900, rng)
    run = read_run(save(tmp_path / "a.csv", Q, size * logged(signed, 16, False)), SIGNALS, units={"current": "A"})
    np.testing.assert_allclose(run.command, size * signed, atol=1e-9)
    assert "signed number of 16 bits" in str(run.notes[0])


def test_positions_of_registers_are_corrected(tmp_path: Path, rng: np.random.Generator) -> None:
    steps = np.rint(2048 / np.pi * Q)
    log = save(tmp_path / "a.csv", logged(steps, 32, False), 1e-3 * counts(900, rng))
    run = read_run(log, SIGNALS, units={"position": "0.087890625 deg"})
    np.testing.assert_allclose(run.position, np.pi / 2048 * steps, atol=1e-9)
    assert "65536" not in str(run.notes[0])
    assert "4294967296 is subtracted from 2147483648 and more" in str(run.notes[0])
    assert discover([log]).reasons.unit.startswith("joint 'j1' reaches 652")


def test_other_whole_numbers_are_no_registers(rng: np.random.Generator) -> None:
    wave = np.sin(4 * TIME)
    assert register_of(logged(counts(200, rng), 16, False)[:, 0]) == Register(16, False)
    for values in (
        np.rint(2048 + 900 * wave),  # offset binary
        np.rint(2500 * (1 + wave)),  # positive, through the middle
        np.rint(800 * np.abs(wave)),  # magnitudes
        np.rint(1000 * (wave > 0)),  # a switch
        np.mod(np.rint(4096 * 3 * TIME / TIME[-1]), 4096),  # an encoder that turns
        counts(200, rng)[:, 0],
        logged(counts(200, rng), 16, False)[:, 0] + 0.5,
    ):
        assert register_of(values) is None

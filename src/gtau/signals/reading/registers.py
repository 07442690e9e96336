"""Signed registers that were logged as unsigned: recognised by jumps of half their range and more, and corrected."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from gtau.findings import Finding
from gtau.signals.reading.notes import listed, reading
from gtau.signals.reading.samples import Samples, extremes
from gtau.signals.storage import blocks, stored_like

LEAST = 128  # counts; below, it is a small number in any register
# Median jump at the middle of the register once it is signed, over that as logged. Present PWM of seven logs of a
# Dynamixel XL330: 3e-5 to 4e-3; of 1,500 other columns of the shared logs only nanoseconds of stamps are below (0.08).
REMAINING = 0.3
FULL = 0.9  # of the range that a number in two's complement reaches at least where it is just below zero
VALUES = 3  # different ones on either side; a switch has fewer


class Register(NamedTuple):
    """A register: the number of its ``bits``, and whether the first one is a ``sign`` beside a magnitude."""

    bits: int
    sign: bool

    def signed(self, values: np.ndarray) -> np.ndarray:
        """Return the signed numbers of unsigned ones."""
        half = 2.0 ** (self.bits - 1)
        return np.where(values < half, values, half - values if self.sign else values - 2 * half)


def register_of(values: np.ndarray) -> Register | None:
    """Recognise a register by its values (N,) as logged.

    None if a value is negative or not a whole number, if the values pass the middle of the range in small steps or
    never, and for a switch.
    """
    values, exact = np.rint(values[np.isfinite(values)]), values[np.isfinite(values)]
    if not values.size or values.min() < 0 or values.max() < LEAST or not np.allclose(values, exact, 1e-9, 0.0):
        return None
    bits = int(values.max()).bit_length()
    above = values >= 2.0 ** (bits - 1)
    at = np.flatnonzero(above[1:] != above[:-1])
    if not at.size or min(len(np.unique(values[above])), len(np.unique(values[~above]))) < VALUES:
        return None

    def jump(numbers: np.ndarray) -> float:
        return float(np.median(np.abs(np.diff(numbers)[at])))

    register = min((Register(bits, sign) for sign in (False, True)), key=lambda one: jump(one.signed(values)))
    full = register.sign or values.max() >= FULL * 2.0**bits
    return register if full and jump(register.signed(values)) < REMAINING * jump(values) else None


def with_signs(
    samples: Samples, scales: tuple[Mapping[str, float], Mapping[str, float]], notes: list[Finding]
) -> Samples:
    """Correct positions and commands that are registers logged without sign, and note it.

    ``scales`` are the SI values of one count of a joint's position and command.
    """
    arrays = []
    for kind, array, scale in zip(("position", "command"), (samples.position, samples.command), scales, strict=True):
        columns = {j: scale[joint] for j, joint in enumerate(samples.joints) if joint in scale}
        if kind == "command":  # positions wrap by turns, which are not a register's range
            columns = {j: _count(array, j, size) for j, size in columns.items()}
        registers = _registers(array, columns)
        for register in set(registers.values()):
            names = tuple(samples.joints[j] for j, same in registers.items() if same == register)
            half = 2 ** (register.bits - 1)
            meaning = f"{2 * half} is subtracted from {half} and more"
            if register.sign:
                meaning = f"{half} and more are negative, with the magnitude above that"
            number = f"a signed number of {register.bits} bits that was logged as unsigned"
            text = f"the {kind} of {listed(names)} is {number}: {meaning}"
            notes.append(reading("unsigned register", text=text, joints=names))
        parts = (_signed(part, registers, columns) for part in blocks(array))
        arrays.append(stored_like(array, parts) if registers else array)
    return replace(samples, position=arrays[0], command=arrays[1])


def _count(array: np.ndarray, j: int, scale: float) -> float:
    """Find what one count is: ``scale``, or the step of a column that is never negative and was scaled before."""
    if extremes(array)[0][j] < 0:
        return scale
    values = np.unique(np.concatenate([part[:, j] for part in blocks(array)])) / scale
    steps = np.diff(values)[np.diff(values) > 1e-9 * values[-1]]
    step = float(f"{steps.min():.6g}") if steps.size else 1.0
    return scale if np.allclose(values, np.rint(values), 1e-9, 0.0) else scale * step


def _registers(array: np.ndarray, columns: Mapping[int, float]) -> dict[int, Register]:
    """Recognise registers among columns of an array, by the value of one count.

    A signal in the upper half of the range is a register if another joint's signal is one.
    """
    low, high = extremes(array)
    ends = {j: sorted((low[j] / size, high[j] / size)) for j, size in columns.items()}
    bits = {j: int(np.rint(most)).bit_length() for j, (least, most) in ends.items() if least >= 0 and most >= LEAST}
    registers = (register_of(np.concatenate([part[:, j] for part in blocks(array)]) / columns[j]) for j in bits)
    common = {register.bits: register for register in registers if register}
    return {j: common[width] for j, width in bits.items() if width in common}


def _signed(part: np.ndarray, registers: Mapping[int, Register], scale: Mapping[int, float]) -> np.ndarray:
    for j, register in registers.items():
        part[:, j] = scale[j] * register.signed(part[:, j] / scale[j])
    return part

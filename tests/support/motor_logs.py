"""Logs of motors with their voltages: what bridge, winding, commutation and recorder add is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from gtau.signals.channel import SideValues
from gtau.signals.run import Run


@dataclass(frozen=True)
class Motors:
    """Motors of a robot, whose voltages are added to runs.

    ``resistance`` (ohm) grows by ``warming`` along a run; ``convention`` is c; ``dead`` is the voltage that the dead
    time of the bridge takes, a share of ``supply`` (V), which sags by ``sag`` ohm; ``bits`` of the duty; ``rate`` (Hz)
    of the recorder; ``commutation`` is the torque constant over the back-EMF constant; ``seed`` draws the ``noise``.
    """

    gains: Sequence[float]
    resistance: float = 2.0
    convention: float = 1.0
    warming: float = 0.0
    dead: float = 0.0
    supply: float = 24.0
    sag: float = 0.0
    bits: int = 16
    rate: float | None = None
    commutation: Sequence[float] | float = 1.0
    inductance: float = 1e-3
    noise: float = 0.0
    seed: int = 0

    def logged(self, run: Run, kind: str = "voltage") -> Run:
        """Return the run with voltages, or with ``duty`` and supply voltage, and with ``supply`` currents too."""
        time, rng = run.time, np.random.default_rng([self.seed, len(run.time)])
        step = float(time[1] - time[0])
        # np.gradient would be 0.07 % too slow at 2 Hz and 200 Hz
        i, qd = run.command[:, : len(self.gains)], CubicSpline(time, run.position)(time, 1)
        ke = np.array(self.gains) / self.commutation
        R = self.resistance * (1 + self.warming * (1 - np.exp(-2 * (time - time[0]) / (time[-1] - time[0]))))
        u = R[:, None] * i + self.inductance * np.gradient(i, step, axis=0) + ke / self.convention * qd
        u += self.dead * self.supply * np.tanh(i / (0.02 * np.abs(i).max(axis=0)))
        duty = u / self.supply
        supply = self.supply - self.sag * np.sum(duty * i, axis=1)
        duty = u / supply[:, None]
        levels = 2.0 ** (self.bits - 1)
        measured = np.round(duty * levels) / levels
        noisy = i + self.noise * np.sqrt(np.mean(i**2, axis=0)) * rng.standard_normal(i.shape)
        sides = {
            "voltage": measured * supply[:, None],
            "duty": measured,
            "supply_voltage": np.repeat(supply[:, None], len(self.gains), axis=1),
            "supply_current": duty * noisy,
        }
        kept = {"voltage": ("voltage",), "duty": ("duty", "supply_voltage")}.get(kind, tuple(sides)[1:])
        every = 1 if self.rate is None else round(1 / (step * self.rate))
        units = {"duty": "1", "supply_current": "A"}
        side = {
            key: SideValues(
                time[::every],
                {joint: sides[key][::every, j] for j, joint in enumerate(run.joints[: len(self.gains)])},
                units.get(key, "V"),
            )
            for key in kept
        }
        command = np.column_stack([noisy, run.command[:, len(self.gains) :]])[::every]
        return replace(
            run,
            time=time[::every],
            position=run.position[::every],
            command=command,
            valid=run.valid[::every],
            side=side,
        )

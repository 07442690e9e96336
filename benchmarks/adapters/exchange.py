"""What the board hands an adapter, and what the adapter hands back; of NumPy alone, as it runs beside each peer."""

import json
import sys
from pathlib import Path
from time import process_time

import numpy as np


class Task:
    """A folder with the task's numbers and logs; :meth:`answer` writes what was found."""

    def __init__(self):
        self.folder = Path(sys.argv[1])
        self.__dict__ |= json.loads((self.folder / "task.json").read_text(encoding="utf-8"))
        self.fit = [self._log(f"fit_{k}") for k in range(len(self.payload))]
        self.check = [self._log(f"check_{k}") for k in range(self.checks)]
        self.begin = process_time()

    def _log(self, name):
        with np.load(self.folder / f"{name}.npz") as file:
            return dict(file)

    def answer(self, predict, **found):
        """Time since the logs were read, and torques along the unused logs by ``predict(log)``, (N, n) each."""
        seconds = process_time() - self.begin
        torques = {f"check_{k}": predict(log) for k, log in enumerate(self.check)}
        np.savez(self.folder / "predicted.npz", **torques)
        self._write({"seconds": seconds, **found})

    def refuse(self, why):
        """Say why the tool does not take the set."""
        self._write({"why": why})
        sys.exit()

    def _write(self, found):
        (self.folder / "answer.json").write_text(json.dumps(found), encoding="utf-8")


def filtered(log, cutoff, rate):
    """Positions behind a zero-phase Butterworth low-pass, and their derivatives by central differences, (N, n)."""
    from scipy.signal import butter, sosfiltfilt

    q = sosfiltfilt(butter(4, cutoff, fs=rate, output="sos"), log["q"], axis=0)
    qd = np.gradient(q, 1 / rate, axis=0)
    return q, qd, np.gradient(qd, 1 / rate, axis=0)

"""Identify what was simulated, for five kinds of robot: a table of gains and parameters, and the time it takes.

PYTHONPATH=src:tests .venv/bin/python benchmarks/simulate_identify.py
"""

from __future__ import annotations

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np
from test_control import described

from gtau.result import identify
from gtau.simulation.simulate import simulate

# A payload known in full fixes the gains of joints that gravity does not load.
BLOCK = {"mx": 0.2, "my": 0.1, "mz": 0.5, "xx": 0.15, "yy": 0.17, "zz": 0.08, "xy": 0.0, "xz": 0.0, "yz": 0.0}
CASES = {  # share of the limits, and the payload's parameters besides its mass
    "orthoglide": (0.9, {}),
    "five-bar": (0.9, {}),
    "delta": (0.9, {}),
    "ur10e": (0.4, BLOCK),
    "gough-stewart": (0.35, BLOCK),
}


def deviations(estimates, true):
    """How many standard deviations each estimate is off."""
    return np.array([abs(each.value - true[name]) / each.std for name, each in estimates.items() if each.std])


def main() -> None:
    head = ("gain error %", "base z rms", "max", "essential max", "simulate s", "identify s")
    print(f"{'robot':<16}" + "".join(f"{each:>15}" for each in head))
    for name, (share, payload) in CASES.items():
        with TemporaryDirectory() as folder:
            out = Path(folder)
            document, chi, gains = described(name, 5, 10.0, share, {"parameters": payload})
            (out / "simulation.yaml").write_text(json.dumps(document), encoding="utf-8")
            start = perf_counter()
            simulate(out / "simulation.yaml", out, lambda *_: None)
            middle = perf_counter()
            result = identify(out / "experiment.yaml")
            end = perf_counter()
        standard = [chi.get(parameter, 0.0) for parameter in result.idm.parameter_names]
        true = dict(zip(result.base.names, result.base.matrix @ standard, strict=True))
        gain = max(abs(result.drive_gains[joint].value / value - 1) for joint, value in gains.items())
        base, essential = deviations(result.parameters, true), deviations(result.essential, true)
        values = (100 * gain, np.sqrt(np.mean(base**2)), base.max(), essential.max(), middle - start, end - middle)
        print(f"{name:<16}" + "".join(f"{each:>15.3f}" for each in values), flush=True)


if __name__ == "__main__":
    main()

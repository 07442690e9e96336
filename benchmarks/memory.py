"""Growth of time and peak memory with the length of a log, from Parquet or CSV to gains, a process for each length.

    python benchmarks/memory.py [--smallest 1e4] [--largest 1e7] [--kind parquet|csv] [--folder DIR] [--json FILE]

The logs are made first in DIR (the Orthoglide with noisy currents, half of the samples with a known payload), one
length after the other, and removed. The peak is the resident set of the whole process as the kernel counts it, pages
of mapped files among it; what lies beyond the program is the peak less that of the shortest log. (With --out, gtau
also writes a table with a row for each decimated sample, which is made in memory.)
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter

import numpy as np
import polars as pl

from gtau.demo import DRIVE_GAINS, MASSES, SIMULATION
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics

PERIOD, RATE, SHARD = 20_000, 1000.0, 1_000_000  # samples of the motion, Hz, samples of a file
NOISE, COUNT = 3e-4, 2.5e-6  # A, m
JOINTS = tuple(DRIVE_GAINS)
EXPERIMENT = """
robot: orthoglide
signals:
  time: t
  position: {{11: q11, 12: q12, 13: q13}}
  current: {{11: v11, 12: v12, 13: v13}}
runs:
  - log: {free}
  - log: {loaded}
    payload: {{name: steel, mass: {mass}}}
"""


def write_log(folder: Path, samples: int, mass: float, kind: str) -> str:
    """A log of a periodic motion with noise of its own all along; returns its name."""
    model = InverseDynamics(load_robot("orthoglide"))
    w = 2 * np.pi * RATE / PERIOD * np.arange(PERIOD)[:, None] / RATE
    harmonics = np.array([[3, 11], [4, 13], [5, 9]])
    rate = 2 * np.pi * RATE / PERIOD * harmonics
    amplitude = np.array([0.06, 0.02])
    angle = w[:, :, None] * harmonics + np.array([0.0, 1.0])
    q = np.sum(amplitude * np.sin(angle), axis=2)
    qd = np.sum(amplitude * rate * np.cos(angle), axis=2)
    qdd = -np.sum(amplitude * rate**2 * np.sin(angle), axis=2)
    chi = SIMULATION.parameters
    chi["m_P"] += mass
    current = model.torques(q, qd, qdd, chi) / np.array(list(DRIVE_GAINS.values()))
    q = COUNT * np.round(q / COUNT)
    rng = np.random.default_rng(round(1000 * mass))
    name = f"log_{round(1000 * mass)}" + ("" if kind == "parquet" else ".csv")
    if kind == "parquet":
        (folder / name).mkdir()
    for start in range(0, samples, SHARD):
        at = np.arange(start, min(start + SHARD, samples))
        v = np.round(current[at % PERIOD] + NOISE * rng.standard_normal((len(at), 3)), 6)
        table = pl.DataFrame(
            {"t": at / RATE}
            | {f"q{joint}": q[at % PERIOD, j] for j, joint in enumerate(JOINTS)}
            | {f"v{joint}": v[:, j] for j, joint in enumerate(JOINTS)}
        )
        if kind == "parquet":
            table.write_parquet(folder / name / f"part_{start // SHARD}.parquet", compression="lz4")
        else:
            with (folder / name).open("ab") as file:
                table.write_csv(file, include_header=start == 0)
    return name


def measure(samples: int, kind: str, folder: Path) -> dict[str, float]:
    """Seconds and peak MiB of ``gtau identify`` on so many samples, and the largest error of a gain."""
    with tempfile.TemporaryDirectory(dir=folder) as name:
        here = Path(name)
        # by another process: the kernel counts the peak of the one that starts gtau as gtau's
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as maker:
            masses = (0.0, MASSES["steel"])
            free, loaded = (maker.submit(write_log, here, samples // 2, m, kind).result() for m in masses)
        (here / "experiment.yaml").write_text(EXPERIMENT.format(free=free, loaded=loaded, mass=MASSES["steel"]))
        program = Path(sys.executable).with_name("gtau")
        arguments = [str(program), "identify", str(here / "experiment.yaml"), "--json"]
        begin = perf_counter()
        output = os.open(here / "printed.json", os.O_WRONLY | os.O_CREAT)
        child = os.posix_spawn(program, arguments, os.environ, file_actions=[(os.POSIX_SPAWN_DUP2, output, 1)])
        os.close(output)
        _, status, usage = os.wait4(child, 0)
        seconds = perf_counter() - begin
        if status:
            raise SystemExit(f"{samples} samples: gtau ended with {status}")
        gains = json.loads((here / "printed.json").read_text())["drive_gains"]
    error = max(abs(each["value"] / DRIVE_GAINS[each["joint"]] - 1) for each in gains)
    return {
        "samples": samples,
        "seconds": seconds,
        "cpu_seconds": usage.ru_utime + usage.ru_stime,
        "peak_mib": usage.ru_maxrss / 1024,
        "gain_error": error,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--smallest", type=float, default=1e4)
    parser.add_argument("--largest", type=float, default=1e7)
    parser.add_argument("--kind", choices=("parquet", "csv"), default="parquet")
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()))
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    if shutil.disk_usage(given.folder).free < 250 * given.largest:
        raise SystemExit(f"{given.folder} has less than 250 bytes a sample free; give another --folder.")
    rows: list[dict[str, float]] = []
    print(f"{'samples':>10} {'s':>8} {'cpu s':>8} {'peak MiB':>9} {'beyond':>8} {'gain error %':>13}")
    for power in range(round(np.log10(given.smallest)), round(np.log10(given.largest)) + 1):
        row = measure(10**power, given.kind, given.folder)
        rows.append(row)
        print(
            f"{row['samples']:>10.0e} {row['seconds']:>8.2f} {row['cpu_seconds']:>8.2f} {row['peak_mib']:>9.0f} "
            f"{row['peak_mib'] - rows[0]['peak_mib']:>8.0f} {100 * row['gain_error']:>13.4f}",
            flush=True,
        )
    base = rows[0]
    for before, row in pairwise(rows[1:]):
        share = (row["cpu_seconds"] - base["cpu_seconds"]) / (before["cpu_seconds"] - base["cpu_seconds"])
        growth = 100 * (row["peak_mib"] / before["peak_mib"] - 1)
        span = f"{before['samples']:.0e} to {row['samples']:.0e}"
        time = f"time grows by an exponent of {np.log10(share):.2f}" if share > 0 else "time does not grow"
        print(f"{span}: {time}, peak memory by {growth:.1f} %")
    if given.json:
        given.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()

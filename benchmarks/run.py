"""How fast, against what one would write with Pinocchio and NumPy: prints a table and writes JSON.

    python benchmarks/run.py [--out benchmarks.json] [--quick]

Results are compared with the peer's before anything is timed. Times are medians of repetitions that take turns with the
peer's, in one thread unless said otherwise. Peers that work sample by sample are timed on fewer samples, and the
time a sample is what is compared; FIGAROH's rows appear where it is installed: pip install 'gtau[benchmarks]'.
"""

# ruff: noqa: E402
from __future__ import annotations

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"

import argparse
import json
import platform
import subprocess
import sys
import tempfile
import tracemalloc
from dataclasses import asdict
from pathlib import Path
from time import perf_counter

# numba imports a package 'coverage' where there is one, and it is not the file beside this one
sys.path = [folder for folder in sys.path if not folder.endswith("benchmarks")]
import numba  # noqa: F401

sys.path += [str(Path(__file__).parent)]

import numpy as np
from peers import PinocchioLoop, figaroh_regressor, random_parameters
from table import Row, check, medians, motion
from whole import excitation_gradient, orthoglide_gains, ur10e_parameters

from gtau.estimation.regression.factors import reduce_run, triangle
from gtau.model.base_parameters import base_parameters
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.robot import Joint, Mdh, Robot
from gtau.signals.preparation.filters import Decimator
from gtau.signals.preparation.prepared_run import SampleWindow
from gtau.signals.run import Run


def seven_axes() -> Robot:
    """A serial arm of seven revolute joints."""
    alphas = (0.0, -np.pi / 2, np.pi / 2, np.pi / 2, -np.pi / 2, -np.pi / 2, np.pi / 2)
    joints = [
        Joint(str(k + 1), str(k) if k else "ground", "revolute", Mdh(alpha=alpha, r=0.2 * (k % 2), d=0.05 * (k == 3)))
        for k, alpha in enumerate(alphas)
    ]
    return Robot("seven-axes", tuple(joints))


def regressors(robot: Robot, samples: int, few: int, targets: tuple[str, str], repetitions: int) -> list[Row]:
    """The regressor consumed in the cache, as torques, and returned."""
    idm = InverseDynamics(robot, "inertial")
    chi = {
        name: value
        for name, value in random_parameters(robot, np.random.default_rng(1)).items()
        if name in idm.parameter_names
    }
    loop = PinocchioLoop(robot, chi)
    path = motion(robot, samples)
    short = tuple(each[:few] for each in path)
    check(robot.name, idm.torques(*short, chi), np.array([W @ loop.chi for W in loop(*short)]))
    works = [
        lambda: idm.torques(*path, chi),
        lambda: [W @ loop.chi for W in loop(*short)],
        lambda: idm.regressor(*path),
        lambda: np.array(list(loop(*short))),
    ]
    if not robot.closures and figaroh_regressor(loop.tree, *short) is not None:
        works.append(lambda: figaroh_regressor(loop.tree, *short))
    cached, theirs, full, stored, *builder = medians(repetitions, *works)
    per, per_few = 1e6 / samples, 1e6 / few
    rows = [
        Row(f"{robot.name}: regressor used in the cache", "Pinocchio loop", cached * per, theirs * per_few, "us/sample",
            targets[0]),
        Row(f"{robot.name}: whole W returned", "Pinocchio loop", full * per, stored * per_few, "us/sample", targets[1]),
    ]  # fmt: skip
    rows += [Row(rows[1].work, "FIGAROH's builder", full * per, each * per_few, "us/sample", "15x") for each in builder]
    return rows


def stages(robot: Robot, samples: int) -> list[Row]:
    """Where the time goes, a stage at a time."""
    idm = InverseDynamics(robot)
    q, qd, qdd = (each.T.copy() for each in motion(robot, samples))
    c = idm.path(q)
    part = slice(0, 2048)
    state = idm.rates(c[:, part], qd[:, part], qdd[:, part])
    chi = np.ones(len(idm.parameter_names))
    closed, rates, columns = medians(
        5,
        lambda: idm.path(q),
        lambda: idm.rates(c[:, part], qd[:, part], qdd[:, part]),
        lambda: idm.full.torques_along(idm.layout, state, chi),
    )
    return [
        Row(f"{robot.name}: closing the loops", "", 1e6 * closed / samples, None, "us/sample", ""),
        Row(f"{robot.name}: velocities, accelerations, J", "", 1e6 * rates / 2048, None, "us/sample", ""),
        Row(f"{robot.name}: all {len(chi)} columns", "", 1e6 * columns / 2048, None, "us/sample", ""),
    ]


def threads(robot: Robot, samples: int) -> Row:
    idm = InverseDynamics(robot)
    path = motion(robot, samples)
    chi = np.ones(len(idm.parameter_names))

    def work(count: str) -> None:
        os.environ["GTAU_THREADS"] = count
        idm.torques(*path, chi)

    two, one = medians(5, lambda: work("2"), lambda: work("1"), clock=perf_counter)
    os.environ["GTAU_THREADS"] = "1"
    return Row(
        f"{robot.name}: two threads", "one thread", 1e6 * two / samples, 1e6 * one / samples, "us/sample", "1.6x"
    )


def prepared(robot: Robot, samples: int) -> SampleWindow:
    """A run as it comes from the filters, with currents that are noise."""
    path = motion(robot, samples)
    command = np.random.default_rng(2).normal(size=path[0].shape)
    time = np.arange(samples) / 1000.0
    run = Run("made up", [f"joint {k + 1}" for k in range(path[0].shape[1])], time, path[0], command)
    return SampleWindow(run, time, *path, command, command, command, np.ones(path[0].shape, dtype=bool))


def reduction(robot: Robot, samples: int, few: int) -> list[Row]:
    """A prepared run to its factors, decimation by 10, base columns; the peer does it with SciPy and NumPy."""
    from scipy.signal import decimate

    idm = InverseDynamics(robot)
    base = base_parameters(idm)
    run, decimator = prepared(robot, samples), Decimator(10)
    loop = PinocchioLoop(robot, random_parameters(robot, np.random.default_rng(1)))
    short = (run.q[:few], run.qd[:few], run.qdd[:few])

    def theirs() -> None:
        W = np.array(list(loop(*short)))
        small = decimate(W, 10, axis=0)
        for j in range(W.shape[1]):
            np.linalg.qr(small[:, j], mode="r")

    ours, peer = medians(3, lambda: reduce_run(idm, base.standard, run, decimator), theirs)
    return [
        Row(f"{robot.name}: run to factors, decimation 10", "Pinocchio, SciPy, QR", 1e6 * ours / samples,
            1e6 * peer / few, "us/sample", "50x"),
    ]  # fmt: skip


def elimination(rows: int, columns: int) -> list[Row]:
    """Eliminating columns one after the other: on a triangle, or by SVD of all rows each time."""
    A = np.random.default_rng(3).normal(size=(rows, columns))
    R = triangle(A)

    def ours() -> None:
        for k in range(columns // 3):
            np.linalg.svd(triangle(R[:, k:]))

    def theirs() -> None:
        np.linalg.svd(A, full_matrices=False)

    loop, first, full = medians(1, ours, lambda: triangle(A), theirs)
    steps = columns // 3
    work, peer = f"{steps} eliminations, r = {rows:.0e}, c = {columns}", "SVD of all rows each step"
    return [
        Row(f"{work}, from the triangle", peer, 1e3 * loop, 1e3 * full * steps, "ms", "500x"),
        Row(f"{work}, first triangle included", peer, 1e3 * (loop + first), 1e3 * full * steps, "ms", ""),
    ]


def growth(robot: Robot, sizes: tuple[int, int]) -> list[Row]:
    """Time of a run's reduction, and memory beyond its input, for two lengths."""
    idm = InverseDynamics(robot)
    names, decimator = base_parameters(idm).standard, Decimator(10)
    runs = [prepared(robot, samples) for samples in sizes]
    short, long = medians(1, *(lambda run=run: reduce_run(idm, names, run, decimator) for run in runs))
    peaks = []
    for run in runs:
        tracemalloc.start()
        reduce_run(idm, names, run, decimator)
        peaks.append(tracemalloc.get_traced_memory()[1] / 2**20)
        tracemalloc.stop()
    exponent = float(np.log(long / short) / np.log(sizes[1] / sizes[0]))
    span = f"N = {sizes[0]:.0e} to {sizes[1]:.0e}"
    beyond = f"{robot.name}: run to factors, memory beyond it"
    return [
        Row(f"{robot.name}: growth of time, {span}", "", exponent, None, "exponent", "0.95-1.05"),
        *(
            Row(f"{beyond}, N = {size:.0e}", "", peak, None, "MiB", "flat")
            for size, peak in zip(sizes, peaks, strict=True)
        ),
    ]


def fresh(code: str, **environment: str) -> tuple[float, float]:
    """Processor seconds of a new process: until the code is done, and until the process has ended."""
    before = os.times()
    timed = f"{code}\nimport time; print(time.process_time())"
    done = subprocess.run(
        [sys.executable, "-c", timed], check=True, env={**os.environ, **environment}, capture_output=True, text=True
    )
    after = os.times()
    spent = after.children_user + after.children_system - before.children_user - before.children_system
    return float(done.stdout), spent


def starts() -> list[Row]:
    """Imports, and the first call ever."""
    light, bare = (np.median([fresh(f"import {name}")[0] for _ in range(7)]) for name in ("gtau", "numpy"))
    call = (
        "import gtau, numpy as np; m = gtau.InverseDynamics(gtau.load_robot('orthoglide')); z = np.zeros((300, 3));"
        "m.torques(z, z, z, np.ones(len(m.parameter_names)))"
    )
    with tempfile.TemporaryDirectory() as folder:
        first, _ = fresh(call, NUMBA_CACHE_DIR=folder)
        later, ended = np.median([fresh(call, NUMBA_CACHE_DIR=folder) for _ in range(7)], axis=0)
    return [
        Row("import gtau", "import numpy", 1e3 * float(light), 1e3 * float(bare), "ms", "at most 1.5x"),
        Row("first call ever, from the start of the process", "", first, None, "s", "under 8 s"),
        Row("first call, code in the cache", "", float(later), None, "s", "under 1 s"),
        Row("the same, until the process has ended", "", float(ended), None, "s", ""),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("benchmarks.json"))
    parser.add_argument("--quick", action="store_true", help="fewer samples and repetitions")
    arguments = parser.parse_args()
    os.environ["GTAU_THREADS"] = "1"
    orthoglide, hexapod, arm = load_robot("orthoglide"), load_robot("gough-stewart"), seven_axes()
    samples, few, repetitions = (20000, 300, 3) if arguments.quick else (100000, 2000, 7)
    rows = [
        *regressors(orthoglide, samples, few, ("100x", "15x"), repetitions),
        *regressors(hexapod, samples, few, ("30x", ""), repetitions),
        *regressors(arm, samples, 5 * few, ("25x", "8x"), repetitions),
        *stages(orthoglide, 32768),
        *stages(hexapod, 32768),
        threads(orthoglide, samples),
        threads(hexapod, samples),
        threads(arm, 10 * samples),
        *reduction(orthoglide, samples, 5 * few),
        *orthoglide_gains(3 * samples, 10000 if arguments.quick else 30000),
        *ur10e_parameters(samples, 5000 if arguments.quick else 20000),
        excitation_gradient(),
        *elimination(10 * samples, 60),
        *growth(orthoglide, (samples, 10 * samples)),
        *starts(),
    ]
    print(f"{'work':<58}{'peer':<27}{'ours':>10}{'peer':>10} {'unit':<10}{'ratio':>8}  target")
    for row in rows:
        theirs = "" if row.theirs is None else f"{row.theirs:.4g}"
        ratio = "" if row.ratio is None else f"{row.ratio:.3g}"
        print(f"{row.work:<58}{row.peer:<27}{row.ours:>10.4g}{theirs:>10} {row.unit:<10}{ratio:>8}  {row.target}")
    document = {
        "machine": {"processor": platform.processor() or platform.machine(), "cores": os.cpu_count()},
        "python": platform.python_version(),
        "rows": [{**asdict(row), "ratio": row.ratio} for row in rows],
    }
    arguments.out.write_text(json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()

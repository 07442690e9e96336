"""Torque errors over all samples beside a careful script: each joint of each log that was not used.

    python benchmarks/every_sample.py                      # measured logs beside the checkout (../shared/data)
    python benchmarks/every_sample.py --only panda tx40

The script is what one would write by hand: positions behind a zero-phase Butterworth low-pass, central differences,
Pinocchio's regressor with rotor inertia, viscous and Coulomb friction and offset, base columns by QR with pivoting,
torques and columns decimated by SciPy, weighted least squares; over every sample, with the rest at both ends masked,
and with slow rows masked as well, each with positions behind 5 and behind 20 times the bandwidth of the motion. It is
given the gains that gtau finds, and finds the payload's parameters itself. Errors are rms errors over rms torques,
per cent, of the same samples: of all against the raw torque, and away from reversals behind the same low-pass.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy.signal import butter, decimate, sosfiltfilt

sys.path += [str(Path(__file__).parent), str(Path(__file__).parents[1] / "tests" / "support")]
from models_to_export import of_equations
from peers import Pinocchio, base_columns, random_parameters
from zoo import ENTRIES

from gtau.estimation.experiment_runs import read_runs
from gtau.estimation.regression.rows import stop
from gtau.model.home import load_robot
from gtau.result import Result, identify
from gtau.signals.reading.experiment import read_experiment
from gtau.signals.run import Run

LOGS = ("panda", "ur10e", "tx40")
MASKS = ("every sample", "ends masked", "slow masked")
CUTOFFS = (5, 20)  # times the bandwidth, of the position filter
SLOW = 0.05  # of the rms speed of a joint
ENDS = 20  # decimated rows, where filters begin


def script(
    result: Result, runs: Sequence[Run], mask: str, wide: float = 5
) -> tuple[Callable[[Run], np.ndarray], np.ndarray]:
    """Identify by hand; returns what predicts torques (N, n) along a run, and the columns' parameters.

    These are ten a link in Pinocchio's order, then of each driven joint rotor inertia, viscous and Coulomb friction and
    offset, each kind together, then ten of the payload; zero where they are not among the base columns.
    """
    model = result.idm
    tree = Pinocchio(result.robot, random_parameters(result.robot, np.random.default_rng(1)))
    ratios, n = result.friction_law.ratios, len(model.actuated)
    links = tree.model.njoints - 1
    driven = [k for k, joint in enumerate(result.robot.joints) if joint.parameters in ("all", "drive")]
    cutoff, factor = result.preparation.bandwidth * wide, result.preparation.decimator.factor

    def columns(run: Run) -> tuple[np.ndarray, np.ndarray]:
        """Regressor (N, n, columns), the tool's inertial columns last but one block, and speeds (N, n)."""
        sos = butter(4, min(2 * cutoff / run.rate, 0.9), output="sos")
        q = sosfiltfilt(sos, np.asarray(run.position), axis=0)
        qd = np.gradient(q, 1 / run.rate, axis=0)
        qdd = np.gradient(qd, 1 / run.rate, axis=0)
        c = model.motion(*model.samples(q, qd, qdd)).c[: len(ratios)].T  # couplings solved
        v, a = qd @ ratios.T, qdd @ ratios.T
        W = np.empty((len(q), n, 10 * links))
        for k, sample in enumerate(zip(c, v, a, strict=True)):
            W[k] = ratios.T @ np.atleast_2d(pin.computeJointTorqueRegressor(tree.model, tree.data, *sample))
        drives = [effect[:, None, driven] * ratios.T[:, driven] for effect in (a, v, np.sign(v), np.ones_like(v))]
        return np.concatenate([W, *drives], axis=2), qd

    blocks, torques, kept = [], [], []
    tool = 10 * [joint.name for joint in result.robot.joints].index(result.robot.tool) + np.arange(10)
    for run in runs:
        W, qd = columns(run)
        tau = result.gains * np.asarray(run.command)[:, :n]
        loaded = run.payload is not None
        W = np.concatenate([W, loaded * W[:, :, tool]], axis=2)
        W, tau, speed = (decimate(each, min(factor, 10), axis=0, ftype="iir") for each in (W, tau, np.abs(qd)))
        rms = np.sqrt(np.mean(qd**2, axis=0))
        inside = np.ones(tau.shape, dtype=bool)
        inside[:ENDS], inside[-ENDS:] = False, False
        if mask != "every sample":
            moving = np.flatnonzero((speed > SLOW * rms).any(axis=1))
            inside[: moving[0]], inside[moving[-1] :] = False, False
        if mask == "slow masked":
            inside &= speed > SLOW * rms
        blocks.append(W), torques.append(tau), kept.append(inside)
    A, y, use = (np.concatenate(each) for each in (blocks, torques, kept))
    base = base_columns(A[use.all(axis=1)][::3].reshape(-1, A.shape[2]))
    weight = np.ones(n)
    for _ in range(2):
        rows = np.concatenate([A[use[:, j], j][:, base] * weight[j] for j in range(n)])
        left = np.concatenate([y[use[:, j], j] * weight[j] for j in range(n)])
        x = np.linalg.lstsq(rows, left, rcond=1e-9)[0]
        error = y - A[:, :, base] @ x
        weight = np.array([1 / np.std(error[use[:, j], j]) for j in range(n)])
    whole = np.zeros(A.shape[2])
    whole[base] = x
    return lambda run: columns(run)[0] @ whole[:-10], whole


def errors_of(result: Result, run: Run, torques: np.ndarray | None = None) -> np.ndarray:
    """Errors (n, 2) of the result, or of other torques (N, n), per cent: raw, and in band away from reversals."""
    prediction = result.predict(run)
    if torques is not None:
        prediction = replace(prediction, predicted=torques)
    found = []
    for each, rows in ((prediction, prediction.valid), (prediction.in_band, prediction.keep)):
        pair = each.measured - each.predicted, each.measured
        squares = [np.sum(values**2, axis=0, where=rows) for values in pair]
        found.append(100 * np.sqrt(squares[0] / squares[1]))
    return np.array(found).T


def measured(data: Path, only: Sequence[str]) -> None:
    print(
        "| log | joint | best peer | which | gtau, plain | gtau | gtau / best | away from reversals: best peer | gtau |"
    )
    print("| --- | --- | ---: | --- | ---: | ---: | ---: | ---: | ---: |")
    for entry in (entry for entry in ENTRIES if entry.name in only):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "experiment.yaml"
            path.write_text(entry.write(data, Path(folder)), encoding="utf-8")
            experiment = read_experiment(path)
            runs, checks = (read_runs(experiment, listed) for listed in (experiment.runs, experiment.validation))
            compare(identify(experiment), runs, checks, entry.robot)


def emps() -> None:
    """The EMPS, simulated with the published values and presliding: moves to and fro, with rests."""
    robot = load_robot("emps")
    joint = robot.actuated[0]
    runs, pulses = [emps_run(joint, seed) for seed in range(2)], replace(emps_run(joint, 2, 1.0), name="pulses")
    compare(identify(robot, runs[:1]), runs[:1], [*runs[1:], pulses], "EMPS, simulated")


def emps_run(joint: str, seed: int, pulse: float = 0.0) -> Run:
    """A run of 24 s at 1 kHz: twelve cycloidal moves of 1 s, each followed by a rest of 1 s.

    Every 0.25 s a pulse of 25 ms accelerates it by up to ``pulse``, m/s2, to and fro.
    """
    rng, rate = np.random.default_rng(seed), 1000.0
    time = np.arange(24 * int(rate)) / rate
    a = np.zeros_like(time)
    for k, way in enumerate(rng.uniform(0.05, 0.12, 12) * (-1.0) ** np.arange(12)):
        since = np.clip(time - 2 * k, 0, 1)
        a += 2 * np.pi * way * np.sin(2 * np.pi * since)
    for k, begin in enumerate(np.arange(0.1, 23.9, 0.25)):
        a += pulse * (-1.0) ** k * np.sin(np.pi * np.clip((time - begin) / 0.025, 0, 1)) ** 2
    v = np.cumsum(a) / rate
    q = np.cumsum(v) / rate
    force = 95.1 * a + 203.5 * v + 20.4 * stop(q, np.array([3e-5]), np.zeros(1))[0] - 3.2 + rng.normal(size=len(time))
    q = 1e-6 * np.round(q / 1e-6)
    return Run(f"seed {seed}", (joint,), time, q[:, None], force[:, None], kind="torque")


def compare(result: Result, runs: Sequence[Run], checks: Sequence[Run], name: str) -> None:
    """Print a row for each joint and log, and one for each log."""
    runs, checks = ([run.ordered(result.idm.actuated) for run in each] for each in (runs, checks))
    variants = [(mask, wide) for wide in CUTOFFS for mask in MASKS]
    scripts = [script(result, runs, *variant)[0] for variant in variants]
    plain = of_equations(result)
    for run in checks:
        peer = np.array([errors_of(result, run, by_hand(run)) for by_hand in scripts])  # (variants, n, 2)
        before, after = errors_of(plain, run), errors_of(result, run)
        best = peer[:, :, 0].argmin(axis=0)
        rows = [
            (
                joint,
                peer[best[j], j, 0],
                words(variants[best[j]]),
                before[j, 0],
                after[j, 0],
                peer[:, j, 1].min(),
                after[j, 1],
            )
            for j, joint in enumerate(result.idm.actuated)
        ]
        mean = np.exp(np.log(peer).mean(axis=1))  # (variants, 2)
        whole = mean[:, 0].argmin()
        ours = [np.exp(np.log(each).mean(axis=0)) for each in (before, after)]
        rows.append(
            ("all", mean[whole, 0], words(variants[whole]), ours[0][0], ours[1][0], mean[:, 1].min(), ours[1][1])
        )
        for joint, by_peer, which, *mine, peer_away, away in rows:
            print(
                f"| {name}, {run.name} | {joint} | {by_peer:.2f} | {which} | {mine[0]:.2f} | {mine[1]:.2f} "
                f"| {mine[1] / by_peer:.2f} | {peer_away:.2f} | {away:.2f} |",
                flush=True,
            )


def words(variant: tuple[str, float]) -> str:
    """Name a variant of the script."""
    return f"{variant[0]}, {variant[1]} times"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", default=LOGS, choices=[each.name for each in ENTRIES])
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    arguments = parser.parse_args()
    measured(arguments.data, arguments.only)
    emps()


if __name__ == "__main__":
    main()

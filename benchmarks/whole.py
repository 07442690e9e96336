"""The rows for whole jobs: log to gains, log to parameters, the gradient of an excitation criterion, and memory."""

# ruff: noqa: E402
from __future__ import annotations

import sys
from pathlib import Path

# numba imports a package 'coverage' where there is one, and it is not the file beside this one
sys.path = [folder for folder in sys.path if not folder.endswith("benchmarks")]
import numba  # noqa: F401

sys.path += [str(Path(__file__).parent)]

import json
import subprocess
from collections.abc import Mapping
from tempfile import TemporaryDirectory

import numpy as np
import polars as pl
from peers import ExcitationByHand, figaroh_wls, gains_by_hand, random_parameters
from table import Row, check, medians, motion

import gtau
from gtau.demo import MASSES, SIMULATION
from gtau.excitation.design_file import read_design
from gtau.excitation.nlp import Programme
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.robot import Robot

RATE, SLOWEST = 250.0, 1.0  # Hz
GAIN = 2100.0
NOISE = 1e-3  # of the rms command
ELIMINATIONS = 20
PEERS_DECIMATION = 9  # least squares bias the peer's gains by 7 % at the factor 2 that is found here, by 0.6 % at 9
STEPS = 50  # of an optimiser


def write_logs(folder: Path, robot: Robot, chi: Mapping[str, float], samples: int, loads: list[float]) -> Path:
    """Logs of currents, or of torques where nothing is loaded, of so many samples together; the experiment's file."""
    model, rng = InverseDynamics(robot), np.random.default_rng(4)
    q, qd, qdd = motion(robot, samples // len(loads), RATE, SLOWEST)
    runs = []
    for k, mass in enumerate(loads):
        loaded = {**chi, f"m_{robot.tool}": chi.get(f"m_{robot.tool}", 0.0) + mass}
        command = model.torques(q, qd, qdd, loaded) / (GAIN if any(loads) else 1.0)
        command += NOISE * command.std(axis=0) * rng.standard_normal(command.shape)
        columns = {f"{kind}{j}": values[:, j] for kind, values in (("q", q), ("v", command)) for j in range(q.shape[1])}
        pl.DataFrame({"t": np.arange(len(q)) / RATE, **columns}).write_parquet(folder / f"{k}.parquet")
        runs.append({"log": f"{k}.parquet", **({"payload": {"name": "known", "mass": mass}} if mass else {})})
    position, command = ({joint: f"{kind}{j}" for j, joint in enumerate(robot.actuated)} for kind in "qv")
    kind = "current" if any(loads) else "torque"
    document = {"robot": robot.name, "signals": {"time": "t", "position": position, kind: command}, "runs": runs}
    (folder / "experiment.yaml").write_text(json.dumps(document), encoding="utf-8")
    return folder / "experiment.yaml"


def orthoglide_gains(samples: int, few: int) -> list[Row]:
    """Logs to drive gains, and the memory that takes beyond the input."""
    robot, chi = load_robot("orthoglide"), SIMULATION.parameters
    with TemporaryDirectory() as one, TemporaryDirectory() as other:
        long = write_logs(Path(one), robot, chi, samples, [0.0, MASSES["steel"]])
        short = write_logs(Path(other), robot, chi, few, [0.0, MASSES["steel"]])
        result = gtau.identify(short)
        factor = result.preparation.decimator.factor
        cutoff = result.preparation.cutoff or np.inf  # without one, as high as the peer goes

        def theirs() -> np.ndarray:
            return gains_by_hand(robot, Path(other), MASSES["steel"], cutoff, PEERS_DECIMATION, ELIMINATIONS)

        found = np.array([gain.value for gain in result.drive_gains.values()])
        check("gains", found, np.full(3, GAIN), 1e-2)
        check("the peer's gains", theirs(), found, 2e-2)  # least squares make them smaller
        ours, peer = medians(1, lambda: gtau.identify(long), theirs)
        memory = peak("ours", long), peak("theirs", short, str(cutoff), str(PEERS_DECIMATION))
    return [
        Row(f"orthoglide: log to gains, N = {samples:.0e}, decimation {factor}", "Pinocchio, SciPy, NumPy",
            1e6 * ours / samples, 1e6 * peer / few, "us/sample", "50x"),
        Row(f"orthoglide: peak memory beyond the input, N = {samples:.0e}", "Pinocchio, SciPy, NumPy",
            memory[0], memory[1] * samples / few, "MiB", "8x less"),
    ]  # fmt: skip


def peak(whose: str, experiment: Path, *settings: str) -> float:
    """MiB of memory that a process takes at most beyond what it has when everything is imported and warm."""
    command = [sys.executable, __file__, whose, str(experiment), *settings]
    return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def _resident(key: str) -> float:
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return float(next(line for line in status.splitlines() if line.startswith(key)).split()[1]) / 1024


def _memory_of_a_job(whose: str, experiment: Path, *settings: str) -> float:
    """As :func:`peak`, in this process."""
    robot = load_robot("orthoglide")
    with TemporaryDirectory() as folder:
        warm = write_logs(Path(folder), robot, SIMULATION.parameters, 6000, [0.0, MASSES["steel"]])

        def work(path: Path) -> None:
            if whose == "ours":
                gtau.identify(path)
            else:
                cutoff, factor = settings
                gains_by_hand(robot, path.parent, MASSES["steel"], float(cutoff), int(factor), 1)

        work(warm)
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # peak = what is resident now
        before = _resident("VmHWM")
        work(experiment)
    logs = sum(path.stat().st_size for path in experiment.parent.glob("*.parquet")) / 2**20
    return _resident("VmHWM") - before - logs


def ur10e_parameters(samples: int, few: int) -> list[Row]:
    """Logs of torques to parameters by weighted least squares."""
    robot = load_robot("ur10e")
    chi = random_parameters(robot, np.random.default_rng(1))
    with TemporaryDirectory() as one, TemporaryDirectory() as other:
        long = write_logs(Path(one), robot, chi, samples, [0.0])
        short = write_logs(Path(other), robot, chi, few, [0.0])
        result = gtau.identify(short, method="wls")
        preparation = result.preparation
        theirs = figaroh_wls(robot, chi, Path(other), preparation.cutoff, preparation.decimator.factor)
        work, name = f"ur10e: log to parameters by WLS, N = {samples:.0e}", "FIGAROH's functions"
        if theirs is None:
            (ours,) = medians(1, lambda: gtau.identify(long, method="wls"))
            return [Row(work, f"{name}: not installed", 1e6 * ours / samples, None, "us/sample", "30x")]
        predicted, measured = theirs()
        check("FIGAROH's torques", predicted, measured, 0.05)
        run = gtau.read_run(Path(other) / "0.parquet", **_as_read(robot))
        prediction = result.predict(run).in_band
        check("torques", prediction.predicted, prediction.measured, 0.05)
        ours, peer = medians(1, lambda: gtau.identify(long, method="wls"), theirs)
    return [Row(work, f"{name}, N = {few:.0e}", 1e6 * ours / samples, 1e6 * peer / few, "us/sample", "30x")]


def _as_read(robot: Robot) -> dict[str, object]:
    position, torque = ({joint: f"{kind}{j}" for j, joint in enumerate(robot.actuated)} for kind in "qv")
    return {"signals": {"time": "t", "position": position, "torque": torque}}


def excitation_gradient() -> Row:
    """The logarithm of the base regressor's condition number, and its gradient by a trajectory's coefficients.

    Ours is asked at points that follow one another, as the optimiser does.
    """
    task, _ = read_design(Path(__file__).parent / "excitation_ur10e.yaml")
    x = task.series.random(np.random.default_rng(5)) * 0.5
    programme = Programme(task, "condition", {})
    peer = ExcitationByHand(task, programme.grid)
    value, slope = programme.value(x)
    check("criterion", np.array([value]), np.array([peer.value(x)]), 1e-6)
    check("gradient", slope, peer.gradient(x), 1e-3)
    nearby = x * (1 + 1e-6 * np.arange(1, STEPS + 1)[:, None])

    def steps() -> None:
        programme = Programme(task, "condition", {})
        for each in nearby:
            programme.value(each)

    ours, theirs = medians(5, steps, lambda: peer.gradient(x))
    work = f"gradient of a criterion, {len(task.model.actuated)} axes, {len(x)} coefficients"
    return Row(work, "differences, Pinocchio loop", 1e3 * ours / STEPS, 1e3 * theirs, "ms", "50x")


if __name__ == "__main__":
    print(_memory_of_a_job(sys.argv[1], Path(sys.argv[2]), *sys.argv[3:]))

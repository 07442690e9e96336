"""Compare the preparation chosen from the logs with plain least squares behind fixed filters, on logs not used.

    python benchmarks/bandwidths.py [--only NAME ...] [--by-hand 1 2 4 8 16]

The logs are those of ``zoo.py`` and the cases beside them (``../shared/data``, or ``--data``). Where an experiment
keeps no log for validation, it is identified on the first 70 % of each log and judged on the rest. Plain least squares
is the model with viscous and Coulomb friction and offsets, positions and commands behind the same zero-phase low-pass
of 6 or 10 Hz: of torques without payload all joints together, weighted, of others each joint by itself, with columns
of its own for each payload. Errors are those of predicted torques over the torques, both rms and behind 10 Hz, in per
cent: the geometric mean of the joints. ``--by-hand`` adds identifications with bandwidths (Hz) set by hand.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import numpy as np

sys.path.append(str(Path(__file__).parent))
from zoo import ENTRIES

from gtau.errors import GtauError
from gtau.estimation.experiment_runs import read_runs
from gtau.estimation.regression.factors import SIGNAL, channel_rows
from gtau.estimation.regression.plausibility import sensors_of
from gtau.estimation.regression.rows import stream_rows
from gtau.model.base_parameters import base_parameters
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.result import Result, identify
from gtau.robots.robot import Robot
from gtau.signals.preparation.filters import Decimator, Preparation, filter_edge, low_pass
from gtau.signals.preparation.prepared_run import PreparedRun
from gtau.signals.reading.experiment import Experiment, read_experiment
from gtau.signals.run import Run

BAND = 10.0  # Hz, of the torques that are compared
FILTERS = (6.0, 10.0)  # Hz, of plain least squares
USED = 0.7  # of a log, where none is kept for validation
ROWS = 100.0  # a second, of plain least squares and of the comparison
CASES = {
    "double_pendulum": "double_pendulum/ramps.yaml",
    "pendulum": "pendulum/known_moment.yaml",
    "sawyer": "sawyer/tilt_4deg.yaml",
}


def experiments(data: Path, folder: Path) -> Iterator[tuple[str, Path]]:
    """Names and files of the experiments."""
    for entry in ENTRIES:
        if entry.name == "upv_gains":  # the logs of "upv"; 70 % of them do not give its gains
            continue
        path = folder / f"{entry.name}.yaml"
        (folder / entry.name).mkdir()
        path.write_text(entry.write(data, folder / entry.name), encoding="utf-8")
        yield entry.name, path
    yield from ((name, data / "cases" / path) for name, path in CASES.items())


def split(experiment: Experiment) -> tuple[list[Run], list[Run]]:
    """Runs to identify from and runs to predict."""
    runs = list(read_runs(experiment, experiment.runs))
    checks = list(read_runs(experiment, experiment.validation))
    if checks:
        return runs, checks
    middle = [run.time[0] + USED * (run.time[-1] - run.time[0]) for run in runs]
    listed = list(zip(experiment.runs, middle, strict=True))
    first, rest = ([entry.model_copy(update={key: float(at)}) for entry, at in listed] for key in ("end", "begin"))
    return list(read_runs(experiment, first)), list(read_runs(experiment, rest))


def plain(robot: Robot, runs: Sequence[Run], checks: Sequence[Run], cutoff: float) -> np.ndarray:
    """Errors (n,) of plain least squares."""
    loads = [run.payload and run.payload.name for run in runs]
    names = list(dict.fromkeys(loads))
    eye = np.eye(len(names))
    used = [rows(robot, run, cutoff, cutoff, eye[names.index(load)]) for run, load in zip(runs, loads, strict=True)]
    W, v = (np.concatenate(parts, axis=1) for parts in zip(*used, strict=True))
    theta = np.array([solved(*of_joint) for of_joint in zip(W, v, strict=True)])
    if len(names) == 1 and runs[0].kind == "torque":
        sigma = np.std(v - np.einsum("jkp,jp->jk", W, theta), axis=1) + 1e-9 * np.std(v)
        together = solved((W / sigma[:, None, None]).reshape(-1, W.shape[2]), (v / sigma[:, None]).ravel())
        theta = np.tile(together, (len(v), 1))
    squares = np.zeros((2, len(v)))
    for run in checks:
        load = run.payload and run.payload.name
        W, v = rows(robot, run, cutoff, BAND, eye[names.index(load)] if load in names else eye[0])
        error = np.einsum("jkp,jp->jk", W, theta) - v
        squares += [np.sum(error**2, axis=1), np.sum(v**2, axis=1)]
    return np.sqrt(squares[0] / squares[1])


def solved(W: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Least squares of normed columns, without the directions that the rows hardly determine."""
    norms = np.maximum(np.linalg.norm(W, axis=0), 1e-300)
    return np.linalg.lstsq(W / norms, v, rcond=1e-6)[0] / norms


def rows(robot: Robot, run: Run, cutoff: float, of_command: float, load: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows of every joint (n, K, p) and its command (n, K), positions and commands behind their low-passes."""
    model = InverseDynamics(robot)
    run = run.ordered(model.actuated)
    n, names = len(model.actuated), base_parameters(model, sensors=sensors_of(robot, [run])).standard
    kept = inner(run)
    still = Preparation(cutoff, cutoff, Decimator(1), 0.0)
    prepared = PreparedRun(run, still, kept, np.ones(n, bool), np.eye(n), np.eye(n), np.zeros((1, n)))
    window = prepared.samples()
    command = low_pass(np.asarray(run.command), run.rate, of_command)[kept.start : kept.stop]
    window = replace(window, command=command)[:: stride(run)]
    regressor = model.columns(names)
    channels = [channel for channel in run.channels if channel.kind.modelled]
    parts = [channel_rows(regressor, channels, part) for part in stream_rows(model, regressor, window, Decimator(1))]
    A = np.concatenate(parts, axis=1)[:n]
    return np.stack([np.kron(load, of_joint[:, : len(names)]) for of_joint in A]), A[..., SIGNAL]


def stride(run: Run) -> int:
    """Samples from one row to the next."""
    return max(1, round(run.rate / ROWS))


def inner(run: Run) -> range:
    """Samples of a run that no filter's end reaches."""
    edge = filter_edge(run.rate, min(FILTERS))
    return range(edge, len(run.time) - edge)


def predicted(result: Result, checks: Sequence[Run]) -> np.ndarray:
    """Errors (n,) of the predictions of an identified model."""
    squares = np.zeros((2, len(result.robot.actuated)))
    for run in checks:
        prediction = result.predict(run)
        kept = inner(run)
        made, measured = (
            low_pass(np.asarray(torques), run.rate, BAND)[kept.start : kept.stop : stride(run)]
            for torques in (prediction.predicted, prediction.measured)
        )
        squares += [np.sum((made - measured) ** 2, axis=0), np.sum(measured**2, axis=0)]
    return np.sqrt(squares[0] / squares[1])


def mean(errors: np.ndarray) -> float:
    """Geometric mean, per cent."""
    return float(100 * np.exp(np.mean(np.log(errors))))


def identified(robot: Robot, experiment: Experiment, runs: Sequence[Run], bandwidth: float | None) -> Result:
    """Identify from runs, with a bandwidth set by hand or chosen."""
    if bandwidth is not None:
        runs = [replace(run, settings=run.log.settings.model_copy(update={"bandwidth": bandwidth})) for run in runs]
    gains = {joint: gain.value for joint, gain in experiment.stated_gains.items()}
    return identify(robot, runs, priors=experiment.expected_parameters, prior_gains=gains)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument("--only", nargs="+", metavar="NAME")
    parser.add_argument("--by-hand", nargs="+", type=float, default=(), metavar="HZ")
    arguments = parser.parse_args()
    columns = ["gtau", *(f"{cutoff:g} Hz" for cutoff in FILTERS), *(f"b {hertz:g}" for hertz in arguments.by_hand)]
    print(f"{'log':16s} {'prepared':28s} {'s':>5s}", *(f"{column:>7s}" for column in columns))
    with tempfile.TemporaryDirectory() as folder:
        for name, path in experiments(arguments.data, Path(folder)):
            if arguments.only and name not in arguments.only:
                continue
            experiment = read_experiment(path)
            robot = load_robot(experiment.robot)
            runs, checks = split(experiment)
            used, seconds, errors = "", 0.0, []
            for bandwidth in (None, *arguments.by_hand):
                begin = perf_counter()
                try:
                    result = identified(robot, experiment, runs, bandwidth)
                    errors.append(mean(predicted(result, checks)))
                except GtauError as refusal:
                    errors.append(np.nan)
                    print(f"{name}: {refusal}")
                    continue
                if bandwidth is None:
                    seconds, of = perf_counter() - begin, result.preparation
                    cutoff = "no filter" if of.cutoff is None else f"{of.cutoff:.3g} Hz"
                    used = f"{of.bandwidth:.3g} Hz, {cutoff}, 1 in {of.decimator.factor}"
            errors[1:1] = [mean(plain(robot, runs, checks, cutoff)) for cutoff in FILTERS]
            worse = "  WORSE" if errors[0] > min(errors[1:3]) else ""
            print(f"{name:16s} {used:28s} {seconds:5.1f}", *(f"{error:7.3g}" for error in errors), worse, flush=True)


if __name__ == "__main__":
    main()

"""Identify the same logs with gtau and its peers, and print one table, also where gtau is behind.

    pip install '.[benchmarks]'
    python benchmarks/peers_on_logs.py [--only NAME ...] [--update docs/evidence/index.md]

The measured logs lie beside the checkout (``../shared/data``, or ``--data``); the EMPS is simulated here. Errors are
rms errors over rms torques, per cent, of the same rows behind the same filter. Processor time is that of the whole
identification; gtau's includes reading the logs, which the peers are given as arrays.
"""

from __future__ import annotations

import argparse
import ast
import inspect
import sys
import tempfile
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from time import process_time

import numpy as np
import polars as pl

sys.path.append(str(Path(__file__).parent))
import every_sample
import peers
import rollouts
from scipy.signal import butter, sosfiltfilt
from table import write_csv
from zoo import ENTRIES, Entry, experiment_file, line, update

from gtau.estimation.experiment_runs import read_runs
from gtau.estimation.results.payload_body import PayloadEstimate
from gtau.result import Result, identify
from gtau.robots.robot import Robot
from gtau.signals.reading.experiment import read_experiment
from gtau.signals.run import Run
from gtau.uses.weigh import weigh

MARKS = "<!-- peers: begin -->", "<!-- peers: end -->"
NAMES = ("emps", "orthoglide", "ur10e", "tx40", "panda")
ROLLED = ("emps",)  # with an arm mujoco.sysid has not converged after 140 s of a processor
GAINS = {"ur10e": (11.98, 11.98, 9.84, 10.76, 10.76, np.nan), "orthoglide": (2170.0, 2100.0, 2070.0)}
EMPS = {"m": 95.1, "fv": 203.5, "fs": 20.4, "off": -3.2}  # as in every_sample.emps_run
STEEL = 1.983  # kg, the payload of the Orthoglide's logs
ROWS = 6000  # FIGAROH's weights are a dense matrix of rows by rows
NONE = "-"


@dataclass(frozen=True)
class Case:
    """A robot's logs as gtau reads and identifies them."""

    name: str
    robot: str
    data: Path
    folder: Path
    result: Result
    runs: list[Run]
    checks: list[Run]


@dataclass(frozen=True)
class Cells:
    """What one tool makes of a case: torques along each log not used, estimates, intervals, lines and seconds."""

    errors: list[np.ndarray] | str  # of each log (n, 2)
    estimates: str
    interval: str
    lines: int | str
    seconds: float | None


def emps(data: Path, folder: Path) -> str:
    """Two simulated logs of the EMPS, one to identify and one to check."""
    for seed in range(2):
        run = every_sample.emps_run("carriage", seed)
        table = {"t": run.time, "q": run.position[:, 0], "f": run.command[:, 0]}
        pl.DataFrame(table).write_csv(folder / f"emps-{seed}.csv")
    signals = {"carriage": "q"}, ("torque", {"carriage": "f"})
    return experiment_file("emps", "t", *signals, [(folder / "emps-0.csv", "")], [(folder / "emps-1.csv", "")])


def lines_of(*functions: Callable) -> int:
    """Lines of code of functions, without comments and docstrings, as Python's own formatter breaks them."""
    total = 0
    for function in functions:
        tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and ast.get_docstring(node):
                del node.body[0]
        total += len([line for line in ast.unparse(tree).splitlines() if line.strip()])
    return total


def compared(pairs: Sequence[tuple[float, float | None, float]]) -> tuple[str, str]:
    """Estimates beside the truth, and how many intervals hold, of (value, half the interval, truth)."""
    known = [(value, half, truth) for value, half, truth in pairs if np.isfinite(truth)]
    estimates = ", ".join(f"{value:.4g}" + (f" ± {half:.2g}" if half else "") for value, half, _ in pairs)
    given = [abs(value - truth) <= half for value, half, truth in known if half is not None]
    return estimates, f"{sum(given)} of {len(given)} hold" if given else "none given"


def gtau(case: Case, seconds: float, lines: int) -> Cells:
    """What gtau finds, with default settings."""
    result, pairs, more = case.result, [], ""
    if case.name in GAINS:
        gains = result.drive_gains.values()
        pairs = [(g.value, g.half_interval(), truth) for g, truth in zip(gains, GAINS[case.name], strict=True)]
    elif case.name == "emps":
        kinds = {name.split("_")[0]: each for name, each in result.parameters.items()}
        pairs = [(kinds[k].value, kinds[k].half_interval(), EMPS[k]) for k in EMPS if k in kinds and kinds[k].value]
    estimates, holds = compared(pairs) if pairs else ("no truth", "given, no truth")
    if case.name == "orthoglide":
        payload = weighed(case).parameters["m"]
        more = f"; weighs 1.136 kg as {payload.value:.3f} ± {payload.half_interval():.3f}"
    if case.name == "ur10e":
        more = "; the controller's: " + ", ".join(f"{truth:.4g}" for truth in GAINS[case.name][:-1])
        holds += " by the controller's gains"
    errors = [every_sample.errors_of(result, run) for run in case.checks]
    return Cells(errors, estimates + more, holds, lines, seconds)


def weighed(case: Case) -> PayloadEstimate:
    """The Orthoglide's second payload, whose mass gtau is not told."""
    logs, path = case.data / "orthoglide_sim", case.folder / "second.yaml"
    joints = ["11", "12", "13"]
    signals = {j: f"q{j}" for j in joints}, ("current", {j: f"v{k}" for k, j in enumerate(joints, start=1)})
    runs = [(logs / "second_payload_unloaded_reference.csv", "")]
    runs += [(logs / "second_payload_1136g.csv", ", payload: {name: second}")]
    path.write_text(experiment_file("orthoglide", "t", *signals, runs, []), encoding="utf-8")
    return weigh(case.result, path)[0]


def by_hand(case: Case) -> Cells:
    """The script of a good engineer; of a parallel robot the longer one that closes the loops and finds gains."""
    result = case.result
    if case.name == "orthoglide":
        logs = case.data / "orthoglide_sim"
        for k, name in enumerate(("1_unloaded", "3_loaded_1983g")):
            pl.read_csv(logs / f"exciting_{name}.csv").write_parquet(case.folder / f"{k}.parquet")
        begin = process_time()
        gains = peers.gains_by_hand(result.robot, case.folder, STEEL, result.preparation.bandwidth * 5, 10, 20)
        pairs = [(gain, None, truth) for gain, truth in zip(gains, GAINS[case.name], strict=True)]
        lines = lines_of(peers.PinocchioLoop, peers.read_by_hand, peers.base_columns, peers.gains_by_hand)
        return Cells("gains only", *compared(pairs), lines, process_time() - begin)
    tried = []
    for mask in every_sample.MASKS:
        begin = process_time()
        predict, chi = every_sample.script(result, case.runs, mask)
        seconds = process_time() - begin
        tried.append([every_sample.errors_of(result, run, predict(run)) for run in case.checks])
    whole = np.log(tried).mean(axis=(1, 2))  # (masks, 2)
    errors = [np.stack([tried[whole[:, k].argmin()][at][:, k] for k in (0, 1)], axis=1) for at in range(len(tried[0]))]
    pairs = [(value, None, EMPS[k]) for k, value in zip(EMPS, (chi[0] + chi[10], *chi[11:14]), strict=True)]
    estimates, holds = compared(pairs) if case.name == "emps" else (no_gains(case), "none given")
    return Cells(errors, estimates, holds, lines_of(every_sample.script, peers.base_columns), seconds)


def no_gains(case: Case) -> str:
    return "no gains (gtau's were given)" if case.name in GAINS else "no truth"


def arm_of(result: Result) -> tuple[Robot, np.ndarray]:
    """The arm without motors of their own, and joint speeds per motor speed (n, n)."""
    n = len(result.idm.actuated)
    joints = tuple(replace(joint, actuated=True) for joint in result.robot.joints[:n])
    robot = result.robot if len(result.robot.joints) == n else replace(result.robot, joints=joints, couplings=())
    return robot, result.friction_law.ratios[:n]


def states(result: Result, run: Run) -> np.ndarray:
    """Positions (N, n) of the arm's joints."""
    q = np.asarray(run.position)
    zero = np.zeros_like(q)
    return result.idm.motion(*result.idm.samples(q, zero, zero)).c[: q.shape[1]].T


def figaroh(case: Case) -> Cells:
    """FIGAROH by its public functions, on the log without payload."""
    result, run = case.result, case.runs[0]
    if result.robot.closures:
        return Cells("no loops", "no gains", NONE, NONE, None)
    if len(result.gains) == 1:  # its regressor indexes rows, of which Pinocchio gives it none
        return Cells("no: an IndexError with one joint", NONE, NONE, NONE, None)
    robot, ratios = arm_of(result)
    chi = peers.random_parameters(robot, np.random.default_rng(1))
    q, n = states(result, run), len(ratios)
    tau = (result.gains * np.asarray(run.command)[:, :n]) @ np.linalg.inv(ratios)
    factor = min(max(result.preparation.decimator.factor, 2), 10)
    thin = int(np.ceil(n * len(q) / factor / ROWS))
    begin = process_time()
    fit = peers.figaroh_fit(
        robot, chi, q, tau, 1 / run.rate, result.preparation.bandwidth * 5, factor, thin, np.linalg.inv(ratios)
    )
    seconds = process_time() - begin
    errors = [every_sample.errors_of(result, each, fit.predict(states(result, each)) @ ratios) for each in case.checks]
    return Cells(errors, no_gains(case), "given, no truth", lines_of(peers.figaroh_fit), seconds)


def mujoco_sysid(case: Case) -> Cells:
    """mujoco.sysid, on windows of the log without payload."""
    result, run = case.result, case.runs[0]
    if case.name not in ROLLED:
        return Cells("not run", NONE, NONE, NONE, None)
    robot, ratios = arm_of(result)

    def filtered(run: Run) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        sos = butter(4, min(2 * result.preparation.bandwidth * 5 / run.rate, 0.9), output="sos")
        q = sosfiltfilt(sos, states(result, run), axis=0)
        qd = np.gradient(q, 1 / run.rate, axis=0)
        return q, qd, np.gradient(qd, 1 / run.rate, axis=0)

    q, qd, _ = filtered(run)
    tau = (result.gains * np.asarray(run.command)[:, : len(ratios)]) @ np.linalg.inv(ratios)
    every = max(1, round(rollouts.STEP * run.rate))
    begin = process_time()
    fit = rollouts.sysid_fit(robot, *(each[::every] for each in (run.time, q, qd, tau)))
    seconds = process_time() - begin
    errors = [every_sample.errors_of(result, each, fit.predict(*filtered(each)) @ ratios) for each in case.checks]
    estimates, holds = no_gains(case), "given, no truth"
    if case.name == "emps":
        kinds = {"mass": 1, "damping": 1, "frictionloss": 1, "biasprm": -1}
        found = [(sign * fit.values[f"{k}_carriage"][0], fit.halves[f"{k}_carriage"][0]) for k, sign in kinds.items()]
        estimates, holds = compared([(*pair, truth) for pair, truth in zip(found, EMPS.values(), strict=True)])
    return Cells(errors, estimates, holds, lines_of(rollouts.sysid_fit), seconds)


def case_of(entry: Entry, data: Path, folder: Path) -> tuple[Case, float, int]:
    """Identify by gtau; processor time, and lines of the files that its user writes, and the command."""
    path = folder / "experiment.yaml"
    path.write_text(entry.write(data, folder), encoding="utf-8")
    lines = 1 + sum(len(each.read_text(encoding="utf-8").splitlines()) for each in folder.glob("*.yaml"))
    begin = process_time()
    experiment = read_experiment(path)
    result = identify(experiment)
    seconds = process_time() - begin
    runs, checks = (
        [run.ordered(result.idm.actuated) for run in read_runs(experiment, listed)]
        for listed in (experiment.runs, experiment.validation)
    )
    return Case(entry.name, entry.robot, data, folder, result, runs, checks), seconds, lines


def row(case: Case, tool: str, cells: Cells) -> list[str]:
    """One row of the table; errors are geometric means over joints and logs, then those of each joint."""
    parts = [cells.errors, cells.errors]
    if not isinstance(cells.errors, str):
        joints = np.exp(np.mean(np.log(cells.errors), axis=0)).T  # (2, n)
        parts = [f"{np.exp(np.log(values).mean()):.3g}" for values in joints]
        if joints.shape[1] > 1:
            each = (", ".join(f"{value:.3g}" for value in values) for values in joints)
            parts = [f"{mean} ({text})" for mean, text in zip(parts, each, strict=True)]
    seconds = NONE if cells.seconds is None else f"{cells.seconds:.2g}"
    return [case.robot, tool, *parts, cells.estimates, cells.interval, str(cells.lines), seconds]


HEADER = (
    "logs",
    "tool",
    "error on logs not used, all samples, %",
    "away from reversals, %",
    "gains and masses",
    "95 % intervals",
    "lines",
    "s",
)


def of_page(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return the table of the page: means over the joints, of all samples and without reversals, by tool."""
    means = {tuple(cells[:2]): [cell.split(" (")[0] for cell in cells[2:4]] for cells in rows[1:] if cells[7] != NONE}
    logs, tools = (list(dict.fromkeys(names)) for names in zip(*means, strict=True))
    shown = [[name, *(" / ".join(dict.fromkeys(means.get((name, tool), [NONE]))) for tool in tools)] for name in logs]
    return [line(["logs", *tools]), line(["---"] * (1 + len(tools))), *map(line, shown)]


TOOLS = {"script": (by_hand, "pinocchio"), "FIGAROH": (figaroh, "figaroh"), "mujoco.sysid": (mujoco_sysid, "absl")}


def main() -> None:
    """Run all tools on all logs and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument("--only", nargs="+", metavar="NAME", choices=NAMES, default=NAMES)
    parser.add_argument("--update", type=Path, metavar="PAGE")
    arguments = parser.parse_args()
    entries = {each.name: each for each in ENTRIES}
    entries["emps"] = Entry("emps", "EMPS, simulated", "force", "", emps)
    rows: list[Sequence[str]] = [HEADER]
    for name in arguments.only:
        with tempfile.TemporaryDirectory() as folder:
            case, seconds, written = case_of(entries[name], arguments.data.resolve(), Path(folder))
            rows.append(row(case, "gtau", gtau(case, seconds, written)))
            print(line(rows[-1]), flush=True)
            for tool, (work, package) in TOOLS.items():
                cells = work(case) if find_spec(package) else Cells("not installed", NONE, NONE, NONE, None)
                rows.append(row(case, tool, cells))
                print(line(rows[-1]), flush=True)
    if arguments.update:
        update(arguments.update, MARKS, of_page(rows))
        write_csv(arguments.update.with_name("benchmarks") / "peers.csv", rows)


if __name__ == "__main__":
    main()

"""Identify every shared log with default settings and print what comes out beside what is published.

    python benchmarks/zoo.py [--only NAME ...] [--update docs/evidence/index.md]

The logs lie beside the checkout (``../shared/data``, or ``--data``); each folder has a README with source, columns and
references. Nothing is set by hand: where logs cannot give what is asked, the row shows the sentence that a user gets.
``--update`` puts the table between the marks in a page, and every joint into zoo/logs.csv beside it.
"""

# ruff: noqa: E501 (rows of a table)
from __future__ import annotations

import argparse
import re
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import floor, log10
from pathlib import Path
from time import perf_counter

import numpy as np
from table import write_csv

from gtau.errors import GtauError
from gtau.estimation.experiment_runs import read_runs
from gtau.result import Result, identify
from gtau.signals.reading.experiment import Experiment, read_experiment

MARKS = "<!-- zoo: begin -->", "<!-- zoo: end -->"
PANDA = ((0, 0, 0.333), (0, -1, 0), (0, 1, 0.316), (0.0825, 1, 0), (-0.0825, -1, 0.384), (0, 1, 0), (0.088, 1, 0))
XMATE3 = ((0, 0, 0.3415), (0, -1, 0), (0, 1, 0.394), (0, -1, 0), (0, 1, 0.366), (0, -1, 0), (0, 1, 0.2503))


@dataclass(frozen=True)
class Entry:
    """A row of the zoo: how its experiment file is written, and what is published to compare with."""

    name: str
    robot: str
    identified: str
    reference: str
    write: Callable[[Path, Path], str]


def main() -> None:
    """Run the rows and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    parser.add_argument("--only", nargs="+", metavar="NAME", choices=[each.name for each in ENTRIES])
    parser.add_argument("--update", type=Path, metavar="PAGE")
    arguments = parser.parse_args()
    rows: list[Sequence[str]] = [HEADER]
    for entry in ENTRIES:
        if arguments.only and entry.name not in arguments.only:
            continue
        rows.append(row(entry, arguments.data))
        print(line(rows[-1]), flush=True)
    if arguments.update:
        update(arguments.update, MARKS, of_page(rows))
        write_csv(arguments.update.with_name("zoo") / "logs.csv", rows)


def update(path: Path, marks: tuple[str, str], lines: list[str]) -> None:
    """Put a table's lines between the marks in a page."""
    page = path.read_text(encoding="utf-8")
    begin, end = (page.index(mark) for mark in marks)
    table = "\n".join([marks[0], "", *lines, "", ""])
    path.write_text(page[:begin] + table + page[end:], encoding="utf-8")


HEADER = (
    "robot",
    "logs",
    "identified",
    "error on logs not used, % of rms",
    "published, or weighed",
    "what gtau says",
    "s",
)
ELSEWHERE = (
    "orthoglide",
    "ur10e",
    "tx40",
    "panda",
    "aliengo",
    "upv",
    "upv_gains",
)  # on the board, or on the robot's page
SHOWN = 0, 2, 3, 4  # of these, on the page; the rest in logs.csv


def line(cells: Sequence[str]) -> str:
    """Write a row of a table as Markdown."""
    return f"| {' | '.join(cells)} |"


def of_page(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return the table of the page: what others published, with the best and the worst joint in place of all.

    Rows that stand elsewhere are left out.
    """
    head, *body = ([cells[k] for k in SHOWN] for cells in rows)
    body = [[*cells[:2], *map(extremes, cells[2:])] for cells in body if cells[3] != "none published"]
    elsewhere = {entry.robot for entry in ENTRIES if entry.name in ELSEWHERE}
    body = [cells for cells in body if cells[0] not in elsewhere]
    return [line(head), line(["---"] * len(head)), *map(line, body)]


def extremes(cell: str) -> str:
    """Return the smallest and the largest of the errors in a cell, with its other words; gains as they are."""
    listed = re.search(r"^(?:fit: )?[\d.]+(, [\d.]+){3,}(?= %|$)", cell)
    if listed is None:
        return cell
    errors = sorted(re.findall(r"[\d.]+", listed[0]), key=float)
    return cell.replace(listed[0].removeprefix("fit: "), f"{errors[0]} to {errors[-1]}")


def row(entry: Entry, data: Path) -> list[str]:
    """One row of the table."""
    begin = perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "experiment.yaml"
        path.write_text(entry.write(data, Path(folder)), encoding="utf-8")
        try:
            experiment = read_experiment(path)
            found, errors, rates = run(experiment)
        except GtauError as error:
            sentence = re.sub(r"\S*/", "", str(error))
            return [entry.robot, "", entry.identified, "", entry.reference, f"refused: {sentence}", ""]
    preparation = found.preparation
    logs = (
        f"{len(experiment.runs)} + {len(experiment.validation)}, {' / '.join(sorted({f'{rate:.4g}' for rate in rates}))} "
        f"Hz; {preparation.bandwidth:.2g} Hz, {'no filter' if preparation.cutoff is None else f'{preparation.cutoff:.2g} Hz'}"
        f", 1 in {preparation.decimator.factor}"
    )
    identified, seconds = f"{entry.identified}{numbers(found)}", f"{perf_counter() - begin:.0f}"
    return [entry.robot, logs, identified, errors, entry.reference, said(found), seconds]


def run(experiment: Experiment) -> tuple[Result, str, list[float]]:
    """The result, the torque errors of each joint on the logs that were not used, and the logs' rates."""
    found = identify(experiment)
    checks = read_runs(experiment, experiment.validation)
    rates = [each.rate for each in (*read_runs(experiment, experiment.runs), *checks)]
    if not checks:
        return found, "fit: " + ", ".join(f"{each.relative:.2g}" for each in found.residuals), rates
    errors = np.mean([[each.relative for each in found.validate(check)] for check in checks], axis=0)
    return found, ", ".join(f"{each:.2g}" for each in errors), rates


def numbers(found: Result) -> str:
    """Gains and masses that were found."""
    parts = []
    if found.kind == "current":
        parts.append(", ".join(rounded(gain.value, gain.std) for gain in found.drive_gains.values()))
    for payload in found.payloads:
        mass = payload.parameters.get("m")
        if mass is not None and mass.value is not None and mass.std:
            parts.append(f"{payload.name} {mass.value:.3f} ({mass.std:.3f}) kg")
    return ": " + "; ".join(parts) if parts else ""


def rounded(value: float, std: float) -> str:
    """Write a value to the first digit of its standard deviation."""
    digits = -floor(log10(std))
    return f"{round(value, digits):.{max(digits, 0)}f} ({round(std, digits):.{max(digits, 0)}f})"


def said(found: Result) -> str:
    """Kinds of the notes, each once."""
    return "; ".join(dict.fromkeys(str.__str__(note.kind) for note in found.notes)) or "nothing"


def experiment_file(
    robot: str, time: str, position: dict[str, str], command: tuple[str, dict[str, str]], runs: list, checks: list
) -> str:
    """Text of an experiment file; runs and checks are paths with what else stands beside them."""

    def group(columns: dict[str, str]) -> str:
        return "{" + ", ".join(f"{joint}: '{column}'" for joint, column in columns.items()) + "}"

    def listed(entries: list) -> str:
        return "".join(f"  - {{log: '{path}'{more}}}\n" for path, more in entries)

    return (
        f"robot: '{robot}'\nsignals:\n  time: {time}\n  position: {group(position)}\n  {command[0]}: {group(command[1])}\n"
        f"runs:\n{listed(runs)}" + (f"validation:\n{listed(checks)}" if checks else "")
    )


def arm(folder: Path, name: str, rows: tuple) -> Path:
    """A robot file of an arm by its modified Denavit-Hartenberg parameters; angles in right angles."""
    lines = [f"robot: {name}", "source: the folder's README", "joints:"]
    for k, (a, alpha, d) in enumerate(rows, start=1):
        before = f"j{k - 1}" if k > 1 else "ground"
        lines.append(f"  j{k}: {{antecedent: {before}, d: {a}, alpha: {alpha}*pi/2, r: {d}, theta: q, actuated: true}}")
    path = folder / f"{name}.yaml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def numbered(prefix: str, joints: list[str], first: int = 1) -> dict[str, str]:
    """Columns of joints: a prefix and a number."""
    return {joint: f"{prefix}{k}" for k, joint in enumerate(joints, start=first)}


SEVEN = [f"j{k}" for k in range(1, 8)]


def orthoglide(data: Path, folder: Path) -> str:
    """Logs of a simulated Orthoglide whose truth is known."""
    joints, logs, steel = ["11", "12", "13"], data / "orthoglide_sim", ", payload: {name: steel, mass: 1.983}"
    runs = [(logs / f"exciting_{k}_{load}.csv", steel if k > 2 else "") for k, load in ORTHOGLIDE]
    signals = {j: f"q{j}" for j in joints}, ("current", {j: f"v{k}" for k, j in enumerate(joints, start=1)})
    return experiment_file("orthoglide", "t", *signals, runs, [(logs / "validation_loaded_1983g.csv", steel)])


ORTHOGLIDE = ((1, "unloaded"), (2, "unloaded"), (3, "loaded_1983g"), (4, "loaded_1983g"))


def ur10e(data: Path, folder: Path) -> str:
    """A UR10e without and with a payload, and three further logs."""
    joints = ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"]
    names, logs = [f"{joint}_joint" for joint in joints], data / "ur10e"
    runs = [
        (logs / "ur-20_02_19_14harm50sec.csv", ""),
        (logs / "ur-20_02_19_14harm50secLoad.csv", ", payload: {name: disc, mass: 2.805}"),
    ]
    checks = [(logs / f"ur-20_02_{name}harm.csv", "") for name in ("10-30sec_12", "12-40sec_12", "06-20sec_10")]
    return experiment_file("ur10e", "'1'", numbered("", names, 2), ("current", numbered("", names, 14)), runs, checks)


def tx40(data: Path, folder: Path) -> str:
    """A TX40 at 5 kHz: identified on the first two thirds."""
    motors, logs = [f"motor_{k}" for k in range(1, 7)], data / "tx40"
    pair = f"[{logs / 'pos_read_data.csv'}, {logs / 'curr_data.csv'}]"
    text = experiment_file("staubli-tx40", "{rate: 5000}", numbered("Joint_", motors), ("torque", numbered("Joint_", motors)), [(pair, ", to: 6")], [(pair, ", from: 6")])  # fmt: skip
    return text.replace("'[", "[").replace("]'", "]")


def panda(data: Path, folder: Path) -> str:
    """A Panda polled at 1 kHz: one value a line, written as a table; identified on the first 70 %."""
    values = [np.loadtxt(data / "panda" / f"exciting_traj_{name}.txt") for name in ("time", "positions", "torques")]
    table = np.column_stack([values[0], values[1].reshape(-1, 7), values[2].reshape(-1, 7)])
    header = ",".join(["t", *(f"q{k}" for k in range(1, 8)), *(f"tau{k}" for k in range(1, 8))])
    np.savetxt(folder / "panda.csv", table, delimiter=",", header=header, comments="", fmt="%.9g")
    log, cut = folder / "panda.csv", float(values[0][int(0.7 * len(values[0]))])
    signals = numbered("q", SEVEN), ("torque", numbered("tau", SEVEN))
    return experiment_file(str(arm(folder, "panda-arm", PANDA)), "t", *signals, [(log, f", to: {cut}")], [(log, f", from: {cut}")])  # fmt: skip


def panda_rosbag2(data: Path, folder: Path) -> str:
    """Another Panda at 30 Hz: identified on the first 70 %."""
    log = data / "panda_rosbag2" / "panda_exciting_trajectory.csv"
    signals = numbered("q_fer_joint", SEVEN), ("torque", numbered("effort_fer_joint", SEVEN))
    return experiment_file(str(arm(folder, "panda-arm", PANDA)), "t", *signals, [(log, ", to: 17")], [(log, ", from: 17")])  # fmt: skip


def dvrk(kind: str, loads: list[tuple[str, str]]) -> Callable[[Path, Path], str]:
    """A da Vinci arm with weights."""

    def write(data: Path, folder: Path) -> str:
        joints, logs = ["yaw", "pitch", "insertion"], data / "dvrk_psm"
        runs = [(logs / f"one_{name}_results.csv", load) for name, load in loads]
        signals = numbered("q", joints), (kind, numbered("tau", joints))
        return experiment_file(str(logs / "psm_front.yaml"), "{rate: 200}", *signals, runs, [(logs / "two_results.csv", "")])  # fmt: skip

    return write


def kuka(data: Path, folder: Path) -> str:
    """A KUKA LBR Med 7; the rate of its log is not stated and taken as 100 Hz."""
    joints, log = [f"A{k}" for k in range(1, 8)], data / "kuka_med7" / "measurements.csv"
    signals = numbered("q_", joints, 0), ("torque", numbered("tau_", joints, 0))
    return experiment_file(str(data / "kuka_med7" / "med7dock.urdf"), "{rate: 100}", *signals, [(log, "")], [])  # fmt: skip


def rokae(column: str) -> Callable[[Path, Path], str]:
    """A Rokae xMate 3 Pro, identified on the first 70 %."""

    def write(data: Path, folder: Path) -> str:
        log, signals = (
            data / "rokae_xmate3pro" / "excit.csv",
            (numbered("q", SEVEN), ("torque", numbered(column, SEVEN))),
        )
        return experiment_file(str(arm(folder, "xmate3", XMATE3)), "t", *signals, [(log, ", to: 14")], [(log, ", from: 14")])  # fmt: skip

    return write


def rokae_gains(data: Path, folder: Path) -> str:
    """The same arm: gains from motor torques and joint torque sensors, without a payload; all of the log."""
    log, sensors = data / "rokae_xmate3pro" / "excit.csv", numbered("torque", SEVEN)
    signals = numbered("q", SEVEN), ("current", numbered("motor", SEVEN))
    text = experiment_file(str(arm(folder, "xmate3", XMATE3)), "t", *signals, [(log, "")], [])
    listed = ", ".join(f"{joint}: '{column}'" for joint, column in sensors.items())
    return text.replace("runs:", f"  joint_torque: {{{listed}}}\nruns:")


def xmate7p(subfolder: str, rate: int) -> Callable[[Path, Path], str]:
    """A Rokae xMate 7 Pro: two trajectories, and a third to check."""

    def write(data: Path, folder: Path) -> str:
        joints, logs = [f"joint{k}" for k in range(1, 8)], data / "xmate7p" / subfolder
        paths = [(logs / f"xMate7p_traj{k}_results.csv", "") for k in (1, 2, 3)]
        signals = numbered("", joints), ("torque", numbered("", joints, 22))
        return experiment_file(str(data / "xmate7p" / "XM7p.urdf"), f"{{rate: {rate}}}", *signals, paths[:2], paths[2:])

    return write


def upv(data: Path, folder: Path) -> str:
    """A real parallel robot: three logs, and a fourth to check."""
    legs, logs = {"p1": 0, "p2": 1, "p3": 2, "p4": 3}, data / "upv_parallel"
    paths = [(logs / f"4dof_N_{name}.csv", "") for name in "abcd"]
    signals = {leg: f"q{k}" for leg, k in legs.items()}, ("torque", {leg: f"u{k}" for leg, k in legs.items()})
    return experiment_file(str(logs / "robot_5p_config1.yaml"), "t", *signals, paths[:3], paths[3:])


def upv_gains(data: Path, folder: Path) -> str:
    """The same robot: gains of its forces from CAD masses of the platform and of the legs' rods, without a payload."""
    text = upv(data, folder).replace("  torque:", "  current:")
    return text + "priors:\n" + "".join(f"  {name}: {{value: {value}, std: {std}}}\n" for name, value, std in UPV_CAD)


UPV_CAD = (  # kg and kg m2, pr_config_params.yaml; the standard deviations are ours: 2 % of a mass, 10 % of an inertia
    ("m_platform", 8.5558, 0.17),
    ("zz_platform", 0.46, 0.046),
    ("m_p1", 1.262, 0.025),
    ("m_p2", 1.262, 0.025),
    ("m_p3", 1.262, 0.025),
    ("m_p4", 1.845, 0.037),
    ("ia_platform", 0.0, 1e-4),
)


def aliengo(data: Path, folder: Path) -> str:
    """A quadruped hung up: its floating base is fixed."""
    joints = [f"{leg}_{part}_joint" for leg in ("FL", "FR", "RL", "RR") for part in ("hip", "thigh", "calf")]
    signals, log = (
        (numbered("q", joints, 0), ("torque", numbered("tau_pd", joints, 0))),
        data / "aliengo" / "aliengo.csv",
    )
    text = experiment_file("ROBOT", "t", *signals, [(log, "")], [])
    return text.replace("robot: 'ROBOT'", f"robot: {{file: '{data / 'aliengo' / 'aliengo.xml'}', base: fixed}}")


G105, G205 = ", payload: {name: 105 g%s}", ", payload: {name: 205 g%s}"
ENTRIES = (
    Entry("orthoglide", "Orthoglide, simulated elsewhere", "gains, N per A", "true 2170, 2100, 2070", orthoglide),
    Entry("ur10e", "UR10e, January pair", "gains, N m/A", "controller 11.98, 11.98, 9.84, 10.76, 10.76, -", ur10e),
    Entry("tx40", "Stäubli TX40", "torques of the motors", "6.7, 6.4, 10.8, 9.4, 30, 22 % (WLS, last third)", tx40),
    Entry("panda", "Franka Panda, polled", "link torques", "8.7, 1.4, 3.7, 1.2, 6.8, 3.4, 19.6 % (WLS behind 10 Hz)", panda),
    Entry("panda_rosbag2", "Franka Panda, ROS", "link torques", "none published", panda_rosbag2),
    Entry("dvrk", "da Vinci PSM", "gains of nominal currents", "near 1 by make; 1.12 (0.09), 1.02 (0.08), 0.75 (0.07) behind a 15 Hz filter by hand", dvrk("current", [("no_weight", ""), ("205_grams_parallel", G205 % ", mass: 0.205")])),
    Entry("dvrk_weigh", "da Vinci PSM", "masses", "0.105 and 0.205 kg on the scales", dvrk("torque", [("no_weight", ""), ("105_grams_parallel", G105 % ""), ("205_grams_parallel", G205 % "")])),
    Entry("kuka_med7", "KUKA LBR Med 7", "link torques", "none published", kuka),
    Entry("rokae_sensor", "Rokae xMate 3 Pro, sensors", "link torques", "none published", rokae("torque")),
    Entry("rokae_motor", "Rokae xMate 3 Pro, motors", "torques of the motors", "none published", rokae("motor")),
    Entry("rokae_gains", "Rokae xMate 3 Pro, motors and sensors", "gains, N m/N m", "111, 138, 113, 112, 82, 86, - (motor torques fitted to the sensors' of the same joint)", rokae_gains),
    Entry("xmate7p", "Rokae xMate 7 Pro, 50 Hz", "link torques", "none published", xmate7p("", 50)),
    Entry("xmate7p_1k", "Rokae xMate 7 Pro, 1 kHz", "link torques", "none published", xmate7p("50Hz_5periods", 1000)),
    Entry("upv", "UPV 3UPS+RPU", "forces of the legs", "12.1, 13.4, 16.2, 11.3 % (fit of the three, without a filter)", upv),
    Entry("upv_gains", "UPV 3UPS+RPU, CAD masses", "gains of forces", "1 by the maker's gains", upv_gains),
    Entry("aliengo", "Unitree Aliengo", "torques of the commands", "friction as PACE's", aliengo),
)  # fmt: skip


if __name__ == "__main__":
    main()

"""Check that a change of the code leaves every number of some forty identifications as it was.

    python benchmarks/equality.py make FOLDER                # write experiments: logs, robots, experiment files
    python benchmarks/equality.py dump FOLDER NUMBERS.json   # identify all of them, and keep what comes out
    python benchmarks/equality.py compare OLD.json NEW.json  # list what differs, and end with 1 where something does

The experiments are made once, with the code that is the reference; a later code reads the same files. They cover every
robot of the catalog (simulated), each estimator, payloads, priors, torque sensors, floating bases, wrenches,
temperatures, poses, and the measured logs of ``../shared/data`` where these lie beside the checkout.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path
from time import process_time

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path += [str(ROOT / "tests" / "support"), str(ROOT / "tests" / "simulation"), str(ROOT / "benchmarks")]
TOLERANCE = 1e-6
"""Relative to the largest of a value and its standard deviation; iterations stop at 1e-8, rounding is below."""
ESTIMATORS = ("ml", "huber", "iv", "didim", "2sls", "tls", "wls", "ols")
SIMULATED = {  # share of the limits
    "3-rrr": 0.4, "delta": 0.9, "emps": 0.9, "five-bar": 0.9, "gough-stewart": 0.35, "orthoglide": 0.9,
    "palletiser": 0.4, "puma560": 0.4, "staubli-tx40": 0.4, "test-bench": 0.9, "ur10e": 0.4,
}  # fmt: skip
LOGS = ("ur10e", "tx40", "panda", "dvrk", "dvrk_weigh", "kuka_med7", "rokae_gains", "xmate7p", "upv", "upv_gains")


def make(folder: Path) -> None:
    """Write one folder for each experiment."""
    from five_bar_logs import Plant, write_experiment
    from floating_logs import AT_HOOK, AT_SOLE, POSE, experiment, simulated
    from simulate_identify import BLOCK
    from test_control import described
    from zoo import ENTRIES

    from gtau.simulation.simulate import simulate

    def new(name: str) -> Path:
        (folder / name).mkdir(parents=True, exist_ok=True)
        return folder / name

    for name, share in SIMULATED.items():
        out = new(f"simulated-{name}")
        document, _, _ = described(
            name, 5, 6.0, share, {"parameters": BLOCK} if name in ("ur10e", "gough-stewart") else {}
        )
        document["robot"] = limited(name, out)
        (out / "simulation.yaml").write_text(json.dumps(document), encoding="utf-8")
        simulate(out / "simulation.yaml", out, lambda *_: None)
    write_experiment(new("five-bar"), Plant(noise=0.02))
    warm(new("temperature"))
    posed(new("poses"))
    base = f"body: trunk, {POSE}"
    experiment(new("floating-hook"), f"{{{base}, wrenches: [{AT_HOOK}]}}", simulated(1))
    experiment(new("floating-sole"), f"{{{base}}}\n  wrenches: [{AT_SOLE}]", simulated(1, foot=1.0))
    flange(new("wrench-flange"))
    data = ROOT.parent / "shared" / "data"
    for entry in ENTRIES if data.is_dir() else ():
        if entry.name in ("orthoglide", *LOGS):
            out = new(f"log-{entry.name}")
            (out / "experiment.yaml").write_text(entry.write(data.resolve(), out), encoding="utf-8")
    if data.is_dir():
        by_method(folder)


def limited(name: str, folder: Path) -> str:
    """Return a robot of the catalog, or the file of one with limits where the catalog states none."""
    from gtau.model.home import load_robot
    from gtau.robots.readers.native import write_native
    from gtau.robots.robot import Limits

    robot, limits = load_robot(name), Limits((-1.0, 1.0), 2.0, 10.0)
    if all(robot.joint(joint).limits.velocity for joint in robot.actuated):
        return name
    joints = tuple(replace(each, limits=limits) if each.name in robot.actuated else each for each in robot.joints)
    write_native(replace(robot, joints=joints), folder / "robot.yaml")
    return "robot.yaml"


def by_method(folder: Path) -> None:
    """Write the Orthoglide's experiment once more for each estimator; ``method.txt`` names it."""
    text = (folder / "log-orthoglide" / "experiment.yaml").read_text(encoding="utf-8")
    for method in (*ESTIMATORS, "paper", "consistent"):
        out = folder / f"orthoglide-{method}"
        out.mkdir(exist_ok=True)
        gains = "prior_gains: {'11': 2001, '12': 2001, '13': 2001}\n"
        (out / "experiment.yaml").write_text(text + gains, encoding="utf-8")
        (out / "method.txt").write_text(method, encoding="utf-8")


def warm(folder: Path) -> None:
    """Write logs of a five-bar whose friction falls as it warms up."""
    from five_bar_logs import EXPERIMENT, GAINS, STEEL, Plant, path, write_log

    for seed, (name, payload) in enumerate({"free": None, "loaded": STEEL, "check": STEEL}.items(), start=1):
        run = Plant(noise=0.02).run(name, 20.0, seed=seed, **({"payload": payload} if payload else {}))
        heat = 25 + 15 * (1 - np.exp(-2 * run.time / run.time[-1]))
        friction = -0.02 * (heat[:, None] - 30) * (path(run.time, seed)[1] + np.sign(path(run.time, seed)[1]))
        file = write_log(folder / f"{name}.csv", replace(run, command=run.command + friction / np.array(GAINS)))
        lines = file.read_text().splitlines()
        more = ["temp", *(f"{value:.5f}" for value in heat)]
        file.write_text("".join(f"{line},{value}\n" for line, value in zip(lines, more, strict=True)))
    (folder / "experiment.yaml").write_text(EXPERIMENT.replace("signals: {", "signals: {temperature: temp, "))


def posed(folder: Path) -> None:
    """Write logs of a five-bar beside the poses of its platform."""
    from five_bar_logs import Plant, five_bar, write_experiment

    from gtau.model.lengths import variable_geometry

    write_experiment(folder, Plant(noise=0.02))
    model, rng = five_bar(), np.random.default_rng(0)
    geometry = variable_geometry(model.robot, model.robot.tool)
    for name in ("free", "loaded", "check"):
        lines = (folder / f"{name}.csv").read_text().splitlines()
        q = np.array([[float(cell) for cell in line.split(",")[1:3]] for line in lines[1:]])
        pose = geometry.pose(model.path(q.T.copy()), np.zeros(len(geometry.constants))).position
        pose = np.asarray(pose).reshape(len(q), 3) + 1e-4 * rng.standard_normal((len(q), 3))
        more = ["px,py,pz", *(f"{x:.6f},{y:.6f},{z:.6f}" for x, y, z in pose)]
        (folder / f"{name}.csv").write_text("".join(f"{a},{b}\n" for a, b in zip(lines, more, strict=True)))
    file = folder / "experiment.yaml"
    pose_columns = "signals: {pose: {source: controller, position: {x: px, z: pz}}, "
    file.write_text(file.read_text().replace("signals: {", pose_columns))


def flange(folder: Path) -> None:
    """Write logs of a fixed arm whose tool is on a force sensor."""
    import polars as pl
    from floating_logs import AT_SOLE, experiment, simulated

    file = experiment(folder, "", simulated(1, moving=False), f"  wrenches: [{AT_SOLE}]")
    pl.DataFrame(simulated(1001, moving=False, tool=True).columns).write_csv(folder / "tool.csv")
    file.write_text(file.read_text().replace("runs: [", "runs: [{log: tool.csv}, "))


def numbers(folder: Path) -> dict[str, object]:
    """Identify an experiment, and return what comes out by name: numbers, verdicts, or the sentence of a refusal."""
    from gtau.errors import GtauError
    from gtau.estimation.experiment_runs import read_runs
    from gtau.result import identify
    from gtau.signals.reading.experiment import read_experiment

    named = folder / "method.txt"
    method = named.read_text(encoding="utf-8") if named.exists() else None
    how = {"paper": {"as_paper": True}, "consistent": {"consistent": True}, None: {}}.get(method, {"method": method})
    begin = process_time()
    try:
        experiment = read_experiment(folder / "experiment.yaml")
        found = identify(experiment, **how)
    except GtauError as error:
        return {"refused": str(error)}
    out: dict[str, object] = {"seconds": process_time() - begin}
    groups = {
        "gain": found.drive_gains,
        "delay": found.delays,
        "parameter": found.parameters,
        "friction": found.friction,
    }
    groups |= {f"payload {k} {each.name}": each.parameters for k, each in enumerate(found.payloads)}
    for each in found.sensors:
        groups[f"sensor {each.joint}"] = {"delay": each.delay, **({"scale": each.ratio} if each.ratio else {})}
    for group, estimates in groups.items():
        for name, estimate in estimates.items():
            out[f"{group} {name}"] = [estimate.value, estimate.std]
            if group in ("gain", "delay"):
                out[f"verdict {group} {name}"] = estimate.verdict.outcome.value
    for each in found.residuals:
        out[f"residual {each.joint}"] = [each.relative, None]
    if found.consistency is not None:
        out |= {f"consistent {name}": [value, None] for name, value in found.consistency.standard.items()}
    for run in read_runs(experiment, experiment.validation):
        for each in found.validate(run):
            out[f"prediction {run.name} {each.joint}"] = [each.relative, None]
    return out


def dump(folder: Path, file: Path, only: str) -> None:
    """Identify all experiments of a folder whose name contains ``only``."""
    from threadpoolctl import threadpool_limits

    out = {}
    with threadpool_limits(1, "blas"):
        for each in sorted(path.parent for path in folder.glob("*/experiment.yaml") if only in path.parent.name):
            out[each.name] = numbers(each)
            print(
                f"{each.name:28} {len(out[each.name]):4} numbers {out[each.name].get('seconds', 0):6.1f} s", flush=True
            )
    file.write_text(json.dumps(out, indent=1), encoding="utf-8")


def differences(old: dict[str, object], new: dict[str, object]) -> list[str]:
    """List what differs by more than rounding."""
    lines = []
    for name in sorted((old.keys() | new.keys()) - {"seconds"}):
        before, after = old.get(name), new.get(name)
        if isinstance(before, list) and isinstance(after, list):
            size = max(abs(x) for x in (*before, 0.0) if x is not None)
            same = all(
                (x is None) == (y is None) and (x is None or abs(x - y) <= TOLERANCE * size)
                for x, y in zip(before, after, strict=True)
            )
        else:
            same = before == after
        if not same:
            lines.append(f"{name}: {before} -> {after}")
    return lines


def compare(old: Path, new: Path) -> int:
    """Print what differs in the experiments that both hold."""
    before, after = (json.loads(path.read_text(encoding="utf-8")) for path in (old, new))
    common = sorted(before.keys() & after.keys())
    found = {name: differences(before[name], after[name]) for name in common}
    for name, lines in found.items():
        print("\n".join([f"{name}: {len(lines)} of {len(before[name])} differ", *(f"  {line}" for line in lines[:12])]))
    then, now = (sum(of[name].get("seconds", 0.0) for name in common) for of in (before, after))
    print(f"{len(common)} experiments, {sum(map(bool, found.values()))} differ; {then:.0f} s then, {now:.0f} s now")
    return int(any(found.values()))


def main() -> None:
    """Parse, call, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["make", "dump", "compare"])
    parser.add_argument("paths", nargs="+", type=Path)
    parser.add_argument("--only", default="", help="experiments whose name contains this")
    arguments = parser.parse_args()
    if arguments.what == "make":
        make(arguments.paths[0].resolve())
    elif arguments.what == "dump":
        dump(arguments.paths[0], arguments.paths[1], arguments.only)
    else:
        sys.exit(compare(*arguments.paths))


if __name__ == "__main__":
    main()

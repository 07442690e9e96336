"""Friction on all samples: torque errors on measured logs, and which terms of simulated friction are found.

    python benchmarks/friction.py                    # all tables
    python benchmarks/friction.py --logs             # measured logs beside the checkout (../shared/data)
    python benchmarks/friction.py --simulated 50     # a joint: so many logs of each kind
    python benchmarks/friction.py --robots 3         # whole robots: so many experiments of each kind

Errors of a log are rms torque errors over rms torques, geometric means over the joints, on runs or stretches that were
not used. The simulated joint follows five harmonics with friction of known kinds; its other torque is known, but for an
error that is white, coloured, a ripple locked to the position, or a wrong load.

Whole robots are identified from two runs, the second with a known payload, with noise on the currents and positions
rounded by encoders; a third run is predicted. Their joints have friction that plants other than our law make.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import numpy as np
from scipy.special import stdtrit

sys.path.append(str(Path(__file__).parent))
from realism.plants import ANY, PLANTS, Plant, random_parameters
from zoo import ENTRIES

from gtau.estimation import identify as stages
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.experiment_runs import read_runs
from gtau.estimation.friction.curves import group_estimates
from gtau.estimation.friction.normal_equations import FrictionGroup, FrictionJoint
from gtau.estimation.friction.selection import FrictionFit, choose
from gtau.estimation.regression.problem import Estimates
from gtau.estimation.regression.rows import stop
from gtau.model.home import load_robot
from gtau.result import Result, identify
from gtau.robots.robot import PLAIN_FRICTION
from gtau.signals.preparation.filters import Decimator
from gtau.signals.reading.experiment import read_experiment
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run
from gtau.simulation.trajectories import Envelope, sines

LOGS = ("ur10e", "panda", "tx40", "dvrk", "xmate7p", "rokae_motor")
RATE, BLOCKS, NOISE = 200.0, 20, 0.05  # Hz; of a log; of the rms torque
TRUTHS = ("viscous and Coulomb", "Maxwell slip", "LuGre", "Stribeck", "load")
ERRORS = ("white", "coloured", "ripple", "wrong load")
BRISTLE = 2e-3  # s, by which LuGre's bristles are damped
LAW = ("presliding, load", "presliding, bent")  # our law: of joints in turn
RUBBED: dict[str, tuple[set[str], ...]] = {  # of whole robots, with the terms that are right, of joints in turn
    "viscous and Coulomb": (set(),),
    "our law": ({"presliding", "load"}, {"presliding", "bent"}),
    "LuGre": ({"presliding"},),
    "LuGre with Stribeck": ({"presliding", "bent"},),
    "generalized Maxwell slip": ({"presliding"},),
    "gaussian Stribeck": ({"bent"},),
    "viscous, Coulomb, ripple": (set(),),
}
MOTION = Envelope(np.array([0.0, -0.8, 0.8, 0.0, 0.0, 0.0]), np.full(6, 1.2), np.full(6, 2.0), np.full(6, 8.0))
PUMA = Plant(lambda: load_robot("puma560"), random_parameters, lambda robot: MOTION, 2.0, (0.03, 0.02, 0.1), ANY)
ROBOTS = {"ur10e": PLANTS["ur10e"], "puma560": PUMA, "five-bar": PLANTS["five-bar"]}
ROUNDING, CURRENT_NOISE = 2e-5, 0.005  # rad; of the rms current


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--logs", action="store_true")
    parser.add_argument("--simulated", type=int, default=0)
    parser.add_argument("--robots", type=int, default=0)
    parser.add_argument("--data", type=Path, default=Path(__file__).parents[2] / "shared" / "data")
    arguments = parser.parse_args()
    every = not (arguments.logs or arguments.simulated or arguments.robots)
    if arguments.logs or every:
        measured(arguments.data)
    if arguments.simulated or every:
        simulated(arguments.simulated or 50)
    if arguments.robots or every:
        robots(arguments.robots or 3)


def measured(data: Path) -> None:
    """Print errors of logs that were not used, by the plain law and by friction of all samples."""
    print("| log | all samples, plain law | all samples | away from reversals, plain law | with all | s, step |")
    print("| --- | ---: | ---: | ---: | ---: | ---: |")
    for entry in (entry for entry in ENTRIES if entry.name in LOGS):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "experiment.yaml"
            path.write_text(entry.write(data, Path(folder)), encoding="utf-8")
            experiment = read_experiment(path)
            found, seconds, step = timed(lambda experiment=experiment: identify(experiment))
            plain = found.replaced(curves={})
            for run in read_runs(experiment, experiment.validation):
                made = [
                    np.array([(each.relative_all, each.relative) for each in result.validate(run)])
                    for result in (plain, found)
                ]
                (all_before, before), (all_after, after) = (np.exp(np.log(each).mean(axis=0)) for each in made)
                errors = " | ".join(f"{each:.2f}" for each in (all_before, all_after, before, after))
                print(f"| {entry.robot}, {run.name} | {errors} | {seconds:.0f}, {step:.1f} |")
                pairs = zip(made[0][:, 0], made[1][:, 0], strict=True)
                quiet = [largest(result, run) for result in (plain, found)]
                print(
                    "  largest, N m or N:", *(f"{one:.2g} -> {other:.2g}," for one, other in zip(*quiet, strict=True))
                )
                print("  joints, all samples:", *(f"{one:.1f} -> {other:.1f}," for one, other in pairs))


def largest(result: Result, run: Run) -> np.ndarray:
    """The largest error of each joint over all samples: the collision threshold without a false alarm on this run."""
    prediction = result.predict(run)
    return np.abs(np.where(prediction.valid, prediction.measured - prediction.predicted, 0.0)).max(axis=0)


def simulated(count: int) -> None:
    """Print the share of logs in which each term was taken, and of parameters in their 95 % intervals, per cent."""
    print("\n| friction | error | presliding | bent | load | false terms | in 95 % intervals |")
    print("| --- | --- | ---: | ---: | ---: | ---: | ---: |")
    right = dict(zip(TRUTHS, (set(), {"width"}, {"width"}, {"speed"}, {"load"}), strict=True))
    for truth in TRUTHS:
        for error in ERRORS:
            found: Counter[str] = Counter()
            inside: list[bool] = []
            for seed in range(count):
                group = experiment(truth, error, seed)
                candidate, _, evidence = choose(group)
                kinds = {kind for _, kind in evidence}
                inside += covered(group, candidate, truth) if kinds == right[truth] else []
                found.update(kinds)
                found["false"] += bool(kinds - right[truth])
            shares = " | ".join(f"{100 * found[kind] / count:.0f}" for kind in ("width", "speed", "load", "false"))
            share = f"{100 * np.mean(inside):.0f}" if inside else "-"
            print(f"| {truth} | {error} | {shares} | {share} |", flush=True)


def covered(group: FrictionGroup, candidate: FrictionFit, truth: str) -> list[bool]:
    """Whether each parameter is in its interval."""
    names, values, _, scatter = group_estimates(group, candidate)
    halves = stdtrit(len(group.G) - 1, 0.975) * np.sqrt(np.diag(scatter))
    found = {name.kind: (value, half) for name, value, half in zip(names, values, halves, strict=True)}
    true = {"off": 0.3, "fv": 0.8, "fs": 2.0} | ({"fb": 1.0} if truth == "Stribeck" else {})
    true |= {"fl": 0.1} if truth == "load" else {}
    true |= {"width": group.joints[0].travel * 10**-3.5} if truth == "Maxwell slip" else {}
    return [kind in found and abs(found[kind][0] - value) <= found[kind][1] for kind, value in true.items()]


def experiment(truth: str, error: str, seed: int) -> FrictionGroup:
    """A joint's log of 30 s, reduced."""
    rng = np.random.default_rng(seed)
    t, h = np.arange(int(30 * RATE)) / RATE, np.arange(1, 6)
    phase = 2 * np.pi * 0.1 * h[:, None] * t
    q = (rng.normal(size=5) / h) @ np.sin(phase) + (rng.normal(size=5) / h) @ np.cos(phase)
    q *= 2.5 / np.ptp(q)
    v = np.gradient(q, t)
    rms, travel = float(np.sqrt(np.mean(v**2))), float(np.ptp(q))
    load = 10 * np.sin(q + rng.uniform(0, 6)) + 3 * np.gradient(v, t)
    joint = FrictionJoint("j", 0, np.ones(1), 0, travel, rms, PLAIN_FRICTION, False)
    y = 0.3 + 0.8 * v + friction(truth, q, v, load, travel, rms)
    e = disturbance(error, q, load, rng) * NOISE * np.std(y)
    z = np.vstack([np.sign(v), stop(q, joint.widths, np.full(len(joint.widths), np.sign(v[0])))])
    rows = Decimator(20).apply(np.vstack([joint.columns(v, z, load, 0.0), y + e]))
    place = np.arange(rows.shape[1]) * BLOCKS // rows.shape[1]
    G = np.array([[rows[:, place == b] @ rows[:, place == b].T] for b in range(BLOCKS)])
    none = np.zeros((0, 0))
    return FrictionGroup((joint,), (0,), none, G, np.zeros((joint.count, 0)), none)


def friction(truth: str, q: np.ndarray, v: np.ndarray, load: np.ndarray, travel: float, rms: float) -> np.ndarray:
    """Friction of 2 N m of a kind; widths are 10^-3.5 of the travel."""
    return 2 * direction(truth, q, v, load / 2, travel * 10**-3.5, 0.1 * rms, 1 / RATE)


def direction(
    truth: str, q: np.ndarray, v: np.ndarray, load: np.ndarray, width: float, speed: float, period: float
) -> np.ndarray:
    """Friction (N,) of a kind and unit height along a path; ``load`` in its units, ``width`` of presliding."""
    sign, fall = np.sign(v), np.exp(-np.abs(v) / speed)
    if truth in ("LuGre", "LuGre with Stribeck"):
        return lugre(v, width, period, fall**2 / 2 * (truth != "LuGre"))
    if truth == "generalized Maxwell slip":  # four elements, whose heights add up to 1
        return stop(q, width * np.array([0.3, 1.0, 3.0, 10.0]), np.full(4, sign[0])).mean(axis=0)
    z = stop(q, np.array([width]), sign[:1])[0] if truth in ("Maxwell slip", *LAW) else sign
    more = {"Stribeck": fall / 2, "gaussian Stribeck": np.exp(-((v / speed) ** 2)) / 2, "load": 0.1 * np.abs(load)}
    return z * (1 + more.get(truth, 0.0) + 0.1 * np.abs(load) * (truth == LAW[0]) + fall / 2 * (truth == LAW[1]))


def lugre(v: np.ndarray, width: float, period: float, more: np.ndarray) -> np.ndarray:
    """LuGre's friction of unit height, with ``more`` of it (N,) at rest and a bristle that is damped over 2 ms."""
    z, steps, found = float(np.sign(v[0])), 5, np.empty(len(v))
    for k, (speed, height) in enumerate(zip(v.tolist(), (1 + more).tolist(), strict=True)):
        a = speed * period / (width * steps)
        for _ in range(steps):  # implicit, so that it is stable at any speed
            last, z = z, (z + a) / (1 + abs(a) / height)
        found[k] = z + BRISTLE * (z - last) * steps / period
    return found


def disturbance(error: str, q: np.ndarray, load: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """An error of about unit rms."""
    white = rng.normal(size=len(q))
    if error == "white":
        return 3 * white  # of which the low-pass takes most
    if error == "coloured":  # over 0.1 s
        from scipy.signal import lfilter

        c = np.exp(-10 / RATE)
        return lfilter([np.sqrt(1 - c * c)], [1, -c], white)
    if error == "ripple":
        return np.sqrt(2) * np.sin(30 * q + rng.uniform(0, 6)) + 0.2 * white
    return np.sqrt(2) * np.sin(2 * q + rng.uniform(0, 6)) + 0.3 * white + 0.5 * load / np.std(load)


def robots(count: int) -> None:
    """Print what is found of whole robots: shares of joints, coverage, and errors of a third run."""
    print(
        "\n| robot | friction | joints | presliding | bent | load | false terms | in 95 % | plain | all samples | s |"
    )
    print("| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |")
    for name, plant in ROBOTS.items():
        for truth, right in RUBBED.items():
            found: Counter[str] = Counter()
            inside: list[bool] = []
            errors, seconds = [], np.zeros(2)
            for seed in range(count):
                runs, truths = experiment_of(plant, truth, seed)
                result, *spent = timed(lambda runs=runs, robot=plant.model.robot: identify(robot, runs[:2]))
                seconds += spent
                for k, joint in enumerate(plant.model.actuated):
                    terms, expected = set(result.curves[joint].evidence), right[k % len(right)]
                    found.update(terms)
                    found["false"] += bool(terms - expected)
                    found["joints"] += 1
                    if truth in ("our law", "viscous and Coulomb") and terms == expected:
                        inside += within(result, joint, truths)
                errors.append([relative(each, runs[2]) for each in (result.replaced(curves={}), result)])
            shares = (found[each] / found["joints"] for each in ("presliding", "bent", "load", "false"))
            before, after = np.exp(np.mean(np.log(errors), axis=0))
            covered = f"{100 * np.mean(inside):.0f}" if inside else "-"
            cells = [name, truth, found["joints"], *(f"{100 * each:.0f}" for each in shares), covered]
            cells += [f"{before:.2f}", f"{after:.2f}", "{:.1f}, {:.1f}".format(*seconds / count)]
            print("|", *(f"{each} |" for each in cells), flush=True)


def experiment_of(plant: Plant, truth: str, seed: int) -> tuple[list[Run], dict[str, float]]:
    """Three runs of a robot, the second with its payload, and the true gains and friction by name."""
    rng, model = np.random.default_rng([17, seed]), plant.model
    chi, n, period = plant.parameters(model, rng), len(model.actuated), 1 / plant.rate
    gains = rng.uniform(*np.broadcast_to(plant.gains, (n, 2)).T)
    of_drives = {f"{kind}_{joint}": 0.0 for kind in ("fv", "fs", "off") for joint in model.actuated}
    time, runs = np.arange(round(plant.seconds / period) + 1) * period, []
    motions = [sines(plant.within(model.robot), plant.seconds, rng)(time) for _ in range(3)]
    travel, rms = np.ptp(motions[0][0], axis=0), np.sqrt(np.mean(motions[0][1] ** 2, axis=0))
    width, speed = travel * 10 ** rng.uniform(-3.7, -3.2, n), 0.15 * rms
    truths = dict(zip((f"gain_{joint}" for joint in model.actuated), gains, strict=True))
    truths |= {name: chi.get(name, 0.0) for name in of_drives}
    kinds = LAW if truth == "our law" else (truth.split(",")[0],)
    for j, joint in enumerate(model.actuated):
        truths |= {f"width_{joint}": width[j], f"vs_{joint}": speed[j]}
        truths |= {f"fl_{joint}": 0.1, f"fb_{joint}": truths[f"fs_{joint}"] / 2}
    for k, (q, qd, qdd) in enumerate(motions):
        carried = {f"{kind}_{model.robot.tool}": value for kind, value in plant.payload().items()} if k == 1 else {}
        now = chi | {name: chi[name] + value for name, value in carried.items() if name in model.parameter_names}
        load = model.torques(q, qd, qdd, now | of_drives)
        tau = load.copy()
        for j, joint in enumerate(model.actuated):
            fv, fs, off = (truths[f"{kind}_{joint}"] for kind in ("fv", "fs", "off"))
            path = (q[:, j], qd[:, j], load[:, j] / max(fs, 1e-12), width[j], speed[j], period)
            tau[:, j] += fv * qd[:, j] + off + fs * direction(kinds[j % len(kinds)], *path)
            if "ripple" in truth:
                tau[:, j] += 0.05 * np.std(tau[:, j]) * np.sin(30 * q[:, j] + j)
        noise = CURRENT_NOISE * np.sqrt(np.mean(tau**2, axis=0)) * rng.standard_normal(tau.shape)
        seen = np.round(q / ROUNDING) * ROUNDING
        payload = Payload(name="disc", mass=plant.mass) if k == 1 else None
        runs.append(Run(f"run {k + 1}", model.actuated, time, seen, (tau + noise) / gains, payload=payload))
    return runs, truths


def within(result: Result, joint: str, truths: dict[str, float]) -> list[bool]:
    """Whether each parameter of a joint's friction but the offset is in its 95 % interval."""
    friction = {**result.friction_parameters, **result.friction}
    intervals = {name: each.interval() for name, each in friction.items() if name.body == joint and name.kind != "off"}
    return [low <= truths[name] <= high for name, (low, high) in intervals.items()]


def relative(result: Result, run: Run) -> float:
    """Error over torque of all samples of a run, per cent, geometric mean over the joints."""
    return float(np.exp(np.mean([np.log(each.relative_all) for each in result.validate(run)])))


def timed(work: Callable[[], Result]) -> tuple[Result, float, float]:
    """A result, and the seconds that it took: in all, and for the friction step."""
    step, spent = stages.friction_step, []

    def friction_step(fit: Fit, estimates: Estimates) -> tuple:
        begin = perf_counter()
        found = step(fit, estimates)
        spent.append(perf_counter() - begin)
        return found

    stages.friction_step = friction_step
    begin = perf_counter()
    result = work()
    stages.friction_step = step
    return result, perf_counter() - begin, sum(spent)


if __name__ == "__main__":
    main()

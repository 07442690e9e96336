"""The task of the next motion on top of what is known, and a motion that is always there: one that was played."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from gtau.campaigns.folder import Round
from gtau.campaigns.rehearsal import CSV
from gtau.errors import GtauError
from gtau.estimation.results.result import Result
from gtau.excitation.constraints import ConstraintUsage, usages_of_motion
from gtau.excitation.design import Design, redesign
from gtau.excitation.design_file import DesignFile, make_task
from gtau.excitation.evaluation import along
from gtau.excitation.prior import DesignPrior
from gtau.excitation.task import DesignProblem
from gtau.progress import Progress
from gtau.robots.parameter import Parameter
from gtau.robots.robot import INERTIAL
from gtau.signals.reading.logs import read_log


def next_task(file: DesignFile, result: Result, model: Path) -> DesignProblem:
    """Make the task of the next motion from what is known, or of the file where no gain can be trusted."""
    try:
        task, _ = make_task(file.model_copy(update={"prior": DesignPrior(model=model)}))
    except GtauError:  # a gain that may be zero, or is not identifiable
        return make_task(file)[0]
    return replace(task, prior=replace(task.prior, covariance=_told(result)))


def _told(result: Result) -> tuple[tuple[Parameter, ...], np.ndarray]:
    """Covariance of what later rounds share with a result, with the random part of the gains alone."""
    bodies = result.robot.bodies  # a payload may be mounted otherwise in each round, and friction drifts
    kept = [
        k
        for k, name in enumerate(result.covariance_names)
        if name.kind == "gain" or (name.kind in INERTIAL and name.body in bodies)
    ]
    names = tuple(result.covariance_names[k] for k in kept)
    part = np.ones(len(kept))
    for k, name in enumerate(names):
        gain = result.drive_gains.get(name.body) if name.kind == "gain" else None
        if gain is not None and gain.std and gain.random_std:
            part[k] = gain.random_std / gain.std
    return names, result.covariance[np.ix_(kept, kept)] * np.outer(part, part)


def played_again(task: DesignProblem, used: list[Round], refusal: GtauError, progress: Progress) -> tuple[Design, str]:
    """Improve a motion that was played, where the search from random motions found none; raises its ``refusal`` else.

    What drives did they can do again: its torques are within the limits, whatever is identified, and of gains their
    values count, not the worst ends of their intervals.
    """
    known = tuple(replace(gain, interval=(gain.value, gain.value)) for gain in task.prior.known)
    task = replace(task, prior=replace(task.prior, known=known))
    for round_ in reversed(used):
        x = np.array(round_.motion.get("series", {}).get("x", ()))
        if round_.played is None or x.size != task.size:
            continue
        series, torque = round_.motion["series"], task.limits.torque * np.ones(len(known))
        for usage in _as_played(task, round_.folder, round_.played.speed):
            for j, joint in enumerate(task.model.actuated):
                if usage.what.startswith(f"torque of joint '{joint}'"):
                    torque[j] = max(torque[j], (1 + 1e-3) * usage.reached)
        slowed = replace(task.series, base_frequency=round_.played.speed / series["period"])
        limits = replace(task.limits, torque=torque)
        again = replace(task, series=slowed, repetitions=series["repetitions"], limits=limits)
        if improved := redesign(again, x, progress):
            return improved, f"the next motion repeats round {round_.folder.name} with other parts, because {refusal}"
    raise refusal


def _as_played(task: DesignProblem, folder: Path, speed: float) -> Iterator[ConstraintUsage]:
    """Compute the usage of limits along the whole motion of a round, at the ``speed`` at which it was played."""
    columns = [f"{kind}_{joint}" for kind in ("q", "qd", "qdd") for joint in task.model.actuated]
    log = read_log(folder / CSV, ("t", *columns)).arrays()
    table = np.array([log[name] for name in columns]).reshape(3, -1, len(log["t"]))
    joints = np.stack([table[0], speed * table[1], speed**2 * table[2], 0 * table[0]])
    return usages_of_motion(along(task, joints, (log["t"][1] - log["t"][0]) / speed, task.motions[0]))

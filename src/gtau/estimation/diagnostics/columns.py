"""Fit the same rows with other readings of the columns of joints, as :mod:`.descriptions` does with other loads.

- With torques of a joint, of a run, or of a joint in a run, reversed or in another unit: joints share the parameters of
  their links, and runs all of them, so that the others give each a scale. Two joints are tried too, as two that are
  reversed hide each other.
- With the other sign of a joint's position, or of its current too, by the sign of its gain then; with its zero a
  quarter of a turn off, or the columns of two joints exchanged.
- With an angle measured from another link: a parallelogram holds the angle of a joint against the link before the
  preceding one, and its motor stands there. Fanuc, ABB and palletisers log ``J2 + J3`` as J3. The motor becomes a joint
  of its own, coupled to both.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import chain, combinations

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.diagnostics.descriptions import (
    ALIKE,
    COLUMNS,
    LEFT,
    MISFIT_GIVEN,
    at_middle,
    described_otherwise,
    middle_windows,
    refitted,
    residual_ratio,
)
from gtau.estimation.diagnostics.verdict import motors, unexplained_shares
from gtau.estimation.effects.effect import EstimatedEffect, encoders
from gtau.estimation.effects.estimate import CLOSE
from gtau.estimation.effects.rows import weights_of
from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.least_squares import fit_by
from gtau.estimation.estimators.maximum_likelihood import ml_or_wls
from gtau.estimation.estimators.newton import whitening
from gtau.estimation.regression.dataset import reduce_runs
from gtau.estimation.regression.factors import KNOWN, MODEL, delayed_signal, triangle
from gtau.findings import Finding, Progress, enumerated, listed
from gtau.robots.robot import Coupling, Robot
from gtau.signals.preparation.prepared_run import SampleWindow

OTHER_LEFT = 0.85  # part of the residual variance that is left with torques reversed or in another unit
OTHER_UNIT = 1.5  # factor of a joint's torques, or the inverse, from which it is another unit
OTHER_RUN = 1.2  # the same of torques in one run
SCALES = np.logspace(-4, 4, 25)  # factors of torques, of which the likeliest is refined

Group = tuple[tuple[str, ...], str]
"""Joints, all where it is empty, and a run, all where it is empty."""


def other_torques(fit: Fit) -> EstimatedEffect | None:
    """Find joints or runs whose torques are reversed or in another unit; None where gains are estimated.

    One after the other, as long as each explains much of what is left.
    """
    if fit.free_gains or not (groups := _groups(fit)):
        return None
    problem, best = fit.problem, fit.unrefined
    block_runs = fit.system.block_positions[:, 0].astype(int)

    def scaled(factors: np.ndarray) -> Fit:
        blocks = problem.blocks.copy()
        blocks[..., : KNOWN + 1] *= factors[block_runs][..., None, None]  # errors stay in the unit of the log
        other = replace(problem, make_blocks=lambda: blocks)
        return replace(fit, system=replace(fit.system, problem=other), solution=fit.solve(other))

    factors, texts, joints = np.ones((len(fit.dataset.runs), len(problem.channels))), list[str](), list[str]()
    while len(texts) < max(len(problem.joints) // 2, 1):
        likely = _likeliest_factors(fit, factors, groups)
        least = {group: OTHER_RUN if group[1] else OTHER_UNIT for group in likely}
        if any(1 / least[group] < factor < least[group] for group, factor in likely.items()):
            break
        tried = {group: np.where(groups[group], factor, 1.0) * factors for group, factor in likely.items()}
        fits = {group: scaled(changed) for group, changed in tried.items()}
        group = min(fits, key=lambda group: residual_ratio(fits[group], best))
        if residual_ratio(fits[group], best) >= OTHER_LEFT:
            break
        best, factors = fits[group], tried[group]
        texts.append(_otherwise(fit.kind, likely))
        joints += chain(*(chosen or motors(fit) for chosen, _ in likely))
    if not texts:
        return None
    n = len(problem.joints)
    if 2 * np.sum((factors[:, :n] < 0).all(axis=0)) + 1 >= n:  # all torques reversed fit as well, with negative masses
        texts[-1] += ", or of all other joints,"
    advice = f"check the signs of the {fit.kind} and position columns, the unit of the {fit.kind}s, and the gear ratio"
    cause = Finding(COLUMNS, tuple(dict.fromkeys(joints)), text=enumerated(texts), advice=advice)
    return described_otherwise(COLUMNS, cause, best, fit.unrefined, beside=False)


def _groups(fit: Fit) -> dict[Group, np.ndarray]:
    """List whose torques may be otherwise, as masks (R, c): a joint's or two joints', a run's, a joint's in a run."""
    runs, channels, joints = fit.dataset.runs, range(len(fit.problem.channels)), motors(fit)
    alone = [(joint,) for joint in joints]
    pairs = combinations(joints, 2) if unexplained_shares(fit).max() > MISFIT_GIVEN else ()
    groups = [(chosen, "") for chosen in (*alone, *pairs)]
    groups += [(chosen, run.name) for chosen in (*alone, ()) for run in runs if len(runs) > 1]
    names = np.array(fit.problem.joints)
    return {
        (chosen, name): np.outer(
            [name in ("", run.name) for run in runs],
            np.isin(channels, np.flatnonzero(np.isin(names, chosen or joints))),
        )
        for chosen, name in groups
    }


def _otherwise(kind: str, likely: Mapping[Group, float]) -> str:
    """Say whose torques are reversed, or by which factors they are larger."""
    who = {" in ".join(filter(None, [listed(joints), run and f"run '{run}'"])): factor
           for (joints, run), factor in likely.items()}  # fmt: skip
    if set(who.values()) == {-1.0}:
        return f"reversed {kind}s of {' or of '.join(who)}"
    times = " or of ".join(f"{name} that are {float(f'{factor:.2g}'):g} times" for name, factor in who.items())
    return f"{kind}s of {times} as large as the other {kind}s say"


def _likeliest_factors(fit: Fit, factors: np.ndarray, groups: Mapping[Group, np.ndarray]) -> dict[Group, float]:
    """Find the likeliest factor of a group's torques beside known ``factors`` (R, c); of all groups that are as likely.

    Errors ``v - X theta - k`` of other rows and ``v - s (X theta + k)`` of the group are linear in theta for any factor
    s; in the eigenvectors of the group's ``X^T X``, X being whitened, no s needs a solution of its own.
    """
    problem, block_runs = fit.problem, fit.system.block_positions[:, 0]
    runs = [problem.blocks[block_runs == k] for k in range(len(factors))]
    full = np.zeros((runs[0].shape[-1],) * 2)
    blocks = np.array([[triangle(full, *channel) for channel in run.swapaxes(0, 1)] for run in runs])
    blocks *= weights_of(fit)[:, None, None]
    by = factors[..., None] / fit.solution.gains[:, None]
    X, k, v = blocks[..., MODEL] * by[..., None], blocks[..., KNOWN] * by, delayed_signal(blocks, fit.solution.delays)
    known, y = problem.known[:, :-1], problem.known[:, -1]
    B = whitening(np.concatenate([*X.reshape(-1, *X.shape[2:]), known]))

    def likeliest(mask: np.ndarray) -> tuple[float, float]:
        """Find the likeliest factor, and minus its log-likelihood."""
        of_group, of_others = np.concatenate(X[mask]), np.concatenate([*X[~mask], known])
        _, s, V = np.linalg.svd(of_group @ B)
        basis, shares = B @ V.T, np.append(s**2, np.zeros(len(V) - len(s)))
        others = np.append((v - k)[~mask], y) @ of_others
        logged, carried = (part[mask].ravel() @ of_group for part in (v, k))
        grid = np.append(SCALES, -SCALES)
        for width in (1 / 3, 1 / 70, 0.0):  # decades on either side, refined twice
            s = grid[:, None]
            theta = (others + s * (logged - s * carried)) @ basis / (1 - shares + s**2 * shares) @ basis.T
            by = np.where(mask, s[..., None], 1.0)[..., None]
            squares = np.sum((v - by * (np.einsum("sk,rcpk->srcp", theta, X) + k)) ** 2, axis=(1, 3))
            losses = np.log(np.maximum(squares, 1e-300)) @ problem.total_rows / 2
            best = float(grid[np.argmin(losses)])
            grid = best * np.logspace(-width, width, len(SCALES))
        return best, float(losses.min())

    profiles = {group: likeliest(mask) for group, mask in groups.items()}
    least = min(loss for _, loss in profiles.values())
    return {
        group: -1.0 if 1 / OTHER_UNIT < -factor < OTHER_UNIT else factor
        for group, (factor, loss) in profiles.items()
        if loss < least + CLOSE
    }


def other_columns(fit: Fit, beside: bool, than: EstimatedEffect | None, progress: Progress) -> EstimatedEffect | None:
    """Find the joint whose columns have another sign or zero, or the two joints whose columns are exchanged.

    With effects ``beside`` them, or without where the user's description has impossible parameters. None where all
    leave more of the residuals than ``LEFT``, and ``than`` another description leaves.
    """
    if (unaltered := at_middle(fit)) is None:
        return None

    def read(order: np.ndarray, signs: np.ndarray, shift: np.ndarray) -> Fit | None:
        along = [_read_otherwise(at, order, signs, shift) for at in middle_windows(fit)]
        return refitted(unaltered, dataset=fit.dataset.reduced(along=along))

    tried = [(cause, partial(read, *reading)) for cause, *reading in _readings(fit)]
    most = max(LEFT, than.cause.values["remains"]) if than else LEFT
    return _likeliest(unaltered, tried, "other signs, zeros and orders of columns", progress, beside, most)


def _likeliest(
    unaltered: Fit,
    tried: Sequence[tuple[Finding, Callable[[], Fit | None]]],
    stage: str,
    progress: Progress,
    beside: bool = True,
    most: float = LEFT,
) -> EstimatedEffect | None:
    """Fit with other descriptions, and return the one that leaves least of the residuals, ``most`` of them at most.

    Of those that leave as much, mirror images, the one with the fewest negative gains.
    """
    fits = list[tuple[float, Finding, Fit]]()
    for number, (cause, described) in enumerate(tried):
        progress(stage, number, len(tried))
        with suppress(GtauError):  # its loops do not close
            if (other := described()) is not None:
                fits.append((residual_ratio(other, unaltered), cause, other))
    progress(stage, len(tried), len(tried))
    least = min((ratio for ratio, *_ in fits), default=1.0)
    if least >= most:
        return None
    alike = [(cause, other) for ratio, cause, other in fits if ratio <= ALIKE * least]
    cause, other = min(alike, key=lambda described: np.sum(described[1].gains < 0))
    return described_otherwise(COLUMNS, cause, other, unaltered, beside)


def _readings(fit: Fit) -> Iterator[tuple[Finding, np.ndarray, np.ndarray, np.ndarray]]:
    """List what columns may be otherwise: the order of joints, signs (2, n) of positions and commands, and shifts."""
    as_logged = np.arange(len(fit.dataset.model.actuated))
    unturned, unmoved = np.ones((2, len(as_logged))), np.zeros(len(as_logged))
    for joint, place in encoders(fit).items():
        chosen = (as_logged == place).astype(float)
        for alone in (True, False):
            columns = "the position" if alone else f"position and {fit.kind}"
            text = f"the other sign of {columns} of '{joint}'"
            advice = f"check the sign of {columns}, and the joint's axis in the robot file"
            turned = unturned - 2 * chosen * [[1], [0 if alone else 1]]
            yield Finding(COLUMNS, (joint,), text=text, advice=advice), as_logged, turned, unmoved
        for degrees in (90, -90, 180) if fit.dataset.robot.joint(joint).turns else ():
            text = f"an error of {degrees} deg in the zero of encoder '{joint}'"
            cause = Finding(COLUMNS, (joint,), text=text, advice="add it to the positions, or correct the zero")
            yield cause, as_logged, unturned, np.radians(degrees) * chosen
    for (one, first), (other, second) in combinations(encoders(fit).items(), 2):
        joints, order = (one, other), as_logged.copy()
        order[[first, second]] = second, first
        text = f"exchanged positions and {fit.kind}s of {listed(joints)}"
        cause = Finding(COLUMNS, joints, text=text, advice="check the order of the joints' columns")
        yield cause, order, unturned, unmoved


def _read_otherwise(at: SampleWindow, order: np.ndarray, signs: np.ndarray, shift: np.ndarray) -> SampleWindow:
    """Exchange and turn the joints' columns of a window, and shift its positions."""
    beyond = at.command.shape[1] - len(order)  # sensors and wrenches stay
    channels, turned = np.append(order, len(order) + np.arange(beyond)), np.append(signs[1], np.ones(beyond))
    moved = {name: getattr(at, name)[:, order] * signs[0] for name in ("q", "qd", "qdd")}
    moved |= {name: getattr(at, name)[:, channels] * turned for name in ("command", "command_d", "command_dd")}
    moved["q"] += shift
    return replace(at, usable=at.usable[:, channels[: at.usable.shape[1]]], part_of=None, **moved)


def angle_from_another_link(fit: Fit, progress: Progress) -> EstimatedEffect | None:
    """Find a joint whose angle is measured, and whose motor stands, as in a parallelogram."""
    gains, tried = None if fit.free_gains else fit.gains, []

    def described(robot: Robot) -> Fit:
        dataset = reduce_runs(robot, fit.dataset.runs, fit.dataset.preparation)
        return fit_by(ml_or_wls(gains), dataset.system(per_run=len(dataset.runs) > 1), fit.free_gains)

    for joint, before, robot in _with_parallelogram(fit.dataset.robot):
        beside = fit.dataset.robot.joint(before).antecedent
        text = f"an angle of '{joint}' that is measured from '{beside}', as with a parallelogram,"
        advice = (
            "log the angle between the links, or describe the parallelogram in the robot file, as the catalog's "
            f"'palletiser' does: the motor '{joint}' turns beside '{before}', and a rod moves the link"
        )
        tried.append((Finding(COLUMNS, (joint,), text=text, advice=advice), partial(described, robot)))
    return _likeliest(fit.unrefined, tried, "angles from other links", progress)


def _with_parallelogram(robot: Robot) -> Iterator[tuple[str, str, Robot]]:
    """Describe the robot with each motor standing beside the motor before it, where their axes are parallel."""
    joints = {joint.name: joint for joint in robot.joints}
    if robot.closures or robot.couplings:
        return
    for place, joint in enumerate(robot.joints):
        before = joints.get(joint.antecedent)
        if before is None or not (joint.actuated and before.actuated and joint.turns and before.turns):
            continue
        along = float(np.array(before.axis) @ np.array(joint.placement.rotation) @ np.array(joint.axis))
        if not np.isclose(abs(along), 1.0, rtol=0, atol=1e-6):
            continue
        link = replace(joint, name=f"{joint.name} link", actuated=False, parameters="inertial")
        motor = replace(before, name=joint.name, parameters="drive", limits=joint.limits, home=0.0)
        moved = {joint.name: link.name}
        others = [replace(other, antecedent=moved.get(other.antecedent, other.antecedent)) for other in robot.joints]
        others[place : place + 1] = [motor, link]
        sign = 1.0 if along > 0 else -1.0
        coupling = Coupling(link.name, ((joint.name, sign), (before.name, -sign)))
        tool = moved.get(robot.tool, robot.tool)
        yield joint.name, before.name, replace(robot, joints=tuple(others), couplings=(coupling,), named_tool=tool)

"""What the scale of each drive gain rests on.

Currents alone leave the scale open: gains and parameters may all be twice as large. It comes from what is known in N m
or kg: payloads, torque sensors, wrenches from outside, known parameters. With all of it larger by one per cent, every
gain and parameter is larger by one per cent too; so the shares by which a gain grows with each source alone add up to
one.
"""

from __future__ import annotations

import numpy as np

from gtau.estimation.estimators.estimator import Fit
from gtau.estimation.estimators.newton import (
    curvature_of_delays,
    jacobian,
    jacobian_of_known,
    stacked,
    to_gains,
    whitening,
)
from gtau.estimation.regression.problem import Problem, delayed


def scale_shares(fit: Fit) -> dict[str, np.ndarray]:
    """Find the share of each source in the scale of the joints' gains, source to (n,); the shares add up to one.

    Parameters
    ----------
    fit : Fit
        With gains that were estimated, at whose solution the equations are linearised.
    """
    problem, solution, n_theta = fit.system.problem, fit.solution, fit.system.problem.n_theta
    state, triangles = solution.iterate, stacked(problem)
    weights = 1 / np.maximum(solution.sigma, problem.smallest_sigma)
    J = jacobian(triangles, state, problem, free_gains=True) * weights[:, None, None]
    known = jacobian_of_known(problem, J.shape[-1])
    rows = np.concatenate([J.reshape(-1, J.shape[-1]), known])
    back = whitening(rows, curvature_of_delays(triangles, state, problem, weights))
    slopes = (to_gains(state, n_theta, True) @ back)[problem.gain_rows] / fit.gains[:, None]

    pushes = fit.system.pushes
    sides: dict[str, np.ndarray] = {}  # J^T de for what each source says, were it larger by all of itself
    for name in dict.fromkeys(each.payload.name for each in fit.system.payloads if each.known_column.any()):
        carriers = [each.run for each in fit.system.payloads if each.payload.name == name]
        mine = np.isin(fit.system.block_positions[:, 0].astype(int), carriers)
        of_blocks = jacobian(problem.blocks[mine], state, problem, free_gains=True)
        change = -state.b[:, None] * (problem.blocks[mine][..., n_theta] + (0.0 if pushes is None else pushes[mine]))
        sides[f"payload '{name}'"] = np.einsum("ujpk,ujp,j->k", of_blocks, change, weights**2)
    for k, joint in enumerate(problem.sensors, start=len(problem.joints)):
        torque = triangles[k][:, n_theta + 1 :] @ delayed(state.delays[k])
        sides[f"torque sensor of '{joint}'"] = J[k].T @ torque * weights[k]
    if (problem.driveless and not problem.silent[problem.base_channels].all()) or pushes is not None:
        acting = [k for k, joint in enumerate(problem.joints) if joint in problem.driveless]
        forces = [triangles[k][:, n_theta + 1 :] @ delayed(state.delays[k]) * weights[k] for k in acting]
        side = sum((J[k].T @ force for k, force in zip(acting, forces, strict=True)), np.zeros(J.shape[-1]))
        if pushes is not None:
            of_blocks = jacobian(problem.blocks, state, problem, free_gains=True)
            side += np.einsum("ujpk,ujp,j->k", of_blocks, state.b[:, None] * pushes, weights**2)
        sides[_wrenches(problem)] = side
    if len(problem.known):
        sides["known parameters"] = -known.T @ problem.known[:, -1]
    shares = {source: -slopes @ (back.T @ side) for source, side in sides.items()}
    total = np.sum(list(shares.values()), axis=0)  # one, up to the curvature that the linear equations lack
    total = np.where(total == 0.0, 1.0, total)  # of a base, whose gain is known
    return {source: share / total for source, share in shares.items()}


def _wrenches(problem: Problem) -> str:
    """Name the measured wrenches; with a base that floats they are those on the base too."""
    if problem.driveless and problem.pushed:
        return "measured wrenches"
    bodies = problem.pushed or problem.driveless[-1:]
    return f"wrench{'es' * (len(bodies) > 1)} on {', '.join(repr(body) for body in bodies)}"

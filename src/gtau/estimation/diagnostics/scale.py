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
from gtau.estimation.regression.equations import KNOWN, delayed_signal
from gtau.estimation.regression.problem import Problem


def scale_shares(fit: Fit) -> dict[str, np.ndarray]:
    """Find the share of each source in the scale of the joints' gains, source to (n,); the shares add up to one.

    Parameters
    ----------
    fit : Fit
        With gains that were estimated, at whose solution the equations are linearised.
    """
    problem, solution = fit.system.problem, fit.solution
    state, triangles = solution.iterate, stacked(problem)
    weights = 1 / np.maximum(solution.sigma, problem.smallest_sigma)
    J = jacobian(triangles, state, problem, free_gains=True) * weights[:, None, None]
    stated = jacobian_of_known(problem, J.shape[-1])
    rows = np.concatenate([J.reshape(-1, J.shape[-1]), stated])
    back = whitening(rows, curvature_of_delays(triangles, state, problem, weights))
    slopes = (to_gains(state, problem.n_theta, True) @ back)[problem.gain_rows] / fit.gains[:, None]

    of_wrenches = fit.system.of_wrenches
    sides: dict[str, np.ndarray] = {}  # J^T de for what each source says, were it larger by all of itself
    for name in dict.fromkeys(each.payload.name for each in fit.system.payloads if each.acts):
        carriers = [each.run for each in fit.system.payloads if each.payload.name == name]
        mine = np.isin(fit.system.block_positions[:, 0].astype(int), carriers)
        of_blocks = jacobian(problem.blocks[mine], state, problem, free_gains=True)
        known = problem.blocks[mine][..., KNOWN] - (0.0 if of_wrenches is None else of_wrenches[mine])
        change = -state.b[:, None] * known
        sides[f"payload '{name}'"] = np.einsum("ujpk,ujp,j->k", of_blocks, change, weights**2)
    measured = np.einsum("cpk,cp,c->ck", J, delayed_signal(triangles, state.delays), weights)  # of gains that are 1
    for k in problem.of("sensor"):
        sides[f"torque sensor of '{problem.channels[k].joint}'"] = measured[k]
    base = problem.of("base")
    if (base and not problem.silent[base].all()) or of_wrenches is not None:
        side = measured[base].sum(axis=0)
        if of_wrenches is not None:
            of_blocks = jacobian(problem.blocks, state, problem, free_gains=True)
            side -= np.einsum("ujpk,ujp,j->k", of_blocks, state.b[:, None] * of_wrenches, weights**2)
        sides[_wrenches(problem)] = side
    if len(problem.known):
        sides["known parameters"] = -stated.T @ problem.known[:, -1]
    shares = {source: -slopes @ (back.T @ side) for source, side in sides.items()}
    total = np.sum(list(shares.values()), axis=0)  # one, up to the curvature that the linear equations lack
    total = np.where(total == 0.0, 1.0, total)  # of a base, whose gain is known
    return {source: share / total for source, share in shares.items()}


def _wrenches(problem: Problem) -> str:
    """Name the measured wrenches; with a base that floats they are those on the base too."""
    base = [problem.channels[k].joint for k in problem.of("base")]
    if base and problem.wrenches:
        return "measured wrenches"
    bodies = problem.wrenches or base[-1:]
    return f"wrench{'es' * (len(bodies) > 1)} on {', '.join(repr(body) for body in bodies)}"

"""DIDIM and instrumental variables (IDIM-IV), which simulate the motion with the current estimate.

Choose ``didim``, which takes no measured position, where encoders are coarse or noisy, beside ``iv``. Choose ``iv``,
the equations as measured, weighted by a motion without noise, where encoders are coarse or noisy, or the filter is
poor.

DIDIM (Gautier, Janot and Vandanjon) takes the regressor along the motion of the robot simulated in closed loop, so that
nothing is differentiated and no noise is amplified; the next estimate is simulated again, until the gains converge. The
control law of a logged robot is unknown, so the simulated one is the usual substitute: PID through the inertia of the
model itself, the acceleration of the reference fed forward,

    M(q) (qdd_r + kd ed + kp e + ki int e) = M(q) qdd + h(q, qd),      e = q_r - q

with all three poles at ``-pole``. The measured motion, low-passed to the band of the equations, is the reference.
All terms of the model besides inertia then act as a disturbance: ``e = s / (s + pole)^3  M^-1 h``. This is solved for
the whole run by filtering ``M^-1 h`` along the motion of the previous pass, until the motion converges: the loop
forgets in a few ``1 / pole``, so two or three passes suffice, each as fast as the model along a log. (Integrated step
by step, the Orthoglide takes a thousand times as long.)

Encoder noise is amplified twice by differentiation to accelerations. It enters the regressor, so least squares and
maximum likelihood underestimate every parameter, the more so the poorer the filter. The method of Janot et al.
multiplies the equations not by the Jacobian J of the errors e, but by the same Jacobian along a simulated motion, whose
errors are uncorrelated with the errors of the equations:

    J_s^T e = 0    instead of    J^T e = 0 ,

solved by Newton's method and simulated again with the new estimate until convergence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.estimators.estimator import Estimator, Fit, Gains, Solution, Solve
from gtau.estimation.estimators.least_squares import fit_by
from gtau.estimation.estimators.maximum_likelihood import ml_or_wls
from gtau.estimation.estimators.newton import RANK, moved, one_step, squared, to_gains, weighted
from gtau.estimation.regression.dataset import Dataset, System
from gtau.estimation.regression.factors import EXTRA, SIGNALS, Factors, Triangles, triangle
from gtau.estimation.regression.problem import Problem
from gtau.estimation.regression.rows import instants, stream_rows
from gtau.estimation.regression.run_blocks import block_of
from gtau.findings import Progress, silent
from gtau.model.inverse_dynamics import PATH, InverseDynamics, Regressor
from gtau.model.loops import Labels
from gtau.robots.parameter import DRY, TERMS, parameter_of
from gtau.signals.preparation.bandwidth import spectra
from gtau.signals.preparation.filters import Preparation, below_nyquist, filter_edge, position_filter
from gtau.signals.preparation.prepared_run import PreparedRun, SampleWindow
from gtau.signals.run import Run
from gtau.signals.storage import Store, block, spans

SMOOTH = 4.0  # cut-off of the reference over the bandwidth of the motion, at least
ROWS = 2.0  # and over the bandwidth of the rows' low-pass, as the currents hold what the rows do
POLE = 20.0  # of the loop, over the bandwidth of the motion
LOOP_PASSES = 20
LOOP_CONVERGED = 1e-6  # change of the accelerations, of their rms
MEASURED = ("command", "command_d", "command_dd", "usable")
PASSES = 10
CONVERGED = 0.1  # standard deviations: convergence of every gain and delay
SWITCHING = 1.0  # and of every parameter: Coulomb friction of a passive joint switches with the sign of single samples

SIMULATIONS = 6  # for instrumental variables
SAME = 0.01  # standard deviations: a smaller change ends them
STEPS = 50
SOLVED = 1e-8  # of a standard deviation


def resimulated_runs(system: System, solution: Solution) -> tuple[SampleWindow, ...]:
    """Replace the motions of all runs by motions of the simulated loop; see :func:`resimulated`."""
    dataset = system.dataset
    if dataset.robot.floating:
        raise GtauError(
            f"motion is simulated from the currents of motors, and the base '{dataset.robot.floating}' has none; use "
            "--method ml."
        )
    if bodies := [frame.body for frame in dataset.runs[0].wrenches]:
        raise GtauError(
            f"motion is simulated from the currents of motors alone, and measured wrenches act on {', '.join(bodies)} "
            "too; use --method ml."
        )
    regressor = dataset.model.columns(dataset.base.standard)
    return tuple(
        resimulated(dataset.model, regressor, system.motion(k, solution.theta), run)
        for k, run in enumerate(dataset.prepared)
    )


def resimulated(idm: InverseDynamics, regressor: Regressor, values: np.ndarray, prepared: PreparedRun) -> SampleWindow:
    """Replace a run's motion by the loop's, for ``values`` (columns,) of the run; raises GtauError."""
    from scipy.signal import bilinear, lfilter, lfilter_zi

    run, kept, rate = prepared.run, prepared.kept, prepared.run.rate
    samples, n = len(prepared), len(run.joints)
    cutoff = reference_cutoff(prepared.preparation, run)
    edge = filter_edge(rate, cutoff)
    pole = 2 * np.pi * POLE * prepared.preparation.bandwidth
    denominator = [1.0, 3 * pole, 3 * pole**2, pole**3]
    # from the disturbance to the loop's error and its two derivatives
    filters = [bilinear([1.0, *[0.0] * (k + 1)], denominator, rate) for k in range(3)]
    motion: list[np.ndarray] = []
    for _ in range(LOOP_PASSES):
        stores, states = [Store((n,)) for _ in range(3)], list[np.ndarray]()
        c = None
        change = size = 0.0
        for start, stop in spans(samples, PATH):
            reference = position_filter(run.position, rate, cutoff, kept.start + start, kept.start + stop)
            before = [block(rows, start, stop) for rows in motion] or reference
            labels = instants(run.name, block(prepared.time, start, stop))
            disturbance, c = _disturbance(idm, regressor, values, before, reference[1], labels, c)
            states = states or [lfilter_zi(b, a)[:, None] * disturbance[:1] for b, a in filters]  # steady at first
            for k, (b, a) in enumerate(filters):
                error, states[k] = lfilter(b, a, disturbance, axis=0, zi=states[k])
                following = reference[k] - error
                stores[k].append(following)
            change += float(np.sum((following - before[2]) ** 2))  # of the accelerations
            size += float(np.sum(reference[2] ** 2))
        motion = [store.array() for store in stores]
        if change < LOOP_CONVERGED**2 * size:
            break
    else:
        raise GtauError(
            f"run '{run.name}': the robot simulated with the estimated parameters does not follow its motion; "
            "use --method ml, or add runs that excite the parameters better."
        )
    rest = {name: Store((run.given.start,), bool if name == "usable" else float) for name in MEASURED}
    for start, stop in spans(samples):
        measured = prepared.samples(start, stop)
        number = np.arange(kept.start + start, kept.start + stop)
        measured.usable[(number < edge) | (number >= len(run.time) - edge)] = False
        for name, store in rest.items():
            store.append(getattr(measured, name))
    return SampleWindow(run, prepared.time, *motion, *(rows.array() for rows in rest.values()))


def reference_cutoff(preparation: Preparation, run: Run) -> float | None:
    """Choose the cut-off of a run's reference, Hz, at most the frequency above which noise exceeds the signal."""
    end = max((joint.end for joint in spectra(run) if joint.moves), default=np.inf)
    rows = min(ROWS * preparation.decimator.cutoff(run.rate), end)
    return below_nyquist(max(SMOOTH * preparation.bandwidth, rows), run.rate)


def _disturbance(
    idm: InverseDynamics,
    regressor: Regressor,
    values: np.ndarray,
    motion: Sequence[np.ndarray],
    direction: np.ndarray,
    here: Labels,
    before: np.ndarray | None,
) -> tuple[np.ndarray, np.ndarray]:
    """Compute ``M^-1 h`` (M, n) along samples of a motion, three arrays (M, n), and the last configuration.

    Coulomb friction opposes the speeds of ``direction`` (M, n), the reference, so that a joint needs no stiction; rows
    where the two differ in sign are next to a reversal, and masked. ``before`` is the configuration ahead of them.
    """
    q, qd, directed = (np.ascontiguousarray(rows.T) for rows in (*motion[:2], direction))
    dry = np.array([parameter_of(name).kind in DRY for name in regressor.names])
    c = idm.path(q, here, before)
    still = np.zeros_like(q)
    moving = idm.rates(c, qd, still, here)
    h = regressor.torques_along(idm.layout, moving, np.where(dry, 0.0, values))
    signs = idm.rates(c, directed, still, here)
    h += regressor.torques_along(idm.layout, signs, np.where(dry, values, 0.0))
    rest = replace(moving, yd=np.zeros_like(moving.yd), ydd=np.zeros_like(moving.ydd))
    weight = regressor.torques_along(idm.layout, rest, values)
    columns = []
    for k in range(len(q)):
        accelerating = replace(rest, ydd=np.ascontiguousarray(moving.J[:, k]))
        columns.append(regressor.torques_along(idm.layout, accelerating, values) - weight)
    M = np.stack(columns, axis=1).transpose(2, 0, 1)
    M = (M + M.swapaxes(1, 2)) / 2
    sizes = np.abs(np.einsum("tii->ti", M))
    lowest = np.linalg.eigvalsh(M / np.sqrt(np.einsum("ti,tj->tij", sizes, sizes)))[:, 0]
    if not lowest.min() > 0:
        raise GtauError(
            f"the estimated inertia is not positive ({here(int(lowest.argmin()))}), so the robot cannot be "
            "simulated; use --method ml, or add runs that excite the parameters better."
        )
    return np.linalg.solve(M, h.T[:, :, None])[:, :, 0], c[:, -1]


def along_simulated_motion(system: System, solve: Solve, progress: Progress) -> System:
    """Iterate between simulated motion and the estimates of ``solve`` until they converge; raises GtauError."""
    measured, solution = system.dataset, solve(system.problem)
    for k in range(PASSES):
        progress("simulation", k, PASSES)
        simulated = resimulated_runs(system, solution)
        system = system.again(measured.reduced(system.loads(solution.theta), along=simulated))
        before, solution = solution, solve(system.problem)
        std = np.sqrt(np.diag(solution.covariance))
        limits = CONVERGED * std
        limits[solution.unknowns.theta] = SWITCHING * std[solution.unknowns.theta]
        if len(before.values) == len(std) and np.all(np.abs(solution.values - before.values) <= limits):
            progress("simulation", PASSES, PASSES)
            return system
    raise GtauError(
        "simulation and estimate do not converge, so the estimated parameters do not reproduce the measured motion; "
        "use --method ml, or add runs that excite the parameters better."
    )


def _by_simulation(system: System, gains: np.ndarray | None = None, progress: Progress = silent) -> Fit:
    solver = ml_or_wls(gains)
    return fit_by(solver, along_simulated_motion(system, solver, progress), gains is None)


@dataclass(frozen=True, eq=False)
class Pair:
    """The same equations along the motion ``measured`` and the one ``simulated``; ``merged`` has all units."""

    measured: Problem
    simulated: Problem
    merged: tuple[np.ndarray, np.ndarray]

    def of(self, parameters: Sequence[str]) -> Pair:
        """Keep some parameters only, the others set to zero."""
        gone = [name for name in self.measured.parameters if name not in set(parameters)]
        columns = self.measured.columns_of(name for name in self.measured.parameters if name in set(parameters))
        measured, simulated = (rows[..., columns] for rows in self.merged)
        return Pair(self.measured.without(gone), self.simulated.without(gone), (measured, simulated))


def instrumental(system: System, solution: Solution, free_gains: bool, progress: Progress) -> tuple[Pair, Solution]:
    """Estimate by instrumental variables from a ``solution`` without; return equations too. Raises GtauError."""
    for k in range(SIMULATIONS):
        progress("simulation", k, SIMULATIONS)
        pair = paired(system, solution)
        before = solution
        solution = with_instruments(pair, solution, free_gains)
        std = np.sqrt(np.diag(solution.covariance))
        if np.all(np.abs(solution.values - before.values) <= SAME * std):
            break
    progress("simulation", SIMULATIONS, SIMULATIONS)
    return pair, solution


def with_instruments(pair: Pair, start: Solution, free_gains: bool) -> Solution:
    """Solve measured equations by the Jacobian of simulated ones, from gains and delays; raises GtauError."""
    problem, n = pair.measured, len(pair.measured.joints)
    values = np.concatenate([np.zeros(problem.n_theta), start.gains, start.delays])

    def linear(blocks: np.ndarray, instruments: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Linearise: weighted errors (., n p), their Jacobian (., n p, k) and the instruments' Jacobian."""
        e, J = weighted(blocks, values, problem, free, weights)
        return e, J, weighted(instruments, values, problem, free, weights)[1]

    for k in range(STEPS):
        free = free_gains and k > 0  # theta comes first: without it the model gives no currents for gains
        errors = squared(pair.merged[0], values)
        weights = problem.weights(errors)
        e, J, Z = linear(*pair.merged)
        norms = np.linalg.norm(Z, axis=0)
        norms[norms == 0] = 1.0
        Q, R = np.linalg.qr(Z / norms)
        U, s, Vt = np.linalg.svd(R)
        shown = s > RANK * s[0]  # a delay that is lost in noise has no column
        Q, back = Q @ U[:, shown], (Vt[shown] / norms).T / s[shown]
        A = Q.T @ J @ back  # not Z^T J, in which half of the digits would be lost
        if np.linalg.cond(A) * RANK > 1:
            raise GtauError(
                "instrumental variables do not determine the estimates, as the simulated motion shows nothing of some; "
                "use --method ml, or add runs that excite the parameters better."
            )
        step = -np.linalg.solve(A, Q.T @ e)
        values = moved(values, back @ step, n)
        if k > 0 and np.linalg.norm(step) < SOLVED * np.sqrt(len(step)):
            break
    else:
        raise GtauError(
            "the iteration with instrumental variables did not converge, as the simulated motion is far from the "
            "measured one; use --method ml, or add runs that excite the parameters better."
        )
    sigma = np.sqrt(errors / np.maximum(problem.total_rows - len(step) / n, 1))
    T, inverse = to_gains(values, n, free_gains) @ back, np.linalg.inv(A)
    white = inverse @ (Q * np.repeat(sigma * weights, len(Q) // n)[:, None]).T

    def replicates() -> np.ndarray:
        shares = []
        for units in zip(pair.measured.units, pair.simulated.units, strict=True):
            e_u, J_u, Z_u = linear(*units)
            weighed = inverse @ (Z_u @ back).T
            shares.append((weighed @ J_u @ back, weighed @ e_u))
        return one_step(shares) @ T.T

    return Solution(problem.unknowns, values, sigma, T @ white @ white.T @ T.T, replicates)


def paired(system: System, solution: Solution) -> Pair:
    """Build the problem along the measured motion and along the simulated one."""
    dataset, simulated = system.dataset, resimulated_runs(system, solution)
    loads = system.loads(solution.theta)
    pairs = [_reduced(dataset, k, run, load) for k, (run, load) in enumerate(zip(simulated, loads, strict=True))]
    measured, instruments = (
        system.again(replace(dataset, factors=factors)).unreduced for factors in zip(*pairs, strict=True)
    )
    b = len(measured.parameters) + 1
    rows = np.concatenate([instruments.blocks[..., :b], measured.blocks], axis=-1)
    R = np.stack([triangle(*rows[:, j]) for j in range(len(measured.joints))])
    merged = R[..., b:], np.concatenate([R[..., :b], R[..., SIGNALS]], axis=-1)
    return Pair(measured, instruments, merged).of(system.problem.parameters)


def _reduced(dataset: Dataset, run: int, simulated: SampleWindow, load: np.ndarray | None) -> tuple[Factors, Factors]:
    """Reduce a run along the measured and the simulated motion, with the same instants row by row.

    The sign of a noisy speed is not the sign of the speed plus noise, so the columns of Coulomb friction are the
    simulated ones. The rows ``[W_s terms_s | W terms | v v' v'']`` are reduced together, and the triangle cut by
    columns.
    """
    model = dataset.model
    columns = dataset.base.standard
    measured = dataset.prepared[run]
    regressor = model.columns(columns)
    decimator = dataset.preparation.at(measured.run.rate).decimator
    blocks = block_of(dataset.prepared.edges[run], decimator.outputs(len(measured)))
    n, b = len(model.actuated), len(columns) + EXTRA - 3
    dry = np.flatnonzero([kind in DRY for kind in (*(name.kind for name in columns), *TERMS)])
    collected = Triangles([np.arange(2 * b + 3)] * n)
    streams = (stream_rows(model, regressor, along, decimator, load) for along in (simulated, measured))
    for part, other in zip(*streams, strict=True):
        A = np.zeros((n, len(part.time), 2 * b + 3))
        for begin, rows in ((0, part), (b, other)):
            end = begin + len(columns)
            A[regressor.rows, :, regressor.columns + begin] = rows.entries
            A[:, :, end : end + len(TERMS)] = rows.terms.transpose(1, 2, 0)
        A[:, :, b + dry] = A[:, :, dry]
        A[:, :, SIGNALS] = other.currents.transpose(1, 2, 0)
        collected.add(A, part.keep & other.keep, blocks[part.outputs])
    R, signals = collected.factors(2 * b + 3), np.arange(2 * b, 2 * b + 3)
    pair = (R[..., np.append(np.arange(begin, begin + b), signals)] for begin in (b, 0))
    along, instruments = (Factors(columns, collected.rows) for columns in pair)
    return along, instruments


def _by_instruments(system: System, gains: np.ndarray | None = None, progress: Progress = silent) -> Fit:
    solver, free_gains = ml_or_wls(gains), gains is None
    pair, solution = instrumental(system, solver(system.problem), free_gains, progress)

    def solve_fixed(problem: Problem) -> Solution:
        return with_instruments(pair.of(problem.parameters), solution, free_gains=False)

    return Fit(system, solution, solver, solve_fixed, free_gains)


DIDIM = Estimator(
    "didim", "parameters from the currents, the motion simulated (DIDIM)", Gains.EITHER, ml_or_wls, _by_simulation
)
IV = Estimator(
    "iv",
    "instrumental variables along simulated motion (IDIM-IV)",
    Gains.EITHER,
    ml_or_wls,
    _by_instruments,
    least_squares=False,
    takes_priors=False,
)

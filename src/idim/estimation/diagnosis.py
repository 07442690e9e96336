"""What in the robot's description, if it were otherwise, would explain the errors: its lengths, and gravity.

A wrong length or direction of gravity leaves errors that hang together with the motion, as unmodelled friction does;
the size of the errors does not tell the two apart, their shape does. So each length, and gravity, is moved a little,
and the change of the torques along the runs is offered to the fit as one more column: what is wrong explains much of
the errors, and says by how much it is. (That base parameters regroup others when lengths change does not matter to
first order, as they are free.)
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from idim.errors import IdimError
from idim.estimation.assembly import Assembly
from idim.estimation.data import Data
from idim.estimation.factors import CURRENTS, EXTRA
from idim.estimation.newton import State, jacobian, least_squares, residuals
from idim.estimation.rows import stream_rows
from idim.estimation.solution import Solution
from idim.estimation.triangle import triangle
from idim.model.inverse_dynamics import InverseDynamics
from idim.robots.robot import Attachment, Mdh, Placement, Robot
from idim.signals.preparation import Held

STEP = 1e-3  # relative change of a length
SHORT = 0.02  # lengths below this share of the longest are not tried
SAME = 1e-6  # relative difference of lengths that are meant to be the same
EXPLAINED = 0.3  # of the variance of the errors: healthy robots stay below 0.02
NEARLY = 0.8  # of the largest share: lengths that explain as much count as alike
PIECE = 40_000  # samples that are looked at, of all runs together
MOST = 12  # lengths that are tried, the longest first


@dataclass(frozen=True)
class Suspicion:
    """What may be wrong, the ``share`` of the errors' variance that it explains, and a length's relative ``change``."""

    why: str
    advice: str
    share: float
    change: float = 0.0


def suspicion(data: Data, assembly: Assembly, solution: Solution) -> Suspicion | None:
    """What explains much of the errors, of several lengths the one that is least wrong; None where nothing does."""
    found = list(_explained(data, assembly, solution))
    most = max((each.share for each in found), default=0.0)
    if most < EXPLAINED:
        return None
    return min((each for each in found if each.share > NEARLY * most), key=lambda each: abs(each.change))


def _explained(data: Data, assembly: Assembly, solution: Solution) -> Iterator[Suspicion]:
    robot, g = data.robot, float(np.linalg.norm(data.robot.gravity))
    axes = [replace(robot, gravity=tuple(np.array(robot.gravity) + STEP * g * row)) for row in np.eye(3)]
    tried: list[tuple[str, list[Robot]]] = [("gravity", axes), *((what, [other]) for what, other in _longer(robot))]
    for what, others in tried:
        try:
            columns, e, J = _offered(data, assembly, solution, others)
        except IdimError:
            continue  # the robot cannot be assembled or follow its motion with another length
        Q = np.linalg.qr(J / np.maximum(np.linalg.norm(J, axis=0), 1e-300))[0]
        left, shown = e - Q @ (Q.T @ e), columns - Q @ (Q.T @ columns)
        steps = least_squares(shown, -left)
        share = 1 - float(np.sum((left + shown @ steps) ** 2) / np.sum(left**2))
        goes = f"{100 * share:.0f} % of the errors' variance would go with"
        if what == "gravity":
            x, y, z = np.array(robot.gravity) + STEP * g * steps
            why = f"{goes} another gravity, about ({x:.1f}, {y:.1f}, {z:.1f}) m/s2"
            advice = "check the direction of gravity, which runs carry the payload, and on which body"
            yield Suspicion(why, advice, share)
        else:
            change = STEP * float(steps[0])
            way = "longer" if change > 0 else "shorter"
            why = f"{goes} other lengths, such as {what} {100 * abs(change):.2g} % {way}"
            yield Suspicion(why, "check the robot's geometry", share, change)


def _longer(robot: Robot) -> Iterator[tuple[str, Robot]]:
    """The robot with each of its lengths a little longer, those that are the same together."""
    places = [(joint.name, joint.placement) for joint in robot.joints]
    sides = [(end.body, end.placement) for closure in robot.closures for end in (closure.a, closure.b)]
    lengths: dict[float, list[str]] = {}
    for name, placement in places + sides:
        for length in _lengths(placement):
            same = next((known for known in lengths if abs(known - length) < SAME * known), length)
            if name not in lengths.setdefault(same, []):
                lengths[same].append(name)
    longest = sorted((length for length in lengths if length > SHORT * max(lengths)), reverse=True)[:MOST]
    for length in longest:
        joints = tuple(replace(joint, placement=_scaled(joint.placement, length)) for joint in robot.joints)
        closures = tuple(
            replace(closure, a=_moved(closure.a, length), b=_moved(closure.b, length)) for closure in robot.closures
        )
        names = ", ".join(f"'{name}'" for name in lengths[length])
        yield f"the length of {1e3 * length:.4g} mm at {names}", replace(robot, joints=joints, closures=closures)


def _lengths(placement: Placement) -> list[float]:
    found = (
        [abs(placement.d), abs(placement.r), abs(placement.b)]
        if isinstance(placement, Mdh)
        else [float(np.linalg.norm(placement.xyz))]
    )
    return [length for length in found if length > 0]


def _moved(end: Attachment, length: float) -> Attachment:
    return replace(end, placement=_scaled(end.placement, length))


def _scaled(placement: Placement, length: float) -> Placement:
    """The placement with its lengths of this size a little longer."""
    if isinstance(placement, Mdh):
        values = {name: getattr(placement, name) for name in ("d", "r", "b")}
        return replace(
            placement, **{k: v * (1 + STEP) for k, v in values.items() if abs(abs(v) - length) < SAME * length}
        )
    if abs(float(np.linalg.norm(placement.xyz)) - length) < SAME * length:
        x, y, z = placement.xyz
        return replace(placement, xyz=(x * (1 + STEP), y * (1 + STEP), z * (1 + STEP)))
    return placement


def _offered(
    data: Data, assembly: Assembly, solution: Solution, others: list[Robot]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Columns of the changes that ``others`` make (., k), the errors (.,) and their Jacobian, weighted by sigma."""
    problem, n = assembly.problem, len(data.model.actuated)
    names, decimator = data.base.standard, data.preparation.decimator
    own = data.model.columns(names)
    models = [(model, model.columns(names)) for model in map(InverseDynamics, others)]
    b, p = len(names), len(names) + EXTRA
    kept = [assembly.whole.parameters.index(name) for name in problem.parameters]
    columns = [*kept, *range(assembly.whole.n_theta, assembly.whole.n_theta + 1 + CURRENTS)]
    state = State(solution.theta, 1 / solution.gains, solution.delays)
    weights = 1 / solution.sigma
    found: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    for run, whole in enumerate(data.prepared):
        size = min(max(PIECE // len(data.prepared), 1), len(whole))
        begin = (len(whole) - size) // 2
        prepared = Held(whole.run, whole.samples(begin, begin + size))
        values = assembly.motion(run, solution.theta)
        waiting: list[list[np.ndarray]] = [[] for _ in range(n)]
        streams = [
            stream_rows(model, regressor, prepared, decimator) for model, regressor in [(data.model, own), *models]
        ]
        for part, *moved in zip(*streams, strict=True):
            A = np.zeros((n, part.entries.shape[1], p + len(others)))
            A[own.rows, :, own.columns] = part.entries
            A[:, :, b : p - CURRENTS] = part.terms.transpose(1, 2, 0)
            A[:, :, p - CURRENTS : p] = part.currents.transpose(1, 2, 0)
            before = own.torques(part.entries, values, n)
            for k, (other, (_, regressor)) in enumerate(zip(moved, models, strict=True)):
                A[:, :, p + k] = regressor.torques(other.entries, values, n) - before
            for j in range(n):
                waiting[j].append(A[j, part.keep[j]])
        blocks = np.zeros((n, p + len(others), len(columns)))
        changes = np.zeros((n, p + len(others), len(others)))
        for j in range(n):
            T = triangle(*waiting[j])
            blocks[j, : len(T)] = (T[:, :p] @ assembly.maps[run, j])[:, columns]
            changes[j, : len(T)] = -state.b[j] * T[:, p:]
        e, J = residuals(blocks, state, problem.n_theta), jacobian(blocks, state, problem, True)
        found.append(
            (
                (changes * weights[:, None, None]).reshape(-1, len(others)),
                (e * weights[:, None]).reshape(-1),
                (J * weights[:, None, None]).reshape(-1, J.shape[-1]),
            )
        )
    offered, e, J = (np.concatenate(each) for each in zip(*found, strict=True))
    return offered, e, J

"""Close the loops of a robot at one configuration by Levenberg-Marquardt, and search for a home where they close."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from gtau.errors import GtauError
from gtau.model.equations import error_expressions
from gtau.model.kinematics import Coordinates
from gtau.robots.placement import within_a_turn
from gtau.robots.robot import Joint, Robot

# Lengths are in characteristic lengths of the robot, angles in rad.
CLOSED = 1e-11  # largest error of a loop that is closed
STALLED = 15  # steps with little improvement, after which a start is abandoned
NEAR = 1e-3  # a home displaced by less is the intended one: no note
FAR = 1.0  # largest admissible error of a home given in the file
LIMITS = 1e-4  # rad or m by which a home may be beyond a limit, as files round both
WELL_CONDITIONED = 30.0  # condition number that the home search aims for
STEP = 0.1
STARTS = 40
MOTOR_DECIMALS = 6  # of a home that was searched for: beyond them processors may differ
CLOSER = "correct the placements or give the passive joints a 'home' closer to the assembled robot"


@dataclass(frozen=True, eq=False)
class LoopErrors:
    """Loops, one configuration at a time: ``function`` maps c to errors and Jacobian, :func:`error_expressions`."""

    layout: Coordinates
    function: Any

    @cached_property
    def looped(self) -> np.ndarray:
        """Indices into yd of the coordinates that a closure or coupling depends on."""
        return np.unique(self.function.sparsity_out(1).get_triplet()[1]).astype(int)

    @property
    def joints(self) -> list[int]:
        """Numbers of the joints in loops."""
        return [int(k) for k in self.looped if k < len(self.layout.robot.joints)]

    def __call__(self, c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Evaluate errors (rows,) and scaled Jacobian (rows, n_y) at ``c`` (n_c,)."""
        error, G = self.function(c)
        return error.full().ravel(), G.full()

    @property
    def passive(self) -> np.ndarray:
        """Indices into yd of the passive coordinates in loops."""
        return np.intersect1d(self.looped, self.layout.passive)

    def moved(self, c: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Move the configuration ``c`` (n_c,) by a scaled displacement (n_y,)."""
        return self.layout.retract(c[:, None], (step * self.layout.unit)[:, None])[:, 0]

    def condition(self, c: np.ndarray) -> float:
        """Compute the condition number at ``c`` of the scaled columns of the passive coordinates in loops."""
        sigma = np.linalg.svd(self(c)[1][:, self.passive], compute_uv=False)
        return float(sigma[0] / max(sigma[-1], 1e-12)) if sigma.size else 1.0

    def gap(self, c: np.ndarray) -> str:
        """Find the loop with the largest closure error at ``c`` (n_c,), and that error."""
        robot, start, gaps, error = self.layout.robot, 0, [], self(c)[0]
        welds = sum(tie.kind == "weld" for tie in robot.closures)
        turned = iter(np.arccos(np.clip(1.0 - error[len(error) - welds :], -1.0, 1.0)))
        for number, closure in enumerate(robot.closures, start=1):
            distance = float(np.linalg.norm(error[start : start + 3]))
            angle = 0.0
            start += 3
            if closure.kind == "weld":
                angle = float(np.fmax(np.linalg.norm(error[start : start + 3]), next(turned)))
                start += 3
            most = max(distance, angle)
            shift = 1e3 * distance * self.layout.length
            sizes = [f"{shift:.3g} mm"] * (distance > 1e-3 * most)
            sizes += [f"{np.degrees(angle):.3g} degrees"] * (angle > 1e-3 * most)
            name = f"closure {number} ('{closure.a.body}' to '{closure.b.body}') stays open by {' and '.join(sizes)}"
            gaps.append((most, name))
        for coupling, value in zip(robot.couplings, error[start:], strict=False):
            gaps.append((abs(float(value)), f"the coupling of '{coupling.joint}' is not met"))
        return max(gaps)[1]

    def apart(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Compute the distance between the scaled coordinates (n_y,) of two configurations, modulo full turns."""
        layout = self.layout
        joints = slice(len(self.layout.robot.joints))
        distance = np.zeros(layout.n_y)
        change = after[joints] - before[joints]
        distance[joints] = np.where(layout.angular[joints], within_a_turn(change), change)
        for slots in layout.platforms:
            distance[slots.rates] = slots.displacement(before, after)
        return np.abs(distance / layout.unit)


def loop_errors(layout: Coordinates) -> LoopErrors:
    """Compile the errors of a robot's loops and their Jacobian from its closure equations."""
    c, yd = ca.SX.sym("c", layout.n_c), ca.SX.sym("yd", layout.n_y)
    return LoopErrors(layout, ca.Function("loops", [c], list(error_expressions(layout, c, yd))))


def closed(errors: LoopErrors, c: np.ndarray, moving: np.ndarray) -> np.ndarray:
    """Minimise the loop errors by Levenberg-Marquardt from ``c`` (n_c,), with the ``moving`` coordinates of yd."""
    damping, stalled = 1e-3, 0
    error, G = errors(c)
    for _ in range(200):
        size = np.linalg.norm(error)
        if np.abs(error).max(initial=0.0) < 1e-15:
            break
        U, sigma, Vt = np.linalg.svd(G[:, moving], full_matrices=False)
        level = damping * size  # fades as the loops close: Newton's method in the end
        share = np.where(sigma > 1e-9, sigma / (sigma**2 + level), 0.0)
        step = np.zeros(G.shape[1])
        step[moving] = -Vt.T @ (share * (U.T @ error))
        tried = errors.moved(c, step / max(1.0, np.abs(step).max()))
        error_there, G_there = errors(tried)
        there = np.linalg.norm(error_there)
        stalled = stalled + 1 if there > 0.99 * size else 0
        if stalled == STALLED:
            break
        if there < size:
            c, error, G = tried, error_there, G_there
            damping = max(damping / 3, 1e-12)
        elif damping > 1e3 or size < CLOSED:
            break
        else:
            damping *= 4
    return c


def is_closed(errors: LoopErrors, c: np.ndarray, tolerance: float = CLOSED) -> bool:
    """Decide whether the loops close at ``c`` (n_c,)."""
    return bool(np.abs(errors(c)[0]).max(initial=0.0) < tolerance)


def nearest_closed(errors: LoopErrors, given: np.ndarray, tolerance: float = CLOSED) -> np.ndarray:
    """Find the closed configuration (n_c,) nearest to the one given, within the position limits if there is one."""
    held = closed(errors, given, errors.passive)
    near = not errors.layout.robot.file.home_given or errors.apart(given, held).max() < FAR
    if near and is_closed(errors, held, tolerance) and not _outside(errors, held):
        return _unwound(errors, given, held)
    best: tuple[tuple[bool, float], np.ndarray] | None = None
    rng, open_ones = np.random.default_rng(0), [held]
    for start in range(STARTS):
        there = closed(errors, _scattered(errors, given, rng) if start else given, errors.looped)
        if not is_closed(errors, there, tolerance):
            open_ones.append(there)
            continue
        there = _unwound(errors, given, there)
        rank = _outside(errors, there), float(np.linalg.norm(errors.apart(given, there)))
        if best is None or rank < best[0]:
            best = rank, there
        if start == 0 and not rank[0]:
            break
    if best is None:
        nearly = min(open_ones, key=lambda c: float(np.abs(errors(c)[0]).max()))
        raise GtauError(
            f"robot '{errors.layout.robot.name}': the loops do not close near the home configuration, nor in any "
            f"other pose tried, at best {errors.gap(nearly)}; check the placements of the closures and of the "
            "joints in the loops, and their units, or write a 'home' closer to the assembled robot."
        )
    return best[1]


def _unwound(errors: LoopErrors, given: np.ndarray, solved: np.ndarray) -> np.ndarray:
    """Remove full turns from a configuration, except for coupled joints, whose couplings would no longer hold."""
    robot, unwound = errors.layout.robot, solved.copy()
    coupled = {name for tie in robot.couplings for name in tie.terms}
    turning = [k for k, joint in enumerate(robot.joints) if joint.turns and joint.name not in coupled]
    unwound[turning] = given[turning] + within_a_turn(solved[turning] - given[turning])
    return unwound


def _scattered(errors: LoopErrors, given: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    c = given.copy()
    for k in errors.joints:
        joint = errors.layout.robot.joints[k]
        reach = np.pi if joint.turns else errors.layout.length
        low, high = joint.limits.position or (-np.inf, np.inf)
        low, high = max(low, given[k] - reach), min(high, given[k] + reach)
        c[k] = rng.uniform(low, high) if low < high else given[k]
    return c


def _outside(errors: LoopErrors, c: np.ndarray) -> bool:
    return any(limit_excess(errors.layout.robot.joints[k], c[k]) > LIMITS for k in errors.joints)


def limit_excess(joint: Joint, value: float) -> float:
    """Compute how far a coordinate is beyond its joint's position limits, rad or m."""
    low, high = joint.limits.position or (-np.inf, np.inf)
    return max(low - value, value - high, 0.0)


def well_conditioned(errors: LoopErrors, c: np.ndarray) -> np.ndarray:
    """Move a closed configuration (n_c,) step by step until it is well conditioned or stops improving."""
    condition, size, limited = errors.condition(c), STEP, _outside(errors, c)
    while condition > WELL_CONDITIONED and size > STEP / 10:
        best = float(f"{condition:.3g}"), c
        for direction in _directions(errors, c):
            for sign in (1.0, -1.0):
                tried = closed(errors, errors.moved(c, sign * size * direction), errors.looped)
                if is_closed(errors, tried) and _outside(errors, tried) <= limited:
                    there = float(f"{errors.condition(tried):.3g}")
                    best = min(best, (there, tried), key=lambda candidate: candidate[0])
        size = size if best[0] < 0.99 * condition else size / 2
        condition, c = best
    return c


def with_round_motors(errors: LoopErrors, c: np.ndarray) -> np.ndarray:
    """Find the closed configuration (n_c,) near ``c`` with rounded motor positions, if there is one."""
    rounded = c.copy()
    rounded[errors.layout.actuated] = np.round(c[errors.layout.actuated], MOTOR_DECIMALS)
    solved = closed(errors, rounded, errors.passive)
    return solved if is_closed(errors, solved) and errors.apart(c, solved).max() < NEAR else c


def _directions(errors: LoopErrors, c: np.ndarray) -> list[np.ndarray]:
    """List displacements (n_y,) that keep the loops closed, their largest entries 1; motors' first."""
    looped = errors.looped  # whose projections do not depend on the processor
    _, sigma, Vt = np.linalg.svd(errors(c)[1][:, looped])
    null = Vt[int((sigma > 1e-7).sum()) :]
    projector = null.T @ null
    directions: list[np.ndarray] = []
    for k in np.argsort(~np.isin(looped, errors.layout.actuated), kind="stable"):
        size = np.linalg.norm(projector[k])
        alike = (abs(projector[k] @ other) > 0.99 * size * np.linalg.norm(other) for other in directions)
        if size >= 0.1 and not any(alike):
            directions.append(projector[k] / np.abs(projector[k]).max())
    steps = np.zeros((len(directions), errors.layout.n_y))
    steps[:, looped] = np.reshape(directions, (-1, looped.size))
    return list(steps)


def closed_home(layout: Coordinates) -> np.ndarray:
    """Close the loops near home, and check that the actuated joints move all of the robot: the home (n_c,) found."""
    robot, errors = layout.robot, loop_errors(layout)
    home = closed(errors, layout.home, errors.passive)
    if not is_closed(errors, home):
        raise GtauError(
            f"robot '{robot.name}': the loops do not close near the home configuration, {errors.gap(home)}; {CLOSER}."
        )
    moved = errors.apart(layout.home, home)
    if moved.max() > FAR:
        k = int(moved.argmax())
        raise GtauError(
            f"robot '{robot.name}': the loops close only far from the home configuration, with '{layout.names[k]}' "
            f"{moved[k] * layout.unit[k]:.4g} {'rad' if layout.angular[k] else 'm'} away from it; {CLOSER}."
        )
    G = errors(home)[1]
    rank, total = (int(np.linalg.matrix_rank(columns, tol=1e-7)) for columns in (G[:, layout.passive], G))
    if rank < len(layout.passive):
        _refuse_free(layout, G[:, layout.passive], rank)
    if total > rank:
        _refuse_redundant(robot, G[:, [*layout.passive, *layout.actuated]], total, total - rank)
    return home


def _refuse_free(layout: Coordinates, G_p: np.ndarray, rank: int) -> None:
    """Refuse passive coordinates left free by rank-deficient columns ``G_p`` of the loop equations."""
    robot = layout.robot
    free = np.abs(np.linalg.svd(G_p)[2][rank:]).max(axis=0) > 1e-6
    held = np.abs(G_p).max(axis=0, initial=0.0) > 1e-7  # a turret under a loop turns, and closes none
    names = [layout.names[k] for k in layout.passive[free]]
    if alone := [layout.names[k] for k in layout.passive[free & ~held]]:
        raise GtauError(
            f"robot '{robot.name}': no motor moves {', '.join(alone)} and no closure holds "
            f"{'them' if len(alone) > 1 else 'it'}; hold the joints that stand still in the logs, "
            f"{_by_held(alone[0])}, fix a base that floats by 'base: fixed', or mark the joint actuated."
        )
    stiff = ""
    if sprung := [joint.name for joint in robot.joints if joint.spring is not None and joint.name in names]:
        stiff = f"hold the springs {', '.join(sprung)} if they hardly deflect, {_by_held(sprung[0])}, "
    raise GtauError(
        f"robot '{robot.name}': with the actuated joints ({', '.join(robot.actuated)}) held at the home configuration "
        f"{', '.join(names)} can still move ({len(layout.passive) - rank} dof); {stiff}actuate more joints, or move "
        "home away from a singular pose."
    )


def _refuse_redundant(robot: Robot, G: np.ndarray, rank: int, excess: int) -> None:
    """Refuse actuated joints that the loop equations tie to each other: the last columns of ``G``, of this rank."""
    n = len(robot.actuated)
    free = np.linalg.svd(G)[2][rank:, G.shape[1] - n :]  # how the motors can move
    ties = np.linalg.svd(free)[2][n - excess :]  # and its orthogonal complement, which they cannot move
    stuck = np.abs(free).max(axis=0, initial=0.0) < 1e-9
    tied = np.abs(ties).max(axis=0) > 1e-6
    names = np.array(robot.actuated)
    fixed, apart = names[stuck].tolist(), names[tied & ~stuck].tolist()
    why = [f"the closures hold {', '.join(fixed)} fixed"] * bool(fixed)
    why += [f"loops or couplings tie {', '.join(apart)} at home"] * bool(apart)
    raise GtauError(
        f"robot '{robot.name}': actuation is redundant, which is not supported: {n} actuated joints for {len(free)} "
        f"dof, where {' and '.join(why)}; mark {excess} of them passive (in MJCF, without an actuator; of URDF, not in "
        f"'name_mot'), hold the joints that stand still in the logs, {_by_held((apart or fixed)[0])}, or check the "
        f"closures and the dof of platforms."
    )


def _by_held(name: str) -> str:
    return f"by 'held: {{{name}: POSITION}}' or a list of the moving 'joints' beside the robot's 'file'"

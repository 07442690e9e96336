"""Adjust the placements in loops that close only up to the digits of their file, so that they close exactly.

With rounded numbers the pins of a planar loop are not parallel, and taken literally none of its joints could move. The
numbers nearest to the written ones are found with which the loops close in every pose and parallel axes stay parallel,
by Gauss and Newton. None moves by more than half a unit of its last digit: a larger gap is no rounding.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple, replace
from itertools import product
from math import pi

import casadi as ca
import numpy as np

from gtau.model.equations import error_expressions
from gtau.model.kinematics import Coordinates, Varied, constant, frames, turned
from gtau.model.loop_closure import CLOSED, LoopErrors, closed
from gtau.robots.placement import angles_of, digits_of, euler_angles, is_written
from gtau.robots.robot import GROUND, Attachment, Joint, Mdh, Placement, Pose, Robot

# Lengths are in characteristic lengths of the robot, angles in rad.
DRAWN = 1e-2  # the worst of 40 planar loops with three decimals: gap 3e-3
LITERAL = 1e-13  # gap of loops as written: in the catalog 8e-16 at most
POSES = 12  # in which loops must close: more than the coordinates of a placement
SPREAD = 0.3  # of the motors around home
HALVINGS = 6  # of the motors' steps, until a pose is within reach
STRETCHED = 0.2  # share of home's smallest singular value in poses out of reach
STEPS = 12
TURNS = 4  # roundings of an angle by which axes may be off from parallel or perpendicular
EXACT = 1e-14  # gap at which the placements are final
MDH_ANGLES = (True, False, True, False, True, False)
POSE_ANGLES = (False, False, False, True, True, True)


def with_exact_loops(robot: Robot, errors: LoopErrors, home: np.ndarray) -> Robot:
    """Move the placements in loops that close up to rounding, so that they close in every pose, with a note."""
    moving = _moving(errors, home)
    if moving is None:
        return robot
    poses = list(_around(errors, home, moving))
    gaps = [float(np.abs(errors(c)[0]).max()) for c in poses]
    joints = [robot.joints[k] for k in errors.joints]
    places = {joint.name: Attachment(joint.antecedent, joint.placement) for joint in joints}
    for number, closure in enumerate(robot.closures):
        places |= {f"{number} a": closure.a, f"{number} b": closure.b}
    bounds, nonzero = _bounds(robot, [place.placement for place in places.values()], joints)
    names = {name for joint in joints for name in (joint.name, joint.antecedent)}
    carrying = [joint for joint in robot.joints if joint.name in names]
    pairs, tilt = _aligned(errors.layout, carrying, poses, bounds)
    if not LITERAL < max(*gaps, tilt) < DRAWN:
        return robot
    varied = _varied(errors.layout, places, carrying, pairs)
    written = bounds * nonzero
    grounded = np.array([[place.body == GROUND] for place in places.values()])
    open_loops = max(gaps) >= LITERAL
    for aligned, bound in product((True, False), (written * grounded, written, bounds)):
        if not open_loops and not (aligned and pairs):
            continue
        if (change := _fitted(varied, errors, poses, moving, bound, aligned)) is not None:
            gap = f"axes in the loops are {np.degrees(tilt):.2g} degrees from parallel or perpendicular"
            return _moved(robot, places, change, errors.gap(poses[int(np.argmax(gaps))]) if open_loops else gap)
    return robot


def _moving(errors: LoopErrors, home: np.ndarray) -> np.ndarray | None:
    """Select the coordinates of yd that close the loops, redundant motors too; None if more than equations."""
    welds = sum(tie.kind == "weld" for tie in errors.layout.robot.closures)
    passive, G = errors.passive, errors(home)[1]
    G = G[: len(G) - welds]
    if len(G) < passive.size or not passive.size:
        return None
    motors, chosen = np.setdiff1d(errors.looped, passive), list(passive)
    tied = np.linalg.svd(G[:, passive])[0][:, passive.size :].T @ G[:, motors]
    while motors.size and (sizes := np.linalg.norm(tied, axis=0)).max() > DRAWN:
        k = int(sizes.argmax())
        chosen.append(motors[k])
        direction = tied[:, k] / sizes[k]
        tied = tied - np.outer(direction, direction @ tied)
    return np.sort(np.array(chosen, dtype=int)) if len(G) >= len(chosen) else None


def _around(errors: LoopErrors, home: np.ndarray, moving: np.ndarray) -> Iterator[np.ndarray]:
    """Iterate over home and poses within reach around it, with other positions of the motors in the loops."""

    def smallest(c: np.ndarray) -> float:
        return float(np.linalg.svd(errors(c)[1][:, moving], compute_uv=False)[-1])

    home = closed(errors, home, moving)
    rng = np.random.default_rng(0)
    motors = np.setdiff1d(errors.looped, moving)
    least = STRETCHED * smallest(home)
    yield home
    for _ in range(POSES - 1):
        step = np.zeros(errors.layout.n_y)
        step[motors] = rng.uniform(-SPREAD, SPREAD, motors.size)
        for _ in range(HALVINGS):
            if smallest(c := closed(errors, errors.moved(home, step), moving)) > least:
                yield c
                break
            step /= 2


def _replaced(robot: Robot, placements: Mapping[str, Placement]) -> Robot:
    """Replace placements in loops by their names: names of joints, and ``0 a`` of the first closure."""

    def end(name: str, at: Attachment) -> Attachment:
        return replace(at, placement=placements.get(name, at.placement))

    joints = (replace(joint, placement=placements.get(joint.name, joint.placement)) for joint in robot.joints)
    closures = (
        replace(closure, a=end(f"{number} a", closure.a), b=end(f"{number} b", closure.b))
        for number, closure in enumerate(robot.closures)
    )
    return replace(robot, joints=tuple(joints), closures=tuple(closures))


def _numbers(placement: Placement) -> tuple[float, ...]:
    return astuple(placement) if isinstance(placement, Mdh) else (*placement.xyz, *placement.rpy)


def _changed(placement: Placement, change: np.ndarray, computed: bool) -> Placement:
    """Change the six numbers; of an orientation ``computed`` by a reader, turn it about its three axes."""
    if isinstance(placement, Mdh):
        return Mdh(*np.add(_numbers(placement), change).tolist())
    x, y, z = (placement.position + change[:3]).tolist()
    roll, pitch, yaw = np.add(placement.rpy, change[3:]).tolist()
    if computed:
        roll, pitch, yaw = angles_of(placement.rotation @ Pose(rpy=tuple(change[3:].tolist())).rotation)
    return Pose((x, y, z), (roll, pitch, yaw))


def _varied_placement(placement: Placement, change: ca.SX, computed: bool) -> Varied:
    """Express :func:`_changed` symbolically."""
    x, _, z = np.eye(3)
    if isinstance(placement, Mdh):
        gamma, b, alpha, d, theta, r = ca.vertsplit(ca.DM(_numbers(placement)) + change)
        before = turned(z, gamma) @ turned(x, alpha)
        return Varied(
            tuple(placement.position.tolist()),
            R=before @ turned(z, theta),
            p=ca.vertcat(0, 0, b) + before @ ca.vertcat(d, 0, r),
        )
    written = np.zeros(3) if computed else placement.rpy
    roll, pitch, yaw = ca.vertsplit(ca.DM(written) + change[3:])
    rotation = turned(z, yaw) @ turned(np.eye(3)[1], pitch) @ turned(x, roll)
    rotation = constant(placement.rotation) @ rotation if computed else rotation
    return Varied(placement.xyz, R=rotation, p=constant(placement.position) + change[:3])


def _bounds(robot: Robot, placements: list[Placement], joints: list[Joint]) -> tuple[np.ndarray, np.ndarray]:
    """Find how far the numbers of placements (places, 6) may move, m and rad, and which are not zero.

    A number computed by a reader moves by what the numbers of two placements allow, one written with all digits not at
    all. Multiples of pi/12 may have been rounded, and count as zero.
    """
    numbers = np.array([_numbers(placement) for placement in placements])
    angular = np.array([MDH_ANGLES if isinstance(placement, Mdh) else POSE_ANGLES for placement in placements])
    remainder = np.where(angular, np.abs(numbers - np.round(numbers / (pi / 12)) * (pi / 12)), np.abs(numbers))
    nonzero = remainder > CLOSED
    axes = [component for joint in joints for component in joint.axis]
    lengths = digits_of(numbers[~angular])
    angles = digits_of([*numbers[angular & nonzero], *axes])
    written, unit = np.vectorize(is_written)(numbers), 1.0
    rounding = robot.file.rounding
    if rounding is None:
        if not angles.significant:  # in rad; then perhaps in degrees
            unit = pi / 180
            angles = digits_of(np.round(numbers[angular & nonzero] / unit, 10))
            written |= angular
        turns = unit * np.vectorize(angles.half_unit)(numbers / unit)
        half = np.where(angular, turns, np.vectorize(lengths.half_unit)(numbers))
        return np.where(written | ~nonzero, half, 0.0), nonzero
    half = np.vectorize(rounding.half_unit)(numbers)
    arms = np.array([[np.linalg.norm(placement.position)] for placement in placements])
    moved = np.where(written, half, 2 * half + rounding.turn * arms)
    return np.where(angular, rounding.turn, moved), nonzero


def _axes(layout: Coordinates, joints: list[Joint], c: ca.SX) -> list[ca.SX]:
    """Express the axes (3,) of joints in the base."""
    frame = frames(layout, c)
    return [frame[joint.name].R_0 @ constant(np.array(joint.axis)) for joint in joints]


def _aligned(
    layout: Coordinates, joints: list[Joint], poses: list[np.ndarray], bounds: np.ndarray
) -> tuple[list[tuple[int, int, bool]], float]:
    """Pair the axes that are parallel (True) or perpendicular in all poses up to the digits; find the largest error."""
    c = ca.SX.sym("c", layout.n_c)
    function = ca.Function("axes", [c], [ca.densify(ca.horzcat(*_axes(layout, joints, c)).T)])
    axes = np.array([function(pose).full() for pose in poses])
    tolerance = min(DRAWN, TURNS * float(bounds[:, 3:].max()))
    cross = np.cross(axes[:, :, None], axes[:, None])
    crossed = np.linalg.norm(cross, axis=-1).max(axis=0)
    along = np.abs(axes @ axes.transpose(0, 2, 1)).max(axis=0)
    first = [int(np.argmax(row <= max(tolerance, LITERAL))) for row in crossed]
    pairs = [(k, j, True) for j, k in enumerate(first) if k < j]
    kinds = sorted(set(first))
    pairs += [(k, j, False) for k in kinds for j in kinds if k < j and along[k, j] < tolerance]
    errors = [np.abs(cross[:, k, j]).max() if parallel else along[k, j] for k, j, parallel in pairs]
    return pairs, float(max(errors, default=0.0))


def _varied(
    layout: Coordinates, places: Mapping[str, Attachment], joints: list[Joint], pairs: list[tuple[int, int, bool]]
) -> ca.Function:
    """Compile from c and changes (6 places,): errors of loops and axes with their Jacobians, and slopes by changes."""
    c = ca.SX.sym("c", layout.n_c)
    yd = ca.SX.sym("yd", layout.n_y)
    change = ca.SX.sym("change", 6 * len(places))
    computed = layout.robot.file.rounding is not None
    parts = ca.vertsplit(change, 6)
    placements = {
        name: _varied_placement(place.placement, part, computed)
        for (name, place), part in zip(places.items(), parts, strict=True)
    }
    varied = Coordinates(_replaced(layout.robot, placements))
    axes, count = _axes(varied, joints, c), len(layout.robot.joints)
    tilts = [ca.cross(axes[k], axes[j]) if parallel else ca.dot(axes[k], axes[j]) for k, j, parallel in pairs]
    tilt = ca.vertcat(ca.SX(0, 1), *tilts)
    by_joints = ca.horzcat(ca.jacobian(tilt, c)[:, :count], ca.SX(tilt.numel(), layout.n_y - count))
    errors, G = error_expressions(varied, c, yd)
    slopes = ca.jacobian(ca.vertcat(errors, tilt), change)
    return ca.Function("varied", [c, change], [errors, G, tilt, by_joints @ constant(np.diag(layout.unit)), slopes])


def _fitted(
    varied: ca.Function,
    errors: LoopErrors,
    poses: Sequence[np.ndarray],
    moving: np.ndarray,
    bound: np.ndarray,
    aligned: bool,
) -> np.ndarray | None:
    """Find the smallest change (places, 6) within ``bound`` with which the loops close in all poses."""
    unknown, change, before, poses = bound > 0.0, np.zeros(bound.shape), np.inf, list(poses)
    for _ in range(STEPS):
        A, b, worst, by = [], [], 0.0, change.ravel()
        changed = replace(errors, function=lambda c, by=by: varied(c, by)[:2])
        for k, c in enumerate(poses):
            poses[k] = c = closed(changed, c, moving)
            error, G, tilt, by_joints, slopes = (part.full() for part in varied(c, by))
            rows = len(error) + len(tilt) * aligned
            surplus = np.linalg.svd(np.vstack([G, by_joints])[:rows, moving])[0][:, moving.size :].T
            A.append(surplus @ slopes[:rows, unknown.ravel()])
            b.append(surplus @ np.vstack([error, tilt])[:rows, 0])
            worst = max(worst, float(np.abs(error).max()), float(np.abs(b[-1]).max(initial=0.0)))
        if worst < EXACT:
            return change
        if worst > before / 2:
            return None
        before, slope = worst, np.vstack(A)
        change[unknown] = _least(slope, slope @ change[unknown] - np.concatenate(b), bound[unknown], worst)
    return None


def _least(A: np.ndarray, b: np.ndarray, bound: np.ndarray, worst: float) -> np.ndarray:
    """Find the smallest x (n,) within ``bound`` for which ``A x = b``; it is no solution where there is none."""
    x, free = np.zeros(bound.size), np.ones(bound.size, dtype=bool)
    while free.any():
        U, sigma, Vt = np.linalg.svd(A[:, free], full_matrices=False)
        kept = sigma > max(1e-7, 10 * worst) * max(sigma.max(initial=0.0), 1.0)
        x[free] = Vt[kept].T @ ((U[:, kept].T @ (b - A[:, ~free] @ x[~free])) / sigma[kept])
        beyond = free & (np.abs(x) > bound)
        if not beyond.any():
            break
        x[beyond] = np.copysign(bound[beyond], x[beyond])
        free &= ~beyond
    return x


def _moved(robot: Robot, places: Mapping[str, Attachment], change: np.ndarray, gap: str) -> Robot:
    """Move the placements, with a note on the ``gap`` that it closes, and the largest shift and turn."""
    computed, placements, shift, angle = robot.file.rounding is not None, {}, 0.0, 0.0
    for (name, place), by in zip(places.items(), change, strict=True):
        if by.any():
            before = place.placement
            placements[name] = after = _changed(before, by, computed)
            shift = max(shift, float(np.linalg.norm(after.position - before.position)))
            angle = max(angle, float(np.linalg.norm(euler_angles(before.rotation.T @ after.rotation))))
    return _replaced(robot, placements).noted(
        f"{gap}, as the numbers in the file are rounded; placements in the loops were moved by up to "
        f"{1e3 * shift:.2g} mm and {np.degrees(angle):.2g} degrees, so that they close in every pose"
    )

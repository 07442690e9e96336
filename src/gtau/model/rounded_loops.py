"""Adjust the placements in loops that close only up to the digits of their file, so that they close exactly.

A planar loop has more closure equations than it needs, since none of its bars leaves the plane. With rounded numbers
its pins are no longer parallel, and taken literally no joint of it could move. The placements nearest to the written
ones are found with which the loops close in every pose, by Gauss and Newton, the joints' coordinates solved for.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from gtau.model.kinematics import coordinates
from gtau.model.loop_closure import CLOSED, LoopErrors, closed, loop_errors
from gtau.robots.geometry import angles_of, turn
from gtau.robots.robot import GROUND, Attachment, Closure, Joint, Placement, Pose, Robot

# Lengths are in characteristic lengths of the robot, angles in rad.
DRAWN = 1e-2  # with three decimals, the worst of 40 planar loops: gap 3e-3, placements moved by 1.3e-3
LITERAL = 1e-13  # gap of loops that close as they are written: on all robots of the catalog 8e-16 at most
POSES = 12  # number of poses in which loops must close: more than the coordinates of a placement
SPREAD = 0.3  # of the motors around home
STEPS = 12
EXACT = 1e-14  # gap at which the placements are final
AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def with_exact_loops(robot: Robot, errors: LoopErrors, home: np.ndarray) -> Robot:
    """Move the placements in loops that close up to rounding, so that they close in every pose.

    Parameters
    ----------
    robot : Robot
    errors : LoopErrors
        Of the robot.
    home : ndarray
        Configuration (n_c,) that minimises the loop errors.

    Returns
    -------
    Robot
        The same one where its loops close in every pose already, or in none; else with a note.
    """
    moving = _moving(errors, home)
    if moving is None:
        return robot
    poses = [closed(errors, each, moving) for each in _around(errors, home, moving)]
    gaps = [float(np.abs(errors(c)[0]).max()) for c in poses]
    if not LITERAL < max(gaps) < DRAWN:
        return robot
    varied = _varied(robot, set(errors.looped.tolist()))
    for free in (varied.written & varied.grounded[:, None], varied.written, np.ones_like(varied.written)):
        if (found := _fitted(varied, errors, poses, moving, free)) is not None:
            exact, shift, angle = _moved(robot, varied, found)
            note = (
                f"{errors.gap(poses[int(np.argmax(gaps))])}, as the numbers in the file are rounded; placements in the "
                f"loops were moved by up to {1e3 * shift:.2g} mm and {np.degrees(angle):.2g} degrees, so that they "
                "close in every pose"
            )
            return replace(exact, notes=(*robot.notes, note))
    return robot


def _moving(errors: LoopErrors, home: np.ndarray) -> np.ndarray | None:
    """Select the coordinates (indices into yd) that close the loops, redundant motors included.

    None where there are no more equations than such coordinates.
    """
    layout, G, passive = errors.layout, errors(home)[1], errors.passive
    rows = G.shape[0] - sum(closure.kind == "weld" for closure in layout.robot.closures)
    motors = np.setdiff1d(errors.looped, passive)
    if rows <= passive.size or not passive.size:
        return None
    U, *_ = np.linalg.svd(G[:rows, passive])
    tied = U[:, passive.size :].T @ G[:rows, motors]
    chosen: list[int] = []
    while motors.size and (sizes := np.linalg.norm(tied, axis=0)).max() > DRAWN:
        k = int(sizes.argmax())
        chosen.append(int(motors[k]))
        direction = tied[:, k] / sizes[k]
        tied = tied - np.outer(direction, direction @ tied)
    moving = np.sort(np.array([*passive, *chosen], dtype=int))
    return moving if rows > moving.size else None


def _around(errors: LoopErrors, home: np.ndarray, moving: np.ndarray) -> Iterator[np.ndarray]:
    """Iterate over home and configurations around it, with other positions of the motors in the loops."""
    rng, motors = np.random.default_rng(0), np.setdiff1d(errors.looped, moving)
    yield home
    for _ in range(POSES - 1):
        step = np.zeros(errors.layout.n_y)
        step[motors] = rng.uniform(-SPREAD, SPREAD, motors.size)
        yield errors.moved(home, step)


@dataclass(frozen=True, eq=False)
class _Varied:
    """A robot with six joints at each placement in a loop, by which the placement moves.

    ``places`` are the names of these joints' placements and ``virtual`` (places, 6) their indices in ``c`` and ``yd``,
    ``own`` the indices of the robot's own joints. ``written`` (places, 6) marks the coordinates that are written with
    digits: not those that are zero, nor angles that are multiples of pi/2. ``grounded`` (places,) marks those on the
    ground: where moving them is enough, legs that are alike stay so.
    """

    errors: LoopErrors
    places: tuple[str, ...]
    virtual: np.ndarray
    own: np.ndarray
    written: np.ndarray
    grounded: np.ndarray


def _varied(robot: Robot, looped: set[int]) -> _Varied:
    joints: list[Joint] = []
    places: list[str] = []
    written: list[list[bool]] = []
    grounded: list[bool] = []

    def vary(place: str, at: Attachment) -> str:
        before = at.body
        for k in range(6):
            kind, placement = ("prismatic" if k < 3 else "revolute"), at.placement if k == 3 else Pose()
            name = f"{place} {k}"
            joints.append(Joint(name, before, kind, placement, AXES[k % 3], actuated=False, parameters="none"))  # type: ignore[arg-type]
            before = name
        places.append(place)
        grounded.append(at.body == GROUND)
        written.append(_with_digits(at.placement))
        return before

    own = []
    for k, joint in enumerate(robot.joints):
        if k in looped:
            before = vary(f"joint {joint.name}", Attachment(joint.antecedent, joint.placement))
            joint = replace(joint, antecedent=before, placement=Pose())
        own.append(len(joints))
        joints.append(joint)
    platforms, closures = {platform.name for platform in robot.platforms}, []
    for number, closure in enumerate(robot.closures):
        ends = (
            end if end.body in platforms else Attachment(vary(f"closure {number} {side}", end))
            for side, end in (("a", closure.a), ("b", closure.b))
        )
        closures.append(Closure(closure.kind, *ends))
    whole = replace(robot, joints=tuple(joints), closures=tuple(closures), named_tool="", springs=(), floating="")
    numbers = {joint.name: k for k, joint in enumerate(joints)}
    virtual = np.array([[numbers[f"{place} {k}"] for k in range(6)] for place in places])
    errors = loop_errors(coordinates(whole))
    return _Varied(errors, tuple(places), virtual, np.array(own), np.array(written), np.array(grounded))


def _with_digits(placement: Placement) -> list[bool]:
    turned = np.abs(placement.rotation - np.round(placement.rotation)).max() > CLOSED
    return [*(np.abs(placement.position) > 0.0).tolist(), *[bool(turned)] * 3]


def _fitted(
    varied: _Varied, errors: LoopErrors, poses: list[np.ndarray], moving: np.ndarray, free: np.ndarray
) -> np.ndarray | None:
    """Find the smallest change (places, 6) of the ``free`` coordinates with which the loops close in all poses."""
    whole, own, n_t = varied.errors, varied.own, len(errors.layout.robot.joints)
    shifts = whole.layout.n_y - errors.layout.n_y
    of_whole = np.array([own[k] if k < n_t else k + shifts for k in moving])
    columns, change = varied.virtual[free], np.zeros(int(free.sum()))
    configurations = []
    for c in poses:
        full = np.zeros(whole.layout.n_c)
        full[own], full[len(whole.layout.robot.joints) :] = c[:n_t], c[n_t:]
        configurations.append(full)
    for _ in range(STEPS):
        A, b, worst = [], [], 0.0
        for k, c in enumerate(configurations):
            c[columns] = change * whole.unit[columns]
            configurations[k] = c = closed(whole, c, of_whole)
            error, G = whole(c)
            U, *_ = np.linalg.svd(G[:, of_whole])
            surplus = U[:, of_whole.size :].T
            A.append(surplus @ G[:, columns])
            b.append(surplus @ error)
            worst = max(worst, float(np.abs(error).max()))
        if worst < EXACT:
            found = np.zeros(free.shape)
            found[free] = change * whole.unit[columns]
            return found if np.abs(change).max(initial=0.0) < DRAWN else None
        U, sigma, Vt = np.linalg.svd(np.vstack(A), full_matrices=False)
        kept = sigma > max(1e-7, 10 * worst) * max(sigma.max(initial=0.0), 1.0)  # the others vanish as the loops close
        change = change - Vt[kept].T @ ((U[:, kept].T @ np.concatenate(b)) / sigma[kept])
    return None


def _moved(robot: Robot, varied: _Varied, found: np.ndarray) -> tuple[Robot, float, float]:
    """Move the placements, and return the largest shift (m) and turn (rad) with the robot."""
    change = dict(zip(varied.places, found, strict=True))

    def moved(place: str, placement: Placement) -> Placement:
        if place not in change or not change[place].any():
            return placement
        rotation = placement.rotation
        for axis, angle in zip(np.eye(3), change[place][3:], strict=True):
            rotation = rotation @ turn(axis, angle)
        x, y, z = (placement.position + change[place][:3]).tolist()
        return Pose((x, y, z), angles_of(rotation) if change[place][3:].any() else angles_of(placement.rotation))

    def end(place: str, at: Attachment) -> Attachment:
        return replace(at, placement=moved(place, at.placement))

    joints = (replace(joint, placement=moved(f"joint {joint.name}", joint.placement)) for joint in robot.joints)
    closures = (
        replace(closure, a=end(f"closure {number} a", closure.a), b=end(f"closure {number} b", closure.b))
        for number, closure in enumerate(robot.closures)
    )
    shift, angle = (float(np.linalg.norm(part, axis=1).max()) for part in np.split(found, [3], axis=1))
    return replace(robot, joints=tuple(joints), closures=tuple(closures)), shift, angle

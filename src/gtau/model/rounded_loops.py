"""Adjust the placements in loops that close only up to the digits of their file, so that they close exactly.

A planar loop has more closure equations than it needs, since none of its bars leaves the plane. With rounded numbers
its pins are no longer parallel, and taken literally no joint of it could move. The numbers nearest to the written ones
are found with which the loops close in every pose and parallel axes stay parallel, by Gauss and Newton, the joints'
coordinates solved for. No number moves by more than half a unit of its last digit. A gap that this cannot close is no
rounding, nor is one in poses out of reach, where the loops are stretched.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import astuple, dataclass, replace
from math import pi
from typing import Literal

import casadi as ca
import numpy as np

from gtau.model.kinematics import Coordinates, constant, coordinates, frames
from gtau.model.loop_closure import CLOSED, LoopErrors, closed, loop_errors
from gtau.robots.digits import Rounding, digits_of, is_written
from gtau.robots.geometry import angles_of, euler_angles
from gtau.robots.robot import GROUND, ROTATIONS, TRANSLATIONS, Attachment, Closure, Joint, Mdh, Placement, Pose, Robot

# Lengths are in characteristic lengths of the robot, angles in rad.
DRAWN = 1e-2  # with three decimals, the worst of 40 planar loops: gap 3e-3, placements moved by 1.3e-3
LITERAL = 1e-13  # gap of loops that close as they are written: on all robots of the catalog 8e-16 at most
POSES = 12  # number of poses in which loops must close: more than the coordinates of a placement
SPREAD = 0.3  # of the motors around home
HALVINGS = 6  # of the motors' steps, until a pose is within reach
STRETCHED = 0.2  # share of home's smallest singular value below which a pose is out of reach, or nearly so
STEPS = 12
EXACT = 1e-14  # gap at which the placements are final
MDH_ANGLES = (True, False, True, False, True, False)
POSE_ANGLES = (False, False, False, True, True, True)
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
        The same one where its loops close in every pose already, or the digits of its numbers do not explain why not;
        else with a note.
    """
    moving = _moving(errors, home)
    if moving is None:
        return robot
    poses = list(_around(errors, home, moving))
    gaps = [float(np.abs(errors(c)[0]).max()) for c in poses]
    if not LITERAL < max(gaps) < DRAWN:
        return robot
    joints = [int(k) for k in errors.looped if k < len(robot.joints)]
    varied = _varied(robot, joints)
    bounds, written = varied.bounds, varied.bounds * varied.nonzero
    for bound in (written * varied.grounded[:, None], written, bounds):
        if (change := _fitted(varied, errors, poses, moving, bound)) is not None:
            exact, shift, angle = _moved(robot, varied, change)
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
    """Iterate over home and poses within reach around it, with other positions of the motors in the loops."""

    def smallest(c: np.ndarray) -> float:
        return float(np.linalg.svd(errors(c)[1][:, moving], compute_uv=False)[-1])

    home = closed(errors, home, moving)
    rng, motors, least = np.random.default_rng(0), np.setdiff1d(errors.looped, moving), STRETCHED * smallest(home)
    yield home
    for _ in range(POSES - 1):
        step = np.zeros(errors.layout.n_y)
        step[motors] = rng.uniform(-SPREAD, SPREAD, motors.size)
        for _ in range(HALVINGS):
            if smallest(c := closed(errors, errors.moved(home, step), moving)) > least:
                yield c
                break
            step /= 2


@dataclass(frozen=True)
class _Place:
    """A placement in a loop, whose six numbers may change."""

    name: str
    at: Attachment
    computed: bool  # from numbers of the file by a reader

    @property
    def numbers(self) -> tuple[float, ...]:
        """The six numbers, lengths and angles."""
        placement = self.at.placement
        return astuple(placement) if isinstance(placement, Mdh) else (*placement.xyz, *placement.rpy)

    @property
    def angular(self) -> tuple[bool, ...]:
        """True where a number is an angle."""
        return MDH_ANGLES if isinstance(self.at.placement, Mdh) else POSE_ANGLES

    def changed(self, change: np.ndarray) -> Placement:
        """Change the numbers by ``change`` (6,); of a computed orientation, turn it about its three axes."""
        placement, numbers = self.at.placement, change.tolist()
        if isinstance(placement, Mdh):
            return Mdh(*np.add(self.numbers, change).tolist())
        x, y, z = (placement.position + change[:3]).tolist()
        roll, pitch, yaw = np.add(placement.rpy, change[3:]).tolist()
        if self.computed:
            roll, pitch, yaw = angles_of(placement.rotation @ Pose(rpy=tuple(numbers[3:])).rotation)
        return Pose((x, y, z), (roll, pitch, yaw))

    def displacement(self, change: np.ndarray) -> np.ndarray:
        """Compute the shift, m, and the turns about x, y and z, rad, that a change (6,) of the numbers makes."""
        before, after = self.at.placement, self.changed(change)
        return np.array([*(after.position - before.position), *euler_angles(before.rotation.T @ after.rotation)])


@dataclass(frozen=True, eq=False)
class _Varied:
    """A robot of joints alone, six of them at each placement in a loop, by which the placement moves.

    ``virtual`` (places, 6) are the indices of these joints in ``c``, ``numbers`` those of all others by the names of
    the robot's coordinates. ``bounds`` (places, 6) say how far the numbers of each placement may move, m and rad;
    ``nonzero`` marks those that are not zero, nor angles that are multiples of pi/12. ``grounded`` (places,) marks
    placements on the ground: where moving them is enough, legs that are alike stay so. ``axes`` maps c to the axes of
    the joints in loops (3 joints,) and their derivatives by c.
    """

    errors: LoopErrors
    places: tuple[_Place, ...]
    virtual: np.ndarray
    numbers: dict[str, int]
    bounds: np.ndarray
    nonzero: np.ndarray
    grounded: np.ndarray
    axes: ca.Function

    def configuration(self, layout: Coordinates, c: np.ndarray) -> np.ndarray:
        """Convert a configuration ``c`` (n_c,) of the robot itself."""
        full = np.zeros(self.errors.layout.n_c)
        full[[self.numbers[joint.name] for joint in layout.robot.joints]] = c[: len(layout.robot.joints)]
        for slots in layout.platforms:
            turned = euler_angles(slots.rotation(c) @ slots.platform.home.rotation.T)
            values = dict(zip(TRANSLATIONS + ROTATIONS, (*c[slots.position], *turned), strict=True))
            for dof in slots.platform.dof:
                full[self.numbers[f"{dof}_{slots.platform.name}"]] = values[dof]
        return full


def _varied(robot: Robot, looped: list[int]) -> _Varied:
    joints: list[Joint] = []
    places: list[_Place] = []

    def add(name: str, before: str, kind: Literal["revolute", "prismatic"], placement: Placement, axis: int) -> str:
        joints.append(Joint(name, before, kind, placement, AXES[axis], actuated=False, parameters="none"))
        return name

    def vary(name: str, at: Attachment, before: str, first: Pose) -> str:
        for k in range(6):
            placement = {0: first, 3: at.placement}.get(k, Pose())
            before = add(f"{name} {k}", before, "prismatic" if k < 3 else "revolute", placement, k % 3)
        places.append(_Place(name, at, robot.rounding is not None))
        return before

    for k, joint in enumerate(robot.joints):
        if k in looped:
            before = vary(joint.name, Attachment(joint.antecedent, joint.placement), joint.antecedent, Pose())
            joint = replace(joint, antecedent=before, placement=Pose())
        joints.append(joint)
    carried = {joint.name: (joint.name, Pose()) for joint in robot.joints} | {GROUND: (GROUND, Pose())}
    for platform in robot.platforms:
        fixed = (0.0 if dof in platform.dof else x for dof, x in zip(TRANSLATIONS, platform.home.xyz, strict=True))
        before, placement = GROUND, Pose(tuple(fixed))  # type: ignore[arg-type]
        for k, dof in enumerate(TRANSLATIONS + ROTATIONS):
            if dof in platform.dof:
                name = f"{dof}_{platform.name}"
                before = add(name, before, "prismatic" if k < 3 else "revolute", placement, k % 3)
                placement = Pose()
        carried[platform.name] = before, Pose(placement.xyz, platform.home.rpy)
    closures = []
    for number, closure in enumerate(robot.closures):
        a, b = (vary(f"{number} {side}", at, *carried[at.body]) for side, at in (("a", closure.a), ("b", closure.b)))
        closures.append(Closure(closure.kind, Attachment(a), Attachment(b)))
    whole = Robot(robot.name, tuple(joints), (), tuple(closures), robot.couplings)
    numbers, layout = {joint.name: k for k, joint in enumerate(joints)}, coordinates(whole)
    c = ca.SX.sym("c", layout.n_c)
    frame, turning = frames(layout, c), [robot.joints[k] for k in looped]
    axes = ca.vertcat(*(frame[joint.name].R_0 @ constant(np.array(joint.axis)) for joint in turning))
    bounds, nonzero = _bounds(robot.rounding, places, turning)
    return _Varied(
        loop_errors(layout),
        tuple(places),
        np.array([[numbers[f"{place.name} {k}"] for k in range(6)] for place in places]),
        numbers,
        bounds,
        nonzero,
        np.array([place.at.body == GROUND for place in places]),
        ca.Function("axes", [c], [ca.densify(axes), ca.densify(ca.jacobian(axes, c))]),
    )


def _bounds(rounding: Rounding | None, places: list[_Place], joints: list[Joint]) -> tuple[np.ndarray, np.ndarray]:
    """Find how far the numbers of placements (places, 6) may move, and which of them are written with digits.

    A number moves by half a unit of its last digit; one computed by a reader by what the numbers of two placements
    allow, one with all digits not at all, but for multiples of pi/12, which may have been rounded to that.
    """
    numbers = np.array([place.numbers for place in places])
    is_angle = np.array([[is_angle for is_angle in place.angular] for place in places])
    axes = [component for joint in joints for component in joint.axis]
    lengths, angles = digits_of(numbers[~is_angle]), digits_of([*numbers[is_angle], *axes])
    if rounding is not None:
        lengths = rounding.lengths
    bounds, nonzero = np.zeros(numbers.shape), np.zeros(numbers.shape, dtype=bool)
    for place, row, marks in zip(places, bounds, nonzero, strict=True):
        for k, (number, angular) in enumerate(zip(place.numbers, place.angular, strict=True)):
            multiple = angular and abs(number - round(number / (pi / 12)) * (pi / 12)) < CLOSED
            marks[k] = number != 0.0 and not multiple
            if rounding is not None and angular:
                row[k] = rounding.turn
            elif multiple or is_written(number):
                row[k] = (angles if angular else lengths).half_unit(number)
            elif rounding is not None:
                row[k] = 2 * lengths.half_unit(number) + rounding.turn * np.linalg.norm(place.at.placement.position)
    return bounds, nonzero


def _fitted(
    varied: _Varied, errors: LoopErrors, poses: list[np.ndarray], moving: np.ndarray, bound: np.ndarray
) -> np.ndarray | None:
    """Find the smallest change (places, 6) of the numbers, within ``bound``, with which the loops close in all poses."""
    whole, free = varied.errors, bound > 0.0
    of_whole = np.array([varied.numbers[errors.layout.names[k]] for k in moving])
    configurations = [varied.configuration(errors.layout, c) for c in poses]
    pairs = _parallel(varied, configurations)
    change = np.zeros(bound.shape)
    for _ in range(STEPS):
        slopes, moved = zip(*(_slope(place, by) for place, by in zip(varied.places, change, strict=True)), strict=True)
        A, b, worst = [], [], 0.0
        for k, c in enumerate(configurations):
            c[varied.virtual] = moved
            configurations[k] = c = closed(whole, c, of_whole)
            error, G = _with_axes(varied, pairs, c)
            U, *_ = np.linalg.svd(G[:, of_whole])
            surplus = U[:, of_whole.size :].T
            by_numbers = np.einsum("rpi,pij->rpj", (G / whole.unit)[:, varied.virtual], np.array(slopes))
            A.append(surplus @ by_numbers[:, free])
            b.append(surplus @ error)
            worst = max(worst, float(np.abs(whole(c)[0]).max()), float(np.abs(b[-1]).max(initial=0.0)))
        if worst < EXACT:
            return change
        stacked = np.vstack(A)
        change[free] = _least(stacked, stacked @ change[free] - np.concatenate(b), bound[free], worst)
    return None


def _slope(place: _Place, change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Differentiate the displacement of a placement by its numbers (6, 6), and return the displacement (6,) itself."""
    step = 1e-6 * np.eye(6)
    ahead, behind = (np.array([place.displacement(change + sign * each) for each in step]) for sign in (1, -1))
    return (ahead - behind).T / 2e-6, place.displacement(change)


def _parallel(varied: _Varied, configurations: list[np.ndarray]) -> list[tuple[int, int]]:
    """Pair the axes in loops that are parallel in all configurations, up to what the digits allow."""
    axes = np.array([np.reshape(varied.axes(c)[0].full(), (-1, 3)) for c in configurations])
    apart = np.linalg.norm(np.cross(axes[:, :, None], axes[:, None]), axis=-1).max(axis=0)
    first = [int(np.argmax(row < min(DRAWN, varied.bounds[:, 3:].sum()))) for row in apart]
    return [(k, j) for j, k in enumerate(first) if k < j]


def _with_axes(varied: _Varied, pairs: list[tuple[int, int]], c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Append to errors (rows,) and scaled Jacobian of the loops the cross products of axes that are parallel."""
    error, G = varied.errors(c)
    axes, slopes = (found.full() for found in varied.axes(c))
    axes, slopes = axes.reshape(-1, 3), slopes.reshape(-1, 3, c.size) * varied.errors.unit
    crossed = [np.cross(axes[j], axes[k]) for j, k in pairs]
    turned = [np.cross(slopes[j].T, axes[k]).T + np.cross(axes[j], slopes[k].T).T for j, k in pairs]
    return np.concatenate([error, *crossed]), np.vstack([G, *turned])


def _least(A: np.ndarray, b: np.ndarray, bound: np.ndarray, worst: float) -> np.ndarray:
    """Find the smallest x (n,) within ``bound`` for which ``A x = b``; it is no solution where there is none."""
    x, free = np.zeros(bound.size), np.ones(bound.size, dtype=bool)
    while free.any():
        U, sigma, Vt = np.linalg.svd(A[:, free], full_matrices=False)
        kept = sigma > max(1e-7, 10 * worst) * max(sigma.max(initial=0.0), 1.0)  # the others vanish as the loops close
        x[free] = Vt[kept].T @ ((U[:, kept].T @ (b - A[:, ~free] @ x[~free])) / sigma[kept])
        beyond = free & (np.abs(x) > bound)
        if not beyond.any():
            break
        x[beyond] = np.copysign(bound[beyond], x[beyond])
        free &= ~beyond
    return x


def _moved(robot: Robot, varied: _Varied, change: np.ndarray) -> tuple[Robot, float, float]:
    """Move the placements, and return the largest shift (m) and turn (rad) with the robot."""
    by_name = {place.name: place.changed(by) for place, by in zip(varied.places, change, strict=True) if by.any()}

    def end(name: str, at: Attachment) -> Attachment:
        return replace(at, placement=by_name.get(name, at.placement))

    joints = (replace(joint, placement=by_name.get(joint.name, joint.placement)) for joint in robot.joints)
    closures = (
        replace(closure, a=end(f"{number} a", closure.a), b=end(f"{number} b", closure.b))
        for number, closure in enumerate(robot.closures)
    )
    moves = np.array([place.displacement(by) for place, by in zip(varied.places, change, strict=True)])
    shift, angle = (float(np.linalg.norm(part, axis=1).max()) for part in np.split(moves, [3], axis=1))
    return replace(robot, joints=tuple(joints), closures=tuple(closures)), shift, angle

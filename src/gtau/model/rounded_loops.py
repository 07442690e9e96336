"""Adjust the placements in loops that close only up to the digits of their file, so that they close exactly.

A planar loop has more closure equations than it needs, since none of its bars leaves the plane. With rounded numbers
its pins are no longer parallel, and taken literally no joint of it could move. The numbers nearest to the written ones
are found with which the loops close in every pose and parallel axes stay parallel, by Gauss and Newton, the joints'
coordinates solved for. No number moves by more than half a unit of its last digit. A gap that this cannot close is no
rounding, nor is one in poses out of reach, where the loops are stretched.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import astuple, dataclass, replace
from itertools import product
from math import pi
from typing import Literal

import casadi as ca
import numpy as np

from gtau.model.kinematics import Coordinates, constant, coordinates, frames
from gtau.model.loop_closure import CLOSED, LoopErrors, closed, loop_errors
from gtau.robots.geometry import angles_of, digits_of, euler_angles, is_written
from gtau.robots.robot import GROUND, ROTATIONS, TRANSLATIONS, Attachment, Closure, Joint, Mdh, Placement, Pose, Robot

# Lengths are in characteristic lengths of the robot, angles in rad.
DRAWN = 1e-2  # with three decimals, the worst of 40 planar loops: gap 3e-3, placements moved by 1.3e-3
LITERAL = 1e-13  # gap of loops that close as they are written: on all robots of the catalog 8e-16 at most
POSES = 12  # number of poses in which loops must close: more than the coordinates of a placement
SPREAD = 0.3  # of the motors around home
HALVINGS = 6  # of the motors' steps, until a pose is within reach
STRETCHED = 0.2  # share of home's smallest singular value below which a pose is out of reach, or nearly so
STEPS = 12
TURNS = 4  # roundings of one angle by which axes may be turned that are meant to be parallel or perpendicular
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
    joints = [robot.joints[k] for k in errors.looped if k < len(robot.joints)]
    places = _places(robot, joints)
    bounds, nonzero = _bounds(robot, places, joints)
    axes = _axes(errors.layout, _with_carriers(robot, joints))
    pairs, tilt = _aligned([axes(c)[0].full() for c in poses], bounds)
    if not LITERAL < max(*gaps, tilt) < DRAWN:
        return robot
    varied = _varied(robot, joints, places)
    written, grounded = bounds * nonzero, np.array([[place.at.body == GROUND] for place in places])
    for aligned, bound in product((pairs, []), (written * grounded, written, bounds)):
        if max(gaps) < LITERAL and not aligned:
            continue
        if (change := _fitted(varied, errors, poses, moving, bound, aligned)) is not None:
            exact, shift, angle = _moved(robot, places, change)
            gap = errors.gap(poses[int(np.argmax(gaps))])
            if max(gaps) < LITERAL:
                gap = f"axes in the loops are {np.degrees(tilt):.2g} degrees from parallel or perpendicular"
            note = (
                f"{gap}, as the numbers in the file are rounded; placements in the loops were moved by up to "
                f"{1e3 * shift:.2g} mm and {np.degrees(angle):.2g} degrees, so that they close in every pose"
            )
            return replace(exact, notes=(*robot.notes, note))
    return robot


def _moving(errors: LoopErrors, home: np.ndarray) -> np.ndarray | None:
    """Select the coordinates (indices into yd) that close the loops, redundant motors included.

    None where there are fewer equations than such coordinates.
    """
    layout, G, passive = errors.layout, errors(home)[1], errors.passive
    rows = G.shape[0] - sum(closure.kind == "weld" for closure in layout.robot.closures)
    motors = np.setdiff1d(errors.looped, passive)
    if rows < passive.size or not passive.size:
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
    return moving if rows >= moving.size else None


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


def _places(robot: Robot, joints: list[Joint]) -> list[_Place]:
    computed = robot.rounding is not None
    places = [_Place(joint.name, Attachment(joint.antecedent, joint.placement), computed) for joint in joints]
    for number, closure in enumerate(robot.closures):
        places += [_Place(f"{number} {side}", at, computed) for side, at in (("a", closure.a), ("b", closure.b))]
    return places


def _bounds(robot: Robot, places: list[_Place], joints: list[Joint]) -> tuple[np.ndarray, np.ndarray]:
    """Find how far the numbers of placements (places, 6) may move, m and rad, and which are not zero.

    A number moves by half a unit of its last digit, one computed by a reader by what the numbers of two placements
    allow, and one written with all digits not at all. Multiples of pi/12 may have been rounded, and count as zero.
    """
    numbers, angular = np.array([place.numbers for place in places]), np.array([place.angular for place in places])
    remainder = np.where(angular, np.abs(numbers - np.round(numbers / (pi / 12)) * (pi / 12)), np.abs(numbers))
    nonzero = remainder > CLOSED
    axes = [component for joint in joints for component in joint.axis]
    lengths, angles = digits_of(numbers[~angular]), digits_of([*numbers[angular & nonzero], *axes])
    written, unit = np.vectorize(is_written)(numbers), 1.0
    if robot.rounding is None:
        if not angles.significant:  # in rad; then perhaps in degrees
            unit = pi / 180
            angles = digits_of(np.round(numbers[angular & nonzero] / unit, 10))
            written |= angular
        turns = unit * np.vectorize(angles.half_unit)(numbers / unit)
        half = np.where(angular, turns, np.vectorize(lengths.half_unit)(numbers))
        return np.where(written | ~nonzero, half, 0.0), nonzero
    lengths, turn = robot.rounding, robot.rounding.turn
    half = np.vectorize(lengths.half_unit)(numbers)
    arms = np.array([[np.linalg.norm(place.at.placement.position)] for place in places])
    return np.where(angular, turn, np.where(written, half, 2 * half + turn * arms)), nonzero


def _with_carriers(robot: Robot, joints: list[Joint]) -> list[str]:
    """Name the joints and those that carry them."""
    names = {joint.name for joint in joints} | {joint.antecedent for joint in joints}
    return [joint.name for joint in robot.joints if joint.name in names]


def _axes(layout: Coordinates, names: list[str]) -> ca.Function:
    """Compile the axes (3 joints,) of joints and their derivatives by the joints' coordinates."""
    c, joints = ca.SX.sym("c", layout.n_c), [layout.robot.joint(name) for name in names]
    frame = frames(layout, c)
    axes = ca.vertcat(*(frame[joint.name].R_0 @ constant(np.array(joint.axis)) for joint in joints))
    return ca.Function("axes", [c], [ca.densify(axes), ca.densify(ca.jacobian(axes, c))])


@dataclass(frozen=True)
class _Pair:
    """Two axes that are meant to be parallel or perpendicular."""

    one: int
    other: int
    parallel: bool

    def error(self, axes: np.ndarray) -> np.ndarray:
        """Compute the error, rad, of axes (joints, 3)."""
        a, b = axes[self.one], axes[self.other]
        return np.cross(a, b) if self.parallel else np.array([a @ b])

    def slope(self, axes: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        """Differentiate the error by the coordinates (rows, n), as the axes are by ``slopes`` (joints, 3, n)."""
        (a, b), (da, db) = (each[[self.one, self.other]] for each in (axes, slopes))
        return np.cross(da.T, b).T + np.cross(a, db.T).T if self.parallel else (a @ db + b @ da)[None]


def _aligned(axes: list[np.ndarray], bounds: np.ndarray) -> tuple[list[_Pair], float]:
    """Pair the axes that are parallel or perpendicular in all poses up to the digits, and find their largest error."""
    each = np.array(axes).reshape(len(axes), -1, 3)
    tolerance = min(DRAWN, TURNS * float(bounds[:, 3:].max()))
    crossed = np.linalg.norm(np.cross(each[:, :, None], each[:, None]), axis=-1).max(axis=0)
    along = np.abs(each @ each.transpose(0, 2, 1)).max(axis=0)
    first = [int(np.argmax(row <= max(tolerance, LITERAL))) for row in crossed]
    pairs = [_Pair(k, j, parallel=True) for j, k in enumerate(first) if k < j]
    kinds = sorted(set(first))
    pairs += [_Pair(k, j, parallel=False) for k in kinds for j in kinds if k < j and along[k, j] < tolerance]
    errors = [float(np.abs(pair.error(pose)).max()) for pair in pairs for pose in each]
    return pairs, max(errors, default=0.0)


@dataclass(frozen=True, eq=False)
class _Varied:
    """A robot of joints alone, six of them at each placement in a loop, by which the placement moves.

    ``virtual`` (places, 6) are the indices of these joints in ``c``, ``numbers`` those of all others by the names of
    the robot's coordinates; ``axes`` see :func:`_axes`.
    """

    errors: LoopErrors
    places: list[_Place]
    virtual: np.ndarray
    numbers: dict[str, int]
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

    def aligned(self, pairs: Sequence[_Pair], c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Evaluate errors and scaled Jacobian of the loops and of the pairs of axes."""
        error, G = self.errors(c)
        axes, slopes = (found.full() for found in self.axes(c))
        axes, slopes = axes.reshape(-1, 3), slopes.reshape(-1, 3, c.size) * self.errors.unit
        rows = [pair.slope(axes, slopes) for pair in pairs]
        return np.concatenate([error, *(pair.error(axes) for pair in pairs)]), np.vstack([G, *rows])


def _varied(robot: Robot, looped: list[Joint], places: list[_Place]) -> _Varied:
    joints: list[Joint] = []
    at = {place.name: place.at for place in places}

    def add(name: str, before: str, kind: Literal["revolute", "prismatic"], placement: Placement, axis: int) -> str:
        joints.append(Joint(name, before, kind, placement, AXES[axis], actuated=False, parameters="none"))
        return name

    def vary(name: str, before: str, first: Pose) -> str:
        for k in range(6):
            placement = {0: first, 3: at[name].placement}.get(k, Pose())
            before = add(f"{name} {k}", before, "prismatic" if k < 3 else "revolute", placement, k % 3)
        return before

    for joint in robot.joints:
        if joint in looped:
            joint = replace(joint, antecedent=vary(joint.name, joint.antecedent, Pose()), placement=Pose())
        joints.append(joint)
    carried = {name: (name, Pose()) for name in (GROUND, *(joint.name for joint in robot.joints))}
    for platform in robot.platforms:
        x, y, z = (
            0.0 if dof in platform.dof else value for dof, value in zip(TRANSLATIONS, platform.home.xyz, strict=True)
        )
        before, placement = GROUND, Pose((x, y, z))
        for k, dof in enumerate(TRANSLATIONS + ROTATIONS):
            if dof in platform.dof:
                kind: Literal["revolute", "prismatic"] = "prismatic" if k < 3 else "revolute"
                before, placement = add(f"{dof}_{platform.name}", before, kind, placement, k % 3), Pose()
        carried[platform.name] = before, Pose(placement.xyz, platform.home.rpy)
    closures = []
    for number, closure in enumerate(robot.closures):
        a, b = (vary(f"{number} {side}", *carried[end.body]) for side, end in (("a", closure.a), ("b", closure.b)))
        closures.append(Closure(closure.kind, Attachment(a), Attachment(b)))
    whole = Robot(robot.name, tuple(joints), (), tuple(closures), robot.couplings)
    numbers, layout = {joint.name: k for k, joint in enumerate(joints)}, coordinates(whole)
    virtual = np.array([[numbers[f"{place.name} {k}"] for k in range(6)] for place in places])
    return _Varied(loop_errors(layout), places, virtual, numbers, _axes(layout, _with_carriers(robot, looped)))


def _fitted(
    varied: _Varied,
    errors: LoopErrors,
    poses: list[np.ndarray],
    moving: np.ndarray,
    bound: np.ndarray,
    pairs: Sequence[_Pair],
) -> np.ndarray | None:
    """Find the smallest change (places, 6) within ``bound`` with which the loops close in all poses."""
    whole, free = varied.errors, bound > 0.0
    of_whole = np.array([varied.numbers[errors.layout.names[k]] for k in moving])
    configurations = [varied.configuration(errors.layout, c) for c in poses]
    change, before = np.zeros(bound.shape), np.inf
    for _ in range(STEPS):
        slopes, moved = zip(*(_slope(place, by) for place, by in zip(varied.places, change, strict=True)), strict=True)
        A, b, worst = [], [], 0.0
        for k, c in enumerate(configurations):
            c[varied.virtual] = moved
            configurations[k] = c = closed(whole, c, of_whole)
            error, G = varied.aligned(pairs, c)
            U, *_ = np.linalg.svd(G[:, of_whole])
            surplus = U[:, of_whole.size :].T
            by_numbers = np.einsum("rpi,pij->rpj", (G / whole.unit)[:, varied.virtual], np.array(slopes))
            A.append(surplus @ by_numbers[:, free])
            b.append(surplus @ error)
            worst = max(worst, float(np.abs(whole(c)[0]).max()), float(np.abs(b[-1]).max(initial=0.0)))
        if worst < EXACT:
            return change
        if worst > before / 2:
            return None
        before, stacked = worst, np.vstack(A)
        change[free] = _least(stacked, stacked @ change[free] - np.concatenate(b), bound[free], worst)
    return None


def _slope(place: _Place, change: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Differentiate the displacement of a placement by its numbers (6, 6), and return the displacement (6,) itself."""
    step = 1e-6 * np.eye(6)
    ahead, behind = (np.array([place.displacement(change + sign * each) for each in step]) for sign in (1, -1))
    return (ahead - behind).T / 2e-6, place.displacement(change)


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


def _moved(robot: Robot, places: list[_Place], change: np.ndarray) -> tuple[Robot, float, float]:
    """Move the placements, and return the largest shift (m) and turn (rad) with the robot."""
    by_name = {place.name: place.changed(by) for place, by in zip(places, change, strict=True) if by.any()}

    def end(name: str, at: Attachment) -> Attachment:
        return replace(at, placement=by_name.get(name, at.placement))

    joints = (replace(joint, placement=by_name.get(joint.name, joint.placement)) for joint in robot.joints)
    closures = (
        replace(closure, a=end(f"{number} a", closure.a), b=end(f"{number} b", closure.b))
        for number, closure in enumerate(robot.closures)
    )
    moves = np.array([place.displacement(by) for place, by in zip(places, change, strict=True)])
    shift, angle = (float(np.linalg.norm(part, axis=1).max()) for part in np.split(moves, [3], axis=1))
    return replace(robot, joints=tuple(joints), closures=tuple(closures)), shift, angle

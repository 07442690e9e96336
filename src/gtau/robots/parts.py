"""Hold some joints of a robot, to isolate one leg, one arm of two, or an arm without its gripper; lock idle pins.

CAD exporters put a hinge on both parts that a loop joins, so that the piece between them turns freely. So does a pin
through the centre of a ball, and a rod or leg between two balls. These degrees of freedom do not belong to the robot.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase

import numpy as np

from gtau.documents.validation import some_of, unknown
from gtau.errors import GtauError
from gtau.robots.geometry import moved_ends, turning
from gtau.robots.parameter import Parameter, lumped, rigid_body, stated_inertias
from gtau.robots.placement import euler_angles, pose_of, rounded, turn
from gtau.robots.robot import GROUND, INERTIAL, Attachment, Closure, Coupling, Joint, Pose, Robot, Spring

NAMED = 6  # joints that a note lists
COAXIAL = 1e-8  # rad, and share of the length of the closure's arms


def select_joints(robot: Robot, patterns: Sequence[str], held: Mapping[str, float]) -> Robot:
    """Let joints move by ``patterns``, or all not in ``held``, by position; hold the others at home, with a note."""
    names = [joint.name for joint in robot.joints if joint.name not in robot.base]
    for name in held:
        if name not in names:
            raise GtauError(f"'held': {unknown(f'joint {name!r}', name, names)}.")
    moving = set() if patterns else set(names) - held.keys()
    for pattern in patterns:
        if not (matched := {name for name in names if fnmatchcase(name, pattern)}):
            raise GtauError(
                f"no joint of robot '{robot.name}' is called '{pattern}'; choose from {', '.join(names)} (* stands for "
                "any letters)."
            )
        moving |= matched
    moving |= set(robot.base)
    if both := moving & held.keys():
        raise GtauError(f"joint '{min(both)}' is both among the 'joints' that move and 'held'; remove one of them.")
    still = [joint for joint in robot.joints if joint.name not in moving]
    positions = {joint.name: held.get(joint.name, joint.home) for joint in still}
    return hold_joints(robot, positions, "as chosen") if positions else robot


def hold_joints(robot: Robot, positions: Mapping[str, float], why: str) -> Robot:
    """Hold joints at ``positions``, rad or m, and the joints coupled to them; note which joints and ``why``."""
    known, settled = dict(positions), False
    while not settled:
        settled = True
        for coupling in robot.couplings:
            terms = coupling.terms
            unknown_joints = [name for name in terms if name not in known]
            if len(unknown_joints) == 1:
                factor = terms.pop(unknown_joints[0])
                rest = sum(term * known[name] for name, term in terms.items())
                known[unknown_joints[0]] = (coupling.offset - rest) / factor
                settled = False
    shown = [f"'{name}' at {position:z.4g}" for name, position in known.items()]
    note = f"{len(shown)} joint{'s' * (len(shown) > 1)} held {why} (rad, m): {some_of(shown, NAMED)}"
    return lock_joints(robot, known).noted(note)


def lock_joints(robot: Robot, positions: Mapping[str, float]) -> Robot:
    """Merge the links of joints at ``positions``, and their masses, into their carriers."""
    fixed = (GROUND, *(platform.name for platform in robot.platforms))
    carried = {body: Attachment(body) for body in fixed}
    joints: list[Joint] = []
    heavy = set()
    for joint in robot.joints:
        at = carried[joint.antecedent].at(joint.placement)
        if joint.name not in positions:
            joints.append(replace(joint, antecedent=at.body, placement=at.placement))
            carried[joint.name] = Attachment(joint.name)
            continue
        carried[joint.name] = _after(joint, at, positions[joint.name])
        if joint.has_mass:
            heavy.add(at.body)
    if not joints:
        raise GtauError(f"robot '{robot.name}': all joints are held; hold fewer of them.")
    closures, springs = _carried_ends(robot, carried)
    tool = carried[robot.named_tool].body if robot.named_tool else ""
    return replace(
        robot,
        joints=tuple(_heavy(joint) if joint.name in heavy else joint for joint in joints),
        closures=tuple(tie for tie in closures if tie.a.body != tie.b.body),
        couplings=tuple(_couplings(robot, positions)),
        springs=tuple(spring for spring in springs if spring.a.body != spring.b.body),
        named_tool="" if tool == GROUND else tool,
        floating="" if robot.floating in positions else robot.floating,
    ).with_file(inertias=_inertias(robot, carried))


def _carried_ends(robot: Robot, carried: Mapping[str, Attachment]) -> tuple[tuple[Closure, ...], tuple[Spring, ...]]:
    return moved_ends(robot, lambda end: carried[end.body].at(end.placement))


def _inertias(robot: Robot, carried: Mapping[str, Attachment]) -> tuple[tuple[str, float], ...]:
    """Add the stated inertias of locked links to the links that carry them; their rotors no longer turn."""
    stated = stated_inertias(robot)
    bodies = dict.fromkeys(name.body for name in stated if name.kind in INERTIAL)
    summed = lumped((carried[body], rigid_body(robot.inertias, body)) for body in bodies)
    turning = {body for body, at in carried.items() if at.body == body}
    rotors = (name for name in stated if name.kind not in INERTIAL and name.body in turning)
    return (*summed.items(), *((name, stated[name]) for name in rotors))


def _after(joint: Joint, at: Attachment, position: float) -> Attachment:
    """Attach a joint's link at a position, from its attachment at zero."""
    if not position:
        return at
    axis = np.array(joint.axis)
    motion = pose_of(turn(axis, position), np.zeros(3)) if joint.turns else pose_of(np.eye(3), axis * position)
    return at.at(motion)


def _heavy(joint: Joint) -> Joint:
    if joint.has_mass:
        return joint
    return replace(joint, parameters="all" if joint.parameters == "drive" else "inertial")


def _couplings(robot: Robot, positions: Mapping[str, float]) -> Iterator[Coupling]:
    for coupling in robot.couplings:
        terms = coupling.terms
        held = [name for name in terms if name in positions]
        offset = coupling.offset - sum(terms.pop(name) * positions[name] for name in held)
        if terms:
            yield Coupling.solved(terms, next(iter(terms)), offset)


def listed(names: Sequence[str]) -> str:
    """List names in quotes, the first few of many."""
    return some_of([f"'{name}'" for name in names], NAMED)


def without_idle_pins(robot: Robot) -> Robot:
    """Lock, at zero, one of two coaxial pins at each closure, and pins through the point of a ``connect`` or a ball.

    Pins are passive revolute joints that carry only the closure, the ball, or a leg that slides along their axis to
    this point. If a pin is the last of three that form a ball, their axes are chosen so that it is idle.
    """
    if (carried := _on_ball(robot)) is not robot:
        return without_idle_pins(carried)
    ends: list[tuple[Attachment, Attachment | None, str]] = []
    for number, closure in enumerate(robot.closures, start=1):
        # the second pin first, to keep the first one
        for a, b in ((closure.b, closure.a), (closure.a, closure.b)):
            ends.append((a, None if closure.kind == "connect" else b, f"closure {number}"))
    for ball in filter(None, (_hinges(robot, joint) for joint in robot.joints)):
        ends.append((Attachment(ball[0].antecedent, ball[0].placement), None, f"ball '{ball[2].name}'"))
    for end, other, place in ends:
        if other is None:
            near, slides = _before_slides(robot, end)
            if (pin := _pin(robot, near)) is None:
                continue
            point = near.placement.position
            along = slides[0] if slides else point / max(float(np.linalg.norm(point)), 1e-300)
            aimed = _aimed(_with_ball(robot, pin, along), pin, along)
            if aimed is not robot:
                return without_idle_pins(aimed)
            apart = [np.cross(direction, pin.axis) for direction in (point, *slides)]
            idle = np.linalg.norm(apart, axis=1).max() < COAXIAL
            why = f"its axis passes through the centre of {place}"
        else:
            pin, twin = _pin(robot, end), _pin(robot, other)
            if pin is None or twin is None:
                continue
            direction, position = _line(pin, end)
            direction_2, position_2 = _line(twin, other)
            away = np.linalg.norm(np.cross(position - position_2, direction))
            idle = away < COAXIAL and np.linalg.norm(np.cross(direction, direction_2)) < COAXIAL
            why = f"it is coaxial with '{twin.name}' in {place}"
        if idle:
            note = f"joint '{pin.name}' is idle, since {why}; it was locked at zero"
            note += f", its link a part of '{pin.antecedent}'" * pin.has_mass
            return without_idle_pins(lock_joints(robot, {pin.name: 0.0}).noted(note))
    return robot


def _on_ball(robot: Robot) -> Robot:
    """Put a free rod (a platform held at two points only) on a ball at the first point that a link carries."""
    placed = {GROUND: Attachment(GROUND)}
    for joint in robot.joints:
        placed[joint.name] = _after(joint, placed[joint.antecedent].at(joint.placement), joint.home)
    for rod in robot.platforms:
        ties = [tie for tie in robot.closures if rod.name in (tie.a.body, tie.b.body)]
        carried = [tie for tie in ties if not placed.keys().isdisjoint((tie.a.body, tie.b.body))]
        sprung = any(rod.name in (spring.a.body, spring.b.body) for spring in robot.springs)
        if [tie.kind for tie in ties] != ["connect", "connect"] or not carried or sprung:
            continue
        end, point = sorted((carried[0].a, carried[0].b), key=lambda it: it.body != rod.name)
        turned = placed[point.body].placement.rotation.T @ rod.home.rotation
        ball = turning(rod.name, point.body, pose_of(turned, point.placement.position), "xyz")
        at = {body: Attachment(body) for body in (GROUND, *robot.bodies)}
        at[rod.name] = Attachment(rod.name, pose_of(np.eye(3), -end.placement.position))
        rest = replace(robot, closures=tuple(tie for tie in robot.closures if tie is not carried[0]))
        return replace(
            robot,
            joints=robot.joints + tuple(replace(joint, actuated=False) for joint in ball),
            platforms=tuple(platform for platform in robot.platforms if platform is not rod),
            closures=_carried_ends(rest, at)[0],
            file=replace(robot.file, inertias=_inertias(robot, at)),
        )
    return robot


def _before_slides(robot: Robot, end: Attachment) -> tuple[Attachment, list[np.ndarray]]:
    """Express a closure's end in the body before slides that carry only it; also return their directions (3,)."""
    directions: list[np.ndarray] = []
    while (slide := _lone(robot, end.body)) is not None and slide.kind == "prismatic":
        turned = slide.placement.rotation
        directions = [turned @ direction for direction in (np.array(slide.axis), *directions)]
        end = Attachment(slide.antecedent, slide.placement).at(end.placement)
    return end, directions


def _pin(robot: Robot, end: Attachment) -> Joint | None:
    """Find the passive revolute joint that moves only a closure's end."""
    pin = _lone(robot, end.body)
    return pin if pin is not None and pin.turns and not pin.actuated else None


def _lone(robot: Robot, body: str) -> Joint | None:
    """Find the joint of a body that carries a single closure's end or joint."""
    if all(joint.name != body for joint in robot.joints):
        return None
    uses = [joint.antecedent for joint in robot.joints] + [end.body for end in robot.ends]
    uses += [name for tie in robot.couplings for name in tie.terms]
    return robot.joint(body) if uses.count(body) == 1 else None


def _line(pin: Joint, end: Attachment) -> tuple[np.ndarray, np.ndarray]:
    """Compute direction (3,) and a point (3,) of the pin's axis in the frame of the closure's end."""
    to_end = end.placement.rotation.T
    return to_end @ np.array(pin.axis), to_end @ -end.placement.position


def _with_ball(robot: Robot, pin: Joint, along: np.ndarray) -> Robot:
    """Make a ball of three hinges that meet in one point, the last one ``pin`` not ``along`` a rod (3,).

    Masses of links between the hinges move to the point, on the body that carries the ball.
    """
    hinges = _hinges(robot, pin)
    if hinges is None or _ball(robot, pin) or np.linalg.norm(np.cross(pin.axis, along)) < COAXIAL:
        return robot
    first, second, _ = hinges
    between = {link.name: link for link in (first, second)}
    at = {body: Attachment(body) for body in (GROUND, *robot.bodies)}
    at |= dict.fromkeys(between, Attachment(first.antecedent, first.placement))
    stated = {name: value for name, value in stated_inertias(robot).items() if name.body not in between}
    if mass := sum(rigid_body(robot.inertias, name).mass for name in between):
        stated[Parameter("m", first.name)] = mass
    links = robot.with_file(inertias=tuple(stated.items()))
    made = {name: replace(link, parameters="none") for name, link in between.items()}
    made[pin.name] = replace(pin, parameters="inertial")
    heavy = first.antecedent if mass else ""
    joints = (made.get(joint.name, _heavy(joint) if joint.name == heavy else joint) for joint in robot.joints)
    names = listed([joint.name for joint in hinges])
    note = f"the joints {names} meet in one point and let the link of '{pin.name}' turn about itself: they are a ball"
    note += f", without friction, and the {mass:.3g} kg of the links between them are at its centre" * (mass > 0)
    return replace(robot, joints=tuple(joints)).with_file(inertias=_inertias(links, at)).noted(note)


def _ball(robot: Robot, last: Joint) -> tuple[Joint, Joint, Joint] | None:
    """Find the three pins of a ball with massless links in between, by the last pin."""
    hinges = _hinges(robot, last)
    return hinges if (hinges is not None and all(joint.parameters == "none" for joint in hinges[:2])) else None


def _hinges(robot: Robot, last: Joint) -> tuple[Joint, Joint, Joint] | None:
    """Find three orthogonal passive pins that meet in one point and turn one link, by the last pin."""
    before = {joint.name: joint for joint in robot.joints}
    middle = before.get(last.antecedent, last)
    ball = (before.get(middle.antecedent, last), middle, last)
    axes = np.array([joint.axis for joint in ball])
    orthogonal = last.placement == middle.placement == Pose() and np.allclose(axes @ axes.T, np.eye(3), atol=COAXIAL)
    inner = all(_pin(robot, Attachment(joint.name)) for joint in ball[:2])
    passive = last.turns and last.name not in robot.driven and last.spring is None
    return ball if orthogonal and inner and passive else None


def _aimed(robot: Robot, pin: Joint, along: np.ndarray) -> Robot:
    """Choose the axes of a ball anew, if ``pin`` is its last: turn that axis ``along`` a direction (3,) of its link."""
    pin = robot.joint(pin.name)
    if (ball := _ball(robot, pin)) is None or np.linalg.norm(np.cross(pin.axis, along)) < COAXIAL:
        return robot
    axes = np.array([joint.axis for joint in ball]).T
    orientation = np.linalg.multi_dot([turn(axis, joint.home) for axis, joint in zip(axes.T, ball, strict=True)])
    # the first axis is square to the rod at home, far from where the first and last would be one
    across = np.cross(along, orientation @ along)
    if np.linalg.norm(across) < 0.1:
        across = np.cross(along, axes[:, np.argmin(np.abs(along @ axes))])
    across /= np.linalg.norm(across)
    now = np.array([across, np.cross(along, across), along]).T
    homes = euler_angles(now.T @ orientation @ now)
    made = {
        joint.name: replace(joint, axis=(rounded(x), rounded(y), rounded(z)), home=rounded(home))
        for joint, (x, y, z), home in zip(ball, now.T, homes, strict=True)
    }
    return replace(robot, joints=tuple(made.get(joint.name, joint) for joint in robot.joints))

"""Published planar and spatial parallel robots with random lengths, exact or written with so many decimals.

Each is drawn at home in space, so that it closes there by construction; frames are then put on its joints, turned at
random about their axes, and the plane of a planar one is turned at random.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from gtau.model.kinematics import Coordinates
from gtau.model.loop_closure import loop_errors
from gtau.robots.placement import angles_of
from gtau.robots.robot import GROUND, Attachment, Closure, Joint, Placement, Platform, Pose, Robot

Z = (0.0, 0.0, 1.0)


@dataclass
class Drawing:
    """Joints, platforms and closures where they are at home."""

    rng: np.random.Generator
    mount: np.ndarray
    spins: bool = True  # frames are turned about their axes, so that lengths are not along x
    frames: dict[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    joints: list[Joint] = field(default_factory=list)
    platforms: list[Platform] = field(default_factory=list)
    closures: list[Closure] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.frames[GROUND] = np.eye(3), np.zeros(3)

    def at(self, body: str, point: np.ndarray, rotation: np.ndarray) -> Pose:
        R, p = self.frames[body]
        x, y, z = (R.T @ (point - p)).tolist()
        return Pose((x, y, z), angles_of(R.T @ rotation))

    def joint(self, name: str, before: str, point, axis=Z, kind: str = "revolute", motor: bool = False) -> None:
        layer = self.rng.uniform(-0.05, 0.05) * np.array(axis) * (len(point) == 2)  # bars lie above each other
        point, axis = self.mount @ (space(point) + layer), self.mount @ np.array(axis)
        x = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
        x /= np.linalg.norm(x)
        rotation = np.column_stack([x, np.cross(axis, x), axis])
        rotation = rotation @ Rotation.from_euler("z", self.spins * self.rng.uniform(-3, 3)).as_matrix()
        self.joints.append(Joint(name, before, kind, self.at(before, point, rotation), actuated=motor))  # type: ignore[arg-type]
        self.frames[name] = rotation, point

    def platform(self, name: str, dof: str, point) -> None:
        x, y, z = space(point).tolist()
        self.platforms.append(Platform(name, tuple(dof.split()), Pose((x, y, z))))
        self.frames[name] = np.eye(3), space(point)

    def tie(self, a: str, b: str, point, kind: str = "connect") -> None:
        point, frame = self.mount @ space(point), Rotation.random(random_state=self.rng).as_matrix()
        frame = frame if kind == "weld" else np.eye(3)
        poses = (self.at(body, point, frame if kind == "weld" else self.frames[body][0]) for body in (a, b))
        self.closures.append(Closure(kind, *map(Attachment, (a, b), poses)))  # type: ignore[arg-type]


def space(point) -> np.ndarray:
    return np.pad(np.array(point, dtype=float), (0, 3 - len(point)))


def polar(length: float, angle: float) -> np.ndarray:
    return length * np.array([np.cos(angle), np.sin(angle)])


def elbow(foot: np.ndarray, tip: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Middle pin of two bars from a foot to a tip, bent by 30 to 120 degrees."""
    way, share, bend = tip - foot, rng.uniform(0.35, 0.65), rng.uniform(0.25, 0.7)
    return foot + share * way + rng.choice([-1, 1]) * bend * np.array([-way[1], way[0]])


def four_bar_of(d: Drawing) -> dict[str, np.ndarray]:
    rng = d.rng
    pin = {"A": np.zeros(2), "D": np.array([rng.uniform(0.4, 0.8), rng.uniform(-0.1, 0.1)])}
    pin["B"] = polar(rng.uniform(0.15, 0.35), rng.uniform(1, 2))
    pin["C"] = pin["D"] + polar(rng.uniform(0.4, 0.7), rng.uniform(1, 1.6))
    d.joint("crank", GROUND, pin["A"], motor=True)
    d.joint("coupler", "crank", pin["B"])
    d.joint("rocker", GROUND, pin["D"])
    d.tie("coupler", "rocker", pin["C"])
    return pin


def four_bar(d: Drawing) -> None:
    four_bar_of(d)


def watt(d: Drawing) -> None:
    pin = four_bar_of(d)
    e = pin["C"] + polar(d.rng.uniform(0.2, 0.4), d.rng.uniform(1.3, 2.6))
    f = pin["C"] + polar(d.rng.uniform(0.2, 0.4), d.rng.uniform(-0.6, 0.4))
    g = elbow(e, f, d.rng) + np.array([0.0, d.rng.uniform(0.05, 0.2)])
    d.joint("upper", "coupler", e)
    d.joint("lower", "rocker", f)
    d.tie("upper", "lower", g)


def stephenson(d: Drawing) -> None:
    pin = four_bar_of(d)
    e = (pin["B"] + pin["C"]) / 2 + polar(0.25, d.rng.uniform(1.2, 2.2))
    foot = np.array([d.rng.uniform(1.0, 1.3), d.rng.uniform(-0.2, 0.2)])
    d.joint("link", "coupler", e)
    d.joint("output", GROUND, foot)
    d.tie("link", "output", elbow(foot, e, d.rng))


def slider_crank(d: Drawing) -> None:
    rng, angle = d.rng, d.rng.uniform(-0.3, 0.3)
    tip = np.array([rng.uniform(0.5, 0.9), rng.uniform(-0.05, 0.05)])
    d.joint("crank", GROUND, (0, 0), motor=True)
    d.joint("rod", "crank", polar(rng.uniform(0.1, 0.2), rng.uniform(1, 2)))
    d.joint("slider", GROUND, (0.4, 0.1), (*polar(1, angle), 0), "prismatic")
    d.tie("rod", "slider", tip)


def five_bar(d: Drawing) -> None:
    half, tip = d.rng.uniform(0.05, 0.2), np.array([d.rng.uniform(-0.1, 0.1), d.rng.uniform(0.3, 0.5)])
    for name, x in (("left", -half), ("right", half)):
        foot = np.array([x, 0.0])
        d.joint(name, GROUND, foot, motor=True)
        d.joint(f"{name}_forearm", name, elbow(foot, tip, d.rng))
    d.tie("left_forearm", "right_forearm", tip)


def planar_legs(d: Drawing, slides: bool) -> None:
    radius, pins = d.rng.uniform(0.3, 0.5), d.rng.uniform(0.08, 0.2)
    turn = d.rng.choice([-1, 1]) * d.rng.uniform(0.3, 0.8)  # not 0, where the lines of the legs meet
    d.mount = np.eye(3)  # of a platform that moves along axes of the base
    d.platform("plate", "x y rz", (0, 0))
    for k in range(3):
        foot, pin = polar(radius, 2 * np.pi * k / 3), polar(pins, 2 * np.pi * k / 3 + turn)
        if slides:
            way = (pin - foot) / np.linalg.norm(pin - foot)
            d.joint(f"pivot{k}", GROUND, foot)
            d.joint(f"leg{k}", f"pivot{k}", foot, (*way, 0), "prismatic", motor=True)
        else:
            d.joint(f"arm{k}", GROUND, foot, motor=True)
            d.joint(f"leg{k}", f"arm{k}", elbow(foot, pin, d.rng))
        d.tie(f"leg{k}", "plate", pin)


def three_rrr(d: Drawing) -> None:
    planar_legs(d, slides=False)


def three_rpr(d: Drawing) -> None:
    planar_legs(d, slides=True)


def palletiser(d: Drawing) -> None:
    rng, y, d.spins = d.rng, (0.0, 1.0, 0.0), False
    height, crank = rng.uniform(0.4, 0.8), polar(rng.uniform(0.2, 0.35), rng.uniform(2.8, 3.5))
    lower = polar(rng.uniform(0.7, 1.0), rng.uniform(1.3, 1.8))

    def above(point: np.ndarray) -> tuple[float, float, float]:
        return (0.2 + point[0], 0.0, height + point[1])

    d.joint("turret", GROUND, (0, 0, 0), motor=True)
    d.joint("lower_arm", "turret", above(np.zeros(2)), y, motor=True)
    d.joint("crank", "turret", above(np.zeros(2)), y, motor=True)
    d.joint("rod", "crank", above(crank), y)
    d.joint("upper_arm", "lower_arm", above(lower), y)
    d.tie("rod", "upper_arm", above(lower + crank))


def tripteron(d: Drawing) -> None:
    d.mount = np.eye(3)
    d.platform("tool", "x y z", (0, 0, 0))
    for k in range(3):
        axis, other, third = np.roll(np.eye(3), k, axis=0)
        plane = np.array([other, third]).T
        foot = d.rng.uniform(0.5, 0.8) * polar(1, d.rng.uniform(-3, 3))
        middle, tip = elbow(foot, np.zeros(2), d.rng), 0.1 * axis
        d.joint(f"rail{k}", GROUND, plane @ foot + tip, tuple(axis), "prismatic", motor=True)
        d.joint(f"arm{k}", f"rail{k}", plane @ foot + tip, tuple(axis))
        d.joint(f"forearm{k}", f"arm{k}", plane @ middle + tip, tuple(axis))
        d.joint(f"wrist{k}", f"forearm{k}", tip, tuple(axis))
        d.tie(f"wrist{k}", "tool", tip, "weld")


def delta(d: Drawing) -> None:
    base, arm, plate = d.rng.uniform(0.2, 0.4), d.rng.uniform(0.3, 0.5), d.rng.uniform(0.05, 0.15)
    down, droop = d.rng.uniform(0.6, 0.9), d.rng.uniform(0.0, 0.3)
    d.mount = np.eye(3)
    d.platform("tool", "x y z", (0, 0, -down))
    for k in range(3):
        turn = Rotation.from_euler("z", 2 * np.pi * k / 3).as_matrix()
        shoulder, tip = np.array([base, 0, 0]), np.array([plate, 0, -down])
        knee = np.array([base + arm * np.cos(droop), 0, -arm * np.sin(droop)])
        across = np.cross([0, 1, 0], tip - knee)
        d.joint(f"arm{k}", GROUND, turn @ shoulder, tuple(turn @ [0, 1, 0]), motor=True)
        d.joint(f"knee{k}", f"arm{k}", turn @ knee, tuple(turn @ [0, 1, 0]))
        d.joint(f"bar{k}", f"knee{k}", turn @ knee, tuple(turn @ across / np.linalg.norm(across)))
        d.tie(f"bar{k}", "tool", turn @ tip)


Kind = Callable[[Drawing], None]
KINDS: tuple[Kind, ...] = (
    four_bar,
    watt,
    stephenson,
    slider_crank,
    five_bar,
    three_rrr,
    three_rpr,
    palletiser,
    tripteron,
    delta,
)


CONDITION = 20.0  # of robots that work: condition number at home


def draw(kind: Kind, seed: int) -> Robot:
    """Draw a robot of a kind, with all digits, whose home is not close to a singularity."""
    rng = np.random.default_rng(seed)
    while True:
        drawing = Drawing(rng, Rotation.random(random_state=rng).as_matrix())
        kind(drawing)
        gx, gy, gz = (drawing.mount @ [1.0, -9.0, 2.0]).tolist()
        parts = tuple(drawing.joints), tuple(drawing.platforms), tuple(drawing.closures)
        robot = Robot(kind.__name__.replace("_", "-"), *parts, gravity=(gx, gy, gz))
        errors = loop_errors(Coordinates(robot))
        if errors.condition(errors.layout.home) < CONDITION:
            return robot


def written(robot: Robot, decimals: int) -> Robot:
    """The robot with its numbers written with so many decimals."""

    def rounded(placement: Placement) -> Pose:
        values = *placement.position.tolist(), *angles_of(placement.rotation)
        x, y, z, roll, pitch, yaw = (round(value, decimals) for value in values)
        return Pose((x, y, z), (roll, pitch, yaw))

    def end(at: Attachment) -> Attachment:
        return replace(at, placement=rounded(at.placement))

    joints = (replace(joint, placement=rounded(joint.placement)) for joint in robot.joints)
    closures = (replace(each, a=end(each.a), b=end(each.b)) for each in robot.closures)
    return replace(robot, joints=tuple(joints), closures=tuple(closures))

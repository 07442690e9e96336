"""The plant: its accelerations against two engines, its energy, its friction, and what it refuses."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest
from energies import energy
from engines import Mujoco, Pinocchio, closed_torques, random_parameters
from robots_for_tests import four_bar, seven_r

from gtau.errors import GtauError
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.loops import advance
from gtau.robots.robot import Joint, Mdh, Robot
from gtau.simulation.joint_friction import plain_friction
from gtau.simulation.mujoco_plant import MujocoPlant
from gtau.simulation.plant import Plant, PlantState

NAMES = ("orthoglide", "five-bar", "delta", "gough-stewart")
ROBOTS = [*(load_robot(name) for name in NAMES), seven_r(), four_bar()]
FRICTIONLESS = ("fv", "fs", "off")


def pose(robots=ROBOTS):
    return pytest.mark.parametrize("robot", robots, ids=lambda robot: robot.name)


def frictionless(chi):
    return {name: value for name, value in chi.items() if name.split("_")[0] not in FRICTIONLESS}


def random_states(model: InverseDynamics, rng: np.random.Generator, count: int) -> list[PlantState]:
    """States near home, moving, with the loops closed."""
    home = np.array([joint.home for joint in model.robot.joints if joint.actuated])
    reach = 0.05 if model.loops else 1.0
    q = home + reach * rng.uniform(-1, 1, (count, len(home)))
    qd = rng.normal(size=q.shape)
    if model.loops is None:
        return [PlantState(a, b, a, b) for a, b in zip(q, qd, strict=True)]
    c, reached = advance(model.loops, np.repeat(model.loops.home[:, None], count, axis=1), q.T)
    assert reached.all()
    return [PlantState(a, b, pose, b) for a, b, pose in zip(q, qd, c.T, strict=True)]


def engine_acceleration(engine, robot, chi, state, force):
    """By an engine: its torques are affine in the accelerations, so that n + 1 of them give the mass matrix."""
    n = len(force)
    push = np.vstack([np.zeros(n), np.eye(n)])
    still = closed_torques(robot, chi, *(np.repeat(x[None], n + 1, axis=0) for x in (state.q, state.qd)), push, engine)
    return np.linalg.solve((still[1:] - still[0]).T, force - still[0])


@pytest.mark.parametrize(("engine", "tolerance"), [(Pinocchio, 1e-10), (Mujoco, 1e-5)])
@pose()
def test_accelerations_are_those_of_the_engines(robot, engine, tolerance, rng):
    """With friction: at these speeds tanh(v / width) is the engines' sign(v), but for joints that hardly move."""
    model, chi = InverseDynamics(robot), random_parameters(robot, rng)
    plant = Plant(model, chi, plain_friction(model, chi, {"prismatic": 1e-9, "revolute": 1e-9}))
    for state in random_states(model, rng, 3):
        force = 30 * rng.normal(size=len(model.actuated))
        expected = engine_acceleration(engine, robot, chi, state, force)
        assert plant.acceleration(state, force) == pytest.approx(expected, abs=tolerance * np.abs(expected).max())


@pose()
def test_the_energy_balance_holds_for_ten_seconds(robot, rng):
    """Without friction the energy changes by the work of the held forces, a sampled spring and damper about home."""
    model = InverseDynamics(robot)
    plant = Plant(model, frictionless(random_parameters(robot, rng)))
    home = plant.start(np.array([joint.home for joint in robot.joints if joint.actuated]))
    mass = plant.mass_matrix(home.c)
    weight = -mass @ plant.acceleration(home, np.zeros(len(home.q)))
    speed = rng.normal(size=len(home.q))
    speed *= 0.3 / np.abs(speed).max()
    state = PlantState(home.q, speed, home.c, speed)
    start, kinetic, worst, work, farthest = energy(plant, state), speed @ mass @ speed / 2, 0.0, 0.0, 0.0
    for _ in range(2000):
        force = weight - mass @ (100.0 * (state.q - home.q) + 0.3 * state.qd)
        after = plant.advance(state, force, 5e-3)
        work += force @ (after.q - state.q)
        state = after
        farthest = max(farthest, np.abs(state.q - home.q).max())
        worst = max(worst, abs(energy(plant, state) - start - work))
    assert 0.01 < farthest < 0.3
    assert worst < 1e-6 * kinetic


def test_a_pendulum_swings_as_the_formula_says():
    """Small swings of a rod about its end, and viscous friction that damps them."""
    robot = Robot("pendulum", (Joint("1", "ground", "revolute", Mdh(alpha=-pi / 2)),))
    inertia, moment, viscous = 0.2, 0.3, 0.05
    plant = Plant(InverseDynamics(robot), {"zz_1": inertia, "mx_1": moment, "fv_1": viscous})
    down = plant.start(np.array([0.0]))
    gravity = plant.acceleration(PlantState(np.array([1e-6]), down.qd, np.array([1e-6]), down.v), np.zeros(1))[0]
    rest = pi / 2 if abs(gravity) > 1e-3 else 0.0  # level, so it falls: it hangs a quarter turn further
    angle = 1e-4
    state = plant.start(np.array([rest + angle]))
    omega2, sigma = moment * 9.80665 / inertia, viscous / inertia / 2
    damped = np.sqrt(omega2 - sigma**2)
    for _ in range(100):
        state = plant.advance(state, np.zeros(1), 0.01)
    expected = angle * np.exp(-sigma) * (np.cos(damped) + sigma / damped * np.sin(damped))
    assert state.q[0] - rest == pytest.approx(expected, abs=1e-4 * angle)


def test_the_loops_stay_closed():
    model = InverseDynamics(load_robot("orthoglide"))
    plant = Plant(model, {"ia_11": 8.0, "ia_12": 8.0, "ia_13": 8.0, "m_P": 1.0, "fs_11": 20.0})
    state = plant.start(np.zeros(3))
    for k in range(300):
        state = plant.advance(state, np.array([60.0, -50.0, 40.0 * np.cos(0.05 * k)]), 1e-3)
    assert np.abs(state.q).min() > 1e-3
    assert model.loops.gap(state.c[:, None]).max() < 1e-12


def test_coulomb_friction_holds_what_it_can():
    """Under less than the friction a joint creeps no faster than tanh lets it, under more it runs away."""
    robot = Robot("slide", (Joint("1", "ground", "prismatic"),), gravity=(0.0, 0.0, 0.0))
    plant = Plant(InverseDynamics(robot), {"m_1": 2.0, "fs_1": 10.0})
    state = plant.start(np.zeros(1))
    for _ in range(200):
        state = plant.advance(state, np.array([9.0]), 1e-3)
    assert state.qd[0] == pytest.approx(1e-3 * np.arctanh(0.9), rel=1e-3)
    for _ in range(200):
        state = plant.advance(state, np.array([14.0]), 1e-3)
    assert state.qd[0] == pytest.approx(0.2 * 4.0 / 2.0, rel=0.02)


@pose([*(load_robot(name) for name in NAMES), seven_r()])
def test_mujoco_moves_alike(robot, rng):
    """Closures as MuJoCo's constraints, its own integration: the same motion within what those give way."""
    model, chi = InverseDynamics(robot), random_parameters(robot, rng)
    ours, theirs = Plant(model, chi), MujocoPlant(model, chi)
    home = np.array([joint.home for joint in robot.joints if joint.actuated])
    a, b = ours.start(home), theirs.start(home)
    force = 30 * rng.normal(size=len(home)) - ours.mass_matrix(a.c) @ ours.acceleration(a, np.zeros(len(home)))
    for _ in range(40):
        a, b = ours.advance(a, force, 1e-3), theirs.advance(b, force, 1e-3)
    moved = np.abs(a.q - home).max()
    assert moved > 1e-4
    assert b.q == pytest.approx(a.q, abs=0.02 * moved)


@pytest.mark.parametrize("turret", [1.0, pi / 2, 2.5, -2.0])
def test_a_linkage_whose_plane_turns_with_the_robot(turret, rng):
    """The equations that parallelograms do not need are others in base axes for every angle of the turret."""
    robot = load_robot("palletiser")
    model, chi = InverseDynamics(robot), frictionless(random_parameters(robot, rng))
    plant = Plant(model, chi)
    state = plant.start(np.array([turret, 1.6, 3.2, 0.3]))
    state = PlantState(state.q, np.array([0.4, -0.3, 0.5, 0.8]), state.c, state.v)
    force = 30 * rng.normal(size=4)
    qdd = plant.acceleration(state, force)
    assert model.torques(state.q[None], state.qd[None], qdd[None], chi)[0] == pytest.approx(force, abs=1e-8)
    assert np.isfinite(plant.advance(state, force, 0.01).q).all()


def test_mujoco_takes_massless_links():
    robot = load_robot("five-bar")
    model = InverseDynamics(robot)
    plant = MujocoPlant(model, {"ia_left": 0.1, "ia_right": 0.1})
    assert np.isfinite(plant.advance(plant.start(np.radians([120.0, 60.0])), np.array([1.0, -1.0]), 0.01).q).all()


@pytest.mark.parametrize(
    ("chi", "sentence"),
    [
        ({"m_11": 1.0}, "its mass matrix at home is not positive definite"),
        ({"mass_11": 1.0}, "has no standard parameter 'mass_11'"),
    ],
)
def test_what_cannot_move_is_refused(chi, sentence):
    with pytest.raises(GtauError, match=sentence):
        Plant(InverseDynamics(load_robot("orthoglide")), chi)


def test_a_singular_pose_ends_the_motion():
    """The feet driven apart until the bars lie in one plane."""
    plant = Plant(InverseDynamics(load_robot("orthoglide")), {"ia_11": 8.0, "ia_12": 8.0, "ia_13": 8.0, "m_P": 1.0})
    state = plant.start(np.zeros(3))

    def push(state):
        for _ in range(300):
            state = plant.advance(state, np.full(3, -60.0), 1e-3)

    with pytest.raises(GtauError, match=r"cannot be continued at q_11 = -0\.07"):
        push(state)

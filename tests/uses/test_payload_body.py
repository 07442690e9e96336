"""Centre of mass and inertia of a weighed payload: in any frame, of a body that can exist, with honest intervals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from plausible_parameters import body_parameters, random_parameters
from scipy.spatial.transform import Rotation

from gtau.errors import GtauError
from gtau.estimation.results.payload_body import QUANTITIES, PayloadBody, PayloadEstimate, Weighed, quantities
from gtau.model.home import load_robot
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.result import identify
from gtau.robots.parameter import RigidBody, inertial_parameters, pseudo_inertia, rigid_body
from gtau.robots.readers.read import frame_on, links_on
from gtau.robots.robot import INERTIAL, Pose
from gtau.signals.reading.statements import Payload
from gtau.signals.run import Run
from gtau.simulation.trajectories import envelope, sines
from gtau.uses.weigh import weigh

FRAME = Pose((0.02, -0.01, 0.05), (0.3, -0.2, 0.5))
POINTS = np.array([[0.05, 0.02, 0.1], [-0.06, 0.0, 0.14], [0.01, -0.08, 0.05], [0.02, 0.05, 0.2]])
MASSES = np.array([0.5, 0.3, 0.6, 0.2])


def truth(masses: np.ndarray, points: np.ndarray, frame: Pose) -> np.ndarray:
    """Compute mass, centre and inertia of point masses from the points as ``frame`` sees them."""
    seen = (points - np.array(frame.xyz)) @ Rotation.from_euler("xyz", frame.rpy).as_matrix()
    center = masses @ seen / masses.sum()
    tensor = sum(m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(masses, seen - center, strict=True))
    entries = np.asarray(tensor)[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    return np.array([masses.sum(), *center, *entries])


def exact(sums: np.ndarray, chi: np.ndarray, std: float = 1e-4) -> Weighed:
    """What a weighing says that finds sums of chi with a standard deviation, uncorrelated."""
    values = sums @ chi
    return Weighed("6", sums, values, std**2 * np.eye(len(sums)), np.zeros((0, 10)), np.zeros(0), None, 1.0)


def body(weighed: Weighed, frame: Pose) -> PayloadBody:
    return PayloadEstimate("x", "run", {}, frozenset(), weighed=weighed).in_frame(frame)


def chi_of(masses: np.ndarray = MASSES, points: np.ndarray = POINTS) -> np.ndarray:
    return np.array(list(body_parameters("6", masses, points).values()))


def test_the_body_in_another_frame_is_that_of_its_points() -> None:
    found = body(exact(np.eye(10), chi_of(), 1e-6), FRAME)
    values = [found.parameters[key].value for key in QUANTITIES]
    assert values == pytest.approx(truth(MASSES, POINTS, FRAME), rel=1e-4, abs=1e-6)
    assert not found.unseen


def test_the_intervals_are_those_of_draws_with_correlated_mass_and_moments() -> None:
    rng, chi = np.random.default_rng(0), chi_of()
    scale = np.array([1e-3] * 6 + [4e-3] * 3 + [2e-2])
    mixed = rng.normal(size=(10, 10)) * scale[:, None]
    mixed[6:9] += 5e-3 * np.outer(np.sign(chi[6:9]), mixed[9] / scale[9])  # a heavier payload has larger moments
    covariance = 0.01 * mixed @ mixed.T
    weighed = replace(exact(np.eye(10), chi), covariance=covariance)
    found = body(weighed, FRAME)
    draws = rng.multivariate_normal(chi, covariance, 4000)
    spread = np.std([quantities(each, FRAME.rotation, FRAME.position) for each in draws], axis=0)
    for key, std in zip(QUANTITIES[:4], spread, strict=False):
        assert found.parameters[key].std == pytest.approx(std, rel=0.06)
    wrong = np.sqrt(covariance[6, 6]) / chi[9]  # without the mass
    assert abs(spread[1] / wrong - 1) > 0.1


def test_sums_that_no_body_has_become_a_body_near_them() -> None:
    chi = chi_of()
    spoilt = chi + np.array([-0.02, 0, 0, 0.004, 0, 0, 0, 0, 0, 0])  # xx far below what the points have
    assert np.linalg.eigvalsh(pseudo_inertia(spoilt))[0] < 0
    covariance = np.diag([1e-2**2] + [1e-4**2] * 9)
    weighed = replace(exact(np.eye(10), spoilt), covariance=covariance)
    found = body(weighed, Pose())
    assert found.rigid is not None
    values = np.array(list(inertial_parameters(found.rigid).values()))
    assert np.linalg.eigvalsh(pseudo_inertia(values))[0] > 0
    assert found.parameters["m"].value == pytest.approx(chi[9], abs=1e-3)
    assert abs(values[0] - chi[0]) < 0.02


def test_sums_far_from_those_of_any_body_are_doubted() -> None:
    chi = chi_of()
    assert not body(exact(np.eye(10), chi), FRAME).doubt
    chi[INERTIAL.index("xx") : INERTIAL.index("zz")] = 0.0  # moments about its origin without inertia
    assert "no rigid body has what was weighed" in body(exact(np.eye(10), chi), FRAME).doubt


def test_what_the_motion_does_not_show_is_not_a_value() -> None:
    """A joint turning about z feels zz, mx and my; with gravity's m beside it, nothing of cz and the other inertias."""
    sums = np.eye(10)[[INERTIAL.index(kind) for kind in ("zz", "mx", "my", "m")]]
    found = body(exact(sums, chi_of(), 1e-6), Pose())
    assert set(found.unseen) == {"cz", "Ixx", "Iyy", "Ixy", "Ixz", "Iyz"}
    whole = truth(MASSES, POINTS, Pose())
    for key in ("m", "cx", "cy", "Izz"):
        assert found.parameters[key].value == pytest.approx(whole[QUANTITIES.index(key)], rel=1e-3)
    assert found.rigid is not None
    assert np.linalg.eigvalsh(found.rigid.inertia)[0] > 0
    turned = body(exact(sums, chi_of(), 1e-6), FRAME)
    assert {"cx", "cy", "cz"} <= set(turned.unseen)  # each has a share of what is not known


def test_a_mass_in_no_sum_by_itself_gives_no_body() -> None:
    sums = np.eye(10)[6:9] + 0.3 * np.eye(10)[9]
    found = body(exact(sums, chi_of()), Pose())
    assert found.rigid is None
    assert found.unseen == QUANTITIES


def test_an_inertia_less_certain_than_its_size_is_not_shown() -> None:
    found = body(exact(np.eye(10), chi_of(), 0.02), Pose())
    assert set(found.unseen) == set(QUANTITIES[4:])
    assert found.parameters["cx"].value is not None


URDF = """<robot name="two">
<link name="base"/><link name="arm"/><link name="flange"/><link name="tool0"/>
<joint name="elbow" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/></joint>
<joint name="to_flange" type="fixed"><origin xyz="0.1 0 0" rpy="0 0 1.0"/><parent link="arm"/><child link="flange"/>
</joint>
<joint name="to_tool" type="fixed"><origin xyz="0 0.2 0" rpy="0.5 0 0"/><parent link="flange"/><child link="tool0"/>
</joint></robot>"""


def test_a_link_of_the_urdf_is_a_frame(tmp_path: Path) -> None:
    (tmp_path / "two.urdf").write_text(URDF)
    called, placement = frame_on("elbow", "tool0", tmp_path / "two.urdf")
    assert called == "tool0"
    first, second = Rotation.from_euler("z", 1.0), Rotation.from_euler("x", 0.5)
    assert placement.position == pytest.approx(np.array([0.1, 0, 0]) + first.apply([0, 0.2, 0]))
    assert placement.rotation == pytest.approx((first * second).as_matrix())
    _, written = frame_on("elbow", "0.1 0 0, 0 0 1.0", None)
    assert written == Pose((0.1, 0.0, 0.0), (0.0, 0.0, 1.0))


def test_links_fixed_to_the_carrier_are_offered(tmp_path: Path) -> None:
    (tmp_path / "two.urdf").write_text(URDF)
    assert links_on("elbow", tmp_path / "two.urdf") == ["arm", "flange", "tool0"]
    assert links_on("elbow", "ur10e") == []


@pytest.mark.parametrize(
    ("frame", "sentence"),
    [
        ("tool9", "has no link 'tool9'; on 'elbow' are arm, elbow, flange, to_flange, tool0, to_tool"),
        ("base", "link 'base' of .* is not fixed to 'elbow', which carries the payload; choose from"),
        ("0 0 0.1", "has 3 numbers; write 'x y z roll pitch yaw'"),
        ("nan 0 0 0 0 0", "has a number that is not finite; write 'x y z roll pitch yaw'"),
    ],
)
def test_frames_that_are_refused(tmp_path: Path, frame: str, sentence: str) -> None:
    (tmp_path / "two.urdf").write_text(URDF)
    with pytest.raises(GtauError, match=sentence):
        frame_on("elbow", frame, tmp_path / "two.urdf")
    with pytest.raises(GtauError, match=r"only a URDF has; name the URDF [(]--robot, or --experiment"):
        frame_on("elbow", "tool0", "ur10e")


# Simulated weighings


@pytest.fixture(scope="module")
def weighings() -> list[tuple[PayloadEstimate, np.ndarray]]:
    """Weigh payloads of four points on a UR10e, torques under 1 % of noise, with the truth in FRAME."""
    robot = load_robot("ur10e")
    model, time, found = InverseDynamics(robot), np.arange(1601) / 200, []
    reference = None
    for seed in range(3):
        rng = np.random.default_rng([11, seed])
        chi = random_parameters(model, rng)
        center = np.array([0.0, 0.0, 0.08]) + rng.uniform(-0.1, 0.1, 3)
        masses, points = rng.uniform(0.1, 1.0, 4), center + rng.normal(0.0, 0.06, (4, 3))
        runs = []
        for name, load in (("free", {}), ("loaded", body_parameters(robot.tool, masses, points))):
            path = sines(envelope(robot, 0.7), 8.0, rng)(time)
            tau = model.torques(*path, chi | {kind: chi[kind] + value for kind, value in load.items()})
            tau += 0.01 * np.sqrt(np.mean(tau**2, axis=0)) * rng.standard_normal(tau.shape)
            payload = Payload(name="load") if load else None
            runs.append(Run(name, model.actuated, time, path[0], tau, kind="torque", payload=payload))
        reference = reference or identify(robot, runs[:1])
        (estimate,) = weigh(reference, robot, runs)
        found.append((estimate, truth(masses, points, FRAME)))
    return found


def test_the_centre_of_mass_is_within_its_interval(weighings: list[tuple[PayloadEstimate, np.ndarray]]) -> None:
    """Of three weighings; docs/evidence/coverage/weighings.csv has the counts of more, on three robots."""
    held = []
    for estimate, true in weighings:
        body = estimate.in_frame(FRAME)
        assert not body.unseen
        ends = [body.parameters[key].interval() for key in QUANTITIES]
        assert all(end is not None for end in ends)
        held.append([low < value < high for (low, high), value in zip(ends, true, strict=True)])
        for key, half in (("cx", 2e-3), ("cy", 2e-3), ("cz", 2e-3), ("Izz", 1e-3)):
            assert body.parameters[key].half_interval() < half
        assert body.rigid is not None
        own = estimate.in_frame().rigid
        assert own is not None
        mass = estimate.parameters["m"]
        assert (own.mass, *body.parameters["m"].interval()) == pytest.approx((mass.value, *mass.interval()), rel=1e-5)
        moved = own.seen_from(FRAME.rotation, FRAME.position)
        assert moved.center == pytest.approx(body.rigid.center)
        assert moved.inertia == pytest.approx(body.rigid.inertia)
    assert np.sum(np.array(held)[:, 1:4]) >= 8


def test_the_order_of_a_payload_begins_with_what_people_ask_for(
    weighings: list[tuple[PayloadEstimate, np.ndarray]],
) -> None:
    estimate, _ = weighings[0]
    assert list(estimate.parameters)[:4] == ["m", "mx", "my", "mz"]
    with pytest.raises(GtauError, match="was not weighed here; take it from"):
        replace(estimate, weighed=None).in_frame()
    with pytest.raises(GtauError, match=r"'frame' of .* cannot be of type int"):
        estimate.in_frame(3)


def test_rigid_bodies_and_parameters_are_inverse() -> None:
    chi = body_parameters("6", MASSES, POINTS)
    body = rigid_body(chi, "6")
    assert isinstance(body, RigidBody)
    assert list(inertial_parameters(body).values()) == pytest.approx(list(chi.values()))

"""Energy of a simulated robot, from the poses of its bodies."""

from functools import lru_cache

import casadi as ca
import numpy as np

from gtau.model.equations import spring_length
from gtau.model.kinematics import frames
from gtau.robots.parameter import Parameter
from gtau.robots.robot import PRELOAD, STIFFNESS
from gtau.simulation.plant import Plant, PlantState


def energy(plant: Plant, state: PlantState) -> float:
    """Compute kinetic and potential energy, J."""
    kinetic = state.qd @ plant.mass_matrix(state.c) @ state.qd / 2
    return float(kinetic + float(_potential(plant)(state.c)))


@lru_cache(maxsize=2)
def _potential(plant: Plant) -> ca.Function:
    layout, chi = plant.layout, plant.chi
    c = ca.SX.sym("c", layout.n_c)
    frame, potential = frames(layout, c), ca.SX(0)
    for body, at in frame.items():
        if Parameter("m", body) in chi:
            m, *ms = (chi[Parameter(kind, body)] for kind in ("m", "mx", "my", "mz"))
            potential -= ca.dot(ca.DM(layout.robot.gravity), m * at.p_0 + at.R_0 @ ca.DM(np.array(ms)))
    for row, joint in enumerate(layout.robot.joints):
        potential += chi.get(Parameter("off", joint.name), 0.0) * c[row]
        if joint.spring is not None:
            potential += chi.get(Parameter(STIFFNESS, joint.name), 0.0) * (c[row] - joint.spring) ** 2 / 2
    for spring in layout.robot.springs:
        length, _ = spring_length(spring, frame)
        f0, k = (chi.get(Parameter(kind, spring.name), 0.0) for kind in (PRELOAD, STIFFNESS))
        potential += k * length**2 / 2 - f0 * length
    return ca.Function("potential", [c], [potential])

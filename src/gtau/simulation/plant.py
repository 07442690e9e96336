"""Plant of a simulation: integrated forward dynamics of any robot (paper, eq. 15 solved for qdd).

The state is the configuration c of the virtual tree, the velocities qd of the actuated joints, and the states z of
presliding friction, which follow the positions. The passive coordinates are integrated as well (``yd = J qd``), and
the loops are closed after every step, in the same assembly mode.

Time per 1 ms of constant force on the Orthoglide: 0.35 ms with the integrator below (tolerance 1e-6), 0.65 ms with
CVODES (Adams; BDF 3.3 ms), and 2 ms with SciPy's RK45, DOP853 and LSODA (1e-7). All of them restart at every change of
the force.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from gtau.errors import GtauError
from gtau.model.equations import closure_expressions, solve, torques
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.model.kinematics import configuration_rates
from gtau.model.loops import advance as follow, pose_words
from gtau.robots.robot import PLAIN_FRICTION
from gtau.simulation.joint_friction import JointFriction, plain_friction

TOLERANCE = 1e-6  # error of the velocities in a step, rad/s or m/s
SHORTEST = 1e-9  # s
APART = 1e-5  # rad or m; integrated c further than this from the closed c is in another assembly mode

# the pair of Dormand and Prince of orders 5 and 4: stages (the last is the solution) and error
STAGES = (
    (1 / 5,),
    (3 / 40, 9 / 40),
    (44 / 45, -56 / 15, 32 / 9),
    (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
    (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
    (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
)
ERROR = (71 / 57600, 0.0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40)


@dataclass(frozen=True, eq=False)
class PlantState:
    """Positions and velocities of the actuated joints (n,), c and v of the engine, and states z (s,) of presliding."""

    q: np.ndarray
    qd: np.ndarray
    c: np.ndarray
    v: np.ndarray
    z: np.ndarray = field(default_factory=lambda: np.zeros(0))


class Plant:
    """Forward dynamics of a robot with the standard parameters ``chi`` by name, SI units, zero if missing.

    Friction defaults to ``fv v + fs tanh(v / width) + off`` from chi. Raises GtauError for unknown names and a mass
    matrix that is not positive definite.
    """

    def __init__(self, model: InverseDynamics, chi: Mapping[str, float], friction: JointFriction | None = None):
        self.model, self.layout = model, model.layout
        if unknown := next((name for name in chi if name not in model.parameter_names), None):
            raise GtauError(f"robot '{model.robot.name}' has no standard parameter '{unknown}'; correct its name.")
        self.chi: dict[str, float] = {name: float(chi.get(name, 0.0)) for name in model.parameter_names}
        self.friction = friction or plain_friction(model, self.chi)
        self._step = self._compiled_step()
        mass = self.mass_matrix(model.home)
        if np.linalg.eigvalsh((mass + mass.T) / 2).min() <= 1e-12 * np.abs(mass).max():
            raise GtauError(
                f"robot '{model.robot.name}': its mass matrix at home is not positive definite; give every actuated "
                "joint a mass, an inertia or a rotor ('ia')."
            )

    def start(self, q: np.ndarray) -> PlantState:
        """Return the state at rest at actuated positions ``q`` (n,); raises GtauError if they cannot be reached."""
        c, still = self.model.path(np.array(q, dtype=float)[:, None])[:, 0], np.zeros(len(q))
        return PlantState(np.array(q, dtype=float), still, c, still, np.zeros(len(self.friction.law.states)))

    def advance(self, state: PlantState, force: np.ndarray, duration: float) -> PlantState:
        """Advance the state by ``duration`` s under constant forces (n,) of the actuated joints, N m or N."""
        c, qd, z, remaining, step = state.c, state.qd, state.z, duration, duration
        actuated = self.layout.actuated
        while remaining > SHORTEST:
            step = min(step, remaining)
            c_next, qd_next, error = self._step(c, qd, force, z, np.array([step]))
            size = np.max(np.abs(error) / (TOLERANCE * (1.0 + np.abs(qd))))
            if size <= 1.0:
                part = self.friction.until_turn(z, qd, qd_next, step)
                if part < 1.0 and part * step > SHORTEST:
                    step *= part
                    continue
                z = self.friction.moved(z, c_next[actuated] - c[actuated])
                c, qd, remaining = c_next, qd_next, remaining - step
            elif step < SHORTEST:
                raise self._lost(c)
            elif not np.isfinite(size):
                size = 1e5
            step *= min(5.0, max(0.1, 0.9 * max(size, 1e-8) ** -0.2))
        c = self._closed(state.c, c)
        return PlantState(c[actuated], qd, c, qd, z)

    def acceleration(self, state: PlantState, force: np.ndarray) -> np.ndarray:
        """Compute accelerations of the actuated joints (n,) in rad/s2 or m/s2."""
        return np.array(self._derivative(state.c, state.qd, force, state.z)[1]).ravel()

    def mass_matrix(self, c: np.ndarray) -> np.ndarray:
        """Compute the mass matrix seen by the actuated joints (n, n)."""
        return np.array(self._inertia(c, np.zeros(len(self.layout.actuated)))[0])

    def _closed(self, c: np.ndarray, moved: np.ndarray) -> np.ndarray:
        """Move from closed ``c`` (n_c,) to the closed configuration near ``moved`` in the same assembly mode."""
        if self.model.loops is None:
            return moved
        closed, reached = follow(self.model.loops, c[:, None], moved[self.layout.actuated, None])
        if not reached[0] or np.abs(closed[:, 0] - moved).max() > APART:
            raise self._lost(c)
        return closed[:, 0]

    def _along_loops(self, c: ca.MX, qd: ca.MX) -> tuple[Any, Any, Any]:
        """Express yd, ydd for zero qdd, and the passive rows of J (eqs. 5 to 8)."""
        n = len(self.layout.actuated)
        if self.model.loops is None:
            return qd, ca.MX.zeros(n), ca.MX(0, n)
        layout = self.layout
        passive, actuated = layout.passive.tolist(), layout.actuated.tolist()
        pose = ca.SX.sym("c", layout.n_c)
        speeds = ca.SX.sym("yd", layout.n_y)
        rates = ca.SX.sym("qd", n)
        _, velocity, gamma = closure_expressions(layout, pose, speeds)
        G = ca.jacobian(velocity, speeds)
        J, _ = solve(G[:, passive], -G[:, actuated], refine=False)
        yd, ydd = ca.SX(layout.n_y, 1), ca.SX(layout.n_y, 1)
        yd[actuated], yd[passive] = rates, J @ rates
        ydd[passive], _ = solve(G[:, passive], -ca.substitute(gamma, speeds, yd), refine=False)
        moved, drift, columns = ca.Function("loops", [pose, rates], [yd, ydd, J], {"cse": True})(c, qd)
        return moved, drift, columns

    @cached_property
    def _inertia(self) -> ca.Function:
        """Compile (c, qd) to the mass matrix, torques at zero qdd without friction and offsets, yd, and passive J."""
        (pose, speeds, pushes, passive), columns = self.model.symbols
        names = [name for name in self.model.parameter_names if name.kind not in PLAIN_FRICTION]
        chi = {name: ca.SX(self.chi[name]) for name in names}
        forces = torques(self.layout, pose, speeds, pushes, columns, chi)
        mass = ca.jacobian(forces, pushes) @ columns
        dynamics = ca.Function("dynamics", [pose, speeds, pushes, passive.T], [mass, forces], {"cse": True})
        c, qd = ca.MX.sym("c", self.layout.n_c), ca.MX.sym("qd", len(self.layout.actuated))
        yd, drift, J = self._along_loops(c, qd)
        return ca.Function("inertia", [c, qd], [*dynamics(c, yd, drift, J), yd, J])

    @cached_property
    def _derivative(self) -> ca.Function:
        """Compile (c, qd, force, z) to c' and qdd."""
        layout, n, s = self.layout, len(self.layout.actuated), len(self.friction.law.states)
        (pose, speeds, _, passive), columns = self.model.symbols
        rates = ca.Function("rates", [pose, speeds], [configuration_rates(layout, pose, speeds)])
        push, states = ca.SX.sym("force", n), ca.SX.sym("z", s)
        rest = ca.densify(self.friction.effort(speeds, columns, push, states))
        effort = ca.Function("effort", [speeds, passive.T, push, states], [rest], {"cse": True})
        sizes = {"c": layout.n_c, "qd": n, "force": n, "z": s}
        c, qd, force, z = (ca.MX.sym(name, size) for name, size in sizes.items())
        M, tau, yd, J = self._inertia(c, qd)
        qdd = ca.solve(M, effort(yd, J, force, z) - tau, "qr")
        return ca.Function("derivative", [c, qd, force, z], [rates(c, yd), qdd])

    def _compiled_step(self) -> Compiled:
        """Compile (c, qd, force, z, h) to c and qd after h s, and the error of qd."""
        layout, n, reach = self.layout, len(self.layout.actuated), self.friction.reach
        sizes = {"c": layout.n_c, "qd": n, "force": n, "z": len(reach), "h": 1}
        c, qd, force, z, h = symbols = [ca.MX.sym(name, size) for name, size in sizes.items()]
        actuated = layout.actuated.tolist()

        def slope(x: ca.MX) -> Any:
            moved = z
            if len(reach):
                moved = ca.fmin(ca.fmax(z + ca.DM(reach) @ (x[actuated] - c[actuated]), -1.0), 1.0)
            return ca.vertcat(*self._derivative(x[: layout.n_c], x[layout.n_c :], force, moved))

        x = ca.vertcat(c, qd)
        slopes: list[Any] = [slope(x)]
        for weights in STAGES:
            x = ca.vertcat(c, qd) + h * ca.horzcat(*slopes) @ ca.DM(weights)
            slopes.append(slope(x))
        error = h * ca.horzcat(*(slope[layout.n_c :] for slope in slopes)) @ ca.DM(ERROR)
        return Compiled(ca.Function("step", symbols, [x[: layout.n_c], x[layout.n_c :], error]))

    def _lost(self, c: np.ndarray) -> GtauError:
        pose = pose_words(self.model.robot, c[self.layout.actuated])
        return GtauError(
            f"robot '{self.model.robot.name}': the simulated motion cannot be continued at {pose}, a singular pose "
            "or a motion without bounds; check the masses and frictions, the controller, and that the trajectory stays "
            "within the workspace."
        )


class Compiled:
    """A CasADi function called through buffers, in a third of the time of a plain call."""

    def __init__(self, function: ca.Function):
        self._function = function
        self._buffer, self._evaluate = function.buffer()

    def __call__(self, *arguments: np.ndarray) -> list[np.ndarray]:
        """Return the outputs as flat arrays."""
        inputs = [np.ascontiguousarray(argument, dtype=float) for argument in arguments]
        results = [np.empty(self._function.numel_out(k)) for k in range(self._function.n_out())]
        for k, argument in enumerate(inputs):
            self._buffer.set_arg(k, memoryview(argument))  # type: ignore[arg-type, call-arg]
        for k, result in enumerate(results):
            self._buffer.set_res(k, memoryview(result))  # type: ignore[arg-type, call-arg]
        self._evaluate()
        return results

"""The inverse dynamic identification model of a robot, evaluated for many samples (eqs. 15 and 16)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, wraps
from inspect import signature
from typing import Any, ParamSpec

import casadi as ca
import numpy as np

from gtau.documents.validation import TEXT, takes
from gtau.errors import GtauError, UnknownName, meant, spelled
from gtau.model.equations import parameter_names, torques, wrench_torques
from gtau.model.kinematics import Coordinates
from gtau.model.loops import Labels, Loops, Motion, close_loops, differentiate, displaced, follow, numbers
from gtau.model.program import NONE, Program, compile_program, share
from gtau.robots.parameter import Parameter
from gtau.robots.placement import WRENCH, WrenchFrame
from gtau.robots.robot import Robot

P = ParamSpec("P")
PATH = 65536  # samples whose loops are closed together, in parallel segments
BLOCK = 2048  # samples computed together: enough to amortise Python, few enough for the cache


@dataclass(frozen=True, eq=False)
class Regressor:
    """Columns of ``IDM_st``: entry k, structurally non-zero, is in row ``rows[k]`` (joint) and column ``columns[k]``.

    ``matrix`` (n, columns) is an expression in ``inputs``: c, yd, ydd and the passive rows of J; and in ``parameters``.
    """

    names: tuple[str, ...]
    inputs: list[ca.SX]
    matrix: ca.SX
    parameters: tuple[ca.SX, ...] = ()

    @cached_property
    def rows(self) -> np.ndarray:
        """Row (actuated joint) of each entry."""
        return np.array(self.matrix.sparsity().get_triplet()[0], dtype=int)

    @cached_property
    def columns(self) -> np.ndarray:
        """Column of each entry."""
        return np.array(self.matrix.sparsity().get_triplet()[1], dtype=int)

    @cached_property
    def program(self) -> Program:
        """Program that maps the inputs of a sample to its entries."""
        return compile_program(self.inputs, [self.matrix.nz[:]], self.parameters)

    @cached_property
    def summed(self) -> Program:
        """Program that maps the inputs to torques; every entry is used as soon as it is computed."""
        chi = ca.SX.sym("chi", len(self.names))
        return compile_program(self.inputs, [self.matrix @ chi], [chi])

    def __call__(self, layout: Coordinates, motion: Motion, parameters: np.ndarray = NONE) -> np.ndarray:
        """Compute the entries (entries, N) for the samples of ``motion``, and ``parameters`` of the program."""
        return self.program(*self.sources(layout, motion), parameters=parameters)

    def torques(self, entries: np.ndarray, chi: np.ndarray, n: int) -> np.ndarray:
        """Compute torques (n, N) from the ``entries`` (entries, N) and values ``chi`` of the columns."""
        along = np.zeros((n, len(entries)))
        along[self.rows, range(len(entries))] = np.asarray(chi)[self.columns]
        return along @ entries

    def torques_along(self, layout: Coordinates, motion: Motion, chi: np.ndarray) -> np.ndarray:
        """Compute torques (n, N) along ``motion`` without storing the entries."""
        return self.summed(*self.sources(layout, motion), parameters=np.asarray(chi, dtype=float))

    def fill(self, layout: Coordinates, motion: Motion, W: np.ndarray) -> None:
        """Put the entries into ``W`` (N, n, columns), whose other entries are zero."""
        self.program.fill(W.reshape(len(W), -1), *self._places, *self.sources(layout, motion))

    @cached_property
    def _places(self) -> tuple[np.ndarray, np.ndarray]:
        """Order of the entries in the memory of a sample, and their places there."""
        places = self.rows * len(self.names) + self.columns
        order = np.argsort(places)
        return order, places[order]

    def sources(self, layout: Coordinates, motion: Motion) -> tuple[np.ndarray, ...]:
        """Return the inputs of the program along ``motion``."""
        passive = motion.J[layout.passive].reshape(layout.passive.size * len(layout.actuated), motion.c.shape[1])
        return motion.c, motion.yd, motion.ydd, passive


def one_or_many(compute: Callable[P, np.ndarray]) -> Callable[P, np.ndarray]:
    """Let a function of ``q``, ``qd``, ``qdd``, (N, n) each, take one state (n,) too, and return its only row."""
    parameters = signature(compute)
    states = [name for name in ("q", "qd", "qdd") if name in parameters.parameters]

    @wraps(compute)
    def computed(*args: P.args, **kwargs: P.kwargs) -> np.ndarray:
        given = parameters.bind(*args, **kwargs)
        if one := np.ndim(given.arguments["q"]) == 1:
            given.arguments.update({name: np.asarray(given.arguments[name])[None] for name in states})
        rows = compute(*given.args, **given.kwargs)
        return rows[0] if one else rows

    return computed


@spelled(
    **dict.fromkeys(("rnea", "rne", "gravity", "gravload"), "idm.torques(q, qd, qdd, parameters)"),
    computeJointTorqueRegressor="idm.regressor(q, qd, qdd)",
)
class InverseDynamics:
    """``tau_idm = IDM_st(q, qd, qdd) chi_st`` of a serial, tree or parallel robot.

    Parameters
    ----------
    robot : Robot
        From :func:`gtau.load_robot`.
    parameters : {"all", "inertial"}
        ``"all"``: 14 standard parameters a joint (inertia, rotor, friction, offset); ``"inertial"``:
        the ten inertial ones alone. A platform always has ten.

    Attributes
    ----------
    robot : Robot
        The robot.
    layout : Coordinates
        The virtual tree's coordinates c (configuration) and y (velocities), and which of them are actuated or passive.
    parameter_names : tuple of str
        Names of the n_st standard parameters, the order of the regressor's columns.
    actuated : tuple of str
        Names of the n actuated joints, the order of the regressor's rows.

    Examples
    --------
    >>> model = gtau.InverseDynamics(gtau.load_robot("five-bar"))
    >>> model.regressor([2.1, 1.0], [0.0, 0.0], [0.0, 0.0]).shape
    (2, 56)
    """

    @takes(robot=("gtau.load_robot(...)", (Robot,)), parameters=TEXT)
    def __init__(self, robot: Robot, parameters: str = "all"):
        if parameters not in ("all", "inertial"):
            raise GtauError(f"parameters is {parameters!r}; write 'all' or 'inertial'.")
        self.robot = robot
        self.layout = Coordinates(robot)
        self.parameter_names = parameter_names(robot, parameters)
        self.actuated = robot.actuated
        self._kind = parameters
        self._regressors: dict[tuple[object, ...], Regressor] = {}

    def __reduce__(self) -> tuple[type[InverseDynamics], tuple[Robot, str]]:
        """Pickle the arguments of the model: compiled programs hold CasADi symbols, which cannot be pickled."""
        return InverseDynamics, (self.robot, self._kind)

    def __repr__(self) -> str:
        return f"InverseDynamics({self.robot!r}, {len(self.parameter_names)} standard parameters)"

    @cached_property
    def loops(self) -> Loops | None:
        """The solved closures; None for a robot without closures and couplings whose joints are all actuated."""
        layout = self.layout
        return close_loops(self.robot) if self.robot.closures or self.robot.couplings or layout.passive.size else None

    @property
    def home(self) -> np.ndarray:
        """Home configuration (n_c,), with the loops closed."""
        return self.layout.home if self.loops is None else self.loops.home

    def altered(self, **changes: Any) -> InverseDynamics:
        """Return the model of the same robot with another gravity or tool; its loops are not solved again."""
        other = InverseDynamics(replace(self.robot, **changes), self._kind)
        other.__dict__["loops"] = self.loops  # of the cached property
        return other

    def motion(
        self,
        q: np.ndarray,
        qd: np.ndarray,
        qdd: np.ndarray,
        labels: Labels | None = None,
        start: np.ndarray | None = None,
    ) -> Motion:
        """Compute the whole tree's motion along a path (n, N) that begins at the closed ``start`` (n_c,), or home."""
        return self.rates(self.path(q, labels, start), qd, qdd, labels)

    def path(self, q: np.ndarray, labels: Labels | None = None, start: np.ndarray | None = None) -> np.ndarray:
        """Compute the configurations (n_c, N) of :meth:`motion`."""
        return q if self.loops is None else follow(self.loops, q, labels, start)

    def near(self, c: np.ndarray, q: np.ndarray, labels: Labels) -> np.ndarray:
        """Compute the configurations (n_c, N) at positions ``q`` (n, N) that are close to ``c``, sample by sample."""
        return q if self.loops is None else displaced(self.loops, c, q, labels)

    def rates(self, c: np.ndarray, qd: np.ndarray, qdd: np.ndarray, labels: Labels | None = None) -> Motion:
        """Compute the state of the whole virtual tree at configurations ``c`` (n_c, N) from :meth:`path`."""
        if self.loops is None:
            n, samples = qd.shape
            return Motion(c, qd, qdd, np.broadcast_to(np.eye(n)[:, :, None], (n, n, samples)), np.ones(samples))
        return differentiate(self.loops, c, qd, qdd, labels)

    def columns(self, names: Sequence[Parameter]) -> Regressor:
        """Return the regressor of the standard parameters ``names``."""
        names = tuple(names)
        if names not in self._regressors:
            inputs, regressor = self._symbolic
            W = regressor[:, [self.parameter_names.index(name) for name in names]]
            self._regressors[names] = Regressor(names, inputs, W)
        return self._regressors[names]

    def wrenches(self, frames: Sequence[WrenchFrame]) -> Regressor:
        """Return the columns (n, 6 k) by which moments and forces on k bodies give torques ``J^T w``, eq. (14)."""
        key = "wrenches", *frames
        if key not in self._regressors:
            inputs, J = self.symbols
            wrench = ca.SX.sym("w", 6 * len(frames))
            matrix = ca.jacobian(wrench_torques(self.layout, inputs[0], J, frames, wrench), wrench)
            names = tuple(Parameter(kind, frame.body) for frame in frames for kind in WRENCH)
            self._regressors[key] = Regressor(names, inputs, matrix)
        return self._regressors[key]

    @cached_property
    def symbols(self) -> tuple[list[ca.SX], ca.SX]:
        """Symbols of c, yd, ydd and the passive rows of J, and J (n_y, n) itself."""
        layout, n = self.layout, len(self.actuated)
        c, yd, ydd = (ca.SX.sym(s, k) for s, k in (("c", layout.n_c), ("yd", layout.n_y), ("ydd", layout.n_y)))
        passive = ca.SX.sym("J", len(layout.passive), n)
        J = ca.SX(layout.n_y, n)
        J[layout.actuated.tolist(), :] = ca.SX.eye(n)
        J[layout.passive.tolist(), :] = passive
        return [c, yd, ydd, passive.T], J

    @cached_property
    def _symbolic(self) -> tuple[list[ca.SX], ca.SX]:
        """Inputs, and the regressor (n, n_st)."""
        inputs, J = self.symbols
        chi = {name: ca.SX.sym(name) for name in self.parameter_names}
        c, yd, ydd, _ = inputs
        return inputs, ca.jacobian(torques(self.layout, c, yd, ydd, J, chi), ca.vertcat(*chi.values()))

    def gravity_torques(self, names: Sequence[Parameter]) -> Regressor:
        """Return a regressor of gravity along the base axes, whose program takes values of ``names``, others zero."""
        key = "gravity", *names
        if key in self._regressors:
            return self._regressors[key]
        inputs, J = self.symbols
        still = ca.SX(self.layout.n_y, 1)
        gravity = ca.SX.sym("g", 3)
        values = ca.SX.sym("chi", len(names))
        chi = dict.fromkeys(self.parameter_names, ca.SX(1, 1)) | dict(zip(names, ca.vertsplit(values), strict=True))
        tau = torques(self.layout, inputs[0], still, still, J, chi, gravity)
        self._regressors[key] = Regressor(("x", "y", "z"), inputs, ca.jacobian(tau, gravity), (values,))
        return self._regressors[key]

    @property
    def full(self) -> Regressor:
        """Regressor of all standard parameters."""
        return self.columns(self.parameter_names)

    @one_or_many
    def regressor(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        """Compute the regressor ``IDM_st`` of eq. (15), (N, n, n_st).

        Parameters
        ----------
        q, qd, qdd : ndarray
            Positions, velocities and accelerations of the actuated joints, (N, n), or (n,) of one state, SI
            units. The samples are taken as points of a path that starts at home.

        Raises
        ------
        GtauError
            The loops cannot be closed, or a pose is too close to a singularity.
        """
        W = np.zeros((len(q), len(self.actuated), len(self.parameter_names)))
        full = self.full
        _ = full.program  # compiled before threads need it
        self._for_blocks(q, qd, qdd, lambda block, motion: full.fill(self.layout, motion, W[block]))
        return W

    @one_or_many
    def torques(
        self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, chi: Mapping[str, float] | np.ndarray
    ) -> np.ndarray:
        """Compute the torques of the actuated joints, tau_idm of eq. (16), (N, n) in N m or N.

        ``chi``, the standard parameters, is a vector (n_st,) or a mapping by name; missing ones are zero.
        """
        vector, tau, full = self._vector(chi), np.zeros((len(q), len(self.actuated))), self.full
        _ = full.summed

        def work(block: slice, motion: Motion) -> None:
            tau[block] = full.torques_along(self.layout, motion, vector).T

        self._for_blocks(q, qd, qdd, work)
        return tau

    def _for_blocks(
        self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, work: Callable[[slice, Motion], None]
    ) -> None:
        """Work on the blocks of a path and their motion in threads; a block stays in the processor's cache."""
        q, qd, qdd = self.samples(q, qd, qdd)
        c = np.empty((0, 0))
        for start in range(0, q.shape[1], PATH):
            chunk = slice(start, start + PATH)
            c = self.path(q[:, chunk], numbers(start), c[:, -1] if start else None)
            states = c, qd[:, chunk], qdd[:, chunk]

            def stretch(first: int, last: int, start: int = start, states: Sequence[np.ndarray] = states) -> None:
                for begin in range(first, last, BLOCK):
                    end = min(begin + BLOCK, last)
                    # blocks are copied, as fresh memory for whole paths would cost more than the copies
                    now, speed, push = (np.ascontiguousarray(samples[:, begin:end]) for samples in states)
                    motion = self.rates(now, speed, push, numbers(start + begin))
                    work(slice(start + begin, start + end), motion)

            share(stretch, c.shape[1])

    def samples(self, *arrays: np.ndarray) -> list[np.ndarray]:
        """Check arrays (N, n), one column per actuated joint, and return them as (n, N); raises GtauError."""
        n, joints = len(self.actuated), list(self.actuated)
        try:  # a table's columns are taken by their names
            tables = (array[joints] if hasattr(array, "columns") else array for array in arrays)
            samples = [np.asarray(array, dtype=float) for array in tables]
        except Exception as error:
            names = ", ".join(joints)
            raise GtauError(f"q, qd or qdd is no array of numbers, or a table without columns {names}.") from error
        if samples[0].ndim != 2 or samples[0].shape[1] != n or len({array.shape for array in samples}) > 1:
            shapes = ", ".join(str(array.shape) for array in samples)
            raise GtauError(
                f"q, qd and qdd have the shapes {shapes}; give each as (N, {n}), a column for each of the joints "
                f"{', '.join(self.actuated)}."
            )
        if broken := next((at for array in samples for at in np.argwhere(~np.isfinite(array)).tolist()), None):
            sample, joint = broken
            raise GtauError(f"a value of '{joints[joint]}' is not finite at sample {sample}; leave such samples out.")
        return [array.T for array in samples]

    def _vector(self, chi: Mapping[str, float] | np.ndarray) -> np.ndarray:
        names = self.parameter_names
        if not isinstance(chi, Mapping):
            vector = np.asarray(chi, dtype=float)
            if vector.shape != (len(names),):
                raise GtauError(
                    f"chi has the shape {vector.shape}; give a vector of {len(names)} entries, one for each of "
                    "parameter_names, or a mapping by name."
                )
            return vector
        if unknown := next((name for name in chi if name not in names), None):
            hint = meant(unknown, names, "parameter_names lists them.")
            raise UnknownName(f"the model of '{self.robot.name}' has no standard parameter '{unknown}'; {hint}")
        return np.array([chi.get(name, 0.0) for name in names], dtype=float)

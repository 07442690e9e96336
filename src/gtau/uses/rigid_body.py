"""Terms of an identified model without friction and damping: ``M(q) qdd + C(q, qd) qd + g(q)``."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gtau.estimation.results.result import IdentifiedModel
from gtau.model.inverse_dynamics import one_or_many
from gtau.robots.robot import DAMPING, PLAIN_FRICTION
from gtau.signals.reading.statements import Payload
from gtau.uses.prediction import loaded_parameters

Torques = Callable[[np.ndarray, np.ndarray], np.ndarray]


def _torques_at(result: IdentifiedModel, q: np.ndarray, payload: Payload | None) -> tuple[Torques, np.ndarray]:
    """Return the function from ``qd`` and ``qdd`` (n, N) to torques (n, N) at ``q`` (N, n), and the torques at rest."""
    model, standard = result.idm, result.base.standard
    lossy = [name.kind in (*PLAIN_FRICTION, DAMPING) for name in standard]
    chi = np.where(lossy, 0.0, loaded_parameters(result, payload, "the robot"))
    (positions,) = model.samples(q)
    c, columns = model.path(positions), model.columns(standard)

    def torques(qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
        return columns.torques_along(model.layout, model.rates(c, qd, qdd), chi)

    still = np.zeros_like(positions)
    return torques, torques(still, still)


@one_or_many
def gravity(result: IdentifiedModel, q: np.ndarray, payload: Payload | None) -> np.ndarray:
    """Compute the torques of gravity and springs; see :meth:`gtau.Result.gravity`."""
    return _torques_at(result, q, payload)[1].T


@one_or_many
def inertia(result: IdentifiedModel, q: np.ndarray, payload: Payload | None) -> np.ndarray:
    """Compute the inertia matrix; see :meth:`gtau.Result.inertia`."""
    torques, rest = _torques_at(result, q, payload)
    still = np.zeros_like(rest)
    columns = [torques(still, still + unit) - rest for unit in np.eye(len(rest))[:, :, None]]
    return np.stack(columns, axis=1).transpose(2, 0, 1)


@one_or_many
def coriolis(result: IdentifiedModel, q: np.ndarray, qd: np.ndarray, payload: Payload | None) -> np.ndarray:
    """Compute the Coriolis matrix of Christoffel's symbols; see :meth:`gtau.Result.coriolis`.

    Coriolis torques are a quadratic form ``h(qd)`` whose symmetric matrices hold the symbols, so column j of the matrix
    is ``(h(qd + e_j) - h(qd) - h(e_j)) / 2``.
    """
    torques, rest = _torques_at(result, q, payload)
    still = np.zeros_like(rest)
    (speeds,) = result.idm.samples(qd)

    def h(speeds: np.ndarray) -> np.ndarray:
        return torques(speeds, still) - rest

    columns = [(h(speeds + unit) - h(speeds) - h(still + unit)) / 2 for unit in np.eye(len(rest))[:, :, None]]
    return np.stack(columns, axis=1).transpose(2, 0, 1)

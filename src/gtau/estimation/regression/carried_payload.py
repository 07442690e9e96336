"""The payload of a run: what is known of it, and which combinations of the rest act on the motors (eq. 18)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gtau.model.base_parameters import BaseParameters, independent_columns
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.robots.robot import INERTIAL
from gtau.signals.payload import Payload


@dataclass(frozen=True, eq=False)
class CarriedPayload:
    """The payload of one run.

    ``unknown`` maps the name in the problem of each unknown parameter that acts on some actuated joint
    to its kind, and ``regroupings`` the kind to the formula of what it stands for: ``sums`` (unknown, free)
    of the kinds ``free`` that are not known. In base columns, a unit of each is ``unknown_columns``
    (n_b, unknown), and all that is known together ``known_column`` (n_b,).
    """

    run: int
    payload: Payload
    unknown: Mapping[str, str]
    regroupings: Mapping[str, str]
    free: tuple[str, ...]
    sums: np.ndarray
    unknown_columns: np.ndarray
    known_column: np.ndarray


def known_values(payload: Payload) -> dict[str, float]:
    """Return the known inertial parameters of a payload, by kind; empty for an unknown payload."""
    mass = {} if payload.mass is None else {"m": payload.mass}
    return {**mass, **payload.parameters}


def carried_payload(idm: InverseDynamics, base: BaseParameters, run: int, payload: Payload) -> CarriedPayload:
    """Express the parameters of a ``payload`` on the robot's tool in base columns."""
    column = {name: k for k, name in enumerate(idm.parameter_names)}
    values = known_values(payload)
    free = [kind for kind in INERTIAL if kind not in values]
    columns = base.matrix[:, [column[f"{kind}_{idm.robot.tool}"] for kind in free]]
    kept, coefficients, _ = independent_columns(columns)
    known = base.matrix[:, [column[f"{kind}_{idm.robot.tool}"] for kind in values]] @ np.array(list(values.values()))
    formulas = {
        free[k]: " + ".join(
            f"{coefficients[row, other]:.5g} {kind}" if other != k else kind
            for other, kind in enumerate(free)
            if coefficients[row, other]
        )
        for row, k in enumerate(kept)
    }
    unknown = {f"{free[k]}_L{run + 1}": free[k] for k in kept}
    return CarriedPayload(run, payload, unknown, formulas, tuple(free), coefficients, columns[:, kept], known)

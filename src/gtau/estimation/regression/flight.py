"""Robots in flight, on whose floating base nothing measured acts: their mass alone gives the scale."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.regression.equations import SIGNAL
from gtau.estimation.regression.factors import Factors
from gtau.model.base_parameters import BaseParameters
from gtau.model.inverse_dynamics import InverseDynamics
from gtau.signals.experiment import Prior

EXACT = 1e-6  # relative standard deviation of what counts as exact: of 1e6 rows without signal it stands against all


def with_exact_mass(
    idm: InverseDynamics, base: BaseParameters, factors: Sequence[Factors], priors: Mapping[str, Prior]
) -> Mapping[str, Prior]:
    """Take the mass of a robot for exact where nothing acts on its floating base in any run.

    The base equations are homogeneous then: parameters that all are too small leave less of the noise in the motion.
    Against that a mass stated to a per mil would not stand; how much it may be wrong is part of
    :func:`gtau.estimation.estimators.scale_uncertainty.scale_uncertainty`.

    Raises
    ------
    GtauError
        The mass is not among the ``priors``.
    """
    rows = [idm.actuated.index(joint) for joint in idm.robot.base]
    if not rows or any(factor.R[:, rows, :, SIGNAL].any() for factor in factors):
        return priors
    name = whole_mass(base, idm.parameter_names)
    prior = priors.get(name)
    if prior is None or not prior.value:
        raise GtauError(
            f"nothing that is measured acts on the base '{idm.robot.floating}' in any run, so that its equations give "
            "ratios of parameters alone, which noise of its motion biases towards zero; log the wrench that holds it "
            "in some runs ('wrenches' of 'base' under 'signals')"
            + (f", or weigh the robot (priors: {{{name}: {{value: ..., std: ...}}}}, kg)." if name else ".")
        )
    return {**priors, name: prior.model_copy(update={"std": EXACT * abs(prior.value)})}


def whole_mass(base: BaseParameters, standard: Sequence[str]) -> str:
    """Return the name of the base parameter that is the mass (kg) of all bodies of a floating robot, or an empty one.

    ``standard`` are the names of the standard parameters, the columns of ``base.matrix``.
    """
    masses = np.array([name.startswith("m_") for name in standard], dtype=float)
    found = (name for name, row in zip(base.names, base.matrix, strict=True) if np.allclose(row, masses, atol=1e-6))
    return next(found, "")

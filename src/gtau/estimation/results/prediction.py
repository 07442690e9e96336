"""Torques along a run, predicted by an identified model."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gtau.errors import GtauError
from gtau.estimation.regression.dataset import at_rate_of
from gtau.estimation.regression.friction import TERMS, transmitted
from gtau.estimation.regression.rows import stream_rows
from gtau.estimation.regression.system import known_values
from gtau.estimation.results.estimate import Estimate, Prediction, TorqueError
from gtau.estimation.results.identified_model import IdentifiedModel
from gtau.robots.units import torque_unit
from gtau.signals.preparation import prepare
from gtau.signals.run import Run, arrange


def predict(result: IdentifiedModel, run: Run) -> Prediction:
    """Predicted and measured torques at the decimated instants of a run; see :meth:`IdentifiedModel.predict`."""
    model, base = result.model, result.base
    run = arrange(run, model.actuated)
    if run.kind != result.kind:
        raise GtauError(
            f"run '{run.name}' holds {run.kind}s, but the model was identified from {result.kind}s; give a run of the "
            "same kind."
        )
    preparation = at_rate_of([run], result.preparation)
    prepared = prepare(run, preparation)
    decimator = preparation.decimator
    missing = [name for name in base.names if name not in result.parameters]
    if missing:
        raise GtauError(f"the model lacks the base parameter '{missing[0]}'; identify it again.")
    chi = np.array([result.params[name] for name in base.names])
    if run.payload is not None:
        tool = {name: k for k, name in enumerate(model.parameter_names)}
        identified = result.payload(run.payload.name)
        if run.payload.mass is None and "m" not in identified:
            raise GtauError(
                f"run '{run.name}' carries the payload '{run.payload.name}', whose mass neither the run nor the model "
                "knows; add its 'mass'."
            )
        for kind, value in {**identified, **known_values(run.payload)}.items():
            chi = chi + value * base.matrix[:, tool[f"{kind}_{result.robot.tool}"]]
    regressor = model.columns(base.standard)
    gains = np.array([result.drive_gains[joint].value for joint in model.actuated])
    delays = np.array([result.delays[joint].value for joint in model.actuated])
    time, predicted, measured, keep, valid = [], [], [], [], []
    load = chi * transmitted(base.names)
    terms = np.array([[_value(result.friction, f"{term}_{joint}") for joint in model.actuated] for term in TERMS])
    for part in stream_rows(model, regressor, prepared, decimator, load):
        tau = regressor.torques(part.entries, chi, len(model.actuated)) + np.einsum("tj,tjk->jk", terms, part.terms)
        v, v_d, v_dd = part.currents
        time.append(part.time)
        predicted.append(tau.T)
        measured.append((gains[:, None] * (v - delays[:, None] * v_d + delays[:, None] ** 2 / 2 * v_dd)).T)
        keep.append(part.keep.T)
        # the samples that the decimation filter sees: ``keep`` of those that are valid, slow or not
        first = decimator.factor * part.outputs.start
        last = decimator.factor * (part.outputs.stop - 1) + 2 * decimator.support
        valid.append(decimator.keep(prepared.valid(first, last + 1)))
    if not np.any([each.any() for each in keep]):
        raise GtauError(f"run '{run.name}' has no usable rows, away from its reversals and gaps; give a longer run.")
    return Prediction(model.actuated, *(np.concatenate(each) for each in (time, predicted, measured, keep, valid)))


def _value(estimates: Mapping[str, Estimate], name: str) -> float:
    return (estimates[name].value or 0.0) if name in estimates else 0.0


def torque_errors(result: IdentifiedModel, prediction: Prediction) -> tuple[TorqueError, ...]:
    """Rms of error and signal of each joint that moves: over the kept rows, and over all valid ones."""

    def rms(values: np.ndarray) -> float:
        return float(np.sqrt(np.mean(values**2)))

    errors = []
    difference = prediction.measured - prediction.predicted
    for j, joint in enumerate(prediction.joints):
        kept, valid = prediction.keep[:, j], prediction.valid[:, j]
        if kept.any():
            used, every = ((rms(difference[rows, j]), rms(prediction.measured[rows, j])) for rows in (kept, valid))
            errors.append(TorqueError(joint, *used, torque_unit(result.robot, joint), *every))
    return tuple(errors)

"""Torques along a run, predicted by an identified model at the highest bandwidth that position noise allows.

The position filter of each joint is chosen for this on the runs of the identification.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gtau.errors import GtauError, quoted, spelled
from gtau.estimation.diagnostics.descriptions import proportions, times_of
from gtau.estimation.diagnostics.verdict import contradiction
from gtau.estimation.friction.law import transmitted
from gtau.estimation.regression.assembly import known_values
from gtau.estimation.regression.plausibility import check_wrenches, motor_to_joint_speed, within_limits
from gtau.estimation.regression.rows import Law, stream_torques
from gtau.estimation.results.conclusions import headline, loses_gains
from gtau.estimation.results.estimate import BandError, TorqueError
from gtau.estimation.results.result import IdentifiedModel
from gtau.findings import Finding, Grade
from gtau.model.inverse_dynamics import one_or_many
from gtau.model.loops import Motion
from gtau.robots.parameter import SHAPES, TEMPERATURE_TERMS, Parameter, torque_unit
from gtau.robots.robot import Robot
from gtau.signals.preparation.bandwidth import widened
from gtau.signals.preparation.filters import Decimator
from gtau.signals.preparation.prepared_run import PreparedRun, prepare
from gtau.signals.reading.drafting import alternatives, drafted_name
from gtau.signals.reading.formats import reading
from gtau.signals.reading.statements import Payload, masses_in_name
from gtau.signals.run import Run, read_run, taper
from gtau.signals.storage import spans

if TYPE_CHECKING:
    import polars as pl


OTHER_UNIT = 5.0  # factor of what is predicted, or the inverse, from which a unit is wrong; an undeclared load made 2


@spelled(plot="gtau.plot(prediction)")
@dataclass(frozen=True)
class Prediction:
    """Torques at every sample of a run: ``time`` (N,) in s, ``predicted`` and ``measured`` (N, n) in the ``units``.

    ``friction`` (N, n) is the part of what is predicted that friction and offsets take. Measured torques are raw.
    Predicted torques are at the instants of the commands, and behind no low-pass but the one of the positions, up to
    where their noise takes over; :attr:`in_band` has both behind the low-pass of identification, ``decimator``, and
    :attr:`rows` one sample in its factor. ``keep`` (N, n) is False near a joint's reversals and rests, which
    identification of gains and inertia leaves out, and near gaps; ``valid`` (N, n) is False near gaps and repaired
    samples, and at the ends of the log up to where the motion begins. ``notes`` say what is assumed of the payload.
    """

    joints: tuple[str, ...]
    units: tuple[str, ...]
    time: np.ndarray
    predicted: np.ndarray
    measured: np.ndarray
    keep: np.ndarray
    valid: np.ndarray
    friction: np.ndarray
    decimator: Decimator
    notes: tuple[Finding, ...] = ()

    @property
    def in_band(self) -> Prediction:
        """Predicted and measured torques behind the low-pass of identification, as its residuals are."""
        smoothed: dict[str, Any] = {
            name: self.decimator.smooth(getattr(self, name).T, 0, len(self.time)).T
            for name in ("predicted", "measured", "friction")
        }
        return replace(self, **smoothed, decimator=Decimator(1))

    @property
    def rows(self) -> Prediction:
        """The rows of identification, whose residuals are as independent as its low-pass lets them be."""
        factor = self.decimator.factor
        return self.in_band.part(slice(factor // 2, None, factor))

    def part(self, samples: slice | np.ndarray) -> Prediction:
        """Take some of the samples."""
        return replace(self, **{name: getattr(self, name)[samples] for name in ("time", *OF_JOINTS)})

    def of(self, joints: Sequence[str]) -> Prediction:
        """Take some of the joints."""
        chosen = [self.joints.index(joint) for joint in joints]
        units = tuple(self.units[j] for j in chosen)
        parts = {name: getattr(self, name)[:, chosen] for name in OF_JOINTS}
        return replace(self, joints=tuple(joints), units=units, **parts)

    def __repr__(self) -> str:
        span = f"{self.time[0]:.4g} to {self.time[-1]:.4g} s{''.join(f'; {note.what}' for note in self.notes)}"
        return f"Prediction({len(self.time)} samples of joints {', '.join(self.joints)}, {span})"

    def to_frame(self) -> pl.DataFrame:
        """Return the torques as a Polars table, one row per sample.

        Columns: ``t`` (s); for each joint ``motor_J`` (drive gain times current), ``model_J`` (what the motion takes),
        ``external_J`` (the torque that the environment exerts on the joint, model minus motor; N m or N), ``usable_J``
        (``keep``) and ``valid_J``.
        """
        import polars as pl

        parts = {"motor": self.measured, "model": self.predicted, "external": self.predicted - self.measured}
        parts |= {"usable": self.keep, "valid": self.valid}
        columns = ((f"{name}_{joint}", j, part) for j, joint in enumerate(self.joints) for name, part in parts.items())
        return pl.DataFrame({"t": self.time} | {name: part[:, j] for name, j, part in columns})


def torque_errors(prediction: Prediction, robot: Robot, bandwidth: float) -> tuple[TorqueError, ...]:
    """Compute rms of error and signal of joints that move: behind the low-pass, raw, and by octaves (Hz)."""
    errors = []
    behind = prediction.in_band
    for j, joint in enumerate(prediction.joints):
        kept, valid = prediction.keep[:, j], prediction.valid[:, j]
        if not kept.any() or not prediction.measured[:, j].any():  # nothing may act on a base in some direction
            continue
        smooth, raw = (
            np.stack([torques.measured[:, j] - torques.predicted[:, j], torques.measured[:, j]])
            for torques in (behind, prediction)
        )
        (rms, signal), (rms_all, signal_all), (rms_raw, signal_raw) = (
            np.sqrt(np.mean(pair[:, rows] ** 2, axis=1)).tolist()
            for pair, rows in ((smooth, kept), (smooth, valid), (raw, valid))
        )
        bands = _bands(prediction.time, raw, valid, bandwidth)
        unit = prediction.units[j]
        errors.append(TorqueError(joint, rms, signal, unit, rms_all, signal_all, rms_raw, signal_raw, bands))
    return tuple(errors)


def other_unit(prediction: Prediction, kind: str) -> Finding | None:
    """Find the joints whose currents or torques are reversed or in another unit, by what the model predicts.

    Friction must be otherwise too, as a payload may reverse the rest of a balanced joint.
    """
    valid = prediction.valid.all(axis=1)
    friction, predicted, measured = (
        torques[valid].T for torques in (prediction.friction, prediction.predicted, prediction.measured)
    )
    other = dict[str, float]()
    for j, (joint, factor) in enumerate(zip(prediction.joints, proportions(predicted, measured), strict=True)):
        parts = np.column_stack([friction[j], predicted[j] - friction[j]])
        factors = np.linalg.lstsq(parts, measured[j], rcond=None)[0]
        unlike = (factors < 0) | (np.abs(np.log(np.abs(factors) + 1e-300)) > np.log(OTHER_UNIT))
        if unlike.all() and np.isfinite(factor):
            other[joint] = factor
    if not other:
        return None
    advice = f"check the signs and the unit of these columns ('units: {{{kind}: ...}}')"
    text = f"{kind}s of {times_of(other)} what the model predicts"
    return contradiction("other unit", (), text, advice, shown_as="unit")


def _bands(time: np.ndarray, raw: np.ndarray, valid: np.ndarray, bandwidth: float) -> tuple[BandError, ...]:
    """Compute rms of error and signal (2, N) in octaves from the ``bandwidth`` (Hz) of the motion to Nyquist."""
    rate = (len(time) - 1) / float(time[-1] - time[0])
    window = taper(len(time)) * valid
    frequency = np.fft.rfftfreq(len(time), 1 / rate)
    power = []
    for values in raw:
        mean = values[valid].mean()  # apart, as its sidelobes would reach far
        density = 2 * np.abs(np.fft.rfft(window * (values - mean))) ** 2 / (len(time) * (window**2).sum())
        density[0] = mean**2
        power.append(np.concatenate([[0.0], np.cumsum(density)]))
    octave = 2.0 ** np.ceil(np.log2(bandwidth))
    octaves = octave * 2.0 ** np.arange(max(np.ceil(np.log2(0.5 * rate / octave)), 0))
    edges = np.array([0.0, *octaves, 0.5 * rate])
    at = np.searchsorted(frequency, edges)
    at[-1] = len(frequency)
    rms = np.sqrt(np.diff(np.array(power)[:, at], axis=1))
    return tuple(BandError(*values) for values in np.column_stack([edges[:-1], edges[1:], *rms]).tolist())


OF_JOINTS = ("predicted", "measured", "friction", "keep", "valid")


def known_names(result: IdentifiedModel) -> dict[str, str]:
    """List the payloads of a model by the names that drafts make of masses, where one has such a mass."""
    names = {name: drafted_name(values.get("m", 0.0)) for name, values in result.payload_values.items()}
    return {made: name for name, made in names.items() if name != made and [*names.values()].count(made) == 1}


def payload_in_name(result: IdentifiedModel, log: str | Path) -> Payload | None:
    """Read the payload of a log from its name, as a draft does, by the model's name if it has one; raises GtauError."""
    mass, *others = masses_in_name(Path(log).name) or (0.0,)
    if others:
        raise GtauError(
            f"the name of {log} may mean a payload of {alternatives((mass, *others))} kg; give a run with it: "
            "gtau.read_run(log, result.recording.signals, {'name': ..., 'mass': ...})."
        )
    name = drafted_name(mass)
    return Payload(name=known_names(result).get(name, name), mass=mass) if mass > 0 else None


def doubts(result: IdentifiedModel) -> list[str]:
    """Repeat the verdict on a model with gains, or anything else, that are contradictory or not identifiable."""
    return [headline(result)] if loses_gains(result) or not result.believable else []


def suited(result: IdentifiedModel, run: Run | str | Path) -> Run:
    """Order the columns of a run, or of a log like the model's, as its joints; raises GtauError."""
    if isinstance(run, (str, Path)) and result.recording is not None:
        run = read_run(run, result.recording.signals, payload_in_name(result, run), result.recording.units)
    if not isinstance(run, Run):
        raise GtauError(
            f"this takes a run, not a {type(run).__name__}; read the log with gtau.read_run(log, signals), with "
            "result.recording.signals if its columns are as in the model's logs."
        )
    run = run.ordered(result.idm.actuated)
    if run.kind != result.kind:
        raise GtauError(
            f"run '{run.name}' holds {run.kind}s, but the model was identified from {result.kind}s; give a run of the "
            "same kind."
        )
    return run


def prepared_for(result: IdentifiedModel, run: Run | str | Path) -> tuple[PreparedRun, range]:
    """Prepare all samples of a run as for identification, and mark those in which the robot moves."""
    run = suited(result, run)
    check_wrenches(result.robot, run)
    prepared = prepare(run, result.preparation.at(run.rate), motor_to_joint_speed(result.idm))
    prepared = within_limits(result.robot, prepared, may_rest=True)
    return replace(prepared, kept=range(len(run.time))), prepared.kept


def predict(result: IdentifiedModel, run: Run | str | Path, external: np.ndarray | None = None) -> Prediction:
    """Predict torques at every sample of a run, with the measured ones; see :meth:`gtau.Result.predict`.

    ``external`` (N, n) are torques of the environment on the joints, N m or N, which load their friction.
    """
    prepared, moving = prepared_for(result, run)
    notes = tuple(_assumed(result, prepared.run, named=not isinstance(run, Run)))
    run, decimator, time = prepared.run, prepared.preparation.decimator, np.asarray(prepared.time)
    chi = loaded_parameters(result, run.payload, f"run '{run.name}'")
    check_temperature_unit(result, run)
    # each joint's position is filtered only as much as its noise requires
    cutoffs, noise = prepared.preparation.prediction_cutoffs, prepared.preparation.position_noise
    wide = replace(prepared, cutoffs=widened(run, cutoffs, noise)) if cutoffs else prepared
    made, friction_torque, measured = joint_torques(result, wide, chi, external)
    n = len(made)
    keep = np.concatenate([prepared.samples(*span).usable[:, :n] for span in spans(len(prepared))])
    valid = np.concatenate([prepared.valid(*span)[:, :n] for span in spans(len(prepared))])
    # at rest before and after the motion any torque within the band of friction holds the robot
    resting = np.ones((len(valid), 1), dtype=bool)
    resting[moving.start : moving.stop] = False
    keep, valid = (decimator.near(mask & ~resting) for mask in (keep, valid))
    if not keep.any():
        raise GtauError(f"run '{run.name}' has no usable rows, away from its reversals and gaps; give a longer run.")
    joints = result.idm.actuated
    units = tuple(torque_unit(result.robot, joint) for joint in joints)
    return Prediction(joints, units, time, made.T, measured.T, keep, valid, friction_torque.T, decimator, notes)


def _assumed(result: IdentifiedModel, run: Run, named: bool) -> Iterator[Finding]:
    """Note a payload ``named`` by its log alone, and one of which model and run know only the mass."""
    payload = run.payload
    if payload is None or payload.mass is None:
        return
    if named:
        text = f"payload '{payload.name}' of {payload.mass:.4g} kg is assumed, from the name of {run.name}"
        yield reading("payload by name", text=text, advice="give a run of gtau.read_run for another")
    if not (payload.parameters or result.payload_values.get(payload.name)):
        known = ", ".join(map(quoted, result.payload_values)) or "it has none"
        text = (
            f"payload '{payload.name}' is not a payload of the model ({known}), so it is treated as a point mass of "
            f"{payload.mass:.4g} kg at the origin of '{result.robot.tool}'"
        )
        yield reading("payload unknown to the model", text=text, advice="correct the name, or give its 'parameters'")


def joint_torques(
    result: IdentifiedModel, prepared: PreparedRun, chi: np.ndarray, external: np.ndarray | None = None
) -> np.ndarray:
    """Compute torques (3, n, N) of a run's samples: predicted, the part of friction and offsets, and measured.

    Predicted torques are at the times of the currents: that at ``t - delay`` belongs to the torque at ``t`` (eq. 17).
    """
    model = result.idm
    standard = result.base.standard
    time = np.asarray(prepared.time)
    load = np.array(transmitted(np, standard, chi))
    friction = friction_along(result, prepared, chi, external)
    torques = np.concatenate([*stream_torques(model, model.columns(standard), prepared, load, friction)], axis=2)
    for torque in torques[:2]:
        for row, joint in zip(torque, model.actuated, strict=True):
            delay = result.delays[joint]
            if delay.value and delay.verdict.outcome != Grade.NOT_IDENTIFIABLE:
                row[:] = np.interp(time + delay.value, time, row)
    torques[2] *= result.gains[:, None]
    return torques


def friction_along(
    result: IdentifiedModel, prepared: PreparedRun, chi: np.ndarray, external: np.ndarray | None = None
) -> Law:
    """Make the friction law of a run, with its temperatures and presliding, for base parameters ``chi`` (n_b,)."""
    law, run = result.friction_law, prepared.run
    states = law.followers(prepared.path)

    def friction(at: np.ndarray, motion: Motion, effort: np.ndarray) -> np.ndarray:
        if external is not None:
            effort = effort - external[np.searchsorted(prepared.time, at)].T
        return law.torques(motion, friction_values(result, chi, run, at), effort, states(at))

    return friction


def check_temperature_unit(result: IdentifiedModel, run: Run) -> None:
    """Check that the temperatures of a run are in the model's unit; raises GtauError."""
    known, logged = result.temperatures, run.side.get("temperature")
    if known and logged and logged.unit != known.unit:
        raise GtauError(
            f"the temperatures of run '{run.name}' are in {logged.unit}, but the model has {known.unit}; give the same "
            "unit."
        )


def friction_values(
    result: IdentifiedModel, chi: np.ndarray, run: Run | None = None, time: np.ndarray | None = None
) -> dict[str, Any]:
    """Collect friction by name for base parameters ``chi`` (n_b,), at a run's temperatures at ``time`` (N,)."""
    values: dict[str, Any] = dict(zip(result.base.standard, chi, strict=True))
    terms = {name: term.value or 0.0 for name, term in result.friction.items() if name.kind not in SHAPES}
    values |= {name: value for name, value in terms.items() if name.kind not in TEMPERATURE_TERMS}
    warm = run.side.get("temperature") if run else None
    if result.temperatures is None or warm is None or time is None:
        return values
    for name, slope in terms.items():
        joint = result.friction_law.motor_of(name.body)
        if name.kind in TEMPERATURE_TERMS and joint is not None and joint in warm.by_joint:
            above = warm.at(joint, time) - result.temperatures.of_joint[joint]
            values[Parameter(TEMPERATURE_TERMS[name.kind], name.body)] += slope * above
    return values


def torques_along(
    result: IdentifiedModel,
    motion: Motion,
    chi: np.ndarray,
    terms: Mapping[Parameter, float] | None = None,
    z: np.ndarray | None = None,
) -> np.ndarray:
    """Compute torques (n, N) for base parameters ``chi`` (n_b,), friction ``terms`` and states ``z`` (s, N)."""
    model, standard = result.idm, result.base.standard
    values = np.array(transmitted(np, standard, chi))
    load = model.columns(standard).torques_along(model.layout, motion, values)
    return load + result.friction_law.torques(motion, friction_values(result, chi) | dict(terms or {}), load, z)


@one_or_many
def torques(
    result: IdentifiedModel, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, payload: Payload | None
) -> np.ndarray:
    """Compute torques (N, n), or (n,), of the identified model at any states; see :meth:`gtau.Result.torques`."""
    model = result.idm
    chi = loaded_parameters(result, payload, "the robot")
    q, qd, qdd = model.samples(q, qd, qdd)
    return torques_along(result, model.motion(q, qd, qdd), chi).T


def require_all_parameters(result: IdentifiedModel) -> None:
    """Refuse a model that lacks a base parameter; raises GtauError."""
    if missing := [name for name in result.base.names if name not in result.parameters]:
        raise GtauError(f"the model lacks the base parameter '{missing[0]}'; identify it again.")


def loaded_parameters(result: IdentifiedModel, payload: Payload | None, carrier: str) -> np.ndarray:
    """Add a ``payload`` to base parameters (n_b,); raises GtauError if its mass is unknown."""
    require_all_parameters(result)
    chi = np.array([result.parameters[name].value or 0.0 for name in result.base.names])
    if payload is None:
        return chi
    identified = result.payload_values.get(payload.name, {})
    if payload.mass is None and "m" not in identified:
        raise GtauError(
            f"{carrier} carries the payload '{payload.name}', whose mass neither the run nor the model knows; add its "
            "'mass'."
        )
    return chi + on_tool(result, {**identified, **known_values(payload)})


def on_tool(result: IdentifiedModel, payload: Mapping[str, float]) -> np.ndarray:
    """Compute the change (n_b,) of the base parameters by inertial parameters of a payload, by kind."""
    columns = [result.idm.parameter_names.index(Parameter(kind, result.robot.tool)) for kind in payload]
    return np.asarray(result.base.matrix[:, columns] @ list(payload.values()))

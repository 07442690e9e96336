"""Compare a result with the requirements of the experiment file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from gtau.errors import GtauError
from gtau.estimation.results.estimate import Requirement, TorqueError
from gtau.estimation.results.identified_model import IdentifiedModel
from gtau.estimation.results.prediction import predict, torque_errors
from gtau.signals.run import Run
from gtau.signals.settings import Requirements


def judge(result: IdentifiedModel, require: Requirements, validation: Sequence[Run]) -> tuple[Requirement, ...]:
    """Compare a result with its requirements, its torque errors also on the runs kept for ``validation``."""
    return tuple(_judged(result, require, validation))


def _judged(result: IdentifiedModel, require: Requirements, validation: Sequence[Run]) -> Iterator[Requirement]:
    if require.torque_error is not None:
        yield _of_torques(require.torque_error, result.residuals)
        for run in validation:
            try:
                errors = torque_errors(result, predict(result, run))
            except GtauError:
                errors = ()
            yield _of_torques(require.torque_error, errors, run.name)
    if require.gain_interval is not None:
        widths = {joint: gain.half_width for joint, gain in result.drive_gains.items()}
        unknown = [joint for joint, width in widths.items() if width is None]
        joint = unknown[0] if unknown else max(widths, key=lambda name: widths[name] or 0.0)
        yield Requirement("gain_interval", require.gain_interval, widths[joint], joint)


def _of_torques(limit: float, errors: Iterable[TorqueError], run: str = "") -> Requirement:
    worst = max(errors, key=lambda each: each.relative, default=None)
    if worst is None:
        return Requirement("torque_error", limit, None, run=run)
    return Requirement("torque_error", limit, worst.relative, worst.joint, run)

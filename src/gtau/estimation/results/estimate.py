"""Estimates with units, standard deviations and verdicts, and the other parts of a result."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from numbers import Integral
from operator import ge, gt, le, lt
from typing import Any, Generic, Literal, TypeVar

import numpy as np

from gtau.errors import GtauError, OtherSpelling, UnknownName
from gtau.estimation.diagnostics.verdict import GOOD
from gtau.findings import Finding, to_width
from gtau.model.singularities import TYPES
from gtau.robots.parameter import Parameter
from gtau.signals.channel import SENSOR, ChannelKind
from gtau.signals.preparation.filters import Decimator
from gtau.signals.preparation.prepared_run import PreparedRun
from gtau.signals.storage import rows_at


def _by_value(compare: Callable[[float, float], bool]) -> Callable[[Estimate, Any], bool]:
    return lambda self, other: compare(float(self), float(other))


@dataclass(frozen=True, repr=False)
class Estimate:
    """A number with its unit and standard deviation; in arithmetic and comparisons its value alone, as ``float`` gives.

    ``value`` is None where it is not identifiable, ``std`` None where the value is known. ``between_run_std`` is the
    standard deviation between runs of a parameter that may drift; its value is then the mean. ``verdict``
    says whether to believe it. ``freedom`` are the degrees of freedom behind ``std``, None for very many.
    ``model_std`` is the part of ``std`` that comes from what the model may lack; the rest is random. ``essential``
    says whether the reduction (paper, section 5.2) keeps a base parameter; None for other estimates. Of the 95 %
    interval, ``half_interval()`` is half in ``unit``, ``half_width`` half in per cent of the value.
    """

    name: str
    value: float | None
    std: float | None
    unit: str
    regrouping: str = ""
    between_run_std: float | None = None
    verdict: Finding = GOOD
    freedom: float | None = None
    model_std: float | None = None
    essential: bool | None = None

    def __str__(self) -> str:
        if self.value is None:
            return "not identifiable"
        half = self.half_interval()
        shown = f"{to_width(self.value, half)} +- {to_width(half, half)}" if half else f"{self.value:.5g}"
        return shown if self.unit == "1" else f"{shown} {self.unit}"

    def __float__(self) -> float:
        if self.value is None:
            raise GtauError(f"'{self.name}' is not identifiable, so it has no value: {self.verdict.why}.")
        return self.value

    __array_ufunc__ = None  # an array times an estimate is __rmul__

    def __mul__(self, factor: Any) -> Any:
        return float(self) * factor

    __rmul__ = __mul__

    def __truediv__(self, divisor: Any) -> Any:
        return float(self) / divisor

    def __rtruediv__(self, dividend: Any) -> Any:
        return dividend / float(self)

    def __round__(self, digits: int | None = None) -> float:
        return round(float(self), digits)

    __lt__, __le__, __gt__, __ge__ = map(_by_value, (lt, le, gt, ge))

    def __format__(self, spec: str) -> str:
        return format(float(self), spec) if spec else str(self)

    def __repr__(self) -> str:
        return f"Estimate({self.name!r}: {self}, {self.verdict.outcome.value})"

    def half_interval(self, level: float = 0.95) -> float | None:
        """Compute half the width of the confidence interval by Student's t, in ``unit``; None without value or std.

        Raises
        ------
        GtauError
            Where the ``level`` is not between 0 and 1.
        """
        if not 0 < level < 1:
            raise GtauError(f"the level {level:g} is not between 0 and 1; write 0.95 for 95 %.")
        if self.value is None or self.std is None:
            return None
        from scipy.special import ndtri, stdtrit

        tail = (1 + level) / 2
        return self.std * float(ndtri(tail) if self.freedom is None else stdtrit(self.freedom, tail))

    def interval(self, level: float = 0.95) -> tuple[float, float] | None:
        """Compute the ends of the confidence interval; see :meth:`half_interval`."""
        half = self.half_interval(level)
        return None if half is None or self.value is None else (self.value - half, self.value + half)

    @property
    def half_width(self) -> float | None:
        """Half the width of the 95 % interval, per cent of the value."""
        half = self.half_interval()
        return None if half is None or not self.value else 100 * half / abs(self.value)

    @property
    def regroups(self) -> str:
        """Sum of parameters that a base parameter stands for; empty where it is one parameter."""
        return self.regrouping if self.regrouping != self.name else ""

    @property
    def random_std(self) -> float | None:
        """The random part of ``std``."""
        if self.std is None or self.model_std is None:
            return self.std
        return float(np.sqrt(max(self.std**2 - self.model_std**2, 0.0)))

    @property
    def rel_std(self) -> float | None:
        """Relative standard deviation, per cent."""
        return 100 * self.std / abs(self.value) if self.value and self.std is not None else None


Key = TypeVar("Key", bound=str)


class Named(dict[Key, Estimate], Generic[Key]):
    """Estimates by joint or parameter; ``[11]`` finds joint ``'11'``, a missing name raises GtauError with all."""

    def __missing__(self, name: object) -> Estimate:
        if isinstance(name, Integral) and str(name) in self:
            return self[str(name)]  # type: ignore[index]
        raise UnknownName(f"there is no '{name}' here; choose from {', '.join(self) or 'nothing'}.")

    def __getattr__(self, name: str) -> Any:
        if name in self:
            raise OtherSpelling(f"names are written in brackets; did you mean [{name!r}]?")
        if name.startswith("_"):
            return object.__getattribute__(self, name)
        raise OtherSpelling(f"there is no '{name}' here; choose from {', '.join(self) or 'nothing'}.")


@dataclass(frozen=True)
class SensorEstimate:
    """The sensor of a joint, behind its drive: its offset and friction by name, its delay (s), and its residual.

    The residual is the error of its torque, N m or N, over the rows used. ``ratio`` is the torque from the other stated
    constants over the sensor reading, to first order; None where nothing else gives a scale. ``kind`` is the kind of
    its channel.
    """

    joint: str
    parameters: Mapping[Parameter, Estimate]
    delay: Estimate
    residual: TorqueError
    ratio: Estimate | None = None
    kind: ChannelKind = SENSOR

    @property
    def source(self) -> str:
        """Its name as a source of the scale."""
        return f"{self.kind.name} of '{self.joint}'"

    @property
    def verdict(self) -> Finding:
        """Verdict on its agreement with the other stated constants."""
        return GOOD if self.ratio is None else self.ratio.verdict


@dataclass(frozen=True)
class BandError:
    """Rms of a torque error and of the raw torque between the frequencies ``low`` and ``high`` (Hz), N m or N."""

    low: float
    high: float
    rms: float
    signal: float


@dataclass(frozen=True, repr=False)
class TorqueError:
    """Torque error of a joint: rms of the error and of the signal ``v g_tau``, N m or N.

    ``rms`` and ``signal`` are taken over the rows that identification uses, away from the joint's reversals, where the
    plain law does not hold; ``rms_all`` and ``signal_all`` over all valid rows, reversals included, with the friction
    of all samples. The latter are None for the residuals of a fit without it. All four are behind the low-pass of
    identification. ``rms_raw`` and ``signal_raw`` are the same of the raw torque over all valid samples, and ``bands``
    by frequency; residuals of a fit have none.
    """

    joint: str
    rms: float
    signal: float
    unit: str
    rms_all: float | None = None
    signal_all: float | None = None
    rms_raw: float | None = None
    signal_raw: float | None = None
    bands: tuple[BandError, ...] = ()

    def __repr__(self) -> str:
        raw = "" if self.relative_raw is None else f", raw {self.relative_raw:.3g} %"
        return f"TorqueError({self.joint!r}: {self.relative:.3g} % of {self.signal:.3g} {self.unit}{raw})"

    @property
    def relative(self) -> float:
        """Error over signal away from reversals, per cent."""
        return 100 * self.rms / self.signal

    @property
    def relative_all(self) -> float | None:
        """Error over signal of all valid rows, reversals included, per cent."""
        return None if self.rms_all is None or not self.signal_all else 100 * self.rms_all / self.signal_all

    @property
    def relative_raw(self) -> float | None:
        """Error over signal of the raw torque at all valid samples, per cent."""
        return None if self.rms_raw is None or not self.signal_raw else 100 * self.rms_raw / self.signal_raw


@dataclass(frozen=True)
class Requirement:
    """A limit that the experiment file sets, per cent, and the value ``found``; None if not available.

    A torque error is the largest of all joints, over the rows used, or on the ``run`` kept for validation that is
    named; a gain's interval is half the widest of 95 %.
    """

    name: Literal["torque_error", "gain_interval"]
    limit: float
    found: float | None
    joint: str = ""
    run: str = ""

    @property
    def met(self) -> bool:
        """Whether the value found is within the limit."""
        return self.found is not None and self.found <= self.limit


@dataclass(frozen=True)
class NearestPose:
    """Nearest pose (rad or m) to a singularity of ``type`` 1 or 2: distance, and time (s) since the start."""

    run: str
    type: Literal[1, 2]
    distance: float
    time: float
    pose: Mapping[str, float]


def distances_along(prepared: PreparedRun, decimator: Decimator, values: np.ndarray) -> np.ndarray:
    """Make a table (K,) of the distances ``values`` (K, 2): ``time``, ``type_1`` and ``type_2``."""
    types = [f"type_{kind}" for kind in TYPES]
    table = np.empty(len(values), [("time", float), *((kind, np.float32) for kind in types)])
    table["time"] = rows_at(prepared.time, decimator.instants(len(prepared)))
    for kind, column in zip(types, values.T, strict=True):
        table[kind] = column
    return table


def nearest_poses(prepared: PreparedRun, decimator: Decimator, values: np.ndarray) -> Iterator[NearestPose]:
    """Find the pose of a run nearest to singularities of each type that the robot can have."""
    instants = decimator.instants(len(prepared.time))
    for kind, distances in zip(TYPES, values.T, strict=True):
        if distances.size and not np.isnan(distances).all():
            k = int(np.nanargmin(distances))
            at = int(instants[k])
            pose = dict(zip(prepared.run.joints, prepared.samples(at, at + 1).q[0].tolist(), strict=True))
            since_start = float(prepared.time[at] - prepared.run.time[0])
            yield NearestPose(prepared.run.name, kind, float(distances[k]), since_start, pose)

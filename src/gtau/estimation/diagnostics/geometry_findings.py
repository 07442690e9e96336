"""Findings of logged poses on a robot's geometry, as data, note and document."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from gtau.findings import Finding
from gtau.findings import FindingKind as F

CORRECT = {True: "correct the robot file", False: "correct the positions by the encoder's zero"}


@dataclass(frozen=True)
class ConstantChange:
    """A constant of the geometry: the ``change`` of its ``value`` that explains the poses best, in ``unit``.

    ``std`` is the standard deviation of the change, ``share`` that of the residual variance which goes with it;
    ``alike`` are constants that explain as much.
    """

    name: str
    value: float
    change: float
    std: float
    unit: str
    share: float
    alike: tuple[str, ...] = ()

    def __str__(self) -> str:
        """Describe the change: ``Rm 326 -> 300.00 mm (standard deviation 0.01)``."""
        unit, factor = ("mm", 1e3) if self.unit == "m" else ("mrad", 1e3)
        digits = max(0, min(6, 1 - int(np.floor(np.log10(max(factor * self.std, 1e-6))))))
        new, std = f"{factor * (self.value + self.change):.{digits}f}", f"{factor * self.std:.{digits}f}"
        either = f" (or {', '.join(self.alike)})" if self.alike else ""
        return f"{self.name} {factor * self.value:.5g} -> {new} {unit} (standard deviation {std}){either}"


@dataclass(frozen=True, eq=False)
class PoseResidual:
    """A component of the pose in a run, logged less computed: rms and mean (``bias``) in ``unit``.

    ``rms_after`` is what the constants of :attr:`GeometryTest.explained_by` leave. ``model.json`` does not hold the
    residuals ``before`` and ``after`` at the instants ``time`` (K,) in s.
    """

    run: str
    name: str
    unit: str
    rms: float
    bias: float
    rms_after: float
    time: np.ndarray = field(default_factory=lambda: np.zeros(0))
    before: np.ndarray = field(default_factory=lambda: np.zeros(0))
    after: np.ndarray = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True, eq=False)
class GeometryTest:
    """Test of a robot's geometry against logged poses.

    Attributes
    ----------
    body, source : str
        Whose pose, and from where; see :class:`gtau.signals.reading.body_columns.PoseColumns`.
    outcome : {"confirmed", "other constants", "unexplained"}
        The last where residuals too large for the robot are left, whatever constants change.
    distances : mapping
        Of what is logged of ``position`` and ``angle``, the rms distance between logged and computed poses, m and rad,
        and what ``explained_by`` leaves of it.
    explained_by : tuple of ConstantChange
        Constants that together explain the residuals, if any do.
    share : float
        Of the residual variance that goes with them.
    tried : tuple of ConstantChange
        Each constant by itself, the best first.
    unseen : tuple of str
        Constants of which the poses say nothing, as the frames would explain the same or the closures hold them.
    delay : tuple of float
        By how much poses lag behind the positions, and its standard deviation, s.
    residuals : tuple of PoseResidual
        Component by component and run by run.
    """

    body: str
    source: str
    outcome: str
    distances: Mapping[str, tuple[float, float]]
    explained_by: tuple[ConstantChange, ...]
    share: float
    tried: tuple[ConstantChange, ...]
    unseen: tuple[str, ...]
    delay: tuple[float, float]
    residuals: tuple[PoseResidual, ...]

    @property
    def note(self) -> Finding:
        """Outcome as a note."""
        units = {"position": "mm", "angle": "mrad"}
        sizes = [[f"{1e3 * size:.2g} {units[kind]}" for size in both] for kind, both in self.distances.items()]
        before, after = (" and ".join(part) for part in zip(*sizes, strict=True))
        kinds = {"confirmed": F.CONFIRMED_GEOMETRY, "unexplained": F.UNEXPLAINED_POSE}
        values = {
            "before": before,
            "after": after,
            "changes": list(map(str, self.explained_by)),
            "count": len(self.explained_by),
            "share": percent(self.share),
            "correct": list(dict.fromkeys(CORRECT[bool(constant.value)] for constant in self.explained_by)),
        }
        return Finding(kinds.get(self.outcome, F.GEOMETRY), (), self.body, values)


def to_document(test: GeometryTest) -> dict[str, Any]:
    """Describe the test as a JSON document, SI units, without the residuals in time."""
    document = asdict(test) | {"traces": [], "sentence": str(test.note)}
    distances = document.pop("distances")
    for kind in ("position", "angle"):
        document[f"{kind}_rms"], document[f"{kind}_after"] = distances.get(kind, (None, None))
    document["delay"], document["delay_std"] = test.delay
    for residual in document["residuals"]:
        for name in ("time", "before", "after"):
            del residual[name]
    return document


def from_document(document: Any) -> Any:
    """Give a JSON document of a test the fields of the test."""
    if not isinstance(document, dict):
        return document
    kinds = [kind for kind in ("position", "angle") if document.get(f"{kind}_rms") is not None]
    distances = {kind: (document[f"{kind}_rms"], document.get(f"{kind}_after")) for kind in kinds}
    return document | {"distances": distances, "delay": (document.get("delay"), document.get("delay_std"))}


def percent(share: float, digits: int = 3) -> str:
    """Format a share in per cent without rounding it to 100."""
    return f"{100 * max(share, 0.0):.{digits}g} %" if share < 0.999 else f"{100 * min(share, 0.99999):.3f} %"

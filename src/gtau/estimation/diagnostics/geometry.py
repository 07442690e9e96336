"""What logged poses say of a robot's geometry: the constants that explain a mismatch, in words and as a document."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from gtau.findings import Finding, Grade

CORRECT = {True: "correct the robot file", False: "correct the positions by the encoder's zero"}


@dataclass(frozen=True)
class ConstantChange:
    """A constant of the geometry: the ``change`` of its ``value`` that explains the poses best, in ``unit``.

    ``std`` is the standard deviation of the change, and ``share`` the share of the residual variance that it explains;
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
        value, new, std = 1e3 * self.value, 1e3 * (self.value + self.change), 1e3 * self.std
        digits = np.clip(1 - int(np.floor(np.log10(max(std, 1e-6)))), 0, 6)
        either = f" (or {', '.join(self.alike)})" if self.alike else ""
        described = f"{self.name} {value:.5g} -> {new:.{digits}f} m{self.unit}"
        return f"{described} (standard deviation {std:.{digits}f}){either}"


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

    Of a ``body``, by a ``source``: see :class:`gtau.signals.reading.body_columns.PoseColumns`. The outcome is
    ``confirmed``, ``other constants``, or ``unexplained`` where residuals too large for the robot are left, whatever
    constants change. ``distances`` are, of what is logged of ``position`` and ``angle``, the rms distance between
    logged and computed poses, m and rad, and what ``explained_by`` leaves of it: constants that together explain a
    ``share`` of the residual variance. ``tried`` is each constant by itself, the best first; of those ``unseen`` the
    poses say nothing, as the frames would explain the same or the closures hold them. Poses lag by ``delay`` behind the
    positions, s, with a standard deviation.
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
        """Grade as a note."""
        sizes = [
            [f"{1e3 * size:.2g} {'mm' if kind == 'position' else 'mrad'}" for size in both]
            for kind, both in self.distances.items()
        ]
        before, after = map(" and ".join, zip(*sizes, strict=True))
        pose = f"the logged pose of '{self.body}'"
        changes = " and ".join(map(str, self.explained_by))
        if self.outcome == "confirmed":
            text = f"{pose} confirms the robot's geometry to {before} rms"
            shown_as = "robot description"
            return Finding(
                "confirmed geometry", subject=self.body, text=text, grade=Grade.INFORMATION, shown_as=shown_as
            )
        if self.outcome == "unexplained":
            more = f"; {changes} would explain {percent(self.share)} of its variance" if changes else ""
            text = (
                f"{pose} is {before} rms from the one computed from the positions, which lengths and encoder zeros do "
                f"not explain{more}"
            )
            advice = (
                "check its columns, units and sequence of angles, whether it is of this body (source: tool) and in the "
                "robot's base (source: tracker), and the angles of the robot's geometry"
            )
            return Finding("unexplained pose", subject=self.body, text=text, advice=advice, shown_as="geometry")
        several = len(self.explained_by) > 1
        text = (
            f"the geometry is off: {changes} {'explain' if several else 'explains'} {percent(self.share)} of the "
            f"residual variance of {pose}, which is {before} rms from the one computed, and {after} with "
            f"{'these changes' if several else 'that change'}"
        )
        advice = " and ".join(dict.fromkeys(CORRECT[bool(constant.value)] for constant in self.explained_by))
        return Finding("geometry", subject=self.body, text=text, advice=advice)


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
    kinds = [kind for kind in ("position", "angle") if document.get(f"{kind}_rms") is not None]
    distances = {kind: (document[f"{kind}_rms"], document.get(f"{kind}_after")) for kind in kinds}
    return document | {"distances": distances, "delay": (document.get("delay"), document.get("delay_std"))}


def percent(share: float, digits: int = 3) -> str:
    """Format a share in per cent without rounding it to 100."""
    return f"{100 * max(share, 0.0):.{digits}g} %" if share < 0.999 else f"{100 * min(share, 0.99999):.3f} %"

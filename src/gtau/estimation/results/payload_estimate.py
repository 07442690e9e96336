"""Estimates of a payload: its parameters, and its mass properties in the frame that a controller needs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from gtau import display
from gtau.documents.validation import PATH, takes
from gtau.errors import GtauError
from gtau.estimation.diagnostics.verdict import GOOD, Verdict
from gtau.estimation.results.estimate import Estimate
from gtau.estimation.results.payload_body import PayloadBody, Weighed, payload_body
from gtau.robots.readers.frames import frame_on
from gtau.robots.robot import Pose


@dataclass(frozen=True, repr=False)
class PayloadEstimate:
    """Inertial parameters of the payload of a run, by kind, in the frame of the body that carries it.

    ``weighed`` is what :meth:`in_frame` needs, None where the mass is known or the estimate was read from a file.
    """

    name: str
    run: str
    parameters: Mapping[str, Estimate]
    known: frozenset[str]
    verdict: Verdict = GOOD
    weighed: Weighed | None = field(default=None, compare=False)

    def __repr__(self) -> str:
        return (
            f"PayloadEstimate({self.name!r} of run {self.run!r}: mass {self.parameters.get('m', 'not identifiable')})"
        )

    def _repr_html_(self) -> str:
        html: str = display.views().html(self)
        return html

    @takes(frame=("the name of a link, 'x y z roll pitch yaw', or a pose", (str, Pose)), file=PATH)
    def in_frame(self, frame: str | Pose = "", file: str | Path | None = None) -> PayloadBody:
        """Compute mass, centre of mass and inertia about it, of a physically possible body, with intervals.

        Parameters
        ----------
        frame : str or Pose
            A link of the URDF ``file`` that is fixed to the carrier (``tool0``), or the pose ``"x y z roll pitch yaw"``
            (m, rad) from the carrier's own frame, which it is by default.
        file : path, optional
            The robot's URDF.

        Raises
        ------
        GtauError
            Where there is no such frame, or the payload was not weighed.
        """
        if self.weighed is None:
            raise GtauError(f"payload '{self.name}' was not weighed here; take it from gtau.weigh.")
        called, placement = frame_on(self.weighed.body, frame, file)
        return payload_body(self.name, self.run, self.weighed, called, placement)

"""Settings made by hand in an experiment file: those of the preparation, and requirements on the result."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, FiniteFloat

from gtau.documents.validation import Keys, Positive


class PreparationSettings(Keys):
    """The key ``preparation`` of an experiment file; missing entries are chosen from the logs.

    Attributes
    ----------
    bandwidth : float, optional
        Of the motion, Hz.
    position_filter : float or "none", optional
        Cut-off of the low-pass of the positions, Hz.
    decimation : int, optional
        Samples of the slowest log per row of the regression.
    delay : float
        Lag of the currents (or torques) behind the positions in the logs, s; it is compensated.
    least_speed : float, optional
        Share of a joint's rms speed below which its rows are left out.
    clock : {"stamps", "regular"}, optional
        Whether samples were taken at their time stamps, or at a regular rate and stamped late.
    """

    bandwidth: Positive | None = None
    position_filter: Positive | Literal["none"] | None = None
    decimation: Annotated[int, Field(ge=1, le=1000)] | None = None
    delay: FiniteFloat = 0.0
    least_speed: Annotated[FiniteFloat, Field(ge=0, lt=1)] | None = None
    clock: Literal["stamps", "regular"] | None = None

    @property
    def given(self) -> tuple[str, ...]:
        """Names of the settings made by hand, in the order of the class."""
        return tuple(name for name in type(self).model_fields if name in self.model_fields_set)


CHOSEN = PreparationSettings()


def _per_cent(value: Any) -> Any:
    """Read ``5 %`` as 5; a bare number could be a share."""
    found = re.fullmatch(r"\s*([0-9.eE+-]+)\s*%\s*", value) if isinstance(value, str) else None
    if found is None:
        raise ValueError(f"write per cent, such as '{value} %', if that is what '{value}' means")
    return found[1]


Percent = Annotated[FiniteFloat, Field(gt=0), BeforeValidator(_per_cent)]


class Requirements(Keys):
    """Limits on the result, per cent.

    ``torque_error`` holds for every joint over the rows used, and on each run kept for validation; ``gain_interval``
    for half the 95 % interval of every drive gain.
    """

    torque_error: Percent | None = None
    gain_interval: Percent | None = None

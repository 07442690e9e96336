"""Requirements of the experiment file on the result."""

from __future__ import annotations

import re
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, FiniteFloat

from gtau.documents.validation import Keys


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

"""Groups of keys in the files that people write: the base of their pydantic models."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

Positive = Annotated[FiniteFloat, Field(gt=0)]


class Keys(BaseModel):
    """A group of a file: a key that it does not know is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True)

"""The payload of a run: known, or to be weighed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import (
    Field,
    FiniteFloat,
    field_validator,
    model_validator,
)

from gtau.documents.validation import Keys, Positive, name_problem, validate
from gtau.robots.robot import INERTIAL
from gtau.signals.columns import document_of


class Payload(Keys):
    """A load on the robot's tool; without ``mass`` it is unknown and to be weighed.

    ``mass`` and its standard deviation in kg; ``parameters`` are further known inertial parameters
    (``xx xy xz yy yz zz`` in kg m2, ``mx my mz`` in kg m) in the frame of the body that carries it.
    """

    name: str
    mass: Positive | None = None
    mass_std: Annotated[FiniteFloat, Field(ge=0)] = 0.0
    parameters: dict[str, FiniteFloat] = Field(default_factory=dict)

    @field_validator("name")
    @classmethod
    def _printable(cls, name: str) -> str:
        if problem := name_problem(name):
            raise ValueError(problem)
        return name

    @field_validator("parameters")
    @classmethod
    def _inertial(cls, parameters: dict[str, float]) -> dict[str, float]:
        for name in parameters:
            if name == "m":
                raise ValueError("write the mass as 'mass', not among the parameters")
            if name not in INERTIAL:
                raise ValueError(f"a payload has no parameter '{name}'; choose from {' '.join(INERTIAL[:-1])}")
        return parameters

    @model_validator(mode="after")
    def _deviation_of_a_mass(self) -> Payload:
        if self.mass is None and "mass_std" in self.model_fields_set:
            raise ValueError("'mass_std' stands without 'mass'; add the mass or remove it")
        return self


def as_payload(payload: Payload | Mapping[str, Any] | None) -> Payload | None:
    """Read a payload from a mapping as in the experiment file; raises GtauError."""
    if payload is None or isinstance(payload, Payload):
        return payload
    return validate(Payload, document_of("payload", payload))

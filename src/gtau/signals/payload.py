"""Payload of a run, known or to be estimated."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field, FiniteFloat, field_validator, model_validator

from gtau.documents.validation import Keys, Positive, name_problem, read_group
from gtau.robots.robot import INERTIAL

FIRST_MOMENTS = ("mx", "my", "mz")
PAYLOAD_KINDS = ("m", *FIRST_MOMENTS, *INERTIAL[:6])
"""Kinds in the order in which they are shown: what people ask for first."""


class Payload(Keys):
    """A load on the robot's tool; without ``mass`` it is unknown and will be estimated.

    ``mass`` and its standard deviation in kg; ``parameters`` are further known inertial parameters
    (``xx xy xz yy yz zz`` in kg m2, ``mx my mz`` in kg m) in the frame of the body that carries it; ``center`` is the
    centre of an unknown mass in that frame, m.
    """

    name: str
    mass: Positive | None = None
    mass_std: Annotated[FiniteFloat, Field(ge=0)] = 0.0
    parameters: dict[str, FiniteFloat] = Field(default_factory=dict)
    center: tuple[FiniteFloat, FiniteFloat, FiniteFloat] | None = None

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
            raise ValueError("'mass_std' is given without 'mass'; add the mass or remove it")
        return self

    @model_validator(mode="after")
    def _center_of_an_unknown_mass(self) -> Payload:
        if self.center is None:
            return self
        if twice := [kind for kind in FIRST_MOMENTS if kind in self.parameters]:
            raise ValueError(f"'center' and '{twice[0]}' of the parameters state the same; remove one of them")
        if self.mass is not None:
            moments = ", ".join(f"{k}: {self.mass * c:.6g}" for k, c in zip(FIRST_MOMENTS, self.center, strict=True))
            raise ValueError(f"'center' is for an unknown mass; for a known one write 'parameters: {{{moments}}}'")
        return self


def as_payload(payload: Payload | Mapping[str, Any] | None) -> Payload | None:
    """Read a payload from a mapping as in the experiment file; raises GtauError."""
    return None if payload is None else read_group(Payload, "payload", payload)

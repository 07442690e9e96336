"""Ten inertial parameters of a rigid body as other programs write them: mass, centre of mass, inertia about it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from gtau.robots.parameter import Parameter
from gtau.robots.robot import INERTIAL, Attachment


@dataclass(frozen=True, eq=False)
class RigidBody:
    """Mass in kg, centre of mass (3,) in m, and inertia tensor (3, 3) about it in kg m2, in axes of the same frame."""

    mass: float
    center: np.ndarray
    inertia: np.ndarray

    def seen_from(self, rotation: np.ndarray, position: np.ndarray) -> RigidBody:
        """Express the body in another frame, whose orientation (3, 3) and origin (3,) in this one are given."""
        center = rotation.T @ (self.center - position)
        return RigidBody(self.mass, center, rotation.T @ self.inertia @ rotation)

    @property
    def about_origin(self) -> np.ndarray:
        """Inertia tensor (3, 3) about the frame's origin."""
        c = self.center
        return np.asarray(self.inertia + self.mass * (c @ c * np.eye(3) - np.outer(c, c)))

    @property
    def principal(self) -> tuple[np.ndarray, np.ndarray]:
        """Principal moments (3,), and axes as the columns of a rotation (3, 3)."""
        moments, axes = np.linalg.eigh(self.inertia)
        axes[:, 0] *= np.linalg.det(axes)
        return moments, axes


def rigid_body(chi: Mapping[str, float], body: str) -> RigidBody:
    """Make the body called ``body`` from standard parameters by name; those missing are zero."""
    xx, xy, xz, yy, yz, zz, mx, my, mz, m = (chi.get(Parameter(kind, body), 0.0) for kind in INERTIAL)
    center = np.array([mx, my, mz]) / m if m else np.zeros(3)
    about_origin = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return RigidBody(m, center, about_origin - m * (center @ center * np.eye(3) - np.outer(center, center)))


def inertial_parameters(body: RigidBody) -> dict[str, float]:
    """Compute the ten parameters by kind, at the frame's origin: the inverse of :func:`rigid_body`."""
    values = (*body.about_origin[np.triu_indices(3)], *(body.mass * body.center), body.mass)
    return dict(zip(INERTIAL, map(float, values), strict=True))


def lumped(parts: Iterable[tuple[Attachment, RigidBody]]) -> dict[str, float]:
    """Sum rigid bodies by the body that each is attached to: standard parameters by name, in the order of parts."""
    parameters: dict[str, float] = {}
    for at, part in parts:
        rotation = at.placement.rotation
        for kind, value in inertial_parameters(part.seen_from(rotation.T, -rotation.T @ at.placement.position)).items():
            name = Parameter(kind, at.body)
            parameters[name] = parameters.get(name, 0.0) + value
    return parameters

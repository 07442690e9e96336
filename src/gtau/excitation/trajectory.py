"""Finite Fourier series that begin and end at rest, and quintic moves to their start and back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

SHORTEST_APPROACH = 1.0  # s
GENTLE = 2.0  # duration over the shortest within speed, acceleration and jerk, so that currents stay within theirs
PEAKS = (1.875, 10 / 3**0.5, 60.0)  # largest speed, acceleration and jerk of a quintic move by 1 in 1 s


@dataclass(frozen=True, eq=False)
class FourierSeries:
    """Periodic motion of m coordinates, at rest at the beginning of every period.

    A coordinate is ``center + sum over k of a_k sin(k w t) + b_k cos(k w t)``, with k up to ``harmonics`` and w the
    angular ``base_frequency`` (Hz). Zero speed and acceleration at t = 0 leave ``2 harmonics - 1`` free numbers per
    coordinate. The vector x (size,) holds these numbers, coordinate by coordinate, in units of ``half`` (m,), with
    amplitudes that fall with k. The coordinates are the actuated joints, or with ``in_platform_space`` the coordinates
    of the platform relative to its home.
    """

    center: np.ndarray
    half: np.ndarray
    base_frequency: float
    harmonics: int
    in_platform_space: bool = False

    @property
    def period(self) -> float:
        """Duration of a period, s."""
        return 1.0 / self.base_frequency

    @property
    def free(self) -> int:
        """Free numbers per coordinate: the center, and the coefficients that the two rest conditions leave free."""
        return 2 * self.harmonics - 1

    @property
    def size(self) -> int:
        """Length of x."""
        return len(self.center) * self.free

    def basis(self, time: np.ndarray) -> np.ndarray:
        """Compute the derivatives (4, N, free) of position to jerk by the free numbers of a coordinate, half = 1."""
        k = np.arange(1, self.harmonics + 1)
        omega = 2 * np.pi * self.base_frequency * k
        angle = np.multiply.outer(time, omega)
        # divided by k, every harmonic has the same speed
        sine, cosine = np.sin(angle) / k, np.cos(angle) / k
        parts = [
            np.hstack([sine, cosine]),
            np.hstack([omega * cosine, omega * -sine]),
            np.hstack([-(omega**2) * sine, -(omega**2) * cosine]),
            np.hstack([-(omega**3) * cosine, -(omega**3) * -sine]),
        ]
        # speed at t = 0: sum of a_k = 0; acceleration at t = 0: sum of k b_k = 0
        at_rest = np.zeros((2, 2 * self.harmonics))
        at_rest[0, : self.harmonics] = 1.0
        at_rest[1, self.harmonics :] = k / np.linalg.norm(k)
        null = np.linalg.svd(at_rest)[2][2:].T
        constant = np.zeros((4, len(time), 1))
        constant[0] = 1.0
        return np.concatenate([constant, np.stack(parts) @ null], axis=2)

    def along(self, x: np.ndarray, basis: np.ndarray) -> np.ndarray:
        """Evaluate positions, velocities, accelerations and jerks (4, m, N), rad or m and s, at a :meth:`basis`."""
        numbers = x.reshape(-1, self.free) * self.half[:, None]
        table = (basis @ numbers.T).transpose(0, 2, 1)
        table[0] += self.center[:, None]
        return np.asarray(table)

    def random(self, rng: np.random.Generator) -> np.ndarray:
        """Draw a random x whose harmonics all have about the same speed."""
        x = rng.normal(size=(len(self.center), self.free))
        x[:, 0] *= 0.1
        return x.reshape(-1)


def quintic(start: np.ndarray, end: np.ndarray, duration: float, time: np.ndarray) -> tuple[np.ndarray, ...]:
    """Evaluate a straight move from rest to rest: position, velocity, acceleration and jerk (m, N) at ``time``."""
    u = np.clip(time / duration, 0.0, 1.0)
    way = (end - start)[:, None]
    return (
        start[:, None] + way * (u**3 * (10 - 15 * u + 6 * u**2)),
        way * (30 * u**2 * (1 - u) ** 2) / duration,
        way * (60 * u * (1 - u) * (1 - 2 * u)) / duration**2,
        way * (60 * (1 - 6 * u + 6 * u**2)) / duration**3,
    )


def move_duration(way: np.ndarray, rates: np.ndarray) -> float:
    """Compute the shortest duration, s, of a quintic move by ``way`` (m,) within speed, acceleration, jerk (3, m)."""
    size, (velocity, acceleration, jerk) = np.abs(way), rates
    durations = (PEAKS[0] * size / velocity, np.sqrt(PEAKS[1] * size / acceleration), np.cbrt(PEAKS[2] * size / jerk))
    return float(max(0.0, *(shortest.max() for shortest in durations)))


def approach_duration(way: np.ndarray, rates: np.ndarray) -> float:
    """Compute the duration, s, of the approach to a motion that begins ``way`` (m,) away from rest."""
    return max(GENTLE * move_duration(way, rates), SHORTEST_APPROACH)

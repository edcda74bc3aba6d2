"""Constant-velocity Kalman filter for a person's head and foot (R. E. Kalman, 1960).

The four coordinates (head x, y, foot x, y), each with its velocity, share one 2 x 2 covariance,
because they are measured together with the same uncertainty. Lengths are in pixels; noise is given
in heights of the person, so that near and far people move alike.
"""

from __future__ import annotations

from math import sqrt

Vector = tuple[float, float, float, float]
"""Head x, y, foot x, y. A tuple, which is faster than an array for so few numbers."""

ACCELERATION = 1.2
"""Process noise: one sigma of the acceleration, heights per second squared."""
MEASUREMENT = 0.08
"""Measurement noise: one sigma of a head or foot position, heights."""
SPEED_SIGMA = 1.0
"""Initial uncertainty of the velocity: one sigma, heights per second."""
SIGMAS = 2
"""Standard deviations within which a position is taken for the expected or the same one."""


class Kalman:
    """Kalman filter of one object."""

    def __init__(self, measurement: Vector, height: float) -> None:
        """Start at rest at ``measurement``; ``height`` of the person in pixels."""
        self.position = measurement
        self.velocity: Vector = (0.0, 0.0, 0.0, 0.0)
        self._pp = (MEASUREMENT * height) ** 2
        self._pv = 0.0
        self._vv = (SPEED_SIGMA * height) ** 2

    def predict(self, dt: float, height: float) -> None:
        """Advance by ``dt`` seconds, with the covariance of the constant-velocity model."""
        self.position = _moved(self.position, dt, self.velocity)
        noise = (ACCELERATION * height) ** 2
        self._pp += dt * (2 * self._pv + dt * self._vv) + noise * dt**4 / 4
        self._pv += dt * self._vv + noise * dt**3 / 2
        self._vv += noise * dt**2

    def update(self, measurement: Vector, height: float) -> None:
        """Correct the state by a measurement."""
        spread = self._pp + (MEASUREMENT * height) ** 2
        gain_p = self._pp / spread
        gain_v = self._pv / spread
        residual = _moved(measurement, -1.0, self.position)
        self.position = _moved(self.position, gain_p, residual)
        self.velocity = _moved(self.velocity, gain_v, residual)
        self._vv -= gain_v * self._pv
        self._pp *= 1 - gain_p
        self._pv *= 1 - gain_p

    @property
    def uncertainty(self) -> float:
        """One sigma of the position, pixels."""
        return sqrt(self._pp)


def _moved(a: Vector, share: float, b: Vector) -> Vector:
    """Return a + share * b."""
    return (a[0] + share * b[0], a[1] + share * b[1], a[2] + share * b[2], a[3] + share * b[3])

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Intra-scan motion: how the sensor really moved during a scan, found together with its pose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.jit import compiled

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class IntraScanMotion:
    """Motion during a scan beyond that which its deskew has undone already.

    A point measured `s` seconds after the instant of its cloud is carried there by
    exp(rate s + bend s^2), sensor frame.

    Attributes:
        rate: (6,) m/s and rad/s.
        bend: (6,) m/s^2 and rad/s^2.
        information: (18, 18) of pose, rate and bend, sensor frame; None = it is known.
    """

    rate: F64
    bend: F64
    information: F64 | None = None

    def at(self, seconds: float) -> F64:
        """(4, 4) what carries a point measured so long after the instant to the instant."""
        return se3.exp(self.rate * seconds + self.bend * seconds**2)

    def spread_at(self, seconds: float) -> F64:
        """(6, 6) covariance, sensor frame, of `at` for what is not known of the motion."""
        if self.information is None:
            return np.zeros((6, 6))
        powers = np.array([seconds, seconds**2])
        blocks = self.covariance.reshape(2, 6, 2, 6)
        spread: F64 = np.einsum('a,aibj,b->ij', powers, blocks, powers)
        return spread

    @property
    def covariance(self) -> F64:
        """(12, 12) covariance of rate and bend, by their information."""
        assert self.information is not None
        unit = 1.0 / np.sqrt(np.maximum(np.diag(self.information), 1e-12))
        scaled = self.information * np.outer(unit, unit) + 1e-9 * np.eye(18)
        covariance: F64 = (np.linalg.inv(scaled) * np.outer(unit, unit))[6:, 6:]
        return covariance

    def undo(self, points: NDArray[Any], times: F64) -> NDArray[Any]:
        """Points (N, 3) measured at times (N,) after the instant, as seen at the instant."""
        moved = np.empty_like(points)
        _carry(points, times, self.rate, self.bend, moved)
        return moved


NO_INTRA_SCAN_MOTION = IntraScanMotion(np.zeros(6), np.zeros(6))


@compiled
def _carry(points, times, rate, bend, moved):  # type: ignore[no-untyped-def]
    """Each point moved by exp(rate s + bend s^2), s its time."""
    for row in range(len(points)):
        s = times[row]
        q = s * s
        wx, wy, wz = (
            rate[3] * s + bend[3] * q,
            rate[4] * s + bend[4] * q,
            rate[5] * s + bend[5] * q,
        )
        vx, vy, vz = (
            rate[0] * s + bend[0] * q,
            rate[1] * s + bend[1] * q,
            rate[2] * s + bend[2] * q,
        )
        sq = wx * wx + wy * wy + wz * wz
        # Rodrigues' factors by their series: turns during a scan are small.
        a = 1.0 - sq / 6.0 * (1.0 - sq / 20.0)
        b = 0.5 - sq / 24.0 * (1.0 - sq / 30.0)
        c = 1.0 / 6.0 - sq / 120.0
        x, y, z = points[row, 0], points[row, 1], points[row, 2]
        cx, cy, cz = wy * z - wz * y, wz * x - wx * z, wx * y - wy * x
        dx, dy, dz = wy * cz - wz * cy, wz * cx - wx * cz, wx * cy - wy * cx
        ex, ey, ez = wy * vz - wz * vy, wz * vx - wx * vz, wx * vy - wy * vx
        fx, fy, fz = wy * ez - wz * ey, wz * ex - wx * ez, wx * ey - wy * ex
        moved[row, 0] = x + a * cx + b * dx + vx + b * ex + c * fx
        moved[row, 1] = y + a * cy + b * dy + vy + b * ey + c * fy
        moved[row, 2] = z + a * cz + b * dz + vz + b * ez + c * fz

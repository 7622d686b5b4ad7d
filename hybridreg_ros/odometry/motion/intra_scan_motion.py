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

    A point measured `s` seconds after the instant of its cloud is carried there by the exponential
    of the sum of terms[k] s^(k + 1), sensor frame.

    Attributes:
        terms: (K, 6), m/s^(k + 1) and rad/s^(k + 1): the velocity at the instant, half the
            acceleration, and so on.
        information: (6 + 6 K, 6 + 6 K) of pose and terms, sensor frame; None = it is known.
    """

    terms: F64
    information: F64 | None = None

    def at(self, seconds: float) -> F64:
        """(4, 4) what carries a point measured so long after the instant to the instant."""
        return se3.exp(seconds ** np.arange(1, len(self.terms) + 1) @ self.terms)

    def spread_at(self, seconds: float) -> F64:
        """(6, 6) covariance, sensor frame, of `at` for what is not known of the motion."""
        if self.information is None:
            return np.zeros((6, 6))
        size, count = len(self.information), len(self.terms)
        unit = 1.0 / np.sqrt(np.maximum(np.diag(self.information), 1e-12))
        scaled = self.information * np.outer(unit, unit) + 1e-9 * np.eye(size)
        known = np.linalg.inv(scaled) * np.outer(unit, unit)
        blocks = known[6:, 6:].reshape(count, 6, count, 6)
        powers = seconds ** np.arange(1, count + 1)
        spread: F64 = np.einsum('a,aibj,b->ij', powers, blocks, powers)
        return spread

    def undo(self, points: NDArray[Any], times: F64) -> NDArray[Any]:
        """Points (N, 3) measured at times (N,) after the instant, as seen at the instant."""
        moved = np.empty_like(points)
        _carry(points, times, self.terms, moved)
        return moved


NO_INTRA_SCAN_MOTION = IntraScanMotion(np.zeros((3, 6)))


@compiled
def _carry(points, times, terms, moved):  # type: ignore[no-untyped-def]
    """Each point moved by the exponential of the sum of terms[k] s^(k + 1), s its time."""
    sums = np.zeros(6)
    for row in range(len(points)):
        s = times[row]
        for i in range(6):
            sums[i] = 0.0
            for k in range(len(terms) - 1, -1, -1):
                sums[i] = (sums[i] + terms[k, i]) * s
        vx, vy, vz, wx, wy, wz = sums
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

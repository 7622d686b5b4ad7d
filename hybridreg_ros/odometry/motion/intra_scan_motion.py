# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Sway: how the sensor really moved during a scan, found together with its pose."""

# ruff: noqa: D417, PLR0913, PLR0917 (kernels take plain arrays)
from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numba
import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.odometry.registration.kernels import NONE, PLANE

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.odometry.config import RefineConfig
    from hybridreg_ros.odometry.motion.prediction import Expected

    F64 = NDArray[np.float64]

_TURNING = (np.deg2rad(0.4), np.deg2rad(18.0))
"""Limits of the standard deviation of the angular velocity within a scan, rad/s."""

_jit = numba.njit(cache=True, nogil=True)


@dataclass(frozen=True, eq=False)
class Sway:
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
        unit = 1.0 / np.sqrt(np.maximum(np.diag(self.information), 1e-12))
        scaled = self.information * np.outer(unit, unit) + 1e-9 * np.eye(18)
        blocks = (np.linalg.inv(scaled) * np.outer(unit, unit))[6:, 6:].reshape(2, 6, 2, 6)
        powers = np.array([seconds, seconds**2])
        spread: F64 = np.einsum('a,aibj,b->ij', powers, blocks, powers)
        return spread

    def undo(self, points: NDArray[Any], times: F64) -> NDArray[Any]:
        """Points (N, 3) measured at times (N,) after the instant, as seen at the instant."""
        moved = np.empty_like(points)
        _carry(points, times, self.rate, self.bend, moved)
        return moved


NO_SWAY = Sway(np.zeros(6), np.zeros(6))


def update(
    sway: Sway,
    T_odom_sensor: F64,
    sums: tuple[F64, F64],
    half_span_s: float,
    config: RefineConfig,
    prior: Expected | None = None,
) -> tuple[F64, Sway, float]:
    """One Gauss-Newton step of pose and sway.

    Args:
        sway: the present one.
        T_odom_sensor: (4, 4) the present pose at the instant of the cloud.
        sums: as `moments` gives them.
        half_span_s: half the duration of the scan, seconds.
        config: how much the velocity may change during a scan.
        prior: pose that the motion so far expects, or None.

    Returns:
        The pose (4, 4), the sway, and the length of the step in units of what the priors allow.
    """
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = T_odom_sensor[:3, :3]
    H, b = np.zeros((18, 18)), np.zeros(18)
    for i in range(3):
        b[6 * i : 6 * i + 6] = turn.T @ sums[1][i]
        for j in range(3):
            H[6 * i : 6 * i + 6, 6 * j : 6 * j + 6] = turn.T @ sums[0][i + j] @ turn
    if prior is not None:
        weight, pull = prior.pull(T_odom_sensor)  # alike along all axes, so turning keeps it
        H[np.arange(6), np.arange(6)] += weight
        b[:6] += turn.T @ pull
    turning = np.full(3, np.deg2rad(config.sway_turn_deg))
    if prior is not None and prior.turn_rate.any() and config.sway_follow > 0.0:
        turning = np.clip(config.sway_follow * prior.turn_rate, *_TURNING)
    spread = np.concatenate([np.full(3, config.sway_speed), turning])
    for order, known in ((1, sway.rate), (2, sway.bend)):
        weight = (half_span_s ** (order - 1) / spread) ** 2
        rows = np.arange(6 * order, 6 * order + 6)
        H[rows, rows] += weight
        b[rows] += weight * known
    if prior is not None and prior.start is not None:
        information, gradient = prior.start.pull(T_odom_sensor, sway)
        H += information
        b += gradient
    step = solve(H, b)
    T = T_odom_sensor @ se3.transform(se3.so3_exp(step[3:6]), step[:3])
    moved = float(np.abs(step[6:12] / spread).max())
    return T, Sway(sway.rate + step[6:12], sway.bend + step[12:], H), moved


def solve(H: F64, b: F64) -> F64:
    """Solution of H step = -b in the directions that the points hold; zero along the others."""
    unit = np.sqrt(np.maximum(np.diag(H), 1e-12))
    values, vectors = np.linalg.eigh(H / np.outer(unit, unit))
    held = values > 1e-4
    projected = np.where(held, (vectors.T @ (-b / unit)) / np.where(held, values, 1.0), 0.0)
    step: F64 = (vectors @ projected) / unit
    return step


@_jit
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


@_jit
def moments(points, times, weights, R, t, kind, anchor, normal, var, scale, point_var):  # type: ignore[no-untyped-def]
    """Sums of the robust cost over powers of the time of each point.

    The unknowns are, per power, a shift (3,) of the position and a turn (3,) about the sensor, in
    the axes of the map; residuals are weighted as in `align.normal_equations`.

    Args:
        points: (N, 3) float64, sensor frame, as carried to the instant.
        times: (N,) seconds after the instant.
        weights: (N,) trust per point, [0, 1].
        scale: (N,) standard deviation of a good plane residual, metres.
        point_var: variance of a point-to-point residual, m^2.

    Returns:
        (5, 6, 6) sums of w s^k J J^T, and (3, 6) sums of w s^k J r.
    """
    H = np.zeros((5, 6, 6))
    b = np.zeros((3, 6))
    J = np.zeros(6)
    for row in range(len(points)):
        if kind[row] == NONE or weights[row] <= 0.0:
            continue
        px, py, pz = points[row, 0], points[row, 1], points[row, 2]
        ax = R[0, 0] * px + R[0, 1] * py + R[0, 2] * pz
        ay = R[1, 0] * px + R[1, 1] * py + R[1, 2] * pz
        az = R[2, 0] * px + R[2, 1] * py + R[2, 2] * pz
        dx = ax + t[0] - anchor[row, 0]
        dy = ay + t[1] - anchor[row, 1]
        dz = az + t[2] - anchor[row, 2]
        plane = kind[row] == PLANE
        for axis in range(1 if plane else 3):
            if plane:
                nx, ny, nz = normal[row, 0], normal[row, 1], normal[row, 2]
                variance = scale[row] * scale[row] + var[row]
                r = dx * nx + dy * ny + dz * nz
                total = r * r
            else:
                nx = 1.0 if axis == 0 else 0.0
                ny = 1.0 if axis == 1 else 0.0
                nz = 1.0 if axis == 2 else 0.0
                variance = point_var
                r = dx * nx + dy * ny + dz * nz
                total = dx * dx + dy * dy + dz * dz
            kernel = 9.0 * variance / (9.0 * variance + total)
            w = weights[row] * kernel * kernel / variance
            J[0], J[1], J[2] = nx, ny, nz
            J[3], J[4], J[5] = ay * nz - az * ny, az * nx - ax * nz, ax * ny - ay * nx
            for k in range(5):
                for i in range(6):
                    for j in range(i, 6):
                        H[k, i, j] += w * J[i] * J[j]
                    if k < 3:
                        b[k, i] += w * J[i] * r
                w *= times[row]
    for k in range(5):
        for i in range(6):
            for j in range(i):
                H[k, i, j] = H[k, j, i]
    return H, b

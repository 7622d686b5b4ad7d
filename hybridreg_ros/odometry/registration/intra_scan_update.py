# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The motion within a scan found together with its pose: moments, update, solution."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.jit import compiled
from hybridreg_ros.odometry.motion.intra_scan_motion import IntraScanMotion
from hybridreg_ros.odometry.registration.gauss_newton import solve
from hybridreg_ros.odometry.registration.kernels import NONE, PLANE, moved

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.odometry.motion.prediction import Expected
    from hybridreg_ros.odometry.motion.usual_motion import UsualMotion

    F64 = NDArray[np.float64]


_SPEED, _TURN = 0.12, float(np.deg2rad(3.0))
"""Standard deviation of the velocity within a scan about the predicted one, m/s, and of the
angular velocity until its usual change is known, rad/s."""
_FOLLOW = 0.35
"""Standard deviation of the angular velocity from then on, relative to that change from scan to
scan (docs/lab/2026-11-22-motion-during-a-scan.md)."""
_TURNING = (np.deg2rad(0.4), np.deg2rad(18.0))
"""Limits of the standard deviation of the angular velocity within a scan, rad/s."""


def update(
    intra_scan: IntraScanMotion,
    T_odom_sensor: F64,
    sums: tuple[F64, F64],
    half_span_s: float,
    prior: Expected | None = None,
    usual: UsualMotion | None = None,
) -> tuple[F64, IntraScanMotion, float]:
    """One Gauss-Newton step of pose and intra-scan motion.

    Args:
        intra_scan: the present one.
        T_odom_sensor: (4, 4) the present pose at the instant of the cloud.
        sums: as `moments` gives them.
        half_span_s: half the duration of the scan, seconds.
        prior: pose that the motion so far expects, or None.
        usual: as in `align`.

    Returns:
        The pose (4, 4), the intra-scan motion, and the length of the step in units of what the
        priors allow.
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
    turning = np.full(3, _TURN)
    if prior is not None and prior.turn_rate.any():
        turning = np.clip(_FOLLOW * prior.turn_rate, *_TURNING)
    spread = np.concatenate([np.full(3, _SPEED), turning])
    weights = (np.array([[1.0], [half_span_s]]) / spread) ** 2
    off = np.array([intra_scan.rate, intra_scan.bend])
    if usual is not None:
        off -= usual.shared
        weights[:, 3:] = 1.0 / usual.variance(half_span_s, off[:, 3:])
    H[np.arange(6, 18), np.arange(6, 18)] += weights.ravel()
    b[6:] += (weights * off).ravel()
    if prior is not None and prior.start is not None:
        information, gradient = prior.start.pull(T_odom_sensor, intra_scan)
        H += information
        b += gradient
    step = solve(H, b)
    T = T_odom_sensor @ se3.transform(se3.so3_exp(step[3:6]), step[:3])
    moved = float((np.abs(step[6:12]) * np.sqrt(weights[0])).max())
    return T, IntraScanMotion(intra_scan.rate + step[6:12], intra_scan.bend + step[12:], H), moved


@compiled
def moments(points, times, weights, T, surfaces, scale, point_var):  # type: ignore[no-untyped-def]
    """Sums of the robust cost over powers of the time of each point.

    The unknowns are, per power, a shift (3,) of the position and a turn (3,) about the sensor, in
    the axes of the map; residuals are weighted as in `kernels.normal_equations`.

    Args:
        points: (N, 3) float64, sensor frame, as carried to the instant.
        times: (N,) seconds after the instant.
        weights: (N,) trust per point, [0, 1].
        T: (4, 4) pose of the instant.
        surfaces: of the points.
        scale: (N,) standard deviation of a good plane residual, metres.
        point_var: variance of a point-to-point residual, m^2.

    Returns:
        (5, 6, 6) sums of w s^k J J^T, and (3, 6) sums of w s^k J r.
    """
    kind, anchor, normal, var, _, _ = surfaces
    H = np.zeros((5, 6, 6))
    b = np.zeros((3, 6))
    J = np.zeros(6)
    for row in range(len(points)):
        if kind[row] == NONE or weights[row] <= 0.0:
            continue
        x, y, z = moved(points, row, T)
        ax, ay, az = x - T[0, 3], y - T[1, 3], z - T[2, 3]
        dx, dy, dz = x - anchor[row, 0], y - anchor[row, 1], z - anchor[row, 2]
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

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Planar motion: the pose in a plane that explains the scan best, for vehicles on flat floors."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.odometry.registration import covariance

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.odometry.registration.alignment import Fit

    F64 = NDArray[np.float64]

VARIANCE = 1e-6
"""Of height (m^2), roll and pitch (rad^2): assumed, not measured, and never 0."""

IN_PLANE = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 1.0])
"""1 for what changes: x, y and yaw."""


def in_plane(fit: Fit, up: F64) -> Fit:
    """The fit moved to the best pose that turns about `up` only and does not rise along it.

    The cost of the alignment is quadratic about its minimum, with the information as Hessian.
    Its minimum among planar poses takes along what height, roll and pitch share with x, y and
    yaw, which a projection would leave out.

    Args:
        fit: a scan in the map; the odom frame lies in the plane.
        up: (3,) unit normal of the plane, odom axes; the same in the sensor frame.
    """
    R, t = fit.T_odom_sensor[:3, :3], fit.T_odom_sensor[:3, 3]
    across = np.linalg.svd(up[None])[2][1:]  # two directions in the plane
    A = np.zeros((3, 6))
    A[0, :3], A[1:, 3:] = up, across
    tilt = np.cross(R @ up, up)
    sine = np.linalg.norm(tilt)
    if sine > 0.0:
        tilt *= np.arctan2(sine, (R @ up) @ up) / sine
    wanted = np.concatenate([[-(up @ t)], across @ tilt])
    spread = covariance.of_pose(fit.information, 1.0)
    gain = spread @ A.T @ np.linalg.inv(A @ spread @ A.T)
    step = gain @ wanted
    left = spread - gain @ A @ spread + VARIANCE * A.T @ A
    T = se3.transform(se3.so3_exp(step[3:]) @ R, t + step[:3])
    information = np.linalg.inv(0.5 * (left + left.T)).astype(np.float64)
    return replace(fit, T_odom_sensor=T, information=information)


def flattened(pose: F64, spread: F64) -> tuple[F64, F64]:
    """Pose (4, 4) with x, y and yaw only, and its covariance (6, 6), fixed axes."""
    yaw = np.arctan2(pose[1, 0], pose[0, 0])
    T = se3.transform(se3.so3_exp(np.array([0.0, 0.0, yaw])), pose[:3, 3] * [1.0, 1.0, 0.0])
    return T, confined(spread)


def confined(spread: F64) -> F64:
    """Covariance (6, 6) of a pose or twist of which only x, y and yaw can be off."""
    result: F64 = spread * np.outer(IN_PLANE, IN_PLANE) + VARIANCE * np.diag(1.0 - IN_PLANE)
    return result

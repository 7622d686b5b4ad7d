# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Unit quaternions (x, y, z, w), the order of ROS messages and TUM files, and rotations."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.errors import FileFormatError

if TYPE_CHECKING:
    from numpy.typing import NDArray


def from_quaternion(x: float, y: float, z: float, w: float) -> NDArray[np.float64]:
    """Rotation (3, 3) of a quaternion, normalised first.

    Raises:
        FileFormatError: its norm is not close to 1.
    """
    norm = float(np.sqrt(x * x + y * y + z * z + w * w))
    if not 0.9 < norm < 1.1:
        raise FileFormatError(f'quaternion ({x:g}, {y:g}, {z:g}, {w:g}) has norm {norm:g}, not 1')
    x, y, z, w = x / norm, y / norm, z / norm, w / norm
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def to_quaternion(R: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """Quaternion (x, y, z, w), w >= 0, of a rotation (3, 3); the largest part is found first."""
    squares = np.array(
        [
            1.0 + R[0, 0] - R[1, 1] - R[2, 2],
            1.0 - R[0, 0] + R[1, 1] - R[2, 2],
            1.0 - R[0, 0] - R[1, 1] + R[2, 2],
            1.0 + R[0, 0] + R[1, 1] + R[2, 2],
        ]
    )
    k = int(np.argmax(squares))
    half = np.sqrt(max(float(squares[k]), 0.0)) / 2.0
    f = 1.0 / (4.0 * half)
    x2y, x2z, y2z = (R[1, 0] + R[0, 1]) * f, (R[0, 2] + R[2, 0]) * f, (R[2, 1] + R[1, 2]) * f
    wx, wy, wz = (R[2, 1] - R[1, 2]) * f, (R[0, 2] - R[2, 0]) * f, (R[1, 0] - R[0, 1]) * f
    q = np.array(
        [
            (half, x2y, x2z, wx),
            (x2y, half, y2z, wy),
            (x2z, y2z, half, wz),
            (wx, wy, wz, half),
        ][k]
    )
    q = q / np.linalg.norm(q)
    q = -q if q[3] < 0.0 else q
    return float(q[0]), float(q[1]), float(q[2]), float(q[3])

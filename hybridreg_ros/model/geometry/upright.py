# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Frames that are found from the clouds: upright, and along the walls.

The first is that which a sensor with a narrow view would have if it were mounted upright.

It is found from the clouds alone, so it turns with them: whatever is done in it is the same for
every way in which the sensor is mounted. A view all round says nothing about its frame (measured
on simulated streets: the vertical has the right sign in 55 %, see docs/lab, 2026-11-22).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]

_MOST_POINTS = 20_000
_MIN_POINTS = 10
_NARROW = 0.5
_OUTSIDE = 0.02


def upright(source: F32, target: F32) -> F64 | None:
    """Rotation from the sensor frames of two clouds to their common upright one.

    In that frame z is where the views point, x along their greater width, and y (down) towards
    the side on which things are nearer, like the optical frame of a camera.

    Args:
        source: (N, 3) sensor frame, metres; rows with NaN or inf are ignored.
        target: (M, 3) likewise.

    Returns:
        (3, 3), or None when a view is wider than 120 degrees or holds too few points.
    """
    rays = [_rays(cloud) for cloud in (source, target)]
    if not all(_narrow(directions) for directions, _ in rays):
        return None
    z = _unit(sum(directions.mean(axis=0) for directions, _ in rays))
    across = np.eye(3) - np.outer(z, z)
    spread = sum(directions.T @ directions / len(directions) for directions, _ in rays)
    _, axes = np.linalg.eigh(across @ spread @ across)
    y = axes[:, 1]  # along z the spread is 0, so the middle one is the narrower of the other two
    farther = sum(_slope(directions, ranges) for directions, ranges in rays) @ y
    y = -y if farther > 0.0 else y
    R: F64 = np.stack([np.cross(y, z), y, z])
    return R


def along_walls(*normals: F32) -> F64:
    """Rotation (3, 3) about z, by at most 45 degrees, after which walls lie along x or y.

    Args:
        normals: (N, 3) unit normals of each cloud, z up; those of the ground count nothing.
    """
    across = np.concatenate([n[:, 0] + 1j * n[:, 1] for n in normals]).astype(np.complex128)
    quarter = float(np.angle((across**4).sum())) / 4.0  # the same for walls at right angles
    R: F64 = se3.so3_exp(np.array([0.0, 0.0, -quarter]))
    return R


def _rays(cloud: F32) -> tuple[F64, F64]:
    """Directions (K, 3) and distances (K,) of some points of a cloud, evenly taken."""
    points = cloud[np.isfinite(cloud).all(axis=1)].astype(np.float64)
    points = points[:: max(1, len(points) // _MOST_POINTS)]
    ranges = np.linalg.norm(points, axis=1)
    seen = ranges > 0.0
    return points[seen] / ranges[seen, None], ranges[seen]


def _narrow(directions: F64) -> bool:
    """Whether all but a few directions lie within 60 degrees of their mean."""
    if len(directions) < _MIN_POINTS:
        return False
    off_axis = directions @ _unit(directions.mean(axis=0))
    return bool(np.quantile(off_axis, _OUTSIDE) > _NARROW)


def _slope(directions: F64, ranges: F64) -> F64:
    """Covariance of direction and logarithm of distance, (3,): towards what is farther."""
    log = np.log(ranges)
    found: F64 = (directions * (log - log.mean())[:, None]).mean(axis=0)
    return found


def _unit(v: F64) -> F64:
    return v / max(float(np.linalg.norm(v)), 1e-12)

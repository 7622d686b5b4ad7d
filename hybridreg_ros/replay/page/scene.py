# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The scene of a run in odom: what stands still, thinned, and the moving points of each frame."""

from __future__ import annotations

import base64
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.odometry.map.thinning import first_per_voxel
from hybridreg_ros.odometry.result import Source
from hybridreg_ros.replay.page.pictures import is_optical
from hybridreg_ros.replay.runner import DYNAMIC_THRESHOLD

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from hybridreg_ros.odometry.result import OdometryResult

STILL_POINTS, MOVING_POINTS = 120_000, 300_000
"""What a page of some megabytes holds and a telephone turns without a jerk."""
STILL_PER_SCAN, MOVING_PER_SCAN = 6000, 1500
FINEST_M = 0.01
GROWTH = 1.25


@dataclass(frozen=True, eq=False)
class Scene:
    """What is drawn in 3D.

    Attributes:
        still: (N, 3) float32, odom, metres.
        voxel_m: spacing of the still points.
        moving: (K, 3) float32 of each kept frame by its stamp (ns), odom, metres.
        keyframes: stamps (ns).
        optical: whether odom has the axes of a camera (x right, y down, z ahead).
    """

    still: NDArray[np.float32]
    voxel_m: float
    moving: Mapping[int, NDArray[np.float32]] = field(default_factory=dict)
    keyframes: tuple[int, ...] = ()
    optical: bool = False

    def upright(self, points: NDArray[np.floating]) -> NDArray[np.floating]:
        """Points (N, 3) of odom with x ahead, y left and z up."""
        if not self.optical:
            return points
        return points[:, [2, 0, 1]] * np.array([1, -1, -1], points.dtype)


class SceneSink:
    """Collects a scene while a replay runs, in memory that does not grow with its length.

    Args:
        threshold: dynamic probability from which a point counts as moving.
    """

    def __init__(self, threshold: float = DYNAMIC_THRESHOLD) -> None:
        self._threshold = threshold
        self._rng = np.random.default_rng(0)
        self._voxel_m = FINEST_M
        self._still: list[NDArray[np.float32]] = []
        self._waiting = 0
        self._moving: dict[int, NDArray[np.float32]] = {}
        self._moving_points = self._seen = 0
        self._every = 1
        self._keyframes: list[int] = []
        self._optical: bool | None = None

    def add(self, message: Any, result: OdometryResult) -> None:
        """Take the result of one scan."""
        if result.source is Source.LOST:
            return
        if result.is_keyframe:
            self._keyframes.append(result.stamp)
        called = result.dynamic_probability >= self._threshold
        self.offer(result.stamp, result.pose, result.scan.points, called)

    def offer(
        self,
        stamp: int,
        pose: NDArray[np.float64],
        points: NDArray[np.float32],
        moving: NDArray[np.bool_],
    ) -> None:
        """Take one scan: points (N, 3) in the sensor frame, those that move (N,), its pose."""
        if self._optical is None and len(points):
            self._optical = is_optical(points)
        still = self._some(np.flatnonzero(~moving), STILL_PER_SCAN)
        self._still.append(se3.apply(pose, points[still]))
        self._waiting += len(still)
        if self._waiting > STILL_POINTS:
            self._thin()
        if self._seen % self._every == 0:
            rows = self._some(np.flatnonzero(moving), MOVING_PER_SCAN)
            self._moving[stamp] = se3.apply(pose, points[rows])
            self._moving_points += len(rows)
        self._seen += 1
        if self._moving_points > MOVING_POINTS:
            self._moving = dict(list(self._moving.items())[::2])
            self._moving_points = sum(map(len, self._moving.values()))
            self._every *= 2

    def _some(self, rows: NDArray[np.int64], most: int) -> NDArray[np.int64]:
        if len(rows) <= most:
            return rows
        return rows[self._rng.integers(0, len(rows), most)]

    def _thin(self) -> None:
        """One point per voxel, in voxels large enough for the number of points."""
        points = np.concatenate([np.zeros((0, 3), np.float32), *self._still])
        while True:
            points = points[first_per_voxel(points, self._voxel_m)]
            if len(points) <= STILL_POINTS:
                break
            self._voxel_m *= GROWTH
        self._still, self._waiting = [points], 0

    def scene(self) -> Scene:
        """What was collected so far."""
        self._thin()
        return Scene(
            self._still[0],
            self._voxel_m,
            dict(self._moving),
            tuple(self._keyframes),
            bool(self._optical),
        )


def packed(points: NDArray[np.floating], low: NDArray[np.floating], step_m: float) -> str:
    """Points (N, 3) as base64 of little-endian uint16 steps from a corner, x y z in turn."""
    steps = np.clip(np.round((points - low) / step_m), 0, 65535).astype('<u2')
    return base64.b64encode(steps.tobytes()).decode('ascii')


def for_page(scene: Scene, start: int) -> dict[str, Any]:
    """A scene as JSON values, upright; times are seconds since `start` (ns).

    Points are kept in steps of a 65,535th of the extent.
    """
    still = scene.upright(scene.still)
    moving = {stamp: scene.upright(p) for stamp, p in scene.moving.items()}
    points = np.concatenate([still, *moving.values()])
    low, high = points.min(axis=0), points.max(axis=0)
    step_m = max(float((high - low).max()) / 65535, 1e-6)
    return {
        'low': low.tolist(),
        'step': step_m,
        'still': packed(still, low, step_m),
        'moving': [
            {'t': round((stamp - start) / 1e9, 4), 'p': packed(p, low, step_m)}
            for stamp, p in moving.items()
        ],
        'keyframes': [round((stamp - start) / 1e9, 4) for stamp in scene.keyframes],
    }

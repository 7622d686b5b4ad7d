# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Pipelines to compare with, as their authors ship them: kiss-icp, genz-icp, small_gicp."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import require
from hybridreg_ros.odometry.registration.kiss import (
    LARGEST_COORDINATE_M,
    MIN_POINTS,
    guarded,
    require_kiss_icp,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F64 = NDArray[np.float64]

_GICP_POINTS = 10


class KissIcp:
    """kiss-icp's own pipeline, with guards.

    Args:
        voxel_size_m: its voxel size.
        max_range_m: its range limit.
        min_range_m: its lower range limit.
        deskew: undo the motion during a scan when believable times are given.
        threads: threads of one registration.

    Raises:
        DependencyError: kiss-icp is not installed.
    """

    def __init__(
        self,
        voxel_size_m: float,
        max_range_m: float = 100.0,
        min_range_m: float = 0.0,
        deskew: bool = True,
        threads: int = 1,
    ) -> None:
        require_kiss_icp()
        from kiss_icp.config import KISSConfig
        from kiss_icp.config.config import (
            AdaptiveThresholdConfig,
            DataConfig,
            MappingConfig,
            RegistrationConfig,
        )
        from kiss_icp.kiss_icp import KissICP

        # Every value is given: kiss-icp would take missing ones from environment variables.
        self._deskew = deskew
        self._kiss = KissICP(
            KISSConfig(
                data=DataConfig(max_range=max_range_m, min_range=min_range_m, deskew=deskew),
                mapping=MappingConfig(voxel_size=voxel_size_m, max_points_per_voxel=20),
                registration=RegistrationConfig(
                    max_num_iterations=500, convergence_criterion=1e-4, max_num_threads=threads
                ),
                adaptive_threshold=AdaptiveThresholdConfig(
                    fixed_threshold=None, initial_threshold=2.0, min_motion_th=0.1
                ),
            )
        )

    def step(self, points: NDArray[np.floating], times: F64 | None = None) -> F64:
        """Pose T_odom_sensor (4, 4) after one more scan.

        Args:
            points: (N, 3), sensor frame, metres.
            times: (N,) seconds of each point; used only when finite and not all equal.
        """
        usable = guarded(points)
        stamps = np.zeros(0)
        if times is not None and self._deskew and len(times) == len(usable):
            spread = np.isfinite(times).all() and times.max(initial=-np.inf) > times.min(
                initial=np.inf
            )
            stamps = np.ascontiguousarray(times, np.float64) if spread else np.zeros(0)
        if len(usable) >= MIN_POINTS:
            self._kiss.register_frame(usable, stamps)
        return np.array(self._kiss.last_pose)


class GenzIcp:
    """genz-icp's own pipeline, with guards as kiss-icp has them.

    Args:
        voxel_size_m: its voxel size.
        max_range_m: its range limit.
        min_range_m: its lower range limit.
        deskew: undo the motion during a scan when believable times are given.

    Raises:
        DependencyError: genz-icp is not installed.
    """

    def __init__(
        self, voxel_size_m: float, max_range_m: float, min_range_m: float, deskew: bool = True
    ) -> None:
        require('genz-icp', 'bench', 'genz_icp')
        from genz_icp.config import GenZConfig
        from genz_icp.config.config import DataConfig, MappingConfig
        from genz_icp.genz_icp import GenZICP

        self._low, self._high = min_range_m, max_range_m
        self._deskew = deskew
        self._pose = np.eye(4)
        self._genz = GenZICP(
            GenZConfig(
                data=DataConfig(max_range=max_range_m, min_range=min_range_m, deskew=deskew),
                mapping=MappingConfig(voxel_size=voxel_size_m, map_cleanup_radius=max_range_m),
            )
        )

    def step(self, points: NDArray[np.floating], times: F64 | None = None) -> F64:
        """Pose T_odom_sensor (4, 4) after one more scan; arguments as `KissIcp.step`."""
        rows = np.ascontiguousarray(points, np.float64)
        sane = (np.abs(rows) < LARGEST_COORDINATE_M).all(axis=1)
        usable = rows[sane]
        stamps = np.zeros(0)
        if times is not None and self._deskew and len(times) == len(rows):
            given = np.ascontiguousarray(times[sane], np.float64)
            if np.isfinite(given).all() and np.ptp(given) > 0.0:
                # It expects times between 0 and 1.
                stamps = (given - given.min()) / np.ptp(given)
        ranges = np.linalg.norm(usable, axis=1)
        if int(((ranges > self._low) & (ranges < self._high)).sum()) >= MIN_POINTS:
            self._genz.register_frame(usable, stamps)
            pose = np.array(self._genz.last_pose)
            if se3.is_rigid(pose, 1e-3):
                self._pose = pose
        return self._pose


class GicpToKeyframe:
    """small_gicp's GICP from each scan to the last keyframe, with a constant-velocity guess.

    Args:
        voxel_size_m: edge of the thinning cubes.
        max_range_m: farther points are left out.
        min_range_m: nearer points are left out.
        keyframe_share: fewer inliers than this share make the scan the next keyframe.

    Raises:
        DependencyError: small_gicp is not installed.
    """

    def __init__(
        self,
        voxel_size_m: float,
        max_range_m: float,
        min_range_m: float,
        keyframe_share: float = 0.7,
    ) -> None:
        require('small-gicp', 'bench', 'small_gicp')
        import small_gicp  # noqa: F401

        self._voxel = voxel_size_m
        self._low, self._high = min_range_m, max_range_m
        self._share = keyframe_share
        self._target: tuple[object, object] | None = None
        self._T_odom_keyframe = np.eye(4)
        self._pose = self._last = np.eye(4)

    def step(self, points: NDArray[np.floating], times: F64 | None = None) -> F64:
        """Pose T_odom_sensor (4, 4) after one more scan; times are not used."""
        import small_gicp

        del times
        rows = np.ascontiguousarray(points, np.float64)
        ranges = np.linalg.norm(rows, axis=1)
        rows = rows[(ranges > self._low) & (ranges < self._high)]
        cloud, tree = small_gicp.preprocess_points(rows, self._voxel, _GICP_POINTS, 1)
        if cloud.size() < MIN_POINTS:
            return self._pose
        if self._target is None:
            self._target = (cloud, tree)
            return self._pose
        predicted = self._pose @ se3.inverse(self._last) @ self._pose
        target, target_tree = self._target
        found = small_gicp.align(
            target,
            cloud,
            target_tree,
            se3.inverse(self._T_odom_keyframe) @ predicted,
            max_correspondence_distance=4.0 * self._voxel,
            num_threads=1,
        )
        pose = self._T_odom_keyframe @ se3.orthonormalise(np.array(found.T_target_source))
        if se3.is_rigid(pose):
            self._last, self._pose = self._pose, pose
        if found.num_inliers < self._share * cloud.size():
            self._target, self._T_odom_keyframe = (cloud, tree), self._pose
        return self._pose

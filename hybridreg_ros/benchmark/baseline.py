# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Other pipelines behind the interface of our front end."""

from __future__ import annotations

from time import perf_counter
from typing import TYPE_CHECKING, Protocol

import numpy as np

from hybridreg_ros.benchmark.pipelines import GenzIcp, GicpToKeyframe, KissIcp
from hybridreg_ros.core.errors import ConfigError
from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.odometry.preprocess import SensorModel, recognise_sensor
from hybridreg_ros.odometry.result import OdometryResult, Reason, Source

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.core.scan import Scan

BASELINE_VOXEL_M = {
    'kiss-icp': {'depth': 0.1, 'lidar': 0.3},
    'genz-icp': {'depth': 0.06, 'lidar': 0.3},
    'small-gicp': {'depth': 0.1, 'lidar': 0.3},
}
"""Voxel edge that suits each baseline, metres: the best of a sweep (docs/lab, 2026-11-22), better
than kiss-icp's own rule, a hundredth of the maximum range (0.08 and 1 m)."""


class _Pipeline(Protocol):
    """What the pipelines have in common."""

    def step(
        self, points: NDArray[np.floating], times: NDArray[np.float64] | None = None
    ) -> NDArray[np.float64]:
        """Pose T_odom_sensor (4, 4) after one more scan."""


class Alone:
    """A baseline's own pipeline with the ranges of the sensor.

    It says nothing about moving points, confidence or covariance; `source` of its results is
    kiss_icp for want of a better word.

    Args:
        name: kiss-icp, genz-icp or small-gicp.
        voxel_size_m: its voxel size, None = BASELINE_VOXEL_M for the sensor.

    Raises:
        ConfigError: no such baseline.
    """

    def __init__(self, name: str = 'kiss-icp', voxel_size_m: float | None = None) -> None:
        if name not in ('kiss-icp', 'genz-icp', 'small-gicp'):
            raise ConfigError(
                f'baseline: expected kiss-icp, genz-icp or small-gicp, found {name!r}'
            )
        self._name = name
        self._voxel_size_m = voxel_size_m
        self._pipeline: _Pipeline | None = None

    def step(self, scan: Scan) -> OdometryResult:
        """Register one scan."""
        start = perf_counter()
        if self._pipeline is None and len(scan):
            self._pipeline = self._build(recognise_sensor(scan.points, OdometryConfig()))
        pose = np.eye(4)
        if self._pipeline is not None:
            pose = self._pipeline.step(scan.points, scan.times)
        return OdometryResult(
            scan=scan,
            pose=pose,
            covariance=np.zeros((6, 6)),
            twist=np.zeros(6),
            twist_covariance=np.zeros((6, 6)),
            source=Source.KISS_ICP,
            reason=Reason.REGISTRAR_KISS_ICP,
            confidence=float('nan'),
            dynamic_probability=np.zeros(len(scan), np.float32),
            timings_s={'total': perf_counter() - start},
        )

    def _build(self, sensor: SensorModel) -> _Pipeline:
        voxel = self._voxel_size_m or BASELINE_VOXEL_M[self._name][sensor.kind]
        if self._name == 'kiss-icp':
            return KissIcp(voxel, sensor.max_range_m, sensor.min_range_m)
        if self._name == 'genz-icp':
            return GenzIcp(voxel, sensor.max_range_m, sensor.min_range_m)
        return GicpToKeyframe(voxel, sensor.max_range_m, sensor.min_range_m)

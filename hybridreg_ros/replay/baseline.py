# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""kiss-icp alone, as its authors ship it, behind the same interface: the rival beside ours."""

from __future__ import annotations

from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.odometry.kiss import PlainKissIcp
from hybridreg_ros.odometry.preprocess import recognise_sensor
from hybridreg_ros.odometry.result import OdometryResult, Reason, Source

if TYPE_CHECKING:
    from hybridreg_ros.core.scan import Scan


class KissIcpAlone:
    """kiss-icp's own pipeline; voxel size and ranges fit the sensor as ours do.

    It says nothing about moving points, confidence or covariance.
    """

    def __init__(self, config: OdometryConfig | None = None) -> None:
        self._config = config or OdometryConfig()
        self._kiss: PlainKissIcp | None = None

    def step(self, scan: Scan) -> OdometryResult:
        """Register one scan."""
        start = perf_counter()
        if self._kiss is None and len(scan):
            sensor = recognise_sensor(scan.points, self._config)
            self._kiss = PlainKissIcp(sensor.voxel_size_m, sensor.max_range_m, sensor.min_range_m)
        pose = np.eye(4) if self._kiss is None else self._kiss.step(scan.points, scan.times)
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

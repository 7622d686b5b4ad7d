# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Settle: a preprocessed scan refined in the map, by as many points as say something new."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from hybridreg_ros.odometry.registration.alignment import refine

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from hybridreg_ros.odometry.config import RefineConfig
    from hybridreg_ros.odometry.map.local_map import LocalMap
    from hybridreg_ros.odometry.motion.prediction import Expected
    from hybridreg_ros.odometry.preprocessed import Cloud
    from hybridreg_ros.odometry.registration.alignment import Basin, Fit


def settle(
    cloud: Cloud,
    T_odom_sensor: NDArray[np.float64],
    local_map: LocalMap,
    config: RefineConfig,
    weights: NDArray[np.floating] | None = None,
    basin: Basin = 'fine',
    prior: Expected | None = None,
) -> Fit:
    """Align a cloud with the map, from a first guess, as `refine` does its registered points.

    The information is that of the points that count as independent, and so is their weight
    against what the motion so far expects.

    Args:
        cloud: the preprocessed scan, K registered points.
        T_odom_sensor: (4, 4) first guess.
        local_map: the map.
        config: settings.
        weights: (K,) trust per registered point in [0, 1], or None for all equal.
        basin: level to start on.
        prior: pose that the motion so far expects, or None.
    """
    share = cloud.icp_share
    held = None if prior is None else prior.widened(share**0.5, share**0.5)
    points, times = cloud.icp_points, cloud.icp_times
    fit = refine(points, T_odom_sensor, local_map, config, weights, basin, times, held)
    return replace(fit, information=share * fit.information)

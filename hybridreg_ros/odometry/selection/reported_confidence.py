# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Reported confidence of a pose, once it was chosen and all ways are known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.odometry.selection import calibration
from hybridreg_ros.odometry.selection.candidates import log_odds, runner_up

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from hybridreg_ros.odometry.selection.candidates import Candidate

    F64 = NDArray[np.float64]

_MATCHED = 0.01
"""Share of unmatched points below which fewer say nothing more."""
_UNANIMOUS = 0.003
"""Disagreement, in voxels or degrees, below which less says nothing more."""


@dataclass(frozen=True)
class ReportedConfidence:
    """What is known of a pose that was chosen.

    Attributes:
        evident: log odds of the confidence by which it was chosen.
        unmatched: log10 of the share of the points without a surface of the map nearby.
        disagreement: log10 of the standard deviation by which the parts of the scan disagree
            about it (`disagreement`).
        innovation: log10 of how far it is off the predicted one (`innovation`); 0 where no motion
            is known.
        runner_up: confidence of the surest pose that another way led to, less when that is near by
            (`runner_up`); 0 where there is none.
    """

    evident: float
    unmatched: float
    disagreement: float
    innovation: float
    runner_up: float

    @property
    def confidence(self) -> float:
        """P(pose right), [0, 1], by the weights of `calibration.json`; at most as evident.

        That nothing speaks against a pose is no evidence for it: a bare wall has no runner-up, and
        the motion so far leads wherever it does.
        """
        most = 1.0 / (1.0 + np.exp(-self.evident))
        return float(min(calibration.packaged().confidence.probability(self), most))


def of(
    found: Candidate, considered: Iterable[Candidate], voxel_size_m: float
) -> ReportedConfidence:
    """The confidence of a pose, with what it follows from.

    Args:
        found: the pose that was chosen.
        considered: every pose that was judged for its scan.
        voxel_size_m: voxel of the map.
    """
    return ReportedConfidence(
        log_odds(found.confidence),
        float(np.log10(max(0.0, 1.0 - found.fit.overlap) + _MATCHED)),
        disagreement(found.fit.cluster_covariance, voxel_size_m),
        found.innovation,
        runner_up(found.fit.T_odom_sensor, considered, voxel_size_m),
    )


def disagreement(cluster_covariance: F64, voxel_size_m: float) -> float:
    """How much the parts of a scan disagree about its pose.

    Args:
        cluster_covariance: (6, 6) of position and turn, m^2 and rad^2 (`Fit`).
        voxel_size_m: voxel of the map; as much as a turn of one degree.

    Returns:
        log10 of the standard deviations along the worst directions, voxels and degrees together.
    """
    shift = (
        np.sqrt(max(0.0, float(np.linalg.eigvalsh(cluster_covariance[:3, :3])[-1]))) / voxel_size_m
    )
    turn = np.rad2deg(np.sqrt(max(0.0, float(np.linalg.eigvalsh(cluster_covariance[3:, 3:])[-1]))))
    return float(np.log10(_UNANIMOUS + np.hypot(shift, turn)))

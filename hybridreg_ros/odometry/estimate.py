# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Estimate: what the tracker says about one cloud."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.odometry.preprocessed import Cloud
    from hybridreg_ros.odometry.result import Reason, Source
    from hybridreg_ros.odometry.selection.reported_confidence import Claim

    F64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Estimate:
    """What the tracker says about one cloud; fields as in OdometryResult.

    `reported` is the pose at the instant that is asked for, None where only the velocity between
    scans leads there; `claim` is what the confidence follows from, None where it is 0.
    """

    pose: F64
    covariance: F64
    source: Source
    reason: Reason
    confidence: float
    dynamic_probability: NDArray[np.float32]
    keyframe_id: int
    is_keyframe: bool
    reported: F64 | None = None
    claim: Claim | None = None


def nothing(cloud: Cloud) -> NDArray[np.float32]:
    """P(dynamic) (N,) of a cloud of which nothing is known: zero."""
    return np.zeros(len(cloud.points), np.float32)

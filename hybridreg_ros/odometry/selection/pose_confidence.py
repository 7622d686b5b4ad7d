# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Confidence of a pose by what the scan sees from there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hybridreg_ros.odometry.selection import calibration

_STIFF_M = 0.003
"""Standard deviation, metres, below which a pose counts as held firmly."""


@dataclass(frozen=True)
class PoseEvidence:
    """What speaks for a pose.

    Attributes:
        overlap: share of the points with a surface of the map nearby, [0, 1].
        seen: share of the points in directions that an earlier scan saw, [0, 1].
        consistent: share of those that stand on what the earlier scan saw there, [0, 1].
        before: share of those that stand before it, in space seen free, [0, 1]; the others stand
            behind it.
        worst_axis: log10 of the standard deviation, metres, that the information of the
            registration leaves along the direction in which the position is held worst.
    """

    overlap: float
    seen: float
    consistent: float
    before: float = 0.0
    worst_axis: float = -2.5


def worst_axis(spread_m: float) -> float:
    """Evidence of how loosely a pose is held along its worst direction.

    Below some millimetres nothing is gained: a wrong pose in a room of clean planes is stiff too.

    Args:
        spread_m: standard deviation of the position there, metres.
    """
    return float(np.log10(max(spread_m, _STIFF_M)))


def of_evidence(evidence: PoseEvidence) -> float:
    """Confidence of a pose that no network vouches for, [0, 1].

    It grows with the share of points that stands where an earlier scan saw a surface, and falls
    with the share that stands in space seen free and where the surfaces found leave a direction
    loose. The weights come from `calibration.json`.
    """
    return calibration.packaged().evidence.probability(evidence)

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Confidence: how far a pose is to be believed, and when the network branch is taken."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.odometry.result import Reason
from hybridreg_ros.odometry.selection import calibration

if TYPE_CHECKING:
    from numpy.typing import NDArray
_STIFF_M = 0.003
"""Standard deviation, metres, below which a pose counts as held firmly."""
_MIN_OVERLAP, _MIN_SEEN, _MIN_CONSISTENT = 0.2, 0.15, 0.15
"""Shares of the points: least that find the map, lie in directions seen, and of those stand on
what was seen; else a pose is not judged at all."""
_AGAINST_MOTION = 0.75
"""Confidence that a pose must reach beyond the reach of the motion."""
_JUMP_DEG = 45.0
"""Largest turn from the predicted orientation within that reach."""
FIRM = float(np.log10(_STIFF_M))
"""`PoseEvidence.worst_axis` of a pose that is held firmly."""


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


@dataclass(frozen=True)
class Verdict:
    """Judgement of one pose.

    Attributes:
        confidence: P(pose right), [0, 1].
        fault: why the pose must not be used, or None.
    """

    confidence: float
    fault: Reason | None


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


def judge(
    evidence: PoseEvidence,
    pose: NDArray[np.float64],
    predicted: NDArray[np.float64] | None,
    dt_s: float,
    voxel_size_m: float,
    max_jump_m: float,
) -> Verdict:
    """Judge a pose by what it explains and by its agreement with the motion so far.

    Args:
        evidence: what speaks for it.
        pose: (4, 4) the pose.
        predicted: (4, 4) pose by constant velocity, None when the motion says nothing.
        dt_s: seconds since the last pose.
        voxel_size_m: voxel of the map.
        max_jump_m: reach of the motion, metres; 0 = by voxel and speed.
    """
    if not (evidence.overlap >= _MIN_OVERLAP and evidence.seen >= _MIN_SEEN):
        return Verdict(0.0, Reason.NO_OVERLAP)
    if not evidence.consistent >= _MIN_CONSISTENT:
        return Verdict(0.0, Reason.REFINEMENT_FAILED)
    confidence = of_evidence(evidence)
    near = predicted is None or agrees(pose, predicted, dt_s, voxel_size_m, max_jump_m)
    if not near and confidence < _AGAINST_MOTION:
        return Verdict(0.0, Reason.DISAGREES_WITH_MOTION)
    return Verdict(confidence, None)


def agrees(
    pose: NDArray[np.float64],
    predicted: NDArray[np.float64],
    dt_s: float,
    voxel_size_m: float,
    max_jump_m: float,
) -> bool:
    """Whether a pose is within reach of the predicted one."""
    deviation = se3.inverse(predicted) @ pose
    limit = max_jump_m or 5.0 * voxel_size_m + 3.0 * max(dt_s, 0.0)
    near = float(np.linalg.norm(deviation[:3, 3])) <= limit
    return near and se3.rotation_angle_deg(deviation[:3, :3]) <= _JUMP_DEG

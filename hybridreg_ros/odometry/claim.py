# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Claim: the confidence that is reported of a pose, once it was chosen and all ways are known."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.odometry import calibration
from hybridreg_ros.odometry.confidence import of_evidence

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from hybridreg_ros.odometry.located import Candidate, Located
    from hybridreg_ros.odometry.motion import Expected

    F64 = NDArray[np.float64]

_MATCHED = 0.01
"""Share of unmatched points below which fewer say nothing more."""
_UNANIMOUS = 0.003
"""Disagreement, in voxels or degrees, below which less says nothing more."""
_USUAL = 0.1
"""Deviation from the prediction, in its units, below which less says nothing more."""
_SUREST = 1e-3
"""Confidences within this of 0 and 1 count alike."""


@dataclass(frozen=True)
class Claim:
    """What is known of a pose that was chosen.

    Attributes:
        evident: log odds of the confidence by which it was chosen.
        unmatched: log10 of the share of the points without a surface of the map nearby.
        scatter: log10 of the standard deviation by which the parts of the scan disagree about it
            (`disagreement`).
        surprise: log10 of how far it is off the predicted one (`surprise`); 0 where no motion is
            known.
        rival: confidence of the surest pose that another way led to, less when that is near by
            (`rival`); 0 where there is none.
    """

    evident: float
    unmatched: float
    scatter: float
    surprise: float
    rival: float

    @property
    def confidence(self) -> float:
        """P(pose right), [0, 1], by the weights of `calibration.json`; at most as evident.

        That nothing speaks against a pose is no evidence for it: a bare wall has no rival, and the
        motion so far leads wherever it does.
        """
        most = 1.0 / (1.0 + np.exp(-self.evident))
        return float(min(calibration.packaged().confidence.probability(self), most))


def of(found: Located, considered: Iterable[Candidate], voxel_size_m: float) -> Claim:
    """The claim for a pose.

    Args:
        found: the pose that was chosen.
        considered: every pose that was judged for its scan.
        voxel_size_m: voxel of the map.
    """
    return Claim(
        log_odds(found.confidence),
        float(np.log10(max(0.0, 1.0 - found.fit.overlap) + _MATCHED)),
        disagreement(found.fit.scatter, voxel_size_m),
        found.surprise,
        rival(found.fit.T_odom_sensor, considered, voxel_size_m),
    )


def log_odds(confidence: float) -> float:
    """Log odds of a confidence in [0, 1]."""
    kept = min(max(confidence, _SUREST), 1.0 - _SUREST)
    return float(np.log(kept / (1.0 - kept)))


def disagreement(scatter: F64, voxel_size_m: float) -> float:
    """How much the parts of a scan disagree about its pose.

    Args:
        scatter: (6, 6) covariance of position and turn, m^2 and rad^2 (`Fit.scatter`).
        voxel_size_m: voxel of the map; as much as a turn of one degree.

    Returns:
        log10 of the standard deviations along the worst directions, voxels and degrees together.
    """
    shift = np.sqrt(max(0.0, float(np.linalg.eigvalsh(scatter[:3, :3])[-1]))) / voxel_size_m
    turn = np.rad2deg(np.sqrt(max(0.0, float(np.linalg.eigvalsh(scatter[3:, 3:])[-1]))))
    return float(np.log10(_UNANIMOUS + np.hypot(shift, turn)))


def surprise(pose: F64, expected: Expected | None, voxel_size_m: float) -> float:
    """How far a pose is off the one that the motion so far predicts.

    Things do jump, so that a far pose is possible; but a repeated structure (shelves, stairs,
    fences) fits as well a period further on, and then nothing else speaks against it.

    Args:
        pose: (4, 4) the pose.
        expected: where the motion so far leads, and how far predictions have been off of late;
            None = the motion says nothing.
        voxel_size_m: voxel of the map; as far as a turn of one degree.

    Returns:
        log10 of the deviation, shift and turn together, in units of a voxel (a degree) and the
        usual deviation; 0 where no motion is known.
    """
    if expected is None or not expected.known:
        return 0.0
    usual = voxel_size_m + expected.shift_m, 1.0 + float(np.rad2deg(expected.turn_rad))
    return float(np.log10(_USUAL + _apart(expected.pose, pose, *usual)))


def rival(
    pose: F64, considered: Iterable[Candidate], voxel_size_m: float, refused: bool = False
) -> float:
    """How plausible the surest pose is that another way led to.

    Args:
        pose: (4, 4) the pose that was chosen.
        considered: every pose that was judged for its scan.
        voxel_size_m: one so far off, or off by one degree, is a different pose; one nearer counts
            by its distance.
        refused: whether those that failed a check count too, by what speaks for them.

    Returns:
        Its confidence, [0, 1].
    """
    others = (
        (of_evidence(c.evidence) if refused else c.verdict.confidence)
        * min(1.0, _apart(pose, c.fit.T_odom_sensor, voxel_size_m, 1.0))
        for c in considered
    )
    return max(others, default=0.0)


def _apart(one: F64, other: F64, metres: float, degrees: float) -> float:
    """Distance of two poses (4, 4), shift and turn together, each in its unit."""
    off = se3.inverse(one) @ other
    shift = float(np.linalg.norm(off[:3, 3])) / metres
    return float(np.hypot(shift, se3.rotation_angle_deg(off[:3, :3]) / degrees))

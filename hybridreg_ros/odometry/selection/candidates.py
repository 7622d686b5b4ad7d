# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Candidates: poses that were found for a scan, each with what speaks for it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.odometry.result import Reason, Source  # noqa: TC001 (fields)
from hybridreg_ros.odometry.selection.pose_confidence import of_evidence, worst_axis

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from hybridreg_ros.odometry.motion.prediction import Expected
    from hybridreg_ros.odometry.network_branch import Proposal
    from hybridreg_ros.odometry.preprocessed import PreprocessedScan
    from hybridreg_ros.odometry.registration.alignment import Fit
    from hybridreg_ros.odometry.selection.pose_confidence import PoseEvidence

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]

_SEEN = 0.2
"""Least share of the points that must find the map, and lie in directions seen: evidence of fewer
is none."""
_FIRM = 0.2
"""Largest standard deviation along the worst axis, voxels, of a scan that may change the map."""
_KNOWN = 0.8
"""Share of the points that must find the map for it to show the place already."""
_LEFT = 0.2
"""A mask of the network that leaves less of the trusted points says that it recognises nothing,
not that all of them move: poses are judged without it."""
UNHELD = 0.3
"""P(right) of a pose along a direction that nothing holds: a normal error of 0.5 m is within 0.2 m
with this probability."""
AGAINST = 3.0
"""Log odds that a pose loses per tenfold distance from the predicted one, beyond what is usual: as
logistic models fitted to poses of development sequences have it (2.7 to 3.5)."""


@dataclass(frozen=True, eq=False)
class Sought:
    """A scan whose pose is looked for.

    Attributes:
        cloud: the preprocessed scan.
        trust: (K,) weight per registered point, [0, 1].
        still: (K,) the same of the points by which poses are judged.
        expected: pose by constant velocity; None = nothing is expected.
        prior: the same, as wide as it may hold a pose.
    """

    cloud: PreprocessedScan
    trust: F32
    still: F32
    expected: Expected | None = None
    prior: Expected | None = None

    def judged_by(self, proposal: Proposal | None) -> Sought:
        """It, judged without the points that the mask of the network knows to move.

        Not where nothing is expected: after a loss the mask is that of a pose that may be wrong.
        """
        if proposal is None or self.expected is None:
            return replace(self, still=self.trust)
        still = self.trust * (1.0 - proposal.uncertainty[self.cloud.icp_in_map])
        knows = (still > 0.5).sum() >= _LEFT * (self.trust > 0.5).sum()
        return replace(self, still=still if knows else self.trust)


@dataclass(frozen=True, eq=False)
class Candidate:
    """A pose found for a scan.

    Attributes:
        fit: the pose in the map.
        source: the branch that made it.
        reason: why that branch.
        evidence: what speaks for the pose.
        reported: (4, 4) it at the instant that is asked for.
        innovation: how far it is off the predicted one (`innovation`).
        vouched: confidence of the network in its own pose, [0, 1]; 1 of the other branch.
        doubt: log odds by which that is less than what a pose must have to be trusted.
        tentative: taken only since it is as the motion leads one to expect: better than none, but
            its scan is a bad one.
    """

    fit: Fit
    source: Source
    reason: Reason
    evidence: PoseEvidence
    reported: F64
    innovation: float = 0.0
    vouched: float = 1.0
    doubt: float = 0.0
    tentative: bool = False

    @property
    def is_seen(self) -> bool:
        """Whether enough is known of where it stands to judge it at all."""
        return min(self.evidence.overlap, self.evidence.seen) >= _SEEN

    @cached_property
    def evident(self) -> float:
        """P(pose right) by the evidence alone, [0, 1]."""
        return of_evidence(self.evidence) if self.is_seen else 0.0

    @property
    def confidence(self) -> float:
        """P(pose right) by the evidence and, of its poses, the network, [0, 1]."""
        return min(self.vouched, self.evident)

    @property
    def score(self) -> float:
        """Log odds that it is right: by the evidence, less its innovation and the doubt."""
        return log_odds(self.evident) - AGAINST * max(0.0, self.innovation) - self.doubt

    @cached_property
    def rank(self) -> float:
        """By which the best of several is chosen: what nothing holds is as the prediction is."""
        return self.score + (log_odds(UNHELD) if self.fit.unheld.any() else 0.0)

    def adds_to_map(self, sure: float, voxel_size_m: float) -> bool:
        """Whether the scan enters the map: not in doubt or held loosely where the map shows it."""
        firm = self.evidence.worst_axis <= worst_axis(_FIRM * voxel_size_m)
        known = self.evidence.overlap >= _KNOWN
        return (self.confidence >= sure and firm) or not (self.tentative or known)


def is_worth_it(
    doubtful: Candidate, considered: Iterable[Candidate], voxel_size_m: float, accept: float
) -> bool:
    """Whether a pose that little speaks for is better than none.

    One as expected is no worse than the prediction itself, unless the scan stands well elsewhere:
    then the motion has changed.

    Args:
        doubtful: the best pose found.
        considered: every pose that was judged for its scan.
        voxel_size_m: voxel of the map; poses so far apart are different ones.
        accept: confidence from which another one speaks against it.
    """
    pose = doubtful.fit.T_odom_sensor
    rivals = (
        c.evident * min(1.0, apart(pose, c.fit.T_odom_sensor, voxel_size_m, 1.0))
        for c in considered
    )
    return doubtful.innovation < 0.0 and max(rivals) < accept


_USUAL = 0.1
"""Deviation from the prediction, in its units, below which less says nothing more."""


_SUREST = 1e-3
"""Confidences within this of 0 and 1 count alike."""


def log_odds(confidence: float) -> float:
    """Log odds of a confidence in [0, 1]."""
    kept = min(max(confidence, _SUREST), 1.0 - _SUREST)
    return float(np.log(kept / (1.0 - kept)))


def innovation(pose: F64, expected: Expected | None, voxel_size_m: float) -> float:
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
    return float(np.log10(_USUAL + apart(expected.pose, pose, *usual)))


def runner_up(pose: F64, considered: Iterable[Candidate], voxel_size_m: float) -> float:
    """How plausible the surest pose is that another way led to.

    Args:
        pose: (4, 4) the pose that was chosen.
        considered: every pose that was judged for its scan.
        voxel_size_m: one so far off, or off by one degree, is a different pose; one nearer counts
            by its distance. One that is likelier wrong than right, as far as it is off the
            prediction, is none.

    Returns:
        Its confidence, [0, 1].
    """
    others = (
        c.evident * min(1.0, apart(pose, c.fit.T_odom_sensor, voxel_size_m, 1.0))
        for c in considered
        if c.score >= 0.0
    )
    return max(others, default=0.0)


def apart(one: F64, other: F64, metres: float, degrees: float) -> float:
    """Distance of two poses (4, 4), shift and turn together, each in its unit."""
    off = se3.inverse(one) @ other
    shift = float(np.linalg.norm(off[:3, 3])) / metres
    return float(np.hypot(shift, se3.rotation_angle_deg(off[:3, :3]) / degrees))

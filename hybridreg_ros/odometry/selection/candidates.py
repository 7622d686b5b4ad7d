# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Poses under judgement and poses that passed."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import RegistrationError
from hybridreg_ros.odometry.result import Reason, Source
from hybridreg_ros.odometry.selection.pose_confidence import FIRM, of_evidence, worst_axis

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

    from hybridreg_ros.odometry.motion.prediction import Expected
    from hybridreg_ros.odometry.registration.alignment import Fit
    from hybridreg_ros.odometry.selection.pose_confidence import PoseEvidence, Verdict

    F64 = NDArray[np.float64]

_log = logging.getLogger(__name__)

_FIRM = 0.2
"""Largest standard deviation along the worst axis, voxels, of a scan that may change the map."""
_KNOWN = 0.8
"""Share of the points that must find the map for it to show the place already."""
UNHELD = 0.3
"""P(right) of a pose along a direction that nothing holds: a normal error of 0.5 m is within 0.2 m
with this probability."""
AGAINST = 3.0
"""Log odds that a pose loses per tenfold distance from the predicted one, beyond what is usual: as
logistic models fitted to poses of development sequences have it (2.7 to 3.5)."""


@dataclass(frozen=True, eq=False)
class Located:
    """A pose that passed its checks.

    Attributes:
        fit: the pose in the map.
        evidence: what speaks for it.
        source: the branch that made it.
        reason: why that branch.
        confidence: P(pose right) by the evidence and, of its poses, the network, [0, 1].
        evident: by the evidence alone, [0, 1].
        innovation: how far it is off the predicted pose (`innovation`).
        rank: by which the best of several is chosen (`rank`).
        tentative: taken only since it is as the motion leads one to expect: better than none, but
            its scan is a bad one.
    """

    fit: Fit
    evidence: PoseEvidence
    source: Source
    reason: Reason
    confidence: float
    evident: float
    innovation: float = 0.0
    rank: float = 0.0
    tentative: bool = False

    def adds_to_map(self, sure: float, voxel_size_m: float) -> bool:
        """Whether the scan enters the map: not in doubt or held loosely where the map shows it."""
        firm = self.evidence.worst_axis <= worst_axis(_FIRM * voxel_size_m)
        known = self.evidence.overlap >= _KNOWN
        return (self.confidence >= sure and firm) or not (self.tentative or known)


@dataclass(frozen=True, eq=False)
class Candidate:
    """A pose under judgement.

    Attributes:
        fit: the pose in the map.
        evidence: what speaks for it.
        verdict: confidence by the evidence, and faults.
        reported: (4, 4) it at the instant that is asked for.
        innovation: how far it is off the predicted one (`innovation`).
        rank: by which the best of several is chosen (`rank`).
    """

    fit: Fit
    evidence: PoseEvidence
    verdict: Verdict
    reported: F64
    innovation: float = 0.0
    rank: float = 0.0


def rank(
    evidence: PoseEvidence, verdict: Verdict, innovation: float, soon: bool, held: bool = True
) -> float:
    """Order of the poses found for one scan: log odds by the evidence, less by distance.

    How loosely a pose is held says how far off it may be, not which of two is the right one: a
    wrong one is often the stiffer. So that does not count where the motion says where the scan is.
    One that nothing holds along a direction is only as good there as the prediction.

    Args:
        evidence: what speaks for the pose.
        verdict: its confidence and faults; a pose with a fault comes last.
        innovation: how far it is off the predicted one (`innovation`).
        soon: whether the scan follows the last one closely.
        held: whether surfaces hold the pose in all directions.
    """
    if verdict.fault is not None:
        return -np.inf
    firm = of_evidence(replace(evidence, worst_axis=FIRM)) if soon else verdict.confidence
    return against_motion(firm if held else UNHELD * firm, innovation)


def against_motion(confidence: float, innovation: float) -> float:
    """Log odds of a pose by the evidence, less by its distance from the predicted one.

    Args:
        confidence: by the evidence, [0, 1].
        innovation: how far the pose is off the predicted one (`innovation`); below 0 it
            does not count, since then it is within what is usual.
    """
    return log_odds(confidence) - AGAINST * max(0.0, innovation)


def located_by_kiss(found: Candidate, reason: Reason, tentative: bool = False) -> Located:
    """A pose that kiss-icp made; its evidence is all that speaks for it."""
    confidence = found.verdict.confidence
    return Located(
        found.fit,
        found.evidence,
        Source.KISS_ICP,
        reason,
        confidence,
        confidence,
        innovation=found.innovation,
        rank=found.rank,
        tentative=tentative,
    )


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
    return (
        doubtful.innovation < 0.0
        and runner_up(pose, considered, voxel_size_m, refused=True) < accept
    )


def better(one: Candidate | None, other: Candidate | None) -> Candidate | None:
    """The one of higher rank; the first when they are equal."""
    if one is None or other is None:
        return one or other
    return other if other.rank > one.rank else one


def tried(way: Callable[[], Fit | None], check: Callable[[Fit], Candidate]) -> Candidate | None:
    """Outcome of one way to register, judged; None when it cannot, or finds nothing new."""
    try:
        fit = way()
        return None if fit is None else check(fit)
    except RegistrationError as error:
        _log.debug('fallback: %s', error)
        return None


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


def runner_up(
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
        * min(1.0, apart(pose, c.fit.T_odom_sensor, voxel_size_m, 1.0))
        for c in considered
    )
    return max(others, default=0.0)


def apart(one: F64, other: F64, metres: float, degrees: float) -> float:
    """Distance of two poses (4, 4), shift and turn together, each in its unit."""
    off = se3.inverse(one) @ other
    shift = float(np.linalg.norm(off[:3, 3])) / metres
    return float(np.hypot(shift, se3.rotation_angle_deg(off[:3, :3]) / degrees))

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Locator: ways to the pose of a scan, one after another until one is sure, and the best pose."""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.errors import RegistrationError
from hybridreg_ros.odometry.load import FULL
from hybridreg_ros.odometry.registration import covariance
from hybridreg_ros.odometry.registration.alignment import align_scan
from hybridreg_ros.odometry.result import Reason, Source
from hybridreg_ros.odometry.selection import reported_confidence
from hybridreg_ros.odometry.selection.candidates import (
    Candidate,
    Sought,
    apart,
    innovation,
    is_worth_it,
    log_odds,
)
from hybridreg_ros.odometry.selection.fallback import Fallback
from hybridreg_ros.odometry.selection.pose_confidence import worst_axis

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from hybridreg_ros.odometry.config import OdometryConfig
    from hybridreg_ros.odometry.load import Effort
    from hybridreg_ros.odometry.motion.prediction import Expected
    from hybridreg_ros.odometry.network_branch import Encoded, LearnedBranch, Proposal
    from hybridreg_ros.odometry.preprocess import SensorModel
    from hybridreg_ros.odometry.preprocessed import PreprocessedScan
    from hybridreg_ros.odometry.registration.alignment import Basin, Fit
    from hybridreg_ros.odometry.result import Watch
    from hybridreg_ros.odometry.world import World

    F64 = NDArray[np.float64]
    F32 = NDArray[np.float32]

_log = logging.getLogger(__name__)

_HEED = np.array([4.0, 2.0])
"""Factors on the spread of shift and turn that the motion so far had, before a pose is held by it:
things start and stop."""
_TOLD_AGAIN = {'depth': 1.0, 'lidar': 6.66}
"""Factor by which the registered points seem surer of a pose than they are (of a lidar, normals
err alike over many): measured as what made poses amid scans consistent (NEES of 44)."""
_FAR = 3.0
"""A pose farther off the expected one, in standard deviations, is another opinion than it."""
_NETWORK_SPREAD = 0.2, float(np.deg2rad(0.3))
"""Standard deviation of the network's poses along each axis, in voxels of the map and radians: of
six recorded and simulated sequences, half are within 0.2 voxels and 0.3 degrees of the aligned
pose, all axes together (docs/lab/2026-11-29-step-time.md)."""


class Locator:
    """The two branches behind one question: where is this scan?

    Each way leads to a candidate. The first that is sure ends the search; else the one that ranks
    highest of all is the pose, if it is likely enough.

    Args:
        config: settings.
        sensor: what the sensor is.
        world: the map of both branches, keyframes, and what earlier scans saw.
        learned: the network branch, or None.

    Attributes:
        judged: every pose that was considered for the last scan.
    """

    def __init__(
        self,
        config: OdometryConfig,
        sensor: SensorModel,
        world: World,
        learned: LearnedBranch | None,
    ) -> None:
        self._config = config
        self._voxel_m = sensor.voxel_size_m
        self._world = world
        self._learned = learned
        self._fallback = Fallback(config, sensor, world.map)
        self._no_network = (
            Reason.REGISTRAR_KISS_ICP if config.registrar == 'kiss-icp' else Reason.NO_WEIGHTS
        )
        self._heed = _HEED / _TOLD_AGAIN[sensor.kind]
        self._network_spread = _NETWORK_SPREAD[0] * sensor.voxel_size_m, _NETWORK_SPREAD[1]
        self.judged: list[Candidate] = []

    def locate(
        self,
        cloud: PreprocessedScan,
        asked: tuple[Encoded | None, Proposal | None],
        expected: Expected,
        last: F64,
        trust: F32,
        watch: Watch,
        effort: Effort,
    ) -> Candidate | Reason:
        """Pose by the network when it is sure, else the best of all ways; or why there is none.

        Args:
            cloud: the preprocessed scan.
            asked: it encoded for the quick look, None without a network; and what the network
                says of it, where it has been asked.
            expected: pose by constant velocity.
            last: (4, 4) last pose.
            trust: (K,) weight per registered point.
            watch: books the time per stage.
            effort: how much is tried while the pose is in doubt.
        """
        scan = Sought(cloud, trust, trust, expected, expected.widened(*self._heed))
        proposals = self._proposals(cloud, *asked, expected, effort.thorough)
        return self._found(scan, proposals, [expected.pose, last], effort.thorough, watch)

    def relocate(self, cloud: PreprocessedScan, last: F64, watch: Watch) -> Candidate | Reason:
        """Pose of a scan when the last pose says little: by keyframes, else by the fallback.

        Args:
            cloud: the preprocessed scan.
            last: (4, 4) last pose before the loss.
            watch: books the time per stage.
        """
        every = np.ones(len(cloud.icp_rows), np.float32)
        scan = Sought(cloud, every, every)
        found = self._found(scan, self._nearest(cloud, last), [last], True, watch)
        if isinstance(found, Candidate) and found.confidence < self._config.gate.enter:
            return Reason.LOW_CONFIDENCE
        return found

    def confidence_of(self, found: Candidate) -> reported_confidence.ReportedConfidence:
        """What is known of the pose that was found for the last scan, all ways considered."""
        return reported_confidence.of(found, self.judged, self._voxel_m)

    def _found(
        self,
        scan: Sought,
        proposals: Iterable[Proposal | None],
        guesses: Sequence[F64],
        wide: bool,
        watch: Watch,
    ) -> Candidate | Reason:
        """The candidate of the first way that is sure, else of the best; or why none is taken."""
        self.judged, why = [], self._no_network
        for proposal in proposals:
            watch.lap('match')
            why, scan = Reason.LOW_CONFIDENCE, scan.judged_by(proposal)
            if proposal is not None and proposal.confidence >= self._config.gate.accept:
                why = self._by_network(scan, proposal)
            watch.lap('refine')
            if self._is_sure():
                if self._is_expected(self._best(), scan.expected):
                    return self._best()
                break
        for way in self._fallback.ways(scan, guesses, wide):
            try:
                self._judge(scan, way(), Source.KISS_ICP, why)
            except RegistrationError as error:
                _log.debug('fallback: %s', error)
            if self.judged and self._best().rank > log_odds(self._config.gate.sure):
                break
        return self._outcome()

    def _proposals(
        self,
        cloud: PreprocessedScan,
        scan: Encoded | None,
        first: Proposal | None,
        expected: Expected,
        thorough: bool,
    ) -> Iterator[Proposal | None]:
        """What the network says of a scan, in a quick look and at the full budget."""
        if self._learned is None:
            return
        keyframe = self._world.keyframes.to_match(expected.pose)
        yield first or self._learned.propose(scan, keyframe)
        if thorough:
            finer = self._learned.encode_finer(cloud.map_points, scan, FULL)
            if finer is not None:
                yield self._learned.propose(finer, keyframe)

    def _nearest(self, cloud: PreprocessedScan, last: F64) -> Iterator[Proposal | None]:
        """What the network says of a scan against each of the keyframes nearest to a pose."""
        if self._learned is None:
            return
        scan = self._learned.encode(cloud.map_points, FULL)
        for keyframe in self._world.keyframes.nearest(last, self._config.lost.keyframes_tried):
            yield self._learned.propose(scan, keyframe)

    def _by_network(self, scan: Sought, proposal: Proposal) -> Reason:
        """Align the network's pose with the map; why the result is not taken, if it is not."""
        start, prior = proposal.T_odom_sensor, scan.prior
        basin: Basin = 'middle'
        if prior is not None and not self._is_near(prior, start):
            prior = None
        if prior is not None and scan.expected is not None:
            start, basin = self._start_between(start, scan.expected, scan.cloud)
        fit = align_scan(scan.cloud, start, self._world.map, scan.trust, basin, prior)
        found = self._judge(scan, fit, Source.HYBRIDREG, Reason.OK, proposal.confidence)
        doubt = Reason.LOW_CONFIDENCE
        if not self._is_expected(found, scan.expected):
            doubt = Reason.DISAGREES_WITH_MOTION
        return self._fault(found) or doubt

    def _is_near(self, prior: Expected, pose: F64) -> bool:
        """Whether a pose (4, 4) of the network is one that the motion so far may expect.

        How far off is too far follows from the spread of both: a pose of the network is good to
        a part of a voxel, a prediction of a fast sensor much better. One that is farther off is
        an opinion of its own, not to be drawn to the expected pose.
        """
        shift_m, turn_rad = self._network_spread
        both = replace(
            prior,
            shift_m=float(np.hypot(prior.shift_m, shift_m)),
            turn_rad=float(np.hypot(prior.turn_rad, turn_rad)),
        )
        return bool(np.abs(both.off(pose)).max() <= _FAR)

    def _start_between(
        self, pose: F64, expected: Expected, cloud: PreprocessedScan
    ) -> tuple[F64, Basin]:
        """Where and how sharply the alignment starts, when the network agrees with the motion.

        That is the mean of a pose of the network and the expected one, weighed by what each is
        worth: often it is far less than a voxel off.

        Args:
            pose: (4, 4) of the network.
            expected: by the motion so far.
            cloud: the preprocessed scan.
        """
        best = expected.fused(pose, *self._network_spread)
        sure = _FAR * (best.shift_m + cloud.reach_m * best.turn_rad) < self._world.map.fine.size_m
        return best.pose, 'fine' if sure else 'near'

    def _best(self) -> Candidate:
        """The candidate of the highest rank so far; at its place, one that the network is sure of.

        Two ways to one place tell of the same pose, unless what the scan sees from it (bent by
        another motion within the scan, say) speaks for one alone.
        """
        best = max(self.judged, key=lambda c: c.rank)
        pose, sure = best.fit.T_odom_sensor, log_odds(self._config.gate.sure)
        same = [
            c
            for c in self.judged
            if c.rank > sure
            and c.doubt == 0.0
            and apart(c.fit.T_odom_sensor, pose, self._voxel_m, 1.0) < 1.0
        ]
        return max(same, key=lambda c: (c.source is Source.HYBRIDREG, c.rank), default=best)

    def _is_sure(self) -> bool:
        """Whether the best pose so far needs no other opinion, but perhaps one near by."""
        told = self.confidence_of(self._best()).confidence if self.judged else 0.0
        return told >= self._config.gate.sure

    def _is_expected(self, found: Candidate, expected: Expected | None) -> bool:
        """Whether a pose is not off the prediction by more than is usual.

        Where a structure repeats (stairs, shelves) every way finds any period of it, so one that
        is farther off is not taken until kiss-icp has looked near the prediction. While
        predictions have not been proven, a voxel is that far.
        """
        pose = found.fit.T_odom_sensor
        if expected is None or apart(expected.pose, pose, self._voxel_m, 1.0) < 1.0:
            return True
        return expected.is_proven and bool(np.abs(expected.off(pose)).max() <= _FAR)

    def _is_likely(self, found: Candidate) -> bool:
        """Whether a candidate is likely enough to be taken."""
        return found.score >= log_odds(self._config.gate.accept)

    def _fault(self, found: Candidate) -> Reason | None:
        """Why a candidate is not likely enough to be taken; None when it is."""
        if self._is_likely(found):
            return None
        if not found.is_seen:
            return Reason.NO_OVERLAP
        evident = found.evident >= self._config.gate.accept
        return Reason.DISAGREES_WITH_MOTION if evident else Reason.REFINEMENT_FAILED

    def _outcome(self) -> Candidate | Reason:
        """The best candidate, if it is likely enough or no worse than the prediction."""
        if not self.judged:
            return Reason.REFINEMENT_FAILED
        best = self._best()
        fault = self._fault(best)
        if fault is None:
            return best
        if fault is not Reason.REFINEMENT_FAILED:
            return fault
        if is_worth_it(best, self.judged, self._voxel_m, self._config.gate.accept):
            return replace(best, reason=Reason.LOW_CONFIDENCE, tentative=True)
        return Reason.LOW_CONFIDENCE

    def _judge(
        self, scan: Sought, fit: Fit, source: Source, reason: Reason, vouched: float = 1.0
    ) -> Candidate:
        """A pose with what speaks for it, judged by the points that do not move."""
        cloud, pose = scan.cloud, fit.T_odom_sensor
        points = cloud.icp_with(fit.intra_scan)[scan.still > 0.5]
        spread = covariance.of_fit(fit, cloud.reported_s - cloud.instant_s, 1.0)
        evidence = replace(
            self._world.sightings.evidence(points, pose, fit.overlap),
            worst_axis=worst_axis(covariance.weakest_m(spread)),
        )
        reported = cloud.reported(pose, fit.intra_scan)
        off = innovation(pose, scan.expected, self._voxel_m)
        doubt = max(0.0, log_odds(self._config.gate.enter) - log_odds(vouched))
        candidate = Candidate(fit, source, reason, evidence, reported, off, vouched, doubt)
        self.judged.append(candidate)
        return candidate

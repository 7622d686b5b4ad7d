# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Locator: which branch gives the pose of a scan, checked by what the scan sees there."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.odometry.load import FULL
from hybridreg_ros.odometry.registration import covariance
from hybridreg_ros.odometry.registration.alignment import align_scan
from hybridreg_ros.odometry.result import Reason, Source
from hybridreg_ros.odometry.selection import candidates, reported_confidence
from hybridreg_ros.odometry.selection.candidates import (
    Candidate,
    Located,
    better,
    located_by_kiss,
    tried,
)
from hybridreg_ros.odometry.selection.fallback import Fallback
from hybridreg_ros.odometry.selection.pose_confidence import (
    Verdict,
    judge,
    worst_axis,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

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
_NO_DOUBT, _STANDS = 0.95, 0.9
"""Confidence, and share of the points on what an earlier scan saw, at which the first pose of
kiss-icp needs no second opinion."""
_SOON_S = 0.15
"""So soon after the last scan the motion says where this one is; later much can have happened."""
_JUMP = 0.5
"""A pose three times as far off the prediction as is usual, and out of reach, has jumped: it is
taken only where that is more likely than not, all things considered."""
_LEFT = 0.2
"""A mask of the network that leaves less of the trusted points says that it recognises nothing,
not that all of them move: poses are judged without it."""


class Locator:
    """The two branches behind one question: where is this scan?

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
        self._sure = config.gate.sure
        self._no_network = (
            Reason.REGISTRAR_KISS_ICP if config.registrar == 'kiss-icp' else Reason.NO_WEIGHTS
        )
        self._rigour = _TOLD_AGAIN[sensor.kind]
        self._network_spread = _NETWORK_SPREAD[0] * sensor.voxel_size_m, _NETWORK_SPREAD[1]
        self._prior: Expected | None = None
        self._reach_m: float | None = None
        self.learn = self._fallback.learn
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
    ) -> Located | Reason:
        """Pose by the network when it is trusted, else by the fallback; or why there is none.

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
        self.judged = []
        self._prior = expected.widened(*(_HEED / self._rigour))
        self._reach_m = min(expected.shift_m, self._prior.shift_m)
        check: Callable[[Fit], Candidate] = partial(self._judged, cloud, trust, expected)
        found: Located | Reason = self._no_network
        for proposal in self._proposals(cloud, *asked, expected, effort.thorough):
            watch.lap('match')
            check = self._check(cloud, trust, expected, proposal)
            other = self._by_network(cloud, proposal, trust, check, expected)
            watch.lap('refine')
            found = other if _is_better(other, found) else found
            if isinstance(found, Located) and self._is_sure(found):
                return self._or_nearer(found, cloud, trust, expected, check)
        why = found if isinstance(found, Reason) else Reason.LOW_CONFIDENCE
        other = self._by_fallback(cloud, [expected.pose, last], trust, check, why, effort.thorough)
        return other if _is_better(other, found) else found

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

    def _is_sure(self, found: Located) -> bool:
        """Whether a pose of the network is taken without another opinion."""
        return self.confidence_of(found).confidence >= self._sure

    def _check(
        self, cloud: PreprocessedScan, trust: F32, expected: Expected, proposal: Proposal | None
    ) -> Callable[[Fit], Candidate]:
        """How poses are judged: without the points that the mask of the network knows to move."""
        if proposal is not None:  # it knows of those who came since the last scan
            still = trust * (1.0 - proposal.uncertainty[cloud.icp_in_map])
            if (still > 0.5).sum() >= _LEFT * (trust > 0.5).sum():
                trust = still
        return partial(self._judged, cloud, trust, expected)

    def confidence_of(self, found: Located) -> reported_confidence.ReportedConfidence:
        """What is known of the pose that was found for the last scan, all ways considered."""
        return reported_confidence.of(found, self.judged, self._voxel_m)

    def relocate(self, cloud: PreprocessedScan, last: F64) -> Located | Reason:
        """Pose of a scan when the last pose says little: by keyframes, else by the fallback.

        Args:
            cloud: the preprocessed scan.
            last: (4, 4) last pose before the loss.
        """
        trust = np.ones(len(cloud.icp_rows), np.float32)
        self.judged, self._prior, self._reach_m = [], None, None
        check = partial(self._judged, cloud, trust, None)
        found: Located | Reason = self._no_network
        if self._learned is not None:
            scan = self._learned.encode(cloud.map_points, FULL)
            for keyframe in self._world.keyframes.nearest(last, self._config.lost.keyframes_tried):
                proposal = self._learned.propose(scan, keyframe)
                other = self._by_network(cloud, proposal, trust, check)
                found = other if _is_better(other, found) else found
                if isinstance(found, Located) and self._is_sure(found):
                    return found
        other = self._by_fallback(cloud, [last], trust, check, Reason.RECOVERED)
        found = other if _is_better(other, found) else found
        if isinstance(found, Located) and found.confidence < self._config.gate.enter:
            return Reason.LOW_CONFIDENCE
        return found

    def _without_doubt(self, found: Candidate) -> bool:
        """Whether a pose is taken without a second opinion.

        Confidence alone is not enough: at a wrong pose along walls most points find the map too,
        and one that nothing holds along a direction is the prediction itself.
        """
        sure = found.verdict.confidence >= _NO_DOUBT and found.evidence.consistent >= _STANDS
        return sure and not found.fit.unheld.any()

    def _followed(
        self,
        cloud: PreprocessedScan,
        predicted: F64,
        trust: F32,
        check: Callable[[Fit], Candidate],
    ) -> Candidate | None:
        """Fallback from the prediction, or None when it cannot register.

        kiss-icp widens its search with the errors of all predictions so far, and then finds the
        next shelf as well. So a pose far off the prediction must be better than what is found
        close to it.
        """
        wide = tried(
            partial(self._fallback.follow, cloud, predicted, trust, prior=self._prior), check
        )
        if wide is None or not self._is_far(wide.fit.T_odom_sensor):
            return wide
        return better(wide, tried(self._near(cloud, predicted, trust, wide), check))

    def _or_nearer(
        self,
        found: Located,
        cloud: PreprocessedScan,
        trust: F32,
        expected: Expected,
        check: Callable[[Fit], Candidate],
    ) -> Located:
        """A sure pose of the network, or a better one close to the prediction.

        Where a structure repeats (stairs, shelves) the network finds any period of it. While
        predictions have not been proven, every pose that is off by a voxel is such a one.
        """
        pose = found.fit.T_odom_sensor
        off = candidates.apart(expected.pose, pose, self._voxel_m, 1.0)
        likely = expected.is_proven and np.abs(expected.off(pose)).max() <= _FAR
        if off < 1.0 or likely:
            return found
        nearer = tried(self._near(cloud, expected.pose, trust, found), check)
        if nearer is None or nearer.rank <= found.rank:
            return found
        if candidates.apart(nearer.fit.T_odom_sensor, pose, self._voxel_m, 1.0) < 1.0:
            return found  # the same place
        return located_by_kiss(nearer, Reason.DISAGREES_WITH_MOTION)

    def _near(
        self,
        cloud: PreprocessedScan,
        predicted: F64,
        trust: F32,
        known: Candidate | Located | None,
    ) -> Callable[[], Fit | None]:
        """Way to register close to the prediction; it leads to nothing the second time."""
        prior, reach_m, self._reach_m = self._prior, self._reach_m, None
        if prior is None or reach_m is None:
            return lambda: None
        pose = None if known is None else known.fit.T_odom_sensor
        return partial(self._fallback.follow_near, cloud, predicted, trust, prior, reach_m, pose)

    def _is_far(self, pose: F64) -> bool:
        """Whether a pose (4, 4) is far off the expected one for what predictions have been."""
        return self._prior is not None and bool(np.abs(self._prior.off(pose)).max() > _FAR)

    def _prior_near(self, pose: F64) -> Expected | None:
        """What the motion so far expects, for a pose (4, 4) of the network near it; else None.

        How far off is too far follows from the spread of both: a pose of the network is good to
        a part of a voxel, a prediction of a fast sensor much better. One that is farther off is
        an opinion of its own, not to be drawn to the expected pose.
        """
        if self._prior is None:
            return None
        shift_m, turn_rad = self._network_spread
        both = replace(
            self._prior,
            shift_m=float(np.hypot(self._prior.shift_m, shift_m)),
            turn_rad=float(np.hypot(self._prior.turn_rad, turn_rad)),
        )
        return self._prior if np.abs(both.off(pose)).max() <= _FAR else None

    def _start_between(
        self, pose: F64, expected: Expected, cloud: PreprocessedScan
    ) -> tuple[F64, Basin]:
        """Where and how coarsely the alignment starts, when the network agrees with the motion.

        The coarse pull is for guesses that may be a voxel off; the mean of a pose of the network
        and the expected one, weighed by what each is worth, often is not.

        Args:
            pose: (4, 4) of the network.
            expected: by the motion so far.
            cloud: the preprocessed scan.
        """
        best = expected.fused(pose, *self._network_spread)
        sure = _FAR * (best.shift_m + cloud.reach_m * best.turn_rad) < self._world.map.fine.size_m
        return best.pose, 'fine' if sure else 'near'

    def _by_network(
        self,
        cloud: PreprocessedScan,
        proposal: Proposal | None,
        trust: F32,
        check: Callable[[Fit], Candidate],
        expected: Expected | None = None,
    ) -> Located | Reason:
        """The network's pose, refined in the map; or why it is not taken."""
        if proposal is None:
            return Reason.LOW_CONFIDENCE
        if proposal.confidence < self._config.gate.enter:
            return Reason.LOW_CONFIDENCE
        start = proposal.T_odom_sensor
        prior = self._prior_near(start)
        basin: Basin = 'near'
        if prior is not None and expected is not None:
            start, basin = self._start_between(start, expected, cloud)
        fit = align_scan(cloud, start, self._world.map, trust, basin, prior)
        candidate = check(fit)
        if candidate.verdict.fault is not None:
            return candidate.verdict.fault
        if candidate.verdict.confidence < self._config.gate.accept:
            return Reason.REFINEMENT_FAILED
        return Located(
            fit,
            candidate.evidence,
            Source.HYBRIDREG,
            Reason.OK,
            min(proposal.confidence, candidate.verdict.confidence),
            candidate.verdict.confidence,
            candidate.innovation,
            candidate.rank,
        )

    def _by_fallback(
        self,
        cloud: PreprocessedScan,
        guesses: Sequence[F64],
        trust: F32,
        check: Callable[[Fit], Candidate],
        reason: Reason,
        wide: bool = True,
    ) -> Located | Reason:
        """Fallback from the guesses; while in doubt, other ways and turned guesses. Best wins."""
        gate = self._config.gate
        best = self._followed(cloud, guesses[0], trust, check)
        if best is None or not self._without_doubt(best):
            ways = self._other_ways(cloud, guesses, trust, best)
            for way in ways if wide else islice(ways, 1):
                best = better(best, tried(way, check))
                if best is not None and best.verdict.confidence >= gate.sure:
                    break
        if best is None:
            return Reason.REFINEMENT_FAILED
        if best.verdict.fault is not None:
            return best.verdict.fault
        if best.verdict.confidence < gate.accept:
            if not candidates.is_worth_it(best, self.judged, self._voxel_m, gate.accept):
                return Reason.LOW_CONFIDENCE
            return located_by_kiss(best, Reason.LOW_CONFIDENCE, tentative=True)
        return located_by_kiss(best, reason)

    def _other_ways(
        self, cloud: PreprocessedScan, guesses: Sequence[F64], trust: F32, first: Candidate | None
    ) -> Iterator[Callable[[], Fit | None]]:
        """Ways to register without a network where following the prediction leaves doubt.

        A crowd that comes into view draws kiss-icp away from the pose by more than predictions
        are usually off, and every guess ends there then; with near partners alone it does not.
        """
        fallback, prior = self._fallback, self._prior
        yield self._near(cloud, guesses[0], trust, first)
        yield partial(fallback.locate, cloud, guesses, trust, prior)
        for guess in fallback.search(cloud, guesses[0]):
            yield partial(fallback.locate, cloud, [guess], trust)

    def _judged(
        self, cloud: PreprocessedScan, trust: F32, expected: Expected | None, fit: Fit
    ) -> Candidate:
        """A pose with what speaks for it, judged by the points that do not move."""
        points = cloud.icp_with(fit.intra_scan)[trust > 0.5]
        spread = covariance.of_fit(fit, cloud.reported_s - cloud.instant_s, 1.0)
        evidence = replace(
            self._world.sightings.evidence(points, fit.T_odom_sensor, fit.overlap),
            worst_axis=worst_axis(covariance.weakest_m(spread)),
        )
        predicted, dt_s = (None, 0.0) if expected is None else (expected.pose, expected.seconds)
        verdict = judge(
            evidence,
            fit.T_odom_sensor,
            predicted,
            dt_s,
            self._voxel_m,
            self._config.gate.max_jump_m,
        )
        reported = cloud.reported(fit.T_odom_sensor, fit.intra_scan)
        off = candidates.innovation(fit.T_odom_sensor, expected, self._voxel_m)
        if expected is not None and off > _JUMP and expected.is_out_of_reach(fit.T_odom_sensor):
            unlikely = (
                verdict.fault is None and candidates.against_motion(verdict.confidence, off) < 0.0
            )
            verdict = Verdict(0.0, Reason.DISAGREES_WITH_MOTION) if unlikely else verdict
        held = not fit.unheld.any()
        order = candidates.rank(evidence, verdict, off, 0.0 < dt_s <= _SOON_S, held)
        candidate = Candidate(fit, evidence, verdict, reported, off, order)
        self.judged.append(candidate)
        return candidate


def _is_better(other: Located | Reason, found: Located | Reason) -> bool:
    """Whether the outcome of another way is a pose of higher rank than the one found, if any."""
    if not isinstance(found, Located):
        return True
    return isinstance(other, Located) and other.rank > found.rank

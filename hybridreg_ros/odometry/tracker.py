# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Tracker: from a preprocessed cloud to a pose, through network, fallback, coasting or loss."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.heap import give_back
from hybridreg_ros.core.scan import NS_PER_S
from hybridreg_ros.odometry.locator import Locator
from hybridreg_ros.odometry.motion.intra_scan_motion import IntraScanMotion
from hybridreg_ros.odometry.network_branch import LearnedBranch
from hybridreg_ros.odometry.registration import covariance
from hybridreg_ros.odometry.registration.covariance import Surroundings
from hybridreg_ros.odometry.registration.planar import in_plane
from hybridreg_ros.odometry.registration.scan_continuity import ScanContinuity
from hybridreg_ros.odometry.result import Reason, Source
from hybridreg_ros.odometry.selection import calibration
from hybridreg_ros.odometry.selection.candidates import UNHELD, Candidate
from hybridreg_ros.odometry.world import World

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from hybridreg_ros.model.budget import Budget
    from hybridreg_ros.model.static_points import PointMask
    from hybridreg_ros.odometry.config import OdometryConfig
    from hybridreg_ros.odometry.keyframes import Keyframe
    from hybridreg_ros.odometry.load import Effort
    from hybridreg_ros.odometry.motion.prediction import Motion
    from hybridreg_ros.odometry.network_branch import Encoded, Proposal, Registrar
    from hybridreg_ros.odometry.preprocess import SensorModel
    from hybridreg_ros.odometry.preprocessed import PreprocessedScan
    from hybridreg_ros.odometry.result import Watch
    from hybridreg_ros.odometry.selection.reported_confidence import ReportedConfidence

    F64 = NDArray[np.float64]

_log = logging.getLogger(__name__)

_OPENINGS = 3
"""How often the first map is made again once the second scan shows the motion."""


class Tracker:
    """World and pose chain of one odom frame.

    Args:
        config: settings.
        sensor: what the sensor is.
        registrar: the network, or None.
        motion: the pose chain, advanced here.
        leg: (6, 6) covariance of the pose at which the map begins, None = none.

    Attributes:
        sensor: what the sensor is.
        lost: whether the last pose must not be used.
        adrift: whether a map began after another one; as in OdometryResult.
        source: branch of the last pose.
        covariance: (6, 6) of the last pose.
    """

    def __init__(
        self,
        config: OdometryConfig,
        sensor: SensorModel,
        registrar: Registrar | None,
        motion: Motion,
        leg: F64 | None = None,
    ) -> None:
        self.sensor = sensor
        self.lost, self.adrift = False, leg is not None
        self.source = Source.KISS_ICP if registrar is None else Source.HYBRIDREG
        self.covariance = covariance.first()
        self._config = config
        self._motion = motion
        self._world = World(config, sensor)
        asked = config.keyframe.window + config.lost.keyframes_tried
        self._learned = None if registrar is None else LearnedBranch(registrar, asked)
        self._locator = Locator(config, sensor, self._world, self._learned)
        self._bad_frames = 0
        self._lost_since, self._lost_twist = 0, np.zeros(6)
        self._blind_leg = np.zeros((6, 6)) if leg is None else leg
        self._held = self._counted = motion.stamp
        self._held_twist: F64 | None = None
        self._surroundings: dict[int, Surroundings] = {}
        self._opening: tuple[PreprocessedScan, int] | None = None
        self._continuity = ScanContinuity()
        self._since_update = 0
        self._becomes_keyframe = False

    def encode(self, cloud: PreprocessedScan, budget: Budget) -> Encoded | None:
        """A cloud encoded by the network; None without one. Needs nothing of earlier scans."""
        if self._learned is None or len(cloud.icp_rows) < self._config.input.min_points:
            return None
        return self._learned.encode(cloud.map_points, budget)

    def knows_motion(self, stamp: int) -> bool:
        """Whether what stands still in a scan at a stamp, ns, is known to."""
        return self._world.dynamics.knows(stamp)

    def propose(
        self, cloud: PreprocessedScan, encoded: Encoded | None, stamp: int
    ) -> Proposal | None:
        """What the network says of a cloud, None where it says nothing yet.

        It may be asked while the last scan is written to the world in another thread, so it says
        nothing when that scan becomes a keyframe; `step` asks it then.

        Args:
            cloud: the preprocessed scan.
            encoded: it, by `encode`.
            stamp: its stamp, ns.
        """
        if self._learned is None or self._becomes_keyframe or self.lost:
            return None
        expected = self._continuity.expect(self._motion.expect(stamp), cloud, stamp)
        return self._learned.propose(encoded, self._world.keyframes.to_match(expected.pose))

    def step(
        self,
        cloud: PreprocessedScan,
        encoded: Encoded | None,
        proposal: Proposal | None,
        stamp: int,
        effort: Effort,
        watch: Watch,
    ) -> Estimate:
        """Locate a cloud and update the pose chain; map and keyframes are left to the estimate.

        Args:
            cloud: the preprocessed scan.
            encoded: it, by `encode`.
            proposal: by `propose`.
            stamp: its stamp, ns.
            effort: how much is done.
            watch: books the time per stage.
        """
        self._locator.judged, self._becomes_keyframe = [], False
        if len(cloud.icp_rows) < self._config.input.min_points:
            return self._bad(stamp, Reason.TOO_FEW_POINTS)
        if len(self._world.map) == 0:
            return self._begin(cloud, encoded, stamp, Reason.FIRST_SCAN)
        cloud = self._continuity.informed(cloud, self._motion.seconds_to(stamp))
        expected = self._continuity.expect(self._motion.expect(stamp), cloud, stamp)
        moves = self._world.dynamics.recalled
        trust = np.float32(1.0) - moves(cloud.icp_points, expected.pose)
        if self.lost:
            found = self._locator.relocate(cloud, self._motion.pose, watch)
        else:
            last = self._motion.pose
            asked = encoded, proposal
            found = self._locator.locate(cloud, asked, expected, last, trust, watch, effort)
        if isinstance(found, Candidate) and self._opens(cloud, stamp):
            cloud, found = self._opened(cloud, encoded, stamp, found, watch, effort)
        self._opening = None
        watch.lap('refine')
        if isinstance(found, Candidate) and self._is_last_straw(found):
            found = found.reason
        if isinstance(found, Candidate):
            return self._accept(cloud, encoded, stamp, found, effort)
        if self.lost and self._give_up(stamp):
            return self._begin(cloud, encoded, stamp, Reason.RECOVERED)
        return self._bad(stamp, found)

    @property
    def judged(self) -> list[Candidate]:
        """Every pose that was considered for the last cloud."""
        return self._locator.judged

    def map_points(self) -> NDArray[np.float32]:
        """Static points (N, 3) of the local map, odom frame, metres."""
        return self._world.map.fine.points()

    def leg_to(self, stamp: int) -> F64:
        """Covariance (6, 6) of a map that begins at a stamp (ns) where the motion leads."""
        if self.lost:
            seconds = (stamp - self._lost_since) / NS_PER_S
            return self._blind_leg + covariance.of_blindness(self._lost_twist, seconds)
        expected = self._motion.expect(stamp)
        spread = np.repeat([expected.shift_m, expected.turn_rad], 3)
        leg: F64 = self.covariance + np.diag(spread**2)
        return leg

    def _is_last_straw(self, found: Candidate) -> bool:
        """Whether a tentative pose comes after too many bad frames to be taken."""
        return found.tentative and self._bad_frames + 1 >= self._config.lost.after_bad_frames

    def _opens(self, cloud: PreprocessedScan, stamp: int) -> bool:
        """Whether this is the second scan of a map whose first one was taken to stand still."""
        if self._opening is None or cloud.times is None:
            return False
        return self._opening[1] == self._motion.stamp < stamp

    def _opened(
        self,
        cloud: PreprocessedScan,
        encoded: Encoded | None,
        stamp: int,
        found: Candidate,
        watch: Watch,
        effort: Effort,
    ) -> tuple[PreprocessedScan, Candidate]:
        """Make the map of the first scan again, deskewed by the motion that the second shows.

        The way between the two shows the velocity, and by how much the second turns faster in that
        map shows the angular acceleration: a map bent by half of it would bend all later scans
        alike. Two scans say less of the change of the linear velocity than there is.

        The pose reported of the first scan stands, so that of its points is found from it.

        Returns:
            The second cloud, deskewed too, and where it is.
        """
        assert self._opening is not None
        (first, since), still, outcome = self._opening, cloud, found
        begun = start = self._motion.pose
        dt = self._motion.seconds_to(stamp)
        before, half = first.twist, np.zeros(6)
        for _ in range(_OPENINGS):
            twist = se3.log(se3.inverse(begun) @ outcome.fit.T_odom_sensor) / dt
            half[3:] = 0.5 * (cloud.rate(outcome.fit.intra_scan) - before)[3:]
            before = twist - half
            motion = IntraScanMotion(before - first.twist, half / dt)
            begun = start @ se3.inverse(motion.at(first.reported_s - first.instant_s))
            predicted = begun @ se3.exp(twist * dt)
            cloud = still.moved_by(twist + half)
            self._restart(first.straightened(motion), begun, since)
            ones = np.ones(len(cloud.icp_rows), np.float32)
            expected = replace(self._motion.expect(stamp), pose=predicted)
            asked = encoded, None
            again = self._locator.locate(cloud, asked, expected, begun, ones, watch, effort)
            if isinstance(again, Reason):  # the velocity was wrong, so as it was before
                self._restart(first, start, since)
                return still, found
            outcome = again
        return cloud, outcome

    def _restart(self, cloud: PreprocessedScan, pose: F64, stamp: int) -> None:
        """Let the map, the past and the newest keyframe be those of one cloud."""
        self._stop(stamp, pose)
        keyframe = self._world.begin_again(cloud, pose, stamp)
        if self._learned is not None:
            self._learned.forget(keyframe)

    def _accept(
        self,
        cloud: PreprocessedScan,
        encoded: Encoded | None,
        stamp: int,
        found: Candidate,
        effort: Effort,
    ) -> Estimate:
        """Write a pose to the chain; what its scan tells the world is left to the estimate."""
        if self._motion.up is not None:
            found = replace(found, fit=in_plane(found.fit, self._motion.up))
        pose, was_lost = found.fit.T_odom_sensor, self.lost
        intra_scan, reported = found.fit.intra_scan, None
        entered = cloud
        if intra_scan is not None:
            intra_scan = intra_scan if cloud.usual is None else cloud.usual.own(intra_scan)
            cloud, reported = cloud.straightened(intra_scan), cloud.reported(pose, intra_scan)
        if was_lost:
            self._stop(stamp, pose)
        elif found.confidence >= self._config.gate.enter:
            self._motion.advance(pose, stamp)
            self._continuity.end_at(entered, pose, intra_scan, stamp)
        else:
            self._hold(pose, stamp)
        self.lost = False
        self._bad_frames = self._bad_frames + 1 if found.tentative else 0
        self.source = found.source
        own = self._own(found, cloud.reported_s - cloud.instant_s)
        around, new = self._around(pose, own)
        self.covariance = around.covariance + (1.0 + new) * own + self._leg(found, stamp)
        loose = bool(found.fit.unheld.any())
        reason = Reason.DEGENERATE if loose else found.reason
        reason = Reason.RECOVERED if was_lost else reason
        told = self._locator.confidence_of(found)
        confidence = min(told.confidence, UNHELD) if loose else told.confidence
        estimate = self._estimate(pose, reason, confidence)
        self._since_update += 1
        static = self._static(encoded, pose) if effort.thorough else None
        around = replace(around, random=around.random + new * own)
        update = partial(self._update, cloud, encoded, stamp, found, static, around)
        self._becomes_keyframe = self._world.is_due(found, stamp)
        if self._since_update < effort.update_every and not self._becomes_keyframe:
            update = partial(self._pass_over, cloud, found)
        return replace(
            estimate,
            own_covariance=own,
            reported=reported,
            reported_confidence=told,
            update=update,
            weak_direction=covariance.weak_direction(found.fit.unheld),
        )

    def _own(self, found: Candidate, ahead_s: float) -> F64:
        """Covariance (6, 6) in its surroundings of a pose told `ahead_s` after its instant."""
        fitted = calibration.packaged().covariance_scale[self.sensor.kind]
        factor = self._config.covariance.scale or fitted
        return covariance.of_registration(found.fit, ahead_s, factor)

    def _around(self, pose: F64, own: F64) -> tuple[Surroundings, float]:
        """How far off the surroundings are in which a pose stands.

        They are those of the nearest keyframe, as far off as its pose was; the first one's own
        noise shows in how a scan lies on it. The farther a pose is from its keyframe, the more of
        what it sees is new, and as far off as the pose itself.

        Args:
            pose: (4, 4) the pose.
            own: (6, 6) covariance of the pose in its surroundings.

        Returns:
            They at the pose, and the share of them that is new, [0, 1].
        """
        keyframes = self._world.keyframes
        near = keyframes.to_match(pose)
        assert near is not None
        known = self._surroundings.setdefault(near.number, Surroundings(own))
        bias = covariance.DRIFT[self.sensor.kind]
        around = known.carried(near.T_odom_keyframe, pose, bias)
        return around, min(1.0, keyframes.distance(near, pose))

    def _leg(self, found: Candidate, stamp: int) -> F64:
        """Covariance (6, 6) of the ways on which nothing held the pose, the present one included.

        What was written to the map on such a way stays as far off as the way was.
        """
        if not found.fit.unheld.any():
            self._held, known = stamp, self._motion.last_step_s > 0.0
            self._held_twist = self._motion.twist if known else None
        else:
            since_s, until_s = ((s - self._held) / NS_PER_S for s in (self._counted, stamp))
            grown = covariance.along(found.fit.unheld, self._held_twist, since_s, until_s)
            self._blind_leg = self._blind_leg + grown
        self._counted = stamp
        return self._blind_leg

    def _update(
        self,
        cloud: PreprocessedScan,
        encoded: Encoded | None,
        stamp: int,
        found: Candidate,
        static: Callable[[], PointMask | None] | None,
        around: Surroundings,
        watch: Watch,
    ) -> Update:
        """Say what moves in a located scan, and write what stands still to the world."""
        self._since_update = 0
        pose = found.fit.T_odom_sensor
        mask = None if static is None else static()
        still = None if mask is None else mask.static
        dynamic, image = self._world.moving(cloud, pose, stamp, still)
        watch.lap('dynamics')
        keyframe = self._world.add(cloud, stamp, found, dynamic, image)
        if keyframe is not None:
            self._surroundings = {
                f.number: self._surroundings.get(f.number, around)
                for f in self._world.keyframes.recent
            }
            self._adopt(keyframe, encoded)
            if self._learned is not None:
                give_back()  # what the network took; the next scan takes most of it again
        watch.lap('map')
        return Update(dynamic, keyframe is not None, self._keyframe_id)

    def _static(self, encoded: Encoded | None, pose: F64) -> Callable[[], PointMask | None] | None:
        """Gives P(static) of a scan's thinned points by the network, by the nearest keyframe."""
        keyframe = self._world.keyframes.to_match(pose)
        if self._learned is None or encoded is None or keyframe is None:
            return None
        return self._learned.point_mask(encoded, keyframe, pose)

    def _pass_over(self, cloud: PreprocessedScan, found: Candidate, watch: Watch) -> Update:
        """Say what moves by what is remembered of its places; the world learns nothing."""
        dynamic = self._world.dynamics.recalled(cloud.points, found.fit.T_odom_sensor)
        watch.lap('dynamics')
        return Update(dynamic, False, self._keyframe_id)

    @property
    def _keyframe_id(self) -> int:
        last = self._world.keyframes.last
        return 0 if last is None else last.number

    def _begin(
        self, cloud: PreprocessedScan, encoded: Encoded | None, stamp: int, reason: Reason
    ) -> Estimate:
        """Start a map at the last pose: the first scan, or a new start after a loss.

        After a loss the way between the old map and the new one is not known: the pose of that
        one step carries the covariance of LOST and the confidence 0, and what may lie between the
        maps stays in the covariance of all later poses.
        """
        if reason is not Reason.FIRST_SCAN:
            self._blind_leg, self.adrift = self.leg_to(stamp), True
        self._stop(stamp, self._motion.predict(stamp))
        pose = self._motion.pose
        self._held, self._counted, self._held_twist = stamp, stamp, None
        self.lost, self._bad_frames = False, 0
        self.source = Source.KISS_ICP if self._learned is None else Source.HYBRIDREG
        first = reason is Reason.FIRST_SCAN
        self.covariance = covariance.first() + self._blind_leg if first else covariance.lost()
        self._adopt(self._world.begin(cloud, pose, stamp), encoded)
        self._opening = None if cloud.times is None else (cloud, stamp)
        return self._estimate(pose, reason, float(first), is_keyframe=True)

    def _bad(self, stamp: int, reason: Reason) -> Estimate:
        """No pose from this cloud: coast for a few frames, then say LOST.

        A cloud that holds next to nothing is silence: the pose is predicted for as long as that
        lasts, but nothing is known of the motion meanwhile.
        """
        self._bad_frames += 1
        if not self.lost and self._bad_frames >= self._config.lost.after_bad_frames:
            self.lost, self._lost_since, self._lost_twist = True, stamp, self._motion.twist
        pose = self._motion.predict(stamp)
        if self.lost:
            self._stop(stamp)
            pose, self.source, self.covariance = self._motion.pose, Source.LOST, covariance.lost()
        else:
            self._continuity.end()
            if reason is not Reason.TOO_FEW_POINTS:
                self._motion.hold(pose, stamp)
            self.covariance = covariance.coasting(self.covariance, self.sensor.voxel_size_m)
        return self._estimate(pose, reason, 0.0)

    def _stop(self, stamp: int, pose: F64 | None = None) -> None:
        """Stand still from now on, at a pose or at the last one."""
        self._motion.stop(stamp, pose)
        self._continuity.forget()

    def _hold(self, pose: F64, stamp: int) -> None:
        """Take a pose that says nothing about the motion."""
        self._motion.hold(pose, stamp)
        self._continuity.end()

    def _adopt(self, keyframe: Keyframe, encoded: Encoded | None) -> None:
        """Let the network match against a keyframe that a scan has become."""
        if self._learned is not None:
            self._learned.keep_only(self._world.keyframes.recent)
            self._learned.adopt(keyframe, encoded)

    def _give_up(self, stamp: int) -> bool:
        """Whether the old map is given up; then it is forgotten, with all that belongs to it."""
        since_s = (stamp - self._lost_since) / NS_PER_S
        if since_s < self._config.lost.reanchor_after_s:
            return False
        _log.warning(
            'lost for %.1f s: starting a new map at the last pose; covariances hold what may lie '
            'between the maps from now on',
            since_s,
        )
        self._world.forget()
        self._world.keyframes.clear()
        return True

    def _estimate(
        self, pose: F64, reason: Reason, confidence: float, is_keyframe: bool = False
    ) -> Estimate:
        return Estimate(
            pose=pose,
            covariance=self.covariance,
            own_covariance=self.covariance,
            source=self.source,
            reason=reason,
            confidence=confidence,
            keyframe_id=self._keyframe_id,
            is_keyframe=is_keyframe,
        )


class Update(NamedTuple):
    """What became of a located scan.

    Attributes:
        dynamic_probability: (N,) float32 in [0, 1] per point of the scan.
        is_keyframe: whether it became a keyframe.
        keyframe_id: number of the newest keyframe.
    """

    dynamic_probability: NDArray[np.float32]
    is_keyframe: bool
    keyframe_id: int


@dataclass(frozen=True, eq=False)
class Estimate:
    """What the tracker says about one cloud; fields as in OdometryResult.

    `own_covariance` is what its pose does not share with the last one; `reported` is the pose at
    the instant that is asked for, None where only the velocity between scans leads there;
    `reported_confidence` is what the confidence follows from, None where it is 0;
    `weak_direction` as in OdometryResult. `update` makes mask, map and keyframes, to be called
    once before the next step; None = nothing to do.
    """

    pose: F64
    covariance: F64
    own_covariance: F64
    source: Source
    reason: Reason
    confidence: float
    keyframe_id: int
    is_keyframe: bool
    reported: F64 | None = None
    reported_confidence: ReportedConfidence | None = None
    weak_direction: F64 | None = None
    update: Callable[[Watch], Update] | None = None

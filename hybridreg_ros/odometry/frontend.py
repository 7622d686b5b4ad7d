# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""HybridOdometry: clouds in, poses and dynamic points out; live or offline, no ROS."""

from __future__ import annotations

import logging
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.scan import NS_PER_S, units_note
from hybridreg_ros.odometry import network_branch
from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.odometry.intake import Intake
from hybridreg_ros.odometry.load import Load
from hybridreg_ros.odometry.motion.prediction import Motion
from hybridreg_ros.odometry.preprocess import preprocess, recognise_sensor
from hybridreg_ros.odometry.registration import covariance
from hybridreg_ros.odometry.result import OdometryResult, Reason, Rest, Source, Watch
from hybridreg_ros.odometry.tracker import Tracker

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from hybridreg_ros.core.scan import Scan
    from hybridreg_ros.odometry.network_branch import Encoded
    from hybridreg_ros.odometry.preprocessed import PreprocessedScan
    from hybridreg_ros.odometry.selection.candidates import Candidate
    from hybridreg_ros.odometry.selection.reported_confidence import ReportedConfidence
    from hybridreg_ros.odometry.tracker import Estimate, Update

_log = logging.getLogger(__name__)

_FOR_SCALE = 500
"""Points by which every scan is asked whether the scene has become a far larger one."""


class Prepared(NamedTuple):
    """A scan with all done that does not need the pose before (`HybridOdometry.prepare`)."""

    tracker: Tracker
    scan: Scan
    cloud: PreprocessedScan
    encoded: Encoded | None
    watch: Watch


class HybridOdometry:
    """Front end: one pose chain and one map, whichever branch makes the pose.

    The first usable scan defines the odom frame. A scan with per-point times is deskewed and
    registered at the mean time of its points; the pose reported is carried by the velocity to the
    instant of `preprocess.deskew_to` (the stamp by default).

    Args:
        config: settings; None = defaults.
        model: 'auto' loads the packaged weights when they ship; None = no network; or a Registrar
            such as HybridReg.
        motion: makes the motion model (a fit gives one whose predictions are off on purpose).

    Attributes:
        config: settings.
        reported_confidence: of the last scan, with what it follows from; None where it is 0.

    Raises:
        ConfigError: `model` is something else.
        DependencyError: kiss-icp is not installed.
    """

    def __init__(
        self,
        config: OdometryConfig | None = None,
        model: Any = 'auto',
        motion: Callable[[], Motion] = Motion,
    ) -> None:
        self.config = config or OdometryConfig()
        wants_network = self.config.registrar == 'hybridreg'
        self._registrar = network_branch.load(model) if wants_network else None
        self._make_motion = motion
        self._intake = Intake(self.config.input)
        self._rest: Rest | None = None
        self.reset()

    @property
    def has_network(self) -> bool:
        """Whether a network leads; False means every pose comes from kiss-icp."""
        return self._registrar is not None

    @property
    def wants_newest(self) -> bool:
        """Whether so much is left out that of waiting scans the newest should come next."""
        return self._load.last.newest

    @property
    def refused(self) -> Mapping[Reason, int]:
        """How many scans were refused for each reason since the start."""
        return self._intake.refused

    @property
    def judged(self) -> list[Candidate]:
        """Every pose considered for the last scan, with what speaks for it (for fitting)."""
        return [] if self._tracker is None else self._tracker.judged

    def map_points(self) -> NDArray[np.float32]:
        """Static points (N, 3) of the local map, odom frame, metres; not while `locate` runs."""
        self._finish()
        if self._tracker is None:
            return np.zeros((0, 3), np.float32)
        return self._tracker.map_points()

    def reset(self) -> None:
        """Forget pose, map and keyframes; the next usable scan defines the odom frame anew."""
        self._finish()
        self._intake.reset()
        self._load = Load()
        self.reported_confidence: ReportedConfidence | None = None
        self._motion = self._make_motion()
        self._tracker: Tracker | None = None
        self._begun = False
        self._outgrown = 0
        self._keyframe_id = 0
        self._last_pose = self._motion.pose

    def step(self, scan: Scan) -> OdometryResult:
        """Take one scan.

        It never raises for what a sensor may send: odd stamps, empty or absurd clouds give a
        result that says so.
        """
        return self.locate(scan)[1]()

    def prepare(self, scan: Scan) -> Prepared | None:
        """Preprocess and encode a scan to come, in another thread, while one is being located.

        Nothing of that needs the pose before, unless the motion during the scan is to be undone.

        Returns:
            What `locate` takes with the scan; None where all of it is left to `locate`.
        """
        tracker = self._tracker if self._begun else None  # the first scan decides sensor and voxel
        if tracker is None or (scan.times is not None and self.config.preprocess.deskew):
            return None
        watch = Watch()
        cloud = preprocess(scan, tracker.sensor, self.config.preprocess, np.zeros(6))
        watch.lap('preprocess')
        encoded = tracker.encode(cloud, self._load.last.first_look)
        watch.lap('encode')
        return Prepared(tracker, scan, cloud, encoded, watch)

    def locate(
        self,
        scan: Scan,
        behind: bool = False,
        prepared: Prepared | None = None,
        matched: Callable[[], object] = lambda: None,
    ) -> tuple[OdometryResult, Rest]:
        """Take one scan, in two parts: its pose at once, mask, map and keyframes afterwards.

        A scan is preprocessed, encoded and matched with a keyframe while the rest of the scan
        before is still being made in another thread; its pose is looked for after that. So the
        results are those of `step`.

        Args:
            scan: the scan.
            behind: whether later scans wait already, or were left out since the last one; then
                less is done per scan for a while (`odometry/load.py`).
            prepared: it by `prepare`, if that was called; of no use after a reset.
            matched: called when the scan has been matched and only its alignment is left: time to
                `prepare` the next one. Not called where it comes to no match.

        Returns:
            What is known with the pose: `dynamic_probability` is 0 everywhere, and it is no
            keyframe yet. The rest, which makes and returns the whole result; to be called once, in
            any thread (the next `locate` calls it if nobody did).
        """
        watch, self.reported_confidence = Watch() if prepared is None else prepared.watch, None
        watch.resume()
        fault = self._intake.check(scan)
        if fault is not None and not self._rebase(scan, fault):
            refusal = self._no_pose(scan, fault, watch)
            return refusal, Rest(lambda: refusal)
        self._judge_scale_again(scan)
        if prepared and (prepared.tracker is not self._tracker or prepared.scan is not scan):
            prepared = None
        cloud = self._preprocessed(scan) if prepared is None else prepared.cloud
        watch.lap('preprocess')
        if cloud is None or self._tracker is None:
            nothing = self._no_pose(scan, Reason.TOO_FEW_POINTS, watch, accepted=True)
            return nothing, Rest(lambda: nothing)
        effort = self._load.effort(behind)
        stamp = scan.stamp + round(cloud.instant_s * NS_PER_S)
        encoded = prepared.encoded if prepared else self._tracker.encode(cloud, effort.first_look)
        watch.lap('encode')
        proposal = self._tracker.propose(cloud, encoded, stamp)
        watch.lap('match')
        matched()
        self._finish()
        watch.resume()
        estimate = self._tracker.step(cloud, encoded, proposal, stamp, effort, watch)
        result = self._result(scan, cloud, estimate, fault, watch)
        known = self._tracker.knows_motion(stamp)
        result = replace(result, load=effort.level, mask_known=known)
        self._rest = Rest(partial(self._completed, result, estimate.update, watch))
        self._begun = True
        return result, self._rest

    def _finish(self) -> None:
        """Have the rest of the last scan done, here or wherever it was begun."""
        if self._rest is not None:
            self._rest.wait()
            self._rest = None

    def _completed(
        self, result: OdometryResult, update: Callable[[Watch], Update] | None, watch: Watch
    ) -> OdometryResult:
        """The result with what its scan tells the world."""
        if update is None:
            return result
        watch.resume()
        made = update(watch)
        self._keyframe_id = made.keyframe_id
        return replace(result, timings_s=watch.laps(), **made._asdict())

    def seen(self, scan: Scan) -> Scan:
        """The scan without points nearer than the sensor can see: no return, or its own housing.

        They are not registered, and nothing is known of whether they move; whoever publishes
        points of a scan steps with what this returns.
        """
        if not len(scan):
            return scan
        known = None if self._tracker is None else self._tracker.sensor
        return scan.beyond((known or recognise_sensor(scan.points, self.config)).min_range_m)

    def _rebase(self, scan: Scan, fault: Reason) -> bool:
        """Whether the time base has changed for good; then the velocity is unknown."""
        if fault is Reason.FRAME_CHANGED or not self._intake.rebased(scan):
            return False
        _log.warning('new time base at %.3f s (%s)', scan.stamp_s, fault.value)
        self._motion.stop(scan.stamp)
        return True

    def _preprocessed(self, scan: Scan) -> PreprocessedScan | None:
        """Preprocessed cloud; None while no scan has shown what the sensor is."""
        if self._tracker is None:
            sensor = recognise_sensor(scan.points, self.config)
            cloud = preprocess(scan, sensor, self.config.preprocess, self._motion.twist)
            if len(cloud.icp_rows) < self.config.input.min_points:
                if note := units_note(scan.points):
                    _log.warning('%s', note)
                return None
            _log.info('sensor: %s', sensor)
            self._tracker = Tracker(self.config, sensor, self._registrar, self._motion)
            return cloud
        return preprocess(scan, self._tracker.sensor, self.config.preprocess, self._motion.twist)

    def _judge_scale_again(self, scan: Scan) -> None:
        """Begin a new map where the scene is far larger than the one the map was made for."""
        tracker = self._tracker
        if tracker is None or len(scan) < self.config.input.min_points:
            return
        some = scan.points[:: max(1, len(scan) // _FOR_SCALE)]
        sensor = recognise_sensor(some, self.config, thins=False)
        self._outgrown = self._outgrown + 1 if tracker.sensor.outgrown_by(sensor) else 0
        if self._outgrown < self.config.input.rebase_after:
            return
        self._finish()
        sensor = recognise_sensor(scan.points, self.config)  # thinned by how much all of it is
        self._outgrown, self._begun = 0, False
        _log.warning('the scene is a far larger one: a new map begins; sensor: %s', sensor)
        leg = tracker.leg_to(scan.stamp)
        self._tracker = Tracker(self.config, sensor, self._registrar, self._motion, leg)

    def _no_pose(
        self, scan: Scan, reason: Reason, watch: Watch, accepted: bool = False
    ) -> OdometryResult:
        """A scan that is not taken, or the first of all are unusable: the last pose stands."""
        tracker = self._tracker
        return OdometryResult(
            scan=scan,
            pose=self._last_pose,
            covariance=covariance.lost() if tracker is None else tracker.covariance,
            twist=self._motion.twist,
            twist_covariance=covariance.lost(),
            source=Source.LOST if tracker is None or tracker.lost else tracker.source,
            reason=reason,
            confidence=0.0,
            dynamic_probability=np.zeros(len(scan), np.float32),
            keyframe_id=self._keyframe_id,
            accepted=accepted,
            adrift=tracker is not None and tracker.adrift,
            timings_s=watch.laps(),
        )

    def _reported(self, estimate: Estimate, cloud: PreprocessedScan) -> NDArray[np.float64]:
        """Pose at the instant that is asked for, from that of the registered cloud."""
        pose, ahead = estimate.pose, cloud.reported_s - cloud.instant_s
        if ahead == 0.0:
            self._last_pose = pose
        elif estimate.reported is not None:
            self._last_pose = estimate.reported
        else:
            self._last_pose = pose @ se3.exp(self._motion.twist * ahead)
        return self._last_pose

    def _result(
        self,
        scan: Scan,
        cloud: PreprocessedScan,
        estimate: Estimate,
        fault: Reason | None,
        watch: Watch,
    ) -> OdometryResult:
        self._keyframe_id, self.reported_confidence = (
            estimate.keyframe_id,
            estimate.reported_confidence,
        )
        return OdometryResult(
            scan=scan,
            pose=self._reported(estimate, cloud),
            covariance=estimate.covariance,
            twist=self._motion.twist,
            twist_covariance=covariance.of_twist(
                estimate.own_covariance, estimate.pose, self._motion.last_step_s
            ),
            source=estimate.source,
            reason=fault or estimate.reason,
            confidence=estimate.confidence,
            dynamic_probability=np.zeros(len(scan), np.float32),
            weak_direction=estimate.weak_direction,
            adrift=self._tracker is not None and self._tracker.adrift,
            keyframe_id=estimate.keyframe_id,
            is_keyframe=estimate.is_keyframe,
            timings_s=watch.laps(),
            deskewed=cloud.deskewed,
        )

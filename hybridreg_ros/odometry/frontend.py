# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""HybridOdometry: clouds in, poses and dynamic points out; live or offline, no ROS."""

from __future__ import annotations

import logging
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.odometry import covariance, learned
from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.odometry.intake import Intake
from hybridreg_ros.odometry.motion import Motion
from hybridreg_ros.odometry.preprocess import Cloud, preprocess, recognise_sensor
from hybridreg_ros.odometry.result import OdometryResult, Reason, Source
from hybridreg_ros.odometry.tracker import Estimate, Tracker

if TYPE_CHECKING:
    from collections.abc import Mapping

    from hybridreg_ros.core.scan import Scan

_log = logging.getLogger(__name__)


class HybridOdometry:
    """Front end: one pose chain and one map, whichever branch makes the pose.

    The first usable scan defines the odom frame. Every pose belongs to the instant its cloud is
    deskewed to (`preprocess.deskew_to`; the stamp by default).

    Args:
        config: settings; None = defaults.
        model: 'auto' loads the packaged weights when they ship; None = no network; or a Registrar
            such as HybridReg.

    Raises:
        ConfigError: `model` is something else.
        DependencyError: kiss-icp is not installed.
    """

    def __init__(self, config: OdometryConfig | None = None, model: Any = 'auto') -> None:
        self.config = config or OdometryConfig()
        wants_network = self.config.registrar == 'hybridreg'
        self._registrar = learned.load(model) if wants_network else None
        self._intake = Intake(self.config.input)
        self.reset()

    @property
    def has_network(self) -> bool:
        """Whether a network leads; False means every pose comes from kiss-icp."""
        return self._registrar is not None

    @property
    def refused(self) -> Mapping[Reason, int]:
        """How many scans were refused for each reason since the start."""
        return self._intake.refused

    def reset(self) -> None:
        """Forget pose, map and keyframes; the next usable scan defines the odom frame anew."""
        self._intake.reset()
        self._motion = Motion()
        self._tracker: Tracker | None = None
        self._keyframe_id = 0

    def step(self, scan: Scan) -> OdometryResult:
        """Take one scan.

        It never raises for what a sensor may send: odd stamps, empty or absurd clouds give a
        result that says so.
        """
        watch = _Stopwatch()
        fault = self._intake.check(scan)
        if fault is not None and not self._rebase(scan, fault):
            return self._refusal(scan, fault, watch)
        cloud = self._prepare(scan)
        watch.lap('preprocess')
        if cloud is None or self._tracker is None:
            return self._without_map(scan, watch)
        estimate = self._tracker.step(cloud, scan.stamp, watch)
        return self._result(scan, cloud, estimate, fault, watch)

    def _rebase(self, scan: Scan, fault: Reason) -> bool:
        """Whether the time base has changed for good; then the velocity is unknown."""
        if fault is Reason.FRAME_CHANGED or not self._intake.rebased(scan):
            return False
        _log.warning('new time base at %.3f s (%s)', scan.stamp_s, fault.value)
        self._motion.stop(scan.stamp)
        return True

    def _prepare(self, scan: Scan) -> Cloud | None:
        """Preprocessed cloud; None while no scan has shown what the sensor is."""
        if self._tracker is None:
            sensor = recognise_sensor(scan.points, self.config)
            cloud = preprocess(scan, sensor, self.config.preprocess, self._motion.twist)
            if len(cloud.icp_rows) < self.config.input.min_points:
                return None
            _log.info('sensor: %s', sensor)
            self._tracker = Tracker(self.config, sensor, self._registrar, self._motion)
            return cloud
        return preprocess(scan, self._tracker.sensor, self.config.preprocess, self._motion.twist)

    def _without_map(self, scan: Scan, watch: _Stopwatch) -> OdometryResult:
        """There has been no usable scan yet, so there is no pose."""
        return OdometryResult(
            scan=scan,
            pose=self._motion.pose,
            covariance=covariance.lost(),
            twist=np.zeros(6),
            twist_covariance=covariance.lost(),
            source=Source.LOST,
            reason=Reason.TOO_FEW_POINTS,
            confidence=0.0,
            dynamic_probability=np.zeros(len(scan), np.float32),
            timings_s=watch.laps(),
        )

    def _refusal(self, scan: Scan, fault: Reason, watch: _Stopwatch) -> OdometryResult:
        """A scan that is not taken: the last pose stands, nothing changes."""
        lost = self._tracker is None or self._tracker.lost
        spread = covariance.lost() if self._tracker is None else self._tracker.covariance
        return OdometryResult(
            scan=scan,
            pose=self._motion.pose,
            covariance=spread,
            twist=self._motion.twist,
            twist_covariance=covariance.lost(),
            source=Source.LOST if lost else self._tracker.source,  # type: ignore[union-attr]
            reason=fault,
            confidence=0.0,
            dynamic_probability=np.zeros(len(scan), np.float32),
            keyframe_id=self._keyframe_id,
            accepted=False,
            timings_s=watch.laps(),
        )

    def _result(
        self, scan: Scan, cloud: Cloud, estimate: Estimate, fault: Reason | None, watch: _Stopwatch
    ) -> OdometryResult:
        self._keyframe_id = estimate.keyframe_id
        return OdometryResult(
            scan=scan,
            pose=estimate.pose,
            covariance=estimate.covariance,
            twist=self._motion.twist,
            twist_covariance=covariance.of_twist(
                estimate.covariance, estimate.pose, self._motion.last_step_s
            ),
            source=estimate.source,
            reason=fault or estimate.reason,
            confidence=estimate.confidence,
            dynamic_probability=estimate.dynamic_probability,
            keyframe_id=estimate.keyframe_id,
            is_keyframe=estimate.is_keyframe,
            timings_s=watch.laps(),
            deskewed=cloud.deskewed,
        )


class _Stopwatch:
    """Seconds per stage of one step."""

    def __init__(self) -> None:
        self._start = self._last = perf_counter()
        self._laps: dict[str, float] = {}

    def lap(self, stage: str) -> None:
        """Book the time since the last lap under a stage."""
        now = perf_counter()
        self._laps[stage] = self._laps.get(stage, 0.0) + now - self._last
        self._last = now

    def laps(self) -> Mapping[str, float]:
        """Seconds per stage, and `total`."""
        return {**self._laps, 'total': perf_counter() - self._start}

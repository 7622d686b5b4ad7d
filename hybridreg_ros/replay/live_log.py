# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What the node publishes, recorded as a bag and as the same log that an offline replay makes."""

from __future__ import annotations

import threading
import time
from collections import defaultdict
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.pointcloud2 import to_scan
from hybridreg_ros.core.quaternion import from_quaternion
from hybridreg_ros.core.scan import NS_PER_S
from hybridreg_ros.metrics.mask import MaskCounts
from hybridreg_ros.odometry.result import LOST_VARIANCE, Source
from hybridreg_ros.replay.outputs import DYNAMIC_TOPIC, STATIC_TOPIC, OutputFiles
from hybridreg_ros.replay.page.pictures import Album, FrameView
from hybridreg_ros.replay.page.scene import SceneSink
from hybridreg_ros.replay.runner import FrameLog, ReplayLog, true_dynamic

if TYPE_CHECKING:
    from numpy.typing import NDArray

PARTS = ('odom', 'dynamic', 'static', 'frame')


class LiveRecorder:
    """Takes the node's messages in any order and thread; joins those of one stamp.

    Attributes:
        log: frames so far, complete after `close`.
        album: frames for the pictures.
        seen: the scene.
    """

    def __init__(self, files: OutputFiles, frames: int) -> None:
        """Start a log.

        Args:
            files: take what the node publishes.
            frames: expected number of frames.
        """
        self.log = ReplayLog()
        self.album = Album(frames)
        self.seen = SceneSink()
        self._files = files
        self._lock = threading.Lock()
        self._waiting: dict[int, dict[str, Any]] = defaultdict(dict)
        self._start = time.perf_counter()

    def on_odom(self, msg: Any) -> None:
        """Take a nav_msgs/Odometry."""
        stamp = _stamp(msg)
        pose = _pose(msg.pose.pose)
        linear, angular = msg.twist.twist.linear, msg.twist.twist.angular
        with self._lock:
            self._files.write_odometry(
                stamp,
                (msg.header.frame_id, msg.child_frame_id),
                pose,
                np.asarray(msg.pose.covariance),
                np.array([linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]),
                np.asarray(msg.twist.covariance),
            )
            self._put(stamp, 'odom', (pose, float(msg.pose.covariance[0])))

    def on_dynamic(self, msg: Any) -> None:
        """Take a cloud of dynamic points."""
        self._cloud(DYNAMIC_TOPIC, 'dynamic', msg)

    def on_static(self, msg: Any) -> None:
        """Take a cloud of static points."""
        self._cloud(STATIC_TOPIC, 'static', msg)

    def on_frame(self, msg: Any) -> None:
        """Take a diagnostic_msgs/DiagnosticArray about one frame."""
        values = {item.key: item.value for status in msg.status for item in status.values}
        with self._lock:
            self._put(_stamp(msg), 'frame', values)

    def _cloud(self, topic: str, part: str, msg: Any) -> None:
        stamp = _stamp(msg)
        scan = to_scan(msg, time_unit='none')
        with self._lock:
            self._files.write_cloud(topic, stamp, msg.header.frame_id, msg)
            self._put(stamp, part, (scan.points, true_dynamic(msg, scan)))

    def _put(self, stamp: int, part: str, value: Any) -> None:
        parts = self._waiting[stamp]
        parts[part] = value
        if len(parts) == len(PARTS):
            self._finish(stamp, self._waiting.pop(stamp))

    def _finish(self, stamp: int, parts: dict[str, Any]) -> None:
        """One frame whose messages are all there, or as many as came."""
        if 'odom' not in parts:
            return
        pose, variance = parts['odom']
        view, told = _view(stamp, parts), parts.get('frame', {})
        if view is not None:
            self.album.offer(view)
            if told.get('source') != Source.LOST.value:
                self.seen.offer(stamp, pose, view.points, view.moving)
        self.log.frames.append(
            FrameLog(
                stamp=stamp,
                pose=pose,
                source=told.get('source', Source.LOST.value if variance >= LOST_VARIANCE else ''),
                reason=told.get('reason', ''),
                confidence=float(told.get('confidence', 'nan')),
                seconds={
                    key.removesuffix('_ms'): 1e-3 * float(value)
                    for key, value in told.items()
                    if key.endswith('_ms')
                },
                points=0 if view is None else len(view.points),
                dynamic=0 if view is None else int(view.moving.sum()),
                mask=_mask(parts),
            )
        )

    def close(self) -> None:
        """Finish the log; frames that lack a cloud are logged with what came."""
        with self._lock:
            for stamp in sorted(self._waiting):
                self._finish(stamp, self._waiting[stamp])
            self._waiting.clear()
            self.log.frames.sort(key=lambda f: f.stamp)
            self.log.wall_s = time.perf_counter() - self._start


def _stamp(msg: Any) -> int:
    return int(msg.header.stamp.sec) * NS_PER_S + int(msg.header.stamp.nanosec)


def _pose(pose: Any) -> NDArray[np.float64]:
    q, p = pose.orientation, pose.position
    return se3.transform(from_quaternion(q.x, q.y, q.z, q.w), np.array([p.x, p.y, p.z]))


def _view(stamp: int, parts: dict[str, Any]) -> FrameView | None:
    """Both clouds as one frame; None when one of them is missing."""
    if 'dynamic' not in parts or 'static' not in parts:
        return None
    moving, moving_truth = parts['dynamic']
    still, still_truth = parts['static']
    truth = None
    if moving_truth is not None and still_truth is not None:
        truth = np.concatenate([moving_truth, still_truth])
    called = np.concatenate([np.ones(len(moving), bool), np.zeros(len(still), bool)])
    return FrameView(stamp, np.concatenate([moving, still]), called, truth)


def _mask(parts: dict[str, Any]) -> MaskCounts | None:
    """Counts of the labelled clouds; None when a cloud or its labels are missing."""
    labels = [parts[part][1] for part in ('dynamic', 'static') if part in parts]
    if len(labels) < 2 or any(values is None for values in labels):
        return None
    tp, fn = (int(values.sum()) for values in labels)
    return MaskCounts(tp=tp, fp=len(labels[0]) - tp, fn=fn, tn=len(labels[1]) - fn)

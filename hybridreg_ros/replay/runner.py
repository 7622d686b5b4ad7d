# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A bag through a front end: one log line per scan, every refused or broken cloud counted."""

from __future__ import annotations

import logging
import re
import time
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from hybridreg_ros.core.errors import BagError
from hybridreg_ros.core.pointcloud2 import field_values, has_field
from hybridreg_ros.core.scan import NS_PER_S
from hybridreg_ros.metrics.mask import MaskCounts, count
from hybridreg_ros.metrics.trajectory import Trajectory
from hybridreg_ros.odometry.result import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from numpy.typing import NDArray

    from hybridreg_ros.core.scan import Scan
    from hybridreg_ros.odometry.result import OdometryResult
    from hybridreg_ros.replay.bag_reader import CloudFrame

logger = logging.getLogger(__name__)

DYNAMIC_THRESHOLD = 0.5
LABEL_FIELD = 'label'
INTERRUPTED = 'interrupted (Ctrl-C)'


class FrontEnd(Protocol):
    """What the runner needs of HybridOdometry."""

    def step(self, scan: Scan) -> OdometryResult:
        """Register one scan."""


class Sink(Protocol):
    """Where results go while a replay runs."""

    def add(self, message: Any, result: OdometryResult) -> None:
        """Take the result of one scan and the message it came from."""


@dataclass(frozen=True, eq=False)
class FrameLog:
    """What is kept of one scan.

    Attributes:
        stamp: ns.
        pose: (4, 4) T_odom_sensor, metres.
        source: hybridreg, kiss_icp or lost; '' when unknown.
        reason: why that branch.
        confidence: P(pose right), NaN when unknown.
        points: valid points.
        invalid: rows with NaN or inf that were left out.
        near: rows without a return, or nearer than the sensor can see, that were left out.
        dynamic: points whose dynamic probability reaches the threshold.
        accepted: False when the front end refused the scan; its pose repeats the last one.
        seconds: time per stage.
        mask: counts against true labels, None without labels.
    """

    stamp: int
    pose: NDArray[np.float64]
    source: str = ''
    reason: str = ''
    confidence: float = float('nan')
    points: int = 0
    invalid: int = 0
    near: int = 0
    dynamic: int = 0
    accepted: bool = True
    seconds: Mapping[str, float] = field(default_factory=dict)
    mask: MaskCounts | None = None


@dataclass(frozen=True)
class Drop:
    """A cloud that never reached the front end, or that it refused.

    Attributes:
        stamp: ns.
        reason: one line.
    """

    stamp: int
    reason: str


@dataclass(eq=False)
class ReplayLog:
    """Everything said about a run; grows while it runs.

    Attributes:
        frames: one per scan that the front end saw, in the order it saw them.
        drops: clouds that were broken or refused.
        interrupted: why the run ended early, '' when it did not.
        wall_s: duration of the run.
        notes: what a reader of the results must know, one line each.
        times_from: what per-point times were made from, or why there are none; scans of each.
    """

    frames: list[FrameLog] = field(default_factory=list)
    drops: list[Drop] = field(default_factory=list)
    interrupted: str = ''
    wall_s: float = 0.0
    notes: list[str] = field(default_factory=list)
    times_from: Counter[str] = field(default_factory=Counter)

    def trajectory(self) -> Trajectory:
        """Poses of the accepted frames, (N, 4, 4), strictly increasing in time."""
        poses = {f.stamp: f.pose for f in self.frames if f.accepted}
        stamps = sorted(poses)
        return Trajectory(
            np.array(stamps, dtype=np.int64),
            np.array([poses[s] for s in stamps], dtype=np.float64).reshape(-1, 4, 4),
        )

    @property
    def useless(self) -> str:
        """Why the run gave no pose at all, '' when it gave one."""
        if any(f.accepted and f.source != 'lost' for f in self.frames):
            return ''
        taken = [f.reason for f in self.frames if f.accepted]
        seen = Counter([d.reason for d in self.drops] + taken)
        reasons = ', '.join(f'{n} x {reason}' for reason, n in seen.most_common(3) if reason)
        return f'no cloud gave a pose ({reasons or "the bag holds none"})'

    def mask_counts(self) -> MaskCounts | None:
        """Sum over the frames with labels, None when there is none."""
        counts = [f.mask for f in self.frames if f.mask is not None]
        return sum(counts, MaskCounts()) if counts else None

    def sources(self) -> dict[str, int]:
        """Number of frames per source; empty when no source is known.

        The first scan, which defines the odom frame, was registered by nothing and is not counted.
        """
        counts = Counter(f.source for f in self.frames if f.reason != Reason.FIRST_SCAN.value)
        return {} if set(counts) <= {''} else dict(counts)


def true_dynamic(message: Any, scan: Scan) -> NDArray[np.bool_] | None:
    """True labels of a scan's points.

    Args:
        message: PointCloud2 the scan was decoded from.
        scan: N points.

    Returns:
        (N,) True where the point moves; None when the message has no label field.
    """
    if not has_field(message, LABEL_FIELD):
        return None
    labels: NDArray[np.bool_] = field_values(message, LABEL_FIELD)[scan.rows] > 0
    return labels


def log_frame(
    message: Any, result: OdometryResult, threshold: float = DYNAMIC_THRESHOLD
) -> FrameLog:
    """Log line of one result and the message it came from; at `threshold` a point moves."""
    called = result.dynamic_probability >= threshold
    truth = true_dynamic(message, result.scan) if result.accepted else None
    return FrameLog(
        stamp=result.stamp,
        pose=result.pose,
        source=str(result.source.value),
        reason=str(result.reason.value),
        confidence=float(result.confidence),
        points=len(result.scan),
        invalid=result.scan.dropped - result.scan.near,
        near=result.scan.near,
        dynamic=int(called.sum()),
        accepted=result.accepted,
        seconds=dict(result.timings_s),
        mask=None if truth is None else count(called, truth),
    )


def run(
    frames: Iterable[CloudFrame],
    front_end: FrontEnd,
    sinks: Iterable[Sink] = (),
    stride: int = 1,
    max_frames: int | None = None,
    threshold: float = DYNAMIC_THRESHOLD,
    tick: Callable[[FrameLog | None], None] | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> ReplayLog:
    """Send clouds through a front end.

    A stop request, Ctrl-C and a damaged bag end the run early: what was made so far is returned,
    and the log says why it is short.

    Args:
        frames: clouds of a bag, `Bag.frames`.
        front_end: takes one scan after the other.
        sinks: receive every accepted result.
        stride: take every n-th cloud.
        max_frames: stop after that many clouds were taken.
        threshold: dynamic probability from which a point counts as moving.
        tick: called after each cloud of the bag, with its log line or None.
        stop: asked before each cloud; True ends the run.
    """
    log = ReplayLog()
    start = time.perf_counter()
    outputs = tuple(sinks)
    remarks: dict[str, list[str]] = defaultdict(list)
    try:
        for number, frame in enumerate(frames):
            if stop():
                log.interrupted = INTERRUPTED
                break
            if number % stride:
                continue
            if max_frames is not None and len(log.frames) + len(log.drops) >= max_frames:
                break
            if frame.scan is not None:
                _tell_times(frame.scan, log, remarks)
            line = _one(frame, front_end, outputs, log, threshold)
            if tick is not None:
                tick(line)
    except KeyboardInterrupt:
        log.interrupted = INTERRUPTED
    except BagError as error:
        log.interrupted = str(error)
    log.wall_s = time.perf_counter() - start
    for notes in remarks.values():
        log.notes.append(f'in {len(notes)} of {len(log.frames)} clouds: {notes[0]}')
    return log


def _tell_times(scan: Scan, log: ReplayLog, remarks: dict[str, list[str]]) -> None:
    """Keep what a scan says of its per-point times; notes that differ in numbers are one kind."""
    if scan.times_from not in log.times_from:
        logger.info('per-point times: %s', scan.times_from)
    log.times_from[scan.times_from] += 1
    for note in scan.notes:
        remarks[re.sub(r'\d+', '', note)].append(note)


def _one(
    frame: CloudFrame,
    front_end: FrontEnd,
    sinks: tuple[Sink, ...],
    log: ReplayLog,
    threshold: float,
) -> FrameLog | None:
    """One cloud: decoded, stepped, logged, written."""
    if frame.scan is None:
        log.drops.append(Drop(frame.stamp, frame.error))
        logger.warning('cloud at %.6f s dropped: %s', frame.stamp / NS_PER_S, frame.error)
        return None
    result = front_end.step(frame.scan)
    line = log_frame(frame.message, result, threshold)
    log.frames.append(line)
    if not result.accepted:
        log.drops.append(Drop(frame.stamp, line.reason))
        return line
    for sink in sinks:
        sink.add(frame.message, result)
    return line

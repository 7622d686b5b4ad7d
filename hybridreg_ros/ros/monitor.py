# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Monitor: thread-safe counters and the last result; what the diagnostics are made from."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

from hybridreg_ros.core.scan import NS_PER_S
from hybridreg_ros.odometry.result import Reason, Source

if TYPE_CHECKING:
    from collections.abc import Mapping

    from hybridreg_ros.odometry.result import OdometryResult

POOR = (Reason.TOO_FEW_POINTS, Reason.NO_OVERLAP, Reason.REFINEMENT_FAILED)
"""Reasons of frames that got no pose of their own."""

_WINDOW = 50


class Drop(StrEnum):
    """Why a cloud did not become odometry; further causes are the front end's reasons."""

    BAD_CLOUD = 'bad_cloud'
    TOO_MANY_POINTS = 'too_many_points'
    QUEUE_FULL = 'queue_full'
    PAUSED = 'paused'
    RESET = 'reset'
    TRANSPORT = 'lost_in_transport'
    INTERNAL_ERROR = 'internal_error'


@dataclass(frozen=True)
class Snapshot:
    """State of the node at one instant.

    Attributes:
        received: clouds that reached the subscription callback.
        processed: clouds that became odometry.
        dropped: count by cause, clouds lost in the transport included.
        recent_drops: count by cause since the previous snapshot.
        poor: frames whose pose is only predicted or lost, by reason.
        recent_poor: the same since the previous snapshot.
        last_drop: one line about the latest dropped cloud.
        input_rate_hz: rate of arrival; 0 when unknown.
        idle_s: seconds since the last cloud, or since the start.
        odometry_age_s: seconds since a cloud last became odometry, or since the start.
        latency_s: median seconds from arrival to publication.
        worst_latency_s: largest of the last 50.
        invalid_points: rows with NaN or inf so far.
        near_points: rows without a return, or nearer than the sensor can see, so far.
        last: the last result, None before the first.
        last_switch: one line about the last change of source.
        note: remark of the decoder about per-point times, '' for none.
    """

    received: int
    processed: int
    dropped: Mapping[str, int]
    recent_drops: Mapping[str, int]
    poor: Mapping[str, int]
    recent_poor: Mapping[str, int]
    last_drop: str
    input_rate_hz: float
    idle_s: float
    odometry_age_s: float
    latency_s: float
    worst_latency_s: float
    invalid_points: int
    near_points: int
    last: OdometryResult | None
    last_switch: str
    note: str


class Monitor:
    """Counts what happens to every cloud."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._arrivals: deque[float] = deque(maxlen=_WINDOW)
        self._latencies: deque[float] = deque(maxlen=_WINDOW)
        self._dropped: Counter[str] = Counter()
        self._reported: Counter[str] = Counter()
        self._poor: Counter[str] = Counter()
        self._poor_reported: Counter[str] = Counter()
        self._last_drop = ''
        self._received = 0
        self._processed = 0
        self._invalid = 0
        self._near = 0
        self._since = self._posed = time.monotonic()
        self._result: OdometryResult | None = None
        self._switch = 'none'
        self._note = ''

    def begin(self) -> None:
        """The subscription is made: silence counts from now on."""
        with self._lock:
            self._since = self._posed = time.monotonic()

    def arrived(self) -> float:
        """Count a cloud that reached the callback; returns its monotonic time, s."""
        now = time.monotonic()
        with self._lock:
            self._received += 1
            self._arrivals.append(now)
        return now

    def dropped(self, cause: Drop | Reason, text: str, count: int = 1) -> None:
        """Count clouds that will not become odometry."""
        with self._lock:
            self._dropped[cause.value] += count
            self._last_drop = f'{cause.value}: {text}'

    def processed(self, result: OdometryResult, arrival_s: float) -> str:
        """Count a result; returns a line when the source changed.

        Args:
            result: what the front end made of the cloud.
            arrival_s: what `arrived` returned for it.
        """
        line = ''
        with self._lock:
            self._processed += 1
            self._posed = time.monotonic()
            self._invalid += result.scan.dropped - result.scan.near
            self._near += result.scan.near
            self._note = '; '.join(result.scan.notes)
            if result.reason in POOR or result.source is Source.LOST:
                self._poor[result.reason.value] += 1
            self._latencies.append(self._posed - arrival_s)
            before = None if self._result is None else self._result.source
            if before is not None and before is not result.source:
                seconds = result.stamp / NS_PER_S
                line = (
                    f'{before.value} to {result.source.value} at {seconds:.3f} s: '
                    f'{result.reason.value}, confidence {result.confidence:.2f}'
                )
                self._switch = line
            self._result = result
        return line

    def finished(self, result: OdometryResult) -> None:
        """Take the timings of a counted result over, mask and map included."""
        with self._lock:
            self._result = result

    def forget(self) -> None:
        """Drop the last result after a reset; counters go on."""
        with self._lock:
            self._result = None

    def snapshot(self) -> Snapshot:
        """State now; drops since the previous call are in `recent_drops`."""
        with self._lock:
            now = time.monotonic()
            recent = self._dropped - self._reported
            self._reported = self._dropped.copy()
            poor = self._poor - self._poor_reported
            self._poor_reported = self._poor.copy()
            latencies = sorted(self._latencies) or [0.0]
            arrivals = self._arrivals
            span = arrivals[-1] - arrivals[0] if len(arrivals) > 1 else 0.0
            return Snapshot(
                received=self._received,
                processed=self._processed,
                dropped=dict(self._dropped),
                recent_drops=dict(recent),
                poor=dict(self._poor),
                recent_poor=dict(poor),
                last_drop=self._last_drop,
                input_rate_hz=(len(arrivals) - 1) / span if span > 0.0 else 0.0,
                idle_s=now - (arrivals[-1] if arrivals else self._since),
                odometry_age_s=now - self._posed,
                latency_s=latencies[len(latencies) // 2],
                worst_latency_s=latencies[-1],
                invalid_points=self._invalid,
                near_points=self._near,
                last=self._result,
                last_switch=self._switch,
                note=self._note,
            )

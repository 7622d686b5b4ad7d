# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Worker: one thread that turns waiting clouds into results, in order, one at a time."""

from __future__ import annotations

import threading
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from hybridreg_ros.core.errors import HybridRegError
from hybridreg_ros.core.pointcloud2 import to_scan
from hybridreg_ros.odometry.result import Source
from hybridreg_ros.ros.frame_queue import FrameQueue
from hybridreg_ros.ros.monitor import Drop, Monitor

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    from hybridreg_ros.core.scan import Scan
    from hybridreg_ros.odometry.frontend import HybridOdometry
    from hybridreg_ros.odometry.result import OdometryResult
    from hybridreg_ros.ros.node_config import NodeConfig


class Arrival(NamedTuple):
    """A cloud on its way: the message and its monotonic time of arrival, s."""

    message: Any
    time_s: float


class Worker:
    """Queue, front end and thread."""

    def __init__(
        self,
        front_end: HybridOdometry,
        config: NodeConfig,
        monitor: Monitor,
        begin: Callable[[Scan], None],
        publish_odometry: Callable[[OdometryResult], None],
        publish: Callable[[Any, OdometryResult], None],
        warn: Callable[[str, str], None],
    ) -> None:
        """Prepare; nothing runs until `start`.

        Args:
            front_end: only this thread steps it.
            config: see `configure`.
            monitor: told about every cloud.
            begin: called in this thread with each scan before it is stepped.
            publish_odometry: called in this thread as soon as the pose of a cloud is known.
            publish: called in this thread with the message and its result, mask included.
            warn: logs cause and text as one line.
        """
        self._front_end = front_end
        self._monitor = monitor
        self._begin = begin
        self._publish_odometry = publish_odometry
        self._publish = publish
        self._warn = warn
        self._queue: FrameQueue[Arrival] = FrameQueue(depth=1)
        self._busy = threading.Lock()
        self._thread = self._new_thread()
        self.configure(config)

    def _new_thread(self) -> threading.Thread:
        return threading.Thread(target=self._run, name='hybridreg_worker', daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def configure(self, config: NodeConfig) -> None:
        """Take queue depth, drop policy and what the decoder needs from a config."""
        self._decoding = (config.time_unit, config.scan_period_s, config.decode_points)
        gone = self._queue.configure(config.queue_depth, config.drop_policy == 'oldest')
        if gone:
            self._monitor.dropped(Drop.QUEUE_FULL, 'queue_depth was reduced', gone)

    def submit(self, arrival: Arrival) -> None:
        """Queue a cloud; never blocks."""
        gone = self._queue.put(arrival)
        if gone:
            self._monitor.dropped(Drop.QUEUE_FULL, 'clouds come faster than they are processed')

    @property
    def waiting(self) -> int:
        """Clouds in the queue."""
        return len(self._queue)

    def reset(self, restart: Callable[[], object]) -> None:
        """Forget pose and map once the current cloud is done; waiting clouds are dropped.

        Args:
            restart: called before the next cloud is begun.
        """
        gone = self._queue.clear()
        with self._busy:
            self._front_end.reset()
            self._monitor.forget()
            restart()
        if gone:
            self._monitor.dropped(Drop.RESET, 'waiting while ~/reset was called', gone)

    def map_points(self) -> NDArray[np.float32]:
        """Static points (N, 3) of the local map, front end's frame, after the current cloud."""
        with self._busy:
            return self._front_end.map_points()

    def stop(self, timeout_s: float = 5.0) -> None:
        """Drop what waits and end the thread after the current cloud.

        Args:
            timeout_s: longest wait for it; the thread goes on alone after that.
        """
        self._queue.close()
        if self._thread.is_alive():
            self._thread.join(timeout_s)

    def _run(self) -> None:
        """Work until the queue is closed.

        An error that is no HybridRegError is a bug: its traceback is logged, the cloud is
        counted, and a new thread goes on with the next cloud.
        """
        finished = False
        try:
            while (arrival := self._queue.get()) is not None:
                with self._busy:
                    self._handle(arrival)
            finished = True
        finally:
            if not finished:
                self._monitor.dropped(Drop.INTERNAL_ERROR, 'see the traceback in the log')
                self._thread = self._new_thread()
                self._thread.start()

    def _handle(self, arrival: Arrival) -> None:
        try:
            scan = to_scan(arrival.message, *self._decoding)
            self._begin(scan)
            result = self._front_end.step(scan, partial(self._posed, arrival.time_s))
        except HybridRegError as error:
            self._monitor.dropped(Drop.BAD_CLOUD, str(error))
            self._warn(Drop.BAD_CLOUD.value, str(error))
            return
        if not result.accepted:
            text = f'cloud at {scan.stamp_s:.3f} s in frame {scan.frame_id!r}'
            self._monitor.dropped(result.reason, text)
            self._warn(result.reason.value, f'dropped {text}')
            return
        self._publish(arrival.message, result)
        self._monitor.finished(result)

    def _posed(self, arrived_s: float, result: OdometryResult) -> None:
        """Publish a pose before mask and map are made."""
        self._publish_odometry(result)
        switch = self._monitor.processed(result, arrived_s)
        if switch:
            self._warn('switch', switch)
        elif result.source is Source.LOST:
            self._warn('lost', result.reason.value)

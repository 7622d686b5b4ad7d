# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Worker: waiting clouds become results, in order; each stage has its thread."""

from __future__ import annotations

import queue
import threading
from typing import TYPE_CHECKING, Any, NamedTuple

from hybridreg_ros.core.errors import HybridRegError
from hybridreg_ros.core.pointcloud2 import to_scan
from hybridreg_ros.odometry.result import Source
from hybridreg_ros.ros.clouds.frame_queue import FrameQueue
from hybridreg_ros.ros.monitor import Drop, Monitor

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray

    from hybridreg_ros.core.scan import Scan
    from hybridreg_ros.odometry.frontend import HybridOdometry, Prepared
    from hybridreg_ros.odometry.result import OdometryResult, Rest
    from hybridreg_ros.ros.node_config import NodeConfig


class Arrival(NamedTuple):
    """A cloud on its way: the message and its monotonic time of arrival, s."""

    message: Any
    time_s: float


class Ready(NamedTuple):
    """A decoded cloud: its message, scan, time of arrival (monotonic, s), and what is done of it.

    `epoch` counts the resets before it.
    """

    message: Any
    scan: Scan
    arrived_s: float
    prepared: Prepared | None
    epoch: int


class Worker:
    """Queue, front end and three threads: clouds are decoded, then located, then completed.

    Attributes:
        join: called in the first thread with a message and its scan; gives those that are stepped.
    """

    def __init__(
        self,
        front_end: HybridOdometry,
        config: NodeConfig,
        monitor: Monitor,
        begin: Callable[[Scan], None],
        publish_odometry: Callable[[OdometryResult], None],
        publish: Callable[[Any, OdometryResult], None],
        warn: Callable[[str, str], None],
        say: Callable[[str], object] = lambda _: None,
    ) -> None:
        """Prepare; nothing runs until `start`.

        Args:
            front_end: only these threads step it.
            config: see `configure`.
            monitor: told about every cloud.
            begin: called in the second thread with each scan before it is stepped.
            publish_odometry: called there as soon as the pose of a cloud is known.
            publish: called in the third thread with the message and its result, mask included.
            warn: logs cause and text as one line.
            say: logs a line that is no warning.
        """
        self._front_end = front_end
        self._monitor = monitor
        self.join: Callable[[Any, Scan], tuple[Any, Scan]] = lambda *alone: alone
        self._begin = begin
        self._publish_odometry = publish_odometry
        self._publish = publish
        self._warn = warn
        self._say = say
        self._times_from = ''
        self._queue: FrameQueue[Arrival] = FrameQueue(depth=1)
        self._busy = threading.Lock()
        self._behind = False
        self._epoch = 0
        self._ready: queue.SimpleQueue[Ready | None] = queue.SimpleQueue()
        self._room = threading.Semaphore()
        self._holds = False
        self._located: queue.SimpleQueue[tuple[Any, Rest] | None] = queue.SimpleQueue()
        self._threads = {work: self._new(work) for work in self._stages}
        self.configure(config)

    @property
    def _stages(self) -> tuple[Callable[[], None], ...]:
        return self._decode_all, self._locate_all, self._complete_all

    def _new(self, work: Callable[[], None]) -> threading.Thread:
        """A thread for one stage, which works until what it waits for has ended.

        An error that is no HybridRegError is a bug: its traceback is logged, the cloud is counted,
        and a new thread goes on with the next cloud.
        """

        def run() -> None:
            finished = False
            try:
                work()
                finished = True
            finally:
                if not finished:
                    self._monitor.dropped(Drop.INTERNAL_ERROR, 'see the traceback in the log')
                    self._threads[work] = self._new(work)
                    self._threads[work].start()

        name = f'hybridreg{work.__name__}'
        return threading.Thread(target=run, name=name, daemon=True)

    def start(self) -> None:
        """Start the threads, unless they run."""
        for thread in self._threads.values():
            if not thread.is_alive():
                thread.start()

    def configure(self, config: NodeConfig) -> None:
        """Take queue depth, drop policy and what the decoder needs from a config."""
        self._decoding = (
            config.time_unit,
            config.scan_period_s,
            config.time_field,
            config.decode_points,
        )
        self._sheds = config.drop_policy == 'oldest'
        gone = self._queue.configure(config.queue_depth, self._sheds)
        if gone:
            self._monitor.dropped(Drop.QUEUE_FULL, 'queue_depth was reduced', gone)

    def submit(self, arrival: Arrival) -> None:
        """Queue a cloud; never blocks."""
        self._too_late(self._queue.put(arrival))

    def _too_late(self, gone: int) -> None:
        """Count clouds that had to make room for later ones."""
        if gone:
            self._behind = True
            text = 'clouds come faster than they are processed'
            self._monitor.dropped(Drop.QUEUE_FULL, text, gone)

    @property
    def waiting(self) -> int:
        """Clouds in the queue."""
        return len(self._queue)

    def drop(self, cause: Drop, text: str) -> None:
        """Drop waiting clouds and count them."""
        gone = self._queue.clear()
        if gone:
            self._monitor.dropped(cause, text, gone)

    def reset(self, restart: Callable[[], object]) -> None:
        """Forget pose and map once the current cloud is done; waiting clouds are dropped.

        Args:
            restart: called before the next cloud is begun.
        """
        self.drop(Drop.RESET, 'waiting while ~/reset was called')
        with self._busy:
            self._epoch += 1
            self._front_end.reset()
            self._monitor.forget()
            restart()

    def map_points(self) -> NDArray[np.float32]:
        """Static points (N, 3) of the local map, front end's frame, after the current cloud.

        May be called by `publish`: no lock of the second thread is held then.
        """
        with self._busy:
            return self._front_end.map_points()

    def stop(self, timeout_s: float = 5.0) -> None:
        """Drop what waits and end the thread after the current cloud.

        Args:
            timeout_s: longest wait for it; the thread goes on alone after that.
        """
        self._queue.close()
        for work, after in zip(self._stages, (self._ready, self._located, None), strict=True):
            if self._threads[work].is_alive():
                self._threads[work].join(timeout_s)
            if after is not None:
                after.put(None)

    def _decode_all(self) -> None:
        """Decode clouds and prepare them.

        The next one is taken when the last one has been matched; when the front end is much
        behind, the newest then. Pose, mask and map of the last one are made meanwhile.
        """
        while self._room.acquire():
            if self._sheds and self._front_end.wants_newest:
                self._too_late(self._queue.shed())
            if (arrival := self._queue.get()) is None:
                return
            ready = None
            try:
                ready = self._decoded(arrival)
            finally:
                if ready is None:
                    self._room.release()
            if ready is not None:
                self._ready.put(ready)

    def _decoded(self, arrival: Arrival) -> Ready | None:
        """A cloud decoded and prepared; None when it cannot be decoded."""
        epoch = self._epoch
        try:
            message, scan = self.join(arrival.message, self.decode(arrival.message))
        except HybridRegError as error:
            self._monitor.dropped(Drop.BAD_CLOUD, str(error))
            self._warn(Drop.BAD_CLOUD.value, str(error))
            return None
        self._tell_times(scan)
        return Ready(message, scan, arrival.time_s, self._front_end.prepare(scan), epoch)

    def decode(self, msg: Any) -> Scan:
        """The scan of a cloud as the front end sees it.

        Raises:
            PointCloudError: the cloud contradicts itself.
        """
        return self._front_end.seen(to_scan(msg, *self._decoding))

    def _locate_all(self) -> None:
        """Find the pose of each decoded cloud and publish it."""
        while (ready := self._ready.get()) is not None:
            self._behind |= self._queue.half_full
            self._holds = True
            try:
                with self._busy:
                    if ready.epoch == self._epoch:
                        self._locate(ready)
                    else:
                        self._monitor.dropped(Drop.RESET, 'waiting while ~/reset was called')
            finally:
                self._make_room()

    def _make_room(self) -> None:
        """Let the next cloud be decoded, once for each that is located."""
        if self._holds:
            self._holds = False
            self._room.release()

    def _locate(self, ready: Ready) -> None:
        scan = ready.scan
        try:
            self._begin(scan)
            behind, self._behind = self._behind, False
            result, rest = self._front_end.locate(scan, behind, ready.prepared, self._make_room)
        except HybridRegError as error:
            self._monitor.dropped(Drop.BAD_CLOUD, str(error))
            self._warn(Drop.BAD_CLOUD.value, str(error))
            return
        if not result.accepted:
            text = f'cloud at {scan.stamp_s:.3f} s in frame {scan.frame_id!r}'
            self._monitor.dropped(result.reason, text)
            self._warn(result.reason.value, f'dropped {text}')
            return
        self._posed(ready.arrived_s, result)
        self._located.put((ready.message, rest))

    def _complete_all(self) -> None:
        """Make mask, map and keyframes of located clouds and publish their points.

        The next cloud is matched meanwhile; its pose waits for the map.
        """
        while (located := self._located.get()) is not None:
            message, rest = located
            result = rest()
            self._publish(message, result)
            self._monitor.finished(result)

    def _tell_times(self, scan: Scan) -> None:
        """Log which per-point times are used when that changes, and what is odd in the cloud."""
        if len(scan) and scan.times_from != self._times_from:
            self._times_from = scan.times_from
            self._say(f'per-point times: {scan.times_from}')
        for note in scan.notes:
            self._warn('cloud', note)

    def _posed(self, arrived_s: float, result: OdometryResult) -> None:
        """Publish a pose before mask and map are made."""
        self._publish_odometry(result)
        switch = self._monitor.processed(result, arrived_s)
        if switch:
            self._warn('switch', switch)
        elif result.source is Source.LOST:
            self._warn('lost', result.reason.value)

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Player: publishes the messages of a bag at a given rate, with /clock and flow control."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from rosgraph_msgs.msg import Clock

from hybridreg_ros.core.errors import BagError, DependencyError
from hybridreg_ros.core.scan import NS_PER_S
from hybridreg_ros.ros.conversions import to_time
from hybridreg_ros.ros.playback.interfaces import message_class
from hybridreg_ros.ros.qos import profile, publisher_events

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rclpy.node import Node

POINT_CLOUD2 = 'sensor_msgs/msg/PointCloud2'
_NAP_S = 0.002


@dataclass(frozen=True)
class PlayOptions:
    """How a bag is played.

    Attributes:
        names: other names for topics of the bag.
        topics: topics to publish; empty = every topic whose type is installed.
        rate: speed, 1 = as recorded; 0 = as fast as the flow control allows.
        clock_hz: /clock messages per second, 0 = none.
        reliable: offer reliable QoS; False = sensor data.
        depth: messages DDS keeps per topic.
        wait_s: longest wait for subscribers of the clouds; 0 = none.
        start_s: seconds of the bag to skip.
        duration_s: seconds of the bag to play; 0 = all.
    """

    topics: tuple[str, ...] = ()
    names: Mapping[str, str] = field(default_factory=dict)
    rate: float = 1.0
    clock_hz: float = 0.0
    reliable: bool = True
    depth: int = 10
    wait_s: float = 0.0
    start_s: float = 0.0
    duration_s: float = 0.0


@dataclass
class PlayReport:
    """What was published.

    Attributes:
        sent: messages per topic.
        clouds: clouds among them.
        unheard: clouds that nobody subscribed to at their time.
        late: messages published more than 50 ms after their time.
        seconds: wall time.
    """

    sent: dict[str, int] = field(default_factory=dict)
    clouds: int = 0
    unheard: int = 0
    late: int = 0
    seconds: float = 0.0


class Player:
    """Publishes a bag from one node; the caller spins the node."""

    def __init__(
        self,
        node: Node,
        bag: Any,
        options: PlayOptions,
        active: Callable[[], bool] = lambda: True,
    ) -> None:
        """Create the publishers.

        Args:
            node: owner of the publishers.
            bag: opened bag (replay.bag_reader.Bag); the caller closes it.
            options: see PlayOptions.
            active: asked often; playing ends early once it says False.

        Raises:
            BagError: the bag lacks a topic asked for.
            DependencyError: a message package of a topic asked for is not installed.
        """
        self._node = node
        self._options = options
        self._bag = bag
        self._active = active
        types = {t.name: t.msgtype for t in self._bag.topics.values()}
        missing = sorted(set(options.topics) - set(types))
        if missing:
            found = ', '.join(sorted(types)) or 'no topic'
            raise BagError(f'{bag.path} has no topic {", ".join(missing)}; found: {found}')
        self._clouds = {t for t, kind in types.items() if kind == POINT_CLOUD2}
        self._publishers: dict[str, Any] = {}
        for topic in options.topics or types:
            self._add(topic, types[topic], required=topic in options.topics)
        self._clock = node.create_publisher(Clock, '/clock', 10) if options.clock_hz else None

    def _add(self, topic: str, kind: str, required: bool) -> None:
        message = message_class(kind)
        if message is None:
            text = f'{topic} is not played: message type {kind} is not installed'
            if required:
                raise DependencyError(text)
            self._node.get_logger().warning(text)
            return
        latched = topic.endswith('tf_static')  # late subscribers need it
        name = self._options.names.get(topic, topic.lstrip('/'))
        self._publishers[topic] = self._node.create_publisher(
            message,
            name,
            profile(self._options.reliable or latched, self._options.depth, latched),
            event_callbacks=publisher_events(
                self._node, name, 'play with --qos reliable, or subscribe best effort'
            ),
        )

    @property
    def cloud_publishers(self) -> list[Any]:
        """Publishers of the cloud topics that are played."""
        return [p for t, p in self._publishers.items() if t in self._clouds]

    @property
    def heard(self) -> bool:
        """Whether every cloud topic has a subscriber."""
        return not self.unheard

    @property
    def unheard(self) -> list[str]:
        """Cloud topics that nobody subscribes to, by their full names."""
        return [p.topic_name for p in self.cloud_publishers if not p.get_subscription_count()]

    @property
    def hint(self) -> str:
        """How to reach those who wait for clouds on another topic; '' when there is nobody."""
        node = self._node
        topics = [n for n, kinds in node.get_topic_names_and_types() if POINT_CLOUD2 in kinds]
        for name in topics:
            if node.count_subscribers(name) and not node.count_publishers(name) and self.unheard:
                rule = f'{self.unheard[0]}:={name}'
                return f'; {name} waits for clouds: add --ros-args -r {rule}'
        return ''

    def wait_until(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Wait for a condition; False when the time is over or playing is to end."""
        end = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() > end or not self._active():
                return False
            time.sleep(0.02)
        return True

    def play(
        self, report: PlayReport, may_send: Callable[[int], bool] | None = None
    ) -> PlayReport:
        """Publish the bag once.

        Args:
            report: counters to go on with.
            may_send: asked with a cloud's stamp (ns) before it goes out, again and again until it
                says True; None = no flow control.

        Returns:
            The same report.

        Raises:
            BagError: the bag is damaged at the place reached.
        """
        o = self._options
        began = time.monotonic()
        first = None
        self._next_clock = 0
        for message in self._bag.messages(list(self._publishers)):
            first = message.log_time if first is None else first
            offset_s = (message.log_time - first) / NS_PER_S - o.start_s
            if offset_s < 0.0:
                continue
            if o.duration_s and offset_s > o.duration_s:
                break
            due = began + offset_s / o.rate if o.rate else began
            if not self._sleep_until(due, message.log_time):
                break
            is_cloud = message.topic in self._clouds
            while is_cloud and may_send is not None and not may_send(message.stamp):
                if not self._active():
                    return report
                time.sleep(_NAP_S)
            if o.rate and not may_send:
                report.late += time.monotonic() - due > 0.05
            self._publishers[message.topic].publish(message.raw)
            report.sent[message.topic] = report.sent.get(message.topic, 0) + 1
            if is_cloud:
                self._count(report, self._publishers[message.topic])
        report.seconds += time.monotonic() - began
        return report

    def _count(self, report: PlayReport, publisher: Any) -> None:
        """Count a cloud; say once that nobody hears it."""
        report.clouds += 1
        if publisher.get_subscription_count():
            return
        if not report.unheard:
            text = f'nobody listens to {publisher.topic_name} yet; --wait waits for a subscriber'
            self._node.get_logger().warning(text + self.hint)
        report.unheard += 1

    def _sleep_until(self, due: float, bag_ns: int) -> bool:
        """Sleep, sending /clock meanwhile; False when playing is to end."""
        o = self._options
        while self._active():
            left = due - time.monotonic()
            if self._clock is not None:
                now_ns = bag_ns - round(max(left, 0.0) * (o.rate or 1.0) * NS_PER_S)
                self._tick(now_ns)
            if left <= 0.0:
                return True
            time.sleep(min(left, 1.0 / o.clock_hz if o.clock_hz else 0.1))
        return False

    def _tick(self, now_ns: int) -> None:
        """Send /clock when its period is over in wall time; simulated time never goes back."""
        wall = time.monotonic_ns()
        if self._clock is not None and wall >= self._next_clock:
            self._next_clock = wall + round(NS_PER_S / self._options.clock_hz)
            self._clock.publish(Clock(clock=to_time(now_ns)))

    def flush(self, timeout_s: float) -> bool:
        """Wait until reliable subscribers have everything; False when the time is over."""
        from rclpy.duration import Duration

        end = time.monotonic() + timeout_s
        return all(
            p.wait_for_all_acked(Duration(seconds=max(end - time.monotonic(), 0.0)))
            for p in self._publishers.values()
        )

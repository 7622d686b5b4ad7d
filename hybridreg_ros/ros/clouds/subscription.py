# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A cloud subscription: QoS by parameter, the automatic choice, counted transport losses."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rclpy.clock import Clock, ClockType
from sensor_msgs.msg import PointCloud2

from hybridreg_ros.ros.qos import all_reliable, profile, subscription_events

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rclpy.node import Node
    from rclpy.subscription import Subscription
    from rclpy.timer import Timer

_LOOK_EVERY_S = 0.2
_HINT = 'set input_qos to sensor_data or auto'


class LossCounter:
    """Counts clouds that never arrived, from both hints the middleware gives.

    Its loss events miss what a full history overwrote; gaps in the sequence numbers of the only
    publisher miss what comes after the last cloud received. Both are at most the truth, so the
    larger one counts.
    """

    def __init__(self, on_lost: Callable[[int], None]) -> None:
        self._on_lost = on_lost
        self._last: int | None = None
        self._events = 0
        self._gaps = 0
        self._told = 0

    def event(self, count: int) -> None:
        """The middleware says that so many messages were lost."""
        self._events += count
        self._tell()

    def arrived(self, number: int | None, only_publisher: Callable[[], bool]) -> None:
        """A message with a sequence number of its publisher arrived."""
        last, self._last = self._last, number
        if number is None or last is None or number <= last + 1 or not only_publisher():
            return
        self._gaps += number - last - 1
        self._tell()

    def restart(self) -> None:
        """Forget the last number: another subscription begins."""
        self._last = None

    def _tell(self) -> None:
        lost = max(self._events, self._gaps)
        if lost > self._told:
            self._on_lost(lost - self._told)
            self._told = lost


class CloudSubscription:
    """Subscribes to clouds; with QoS 'auto' it follows the publishers that are there.

    Attributes:
        topic: resolved name of the topic.
        state: 'best_effort', 'reliable', or 'waiting for a publisher'.
    """

    def __init__(
        self,
        node: Node,
        source: tuple[str, str, int],
        on_cloud: Callable[[PointCloud2], None],
        on_lost: Callable[[int], None],
    ) -> None:
        """Subscribe, or with 'auto' wait for the first publisher.

        Args:
            node: owner of the subscription.
            source: name of the topic; sensor_data, reliable or auto; messages that DDS keeps.
            on_cloud: receives each message.
            on_lost: receives the number of messages that never arrived, each once.
        """
        self._node = node
        self._name, qos, self._depth = source
        self._hint = None if qos == 'auto' else _HINT
        self._on_cloud = on_cloud
        self._losses = LossCounter(on_lost)
        self._subscription: Subscription | None = None
        self._reliable: bool | None = None
        self.topic = node.resolve_topic_name(self._name)
        self.state = 'waiting for a publisher'
        self._timer: Timer | None = None
        if qos == 'auto':
            node.get_logger().info(f'subscribed to {self.topic}, {self.state}')
            self._timer = node.create_timer(
                _LOOK_EVERY_S, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME)
            )
        else:
            self._subscribe(qos == 'reliable')

    def _look(self) -> None:
        reliable = all_reliable(self._node, self.topic)
        if reliable is not None and reliable != self._reliable:
            self._subscribe(reliable)

    def _subscribe(self, reliable: bool) -> None:
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
        self._losses.restart()
        self._reliable = reliable
        self.state = 'reliable' if reliable else 'best_effort'
        self._subscription = self._node.create_subscription(
            PointCloud2,
            self._name,
            self._receive,
            profile(reliable, self._depth),
            event_callbacks=subscription_events(
                self._node, self.topic, self._hint, self._losses.event
            ),
        )
        self._node.get_logger().info(f'subscribed to {self.topic}, {self.state}')

    def _receive(self, msg: PointCloud2, info: Mapping[str, Any]) -> None:
        number = info.get('publication_sequence_number')
        self._losses.arrived(number, lambda: self._node.count_publishers(self.topic) <= 1)
        self._on_cloud(msg)

    def close(self) -> None:
        """Stop receiving."""
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None

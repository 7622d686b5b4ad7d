# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Flow: keeps the clouds under way below the node's queue depth, so that none is dropped."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry

from hybridreg_ros.ros.qos import profile

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from rclpy.node import Node

_CAUSE = 'dropped.'


class Flow:
    """Counts what one odometry node has finished: odometry it published, clouds it dropped.

    Odometry tells at once; clouds that were refused are learned from the node's diagnostics.

    Attributes:
        sent: clouds that were allowed to go.
        message: text of the target's last diagnostics.
    """

    def __init__(
        self,
        node: Node,
        target: str,
        window: int,
        on_odometry: Callable[[Odometry], None] | None = None,
    ) -> None:
        """Subscribe to the outputs of the target.

        Args:
            node: owner of the subscriptions.
            target: name of the odometry node, relative to the namespace of `node`.
            window: clouds that may be under way.
            on_odometry: receives each Odometry message.
        """
        self._window = window
        self._on_odometry = on_odometry
        self._lock = threading.Lock()
        self._status = f'{node.resolve_topic_name(target).lstrip("/")}: odometry'
        self.sent = 0
        self._odometry = 0
        self._base: dict[str, int] | None = None
        self._counts: dict[str, int] = {}
        self._changed = time.monotonic()
        self.message = ''
        self._subscriptions = [
            node.create_subscription(Odometry, f'{target}/odom', self._odom, profile(True, 100)),
            node.create_subscription(
                DiagnosticArray, '/diagnostics', self._diagnostics, profile(True, 100)
            ),
        ]

    def _odom(self, msg: Odometry) -> None:
        if self._on_odometry is not None:
            self._on_odometry(msg)
        with self._lock:
            self._odometry += 1

    def _diagnostics(self, msg: DiagnosticArray) -> None:
        for status in msg.status:
            if status.name == self._status:
                counts = {
                    item.key: int(item.value)
                    for item in status.values
                    if item.key in ('received', 'processed') or item.key.startswith(_CAUSE)
                }
                with self._lock:
                    self._base = counts if self._base is None else self._base
                    if counts != self._counts:
                        self._changed = time.monotonic()
                    self._counts = counts
                    self.message = status.message

    @property
    def seen(self) -> bool:
        """Whether diagnostics of the target have arrived."""
        return self._base is not None

    @property
    def dropped(self) -> Mapping[str, int]:
        """Clouds dropped by the target, by cause, since its diagnostics were first seen."""
        with self._lock:
            base = self._base or {}
            found = {
                key.removeprefix(_CAUSE): n - base.get(key, 0)
                for key, n in self._counts.items()
                if key.startswith(_CAUSE)
            }
        return {cause: n for cause, n in found.items() if n}

    @property
    def processed(self) -> int:
        """Clouds that became odometry."""
        with self._lock:
            base = self._base or {}
            told = self._counts.get('processed', 0) - base.get('processed', 0)
            return max(self._odometry, told)

    @property
    def received(self) -> int:
        """Clouds that reached the target's subscription."""
        with self._lock:
            base = self._base or {}
            return self._counts.get('received', 0) - base.get('received', 0)

    @property
    def idle(self) -> bool:
        """Whether the target has finished every cloud that reached it."""
        lost = self.dropped.get('lost_in_transport', 0)
        return self.processed + sum(self.dropped.values()) - lost >= self.received

    @property
    def quiet_s(self) -> float:
        """Seconds since a counter of the target last changed."""
        return time.monotonic() - self._changed

    @property
    def under_way(self) -> int:
        """Clouds sent and not yet known to be finished."""
        return self.sent - self.processed - sum(self.dropped.values())

    def may_send(self, _: int) -> bool:
        """Whether there is room for one more cloud; if so it is counted as sent."""
        if self.under_way >= self._window:
            return False
        self.sent += 1
        return True

    def drain(self, timeout_s: float) -> bool:
        """Wait until nothing is under way; False when nothing moves for `timeout_s`."""
        last, end = self.under_way, time.monotonic() + timeout_s
        while (now := self.under_way) > 0:
            if now != last:
                last, end = now, time.monotonic() + timeout_s
            if time.monotonic() > end:
                return False
            time.sleep(0.01)
        return True

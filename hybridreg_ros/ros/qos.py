# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Quality of service: profiles by parameter, automatic choice, one clear warning on a mismatch."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSProfile,
    ReliabilityPolicy,
    qos_policy_name_from_kind,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.node import Node


def profile(reliable: bool, depth: int, latched: bool = False) -> QoSProfile:
    """Keep-last profile; `latched` gives late subscribers the last messages."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def all_reliable(node: Node, topic: str) -> bool | None:
    """Whether every publisher of a topic is reliable; None when there is none yet."""
    infos = node.get_publishers_info_by_topic(topic)
    if not infos:
        return None
    return all(i.qos_profile.reliability == ReliabilityPolicy.RELIABLE for i in infos)


def subscription_events(
    node: Node, topic: str, hint: str | None, on_lost: Callable[[int], None]
) -> SubscriptionEventCallbacks:
    """Events of the cloud subscription.

    Args:
        node: whose logger warns.
        topic: name for the text.
        hint: what the user should set; None = a mismatch is dealt with elsewhere.
        on_lost: called with the number of messages that the transport lost since the last call.
    """
    warned: set[str] = set()

    def incompatible(event: Any) -> None:
        policy = qos_policy_name_from_kind(event.last_policy_kind)
        if hint is not None and policy not in warned:
            warned.add(policy)
            node.get_logger().warning(
                f'a publisher of {topic} offers an incompatible {policy}: '
                f'nothing arrives from it; {hint}'
            )

    def lost(event: Any) -> None:
        on_lost(int(event.total_count_change))

    return SubscriptionEventCallbacks(incompatible_qos=incompatible, message_lost=lost)


def publisher_events(node: Node, topic: str, hint: str) -> PublisherEventCallbacks:
    """Events of an output: one warning when a subscriber asks for more than is offered."""
    warned: set[str] = set()

    def incompatible(event: Any) -> None:
        policy = qos_policy_name_from_kind(event.last_policy_kind)
        if policy not in warned:
            warned.add(policy)
            node.get_logger().warning(
                f'a subscriber of {topic} requests an incompatible {policy}: '
                f'it receives nothing; {hint}'
            )

    return PublisherEventCallbacks(incompatible_qos=incompatible)

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Playing: a bag, a player and a flow control put together as the command line asks."""

from __future__ import annotations

import contextlib
import threading
from typing import TYPE_CHECKING, Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

from hybridreg_ros.core.errors import HybridRegError
from hybridreg_ros.ros.playback.flow import Flow
from hybridreg_ros.ros.playback.player import Player, PlayOptions, PlayReport
from hybridreg_ros.ros.session import ros_session

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from rclpy.node import Node

    from hybridreg_ros.ros.stop_signals import StopSignals

_FLUSH_S = 5.0
_DRAIN_S = 10.0


def options(args: argparse.Namespace) -> PlayOptions:
    """Options of the player from the command line.

    Raises:
        HybridRegError: a number is out of range.
    """
    for name in ('rate', 'clock', 'wait', 'start', 'duration', 'lossless'):
        if getattr(args, name) < 0 or getattr(args, name) != getattr(args, name):
            raise HybridRegError(f'--{name}: expected >= 0, found {getattr(args, name)}')
    if not args.rate and not args.lossless:
        raise HybridRegError('--rate 0 needs --lossless: expected a speed above 0')
    if args.lossless and args.qos != 'reliable':
        raise HybridRegError('--lossless needs --qos reliable')
    return PlayOptions(
        topics=tuple(args.topics),
        rate=args.rate,
        clock_hz=args.clock,
        reliable=args.qos == 'reliable',
        depth=args.qos_depth,
        wait_s=args.wait or (30.0 if args.lossless else 0.0),
        start_s=args.start,
        duration_s=args.duration,
    )


def open_bag(path: str | Path) -> Any:
    """Open a bag with the reader that the offline replay uses.

    Raises:
        BagError: missing, not a bag, or damaged beyond repair.
        DependencyError: rosbags or mcap is not installed.
    """
    from hybridreg_ros.replay import bag_reader

    return bag_reader.open_bag(path)


@contextlib.contextmanager
def spinning(node: Node) -> Iterator[None]:
    """Spin a node in a thread of its own."""
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)

    def spin() -> None:
        with contextlib.suppress(ExternalShutdownException, KeyboardInterrupt):
            executor.spin()

    thread = threading.Thread(target=spin, name='spin', daemon=True)
    thread.start()
    try:
        yield
    finally:
        executor.shutdown()
        thread.join(2.0)


def play(node: Node, args: argparse.Namespace, active: Callable[[], bool]) -> PlayReport:
    """Play the bag once or in a loop.

    Args:
        node: publishes; spun by this function.
        args: command line of bag_player.
        active: playing ends early once it says False.

    Raises:
        HybridRegError: bad options, a bad bag, or nobody listens.
    """
    opts = options(args)
    report = PlayReport()
    with contextlib.closing(open_bag(args.bag)) as bag, spinning(node):
        player = Player(node, bag, opts, active)
        flow = Flow(node, args.node, args.lossless) if args.lossless else None
        _wait(player, flow, opts.wait_s, args.node, active)
        while active():
            player.play(report, flow.may_send if flow else None)
            if active() and not sum(report.sent.values()):
                raise HybridRegError(f'{args.bag}: no message was played')
            if not args.loop:
                break
        if flow is not None and active() and not flow.drain(_DRAIN_S):
            node.get_logger().warning(f'{flow.under_way} clouds did not come back')
        if flow is not None and flow.dropped:
            node.get_logger().warning(f'dropped by {args.node}: {dict(flow.dropped)}')
        if opts.reliable and active() and not player.flush(_FLUSH_S):
            node.get_logger().warning('a subscriber has not acknowledged every message')
        if report.clouds and report.unheard == report.clouds:
            topics = ', '.join(player.unheard)
            raise HybridRegError(f'nobody listened to {topics} while it was played{player.hint}')
    return report


def _wait(
    player: Player, flow: Flow | None, wait_s: float, target: str, active: Callable[[], bool]
) -> None:
    """Wait for subscribers, and for the node that the flow control follows.

    Raises:
        HybridRegError: they did not come.
    """
    heard = not wait_s or player.wait_until(lambda: player.heard, wait_s)
    if not heard and active():
        topics = ', '.join(player.unheard)
        raise HybridRegError(f'nobody subscribed to {topics} within {wait_s:g} s{player.hint}')
    found = flow is None or player.wait_until(lambda: flow.seen, wait_s)
    if not found and active():
        raise HybridRegError(f'no diagnostics of node {target} within {wait_s:g} s (see --node)')


def run(args: argparse.Namespace, argv: list[str], stop: StopSignals) -> None:
    """Play a bag, and say what was played.

    Args:
        args: command line, parsed.
        argv: the same with its ROS arguments.
        stop: waits for the signals already.

    Raises:
        HybridRegError: bad options, a bad bag, or nobody listens.
    """
    with ros_session(argv, stop) as session:
        node = rclpy.create_node('bag_player')
        try:
            report = play(node, args, lambda: session.active)
            sent = ', '.join(f'{topic} {n}' for topic, n in sorted(report.sent.items()))
            node.get_logger().info(
                f'played {sent or "nothing"} in {report.seconds:.1f} s, {report.late} late, '
                f'{report.unheard} clouds unheard'
            )
        finally:
            node.destroy_node()

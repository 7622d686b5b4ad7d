# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Executable odometry_node: signals first, then everything that takes time to load."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from hybridreg_ros.core.heap import one_heap
from hybridreg_ros.ros.stop_signals import StopSignals, leave

if TYPE_CHECKING:
    import argparse


def parser() -> argparse.ArgumentParser:
    """Command line of the node, ROS arguments aside."""
    import argparse  # all imports come after the signals
    from importlib.metadata import version

    p = argparse.ArgumentParser(
        prog='odometry_node',
        usage='odometry_node [-h] [--version] [--managed] [--ros-args ...]',
        description='Turns the clouds of topic points into odometry and dynamic points.',
        epilog='ROS arguments: -r points:=/lidar/points (the topic of the clouds), '
        '-p NAME:=VALUE (a parameter), --params-file FILE (such as config/node.yaml), '
        '-r __ns:=/robot (namespace), --log-level LEVEL. docs/reference/ros.md lists topics, '
        'services and parameters.',
    )
    p.add_argument(
        '--version', action='version', version=f'odometry_node {version("hybridreg_ros")}'
    )
    p.add_argument(
        '--managed',
        action='store_true',
        help='wait for the lifecycle transitions of a managed node',
    )
    return p


def main(args: list[str] | None = None) -> int:
    """Run the node until it is told to stop.

    Args:
        args: command line without the program's name; None = that of this process.

    Returns:
        0 after shutdown, 2 when the node cannot start (one line on stderr). SIGINT and SIGTERM
        end the process with 0 from within; --help, --version and unknown arguments as argparse.
    """
    argv = sys.argv[1:] if args is None else args
    one_heap()
    with StopSignals() as stop:
        code = _run(argv, stop)
    if stop.asked:
        leave(code)  # a thread may be in a long call
    return code


def _run(argv: list[str], stop: StopSignals) -> int:
    from hybridreg_ros.core.errors import HybridRegError
    from hybridreg_ros.ros.session import own_arguments

    try:
        own = parser().parse_args(own_arguments('odometry_node', argv))
        from hybridreg_ros.ros.node import run

        run(argv, stop, own.managed)
    except HybridRegError as error:
        sys.stderr.write(f'odometry_node: {error}\n')
        return 2
    return 0


if __name__ == '__main__':
    raise SystemExit(main())

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Executable bag_player: plays a rosbag2 into ROS topics, with QoS and /clock on request."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from hybridreg_ros.ros.stop_signals import StopSignals, leave

if TYPE_CHECKING:
    import argparse


def parser() -> argparse.ArgumentParser:
    """Command line of the player."""
    import argparse  # all imports come after the signals
    from importlib.metadata import version

    p = argparse.ArgumentParser(prog='bag_player', description=__doc__)
    p.add_argument('--version', action='version', version=f'bag_player {version("hybridreg_ros")}')
    p.add_argument('bag', help='rosbag2 file (.mcap, .db3) or directory')
    p.add_argument('--topics', nargs='+', default=[], help='topics to play, default all')
    p.add_argument('--rate', type=float, default=1.0, help='speed, 1 = as recorded')
    p.add_argument(
        '--clock', type=float, nargs='?', const=100.0, default=0.0, metavar='HZ',
        help='publish /clock so often (100)',
    )  # fmt: skip
    p.add_argument('--qos', choices=('reliable', 'sensor_data'), default='reliable')
    p.add_argument('--qos-depth', type=int, default=10, help='messages DDS keeps per topic')
    p.add_argument(
        '--wait', type=float, nargs='?', const=30.0, default=0.0, metavar='S',
        help='wait so long for subscribers of the clouds (30 s), then give up with an error',
    )  # fmt: skip
    p.add_argument('--start', type=float, default=0.0, help='seconds to skip')
    p.add_argument('--duration', type=float, default=0.0, help='seconds to play, default all')
    p.add_argument('--loop', action='store_true', help='begin again at the end of the bag')
    p.add_argument(
        '--lossless', type=int, nargs='?', const=2, default=0, metavar='N',
        help='never more than N (2) clouds under way in the odometry node; implies --wait',
    )  # fmt: skip
    p.add_argument('--node', default='hybridreg', help='odometry node that --lossless follows')
    return p


def main(args: list[str] | None = None) -> int:
    """Play a bag.

    Args:
        args: command line without the program's name; None = that of this process.

    Returns:
        0 at the end of the bag, 2 after an error (one line on stderr). SIGINT and SIGTERM end the
        process with 0 from within.
    """
    argv = sys.argv[1:] if args is None else args
    with StopSignals() as stop:
        code = _run(argv, stop)
    if stop.asked:
        leave(code)
    return code


def _run(argv: list[str], stop: StopSignals) -> int:
    from hybridreg_ros.core.errors import HybridRegError
    from hybridreg_ros.ros.session import own_arguments

    try:
        parsed = parser().parse_args(own_arguments('bag_player', argv))
        from hybridreg_ros.ros.playback.playing import run

        run(parsed, argv, stop)
    except HybridRegError as error:
        sys.stderr.write(f'bag_player: {error}\n')
        return 2
    return 0


if __name__ == '__main__':
    raise SystemExit(main())

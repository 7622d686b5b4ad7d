# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Command line of the bag player; without rclpy, so that the reference can be made from it."""

from __future__ import annotations

import argparse
from importlib.metadata import version


def parser() -> argparse.ArgumentParser:
    """Command line of the player."""
    p = argparse.ArgumentParser(
        prog='bag_player',
        description='Play a rosbag2 into ROS topics, with QoS and /clock on request.',
    )
    p.add_argument('--version', action='version', version=f'bag_player {version("hybridreg_ros")}')
    p.add_argument('bag', help='rosbag2 file (.mcap, .db3) or directory')
    p.add_argument('--topics', nargs='+', default=[], help='topics to play (default: all)')
    p.add_argument('--rate', type=float, default=1.0, help='playback speed, 1 = as recorded')
    p.add_argument(
        '--clock',
        type=float,
        nargs='?',
        const=100.0,
        default=0.0,
        metavar='HZ',
        help='publish /clock at this rate (100 if HZ is left out)',
    )
    p.add_argument(
        '--qos',
        choices=('reliable', 'sensor_data'),
        default='reliable',
        help='quality of service of the topics',
    )
    p.add_argument(
        '--qos-depth', type=int, default=10, help='number of messages that DDS keeps per topic'
    )
    p.add_argument(
        '--wait',
        type=float,
        nargs='?',
        const=30.0,
        default=0.0,
        metavar='S',
        help='wait this long for subscribers of the clouds (30 s if S is left out), then exit '
        'with an error',
    )
    p.add_argument('--start', type=float, default=0.0, help='seconds to skip at the beginning')
    p.add_argument('--duration', type=float, default=0.0, help='seconds to play (default: all)')
    p.add_argument('--loop', action='store_true', help='start again at the end of the bag')
    p.add_argument(
        '--lossless',
        type=int,
        nargs='?',
        const=1,
        default=0,
        metavar='N',
        help='never have more than N clouds (1 if N is left out) in progress in the odometry '
        'node; implies --wait',
    )
    p.add_argument(
        '--node', default='hybridreg', help='name of the odometry node that --lossless watches'
    )
    return p

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""How long the node takes to end on a signal, at random moments from its start on.

Its start is when it waits for signals, about a tenth of a second after that of the interpreter.

python scripts/signal_report.py --moments 50
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from hybridreg_ros.core.pointcloud2 import from_arrays
from hybridreg_ros.ros.conversions import to_pointcloud2, to_time
from hybridreg_ros.ros.playback.live import own_node
from hybridreg_ros.ros.playback.node_process import LOCALHOST, waits_for_signals
from hybridreg_ros.ros.playback.transport_check import hall
from hybridreg_ros.ros.qos import profile

if TYPE_CHECKING:
    from rclpy.node import Node

_PERIOD_S = 0.1
_HANG_S = 60.0
_APART_S = 0.05


class Ending(NamedTuple):
    """One end of the node: moment of the signal and time to the exit, s; code; last line."""

    after_s: float
    signals: str
    took_s: float
    code: int
    last: str


def feed(node: Node, points: int, stopped: threading.Event) -> None:
    """Publish clouds of a hall at 10 Hz until told to stop."""
    publisher = node.create_publisher(PointCloud2, 'points', profile(reliable=True, depth=2))
    world, k = hall(points), 0
    while not stopped.wait(_PERIOD_S):
        k += 1
        world[:, 0] -= 0.1
        header = Header(stamp=to_time(k * 100_000_000), frame_id='lidar')
        publisher.publish(to_pointcloud2(from_arrays(world), header))


def once(rng: random.Random, longest_s: float, environment: dict[str, str]) -> Ending:
    """Start the node, signal it at a random moment, once or twice, and wait for its end."""
    signals = rng.choice((signal.SIGINT, signal.SIGTERM)), rng.choice((1, 2))
    after_s = rng.uniform(0.0, longest_s)
    with tempfile.TemporaryFile('w+') as log:
        process = subprocess.Popen(
            [
                sys.executable,
                '-m',
                'hybridreg_ros.ros.odometry_node',
                '--ros-args',
                '-r',
                '__ns:=/signals',
            ],
            env=environment,
            stdout=log,
            stderr=subprocess.STDOUT,
        )
        while not waits_for_signals(process.pid):
            time.sleep(0.001)
        time.sleep(after_s)
        began = time.monotonic()
        for k in range(signals[1]):
            time.sleep(_APART_S if k else 0.0)
            process.send_signal(signals[0])
        code = process.wait(_HANG_S)
        took_s = time.monotonic() - began
        log.seek(0)
        lines = log.read().strip().splitlines() or ['']
    traced = any('Traceback' in line for line in lines)
    name = f'{signals[0].name} x{signals[1]}'
    return Ending(after_s, name, took_s, code, lines[-1] if traced or code else '')


def main() -> int:
    """Print one line for each moment and the worst; 1 when an end was not clean."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').split('\n', maxsplit=1)[0])
    parser.add_argument('--moments', type=int, default=50)
    parser.add_argument('--longest', type=float, default=15.0, help='latest moment, s')
    parser.add_argument('--points', type=int, default=60_000, help='points per cloud')
    parser.add_argument('--seed', type=int, default=0)
    parser.add_argument('--cold', action='store_true', help='nothing is compiled beforehand')
    args = parser.parse_args()
    rng, endings, stopped = random.Random(args.seed), [], threading.Event()
    domain = 1 + os.getpid() % 99
    environment = {**os.environ, **LOCALHOST, 'ROS_DOMAIN_ID': str(domain)}
    with own_node('/signals', domain) as node, tempfile.TemporaryDirectory() as folder:
        if args.cold:
            environment['NUMBA_CACHE_DIR'] = str(Path(folder))
        thread = threading.Thread(target=feed, args=(node, args.points, stopped))
        thread.start()
        for _ in range(args.moments):
            ending = once(rng, args.longest, environment)
            endings.append(ending)
            end = f'ended after {ending.took_s:5.2f} s  code {ending.code}  {ending.last}'
            print(f'{ending.after_s:6.2f} s  {ending.signals:10}  {end}', flush=True)
        stopped.set()
        thread.join()
    faults = [e for e in endings if e.code or e.last]
    worst = max(e.took_s for e in endings)
    print(f'{len(endings)} moments: worst {worst:.2f} s, not clean: {len(faults)}')
    return int(bool(faults))


if __name__ == '__main__':
    sys.exit(main())

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What a sensor gets from the node while it plays at its own rate: answers and their delay.

Scans of a sequence go to and fro until the time is over, into the real node over DDS, with both
of its clouds subscribed (and not decoded, as a subscriber in C++ would cost next to nothing). A
recording whose scans are further apart than the rate says is played faster than it was moved
(`pace`); a simulated sequence is made at that rate, of a room with 640x480 pixels.

python scripts/live_report.py depth_7scenes --rate 10 --seconds 120
python scripts/live_report.py lidar_kitti_raw_22scans --rate 10 --seconds 30
python scripts/live_report.py dev-room-933 --rate 30 --seconds 30
python scripts/live_report.py depth_7scenes --burst 50    # scans that come at once
python scripts/live_report.py depth_7scenes --stall 3     # the node stands still, s

After a burst or a stall in the middle, poses of scans are compared with those that the same scans
had in the first third.
"""

from __future__ import annotations

import argparse
import collections
import itertools
import json
import os
import signal
import struct
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from hybridreg_ros.benchmark import suite_data
from hybridreg_ros.benchmark.suite_list import SEQUENCES
from hybridreg_ros.core import se3
from hybridreg_ros.core.pointcloud2 import from_arrays
from hybridreg_ros.core.scan import NS_PER_S
from hybridreg_ros.data.sequences.simulate import simulate
from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.ros.conversions import from_pose, to_pointcloud2, to_time
from hybridreg_ros.ros.node_config import NodeConfig
from hybridreg_ros.ros.playback.live import own_node
from hybridreg_ros.ros.playback.node_process import NodeProcess
from hybridreg_ros.ros.playback.playing import spinning
from hybridreg_ros.ros.qos import profile

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray
    from rclpy.node import Node

_NAMESPACE = '/live'
_STAMP = 4
"""Offset of the stamp (int32 s, uint32 ns) in a serialised cloud."""
_WARM_UP = 12
"""Clouds before the clock starts: the first pose compiles nothing, but loads the network."""
_START_S = 180.0


class Listener:
    """Everything that comes back, with its time of arrival."""

    def __init__(self, node: Node) -> None:
        self.arrived: dict[int, float] = {}
        self.poses: dict[int, NDArray[np.float64]] = {}
        self.branches: collections.Counter[str] = collections.Counter()
        self.clouds: collections.Counter[str] = collections.Counter()
        self.status: dict[str, str] = {}
        qos = profile(reliable=True, depth=10)
        node.create_subscription(Odometry, 'hybridreg/odom', self._odometry, qos)
        for name in ('dynamic_points', 'static_points'):
            count = self._counter(name)
            node.create_subscription(PointCloud2, f'hybridreg/{name}', count, qos, raw=True)
        node.create_subscription(DiagnosticArray, '/diagnostics', self._told, qos)

    def _odometry(self, message: Odometry) -> None:
        stamp = message.header.stamp.sec * NS_PER_S + message.header.stamp.nanosec
        self.arrived[stamp] = time.monotonic()
        self.poses[stamp] = from_pose(message.pose.pose)

    def _counter(self, name: str) -> Any:
        return lambda _: self.clouds.update([name])

    def _told(self, message: DiagnosticArray) -> None:
        self.status.update({v.key: v.value for s in message.status for v in s.values})


def serialised(args: argparse.Namespace) -> tuple[list[bytearray], float]:
    """Every n-th scan of a sequence as a serialised PointCloud2; how much faster than moved."""
    sequence = SEQUENCES[args.sequence]
    if sequence.source == 'simulated':
        scene = 'room' if sequence.kind == 'depth' else 'street'
        seed, share = sequence.seed, sequence.share
        made = simulate(scene, args.frames, args.rate, seed, dynamic=share, size=(640, 480))
        points, apart_s = [f.points for f in made], 1.0 / args.rate
    else:
        frames = suite_data.load(sequence, args.data, args.data)
        points = [f.scan.points for f in frames]
        apart_s = (frames[-1].scan.stamp - frames[0].scan.stamp) / (len(frames) - 1) / NS_PER_S
    header = Header(stamp=to_time(0), frame_id='sensor')
    clouds = (to_pointcloud2(from_arrays(some), header) for some in points[:: args.every])
    return [bytearray(serialize_message(c)) for c in clouds], apart_s * args.every * args.rate


def to_and_fro(clouds: list[bytearray]) -> Iterator[bytearray]:
    """The clouds forwards and backwards, for ever, so that the sensor never jumps."""
    return itertools.cycle([*clouds, *clouds[-2:0:-1]])


def play(
    node: Node,
    process: NodeProcess,
    clouds: Iterator[bytearray],
    count: int,
    rate_hz: float,
    first: int,
    trouble: Callable[[int], None] = lambda _: None,
) -> dict[int, float]:
    """Publish so many clouds at a rate; the times at which they went, by stamp.

    `trouble` is called before each, with its number.
    """
    publisher = node.create_publisher(PointCloud2, 'points', profile(reliable=True, depth=2))
    process.wait_until(publisher.get_subscription_count, _START_S, 'the node to subscribe')
    sent, began = {}, time.monotonic()
    for k in range(count):
        stamp = first + round(k * NS_PER_S / rate_hz)
        cloud = next(clouds)
        struct.pack_into('<iI', cloud, _STAMP, *divmod(stamp, NS_PER_S))
        trouble(k)
        time.sleep(max(0.0, began + k / rate_hz - time.monotonic()))
        sent[stamp] = time.monotonic()
        publisher.publish(bytes(cloud))
    node.destroy_publisher(publisher)
    return sent


def trouble_of(args: argparse.Namespace, pid: int) -> Callable[[int], None]:
    """Hold back clouds, or stop the node, in the middle."""
    middle = round(args.seconds * args.rate) // 2

    def trouble(k: int) -> None:
        if k == middle and args.burst:
            time.sleep(args.burst / args.rate)
        elif args.stall and k in {middle, middle + round(args.stall * args.rate)}:
            os.kill(pid, signal.SIGSTOP if k == middle else signal.SIGCONT)

    return trouble


def off(heard: Listener, sent: Sequence[int], period: int) -> tuple[float, float]:
    """Largest difference, mm and deg, of poses in the last third from those of the same scans.

    Args:
        heard: what came back.
        sent: stamps, ns, in order.
        period: after so many clouds the same scan comes again.
    """
    third, metres, degrees = len(sent) // 3, [0.0], [0.0]
    for k in range(2 * third, len(sent)):
        first = next((j for j in range(k % period, third, period) if sent[j] in heard.poses), None)
        if first is None or sent[k] not in heard.poses:
            continue
        between = se3.inverse(heard.poses[sent[first]]) @ heard.poses[sent[k]]
        metres.append(float(np.linalg.norm(between[:3, 3])))
        degrees.append(se3.rotation_angle_deg(between[:3, :3]))
    return 1e3 * max(metres), max(degrees)


def cpu_s(pid: int) -> float:
    """Processor time of a process so far."""
    fields = Path(f'/proc/{pid}/stat').read_text(encoding='ascii').rsplit(')', 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def measured(args: argparse.Namespace) -> dict[str, Any]:
    """Play and listen."""
    domain, (clouds, pace) = 1 + os.getpid() % 99, serialised(args)
    source = to_and_fro(clouds)
    with (
        own_node(_NAMESPACE, domain) as node,
        NodeProcess((OdometryConfig(), NodeConfig()), _NAMESPACE, domain) as process,
        spinning(node),
    ):
        heard = Listener(node)
        play(node, process, source, _WARM_UP, 1.0, NS_PER_S)
        process.wait_until(lambda: heard.arrived, _START_S, 'the first odometry')
        time.sleep(2.0)
        count, used = round(args.seconds * args.rate), cpu_s(process.pid)
        last = NS_PER_S * (_WARM_UP + 4)
        trouble = trouble_of(args, process.pid)
        sent = play(node, process, source, count, args.rate, last, trouble)
        time.sleep(1.5)
        used = cpu_s(process.pid) - used
        process.check()
    delays = 1e3 * np.array([heard.arrived[s] - t for s, t in sent.items() if s in heard.arrived])
    answered = len(delays)
    return {
        'pace': pace,
        'sent': len(sent),
        'answered': answered,
        'answered %': 100.0 * answered / len(sent),
        'answers a second': answered / args.seconds,
        **{f'p{p} ms': float(np.percentile(delays, p)) for p in (50, 95, 100) if answered},
        'cpu %': 100.0 * used / args.seconds,
        'off later mm, deg': off(heard, list(sent), 2 * len(clouds) - 2),
        'clouds': dict(heard.clouds),
        'status': {
            k: heard.status.get(k)
            for k in ('received', 'processed', 'dropped.queue_full', 'load', 'source', 'total_ms')
        },
    }


def main() -> int:
    """Measure, print and say as JSON."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').split('\n', maxsplit=1)[0])
    parser.add_argument('sequence', choices=list(SEQUENCES), metavar='SEQUENCE')
    parser.add_argument('--data', type=Path, default=Path('../shared/data'))
    parser.add_argument('--frames', type=int, default=150, help='of a simulated sequence')
    parser.add_argument('--every', type=int, default=1, help='take every n-th scan')
    parser.add_argument('--rate', type=float, default=10.0, help='scans a second')
    parser.add_argument('--seconds', type=float, default=30.0)
    parser.add_argument('--burst', type=int, default=0, help='clouds that come at once')
    parser.add_argument('--stall', type=float, default=0.0, help='seconds the node stands still')
    parser.add_argument('--json', type=Path)
    args = parser.parse_args()
    found = measured(args)
    for key, value in found.items():
        print(f'{key:18} {value:.1f}' if isinstance(value, float) else f'{key:18} {value}')
    if args.json:
        args.json.write_text(json.dumps(found, indent=1), encoding='utf-8')
    return 0


if __name__ == '__main__':
    sys.exit(main())

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""How the real node stands hours of clouds: growth of its memory, clouds lost and not answered.

The scans of a sequence are played forth and back over DDS (as scripts/memory_report.py does). Each
cloud is sent when the one before was answered, or, with --real, every tenth of a second.

    python scripts/endurance_report.py dev-street-6205              # lidar: an hour at 10 Hz
    python scripts/endurance_report.py dev-room-933                 # depth camera
    python scripts/endurance_report.py dev-room-933 --minutes 1     # to see that it works
"""

from __future__ import annotations

import argparse
import os
import resource
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from memory_report import loop_of, looped
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from hybridreg_ros.benchmark.suite_list import SEQUENCES
from hybridreg_ros.benchmark.suite_memory import WARM_STEPS
from hybridreg_ros.core.pointcloud2 import from_arrays
from hybridreg_ros.core.scan import NS_PER_S
from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.ros.conversions import to_ns, to_pointcloud2, to_time
from hybridreg_ros.ros.node_config import NodeConfig
from hybridreg_ros.ros.playback.flow import Flow
from hybridreg_ros.ros.playback.live import own_node
from hybridreg_ros.ros.playback.node_process import NodeProcess
from hybridreg_ros.ros.playback.playing import spinning
from hybridreg_ros.ros.qos import profile

if TYPE_CHECKING:
    from collections.abc import Sequence

    from nav_msgs.msg import Odometry

    from hybridreg_ros.core.scan import Scan

_HZ = 10
_LONGEST_S = 10.0
"""How long an answer is waited for."""


class Endurance(NamedTuple):
    """Outcome: clouds sent, answered by odometry, and dropped; MB early and late; seconds."""

    sent: int
    answered: int
    dropped: dict[str, int]
    early_mb: float
    late_mb: float
    seconds: float

    @property
    def lost(self) -> int:
        """Clouds of which the node knows nothing, or only that the transport lost them."""
        counted = sum(n for cause, n in self.dropped.items() if cause != 'lost_in_transport')
        return self.sent - self.answered - counted


def resident_mb(pid: int) -> float:
    """Resident memory of a process, MB."""
    pages = int(Path(f'/proc/{pid}/statm').read_text('ascii').split()[1])
    return pages * resource.getpagesize() / 1e6


def endure(
    clouds: Sequence[Scan], count: int, real: bool, config: OdometryConfig | None = None
) -> Endurance:
    """Send so many clouds into a node of its own.

    Args:
        clouds: scans in order, sensor frame, metres.
        count: clouds to send, more than `WARM_STEPS`.
        real: send at 10 Hz, else as fast as they are answered.
        config: settings of the front end.
    """
    space, domain = f'/endurance_{os.getpid()}', 1 + os.getpid() % 99
    settings = NodeConfig(input_qos='reliable', publish_tf=False)
    answered: set[int] = set()
    process = NodeProcess((config or OdometryConfig(), settings), space, domain)

    def keep(msg: Odometry) -> None:
        answered.add(to_ns(msg.header.stamp))

    with process, own_node(space, domain) as node:
        publisher = node.create_publisher(PointCloud2, 'points', profile(True, 10))
        flow = Flow(node, 'hybridreg', window=0, on_odometry=keep)
        with spinning(node):
            process.wait_until(
                lambda: flow.seen and publisher.get_subscription_count(), 300.0, 'the node'
            )
            began, early_mb = time.monotonic(), 0.0
            for k in range(count):
                stamp = (k + 1) * (NS_PER_S // _HZ)
                header = Header(stamp=to_time(stamp), frame_id='sensor')
                points = clouds[looped(len(clouds), k)].points
                publisher.publish(to_pointcloud2(from_arrays(points), header))
                if real:
                    time.sleep(max(0.0, began + (k + 1) / _HZ - time.monotonic()))
                else:
                    end = time.monotonic() + _LONGEST_S
                    while stamp not in answered and time.monotonic() < end:
                        time.sleep(0.001)
                process.check()
                if k == WARM_STEPS:
                    early_mb = resident_mb(process.pid)
                if k % 1000 == 0:
                    told = f'{k} of {count} clouds, {len(answered)} answered'
                    print(f'{told}, {resident_mb(process.pid):.1f} MB', file=sys.stderr)
            process.wait_until(lambda: flow.idle and flow.quiet_s > 2.5, 60.0, 'the last cloud')
            return Endurance(
                count,
                len(answered),
                dict(flow.dropped),
                early_mb,
                resident_mb(process.pid),
                time.monotonic() - began,
            )


def main() -> int:
    """Print one table; 1 when a cloud was lost."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('sequence', help='of the benchmark or the development suite')
    parser.add_argument('--minutes', type=float, default=60.0, help='of recording, at 10 Hz')
    parser.add_argument('--real', action='store_true', help='send at 10 Hz')
    parser.add_argument('--data', type=Path, default=Path('../shared/data'), help='recordings')
    parser.add_argument('--cache', type=Path, default=Path('out/suite/cache'), help='simulated')
    args = parser.parse_args()
    count = round(60 * _HZ * args.minutes)
    if args.sequence not in SEQUENCES:
        parser.error(f'sequence: {args.sequence!r} is none of {", ".join(SEQUENCES)}')
    if count <= WARM_STEPS:
        parser.error(f'--minutes: expected more than {WARM_STEPS / 60 / _HZ:.2f}')
    clouds = loop_of(SEQUENCES[args.sequence], args.data, args.cache)
    found = endure(clouds, count, args.real)
    grown_mb = found.late_mb - found.early_mb
    print(
        f'| sequence | points | sent | answered | dropped | lost | MB after {WARM_STEPS} | '
        'at the end | grown by | s |\n|---|---|---|---|---|---|---|---|---|---|\n'
        f'| {args.sequence} | {max(len(c) for c in clouds):,} | {found.sent:,} '
        f'| {found.answered:,} | {found.dropped or 0} | {found.lost} | {found.early_mb:.1f} '
        f'| {found.late_mb:.1f} | {grown_mb:.1f} | {found.seconds:.0f} |'
    )
    return int(found.lost > 0)


if __name__ == '__main__':
    sys.exit(main())

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Do full-size clouds reach the real node without a loss? Measured, with sensor-data QoS.

python -m hybridreg_ros.ros.playback.transport_check --frames 300 --rate 10 --points 120000
"""

from __future__ import annotations

import argparse
import logging
import os
import time
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from hybridreg_ros.core.pointcloud2 import from_arrays
from hybridreg_ros.core.scan import NS_PER_S
from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.ros.conversions import to_pointcloud2, to_time
from hybridreg_ros.ros.node_config import NodeConfig
from hybridreg_ros.ros.playback.flow import Flow
from hybridreg_ros.ros.playback.live import own_node
from hybridreg_ros.ros.playback.node_process import NodeProcess
from hybridreg_ros.ros.playback.playing import spinning
from hybridreg_ros.ros.qos import profile

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

logger = logging.getLogger(__name__)

_SENSOR_DATA_DEPTH = 5
_SPEED_M_S = 1.0


@dataclass(frozen=True)
class TransportReport:
    """Outcome of one measurement.

    Attributes:
        sent: clouds published, best effort.
        received: clouds that reached the subscription callback of the node.
        odometry: Odometry messages that came back.
        dropped: clouds the node dropped, by cause; lost_in_transport are told by the middleware.
        cloud_bytes: size of one cloud.
        publish_ms: median duration of one publish call.
        late: clouds published more than 20 ms after their time.
        seconds: wall time.
    """

    sent: int
    received: int
    odometry: int
    dropped: Mapping[str, int]
    cloud_bytes: int
    publish_ms: float
    late: int
    seconds: float

    @property
    def lost(self) -> int:
        """Clouds that did not reach the node."""
        return self.sent - self.received


def hall(count: int, seed: int = 0) -> NDArray[np.float32]:
    """(count, 3) float32 points on walls, rough floor and boxes of a hall of 60 x 40 x 8 m."""
    rng = np.random.default_rng(seed)
    half = np.array([30.0, 20.0, 4.0])
    points = rng.uniform(-half, half, (count, 3))
    axis = rng.integers(0, 3, count)
    points[np.arange(count), axis] = np.where(rng.random(count) < 0.5, -1.0, 1.0) * half[axis]
    boxed = np.flatnonzero(rng.random(count) < 0.4)
    corners = rng.uniform(-0.9 * half, 0.9 * half, (40, 3))
    which = rng.integers(0, len(corners), len(boxed))
    offset = rng.uniform(0.0, 2.0, (len(boxed), 3))
    offset[np.arange(len(boxed)), rng.integers(0, 3, len(boxed))] = 0.0
    points[boxed] = corners[which] + offset
    return (points + rng.normal(0.0, 0.01, points.shape)).astype(np.float32)


def check_transport(
    frames: int = 300,
    rate_hz: float = 10.0,
    points: int = 120_000,
    config: OdometryConfig | None = None,
    node_config: NodeConfig | None = None,
) -> TransportReport:
    """Publish clouds of 32 bytes a point at a fixed rate into the real node and count.

    Args:
        frames: clouds to send.
        rate_hz: clouds per second.
        points: points per cloud.
        config: settings of the front end.
        node_config: settings of the node; QoS stays sensor data.

    Raises:
        HybridRegError: the node did not start or ended.
    """
    space, domain = f'/transport_{os.getpid()}', 1 + os.getpid() % 99
    settings = replace(node_config or NodeConfig(), diagnostics_period_s=0.5, publish_tf=False)
    process = NodeProcess((config or OdometryConfig(), settings), space, domain)
    with process, own_node(space, domain) as node:
        publisher = node.create_publisher(
            PointCloud2, 'points', profile(reliable=False, depth=_SENSOR_DATA_DEPTH)
        )
        flow = Flow(node, 'hybridreg', window=0)
        with spinning(node):
            process.wait_until(
                lambda: flow.seen and publisher.get_subscription_count(), 60.0, 'the node'
            )
            world = hall(points)
            extra: dict[str, NDArray[Any]] = {
                'intensity': np.ones(points, np.float32),
                'ring': np.zeros(points, np.uint16),
                'timestamp': np.linspace(0.0, 0.1, points),
            }
            calls, late, size = [], 0, 0
            start = time.monotonic()
            for k in range(frames):
                moved = world - np.array([_SPEED_M_S * k / rate_hz, 0.0, 0.0], np.float32)
                stamp = NS_PER_S + round(k * NS_PER_S / rate_hz)
                header = Header(stamp=to_time(stamp), frame_id='lidar')
                msg = to_pointcloud2(from_arrays(moved, extra), header)
                size = len(msg.data)
                due = start + k / rate_hz
                time.sleep(max(due - time.monotonic(), 0.0))
                late += time.monotonic() - due > 0.02
                before = time.perf_counter()
                publisher.publish(msg)
                calls.append(time.perf_counter() - before)
            process.wait_until(
                lambda: flow.idle and min(flow.quiet_s, time.monotonic() - due) > 1.5,
                120.0,
                'the last cloud',
            )
            return TransportReport(
                sent=frames,
                received=flow.received,
                odometry=flow.processed,
                dropped=dict(flow.dropped),
                cloud_bytes=size,
                publish_ms=1e3 * float(np.median(calls)),
                late=late,
                seconds=time.monotonic() - start,
            )


def main() -> int:
    """Measure and log; returns 0 when no cloud was lost on the way."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').split('\n', maxsplit=1)[0])
    parser.add_argument('--frames', type=int, default=300)
    parser.add_argument('--rate', type=float, default=10.0, help='clouds per second')
    parser.add_argument('--points', type=int, default=120_000, help='points per cloud')
    parser.add_argument('--registrar', choices=('hybridreg', 'kiss-icp'), default='hybridreg')
    args = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format='%(message)s')
    config = OdometryConfig(registrar=args.registrar)
    report = check_transport(args.frames, args.rate, args.points, config)
    logger.info('lost on the way: %d of %d', report.lost, report.sent)
    for name, value in asdict(report).items():
        logger.info('%s: %s', name, value)
    return int(report.lost > 0)


if __name__ == '__main__':
    raise SystemExit(main())

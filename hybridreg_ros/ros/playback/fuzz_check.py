# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Does the real node stand broken clouds? Thousands through its topic, between good ones.

python -m hybridreg_ros.ros.playback.fuzz_check --clouds 10000
"""

from __future__ import annotations

import argparse
import copy
import logging
import os
import time
from array import array
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from hybridreg_ros.core.pointcloud2 import from_arrays
from hybridreg_ros.core.scan import NS_PER_S
from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.ros.conversions import to_pointcloud2, to_time
from hybridreg_ros.ros.node_config import NodeConfig
from hybridreg_ros.ros.playback.flow import Flow
from hybridreg_ros.ros.playback.live import own_node
from hybridreg_ros.ros.playback.node_process import NodeProcess
from hybridreg_ros.ros.playback.playing import spinning
from hybridreg_ros.ros.playback.transport_check import hall
from hybridreg_ros.ros.qos import profile

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from nav_msgs.msg import Odometry
    from rclpy.node import Node

logger = logging.getLogger(__name__)

_GOOD = 12
_STEP_NS = NS_PER_S // 10
_BATCH = 20
_WAIT_S = 180.0
_UINT32 = 2**32 - 1
_EXTREMES = (0, 1, 3, 4, 7, 255, 2**16, 2**31 - 1, 2**31, _UINT32)
_NAMES = ('x', 'y', 'z', 't', 'time', 'timestamp', '', 'ring', 'ä', 'x' * 300, '\x01')


@dataclass(frozen=True)
class FuzzReport:
    """Outcome of one run.

    Attributes:
        sent: broken clouds published.
        dropped: clouds that the node dropped, by cause.
        tracebacks: in what the node wrote.
        changed: good clouds whose pose is not, bit by bit, that of the run without broken ones.
        seconds: wall time.
    """

    sent: int
    dropped: Mapping[str, int]
    tracebacks: int
    changed: int
    seconds: float

    @property
    def sound(self) -> bool:
        """Whether nothing went wrong."""
        return not self.tracebacks and not self.changed and 'internal_error' not in self.dropped


def fuzzed(good: PointCloud2, rng: np.random.Generator) -> PointCloud2:
    """A copy of a cloud in which one to four things are broken; stamp and frame stay."""
    msg = copy.deepcopy(good)
    for k in rng.permutation(len(_BREAKS))[: rng.integers(1, 5)]:
        _BREAKS[k](msg, rng)
    return msg


def _number(rng: np.random.Generator) -> int:
    if rng.random() < 0.6:
        return int(rng.choice(_EXTREMES))
    return int(rng.integers(0, 2 ** int(rng.integers(1, 33))))


def _break_shape(msg: PointCloud2, rng: np.random.Generator) -> None:
    name = str(rng.choice(['height', 'width', 'point_step', 'row_step']))
    setattr(msg, name, _number(rng))


def _break_field(msg: PointCloud2, rng: np.random.Generator) -> None:
    if not msg.fields:
        return
    field = msg.fields[int(rng.integers(len(msg.fields)))]
    kind = str(rng.choice(['offset', 'count', 'datatype', 'name']))
    if kind == 'name':
        field.name = str(rng.choice(_NAMES))
    elif kind == 'datatype':
        field.datatype = int(rng.integers(0, 256))
    else:
        setattr(field, kind, _number(rng))


def _break_list(msg: PointCloud2, rng: np.random.Generator) -> None:
    fields = list(msg.fields)
    if fields and rng.random() < 0.5:
        del fields[int(rng.integers(len(fields)))]
    else:
        name = str(rng.choice(_NAMES))
        fields.append(PointField(name=name, offset=_number(rng), datatype=7, count=_number(rng)))
    msg.fields = fields


def _break_data(msg: PointCloud2, rng: np.random.Generator) -> None:
    data = np.frombuffer(msg.data, np.uint8)
    keep = int(rng.integers(0, len(data) + 1)) if rng.random() < 0.5 else 0
    noise = rng.integers(0, 256, int(rng.integers(0, 2000)), dtype=np.uint8)
    broken = array('B')
    broken.frombytes(data[:keep].tobytes() + noise.tobytes())
    msg.data = broken


def _break_order(msg: PointCloud2, _: np.random.Generator) -> None:
    msg.is_bigendian = not msg.is_bigendian


def _empty(msg: PointCloud2, rng: np.random.Generator) -> None:
    setattr(msg, str(rng.choice(['height', 'width'])), 0)
    msg.point_step = int(rng.choice([msg.point_step, _UINT32]))


_BREAKS: tuple[Callable[[PointCloud2, np.random.Generator], None], ...] = (
    _break_shape,
    _break_shape,
    _break_field,
    _break_field,
    _break_list,
    _break_data,
    _break_order,
    _empty,
)


class _Client:
    """Sends clouds to one node and knows what became of them."""

    def __init__(self, node: Node, process: NodeProcess) -> None:
        self._process = process
        self._publisher = node.create_publisher(PointCloud2, 'points', profile(True, 4 * _BATCH))
        self._reset = node.create_client(Trigger, 'hybridreg/reset')
        self._poses: dict[int, bytes] = {}
        self.flow = Flow(node, 'hybridreg', window=0, on_odometry=self._keep)
        self._sent = 0

    def _keep(self, msg: Odometry) -> None:
        p, o = msg.pose.pose.position, msg.pose.pose.orientation
        pose = np.array([p.x, p.y, p.z, o.x, o.y, o.z, o.w, *msg.pose.covariance])
        self._poses[msg.header.stamp.sec * NS_PER_S + msg.header.stamp.nanosec] = pose.tobytes()

    def begin(self) -> None:
        """Wait for the node, then let it forget all."""
        self._wait(lambda: self.flow.seen and self._publisher.get_subscription_count(), 'the node')
        self._wait(self._reset.service_is_ready, 'its services')
        future = self._reset.call_async(Trigger.Request())
        self._wait(future.done, 'reset')
        self._poses.clear()

    def chain(self, broken: int, rng: np.random.Generator) -> list[bytes]:
        """Poses of the good clouds, with as many broken ones between them."""
        shares, stamps = np.array_split(np.arange(broken), _GOOD), []
        world = hall(6000)
        for k, share in enumerate(shares):
            stamps.append((k + 1) * _STEP_NS)
            header = Header(stamp=to_time(stamps[-1]), frame_id='lidar')
            moved = world - np.array([0.1 * k, 0.0, 0.0], np.float32)
            good = to_pointcloud2(from_arrays(moved), header)
            self._send(good)
            self._wait(lambda stamp=stamps[-1]: stamp in self._poses, 'the odometry')
            small = to_pointcloud2(from_arrays(moved[:500]), header)
            for part in np.array_split(share, -(-len(share) // _BATCH) or 1):
                for _ in part:
                    self._send(fuzzed(small, rng))
                self._wait(lambda: self.flow.received >= self._sent, 'the broken clouds')
                self._wait(lambda: self.flow.idle, 'their end')
        return [self._poses[s] for s in stamps]

    def _send(self, msg: PointCloud2) -> None:
        self._publisher.publish(msg)
        self._sent += 1

    def _wait(self, condition: Any, what: str) -> None:
        self._process.wait_until(condition, _WAIT_S, what)


def check_fuzz(
    clouds: int = 1000, seed: int = 0, config: OdometryConfig | None = None
) -> FuzzReport:
    """Send broken clouds into the real node, and compare its poses with those without them.

    The broken clouds carry the stamp of the good one before them, so those that can be read after
    all are refused for it.

    Args:
        clouds: how many broken clouds.
        seed: of what is broken.
        config: settings of the front end.

    Raises:
        HybridRegError: the node did not start, ended, or went silent.
    """
    space, domain, began = f'/fuzz_{os.getpid()}', 1 + os.getpid() % 99, time.monotonic()
    settings = NodeConfig(
        input_qos='reliable',
        input_qos_depth=4 * _BATCH,
        queue_depth=4 * _BATCH,
        diagnostics_period_s=0.05,
        publish_tf=False,
    )
    process = NodeProcess((config or OdometryConfig(), settings), space, domain)
    with process, own_node(space, domain) as node:
        client = _Client(node, process)
        with spinning(node):
            client.begin()
            alone = client.chain(0, np.random.default_rng(seed))
            client.begin()
            among = client.chain(clouds, np.random.default_rng(seed))
            return FuzzReport(
                sent=clouds,
                dropped=dict(client.flow.dropped),
                tracebacks=process.log.read_text(encoding='utf-8').count('Traceback'),
                changed=sum(a != b for a, b in zip(alone, among, strict=True)),
                seconds=time.monotonic() - began,
            )


def main() -> int:
    """Run and log; returns 0 when nothing went wrong."""
    parser = argparse.ArgumentParser(description=(__doc__ or '').split('\n', maxsplit=1)[0])
    parser.add_argument('--clouds', type=int, default=1000)
    parser.add_argument('--seed', type=int, default=0)
    parser.add_argument('--registrar', choices=('hybridreg', 'kiss-icp'), default='hybridreg')
    args = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format='%(message)s')
    report = check_fuzz(args.clouds, args.seed, OdometryConfig(registrar=args.registrar))
    for name, value in asdict(report).items():
        logger.info('%s: %s', name, value)
    return int(not report.sound)


if __name__ == '__main__':
    raise SystemExit(main())

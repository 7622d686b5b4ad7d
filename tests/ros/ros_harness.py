# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A client of the real node: publishes clouds over DDS, collects and waits for every output."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import SetParameters
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.parameter import Parameter
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from hybridreg_ros.core.pointcloud2 import from_arrays
from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.ros import fastdds
from hybridreg_ros.ros.conversions import to_ns, to_pointcloud2, to_time
from hybridreg_ros.ros.node_config import NodeConfig
from hybridreg_ros.ros.playback.node_process import LOCALHOST, NodeProcess
from hybridreg_ros.ros.qos import profile

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from rcl_interfaces.msg import SetParametersResult

KISS = OdometryConfig(registrar='kiss-icp')
QUICK = NodeConfig(diagnostics_period_s=0.1, queue_depth=50, input_qos_depth=50)
STEP_NS = 100_000_000
FRAME = 'lidar'


def domain() -> int:
    """ROS domain of this test process."""
    return 1 + os.getpid() % 99


def room(x: float = 0.0, seed: int = 3, count: int = 3000) -> np.ndarray:
    """(N, 3) float32 points on the walls of a cluttered room, seen from (x, 0, 0)."""
    g = np.random.default_rng(seed)
    half = np.array([5.0, 4.0, 1.5])
    points = g.uniform(-half, half, (count, 3))
    axis = g.integers(0, 3, count)
    side = np.where(g.random(count) < 0.5, -1.0, 1.0)
    points[np.arange(count), axis] = side * half[axis]
    for _ in range(6):
        corner = g.uniform([-4, -3, -1.5], [4, 3, 0.0])
        box = corner + g.uniform(0.0, 0.8, (count // 12, 3))
        box[:, g.integers(0, 3)] = corner[g.integers(0, 3)]
        points = np.concatenate([points, box])
    points += g.normal(0.0, 0.005, points.shape)
    points[:, 0] -= x
    return points.astype(np.float32)


def cloud(points: np.ndarray, stamp: int, frame: str = FRAME, **extra: np.ndarray) -> PointCloud2:
    """Message of points (N, 3) at a stamp (ns)."""
    header = Header(stamp=to_time(stamp), frame_id=frame)
    return to_pointcloud2(from_arrays(points, extra), header)


class Probe:
    """Subscribed to everything one odometry node publishes."""

    process: NodeProcess  # what is probed
    other: Any = None  # a further publisher of the test

    def __init__(self, namespace: str, reliable: bool = True) -> None:
        os.environ.update(LOCALHOST)
        fastdds.prepare()
        self.context = rclpy.context.Context()
        self.context.init(domain_id=domain())
        self.node = rclpy.create_node(
            'probe', context=self.context, namespace=namespace, use_global_arguments=False
        )
        self._levels: set[bytes] = set()
        self.received: dict[str, list[Any]] = {}
        self.values: dict[str, str] = {}
        self.level, self.text, self.diagnostics = b'', '', 0
        self.points = self.node.create_publisher(PointCloud2, 'points', profile(reliable, 50))
        self._status = f'{namespace.strip("/")}/hybridreg: odometry'.lstrip('/')
        self.listen('odom', Odometry)
        self.node.create_subscription(
            DiagnosticArray, '/diagnostics', self._on_diagnostics, profile(True, 100)
        )
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        with contextlib.suppress(ExternalShutdownException):
            self._executor.spin()

    def listen(self, topic: str, kind: type) -> None:
        """Collect the messages of ~/topic of the node."""
        kept = self.received.setdefault(topic, [])
        self.node.create_subscription(kind, f'hybridreg/{topic}', kept.append, profile(True, 100))

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        for status in msg.status:
            if status.name == self._status:
                self.values = {v.key: v.value for v in status.values}
                self.level, self.text = status.level, status.message
                self._levels.add(status.level)
                self.diagnostics += 1

    @property
    def is_ready(self) -> bool:
        """Whether the node takes clouds and its diagnostics say so."""
        told = self.diagnostics > 0 and 'starting' not in self.text
        return told and self.points.get_subscription_count() > 0

    @property
    def odometry(self) -> list[Odometry]:
        """Odometry so far."""
        return self.received['odom']

    def at(self, stamp: int, topic: str = 'odom') -> Any | None:
        """The message of a topic with this stamp (ns)."""
        return next((m for m in self.received[topic] if to_ns(m.header.stamp) == stamp), None)

    def wait(self, condition: Callable[[], Any], what: str, timeout_s: float = 60.0) -> Any:
        """Result of a condition once it is true; fails the test when it stays false."""
        end = time.monotonic() + timeout_s
        while not (value := condition()):
            if time.monotonic() > end:
                raise AssertionError(f'waited {timeout_s} s for {what}; {self.text} {self.values}')
            time.sleep(0.005)
        return value

    def count(self, key: str) -> int:
        """A counter of the diagnostics."""
        return int(self.values.get(key, '0'))

    def counters(self) -> list[tuple[str, int]]:
        """Every counter of clouds in the diagnostics."""
        wanted = ('received', 'processed', 'dropped.', 'poor.')
        return [(k, int(v)) for k, v in self.values.items() if k.startswith(wanted)]

    def watch_levels(self) -> set[bytes]:
        """A set that collects the diagnostic levels from now on."""
        self._levels = set()
        return self._levels

    def fresh(self) -> None:
        """Wait for diagnostics that were made after this call."""
        seen = self.diagnostics
        self.wait(lambda: self.diagnostics >= seen + 2, 'diagnostics')

    def send(self, msg: PointCloud2) -> None:
        """Publish a cloud."""
        self.points.publish(msg)

    def answer(self, msg: PointCloud2) -> Odometry:
        """Publish a cloud and wait for its odometry."""
        self.send(msg)
        stamp = to_ns(msg.header.stamp)
        return self.wait(lambda: self.at(stamp), f'odometry of {stamp}')

    def call(self, service: str) -> Trigger.Response:
        """Call ~/service of the node."""
        client = self.node.create_client(Trigger, f'hybridreg/{service}')
        assert client.wait_for_service(10.0)
        future = client.call_async(Trigger.Request())
        self.wait(future.done, service)
        return future.result()

    def set(self, name: str, value: Any) -> SetParametersResult:
        """Set one parameter of the node through its service, as ros2 param set does."""
        client = self.node.create_client(SetParameters, 'hybridreg/set_parameters')
        assert client.wait_for_service(10.0)
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()]
        )
        future = client.call_async(request)
        self.wait(future.done, f'set {name}')
        return future.result().results[0]

    def publishers_matched(self, *topics: str) -> bool:
        """Whether the node has noticed the subscriptions to these outputs (both ways)."""
        names = [self.node.resolve_topic_name(f'hybridreg/{t}') for t in topics]
        if not all(self.node.count_publishers(n) for n in names):
            return False
        seen = self.diagnostics  # made after the match on their side
        self.wait(lambda: self.diagnostics >= seen + 2, 'diagnostics')
        return True

    def close(self) -> None:
        """End the client."""
        self._executor.shutdown()
        self._thread.join(5.0)
        self.node.destroy_node()
        self.context.try_shutdown()


@contextlib.contextmanager
def running(
    name: str, config: OdometryConfig = KISS, node_config: NodeConfig = QUICK, **changes: Any
) -> Iterator[Probe]:
    """The real node in its own process and a probe that is matched with it."""
    space = f'/test_{name}_{os.getpid()}'
    with NodeProcess((config, replace(node_config, **changes)), space, domain()) as process:
        probe = Probe(space)
        probe.process = process
        try:
            process.wait_until(
                lambda: probe.is_ready,
                180.0,
                'the node',
            )
            yield probe
        finally:
            probe.close()

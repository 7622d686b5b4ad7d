# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Runtime: the callbacks around one front end, on a plain or a managed node."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType

from hybridreg_ros.ros import topics
from hybridreg_ros.ros.clouds.second_sensor import SecondSensor
from hybridreg_ros.ros.clouds.subscription import CloudSubscription
from hybridreg_ros.ros.diagnostics import TWINS, Setting, to_array
from hybridreg_ros.ros.extrinsic import Extrinsic
from hybridreg_ros.ros.front_end import Building, FrontEnd
from hybridreg_ros.ros.guides.guides import Guides
from hybridreg_ros.ros.monitor import Drop, Monitor
from hybridreg_ros.ros.outputs import Outputs
from hybridreg_ros.ros.qos import profile
from hybridreg_ros.ros.requests import Requests
from hybridreg_ros.ros.worker import Arrival, Worker

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np
    from numpy.typing import NDArray
    from rclpy.node import Node
    from sensor_msgs.msg import PointCloud2

    from hybridreg_ros.odometry.config import OdometryConfig
    from hybridreg_ros.odometry.result import OdometryResult
    from hybridreg_ros.ros.fastdds import Transport
    from hybridreg_ros.ros.journal import Journal
    from hybridreg_ros.ros.node_config import NodeConfig

_FINISH_S = 0.25
"""How long an ending node waits for the cloud in work."""
_KINDS = ('publisher', 'subscription', 'service', 'timer', 'guard_condition')


class Runtime:
    """Takes clouds between `open` and `close`, once it is built.

    Attributes:
        paused: whether clouds are dropped on request.
    """

    def __init__(
        self,
        node: Node,
        configs: Callable[[], tuple[OdometryConfig, NodeConfig]],
        transport: Transport,
        journal: Journal,
        on_built: Callable[[], object],
    ) -> None:
        """Create publishers and services, and begin to build the front end.

        Args:
            node: owner of everything that is created.
            configs: gives the present parameters.
            transport: what fastdds.prepare decided, for the diagnostics.
            journal: for warnings.
            on_built: called in another thread once `ready` can be called.

        Raises:
            DependencyError: something shall come from /tf and tf2_msgs is missing.
        """
        self._before = _entities(node)
        self._node, self._configs = node, configs
        self._transport, self._journal = transport, journal
        odometry, config = configs()
        self.paused = False
        self._monitor = Monitor()
        self._extrinsic = Extrinsic(node, config)
        self._guides = Guides(node, config, self._extrinsic)
        self._outputs = Outputs(
            node, config, odometry.dynamics.threshold, self._extrinsic, self._guides.up
        )
        self._requests = Requests(node, self, lambda: configs()[1], journal)
        self._front_end: FrontEnd | None = None
        self._worker: Worker | None = None
        self._inputs: list[CloudSubscription] = []
        self._second: SecondSensor | None = None
        self._diagnostics = node.create_publisher(
            DiagnosticArray,
            topics.DIAGNOSTICS.name,
            profile(reliable=True, depth=topics.DIAGNOSTICS.depth),
        )
        self._timer = node.create_timer(  # goes on while simulated time stands still
            config.diagnostics_period_s,
            self._on_diagnostics,
            clock=Clock(clock_type=ClockType.STEADY_TIME),
        )
        if transport.warning:
            node.get_logger().warning(transport.reason)
        say, motion = node.get_logger().info, self._guides.motion
        self._building = Building(odometry, config.weights, say, on_built, motion)

    def ready(self) -> None:
        """Take the front end over that was built.

        Raises:
            WeightsError: the file named cannot be used.
            DependencyError: kiss-icp is not installed.
        """
        self._front_end = made = self._building.result()
        if not made.has_weights:
            self._node.get_logger().warning(f'no weights, kiss-icp alone: {made.weights}')
        config = self._configs()[1]
        self._worker = Worker(
            made.odometry,
            config,
            self._monitor,
            self._guides.begin,
            self._outputs.publish_odometry,
            self._publish,
            self._journal.warn,
            self._node.get_logger().info,
        )
        if config.use_points_2:
            self._second = SecondSensor(self._node, config, self._worker.decode)
            self._worker.join = self._second.join

    def open(self) -> None:
        """Subscribe: from now on clouds are worked on."""
        assert self._worker is not None
        config = self._configs()[1]
        qos = config.input_qos, config.input_qos_depth
        self._outputs.open()
        self._worker.start()
        self._monitor.begin()
        source = topics.POINTS.name, *qos
        self._inputs = [CloudSubscription(self._node, source, self._on_cloud, self._on_lost)]
        if self._second is not None:
            self._inputs.append(self._second.open(*qos, self._on_lost))

    def close(self) -> None:
        """Publish nothing more, drop what waits, and unsubscribe; pose and map stay."""
        self._outputs.close()
        for source in self._inputs:
            source.close()
        self._inputs = []
        if self._worker is not None:
            self._worker.drop(Drop.PAUSED, 'deactivated')

    def stop(self) -> None:
        """Close for good, when the cloud in work is finished or takes long."""
        if self._worker is not None:
            self._worker.stop(_FINISH_S)
        self._outputs.close()

    def dispose(self) -> None:
        """Stop, and destroy whatever was created on the node."""
        self.stop()
        for kind, items in _entities(self._node).items():
            for item in items - self._before[kind]:
                getattr(self._node, f'destroy_{kind}')(item)

    def configure(self) -> None:
        """Apply changed parameters."""
        odometry, config = self._configs()
        self._outputs.configure(config, odometry.dynamics.threshold)
        if self._worker is not None:
            self._worker.configure(config)
        period_ns = round(config.diagnostics_period_s * 1e9)
        if self._timer.timer_period_ns != period_ns:
            self._timer.timer_period_ns = period_ns
            self._timer.reset()

    def restart(self, T_odom_start: NDArray[np.float64]) -> None:
        """Forget pose and map; the base is at T_odom_start (4, 4) when the next cloud comes."""
        restart = partial(self._outputs.restart, T_odom_start)
        if self._worker is None:
            restart()
        else:
            self._worker.reset(restart)

    def map_points(self) -> NDArray[np.float32] | None:
        """Static points (N, 3) of the local map, odom frame; None before there is a front end."""
        if self._worker is None:
            return None
        return self._outputs.in_odom(self._worker.map_points())

    def _publish(self, msg: PointCloud2, result: OdometryResult) -> None:
        """Publish what follows the odometry; called in a thread of the worker."""
        self._outputs.publish(msg, result)
        if self._worker is not None:
            self._outputs.publish_map(self._worker.map_points, result)

    def _on_cloud(self, msg: PointCloud2) -> None:
        """Queue a cloud, or count why not; never blocks."""
        time_s = self._monitor.arrived()
        size = msg.height * msg.width
        limit = self._configs()[1].max_cloud_points
        if self.paused:
            self._monitor.dropped(Drop.PAUSED, 'between ~/pause and ~/resume')
        elif size > limit:
            text = f'{size} points, max_cloud_points is {limit}'
            self._monitor.dropped(Drop.TOO_MANY_POINTS, text)
            self._journal.warn(Drop.TOO_MANY_POINTS.value, text)
        elif self._worker is not None:
            self._worker.submit(Arrival(msg, time_s))

    def _on_lost(self, count: int) -> None:
        """Count clouds that the transport lost; the middleware tells."""
        text = 'never arrived; see docs/guide/troubleshooting.md'
        self._monitor.dropped(Drop.TRANSPORT, text, count)

    def _on_diagnostics(self) -> None:
        """Publish the state of the node."""
        name = self._node.get_fully_qualified_name().lstrip('/')
        made = self._front_end
        state = ', '.join(source.state for source in self._inputs) or 'closed'
        closed = '' if self._inputs else 'inactive'
        twins = self._outputs.twins
        if twins:
            self._journal.warn('twins', f'{twins} more {TWINS}')
        second = {} if self._second is None else {'points_2': self._second.state}
        setting = Setting(
            name=f'{name}: odometry',
            hardware_id=self._node.resolve_topic_name(topics.POINTS.name),
            weights=self._building.state if made is None else made.weights,
            has_weights=made is None or made.has_weights,
            transport=f'{self._transport.reason}; input {state}',
            transport_warning=self._transport.warning,
            input_timeout_s=self._configs()[1].input_timeout_s,
            paused=self.paused,
            starting=self._building.state if made is None else closed,
            waiting_for=self._extrinsic.waiting_for,
            guides={**self._guides.states, **second},
            twins=twins,
            queue=self._worker.waiting if self._worker else 0,
            tf=self._outputs.tf_state,
        )
        stamp = self._node.get_clock().now().to_msg()
        self._diagnostics.publish(to_array(self._monitor.snapshot(), setting, stamp))


def _entities(node: Node) -> dict[str, set[object]]:
    """What exists on a node, by kind."""
    kinds = (node.publishers, node.subscriptions, node.services, node.timers, node.guards)
    return {name: set(items) for name, items in zip(_KINDS, kinds, strict=True)}

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The node: clouds in; odometry, dynamic and static points, /tf and diagnostics out."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger

from hybridreg_ros.core.errors import HybridRegError
from hybridreg_ros.core.pages import one_heap
from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.ros import fastdds, topics
from hybridreg_ros.ros.diagnostics import Setting, to_array
from hybridreg_ros.ros.front_end import build_front_end
from hybridreg_ros.ros.monitor import Drop, Monitor
from hybridreg_ros.ros.node_config import RESTART_ONLY, RUNTIME, NodeConfig
from hybridreg_ros.ros.outputs import Outputs
from hybridreg_ros.ros.parameters import ConfigParameters, leaves
from hybridreg_ros.ros.qos import profile
from hybridreg_ros.ros.session import ros_session
from hybridreg_ros.ros.subscription import CloudSubscription
from hybridreg_ros.ros.worker import Arrival, Worker

if TYPE_CHECKING:
    from rclpy.timer import Timer
    from sensor_msgs.msg import PointCloud2


_WARN_EVERY_S = 5.0
_LOOK_EVERY_S = 0.1
_FIXED = {leaf.name for leaf in leaves(OdometryConfig())}.difference(RUNTIME).union(RESTART_ONLY)


class OdometryNode(Node):  # type: ignore[misc]  # rclpy has no usable types
    """ROS callbacks around one front end; docs/reference/ros.md lists the interface."""

    def __init__(self, transport: fastdds.Transport | None = None) -> None:
        """Read the parameters, build the front end, then subscribe.

        Args:
            transport: what fastdds.prepare decided, for the diagnostics.

        Raises:
            ConfigError: a parameter is unknown, of the wrong type or out of range.
            WeightsError: the weights file given cannot be used.
            DependencyError: an optional package is needed for the parameters given.
        """
        super().__init__('hybridreg', automatically_declare_parameters_from_overrides=True)
        self._transport = transport or fastdds.Transport(None, 'chosen by the process around')
        self._paused = False
        self._warned: dict[str, float] = {}
        self._monitor = Monitor()
        self._settings = ConfigParameters(
            self, (OdometryConfig(), NodeConfig()), _FIXED.__contains__, self._on_parameters
        )
        odometry, config = self._configs
        self._front_end = build_front_end(odometry, config.weights, self.get_logger().info)
        self._outputs = Outputs(self, config, odometry.dynamics.threshold)
        self._worker = Worker(
            self._front_end.odometry,
            config,
            self._monitor,
            self._outputs.publish_odometry,
            self._outputs.publish,
            self._warn,
            self.get_logger().info,
        )
        self._triggers = [
            self.create_service(Trigger, topics.RESET.name, self._on_reset),
            self.create_service(Trigger, topics.PAUSE.name, self._on_pause),
            self.create_service(Trigger, topics.RESUME.name, self._on_resume),
        ]
        self._diagnostics = self.create_publisher(
            DiagnosticArray,
            topics.DIAGNOSTICS.name,
            profile(reliable=True, depth=topics.DIAGNOSTICS.depth),
        )
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = self._diagnostics_timer(config)
        if self._transport.warning:
            self.get_logger().warning(self._transport.reason)
        if not self._front_end.has_weights:
            self.get_logger().warning(f'no weights, kiss-icp alone: {self._front_end.weights}')
        self._worker.start()
        self._input = CloudSubscription(
            self, config.input_qos, config.input_qos_depth, self._on_cloud, self._on_lost
        )

    @property
    def _configs(self) -> tuple[OdometryConfig, NodeConfig]:
        odometry, node = self._settings.configs
        return odometry, node

    def _diagnostics_timer(self, config: NodeConfig) -> Timer:
        """Timer on the steady clock: diagnostics go on while simulated time stands still."""
        return self.create_timer(
            config.diagnostics_period_s, self._on_diagnostics, clock=self._steady
        )

    def _on_cloud(self, msg: PointCloud2) -> None:
        """Queue a cloud, or count why not; never blocks."""
        time_s = self._monitor.arrived()
        size = msg.height * msg.width
        limit = self._configs[1].max_cloud_points
        if self._paused:
            self._monitor.dropped(Drop.PAUSED, 'between ~/pause and ~/resume')
        elif size > limit:
            text = f'{size} points, max_cloud_points is {limit}'
            self._monitor.dropped(Drop.TOO_MANY_POINTS, text)
            self._warn(Drop.TOO_MANY_POINTS.value, text)
        else:
            self._worker.submit(Arrival(msg, time_s))

    def _on_lost(self, count: int) -> None:
        """Count clouds that the transport lost; the middleware tells."""
        text = 'never arrived; see docs/guide/troubleshooting.md'
        self._monitor.dropped(Drop.TRANSPORT, text, count)

    def _warn(self, cause: str, text: str) -> None:
        """Log one line, at most every five seconds per cause; the counters miss nothing."""
        now = time.monotonic()
        if now - self._warned.get(cause, -_WARN_EVERY_S) >= _WARN_EVERY_S:
            self._warned[cause] = now
            self.get_logger().warning(f'{cause}: {text}')

    def _on_parameters(self) -> None:
        """Apply accepted changes."""
        odometry, config = self._configs
        self._outputs.configure(config, odometry.dynamics.threshold)
        self._worker.configure(config)
        period_ns = round(config.diagnostics_period_s * 1e9)
        if self._timer.timer_period_ns != period_ns:
            self._timer.timer_period_ns = period_ns
            self._timer.reset()

    def _on_reset(self, _: Any, response: Trigger.Response) -> Trigger.Response:
        """Start again at the origin with an empty map."""
        self._worker.reset()
        self._outputs.forget()
        response.success, response.message = True, 'pose and map cleared'
        return response

    def _on_pause(self, _: Any, response: Trigger.Response) -> Trigger.Response:
        """Ignore (and count) clouds from now on."""
        self._paused = True
        response.success, response.message = True, 'paused: clouds are counted and dropped'
        return response

    def _on_resume(self, _: Any, response: Trigger.Response) -> Trigger.Response:
        """Process clouds again."""
        self._paused = False
        response.success, response.message = True, 'resumed'
        return response

    def _on_diagnostics(self) -> None:
        """Publish the state of the node."""
        name = self.get_fully_qualified_name().lstrip('/')
        setting = Setting(
            name=f'{name}: odometry',
            hardware_id=self._input.topic,
            weights=self._front_end.weights,
            has_weights=self._front_end.has_weights,
            transport=f'{self._transport.reason}; input {self._input.state}',
            transport_warning=self._transport.warning,
            input_timeout_s=self._configs[1].input_timeout_s,
            paused=self._paused,
            waiting_for=self._outputs.waiting_for,
            queue=self._worker.waiting,
            tf=self._outputs.tf_state,
        )
        stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(to_array(self._monitor.snapshot(), setting, stamp))

    def stop(self) -> None:
        """End the worker; the cloud in work is finished first."""
        self._worker.stop()


def main(args: list[str] | None = None) -> int:
    """Run the node until it is told to stop.

    Args:
        args: command line without the program's name; None = that of this process.

    Returns:
        0 after Ctrl-C or shutdown, 2 when the node cannot start (one line on stderr).
    """
    one_heap()
    with ros_session(args) as session:
        node: OdometryNode | None = None
        try:
            node = OdometryNode(session.transport)
            executor = SingleThreadedExecutor()
            executor.add_node(node)
            while session.active:
                executor.spin_once(timeout_sec=_LOOK_EVERY_S)
        except ExternalShutdownException:
            pass
        except HybridRegError as error:
            sys.stderr.write(f'odometry_node: {error}\n')
            return 2
        finally:
            if node is not None:
                node.stop()
                node.destroy_node()
    return 0


if __name__ == '__main__':
    raise SystemExit(main())

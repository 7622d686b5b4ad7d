# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The node: clouds in; odometry, dynamic and static points, /tf and diagnostics out."""

from __future__ import annotations

import contextlib
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger

from hybridreg_ros.core.errors import FileFormatError
from hybridreg_ros.core.pages import one_heap
from hybridreg_ros.data.loaders.clouds import write_cloud
from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.ros import fastdds, topics
from hybridreg_ros.ros.conversions import from_pose
from hybridreg_ros.ros.diagnostics import TWINS, Setting, to_array
from hybridreg_ros.ros.extrinsic import Extrinsic
from hybridreg_ros.ros.front_end import Building, FrontEnd
from hybridreg_ros.ros.guides.guides import Guides
from hybridreg_ros.ros.journal import Journal
from hybridreg_ros.ros.monitor import Drop, Monitor
from hybridreg_ros.ros.node_config import RESTART_ONLY, RUNTIME, NodeConfig
from hybridreg_ros.ros.outputs import Outputs
from hybridreg_ros.ros.parameters import ConfigParameters, leaves
from hybridreg_ros.ros.qos import profile
from hybridreg_ros.ros.session import ros_session
from hybridreg_ros.ros.subscription import CloudSubscription
from hybridreg_ros.ros.transforms import pose_matrix
from hybridreg_ros.ros.worker import Arrival, Worker

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from rclpy.timer import Timer
    from sensor_msgs.msg import PointCloud2

    from hybridreg_ros.odometry.result import OdometryResult
    from hybridreg_ros.ros.session import Session
    from hybridreg_ros.ros.stop_signals import StopSignals


_FINISH_S = 0.25
"""How long an ending node waits for the cloud in work."""
_FIXED = {leaf.name for leaf in leaves(OdometryConfig())}.difference(RUNTIME).union(RESTART_ONLY)


class OdometryNode(Node):  # type: ignore[misc]  # rclpy has no usable types
    """ROS callbacks around one front end; docs/reference/ros.md lists the interface."""

    def __init__(self, transport: fastdds.Transport | None = None) -> None:
        """Read the parameters and begin to build the front end; subscribe once it is built.

        A front end that cannot be built is an error (WeightsError, DependencyError) raised out of
        the executor.

        Args:
            transport: what fastdds.prepare decided, for the diagnostics.

        Raises:
            ConfigError: a parameter is unknown, of the wrong type or out of range.
            DependencyError: the extrinsic shall come from /tf_static and tf2_msgs is missing.
        """
        super().__init__('hybridreg', automatically_declare_parameters_from_overrides=True)
        self._transport = transport or fastdds.Transport(None, 'chosen by the process around')
        self._paused = False
        self._journal = Journal(self.get_logger())
        self._monitor = Monitor()
        self._settings = ConfigParameters(
            self, (OdometryConfig(), NodeConfig()), _FIXED.__contains__, self._on_parameters
        )
        odometry, config = self._configs
        self._extrinsic = Extrinsic(self, config)
        self._guides = Guides(self, config, self._extrinsic)
        self._outputs = Outputs(
            self, config, odometry.dynamics.threshold, self._extrinsic, self._guides.up
        )
        self._front_end: FrontEnd | None = None
        self._worker: Worker | None = None
        self._input: CloudSubscription | None = None
        self._triggers = [
            self.create_service(Trigger, topics.RESET.name, self._on_reset),
            self.create_service(Trigger, topics.RESET_TO_POSE.name, self._on_reset_to_pose),
            self.create_service(Trigger, topics.SAVE_MAP.name, self._on_save_map),
            self.create_service(Trigger, topics.PAUSE.name, self._on_pause),
            self.create_service(Trigger, topics.RESUME.name, self._on_resume),
        ]
        self._initial = self.create_subscription(
            PoseWithCovarianceStamped,
            topics.INITIAL_POSE.name,
            self._on_initial_pose,
            topics.INITIAL_POSE.depth,
        )
        self._diagnostics = self.create_publisher(
            DiagnosticArray,
            topics.DIAGNOSTICS.name,
            profile(reliable=True, depth=topics.DIAGNOSTICS.depth),
        )
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = self._diagnostics_timer(config)
        if self._transport.warning:
            self.get_logger().warning(self._transport.reason)
        self._built = self.create_guard_condition(self._on_built)
        self._journal.open()
        self._building = Building(
            odometry,
            config.weights,
            self.get_logger().info,
            self._built.trigger,
            self._guides.motion,
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

    def _on_built(self) -> None:
        """Subscribe: from now on clouds can be worked on."""
        config = self._configs[1]
        self._front_end = made = self._building.result()
        if not made.has_weights:
            self.get_logger().warning(f'no weights, kiss-icp alone: {made.weights}')
        self._worker = Worker(
            made.odometry,
            config,
            self._monitor,
            self._guides.begin,
            self._outputs.publish_odometry,
            self._publish,
            self._journal.warn,
            self.get_logger().info,
        )
        self._worker.start()
        self._monitor.begin()
        self._input = CloudSubscription(
            self, config.input_qos, config.input_qos_depth, self._on_cloud, self._on_lost
        )

    def _publish(self, msg: PointCloud2, result: OdometryResult) -> None:
        """Publish what follows the odometry; called in a thread of the worker."""
        self._outputs.publish(msg, result)
        if self._worker is not None:
            self._outputs.publish_map(self._worker.map_points, result)

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
            self._journal.warn(Drop.TOO_MANY_POINTS.value, text)
        elif self._worker is not None:
            self._worker.submit(Arrival(msg, time_s))

    def _on_lost(self, count: int) -> None:
        """Count clouds that the transport lost; the middleware tells."""
        text = 'never arrived; see docs/guide/troubleshooting.md'
        self._monitor.dropped(Drop.TRANSPORT, text, count)

    def _on_parameters(self) -> None:
        """Apply accepted changes."""
        odometry, config = self._configs
        self._outputs.configure(config, odometry.dynamics.threshold)
        if self._worker is not None:
            self._worker.configure(config)
        period_ns = round(config.diagnostics_period_s * 1e9)
        if self._timer.timer_period_ns != period_ns:
            self._timer.timer_period_ns = period_ns
            self._timer.reset()

    def _restart(self, T_odom_start: NDArray[np.float64]) -> None:
        """Forget pose and map; the base is at T_odom_start (4, 4) when the next cloud comes."""
        restart = partial(self._outputs.restart, T_odom_start)
        if self._worker is None:
            restart()
        else:
            self._worker.reset(restart)

    def _on_reset(self, _: Any, response: Trigger.Response) -> Trigger.Response:
        """Start again at the origin with an empty map."""
        self._restart(np.eye(4))
        response.success, response.message = True, 'pose and map cleared'
        return response

    def _on_reset_to_pose(self, _: Any, response: Trigger.Response) -> Trigger.Response:
        """Start again at the parameter initial_pose with an empty map."""
        values = self._configs[1].initial_pose
        self._restart(pose_matrix(values))
        response.success = True
        response.message = f'map cleared, pose is {" ".join(f"{v:g}" for v in values)}'
        return response

    def _on_initial_pose(self, msg: PoseWithCovarianceStamped) -> None:
        """Start again at a pose; its covariance is not used."""
        frame, odom_frame = msg.header.frame_id.lstrip('/'), self._configs[1].odom_frame
        try:
            T_odom_start = from_pose(msg.pose.pose)
        except FileFormatError as error:
            self._journal.warn('initial_pose', str(error))
            return
        if frame not in ('', odom_frame) or not np.isfinite(T_odom_start).all():
            text = f'expected a finite pose in frame {odom_frame}, found frame {frame!r}'
            self._journal.warn('initial_pose', text)
            return
        self._restart(T_odom_start)

    def _on_save_map(self, _: Any, response: Trigger.Response) -> Trigger.Response:
        """Write the static points of the local map, odom frame, to the parameter map_file."""
        path = Path(self._configs[1].map_file).expanduser().resolve()
        if self._worker is None:
            response.message = 'no map yet: the node is starting'
            return response
        points = self._outputs.in_odom(self._worker.map_points())
        try:
            write_cloud(path, points)
        except FileFormatError as error:
            response.message = str(error)
            return response
        response.success = len(points) > 0
        response.message = f'{len(points)} points in {path}'
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
        made, source = self._front_end, self._input
        rivals = self._outputs.rivals
        if rivals:
            self._journal.warn('twins', f'{rivals} more {TWINS}')
        setting = Setting(
            name=f'{name}: odometry',
            hardware_id=self.resolve_topic_name(topics.POINTS.name),
            weights=self._building.state if made is None else made.weights,
            has_weights=made is None or made.has_weights,
            transport=f'{self._transport.reason}; input {source.state if source else "closed"}',
            transport_warning=self._transport.warning,
            input_timeout_s=self._configs[1].input_timeout_s,
            paused=self._paused,
            starting=self._building.state if made is None else '',
            waiting_for=self._extrinsic.waiting_for,
            guides=self._guides.states,
            rivals=rivals,
            queue=self._worker.waiting if self._worker else 0,
            tf=self._outputs.tf_state,
        )
        stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(to_array(self._monitor.snapshot(), setting, stamp))

    def stop(self) -> None:
        """Close the outputs, when the cloud in work is finished or takes long."""
        if self._worker is not None:
            self._worker.stop(_FINISH_S)
        self._outputs.close()
        self._journal.shut()


def run(argv: list[str], stop: StopSignals) -> None:
    """Run the node until a signal comes or rclpy is shut down.

    Args:
        argv: command line without the program's name.
        stop: waits for the signals already.

    Raises:
        HybridRegError: the node cannot start.
    """
    one_heap()
    with ros_session(argv, stop) as session, contextlib.suppress(ExternalShutdownException):
        _serve(session)


def _serve(session: Session) -> None:
    """Make the node, serve its callbacks until the end, and close it."""
    node = OdometryNode(session.transport)
    try:
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        session.spin(executor)
    finally:
        node.stop()
        node.destroy_node()

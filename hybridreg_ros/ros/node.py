# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The node, plain or managed: clouds in; odometry, dynamic and static points, /tf out."""

from __future__ import annotations

import contextlib
import threading
from typing import TYPE_CHECKING

from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from rclpy.node import Node

from hybridreg_ros.core.errors import HybridRegError
from hybridreg_ros.odometry.config import OdometryConfig
from hybridreg_ros.ros.journal import Journal
from hybridreg_ros.ros.node_config import RESTART_ONLY, RUNTIME, NodeConfig
from hybridreg_ros.ros.parameters import ConfigParameters, leaves
from hybridreg_ros.ros.runtime import Runtime
from hybridreg_ros.ros.session import ros_session

if TYPE_CHECKING:
    from collections.abc import Callable

    from rclpy.lifecycle import LifecycleState

    from hybridreg_ros.ros.fastdds import Transport
    from hybridreg_ros.ros.session import Session
    from hybridreg_ros.ros.stop_signals import StopSignals

NAME = 'hybridreg'
_FIXED = {leaf.name for leaf in leaves(OdometryConfig())}.difference(RUNTIME).union(RESTART_ONLY)


class _Owner:
    """Parameters and log of a node, and its runtime while there is one."""

    def __init__(self, node: Node, transport: Transport) -> None:
        """Read the parameters; see `ConfigParameters` for what is raised."""
        self._node, self._transport = node, transport
        self._journal = Journal(node.get_logger())
        self.runtime: Runtime | None = None
        self._settings = ConfigParameters(
            node, (OdometryConfig(), NodeConfig()), _FIXED.__contains__, self._on_parameters
        )
        self._journal.open()

    def _configs(self) -> tuple[OdometryConfig, NodeConfig]:
        odometry, node = self._settings.configs
        return odometry, node

    def make_runtime(self, on_built: Callable[[], object]) -> Runtime:
        """Begin to make a runtime; see there."""
        self.runtime = Runtime(self._node, self._configs, self._transport, self._journal, on_built)
        return self.runtime

    def _on_parameters(self) -> None:
        if self.runtime is not None:
            self.runtime.configure()

    def stop(self) -> None:
        """End the work and give the log back."""
        if self.runtime is not None:
            self.runtime.stop()
        self._journal.shut()


class OdometryNode(Node):  # type: ignore[misc]  # rclpy has no usable types
    """Takes clouds as soon as its front end is built; docs/reference/ros.md has the interface."""

    def __init__(self, transport: Transport) -> None:
        """Read the parameters and begin to build the front end.

        A front end that cannot be built is an error (WeightsError, DependencyError) raised out of
        the executor.

        Args:
            transport: what fastdds.prepare decided, for the diagnostics.

        Raises:
            ConfigError: a parameter is unknown, of the wrong type or out of range.
            DependencyError: something shall come from /tf and tf2_msgs is missing.
        """
        super().__init__(NAME, automatically_declare_parameters_from_overrides=True)
        self._owner = _Owner(self, transport)
        built = self.create_guard_condition(self._on_built)
        self._runtime = self._owner.make_runtime(built.trigger)

    def _on_built(self) -> None:
        self._runtime.ready()
        self._runtime.open()

    def stop(self) -> None:
        """Close the outputs, when the cloud in work is finished or takes long."""
        self._owner.stop()


class ManagedOdometryNode(LifecycleNode):  # type: ignore[misc]  # rclpy has no usable types
    """The same, taking clouds only while it is active.

    Configure builds the front end, and fails, with a line in the log, when it cannot be built.
    Deactivate keeps pose and map; cleanup forgets them.
    """

    def __init__(self, transport: Transport) -> None:
        """Read the parameters; arguments and errors as for `OdometryNode`."""
        super().__init__(NAME, automatically_declare_parameters_from_overrides=True)
        self._owner = _Owner(self, transport)

    def on_configure(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Build the front end; meanwhile nothing else is answered."""
        built = threading.Event()
        try:
            runtime = self._owner.make_runtime(built.set)
            built.wait()
            runtime.ready()
        except HybridRegError as error:
            self.get_logger().error(f'not configured: {error}')
            self._dispose()
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Subscribe to the clouds."""
        assert self._owner.runtime is not None
        self._owner.runtime.open()
        result: TransitionCallbackReturn = super().on_activate(state)
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Unsubscribe; what waits is dropped, and nothing more is published but diagnostics."""
        assert self._owner.runtime is not None
        self._owner.runtime.close()
        result: TransitionCallbackReturn = super().on_deactivate(state)
        return result

    def on_cleanup(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Forget pose, map and front end, and close all topics and services."""
        self._dispose()
        return TransitionCallbackReturn.SUCCESS

    on_shutdown = on_error = on_cleanup

    def _dispose(self) -> None:
        if self._owner.runtime is not None:
            self._owner.runtime.dispose()
            self._owner.runtime = None

    def stop(self) -> None:
        """As `OdometryNode.stop`."""
        self._owner.stop()


def run(argv: list[str], stop: StopSignals, managed: bool = False) -> None:
    """Run the node until a signal comes or rclpy is shut down.

    Args:
        argv: command line without the program's name.
        stop: waits for the signals already.
        managed: whether it waits for lifecycle transitions.

    Raises:
        HybridRegError: the node cannot start.
    """
    with ros_session(argv, stop) as session, contextlib.suppress(ExternalShutdownException):
        _serve(session, ManagedOdometryNode if managed else OdometryNode)


def _serve(session: Session, kind: type[OdometryNode] | type[ManagedOdometryNode]) -> None:
    """Make the node, serve its callbacks until the end, and close it."""
    node = kind(session.transport)
    try:
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        session.spin(executor)
    finally:
        node.stop()
        node.destroy_node()

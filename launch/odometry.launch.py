# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Start the odometry node, plain or managed, and RViz on request.

ros2 launch hybridreg_ros odometry.launch.py topic:=/lidar/points rviz:=true
ros2 launch hybridreg_ros odometry.launch.py topic:=/lidar/points managed:=true autostart:=false

Whatever the same launch starts afterwards gets the shared-memory profile too, so that a driver
does not lose large clouds.
"""

import yaml
from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch.actions import DeclareLaunchArgument, EmitEvent, OpaqueFunction, RegisterEventHandler
from launch.events import matches_action
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode, Node
from launch_ros.event_handlers import OnStateTransition
from launch_ros.events.lifecycle import ChangeState
from launch_ros.substitutions import FindPackageShare
from lifecycle_msgs.msg import Transition

from hybridreg_ros.ros import fastdds
from launch import Action, LaunchContext, LaunchDescription

SHARE = FindPackageShare('hybridreg_ros')
CONFIG = PathJoinSubstitution([SHARE, 'config', 'node.yaml'])
RVIZ = PathJoinSubstitution([SHARE, 'rviz', 'odometry.rviz'])

ARGUMENTS = {
    'topic': ('points', 'PointCloud2 topic to read'),
    'namespace': ('', 'namespace of the node'),
    'params_file': (CONFIG, 'parameter file, keys as in config/node.yaml and odometry.yaml'),
    'managed': ('false', 'start the managed (lifecycle) node'),
    'autostart': ('true', 'configure and activate the managed node'),
    'log_level': ('info', 'debug, info, warn or error'),
    'rviz': ('false', 'start RViz'),
    'rviz_config': (RVIZ, 'RViz display set-up'),
}
# Given on the command line they win over the parameter file; '' leaves the file's value.
PARAMETERS = {
    'registrar': 'hybridreg or kiss-icp',
    'base_frame': 'frame whose pose is published',
    'odom_frame': 'fixed frame of the odometry',
    'publish_tf': 'publish odom_frame to base_frame on /tf',
    'invert_tf': 'publish base_frame to odom_frame instead',
    'input_qos': 'sensor_data, reliable or auto',
    'use_sim_time': 'take the time from /clock',
}


def is_on(context: LaunchContext, name: str) -> bool:
    """Value of a launch argument that is true or false."""
    return bool(yaml.safe_load(LaunchConfiguration(name).perform(context)))


def transitions(node: LifecycleNode) -> list[Action]:
    """What configures a managed node, and activates it once that has succeeded."""

    def emit(transition: int) -> EmitEvent:
        matcher = matches_action(node)
        return EmitEvent(
            event=ChangeState(lifecycle_node_matcher=matcher, transition_id=transition)
        )

    configured = OnStateTransition(
        target_lifecycle_node=node,
        start_state='configuring',
        goal_state='inactive',
        entities=[emit(Transition.TRANSITION_ACTIVATE)],
    )
    return [RegisterEventHandler(configured), emit(Transition.TRANSITION_CONFIGURE)]


def start_node(context: LaunchContext) -> list[Action]:
    """The node with the parameter file and the parameters given by name; RViz when it is wanted.

    Raises:
        RuntimeError: RViz is wanted and not installed; then nothing is started.
    """
    fastdds.prepare()
    texts = {name: LaunchConfiguration(name).perform(context) for name in PARAMETERS}
    given = {name: yaml.safe_load(text) for name, text in texts.items() if text}
    managed = is_on(context, 'managed')
    node = (LifecycleNode if managed else Node)(
        package='hybridreg_ros',
        executable='odometry_node',
        name='hybridreg',
        namespace=LaunchConfiguration('namespace'),
        output='screen',
        parameters=[LaunchConfiguration('params_file'), given],
        remappings=[('points', LaunchConfiguration('topic'))],
        arguments=[
            *(['--managed'] if managed else []),
            '--ros-args',
            '--log-level',
            LaunchConfiguration('log_level'),
        ],
    )
    actions = [node]
    if managed and is_on(context, 'autostart'):
        actions += transitions(node)
    if not is_on(context, 'rviz'):
        return actions
    try:
        get_package_prefix('rviz2')
    except PackageNotFoundError:
        raise RuntimeError('rviz:=true needs rviz2: apt install ros-jazzy-rviz2') from None
    rviz = Node(
        package='rviz2',
        executable='rviz2',
        output='log',
        arguments=['-d', LaunchConfiguration('rviz_config')],
    )
    return [*actions, rviz]


def generate_launch_description() -> LaunchDescription:
    """Node and RViz."""
    declared = [
        DeclareLaunchArgument(name, default_value=value, description=text)
        for name, (value, text) in ARGUMENTS.items()
    ] + [
        DeclareLaunchArgument(name, default_value='', description=f"{text}; '' = parameter file")
        for name, text in PARAMETERS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=start_node)])

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Start the odometry node, and RViz on request.

ros2 launch hybridreg_ros odometry.launch.py topic:=/lidar/points rviz:=true
"""

import yaml
from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchContext, LaunchDescription

SHARE = FindPackageShare('hybridreg_ros')
CONFIG = PathJoinSubstitution([SHARE, 'config', 'node.yaml'])
RVIZ = PathJoinSubstitution([SHARE, 'rviz', 'odometry.rviz'])

ARGUMENTS = {
    'topic': ('points', 'PointCloud2 topic to read'),
    'namespace': ('', 'namespace of the node'),
    'params_file': (CONFIG, 'parameter file, keys as in config/node.yaml and odometry.yaml'),
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


def start_node(context: LaunchContext) -> list[Node]:
    """The node with the parameter file and the parameters given by name; RViz when it is wanted.

    Raises:
        RuntimeError: RViz is wanted and not installed; then nothing is started.
    """
    texts = {name: LaunchConfiguration(name).perform(context) for name in PARAMETERS}
    given = {name: yaml.safe_load(text) for name, text in texts.items() if text}
    node = Node(
        package='hybridreg_ros',
        executable='odometry_node',
        name='hybridreg',
        namespace=LaunchConfiguration('namespace'),
        output='screen',
        parameters=[LaunchConfiguration('params_file'), given],
        remappings=[('points', LaunchConfiguration('topic'))],
        arguments=['--ros-args', '--log-level', LaunchConfiguration('log_level')],
    )
    if not yaml.safe_load(LaunchConfiguration('rviz').perform(context)):
        return [node]
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
    return [node, rviz]


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

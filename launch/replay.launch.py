# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Play a bag into the odometry node; everything stops at the end of the bag.

ros2 launch hybridreg_ros replay.launch.py bag:=/path/to/bag.mcap topic:=/points
"""

from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    IncludeLaunchDescription,
    RegisterEventHandler,
)
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

ARGUMENTS = {
    'bag': (None, 'rosbag2 file or directory'),
    'topic': ('/points', 'PointCloud2 topic of the bag'),
    'rate': ('1.0', 'speed, 1 = as recorded'),
    'rviz': ('false', 'start RViz'),
}


def generate_launch_description() -> LaunchDescription:
    """Node with simulated time, player with /clock."""
    odometry = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(
            PathJoinSubstitution(
                [FindPackageShare('hybridreg_ros'), 'launch', 'odometry.launch.py']
            )
        ),
        launch_arguments={
            'topic': LaunchConfiguration('topic'),
            'rviz': LaunchConfiguration('rviz'),
            'use_sim_time': 'true',
        }.items(),
    )
    player = Node(
        package='hybridreg_ros',
        executable='bag_player',
        output='screen',
        arguments=[
            LaunchConfiguration('bag'),
            '--rate',
            LaunchConfiguration('rate'),
            '--clock',
            '--lossless',
        ],
    )
    declared = [
        DeclareLaunchArgument(name, default_value=value, description=text)
        for name, (value, text) in ARGUMENTS.items()
    ]
    end = RegisterEventHandler(
        OnProcessExit(target_action=player, on_exit=[EmitEvent(event=Shutdown())])
    )
    return LaunchDescription([*declared, odometry, player, end])

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""NodeConfig: the settings that only the ROS node has; the front end has its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hybridreg_ros.core.config import dump_yaml, option, validate
from hybridreg_ros.core.errors import ConfigError
from hybridreg_ros.core.pointcloud2 import MOST_POINTS

RESTART_ONLY = (
    'weights',
    'input_qos',
    'input_qos_depth',
    'base_frame',
    'guess_frame',
    'use_imu',
    'use_points_2',
    'pair_within_s',
    'planar',
    'extrinsic_source',
    'extrinsic',
)
"""Fields that are read when the node starts; the parameter server refuses to change them."""
RUNTIME = ('dynamics.threshold',)
"""Front-end parameters that the node itself applies; the others are read at the start."""


@dataclass(frozen=True)
class NodeConfig:
    """Frames, outputs, queue and quality of service of the node.

    Raises:
        ConfigError: a value has the wrong type or lies outside its range.
    """

    weights: str = option('', "weights file of the network; '' = the packaged one")
    odom_frame: str = option('odom', 'fixed frame of the odometry')
    base_frame: str = option('', "frame whose pose is published; '' = frame of the clouds")
    extrinsic_source: str = option(
        'tf',
        'where the pose of the sensor in base_frame comes from',
        choices=('tf', 'parameter'),
    )
    extrinsic: tuple[float, ...] = option(
        (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
        'pose of the sensor in base_frame if extrinsic_source is parameter: x y z (m) qx qy qz qw',
    )
    publish_tf: bool = option(True, 'publish the transform from odom_frame to base_frame on /tf')
    invert_tf: bool = option(
        False, 'publish it from base_frame to odom_frame instead (odom becomes a leaf)'
    )
    guess_frame: str = option(
        '',
        'fixed frame of another odometry (wheels); registrations start from the motion of the '
        "sensor in it by /tf; '' = from constant velocity, which also steps in when its "
        'transforms stop',
    )
    use_imu: bool = option(
        False,
        'take the rotation of the sensor, for prediction and deskew, from the angular rates on '
        'imu (sensor_msgs/Imu) while they arrive',
    )
    initial_pose: tuple[float, ...] = option(
        (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
        'pose of base_frame in odom_frame at the start and after ~/reset_to_pose: '
        'x y z (m) qx qy qz qw',
    )
    use_points_2: bool = option(
        False,
        'join each cloud with the one of a second sensor on points_2 that is nearest in time; '
        'its pose is taken from /tf_static',
    )
    pair_within_s: float = option(
        0.05,
        'how far apart two clouds that are joined may be, and how long the first waits, seconds',
        low=0.0,
        high=1.0,
    )
    level: bool = option(
        True,
        'with use_imu: roll and pitch of the first pose are those of the base by gravity, if it '
        'stands still then; else, and without use_imu, those of initial_pose',
    )
    planar: bool = option(
        False,
        'for wheeled robots on flat floors: only x, y and yaw of base_frame change',
    )
    publish_keyframe: bool = option(False, 'publish the static points of new keyframes')
    publish_path: bool = option(False, 'publish the poses so far as nav_msgs/Path')
    local_map_period_s: float = option(
        1.0, 'time between two messages of ~/local_map, seconds', low=0.05, high=3600.0
    )
    map_file: str = option('map.ply', 'file that ~/save_map writes: .ply, .pcd or .npy')
    path_length: int = option(
        2000,
        'maximum number of poses in the path; the oldest are removed first',
        low=2,
        high=100_000,
    )
    input_qos: str = option(
        'sensor_data',
        'QoS of the cloud subscription; auto = reliable if every publisher is reliable',
        choices=('sensor_data', 'reliable', 'auto'),
    )
    input_qos_depth: int = option(
        30, 'number of clouds that DDS queues for the node', low=1, high=1000
    )
    queue_depth: int = option(
        2, 'number of clouds that may wait while one is processed', low=1, high=1000
    )
    drop_policy: str = option(
        'oldest',
        'which waiting cloud is dropped when the queue is full',
        choices=('oldest', 'newest'),
    )
    time_unit: str = option(
        'auto',
        'unit of per-point times; normalised = share of scan_period_s, none = ignore them',
        choices=('auto', 's', 'ms', 'us', 'ns', 'normalised', 'none'),
    )
    time_field: str = option(
        '', "field with the per-point times; '' = the first usable one of the usual names"
    )
    scan_period_s: float = option(
        0.1, 'duration that a normalised time of 1 stands for, seconds', low=0.001, high=10.0
    )
    max_cloud_points: int = option(
        4_000_000, 'larger clouds are dropped and counted', low=1000, high=100_000_000
    )
    decode_points: int = option(
        MOST_POINTS,
        'of larger clouds only every second, third, ... point is used and published',
        low=1000,
        high=100_000_000,
    )
    input_timeout_s: float = option(
        2.0,
        'time without a cloud, or without odometry, after which the diagnostics warn, seconds',
        low=0.1,
        high=3600.0,
    )
    diagnostics_period_s: float = option(
        1.0, 'time between two diagnostics messages, seconds', low=0.05, high=60.0
    )

    def __post_init__(self) -> None:
        """Check ranges; see the class for what is raised."""
        validate(self)
        for name in ('extrinsic', 'initial_pose'):
            _check_pose(name, getattr(self, name))
        for name in ('odom_frame', 'base_frame', 'guess_frame'):
            value = getattr(self, name)
            if value.startswith('/'):
                raise ConfigError(f'{name}: expected a frame without leading /, found {value!r}')
        if self.guess_frame and self.guess_frame in (self.odom_frame, self.base_frame):
            raise ConfigError(
                f'guess_frame: expected neither odom_frame nor base_frame, found '
                f'{self.guess_frame!r}'
            )
        if not self.odom_frame:
            raise ConfigError("odom_frame: expected a frame name, found ''")
        if self.odom_frame == self.base_frame:
            raise ConfigError(
                f'base_frame: expected a frame other than odom_frame {self.odom_frame!r}'
            )


def _check_pose(name: str, values: tuple[float, ...]) -> None:
    if len(values) != 7:
        raise ConfigError(f'{name}: expected 7 numbers x y z qx qy qz qw, found {len(values)}')
    norm = float(np.linalg.norm(values[3:]))
    if not abs(norm - 1.0) < 1e-3:
        raise ConfigError(f'{name}: expected a unit quaternion, found norm {norm:.4g}')
    if not np.isfinite(values).all():
        raise ConfigError(f'{name}: expected finite numbers, found {values}')


def parameter_file(config: NodeConfig | None = None) -> str:
    """ROS parameter file (YAML text) of a config; `config/node.yaml` is that of the defaults."""
    head = (
        '# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers\n'
        '# SPDX-License-Identifier: Apache-2.0\n'
        '# Written by hybridreg_ros.ros.node_config.parameter_file; a test keeps it up to date.\n'
        '/**:\n  ros__parameters:\n'
    )
    return head + dump_yaml(config or NodeConfig(), indent=4)

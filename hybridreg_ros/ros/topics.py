# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Topics and services of the node; the node creates them from here, the reference lists them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Topic:
    """One topic of the node.

    Attributes:
        name: as given to rclpy, so relative and private names resolve as usual.
        type: of its messages.
        doc: what is in them, and when they are sent.
        depth: messages that DDS keeps; 0 = by parameter.
        received: whether the node subscribes to it.
    """

    name: str
    type: str
    doc: str
    depth: int = 10
    received: bool = False

    @property
    def by_default(self) -> str:
        """Full name while node and namespace are not renamed."""
        return absolute(self.name)


@dataclass(frozen=True)
class Service:
    """One service of the node, of type std_srvs/srv/Trigger."""

    name: str
    doc: str

    @property
    def by_default(self) -> str:
        """Full name while node and namespace are not renamed."""
        return absolute(self.name)


def absolute(name: str) -> str:
    """Full name of a relative or private one, of a node hybridreg in the namespace /."""
    return name if name.startswith('/') else '/' + name.replace('~', 'hybridreg', 1)


POINTS = Topic(
    'points',
    'sensor_msgs/msg/PointCloud2',
    'clouds of the sensor; any field layout, byte order and padding; QoS by `input_qos`',
    depth=0,
    received=True,
)
POINTS_2 = Topic(
    'points_2',
    'sensor_msgs/msg/PointCloud2',
    'clouds of a second sensor, with `use_points_2`',
    depth=0,
    received=True,
)
TF_STATIC = Topic(
    '/tf_static',
    'tf2_msgs/msg/TFMessage',
    'pose of the sensor in `base_frame`, with `extrinsic_source: tf`, of IMU and second sensor',
    depth=100,
    received=True,
)
ODOM = Topic('~/odom', 'nav_msgs/msg/Odometry', 'pose and twist of every cloud, with covariances')
DYNAMIC_POINTS = Topic(
    '~/dynamic_points',
    'sensor_msgs/msg/PointCloud2',
    'points whose `dynamic_probability` is at least `dynamics.threshold`; every field of the '
    'input is kept, and so are stamp and frame',
    depth=5,
)
STATIC_POINTS = Topic(
    '~/static_points',
    'sensor_msgs/msg/PointCloud2',
    'the other valid points; none in the first quarter of a second, in which nothing can tell '
    'what moves',
    depth=5,
)
TF = Topic(
    '/tf',
    'tf2_msgs/msg/TFMessage',
    '`odom_frame` to `base_frame` with `publish_tf`, not while lost; needs tf2_msgs',
    depth=100,
)
DIAGNOSTICS = Topic(
    '/diagnostics',
    'diagnostic_msgs/msg/DiagnosticArray',
    'state of the node, every `diagnostics_period_s`',
)
FRAME = Topic(
    '~/frame',
    'diagnostic_msgs/msg/DiagnosticArray',
    'report on every frame: `source`, `reason`, `confidence`, `keyframe` and the '
    'milliseconds of each stage; its stamp is that of the cloud',
)
KEYFRAME = Topic(
    '~/keyframe',
    'sensor_msgs/msg/PointCloud2',
    'static points of each new keyframe, with `publish_keyframe`',
    depth=5,
)
PATH = Topic(
    '~/path', 'nav_msgs/msg/Path', 'the last `path_length` poses, with `publish_path`', depth=1
)
LOCAL_MAP = Topic(
    '~/local_map',
    'sensor_msgs/msg/PointCloud2',
    'static points of the local map in `odom_frame`, every `local_map_period_s`',
    depth=1,
)
INITIAL_POSE = Topic(
    '~/initial_pose',
    'geometry_msgs/msg/PoseWithCovarianceStamped',
    'pose of `base_frame` in `odom_frame` to start again at, with an empty map; its covariance '
    'is not used',
    received=True,
)
IMU = Topic(
    'imu',
    'sensor_msgs/msg/Imu',
    'angular rates of the sensor or of a body fixed to it, with `use_imu`; best effort',
    depth=200,
    received=True,
)
GUESS_TF = Topic(
    '/tf',
    'tf2_msgs/msg/TFMessage',
    'motion of the sensor in `guess_frame`, if one is set; needs tf2_msgs',
    depth=100,
    received=True,
)
TOPICS = (
    POINTS,
    POINTS_2,
    TF_STATIC,
    INITIAL_POSE,
    IMU,
    GUESS_TF,
    ODOM,
    DYNAMIC_POINTS,
    STATIC_POINTS,
    TF,
    DIAGNOSTICS,
    FRAME,
    KEYFRAME,
    PATH,
    LOCAL_MAP,
)

RESET = Service('~/reset', 'start again at the origin with an empty map')
RESET_TO_POSE = Service(
    '~/reset_to_pose', 'start again at the parameter `initial_pose` with an empty map'
)
SAVE_MAP = Service(
    '~/save_map',
    'write the static points of the local map, in `odom_frame`, to the file `map_file`',
)
PAUSE = Service('~/pause', 'count and drop clouds from now on')
RESUME = Service('~/resume', 'process clouds again')
SERVICES = (RESET, RESET_TO_POSE, SAVE_MAP, PAUSE, RESUME)

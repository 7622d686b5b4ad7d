# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""ROS messages from results: stamps, poses, Odometry, TransformStamped, PointCloud2."""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Pose, TransformStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from hybridreg_ros.core import se3
from hybridreg_ros.core.quaternion import from_quaternion, to_quaternion
from hybridreg_ros.core.scan import NS_PER_S
from hybridreg_ros.odometry.registration.planar import IN_PLANE, confined, flattened
from hybridreg_ros.odometry.result import LOST_VARIANCE, OdometryResult, Source

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.core.pointcloud2 import CloudData

    F64 = NDArray[np.float64]


def to_time(stamp_ns: int) -> Time:
    """Stamp message of nanoseconds."""
    return Time(sec=stamp_ns // NS_PER_S, nanosec=stamp_ns % NS_PER_S)


def to_ns(stamp: Time) -> int:
    """Nanoseconds of a stamp message."""
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def rotation(q: F64) -> F64:
    """Rotation (3, 3) of a quaternion (4,) x y z w of any length.

    Raises:
        FileFormatError: the quaternion is zero or not finite.
    """
    norm = float(np.linalg.norm(q))
    return from_quaternion(*(float(v) / norm if norm else 0.0 for v in q))


def to_pose(T: F64) -> Pose:
    """Pose message of a transform (4, 4)."""
    pose = Pose()
    p, o = pose.position, pose.orientation
    p.x, p.y, p.z = (float(v) for v in T[:3, 3])
    o.x, o.y, o.z, o.w = to_quaternion(T[:3, :3])
    return pose


def from_pose(pose: Pose) -> F64:
    """Transform (4, 4) of a pose message."""
    p, o = pose.position, pose.orientation
    return se3.transform(rotation(np.array([o.x, o.y, o.z, o.w])), np.array([p.x, p.y, p.z]))


def base_pose(pose: F64, T_base_sensor: F64) -> F64:
    """Pose of the base in an odom frame that starts at the base.

    Args:
        pose: (4, 4) T_odom_sensor, the odom frame starting at the sensor.
        T_base_sensor: (4, 4) extrinsic.
    """
    T: F64 = T_base_sensor @ pose @ se3.inverse(T_base_sensor)
    return T


def base_covariance(covariance: F64, pose: F64, T_base_sensor: F64) -> F64:
    """Covariance (6, 6) of `base_pose`, fixed axes, from that of the sensor pose."""
    R, t = T_base_sensor[:3, :3], T_base_sensor[:3, 3]
    lever = base_pose(pose, T_base_sensor)[:3, :3] @ t
    return _moved(covariance, R, se3.hat(lever) @ R)


def base_twist(twist: F64, covariance: F64, T_base_sensor: F64) -> tuple[F64, F64]:
    """Twist (6,) and its covariance (6, 6) of the base, in the base frame, from the sensor's."""
    R, t = T_base_sensor[:3, :3], T_base_sensor[:3, 3]
    angular = R @ twist[3:]
    linear = R @ twist[:3] + np.cross(t, angular)
    return np.concatenate([linear, angular]), _moved(covariance, R, se3.hat(t) @ R)


def _moved(covariance: F64, R: F64, corner: F64) -> F64:
    J = np.zeros((6, 6))
    J[:3, :3], J[3:, 3:], J[:3, 3:] = R, R, corner
    result: F64 = J @ covariance @ J.T
    return result


def to_odometry(
    result: OdometryResult,
    frames: tuple[str, str],
    T_base_sensor: F64 | None = None,
    T_odom_start: F64 | None = None,
    planar: bool = False,
) -> Odometry:
    """Odometry message of a result; its stamp is the stamp of the cloud.

    Args:
        result: outcome of one scan.
        frames: of the pose, and the base frame (the sensor frame when there is no extrinsic).
        T_base_sensor: (4, 4) pose of the sensor in the child frame; None = identity.
        T_odom_start: (4, 4) pose of the child frame at the first scan; None = identity.
        planar: whether the base moves in the plane z = 0 of its first pose.
    """
    pose, covariance = result.pose, result.covariance
    twist, twist_covariance = result.twist, result.twist_covariance
    if T_base_sensor is not None:
        pose = base_pose(result.pose, T_base_sensor)
        if result.source is not Source.LOST:
            covariance = base_covariance(covariance, result.pose, T_base_sensor)
        twist, twist_covariance = base_twist(twist, twist_covariance, T_base_sensor)
    if planar:
        pose, covariance = flattened(pose, covariance)
        twist, twist_covariance = twist * IN_PLANE, confined(twist_covariance)
    if T_odom_start is not None:
        pose = T_odom_start @ pose
        covariance = _moved(covariance, T_odom_start[:3, :3], np.zeros((3, 3)))
    if result.source is Source.LOST:
        covariance = np.maximum(covariance, np.diag(np.full(6, LOST_VARIANCE)))
    msg = Odometry(child_frame_id=frames[1])
    msg.header = Header(stamp=to_time(result.stamp), frame_id=frames[0])
    msg.pose.pose = to_pose(pose)
    msg.pose.covariance = np.asarray(covariance, dtype=np.float64).reshape(36)
    linear, angular = msg.twist.twist.linear, msg.twist.twist.angular
    linear.x, linear.y, linear.z, angular.x, angular.y, angular.z = (float(v) for v in twist)
    msg.twist.covariance = np.asarray(twist_covariance, dtype=np.float64).reshape(36)
    return msg


def to_transform(odometry: Odometry, invert: bool = False) -> TransformStamped:
    """TF of an Odometry message: odom to child, or child to odom when inverted."""
    parent, child = odometry.header.frame_id, odometry.child_frame_id
    T = from_pose(odometry.pose.pose)
    if invert:
        parent, child, T = child, parent, se3.inverse(T)
    msg = TransformStamped(child_frame_id=child)
    msg.header = Header(stamp=odometry.header.stamp, frame_id=parent)
    v, r = msg.transform.translation, msg.transform.rotation
    v.x, v.y, v.z = (float(x) for x in T[:3, 3])
    r.x, r.y, r.z, r.w = to_quaternion(T[:3, :3])
    return msg


def to_pointcloud2(cloud: CloudData, header: Header) -> PointCloud2:
    """PointCloud2 message of cloud data; the bytes are copied once."""
    data = array('B')
    data.frombytes(np.ascontiguousarray(cloud.data).data)
    msg = PointCloud2(
        header=header,
        height=cloud.height,
        width=cloud.width,
        fields=[
            PointField(name=f.name, offset=f.offset, datatype=f.datatype, count=f.count)
            for f in cloud.fields
        ],
        is_bigendian=cloud.is_bigendian,
        point_step=cloud.point_step,
        row_step=cloud.row_step,
        is_dense=cloud.is_dense,
    )
    msg.data = data
    return msg

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Writes clouds and odometry as a rosbag2: a directory, or one bare .mcap or .db3 file."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.core.errors import BagError, DependencyError
from hybridreg_ros.core.quaternion import to_quaternion
from hybridreg_ros.core.scan import NS_PER_S

try:
    from rosbags.interfaces import (
        Qos,
        QosDurability,
        QosHistory,
        QosLiveliness,
        QosReliability,
        QosTime,
    )
    from rosbags.rosbag2 import StoragePlugin, Writer, WriterError
    from rosbags.typesys import Stores, get_typestore
except ImportError as missing:
    raise DependencyError(
        f"bags need {missing.name}: pip install 'hybridreg_ros[replay]'"
    ) from None

if TYPE_CHECKING:
    from types import TracebackType

    from numpy.typing import NDArray
    from rosbags.interfaces import Connection

    from hybridreg_ros.core.pointcloud2 import CloudData
    from hybridreg_ros.metrics.trajectory import Trajectory

SUFFIX_STORAGE = {'.mcap': 'mcap', '.db3': 'sqlite3'}
_LAST_NS = 2**31 * NS_PER_S
"""ROS headers hold whole seconds as int32."""
_PLUGINS = {'mcap': StoragePlugin.MCAP, 'sqlite3': StoragePlugin.SQLITE3}
_RELIABLE = Qos(
    QosHistory.KEEP_LAST,
    10,
    QosReliability.RELIABLE,
    QosDurability.VOLATILE,
    QosTime(0, 0),
    QosTime(0, 0),
    QosLiveliness.AUTOMATIC,
    QosTime(0, 0),
    False,
)
_LATCHED = _RELIABLE._replace(durability=QosDurability.TRANSIENT_LOCAL)
TF, TF_STATIC = '/tf', '/tf_static'


class BagWriter:
    """Writes one bag; as a context manager it removes the unfinished bag after an error.

    A path ending in .mcap or .db3 becomes one file, anything else a rosbag2 directory. The bag
    appears under its name when it is closed; until then it grows in a hidden folder beside it.
    """

    def __init__(
        self, path: str | Path, storage: str | None = None, overwrite: bool = False
    ) -> None:
        """Start a bag.

        Args:
            path: file or directory to make.
            storage: mcap or sqlite3; None takes it from the suffix, mcap for a directory.
            overwrite: replace what is there instead of refusing.

        Raises:
            BagError: the path exists, or storage contradicts the suffix.
        """
        self.path = Path(path)
        implied = SUFFIX_STORAGE.get(self.path.suffix)
        if storage is not None and implied is not None and storage != implied:
            raise BagError(f'{self.path} ends in {self.path.suffix} but storage is {storage}')
        self._bare = implied is not None
        self._overwrite = overwrite
        if self.path.exists() and not overwrite:
            raise BagError(f'{self.path} exists already: remove it or name another output')
        self._scratch = self.path.parent / f'.{self.path.name}.writing'
        shutil.rmtree(self._scratch, ignore_errors=True)
        self._scratch.mkdir(parents=True)
        self._typestore = get_typestore(Stores.ROS2_JAZZY)
        self._writer = Writer(
            self._scratch / self.path.stem,
            version=9,
            storage_plugin=_PLUGINS[storage or implied or 'mcap'],
        )
        self._writer.open()
        self._connections: dict[tuple[str, str], Connection] = {}
        self._closed = False
        self.messages = 0

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.abort()

    def close(self) -> None:
        """Finish the bag and move it to its name; closing twice does nothing."""
        if self._closed:
            return
        self._closed = True
        self._writer.close()
        made = self._scratch / self.path.stem
        if self.path.exists() and self._overwrite:
            if self.path.is_dir():
                shutil.rmtree(self.path)
            else:
                self.path.unlink()
        if self._bare:
            next(made.glob(f'*{self.path.suffix}')).replace(self.path)
        else:
            made.rename(self.path)
        shutil.rmtree(self._scratch, ignore_errors=True)

    def abort(self) -> None:
        """Drop the unfinished bag."""
        if not self._closed:
            self._closed = True
            self._writer.abort()
            shutil.rmtree(self._scratch, ignore_errors=True)

    def _type(self, name: str) -> Any:
        return self._typestore.types[name]

    def write(self, topic: str, msgtype: str, stamp: int, message: Any) -> None:
        """Append one message.

        Args:
            topic: absolute topic name.
            msgtype: for example 'sensor_msgs/msg/PointCloud2'.
            stamp: log time, ns.
            message: rosbags message object of that type.

        Raises:
            BagError: the disk refuses, the message does not fit its type, or no header holds the
                stamp.
        """
        if not 0 <= stamp < _LAST_NS:
            raise BagError(
                f'a stamp of {stamp / NS_PER_S:.9g} s cannot be stored: expected 0 to '
                f'{_LAST_NS // NS_PER_S} s'
            )
        raw = self._typestore.serialize_cdr(message, msgtype)
        self.write_raw(topic, msgtype, stamp, raw)

    def write_raw(self, topic: str, msgtype: str, stamp: int, raw: bytes | memoryview) -> None:
        """Append one message that is serialised already (CDR)."""
        try:
            if (topic, msgtype) not in self._connections:
                qos = _LATCHED if topic == TF_STATIC else _RELIABLE
                self._connections[topic, msgtype] = self._writer.add_connection(
                    topic, msgtype, typestore=self._typestore, offered_qos_profiles=[qos]
                )
            self._writer.write(self._connections[topic, msgtype], stamp, raw)
        except (WriterError, OSError) as error:
            raise BagError(f'cannot write {self.path}: {error}') from None
        self.messages += 1

    def _header(self, stamp: int, frame_id: str) -> Any:
        sec, nanosec = divmod(int(stamp), NS_PER_S)
        time = self._type('builtin_interfaces/msg/Time')(sec=sec, nanosec=nanosec)
        return self._type('std_msgs/msg/Header')(stamp=time, frame_id=frame_id)

    def write_cloud(self, topic: str, stamp: int, frame_id: str, cloud: CloudData) -> None:
        """Append a sensor_msgs/PointCloud2.

        Args:
            topic: absolute topic name.
            stamp: header stamp and log time, ns.
            frame_id: sensor frame.
            cloud: layout and bytes.
        """
        field = self._type('sensor_msgs/msg/PointField')
        message = self._type('sensor_msgs/msg/PointCloud2')(
            header=self._header(stamp, frame_id),
            height=cloud.height,
            width=cloud.width,
            fields=[
                field(name=f.name, offset=f.offset, datatype=f.datatype, count=f.count)
                for f in cloud.fields
            ],
            is_bigendian=cloud.is_bigendian,
            point_step=cloud.point_step,
            row_step=cloud.row_step,
            data=np.asarray(cloud.data, dtype=np.uint8),
            is_dense=cloud.is_dense,
        )
        self.write(topic, 'sensor_msgs/msg/PointCloud2', stamp, message)

    def _pose(self, pose: NDArray[np.float64]) -> Any:
        x, y, z, w = to_quaternion(pose[:3, :3])
        tx, ty, tz = (float(v) for v in pose[:3, 3])
        return self._type('geometry_msgs/msg/Pose')(
            position=self._type('geometry_msgs/msg/Point')(x=tx, y=ty, z=tz),
            orientation=self._type('geometry_msgs/msg/Quaternion')(x=x, y=y, z=z, w=w),
        )

    def write_transform(
        self, topic: str, stamp: int, frames: tuple[str, str], pose: NDArray[np.float64]
    ) -> None:
        """Append a tf2_msgs/TFMessage with one transform.

        Args:
            topic: TF or TF_STATIC.
            stamp: header stamp and log time, ns.
            frames: (frame_id, child_frame_id).
            pose: (4, 4) T_frame_child, metres.
        """
        x, y, z = (float(v) for v in pose[:3, 3])
        transform = self._type('geometry_msgs/msg/TransformStamped')(
            header=self._header(stamp, frames[0]),
            child_frame_id=frames[1],
            transform=self._type('geometry_msgs/msg/Transform')(
                translation=self._type('geometry_msgs/msg/Vector3')(x=x, y=y, z=z),
                rotation=self._pose(pose).orientation,
            ),
        )
        kind = 'tf2_msgs/msg/TFMessage'
        self.write(topic, kind, stamp, self._type(kind)(transforms=[transform]))

    def write_path(self, topic: str, frame_id: str, path: Trajectory) -> None:
        """Append a nav_msgs/Path of T_frame_sensor, with the stamp of its first pose."""
        start = int(path.stamps[0])
        poses = [
            self._type('geometry_msgs/msg/PoseStamped')(
                header=self._header(stamp, frame_id), pose=self._pose(T)
            )
            for stamp, T in zip(path.stamps, path.poses, strict=True)
        ]
        kind = 'nav_msgs/msg/Path'
        message = self._type(kind)(header=self._header(start, frame_id), poses=poses)
        self.write(topic, kind, start, message)

    def write_odometry(
        self,
        topic: str,
        stamp: int,
        frames: tuple[str, str],
        pose: NDArray[np.float64],
        covariance: NDArray[np.float64] | None = None,
        twist: NDArray[np.float64] | None = None,
        twist_covariance: NDArray[np.float64] | None = None,
    ) -> None:
        """Append a nav_msgs/Odometry.

        Args:
            topic: absolute topic name.
            stamp: header stamp and log time, ns.
            frames: (frame_id, child_frame_id).
            pose: (4, 4) T_frame_child, metres.
            covariance: (6, 6) of the pose; zeros (unknown) when None.
            twist: (6,) linear (m/s) and angular (rad/s) in the child frame; zeros when None.
            twist_covariance: (6, 6) of the twist; zeros when None.
        """
        vector = self._type('geometry_msgs/msg/Vector3')
        v = [float(x) for x in (np.zeros(6) if twist is None else twist)]
        message = self._type('nav_msgs/msg/Odometry')(
            header=self._header(stamp, frames[0]),
            child_frame_id=frames[1],
            pose=self._type('geometry_msgs/msg/PoseWithCovariance')(
                pose=self._pose(pose), covariance=_flat36(covariance)
            ),
            twist=self._type('geometry_msgs/msg/TwistWithCovariance')(
                twist=self._type('geometry_msgs/msg/Twist')(
                    linear=vector(x=v[0], y=v[1], z=v[2]),
                    angular=vector(x=v[3], y=v[4], z=v[5]),
                ),
                covariance=_flat36(twist_covariance),
            ),
        )
        self.write(topic, 'nav_msgs/msg/Odometry', stamp, message)


def _flat36(matrix: NDArray[np.float64] | None) -> NDArray[np.float64]:
    if matrix is None:
        return np.zeros(36)
    return np.ascontiguousarray(matrix, dtype=np.float64).reshape(36)

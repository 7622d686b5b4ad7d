# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Bags of every kind and state: whole, cut off, unordered, foreign, and what is said of each."""

from __future__ import annotations

import logging
import sqlite3
import struct
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tiny_bags import (
    PERIOD,
    START,
    cloud_bytes,
    room_cloud,
    sensor_pose,
    write_mcap,
    write_room_bag,
)

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import BagError
from hybridreg_ros.core.pointcloud2 import CloudData, from_arrays
from hybridreg_ros.replay.bag_reader import ODOMETRY, POINT_CLOUD2, open_bag
from hybridreg_ros.replay.bag_writer import BagWriter

if TYPE_CHECKING:
    from pathlib import Path

STAMPS = [START + i * PERIOD for i in range(12)]


@pytest.mark.parametrize('name', ['a.mcap', 'a.db3', 'folder'])
def test_round_trip(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    write_room_bag(path, 12)
    assert path.is_file() == (name != 'folder')
    assert [p.name for p in tmp_path.iterdir()] == [name], 'scratch folder left behind'
    with open_bag(path) as bag:
        assert bag.recovered is None
        assert bag.topics['/points'] == ('/points', POINT_CLOUD2, 12)
        assert bag.topics['/ground_truth/odom'] == ('/ground_truth/odom', ODOMETRY, 12)
        frames = list(bag.frames())
        assert [f.stamp for f in frames] == STAMPS
        for i, frame in enumerate(frames):
            assert frame.scan is not None
            assert frame.scan.frame_id == 'lidar'
            assert frame.message.data.tobytes() == room_cloud(i).data.tobytes()
        truth = bag.ground_truth()
        assert truth is not None
        assert truth.stamps.tolist() == STAMPS
        for i, pose in enumerate(truth.poses):
            np.testing.assert_allclose(pose, sensor_pose(i), atol=1e-12)


def test_sqlite_directory_and_anyreader_of_rosbags(tmp_path: Path) -> None:
    from rosbags.highlevel import AnyReader

    with BagWriter(tmp_path / 'bag', storage='sqlite3') as writer:
        writer.write_cloud('/points', START, 'lidar', room_cloud(0))
    assert list((tmp_path / 'bag').glob('*.db3'))
    with AnyReader([tmp_path / 'bag']) as reader:
        ((connection, stamp, raw),) = list(reader.messages())
        message = reader.deserialize(raw, connection.msgtype)
    assert stamp == START
    assert message.header.frame_id == 'lidar'  # type: ignore[attr-defined]


def test_clouds_come_in_stamp_order(tmp_path: Path) -> None:
    write_room_bag(tmp_path / 'a.mcap', order=[1, 0, 2, 5, 3, 4, 6])
    with open_bag(tmp_path / 'a.mcap') as bag:
        stamps = [s.stamp for s in bag.scans()]
    assert stamps == STAMPS[:7]


@pytest.mark.parametrize('share', [0.35, 0.6, 0.97])
def test_cut_off_mcap_is_streamed(
    tmp_path: Path, share: float, caplog: pytest.LogCaptureFixture
) -> None:
    cut = tmp_path / 'cut.mcap'
    write_room_bag(tmp_path / 'big.mcap', 12, n=30000)
    whole = (tmp_path / 'big.mcap').read_bytes()
    cut.write_bytes(whole[: int(share * len(whole))])
    with caplog.at_level(logging.WARNING), open_bag(cut) as bag:
        scans = list(bag.scans())
        recovered = bag.recovered
        truth = bag.ground_truth()
    assert recovered is not None
    assert f'recovered {recovered} messages' in caplog.text
    assert truth is not None
    assert len(scans) + len(truth) == recovered
    assert 12 * share - 2.5 <= len(scans) <= 12 * share
    assert [s.stamp for s in scans] == STAMPS[: len(scans)]


def test_cut_off_mcap_inside_a_directory(tmp_path: Path) -> None:
    write_room_bag(tmp_path / 'bag', 12, n=30000)
    (file,) = (tmp_path / 'bag').glob('*.mcap')
    file.write_bytes(file.read_bytes()[:-5000])
    with open_bag(tmp_path / 'bag') as bag:
        assert bag.recovered
        assert len(list(bag.scans())) >= 10


def test_cut_off_sqlite_says_what_to_do(tmp_path: Path) -> None:
    write_room_bag(tmp_path / 'a.db3', 12)
    data = (tmp_path / 'a.db3').read_bytes()
    (tmp_path / 'a.db3').write_bytes(data[: len(data) // 2])
    with pytest.raises(BagError, match=r'cut-off sqlite3 bag .* \.recover'):
        list(open_bag(tmp_path / 'a.db3').scans())


def broken(folder: Path) -> dict[str, Path]:
    """Things that are not usable bags."""
    paths = {
        name: folder / name
        for name in ('gone', 'empty_dir', 'a.txt', 'a.bag', 'x.mcap', 'x.db3', '0.mcap')
    }
    paths['empty_dir'].mkdir()
    for name in ('a.txt', 'a.bag', 'x.mcap', 'x.db3'):
        paths[name].write_bytes(b'no bag at all ' * 100)
    paths['0.mcap'].write_bytes(b'')
    return paths


@pytest.mark.parametrize(
    ('name', 'text'),
    [
        ('gone', 'no bag at'),
        ('empty_dir', 'is not a log: expected'),
        ('a.txt', r'expected a \.mcap, \.db3 or \.bag file'),
        ('a.bag', r'cannot read bag .*: try rosbag reindex'),
        ('x.mcap', 'no complete message in it'),
        ('x.db3', 'does not begin like an sqlite3 file'),
        ('0.mcap', 'no complete message in it'),
    ],
)
def test_what_is_not_a_bag(tmp_path: Path, name: str, text: str) -> None:
    with pytest.raises(BagError, match=text) as caught:
        open_bag(broken(tmp_path)[name])
    assert '\n' not in str(caught.value)


def test_choice_of_the_cloud_topic(tmp_path: Path) -> None:
    write_room_bag(tmp_path / 'two.mcap', 2, topics=('/front', '/rear'))
    with open_bag(tmp_path / 'two.mcap') as bag:
        assert bag.cloud_topic() == '/front'
        assert bag.cloud_topic('/rear') == '/rear'
        assert bag.cloud_topic('rear') == '/rear'
        with pytest.raises(BagError, match=r'has no topic /top; found: /front \(sensor_msgs'):
            bag.cloud_topic('/top')
        with pytest.raises(BagError, match='is nav_msgs/msg/Odometry, expected sensor_msgs'):
            bag.cloud_topic('/ground_truth/odom')


def test_bag_without_clouds_or_truth(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'a.mcap') as writer:
        writer.write_odometry('/odom', START, ('odom', 'base'), np.eye(4))
    with open_bag(tmp_path / 'a.mcap') as bag:
        with pytest.raises(BagError, match=r'has no PointCloud2 topic; found: /odom'):
            bag.cloud_topic()
        assert bag.ground_truth() is None
        named = bag.ground_truth('/odom')
        assert named is not None
        np.testing.assert_allclose(named.poses[0], np.eye(4))


def test_broken_clouds_are_counted_not_fatal(tmp_path: Path) -> None:
    good = room_cloud(0)
    cut = CloudData(**{**vars(good), 'data': good.data[:100]})
    no_xyz = CloudData(**{**vars(good), 'fields': good.fields[3:]})
    empty = from_arrays(np.zeros((0, 3), np.float32))
    with BagWriter(tmp_path / 'a.mcap') as writer:
        for i, cloud in enumerate([good, cut, no_xyz, empty, good]):
            writer.write_cloud('/points', START + i * PERIOD, 'lidar', cloud)
    with open_bag(tmp_path / 'a.mcap') as bag:
        frames = list(bag.frames())
        assert len(list(bag.scans())) == 3
    assert [f.scan is None for f in frames] == [False, True, True, False, False]
    assert 'truncated data' in frames[1].error
    assert 'lacks field x, y, z' in frames[2].error


def _write_and_fail(path: Path) -> None:
    with BagWriter(path) as writer:
        writer.write_cloud('/points', START, 'lidar', room_cloud(0))
        raise RuntimeError('stop')


def test_writer_refuses_and_cleans_up(tmp_path: Path) -> None:
    (tmp_path / 'there.mcap').write_text('mine')
    with pytest.raises(BagError, match='exists already'):
        BagWriter(tmp_path / 'there.mcap')
    with pytest.raises(BagError, match=r'ends in \.mcap but storage is sqlite3'):
        BagWriter(tmp_path / 'new.mcap', storage='sqlite3')
    with pytest.raises(RuntimeError, match='stop'):
        _write_and_fail(tmp_path / 'new.mcap')
    assert [p.name for p in tmp_path.iterdir()] == ['there.mcap']
    assert (tmp_path / 'there.mcap').read_text() == 'mine'


@pytest.mark.parametrize('name', ['over.mcap', 'over'])
def test_writer_overwrites_when_asked(tmp_path: Path, name: str) -> None:
    for frames in (3, 2):
        with BagWriter(tmp_path / name, overwrite=True) as writer:
            for i in range(frames):
                writer.write_cloud('/points', START + i, 'lidar', room_cloud(0))
    with open_bag(tmp_path / name) as bag:
        assert bag.topics['/points'].messages == 2
    assert [p.name for p in tmp_path.iterdir()] == [name]


def test_odometry_carries_covariance_and_twist(tmp_path: Path) -> None:
    covariance, twist = np.arange(36.0).reshape(6, 6), np.arange(6.0)
    pose = se3.exp(np.array([1.0, 2.0, 3.0, 2.5, -1.0, 0.5]))
    with BagWriter(tmp_path / 'a.mcap') as writer:
        writer.write_odometry(
            '/odom', START, ('odom', 'base'), pose, covariance, twist, 2 * covariance
        )
    with open_bag(tmp_path / 'a.mcap') as bag:
        (message,) = (bag.decode(m) for m in bag.messages())
    assert message.child_frame_id == 'base'
    assert message.pose.covariance.tolist() == covariance.ravel().tolist()
    assert message.twist.covariance.tolist() == (2 * covariance).ravel().tolist()
    assert message.twist.twist.linear.y == 1.0
    assert message.twist.twist.angular.z == 5.0


@pytest.mark.parametrize(
    'schema',
    [
        (POINT_CLOUD2, 'ros2msg', b''),
        (POINT_CLOUD2, 'ros2msg', b'uint8 something_else'),
        (POINT_CLOUD2, 'ros2msg', b'not even ! a definition ('),
        (POINT_CLOUD2, 'ros2msg', b'\xff\xfe'),
        (POINT_CLOUD2, 'ros2idl', b'module {'),
        (POINT_CLOUD2, '', b''),
        ('sensor_msgs/PointCloud2', 'ros2msg', b''),
    ],
)
@pytest.mark.parametrize('chunked', [True, False])
def test_standard_messages_need_no_definition(
    tmp_path: Path, schema: tuple[str, str, bytes], chunked: bool
) -> None:
    write_mcap(tmp_path / 'a.mcap', cloud_bytes(3), schema, chunked=chunked)
    with open_bag(tmp_path / 'a.mcap') as bag:
        assert bag.recovered is None
        assert bag.topics['/points'] == ('/points', POINT_CLOUD2, 3)
        frames = list(bag.frames())
    assert [f.stamp for f in frames] == STAMPS[:3]
    for i, frame in enumerate(frames):
        assert frame.scan is not None, frame.error
        assert np.array_equal(frame.message.data, room_cloud(i).data)


def test_definitions_of_other_messages_are_learnt_or_left(tmp_path: Path) -> None:
    """A type of one's own with a header is ordered by its stamps where the bag explains it."""
    header = cloud_bytes(2)
    text = b'std_msgs/Header header\nuint32 rest\n'
    for name, definition in (('good', text), ('bad', b'???')):
        path = tmp_path / f'{name}.mcap'
        messages = [(topic, time + 5, raw) for topic, time, raw in header]
        write_mcap(path, messages, (f'own_msgs/msg/{name.title()}', 'ros2msg', definition))
        with open_bag(path) as bag:
            late = [m.stamp - s for m, s in zip(bag.messages(), STAMPS, strict=False)]
        assert late == ([0, 0] if name == 'good' else [5, 5])


@pytest.mark.parametrize('storage', ['mcap', 'db3'])
def test_stamps_of_zero_are_log_times(
    tmp_path: Path, storage: str, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / f'a.{storage}'
    with BagWriter(path) as writer:
        for topic, time, raw in cloud_bytes(3, stamped=False):
            writer.write_raw(topic, POINT_CLOUD2, time, raw)
    with open_bag(path) as bag:
        frames = list(bag.frames())
        times = [bag.decode(message).header.stamp for message in bag.messages()]
    assert [f.scan.stamp for f in frames if f.scan] == STAMPS[:3]
    assert [s.sec * 10**9 + s.nanosec for s in times] == STAMPS[:3]
    assert caplog.text.count('stamps of /points are zero: log times stand in') == 1


def test_stamps_that_no_bag_holds(tmp_path: Path) -> None:
    with pytest.raises(BagError, match='a stamp of -1 s cannot be stored'):
        write_one(tmp_path / 'a.mcap', -(10**9))
    with pytest.raises(BagError, match='cannot be stored: expected 0 to 2147483648 s'):
        write_one(tmp_path / 'a.mcap', 2**31 * 10**9)
    topic, time, raw = cloud_bytes(1)[0]
    raw = raw[:4] + struct.pack('<iI', -5, 0) + raw[12:]
    write_mcap(tmp_path / 'b.mcap', [(topic, time, raw)], (POINT_CLOUD2, 'ros2msg', b''))
    with open_bag(tmp_path / 'b.mcap') as bag:
        (frame,) = bag.frames()
    assert (frame.scan, frame.error) == (None, 'its stamp is negative: -5.000000 s')


def write_one(path: Path, stamp: int) -> None:
    with BagWriter(path) as writer:
        writer.write_cloud('/points', stamp, 'lidar', room_cloud(0))


def test_a_topic_without_messages(tmp_path: Path) -> None:
    write_mcap(tmp_path / 'a.mcap', [], (POINT_CLOUD2, 'ros2msg', b''))
    with open_bag(tmp_path / 'a.mcap') as bag, pytest.raises(BagError, match='no PointCloud2'):
        bag.cloud_topic()
    path = tmp_path / 'b.db3'
    write_room_bag(path, 1)
    connection = sqlite3.connect(path)
    connection.execute('DELETE FROM messages')
    connection.commit()
    connection.close()
    with open_bag(path) as bag:
        with pytest.raises(BagError, match='holds no message on /points'):
            bag.cloud_topic()
        assert bag.ground_truth() is None


def test_damaged_chunks_are_found_by_their_checksum(tmp_path: Path) -> None:
    path = tmp_path / 'a.mcap'
    write_mcap(path, cloud_bytes(6), (POINT_CLOUD2, 'ros2msg', b''))
    data = bytearray(path.read_bytes())
    data[len(data) // 4] ^= 0x40
    path.write_bytes(data)
    with open_bag(path) as bag, pytest.raises(BagError, match=r'is damaged .*mcap recover'):
        list(bag.frames())


def split_bag(folder: Path, suffix: str, parts: int = 12) -> None:
    """A folder of bag files with one frame each, whose numbers are not padded; no metadata."""
    folder.mkdir()
    for i in range(parts):
        with BagWriter(folder / f'run_{i}.{suffix}') as writer:
            writer.write_cloud('/points', STAMPS[i], 'lidar', room_cloud(i, 200))
            writer.write_odometry('/ground_truth/odom', STAMPS[i], ('w', 'l'), sensor_pose(i))


@pytest.mark.parametrize('suffix', ['mcap', 'db3'])
def test_split_bag_without_metadata(
    tmp_path: Path, suffix: str, caplog: pytest.LogCaptureFixture
) -> None:
    folder = tmp_path / 'bag'
    split_bag(folder, suffix)
    with open_bag(folder) as bag:
        assert bag.topics['/points'].messages == 12
        assert [s.stamp for s in bag.scans()] == STAMPS
        truth = bag.ground_truth()
    assert truth is not None
    assert truth.stamps.tolist() == STAMPS
    (folder / f'run_12.{suffix}').write_bytes(b'')
    with open_bag(folder) as bag:
        assert len(list(bag.scans())) == 12
    assert f'left out: {"cannot read bag " if suffix == "mcap" else ""}{folder}' in caplog.text


def test_odd_metadata(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    write_room_bag(tmp_path / 'bag', 3)
    metadata = tmp_path / 'bag' / 'metadata.yaml'
    whole = metadata.read_text()
    for text, warning in (
        (
            whole.replace('version: 9', 'version: 12'),
            'has version 12, newer than 9: the files are',
        ),
        ('][', 'cannot be used'),
        ('rosbag2_bagfile_information: 3', 'cannot be used'),
    ):
        metadata.write_text(text)
        caplog.clear()
        with open_bag(tmp_path / 'bag') as bag:
            assert len(list(bag.scans())) == 3
        assert warning in caplog.text
    metadata.write_text(
        whole.replace('version: 9', 'version: 12').replace(
            "compression_mode: ''", 'compression_mode: FILE'
        )
    )
    with pytest.raises(BagError, match='version 12, newer than 9, and its files are compressed'):
        open_bag(tmp_path / 'bag')
    metadata.write_text(whole.replace('bag.mcap', 'gone.mcap'))
    with pytest.raises(BagError, match=r'lacks gone\.mcap of its metadata'):
        open_bag(tmp_path / 'bag')


def test_folders_of_other_files(tmp_path: Path) -> None:
    for names, text in (
        (['a.mcap', 'b.db3'], r'holds \.db3 and \.mcap files and no metadata'),
        (['a.bag'], 'try rosbag reindex'),
        (['a.mcap.zstd'], 'holds compressed files and no metadata'),
    ):
        folder = tmp_path / names[0].replace('.', '_')
        folder.mkdir()
        for name in names:
            (folder / name).write_bytes(b'x')
        with pytest.raises(BagError, match=text):
            open_bag(folder)
    for chunked in (True, False):
        write_mcap(
            tmp_path / 'r.mcap',
            [('/p', 1, b'1234')],
            ('sensor_msgs/PointCloud2', 'ros1msg', b''),
            'ros1',
            chunked,
        )
        with pytest.raises(BagError, match='holds messages of ROS 1: convert it first'):
            open_bag(tmp_path / 'r.mcap')

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Bags of every kind and state: whole, cut off, unordered, foreign, and what is said of each."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tiny_bags import PERIOD, START, room_cloud, sensor_pose, write_room_bag

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
        for name in ('gone', 'empty_dir', 'no_meta', 'a.txt', 'a.bag', 'x.mcap', 'x.db3', '0.mcap')
    }
    paths['empty_dir'].mkdir()
    write_room_bag(paths['no_meta'], 1)
    (paths['no_meta'] / 'metadata.yaml').unlink()
    for name in ('a.txt', 'a.bag', 'x.mcap', 'x.db3'):
        paths[name].write_bytes(b'no bag at all ' * 100)
    paths['0.mcap'].write_bytes(b'')
    return paths


@pytest.mark.parametrize(
    ('name', 'text'),
    [
        ('gone', 'no bag at'),
        ('empty_dir', r'neither metadata\.yaml nor'),
        ('no_meta', r'no metadata\.yaml: name its file instead .*no_meta\.mcap'),
        ('a.txt', r'expected a \.mcap or \.db3 file'),
        ('a.bag', r'ROS 1 bag: convert it first, rosbags-convert'),
        ('x.mcap', 'no complete message in it'),
        ('x.db3', 'does not begin like an sqlite3 file'),
        ('0.mcap', 'seems to be empty'),
    ],
)
def test_what_is_not_a_bag(tmp_path: Path, name: str, text: str) -> None:
    with pytest.raises(BagError, match=text) as caught:
        open_bag(broken(tmp_path)[name])
    assert '\n' not in str(caught.value)


def test_choice_of_the_cloud_topic(tmp_path: Path) -> None:
    write_room_bag(tmp_path / 'two.mcap', 2, topics=('/front', '/rear'))
    with open_bag(tmp_path / 'two.mcap') as bag:
        with pytest.raises(BagError, match='2 PointCloud2 topics, choose one with --topic: /fro'):
            bag.cloud_topic()
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

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Logs as they come: folders of files and bags of ROS 1, whole or a part."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from PIL import Image
from tiny_bags import PERIOD, START, cloud_bytes, room_cloud, sensor_pose

from hybridreg_ros.cli.main import main
from hybridreg_ros.data.loaders.clouds import write_cloud
from hybridreg_ros.replay.bag_reader import open_bag
from hybridreg_ros.replay.trajectory_io import read_kitti_rows, read_tum

if TYPE_CHECKING:
    from pathlib import Path

FRAMES = 5
KISS = ['--registrar', 'kiss-icp', '--no-clouds']


def points(k: int) -> np.ndarray:
    raw = np.frombuffer(room_cloud(k).data, np.uint8).reshape(-1, room_cloud(k).point_step)
    return raw[:, :12].copy().view(np.float32)


def write_folder(folder: Path, suffix: str) -> None:
    folder.mkdir(parents=True)
    for k in range(FRAMES):
        write_cloud(folder / f'{k}{suffix}', points(k))
    rows = [sensor_pose(k)[:3].ravel() for k in range(FRAMES)]
    np.savetxt(folder / 'poses.txt', rows)


def metrics_of(log: Path, out: Path, *more: str) -> dict[str, object]:
    assert main(['replay', str(log), '--out', str(out), *KISS, *more]) == 0
    found: dict[str, object] = json.loads((out / 'metrics.json').read_text())
    return found


@pytest.mark.parametrize('suffix', ['.bin', '.ply', '.pcd', '.npy'])
def test_folder_of_clouds(tmp_path: Path, suffix: str) -> None:
    write_folder(tmp_path / 'walk', suffix)
    found = metrics_of(tmp_path / 'walk', tmp_path / 'o')
    assert (found['frames'], found['topic']) == (FRAMES, '/points')
    assert found['trajectory']['matched'] == FRAMES  # type: ignore[index]
    assert found['trajectory']['ate_rmse_m'] < 0.01  # type: ignore[index]
    estimate = read_kitti_rows(tmp_path / 'o' / 'odometry_kitti.txt')
    truth = read_kitti_rows(tmp_path / 'o' / 'truth_kitti.txt')
    assert estimate.shape == truth.shape == (FRAMES, 4, 4)
    np.testing.assert_allclose(truth[3], sensor_pose(3), atol=1e-9)
    assert len(read_tum(tmp_path / 'o' / 'truth.tum')) == FRAMES


def test_folder_of_depth_images(tmp_path: Path) -> None:
    folder = tmp_path / 'seq'
    folder.mkdir()
    rows, columns = np.mgrid[0:60, 0:80]
    for k in range(3):
        depth = 2000 + 3 * columns + 2 * rows - 10 * k
        Image.fromarray(depth.astype(np.uint16)).save(folder / f'frame-00000{k}.depth.png')
    (folder / 'camera-intrinsics.txt').write_text('60 0 40\n0 60 30\n0 0 1\n')
    found = metrics_of(folder, tmp_path / 'o')
    assert found['frames'] == 3
    assert found['not_scored'] == 'the bag holds no ground truth'


def test_folder_that_is_none_or_lacks_something(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_folder(tmp_path / 'walk', '.ply')
    (tmp_path / 'walk' / 'poses.txt').write_text('1 0 0 0 0 1 0 0 0 0 1 0\n')
    (tmp_path / 'empty').mkdir()
    (tmp_path / 'walk.pcap').touch()
    for name, more, text in (
        ('empty', [], 'is not a log: expected a .mcap, .db3 or .bag, velodyne/*.bin'),
        ('walk.pcap', [], 'play it with the driver of the sensor'),
        ('walk/1.ply', [], 'name its folder, or use `hybridreg register` with two'),
        ('walk', [], '5 scans but 1 poses'),
        ('walk', ['--topic', '/front'], '5 scans but 1 poses'),
    ):
        arguments = ['replay', str(tmp_path / name), '--out', str(tmp_path / 'o'), *KISS, *more]
        assert main(arguments) == 2
        assert text in capsys.readouterr().err
    (tmp_path / 'walk' / 'poses.txt').unlink()
    for option in ('--topic', '--truth-topic'):
        arguments = ['replay', str(tmp_path / 'walk'), '--out', str(tmp_path / 'o'), *KISS]
        assert main([*arguments, option, '/front']) == 2
        assert 'it has no topics' in capsys.readouterr().err


def write_ros1(path: Path, compression: str | None) -> None:
    """A bag of ROS 1 with the clouds of the room."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    old, new = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_JAZZY)
    made_by = Writer(path)
    if compression is not None:
        made_by.set_compression(Writer.CompressionFormat[compression])
    with made_by as writer:
        kind = 'sensor_msgs/msg/PointCloud2'
        connection = writer.add_connection('/points', kind, typestore=old)
        for number, (_, stamp, raw) in enumerate(cloud_bytes(FRAMES)):
            message: Any = new.deserialize_cdr(raw, kind)
            header = old.types['std_msgs/msg/Header'](
                number, message.header.stamp, message.header.frame_id
            )
            made = old.types[kind](
                header,
                *[
                    getattr(message, name)
                    for name, _ in old.fielddefs[kind][1]
                    if name != 'header'
                ],
            )
            writer.write(connection, stamp, old.serialize_ros1(made, kind))


@pytest.mark.parametrize('compression', [None, 'BZ2', 'LZ4'])
def test_bag_of_ros_1(tmp_path: Path, compression: str | None) -> None:
    write_ros1(tmp_path / 'walk.bag', compression)
    with open_bag(tmp_path / 'walk.bag') as bag:
        frames = list(bag.frames())
    assert [f.stamp for f in frames] == [START + k * PERIOD for k in range(FRAMES)]
    assert frames[2].scan is not None
    np.testing.assert_array_equal(frames[2].scan.points, points(2))
    assert frames[2].scan.frame_id == 'lidar'
    assert metrics_of(tmp_path / 'walk.bag', tmp_path / 'o')['accepted'] == FRAMES


def test_broken_bag_of_ros_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_ros1(tmp_path / 'walk.bag', None)
    data = (tmp_path / 'walk.bag').read_bytes()
    (tmp_path / 'walk.bag').write_bytes(data[: len(data) // 2])
    assert main(['replay', str(tmp_path / 'walk.bag'), '--out', str(tmp_path / 'o'), *KISS]) == 2
    assert 'rosbag reindex' in capsys.readouterr().err


def test_part_of_a_log(room_bag: Path, tmp_path: Path) -> None:
    found = metrics_of(room_bag, tmp_path / 'o', '--start', '0.3', '--duration', '0.4')
    stamps = [row['stamp'] for row in found['per_frame']]  # type: ignore[attr-defined]
    assert stamps == [START + k * PERIOD for k in range(3, 8)]

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`hybridreg score`: files and bags in every combination, masks, one-line errors."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tiny_bags import PERIOD, START, sensor_pose, write_tum

from hybridreg_ros.cli.main import main
from hybridreg_ros.core import se3
from hybridreg_ros.core.pointcloud2 import from_arrays
from hybridreg_ros.core.quaternion import to_quaternion
from hybridreg_ros.replay.bag_reader import trajectory_of
from hybridreg_ros.replay.bag_writer import BagWriter

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def truth(tmp_path: Path) -> Path:
    """Ten true poses as a TUM file."""
    path = tmp_path / 'truth.tum'
    write_tum(path, trajectory_of((START + i * PERIOD, sensor_pose(i)) for i in range(10)))
    return path


def test_perfect_tum_and_kitti(
    truth: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = tmp_path / 'r.json'
    assert main(['score', str(truth), str(truth), '--json', str(result)]) == 0
    text = capsys.readouterr().out
    assert 'ATE rmse' in text
    assert 'KITTI drift' in text
    assert json.loads(result.read_text())['trajectory']['ate_rmse_m'] < 1e-9
    rows = [' '.join(f'{v:.17g}' for v in sensor_pose(i)[:3].ravel()) for i in range(10)]
    (tmp_path / 'poses.txt').write_text('\n'.join(rows))
    times = [f'{(START + i * PERIOD) / 1e9:.9f}' for i in range(10)]
    (tmp_path / 'times.txt').write_text('\n'.join(times))
    arguments = ['score', str(tmp_path / 'poses.txt'), str(truth), '--json', str(result)]
    assert main([*arguments, '--tolerance', '0.001']) == 0
    assert json.loads(result.read_text())['trajectory']['matched'] == 10


def test_mask_of_recorded_clouds(truth: Path, tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'live.mcap') as bag:
        for i in range(3):
            stamp = START + i * PERIOD
            bag.write_odometry('/hybridreg/odom', stamp, ('odom', 'lidar'), sensor_pose(i))
            for name, labels in (('dynamic', [1, 2, 0]), ('static', [0, 0, 0, 1])):
                points = np.zeros((len(labels), 3), np.float32)
                cloud = from_arrays(points, {'label': np.array(labels, np.uint8)})
                bag.write_cloud(f'/hybridreg/{name}_points', stamp, 'lidar', cloud)
    result = tmp_path / 'r.json'
    assert main(['score', str(tmp_path / 'live.mcap'), str(truth), '--json', str(result)]) == 0
    scores = json.loads(result.read_text())
    assert scores['mask']['counts'] == {'tp': 6, 'fp': 3, 'fn': 3, 'tn': 9}
    assert scores['mask']['iou'] == pytest.approx(0.5)
    assert scores['trajectory']['matched'] == 3


def test_topics_of_bags(truth: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with BagWriter(tmp_path / 'a.mcap') as bag:
        for i in range(4):
            for topic in ('/wheel', '/visual'):
                bag.write_odometry(topic, START + i * PERIOD, ('odom', 'base'), sensor_pose(i))
    arguments = ['score', str(tmp_path / 'a.mcap'), str(truth)]
    assert main([*arguments, '--topic', '/wheel']) == 0
    capsys.readouterr()
    assert main(arguments) == 2
    assert 'has no topic /hybridreg/odom; found: /wheel' in capsys.readouterr().err


def test_truth_of_another_body(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A warning with the pose that explains the drift; with it, there is none."""
    turn = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    X = se3.transform(turn, np.array([0.1, 0.05, 0.4]))
    bends = [se3.exp(np.array([0.2, 0, 0, 0.02 * np.sin(k / 9), 0, 0.05])) for k in range(60)]
    body = [np.eye(4)]
    for step in bends:
        body.append(body[-1] @ step)
    for name, poses in (('est', [T @ X for T in body]), ('ref', body)):
        pairs = ((START + i * PERIOD, T) for i, T in enumerate(poses))
        write_tum(tmp_path / f'{name}.tum', trajectory_of(pairs))
    result = tmp_path / 'r.json'
    arguments = [
        'score',
        str(tmp_path / 'est.tum'),
        str(tmp_path / 'ref.tum'),
        '--json',
        str(result),
    ]
    assert main(arguments) == 0
    warning = capsys.readouterr().err
    assert warning.startswith('hybridreg: warning: the truth seems to be that of another body')
    assert json.loads(result.read_text())['trajectory']['drift']['translation_percent'] > 100.0
    extrinsic = warning.split('--extrinsic ')[1].split(':')[0].split()
    assert extrinsic == ['0.1', '0.05', '0.4', '-0.5', '0.5', '-0.5', '0.5']
    assert main([*arguments, '--extrinsic', *extrinsic]) == 0
    assert capsys.readouterr().err == ''
    assert json.loads(result.read_text())['trajectory']['drift']['translation_percent'] < 0.1
    assert main([*arguments, '--extrinsic', '0', '0', '0', '0', '0', '0', '2']) == 2
    assert 'extrinsic: quaternion (0, 0, 0, 2) has norm 2' in capsys.readouterr().err


@pytest.mark.parametrize('kind', ['TransformStamped', 'PoseWithCovarianceStamped', 'PoseStamped'])
def test_truth_of_every_message_with_a_pose(
    truth: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str
) -> None:
    for name, scale in (('good', 1.0), ('bad', 3.0)):
        with BagWriter(tmp_path / f'{name}.mcap') as bag:
            for i in range(10):
                stamp = START + i * PERIOD
                message = posed_message(bag, kind, stamp, sensor_pose(i), scale)
                bag.write('/vicon', f'geometry_msgs/msg/{kind}', stamp, message)
    result = tmp_path / 'r.json'
    assert main(['score', str(truth), str(tmp_path / 'good.mcap'), '--json', str(result)]) == 0
    assert json.loads(result.read_text())['trajectory']['ate_max_m'] < 1e-9
    capsys.readouterr()
    assert main(['score', str(truth), str(tmp_path / 'bad.mcap')]) == 2
    error = capsys.readouterr().err
    assert f'bad.mcap, /vicon at {START / 1e9:.6f} s: quaternion' in error
    assert len(error.splitlines()) == 1


def posed_message(bag: BagWriter, kind: str, stamp: int, T: np.ndarray, scale: float) -> object:
    """A message of geometry_msgs with a pose, its quaternion of a length."""
    geometry = 'geometry_msgs/msg/'
    time = bag._type('builtin_interfaces/msg/Time')(*divmod(stamp, 10**9))
    header = bag._type('std_msgs/msg/Header')(time, 'world')
    place = [float(v) for v in T[:3, 3]]
    turn = bag._type(geometry + 'Quaternion')(*(scale * v for v in to_quaternion(T[:3, :3])))
    if kind == 'TransformStamped':
        moved = bag._type(geometry + 'Transform')(bag._type(geometry + 'Vector3')(*place), turn)
        return bag._type(geometry + kind)(header, 'body', moved)
    pose = bag._type(geometry + 'Pose')(bag._type(geometry + 'Point')(*place), turn)
    if kind == 'PoseWithCovarianceStamped':
        pose = bag._type(geometry + 'PoseWithCovariance')(pose, np.zeros(36))
    return bag._type(geometry + kind)(header, pose)


def test_errors_are_one_line(
    truth: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    later = tmp_path / 'later.tum'
    write_tum(later, trajectory_of((10**9 * (i + 1), sensor_pose(i)) for i in range(3)))
    one = tmp_path / 'one.tum'
    write_tum(one, trajectory_of([(START, sensor_pose(0))]))
    (tmp_path / 'text.txt').write_text('hello world\n')
    for estimate, text in {
        later: 'no stamps in common within 0.01 s',
        one: '1 pose in common',
        tmp_path / 'gone.tum': 'no file at',
        tmp_path / 'gone.mcap': 'no bag at',
        tmp_path / 'text.txt': 'expected 8 columns (TUM) or 12 (KITTI), found 2',
    }.items():
        assert main(['score', str(estimate), str(truth)]) == 2
        error = capsys.readouterr().err
        assert text in error
        assert len(error.splitlines()) == 1

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Loaders of recorded data: tiny files in every format, real files, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from hybridreg_ros.core.errors import FileFormatError
from hybridreg_ros.core.se3 import apply, exp, inverse
from hybridreg_ros.data.loaders.clouds import write_cloud
from hybridreg_ros.data.loaders.eth import Eth
from hybridreg_ros.data.loaders.kitti import KittiOdometry
from hybridreg_ros.data.loaders.official import OfficialHybridMatch
from hybridreg_ros.data.loaders.posed_frames import (
    from_quaternion,
    pairs_apart,
    read_numbers,
    rigid,
)
from hybridreg_ros.data.loaders.sevenscenes import SevenScenes
from hybridreg_ros.data.loaders.threedmatch import ThreeDMatch, read_log
from hybridreg_ros.data.loaders.tum import TumRgbd

SHARED = Path(__file__).resolve().parents[2].parent / 'shared' / 'data'
WORLD = np.random.default_rng(0).uniform([-20, -20, -1], [20, 20, 3], (800, 3))
POSES = np.stack([exp(np.array([4.0 * k, 0.3 * k, 0.0, 0.0, 0.0, 0.1 * k])) for k in range(5)])
TURN = exp(np.array([0.2, -0.1, 0.4, 0.3, 0.2, -0.5]))


def real(name):
    path = SHARED / name
    if not path.exists():
        pytest.skip(f'{path} is not here')
    return path


def seen_from(T_world_sensor):
    return apply(inverse(T_world_sensor), WORLD).astype(np.float32)


def agrees(pair, tolerance=0.02):
    """Source points, moved by the pair's transform, lie on the target's points."""
    moved = apply(pair.T_target_source, pair.source.astype(np.float64))
    gap = np.linalg.norm(moved[:, None] - pair.target[None], axis=2).min(1)
    return float(np.median(gap)) < tolerance and not pair.source_label.any()


@pytest.fixture
def kitti(tmp_path):
    folder = tmp_path / '07'
    (folder / 'velodyne').mkdir(parents=True)
    for k, T in enumerate(POSES):
        write_cloud(folder / 'velodyne' / f'{k:06d}.bin', seen_from(T))
    rows = [T[:3].ravel() for T in POSES]
    np.savetxt(folder / 'poses.txt', rows)
    np.savetxt(folder / 'times.txt', 0.1 * np.arange(5))
    return folder


def test_kitti_pairs_are_apart_and_agree(kitti):
    data = KittiOdometry(kitti, distance_m=7.0)
    assert len(data) == 3
    assert data.pairs[0] == (2, 0)
    assert data.times_s is not None
    pair = data[1]
    assert pair.voxel_size_m == 0.3
    assert agrees(pair)
    assert pair.overlap > 0.9


def test_unpadded_numbers_go_with_their_poses(tmp_path):
    (tmp_path / 'velodyne').mkdir()
    poses = [exp(np.array([0.5 * k, 0.1 * k, 0, 0, 0, 0.02 * k])) for k in range(12)]
    for k, T in enumerate(poses):
        write_cloud(tmp_path / 'velodyne' / f'{k}.bin', seen_from(T))
    np.savetxt(tmp_path / 'poses.txt', [T[:3].ravel() for T in poses])
    data = KittiOdometry(tmp_path, distance_m=0.4)
    assert [f.name for f in data.files] == [f'{k}.bin' for k in range(12)]
    assert all(agrees(data[k]) for k in range(len(data)))
    for k, T in enumerate(camera_poses(12)):
        write_depth(tmp_path / f'frame-{k}.depth.png', wall_depth(T), 1000.0)
        np.savetxt(tmp_path / f'frame-{k}.pose.txt', T)
    frames = SevenScenes(tmp_path, step=2)
    np.testing.assert_allclose(frames.poses, camera_poses(12), atol=1e-9)


def test_kitti_poses_of_the_camera_are_moved_to_the_lidar(kitti):
    T_camera_lidar = TURN
    camera = [T_camera_lidar @ T @ inverse(T_camera_lidar) for T in POSES]
    np.savetxt(kitti / 'poses.txt', [T[:3].ravel() for T in camera])
    row = ' '.join(str(v) for v in T_camera_lidar[:3].ravel())
    (kitti / 'calib.txt').write_text(f'P0: 1 0 0 0 0 1 0 0 0 0 1 0\nTr: {row}\n')
    data = KittiOdometry(kitti, distance_m=3.0)
    assert np.allclose(data.poses, POSES, atol=1e-9)
    (kitti / 'calib.txt').write_text('P0: 1 2 3\n')
    with pytest.raises(FileFormatError, match='expected a line Tr:'):
        KittiOdometry(kitti)
    for damaged in (b'Tr: a b c\n', b'Tr: 1 0 \xc9\n'):
        (kitti / 'calib.txt').write_bytes(damaged)
        with pytest.raises(FileFormatError, match='something other than numbers'):
            KittiOdometry(kitti)


def test_broken_kitti_folders_are_refused(kitti, tmp_path):
    np.savetxt(kitti / 'poses.txt', [T[:3].ravel() for T in POSES[:3]])
    with pytest.raises(FileFormatError, match='one pose for each of 5 scans, found 3'):
        KittiOdometry(kitti)
    with pytest.raises(FileFormatError, match=r'holds no \.bin scans'):
        KittiOdometry(tmp_path / 'none')
    (kitti / 'poses.txt').unlink()
    with pytest.raises(FileFormatError, match='cannot read'):
        KittiOdometry(kitti)


def write_log(path, rows, size=4):
    text = ''
    for i, j, matrix in rows:
        lines = '\n'.join(' '.join(f'{v:.9f}' for v in row) for row in matrix)
        text += f'{i}\t{j}\t5\n{lines}\n'
    path.write_text(text)


def test_threedmatch_reads_log_info_and_clouds(tmp_path):
    rows = [(0, 1, inverse(POSES[0]) @ POSES[1]), (0, 3, inverse(POSES[0]) @ POSES[3])]
    write_log(tmp_path / 'gt.log', rows)
    write_log(tmp_path / 'gt.info', [(i, j, np.diag([1, 2, 3, 4, 5, 6.0])) for i, j, _ in rows])
    for k in (0, 1, 3):
        write_cloud(tmp_path / f'cloud_bin_{k}.ply', seen_from(POSES[k]))
    data = ThreeDMatch(tmp_path)
    assert len(data) == 2
    assert agrees(data[1])
    assert data[0].name.endswith('0_1')
    information = data.information(0)
    assert information is not None
    assert information[5, 5] == 6.0
    assert len(ThreeDMatch(tmp_path, neighbours=False)) == 1
    (tmp_path / 'cloud_bin_3.ply').unlink()
    with pytest.raises(FileFormatError, match='holds no cloud cloud_bin_3'):
        data[1]


def test_eth_is_the_same_with_other_names(tmp_path):
    write_log(tmp_path / 'gt.log', [(2, 4, inverse(POSES[2]) @ POSES[4])])
    for k in (2, 4):
        write_cloud(tmp_path / f'Hokuyo_{k}.ply', seen_from(POSES[k]))
    data = Eth(tmp_path)
    assert agrees(data[0])
    assert data[0].voxel_size_m == 0.1


def test_broken_logs_are_refused(tmp_path):
    path = tmp_path / 'gt.log'
    path.write_text('0 1 5\n1 0 0 0\n')
    with pytest.raises(FileFormatError, match='expected blocks of 19 numbers, found 7'):
        read_log(path)
    path.write_text('0 1 x')
    with pytest.raises(FileFormatError, match='expected numbers only'):
        read_log(path)
    with pytest.raises(FileFormatError, match='cannot read'):
        read_log(tmp_path / 'none.log')
    write_log(path, [(0, 1, 2.0 * np.eye(4))])
    write_cloud(tmp_path / 'cloud_bin_0.npy', WORLD)
    write_cloud(tmp_path / 'cloud_bin_1.npy', WORLD)
    with pytest.raises(FileFormatError, match='expected a rigid 4x4 transform'):
        ThreeDMatch(tmp_path)[0]


def wall_depth(T_world_camera, shape=(48, 64), f=60.0):
    """Depth image of the plane z = 4 of the world, metres."""
    v, u = np.mgrid[: shape[0], : shape[1]]
    rays = np.stack([(u - 32) / f, (v - 24) / f, np.ones(shape)], -1)
    world = rays @ T_world_camera[:3, :3].T
    return (4.0 - T_world_camera[2, 3]) / world[..., 2]


def camera_poses(count):
    return [
        exp(np.array([0.05 * k, 0.0, 0.1 * k, 0.01 * k, 0.02 * k, 0.03 * k])) for k in range(count)
    ]


def write_depth(path, depth_m, units):
    image = pytest.importorskip('PIL.Image')
    image.fromarray(np.round(depth_m * units).astype(np.uint16)).save(path)


def test_sevenscenes_frames_lie_on_the_wall(tmp_path):
    poses = camera_poses(4)
    (tmp_path / 'camera-intrinsics.txt').write_text('60 0 32\n0 60 24\n0 0 1\n')
    for k, T in enumerate(poses):
        write_depth(tmp_path / f'frame-{k:06d}.depth.png', wall_depth(T), 1000.0)
        np.savetxt(tmp_path / f'frame-{k:06d}.pose.txt', T)
    data = SevenScenes(tmp_path, step=2)
    assert len(data) == 2
    pair = data[0]
    moved = apply(data.poses[0] @ pair.T_target_source, pair.source.astype(np.float64))
    assert np.abs(moved[:, 2] - 4.0).max() < 2e-3
    (tmp_path / 'frame-000001.pose.txt').write_text('1 2 3')
    with pytest.raises(FileFormatError, match='expected 4 numbers, found 3'):
        SevenScenes(tmp_path)
    with pytest.raises(FileFormatError, match='holds no frame-NNNNNN'):
        SevenScenes(tmp_path / 'none')


def quaternion(R):
    w = 0.5 * np.sqrt(1.0 + np.trace(R))
    return [
        (R[2, 1] - R[1, 2]) / (4 * w),
        (R[0, 2] - R[2, 0]) / (4 * w),
        (R[1, 0] - R[0, 1]) / (4 * w),
        w,
    ]


def test_tum_associates_depth_and_truth(tmp_path):
    folder = tmp_path / 'rgbd_dataset_other'
    (folder / 'depth').mkdir(parents=True)
    poses = camera_poses(4)
    truth, listing = ['# time place quaternion'], ['# depth']
    for k, T in enumerate(poses):
        write_depth(folder / 'depth' / f'{k}.png', wall_depth(T, f=525.0), 5000.0)
        listing.append(f'{10.0 + 0.1 * k:.4f} depth/{k}.png')
        numbers = [10.005 + 0.1 * k, *T[:3, 3], *quaternion(T[:3, :3])]
        truth.append(' '.join(f'{v:.9f}' for v in numbers))
    listing.append('99.0 depth/late.png')
    (folder / 'depth.txt').write_text('\n'.join(listing))
    (folder / 'groundtruth.txt').write_text('\n'.join(truth))
    data = TumRgbd(folder, step=1)
    assert len(data) == 3
    assert np.allclose(data.poses, poses, atol=1e-6)
    assert data.camera.fx == 525.0
    assert len(data.cloud(0)) == 48 * 64
    with pytest.raises(FileFormatError, match=r'no depth image within 0.001 s'):
        TumRgbd(folder, max_gap_s=0.001)
    (folder / 'depth.txt').write_text('10.0')
    with pytest.raises(FileFormatError, match='expected lines of a time and a file name'):
        TumRgbd(folder)
    (folder / 'depth.txt').write_text('# nothing')
    with pytest.raises(FileFormatError, match='lists no depth images'):
        TumRgbd(folder)
    (folder / 'depth.txt').unlink()
    with pytest.raises(FileFormatError, match='cannot read'):
        TumRgbd(folder)


@pytest.fixture
def official(tmp_path):
    place = tmp_path / 'bp' / 'high' / '0001'
    place.mkdir(parents=True)
    source, target = seen_from(POSES[1]), seen_from(POSES[0])
    target[:200] += 1.0
    np.save(place / 'src.npy', source)
    np.save(place / 'ref.npy', target)
    np.save(place / 'ref_wo_anim.npy', seen_from(POSES[0]))
    np.save(place / 'relative_transform.npy', inverse(POSES[0]) @ POSES[1])
    for side in ('src', 'ref'):
        rows = list(range(200, len(source)))
        (place / f'{side}_back_indices.json').write_text(json.dumps({'back_indices': rows}))
    return tmp_path


def test_the_official_layout_gives_labels_and_the_frozen_twin(official):
    data = OfficialHybridMatch(official)
    pair = data[0]
    assert (len(data), pair.name) == (1, 'bp/high/0001')
    assert pair.dynamic_share == pytest.approx(0.25)
    assert (pair.source_label[:200] == 2).all()
    assert not pair.source_label[200:].any()
    assert pair.overlap > 0.95
    still = OfficialHybridMatch(official, still=True)[0]
    assert agrees(still)
    assert still.dynamic_share == 0.0


def test_broken_official_pairs_are_refused(official, tmp_path):
    place = official / 'bp' / 'high' / '0001'
    indices = place / 'src_back_indices.json'
    indices.write_text(json.dumps({'back_indices': [0, 999999]}))
    with pytest.raises(FileFormatError, match='expected rows below 800, found 0 to 999999'):
        OfficialHybridMatch(official)[0]
    indices.write_text('[]')
    with pytest.raises(FileFormatError, match=r'expected \{"back_indices"'):
        OfficialHybridMatch(official)[0]
    indices.unlink()
    with pytest.raises(FileFormatError, match='cannot read'):
        OfficialHybridMatch(official)[0]
    (place / 'relative_transform.npy').write_bytes(b'no array')
    with pytest.raises(FileFormatError, match='is not an array of numbers'):
        OfficialHybridMatch(official)[0]
    (tmp_path / 'empty').mkdir()
    with pytest.raises(FileFormatError, match=r'expected folders with ref\.npy'):
        OfficialHybridMatch(tmp_path / 'empty')


def test_number_tables_tell_the_line(tmp_path):
    path = tmp_path / 'table.txt'
    path.write_text('1 2 # note\n\n3 4\n')
    assert np.array_equal(read_numbers(path), [[1, 2], [3, 4]])
    path.write_text('1 2\n3 x\n')
    with pytest.raises(FileFormatError, match=r'table.txt:2: expected numbers'):
        read_numbers(path)
    path.write_text('')
    with pytest.raises(FileFormatError, match='holds no numbers'):
        read_numbers(path)
    path.write_bytes(b'\xff\xfe\x00')
    with pytest.raises(FileFormatError, match='is not a text file'):
        read_numbers(path)


def test_transforms_are_checked():
    assert np.allclose(rigid(TURN[:3].ravel(), 'here'), TURN)
    with pytest.raises(FileFormatError, match='here: expected a rigid'):
        rigid(np.arange(12.0), 'here')
    with pytest.raises(FileFormatError, match='here: expected a unit quaternion'):
        from_quaternion(np.zeros(3), np.zeros(4), 'here')
    assert pairs_apart(POSES[:1], 1.0) == []


@pytest.mark.real_data
def test_real_kitti_keyframes_agree_with_their_poses():
    data = KittiOdometry(real('lidar_kitti07_keyframes5'), distance_m=3.0)
    assert len(data) >= 3
    assert all(data[k].overlap > 0.5 for k in range(len(data)))


@pytest.mark.real_data
def test_real_sevenscenes_frames_agree_with_their_poses():
    data = SevenScenes(real('depth_7scenes'), step=2)
    assert len(data) == 98
    pair = data[40]
    assert len(pair.source) > 3000
    assert pair.overlap > 0.6

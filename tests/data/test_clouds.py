# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Clouds and depth images: round trips through every format, real files, damaged files."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from hybridreg_ros.core.errors import FileFormatError
from hybridreg_ros.core.se3 import transform
from hybridreg_ros.data.loaders.clouds import read_cloud, write_cloud
from hybridreg_ros.data.loaders.depth_images import (
    Intrinsics,
    depth_to_points,
    read_depth_m,
    read_intrinsics,
)
from hybridreg_ros.data.overlap import near_cells, overlap_share

SHARED = Path(__file__).resolve().parents[2].parent / 'shared' / 'data'
POINTS = np.random.default_rng(0).normal(size=(57, 3)).astype(np.float32)


def real(name):
    path = SHARED / name
    if not path.exists():
        pytest.skip(f'{path} is not here')
    return path


@pytest.mark.parametrize('suffix', ['.npy', '.npz', '.ply', '.pcd', '.bin'])
def test_clouds_survive_a_round_trip(tmp_path, suffix):
    path = tmp_path / f'cloud{suffix}'
    write_cloud(path, POINTS.astype(np.float64))
    back = read_cloud(str(path))
    assert back.dtype == np.float32
    assert np.array_equal(back, POINTS)


def test_written_ply_and_pcd_open_in_open3d(tmp_path):
    open3d = pytest.importorskip('open3d')
    for suffix in ('.ply', '.pcd'):
        path = tmp_path / f'cloud{suffix}'
        write_cloud(path, POINTS)
        other = np.asarray(open3d.io.read_point_cloud(str(path)).points)
        assert np.allclose(other, POINTS)


@pytest.mark.parametrize('mode', ['ascii', 'compressed', 'binary'])
def test_clouds_written_by_open3d_are_read(tmp_path, mode):
    open3d = pytest.importorskip('open3d')
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(POINTS))
    for suffix in ('.ply', '.pcd'):
        path = tmp_path / f'cloud{suffix}'
        open3d.io.write_point_cloud(
            str(path), cloud, write_ascii=mode == 'ascii', compressed=mode == 'compressed'
        )
        assert np.allclose(read_cloud(path), POINTS, atol=1e-5)


def test_ply_with_other_properties_and_big_endian(tmp_path):
    head = (
        'ply\nformat binary_big_endian 1.0\nelement vertex 2\nproperty uchar red\n'
        'property double x\nproperty double z\nproperty float y\nend_header\n'
    )
    body = b''.join(struct.pack('>Bddf', 9, k, k + 0.25, -k) for k in (1.0, 2.0))
    path = tmp_path / 'cloud.ply'
    path.write_bytes(head.encode() + body)
    assert np.array_equal(read_cloud(path), np.array([[1, -1, 1.25], [2, -2, 2.25]], np.float32))


BAD = {
    'short.bin': b'1234567',
    'cut.ply': b'ply\nformat binary_little_endian 1.0\nelement vertex 9\nproperty float x\n'
    b'property float y\nproperty float z\nend_header\nabc',
    'none.ply': b'hello',
    'no_z.ply': b'ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n',
    'cut.pcd': b'VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nPOINTS 3\n'
    b'DATA binary\n1234',
    'odd.npy': b'not numpy',
    'odd.npz': b'PK not a zip',
}


@pytest.mark.parametrize('name', list(BAD))
def test_damaged_clouds_give_one_clear_line(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(BAD[name])
    with pytest.raises(FileFormatError, match=name) as error:
        read_cloud(path)
    assert '\n' not in str(error.value)


def test_missing_unknown_and_flat_files_are_refused(tmp_path):
    with pytest.raises(FileFormatError, match='cannot read cloud'):
        read_cloud(tmp_path / 'nothing.ply')
    with pytest.raises(FileFormatError, match=r'expected one of \.npy'):
        read_cloud(tmp_path / 'cloud.xyz')
    with pytest.raises(FileFormatError, match=r'expected \.ply, \.pcd, \.npy'):
        write_cloud(tmp_path / 'cloud.xyz', POINTS)
    with pytest.raises(FileFormatError, match='cannot write'):
        write_cloud(tmp_path / 'no' / 'cloud.ply', POINTS)
    np.save(tmp_path / 'flat.npy', np.zeros(7))
    with pytest.raises(FileFormatError, match=r'expected numbers of shape \(N, 3\)'):
        read_cloud(tmp_path / 'flat.npy')


@pytest.mark.real_data
@pytest.mark.parametrize(
    ('name', 'count'),
    [
        ('lidar_small_gicp_pair/source.ply', 69792),
        ('rosbag2_vlp16_packets/1673400472138016708.pcd', 14831),
        ('lidar_kitti07_keyframes5/velodyne/000000.bin', None),
    ],
)
def test_real_clouds_are_read(name, count):
    points = read_cloud(real(name))
    assert count is None or len(points) == count
    assert np.isfinite(points).all()
    assert 5.0 < np.ptp(points, axis=0).max() < 400.0


def test_depth_images_become_points(tmp_path):
    image = pytest.importorskip('PIL.Image')
    raw = np.array([[0, 1000, 65535], [2000, 500, 9000]], np.uint16)
    image.fromarray(raw).save(tmp_path / 'd.png')
    depth = read_depth_m(tmp_path / 'd.png')
    assert np.isnan(depth[0, [0, 2]]).all()
    points = depth_to_points(depth, Intrinsics(2.0, 4.0, 1.0, 0.5), max_depth_m=3.0)
    expected = [[0.0, -0.125, 1.0], [-1.0, 0.25, 2.0], [0.0, 0.0625, 0.5]]
    assert np.allclose(points, expected)


def test_other_images_are_refused(tmp_path):
    image = pytest.importorskip('PIL.Image')
    image.fromarray(np.zeros((4, 4, 3), np.uint8)).save(tmp_path / 'rgb.png')
    with pytest.raises(FileFormatError, match='expected 16-bit depth, found uint8'):
        read_depth_m(tmp_path / 'rgb.png')
    (tmp_path / 'text.png').write_text('hello')
    with pytest.raises(FileFormatError, match='is not an image'):
        read_depth_m(tmp_path / 'text.png')
    with pytest.raises(FileFormatError, match='cannot read'):
        read_depth_m(tmp_path / 'none.png')


def test_intrinsics_come_as_matrix_or_four_numbers(tmp_path):
    path = tmp_path / 'k.txt'
    path.write_text('585 0 320\n0 580 240\n0 0 1\n')
    assert read_intrinsics(path) == Intrinsics(585.0, 580.0, 320.0, 240.0)
    path.write_text('1, 2, 3, 4')
    assert read_intrinsics(path) == Intrinsics(1.0, 2.0, 3.0, 4.0)
    path.write_text('0 580 320 240')
    with pytest.raises(FileFormatError, match='expected focal lengths above 0'):
        read_intrinsics(path)
    path.write_text('1 2 3')
    with pytest.raises(FileFormatError, match='expected 9 or 4 numbers, found 3'):
        read_intrinsics(path)
    path.write_text('a b')
    with pytest.raises(FileFormatError, match='expected numbers only'):
        read_intrinsics(path)
    with pytest.raises(FileFormatError, match='cannot read intrinsics'):
        read_intrinsics(tmp_path / 'none.txt')


def test_grid_neighbours_bracket_the_true_radius():
    rng = np.random.default_rng(1)
    a, b = rng.uniform(-5, 5, (400, 3)), rng.uniform(-5, 5, (300, 3))
    nearest = np.linalg.norm(a[:, None] - b[None], axis=2).min(1)
    near = near_cells(a, b, 0.8)
    assert near[nearest <= 0.8].all()
    assert not near[nearest > 3.5 * 0.8].any()
    assert not near_cells(a, b[:0], 0.8).any()
    assert overlap_share(a, a, np.eye(4), 0.1) == 1.0
    far = transform(np.eye(3), np.array([100.0, 0.0, 0.0]))
    assert overlap_share(a, a, far, 0.1) == 0.0

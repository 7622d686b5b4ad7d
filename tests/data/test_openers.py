# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Every format is told by what lies in its folder."""

from __future__ import annotations

from pathlib import Path

import pytest
from test_loaders import camera_poses, kitti, official, seen_from, wall_depth, write_depth
from test_loaders import write_log as write_gt_log
from test_shards import tiny

from hybridreg_ros.core.errors import FileFormatError
from hybridreg_ros.core.se3 import inverse
from hybridreg_ros.data.hybridmatch.shards import Split, encode_pair, write_shard
from hybridreg_ros.data.loaders.clouds import write_cloud
from hybridreg_ros.data.loaders.eth import Eth
from hybridreg_ros.data.loaders.kitti import KittiOdometry
from hybridreg_ros.data.loaders.official import OfficialHybridMatch
from hybridreg_ros.data.loaders.openers import open_pairs
from hybridreg_ros.data.loaders.sevenscenes import SevenScenes
from hybridreg_ros.data.loaders.threedmatch import ThreeDMatch
from hybridreg_ros.data.loaders.tum import TumRgbd

__all__ = ['kitti', 'official']
SHARED = Path(__file__).resolve().parents[2].parent / 'shared' / 'data'


@pytest.mark.parametrize(('stem', 'kind'), [('cloud_bin_{}', ThreeDMatch), ('Hokuyo_{}', Eth)])
def test_logs(tmp_path, stem, kind):
    poses = camera_poses(2)
    write_gt_log(tmp_path / 'gt.log', [(0, 1, inverse(poses[0]) @ poses[1])])
    for k, T in enumerate(poses):
        write_cloud(tmp_path / f'{stem.format(k)}.ply', seen_from(T))
    found = open_pairs(tmp_path)
    assert type(found) is kind
    assert len(found[0].source) > 0


def test_scans_and_released_pairs(kitti, official):
    assert isinstance(open_pairs(kitti), KittiOdometry)
    found = open_pairs(official / 'bp')
    assert isinstance(found, OfficialHybridMatch)
    assert found[0].source_label.any()


def test_images(tmp_path):
    seven, tum = tmp_path / 'seven', tmp_path / 'tum'
    (tum / 'depth').mkdir(parents=True)
    seven.mkdir()
    for k, T in enumerate(camera_poses(12)):
        write_depth(seven / f'frame-{k:06d}.depth.png', wall_depth(T), 1000.0)
        rows = '\n'.join(' '.join(str(v) for v in row) for row in T)
        (seven / f'frame-{k:06d}.pose.txt').write_text(rows)
        write_depth(tum / 'depth' / f'{k}.png', wall_depth(T), 5000.0)
    (tum / 'depth.txt').write_text(''.join(f'{k}.0 depth/{k}.png\n' for k in range(12)))
    (tum / 'groundtruth.txt').write_text(''.join(f'{k}.0 0 0 0 0 0 0 1\n' for k in range(12)))
    for folder, kind in ((seven, SevenScenes), (tum, TumRgbd)):
        found = open_pairs(folder)
        assert isinstance(found, kind)
        assert len(found) > 0


def test_shards_and_nothing(tmp_path):
    write_shard(tmp_path / '0000000.hrs', [encode_pair(tiny(3, 60))])
    assert isinstance(open_pairs(tmp_path), Split)
    (tmp_path / 'empty').mkdir()
    with pytest.raises(FileFormatError, match=r'hybridreg generate.*gt\.log'):
        open_pairs(tmp_path / 'empty')
    with pytest.raises(FileFormatError, match='no folder of pairs at'):
        open_pairs(tmp_path / 'gone')


@pytest.mark.real_data
@pytest.mark.parametrize(
    ('name', 'kind'), [('lidar_kitti07_keyframes5', KittiOdometry), ('depth_7scenes', SevenScenes)]
)
def test_real_folders_open(name, kind):
    if not (SHARED / name).exists():
        pytest.skip(f'{SHARED / name} is not here')
    found = open_pairs(SHARED / name)
    assert isinstance(found, kind)
    assert len(found[0].source) > 1000

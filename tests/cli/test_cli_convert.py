# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`hybridreg convert` and `simulate`: tiny folders of every layout, broken ones, real ones."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
import pytest
from PIL import Image

from hybridreg_ros.cli.main import main
from hybridreg_ros.core import se3
from hybridreg_ros.core.pointcloud2 import field_values
from hybridreg_ros.replay.bag_reader import open_bag
from hybridreg_ros.replay.recording import EPOCH_S

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray


def failure(capsys: pytest.CaptureFixture[str], arguments: list[str]) -> str:
    """The one error line of a command that must fail with exit code 2."""
    capsys.readouterr()
    assert main(arguments) == 2
    lines = [x for x in capsys.readouterr().err.splitlines() if x.startswith('hybridreg')]
    assert len(lines) == 1
    return lines[0]


def rows(poses: list[NDArray[np.float64]]) -> str:
    return '\n'.join(' '.join(f'{v:.12f}' for v in T[:3].ravel()) for T in poses)


def poses(n: int) -> list[NDArray[np.float64]]:
    return [se3.exp(np.array([0.3 * i, 0.1 * i, 0, 0, 0, 0.05 * i])) for i in range(n)]


@pytest.fixture
def kitti(tmp_path: Path) -> Path:
    """Four scans in KITTI's layout with poses and times."""
    folder = tmp_path / 'kitti'
    (folder / 'velodyne').mkdir(parents=True)
    rng = np.random.default_rng(1)
    for i in range(4):
        rng.random((50 + i, 4)).astype('<f4').tofile(folder / 'velodyne' / f'{i:06d}.bin')
    (folder / 'poses.txt').write_text(rows(poses(4)))
    (folder / 'times.txt').write_text('10.000000001\n10.5\n11.0\n11.5\n')
    return folder


def test_kitti(kitti: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag_path, result = tmp_path / 'a.mcap', tmp_path / 'r.json'
    arguments = ['convert', 'kitti', str(kitti), '--out', str(bag_path)]
    assert main([*arguments, '--json', str(result)]) == 0
    assert '4 clouds on /points, 4 poses on /ground_truth/odom' in capsys.readouterr().out
    assert json.loads(result.read_text()) == {'bag': str(bag_path), 'clouds': 4, 'poses': 4}
    with open_bag(bag_path) as bag:
        frames = list(bag.frames())
        truth = bag.ground_truth()
    assert truth is not None
    assert [f.stamp for f in frames] == truth.stamps.tolist()
    assert frames[0].stamp == 10_000_000_001
    np.testing.assert_allclose(truth.poses, poses(4), atol=1e-11)
    for i, frame in enumerate(frames):
        raw = np.fromfile(kitti / 'velodyne' / f'{i:06d}.bin', '<f4').reshape(-1, 4)
        assert frame.scan is not None
        assert np.array_equal(frame.scan.points, raw[:, :3])
        assert np.array_equal(field_values(frame.message, 'intensity'), raw[:, 3])
    assert 'exists already' in failure(capsys, arguments)
    assert main([*arguments, '--overwrite', '--stride', '2']) == 0
    with open_bag(bag_path) as bag:
        assert bag.topics['/points'].messages == 2


def test_kitti_camera_poses_and_official_layout(tmp_path: Path) -> None:
    folder = tmp_path / 'sequences' / '07'
    (folder / 'velodyne').mkdir(parents=True)
    (tmp_path / 'poses').mkdir()
    for i in range(3):
        np.zeros((5, 4), '<f4').tofile(folder / 'velodyne' / f'{i:06d}.bin')
    Tr = se3.exp(np.array([0.1, -0.2, 0.3, 1.2, -1.2, 1.2]))
    camera = [Tr @ T @ se3.inverse(Tr) for T in poses(3)]
    (tmp_path / 'poses' / '07.txt').write_text(rows(camera))
    (folder / 'calib.txt').write_text(f'P0: 1 0 0 0 0 1 0 0 0 0 1 0\nTr: {rows([Tr])}\n')
    assert (
        main(['convert', 'kitti', str(folder), '--out', str(tmp_path / 'b'), '--rate', '5']) == 0
    )
    with open_bag(tmp_path / 'b') as bag:
        truth = bag.ground_truth()
    assert truth is not None
    np.testing.assert_allclose(truth.poses, poses(3), atol=1e-9)
    assert np.diff(truth.stamps).tolist() == [200_000_000] * 2
    assert truth.stamps[0] == EPOCH_S * 10**9


def test_broken_kitti_folders(
    kitti: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = ['--out', str(tmp_path / 'o.mcap')]
    arguments = ['convert', 'kitti', str(kitti), *out]
    (tmp_path / 'empty').mkdir()
    empty = ['convert', 'kitti', str(tmp_path / 'empty'), *out]
    assert 'holds no scans: expected velodyne/*.bin' in failure(capsys, empty)
    assert 'no folder' in failure(capsys, ['convert', 'kitti', str(tmp_path / 'gone'), *out])
    (kitti / 'times.txt').write_text('1\n2\n')
    assert '4 scans but 2 times' in failure(capsys, arguments)
    (kitti / 'times.txt').unlink()
    (kitti / 'poses.txt').write_text(rows(poses(3)))
    assert '4 scans but 3 poses' in failure(capsys, arguments)
    (kitti / 'poses.txt').unlink()
    for name in ('poses_a.txt', 'poses_b.txt'):
        (kitti / name).write_text(rows(poses(4)))
    assert 'choose one with --poses: poses_a.txt, poses_b.txt' in failure(capsys, arguments)
    chosen = [*arguments, '--poses', str(kitti / 'poses_b.txt')]
    (kitti / 'calib.txt').write_text('P0: 1\n')
    assert 'expected a line Tr:, found none' in failure(capsys, chosen)
    for text, message in (
        ('Tr: 1 0 0 x', 'calib.txt: Tr holds something other than numbers'),
        ('Tr: 1 0 0', 'calib.txt Tr: expected a rigid 4x4 transform'),
        ('Tr: 9 0 0 0 0 1 0 0 0 0 1 0', 'calib.txt Tr: expected a rigid 4x4 transform'),
    ):
        (kitti / 'calib.txt').write_text(text)
        assert message in failure(capsys, chosen)
    (kitti / 'calib.txt').unlink()
    scan = kitti / 'velodyne' / '000002.bin'
    scan.write_bytes(scan.read_bytes()[:-4])
    assert '000002.bin is not a readable .bin cloud: 828 bytes' in failure(capsys, chosen)
    assert not list(tmp_path.glob('*o.mcap*')), 'an unfinished bag was left behind'


def test_unpadded_numbers_keep_their_order(tmp_path: Path) -> None:
    """0.bin to 11.bin go with rows 0 to 11 of the poses; so do depth images."""
    truth = poses(12)
    (tmp_path / 'k').mkdir()
    (tmp_path / 'k' / 'poses.txt').write_text(rows(truth))
    for i in range(12):
        np.full((5, 4), i + 1, '<f4').tofile(tmp_path / 'k' / f'{i}.bin')
        write_depth(tmp_path / 'd' / f'depth{i}.png', np.full((6, 8), 500 * (i + 1), np.uint16))
    (tmp_path / 'd' / 'camera-intrinsics.txt').write_text('10 0 4\n0 20 3\n0 0 1\n')
    for kind, folder, step, first in (('kitti', 'k', 1.0, 1.0), ('depth', 'd', 0.5, 0.5)):
        out = str(tmp_path / f'{folder}.mcap')
        assert main(['convert', kind, str(tmp_path / folder), '--out', out]) == 0
        with open_bag(out) as bag:
            frames, found = list(bag.frames()), bag.ground_truth()
        assert [f.scan.points[0, 2] for f in frames if f.scan] == [
            first + step * i for i in range(12)
        ]
        if kind == 'kitti':
            assert found is not None
            np.testing.assert_allclose(found.poses, truth, atol=1e-9)


def test_kitti_layout_of_five_columns(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Scans as nuScenes stores them (x y z intensity ring), 4 dividing their size."""
    (tmp_path / 'k').mkdir()
    tables = []
    for i in range(2):
        rng = np.random.default_rng(i)
        xyz = rng.uniform([-40, -40, -2], [40, 40, 4], (400, 3))
        rest = [rng.uniform(0, 255, 400).round(), np.arange(400) % 32]
        tables.append(np.column_stack([xyz, *rest]).astype('<f4'))
        tables[-1].tofile(tmp_path / 'k' / f'{i}.pcd.bin')
    arguments = [
        'convert',
        'kitti',
        str(tmp_path / 'k'),
        '--overwrite',
        '--out',
        str(tmp_path / 'a.db3'),
    ]
    for more in ([], ['--columns', '5']):
        assert main([*arguments, *more]) == 0
        with open_bag(tmp_path / 'a.db3') as bag:
            frames = list(bag.frames())
        for frame, table in zip(frames, tables, strict=True):
            assert frame.scan is not None
            assert np.array_equal(frame.scan.points, table[:, :3])
            assert np.array_equal(field_values(frame.message, 'intensity'), table[:, 3])
    assert '8000 bytes are not a multiple of 28' in failure(capsys, [*arguments, '--columns', '7'])


def write_depth(path: Path, raw: NDArray[np.uint16]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(raw).save(path)


@pytest.fixture
def depth(tmp_path: Path) -> Path:
    """Three depth images 8 x 6, every fifth of 30 Hz, the second without a pose."""
    folder = tmp_path / 'depth_scene'
    raw = np.full((6, 8), 2000, np.uint16)
    raw[0, 0], raw[0, 1], raw[5, 7] = 0, 65535, 12000
    for i, T in zip((0, 5, 10), poses(3), strict=True):
        write_depth(folder / f'frame-{i:06d}.depth.png', raw)
        text = '\n'.join(' '.join(f'{v:.12f}' for v in row) for row in T)
        if i == 5:
            text = text.replace(text.split()[0], 'nan')
        (folder / f'frame-{i:06d}.pose.txt').write_text(text)
    (folder / 'camera-intrinsics.txt').write_text('10 0 4\n0 20 3\n0 0 1\n')
    return folder


def test_depth(depth: Path, tmp_path: Path) -> None:
    assert main(['convert', 'depth', str(depth), '--out', str(tmp_path / 'd.db3')]) == 0
    with open_bag(tmp_path / 'd.db3') as bag:
        frames, truth = list(bag.frames()), bag.ground_truth()
    assert np.diff([f.stamp for f in frames]).tolist() == [166_666_667, 166_666_666]
    assert truth is not None
    assert len(truth) == 2, 'a lost pose (nan) is no pose'
    np.testing.assert_allclose(truth.poses[1], poses(3)[2], atol=1e-11)
    scan = frames[0].scan
    assert scan is not None
    assert scan.shape == (6, 8)
    assert scan.frame_id == 'camera_depth_optical_frame'
    assert (len(scan), scan.dropped) == (45, 3)
    v, u = 2, 5
    np.testing.assert_allclose(
        scan.points[v * 8 + u - 2], [(u - 4) / 10 * 2, (v - 3) / 20 * 2, 2.0], rtol=1e-6
    )
    arguments = ['convert', 'depth', str(depth), '--out', str(tmp_path / 'e.mcap')]
    assert main([*arguments, '--pixel-step', '2', '--max-depth', '20']) == 0
    with open_bag(tmp_path / 'e.mcap') as bag:
        small = next(iter(bag.scans()))
    assert small.shape == (3, 4)


def test_broken_depth_folders(
    depth: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ['convert', 'depth', str(depth), '--out', str(tmp_path / 'o.mcap')]
    image = depth / 'frame-000005.depth.png'
    whole = image.read_bytes()
    image.write_bytes(b'no image')
    assert 'is not an image' in failure(capsys, arguments)
    image.write_bytes(whole[:60])
    assert 'frame-000005' in failure(capsys, arguments)
    Image.fromarray(np.zeros((4, 4, 3), np.uint8)).save(image)
    assert 'expected 16-bit depth, found uint8' in failure(capsys, arguments)
    image.write_bytes(whole)
    (depth / 'frame-000010.pose.txt').write_text('1 2 3')
    assert '10.pose.txt:1: expected 4 numbers, found 3' in failure(capsys, arguments)
    (depth / 'frame-000010.pose.txt').write_text('a')
    assert 'frame-000010.pose.txt' in failure(capsys, arguments)
    intrinsics = depth / 'camera-intrinsics.txt'
    for text, message in {
        '1 2 3': 'expected 9 or 4 numbers',
        'fx': 'expected numbers only',
    }.items():
        intrinsics.write_text(text)
        assert message in failure(capsys, arguments)
    intrinsics.unlink()
    assert 'lacks camera-intrinsics.txt' in failure(capsys, arguments)
    for png in depth.glob('*.png'):
        png.unlink()
    assert 'holds no depth images' in failure(capsys, arguments)


@pytest.fixture
def tum(tmp_path: Path) -> Path:
    """Three images between five poses, the last image after the last pose."""
    folder = tmp_path / 'rgbd_dataset_freiburg3_test'
    listing = ['# depth maps']
    for stamp in ('100.05', '100.10', '100.25'):
        write_depth(folder / 'depth' / f'{stamp}.png', np.full((4, 4), 5000, np.uint16))
        listing.append(f'{stamp} depth/{stamp}.png')
    (folder / 'depth.txt').write_text('\n'.join(listing))
    truth = [f'{100 + 0.04 * k:.2f} {0.1 * k} 0 0 0 0 0 1' for k in range(5)]
    (folder / 'groundtruth.txt').write_text('\n'.join(truth))
    return folder


def test_tum(tum: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ['convert', 'tum', str(tum), '--out']
    assert main([*arguments, str(tmp_path / 't.mcap')]) == 0
    assert '3 clouds on /points, 2 poses' in capsys.readouterr().out
    with open_bag(tmp_path / 't.mcap') as bag:
        scans, truth = list(bag.scans()), bag.ground_truth()
    assert [s.stamp for s in scans] == [100_050_000_000, 100_100_000_000, 100_250_000_000]
    assert truth is not None
    np.testing.assert_allclose(truth.poses[:, 0, 3], [0.125, 0.25], atol=1e-12)
    np.testing.assert_allclose(scans[0].points[0, 2], 1.0)
    np.testing.assert_allclose(scans[0].points[0, 0], -320.1 / 535.4, rtol=1e-6)
    (tum / 'depth.txt').write_text('100.05\n')
    assert 'line 1: expected stamp and file name' in failure(capsys, [*arguments, 'x.mcap'])
    (tum / 'depth.txt').write_text('100.05 depth/gone.png\n')
    assert 'gone.png' in failure(capsys, [*arguments, str(tmp_path / 'x.mcap')])
    (tum / 'depth.txt').unlink()
    assert 'lacks depth.txt' in failure(capsys, [*arguments, 'x.mcap'])


def test_simulate_room(tmp_path: Path) -> None:
    for name in ('a.mcap', 'b.mcap'):
        arguments = ['simulate', '--scene', 'room', '--frames', '2', '--seed', '5']
        assert main([*arguments, '--out', str(tmp_path / name)]) == 0
    bags = [open_bag(tmp_path / name) for name in ('a.mcap', 'b.mcap')]
    first, second = (list(bag.frames()) for bag in bags)
    assert [f.message.data.tobytes() for f in first] == [f.message.data.tobytes() for f in second]
    truth = bags[0].ground_truth()
    assert truth is not None
    assert truth.stamps.tolist() == [f.stamp for f in first]
    assert np.diff(truth.stamps).tolist() == [100_000_000]
    labels = field_values(first[0].message, 'label')
    assert set(np.unique(labels)) <= {0, 1, 2}
    assert first[0].scan is not None
    assert first[0].scan.shape[0] > 1, 'a depth cloud is organised'


LIMITS_MM = {
    'lidar_balm_walk_a': ('kitti', 15.0, 30),
    'lidar_kitti_raw_22scans': ('kitti', 30.0, 22),
    'depth_7scenes': ('depth', 20.0, 100),
}


@pytest.mark.slow
@pytest.mark.real_data
@pytest.mark.parametrize('name', LIMITS_MM)
def test_real_recordings(shared_data: Path, tmp_path: Path, name: str) -> None:
    kind, limit_mm, frames = LIMITS_MM[name]
    bag = str(tmp_path / 'bag.mcap')
    assert main(['convert', kind, str(shared_data / name), '--out', bag]) == 0
    out = tmp_path / 'run'
    assert main(['replay', bag, '--registrar', 'kiss-icp', '--out', str(out)]) == 0
    metrics = json.loads((out / 'metrics.json').read_text())
    assert metrics['accepted'] == metrics['trajectory']['matched'] == frames
    assert metrics['trajectory']['step_mean_mm'] <= limit_mm

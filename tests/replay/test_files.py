# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Trajectory and cloud files: exact round trips, foreign formats, and one-line errors."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tiny_bags import write_tum

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import FileFormatError
from hybridreg_ros.core.quaternion import from_quaternion, to_quaternion
from hybridreg_ros.metrics.trajectory import Trajectory
from hybridreg_ros.replay import trajectory_io as io

if TYPE_CHECKING:
    from pathlib import Path


def random_trajectory(n: int = 20) -> Trajectory:
    rng = np.random.default_rng(5)
    poses = np.array([se3.exp(rng.normal(0, 2, 6)) for _ in range(n)])
    return Trajectory(1_700_000_000_123_456_789 + np.arange(n) * 99_999_999, poses)


def test_quaternions_against_scipy() -> None:
    rotations = Rotation.random(200, rng=np.random.default_rng(1))
    half_turns = Rotation.from_rotvec(np.pi * np.eye(3))
    for rotation in [*rotations, *half_turns, Rotation.identity()]:
        R = rotation.as_matrix()
        q = to_quaternion(R)
        assert abs(np.dot(q, rotation.as_quat())) == pytest.approx(1.0)
        assert q[3] >= 0.0
        np.testing.assert_allclose(from_quaternion(*q), R, atol=1e-14)
    np.testing.assert_allclose(from_quaternion(0, 0, 0, 1.05), np.eye(3))
    with pytest.raises(FileFormatError, match=r'has norm 0, not 1'):
        from_quaternion(0, 0, 0, 0)


def test_tum_round_trip_is_exact(tmp_path: Path) -> None:
    trajectory = random_trajectory()
    write_tum(tmp_path / 'a.tum', trajectory)
    back = io.read_trajectory(tmp_path / 'a.tum')
    assert np.array_equal(back.stamps, trajectory.stamps), 'nanoseconds lost'
    assert np.array_equal(back.poses[:, :3, 3], trajectory.poses[:, :3, 3])
    np.testing.assert_allclose(back.poses, trajectory.poses, atol=1e-15)


def test_evo_reads_the_tum_file(tmp_path: Path) -> None:
    from evo.tools.file_interface import read_tum_trajectory_file

    trajectory = random_trajectory()
    write_tum(tmp_path / 'a.tum', trajectory)
    back = read_tum_trajectory_file(tmp_path / 'a.tum')
    np.testing.assert_allclose(np.array(back.poses_se3), trajectory.poses, atol=1e-14)


def test_stamps_keep_nanoseconds() -> None:
    assert io.stamp_ns('1630577772.068958001') == 1_630_577_772_068_958_001
    assert io.stamp_ns('12') == 12_000_000_000
    assert io.stamp_ns('.5') == 500_000_000
    assert io.stamp_ns('-0.25') == -250_000_000
    assert io.stamp_ns('1e-3') == 1_000_000
    assert io.stamp_ns('0.1234567899') == 123_456_789


def test_kitti_file_with_and_without_times(tmp_path: Path) -> None:
    trajectory = random_trajectory(5)
    rows = [' '.join(f'{v:.17g}' for v in T[:3].ravel()) for T in trajectory.poses]
    (tmp_path / 'poses.txt').write_text('\n'.join(rows))
    plain = io.read_trajectory(tmp_path / 'poses.txt')
    np.testing.assert_allclose(plain.poses, trajectory.poses, atol=1e-12)
    assert plain.stamps.tolist() == [i * 100_000_000 for i in range(5)]
    (tmp_path / 'times.txt').write_text('\n'.join(f'{0.5 * i}' for i in range(5)))
    assert io.read_trajectory(tmp_path / 'poses.txt').stamps[4] == 2_000_000_000
    (tmp_path / 'times.txt').write_text('0\n1\n')
    with pytest.raises(FileFormatError, match=r'5 poses but .*times.txt 2 times'):
        io.read_trajectory(tmp_path / 'poses.txt')


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('', 'holds no pose'),
        ('# only a comment\n', 'holds no pose'),
        ('1 2 3\n', r'expected 8 columns \(TUM\) or 12 \(KITTI\), found 3'),
        ('1 0 0 0 0 0 0 1\n2 0 0 0 0 0 1\n', 'line 2: expected stamp x y z .* found 7 columns'),
        ('1 0 0 zero 0 0 0 1\n', 'line 1: .*could not convert'),
        ('1 0 0 0 0 0 0 0\n', 'norm 0, not 1'),
        ('1 0 0 0 0 0 0 1\n\n1 0 0 0 0 0 0 1\n', r'a\.txt line 3: stamps must increase.* line 1'),
        ('1 0 0 0 0 0 0 1\n2 0 0 0 1 1 0 1\n', r'a\.txt line 2: quaternion .* has norm 1.7'),
        ('1 0 0 nan 0 0 0 1\n', 'line 1: .*not finite'),
        ('1e400 0 0 0 0 0 0 1\n', 'line 1: .*not finite'),
        ('1e40 0 0 0 0 0 0 1\n', 'is no time: expected seconds'),
        ('99999999999 0 0 0 0 0 0 1\n', 'is no time: expected seconds'),
        ('1 0 0 0 0 1 0 0 0 0 1 0\n1 9 9 0 0 1 0 0 0 0 1 0\n', 'line 2: .* no rigid transform'),
        ('1 0 0 0 0 1 0 0 0 0 nan 0\n', 'line 1: .* no rigid transform'),
        ('1 0 0 0 0 1 0 0 0 0 1\n' * 2, 'found 11'),
        ('1 0 0 0 0 1 0 0 0 0 1 x\n', 'line 1: could not convert'),
        ('1 0 0 0 0 1 0 0 0 0 1 0\n1 2\n', 'line 2: expected 12 numbers, found 2'),
    ],
)
def test_bad_trajectory_files(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / 'a.txt').write_text(text)
    with pytest.raises(FileFormatError, match=message):
        io.read_trajectory(tmp_path / 'a.txt')


@pytest.mark.parametrize('start', [0, 1_700_000_000])
@pytest.mark.parametrize('unit', ['s', 'ms', 'us', 'ns'])
def test_stamps_in_other_units(
    tmp_path: Path, unit: str, start: int, caplog: pytest.LogCaptureFixture
) -> None:
    """Epoch stamps in any unit, and us and ns from zero; ms from zero may be seconds."""
    if (unit, start) == ('ms', 0):
        pytest.skip('0 100 200 may be seconds')
    stamps_ns = [start * 10**9 + i * 100_000_000 for i in range(20)]
    per_unit = {'s': 10**9, 'ms': 10**6, 'us': 10**3, 'ns': 1}[unit]
    texts = [
        f'{s // per_unit}.{s % per_unit:09d}' if unit == 's' else str(s // per_unit)
        for s in stamps_ns
    ]
    (tmp_path / 'a.tum').write_text(''.join(f'{t} 0 0 0 0 0 0 1\n' for t in texts))
    assert io.read_trajectory(tmp_path / 'a.tum').stamps.tolist() == stamps_ns
    (tmp_path / 'times.txt').write_text('\n'.join(texts))
    assert io.read_times(tmp_path / 'times.txt') == stamps_ns
    (tmp_path / 'list.txt').write_text('\n'.join(f'{t} {t}.png' for t in texts))
    assert [s for s, _ in io.read_listing(tmp_path / 'list.txt')] == stamps_ns
    assert (f'stamps are taken as {unit}' in caplog.text) == (unit != 's')


def test_what_is_no_trajectory_file(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match='no file at'):
        io.read_trajectory(tmp_path / 'gone.txt')
    with pytest.raises(FileFormatError, match='is not a text file'):
        io.read_trajectory(tmp_path)
    (tmp_path / 'b.txt').write_bytes(b'\xff\xfe\x00\x80')
    with pytest.raises(FileFormatError, match='is not a text file'):
        io.read_trajectory(tmp_path / 'b.txt')
    for reader, text in ((io.read_times, 'expected seconds'), (io.read_listing, 'expected stamp')):
        (tmp_path / 'c.txt').write_text('soon\n')
        with pytest.raises(FileFormatError, match=f'line 1: {text}'):
            reader(tmp_path / 'c.txt')
    (tmp_path / 'c.txt').write_text('# nothing\n')
    with pytest.raises(FileFormatError, match='lists no file'):
        io.read_listing(tmp_path / 'c.txt')

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The cleaned map: what any scan saw through is taken out, what stands still is kept."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
import pytest
from PIL import Image

from hybridreg_ros.cli.main import main
from hybridreg_ros.core import se3
from hybridreg_ros.data.loaders.clouds import read_cloud
from hybridreg_ros.replay.clean_map import MOVING, STILL, UNKNOWN, MapSink

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray


def scan(k: int, box_at: float | None) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """What a lidar 0.1 k m along a corridor sees: rays end at the box or at the walls."""
    azimuth, elevation = np.meshgrid(
        np.deg2rad(np.arange(0.0, 360.0, 0.5)), np.deg2rad(np.arange(-20.0, 20.0, 1.0))
    )
    ray = np.stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ],
        axis=-1,
    ).reshape(-1, 3)
    origin = np.array([0.1 * k, 0.0, 0.0])
    far = (np.array([8.0, 5.0, 2.0]) - np.sign(ray) * origin) / np.maximum(np.abs(ray), 1e-9)
    reach = far.min(axis=1)
    label = np.full(len(ray), STILL, np.uint8)
    if box_at is not None:  # an upright disc that faces the sensor
        hit = 2.0 / np.where(ray[:, 1] == 0.0, np.nan, ray[:, 1])
        place = origin + hit[:, None] * ray
        on = (hit > 0) & (np.abs(place[:, 0] - box_at) < 0.5) & (np.abs(place[:, 2]) < 0.8)
        reach = np.where(on, np.minimum(hit, reach), reach)
        label[on] = MOVING
    return (reach[:, None] * ray).astype(np.float32), label


def sink_of(tmp_path: Path, frames: int, labelled: bool = True) -> MapSink:
    sink = MapSink(tmp_path)
    for k in range(frames):
        points, label = scan(k, -3.0 + 0.4 * k if k < 15 else None)
        pose = se3.exp(np.array([0.1 * k, 0.0, 0.0, 0.0, 0.0, 0.0]))
        none = np.zeros(len(points), np.bool_)
        sink.offer(pose, points, none, label if labelled else np.full_like(label, UNKNOWN))
    return sink


@pytest.mark.parametrize('frames', [20, 8])
def test_ghosts_go_and_walls_stay(tmp_path: Path, frames: int) -> None:
    """Nobody called the box moving: earlier and later scans alone clear its trail."""
    made = sink_of(tmp_path, frames).make()
    report = made.report
    assert report.moving == 0
    assert report.ghosts > 0
    assert report.static_accuracy is not None
    assert report.dynamic_accuracy is not None
    assert report.static_accuracy > 0.97
    assert report.dynamic_accuracy > 0.9
    assert report.accuracy == pytest.approx(
        np.sqrt(report.static_accuracy * report.dynamic_accuracy)
    )
    in_the_way = (np.abs(made.still[:, 1] - 2.0) < 0.3) & (np.abs(made.still[:, 2]) < 0.7)
    free = np.abs(made.still[:, 0]) < 6.0
    assert (in_the_way & free).sum() < 0.02 * len(made.still)
    assert np.abs(made.moving[:, 1] - 2.0).min() < 0.1


def test_nothing_moves_nothing_goes(tmp_path: Path) -> None:
    sink = MapSink(tmp_path)
    for k in range(10):
        points, label = scan(k, None)
        pose = se3.exp(np.array([0.1 * k, 0.0, 0.0, 0.0, 0.0, 0.0]))
        sink.offer(pose, points, np.zeros(len(points), np.bool_), label)
    report = sink.make().report
    assert report.static_accuracy is not None
    assert report.static_accuracy > 0.99
    assert (report.dynamic_accuracy, report.accuracy) == (None, None)


def test_map_without_labels_or_scans(tmp_path: Path) -> None:
    report = sink_of(tmp_path, 4, labelled=False).make().report
    assert (report.scans, report.static_accuracy) == (4, None)
    empty = MapSink(tmp_path).make()
    assert (len(empty.still), empty.report.scans) == (0, 0)
    assert not list(tmp_path.iterdir()), 'scans are kept in a file without a name'


@pytest.mark.parametrize('suffix', ['.ply', '.pcd'])
def test_replay_writes_the_map(
    room_bag: Path, tmp_path: Path, suffix: str, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ['replay', str(room_bag), '--out', str(tmp_path / 'o'), '--registrar', 'kiss-icp']
    still, moved = tmp_path / f'clean{suffix}', tmp_path / f'moving{suffix}'
    assert main([*arguments, '--map', str(still), '--moving', str(moved)]) == 0
    assert 'of what stands still, took out' in capsys.readouterr().out
    report = json.loads((tmp_path / 'o' / 'metrics.json').read_text())['map']
    assert len(read_cloud(still)) == report['written'] > 500
    assert report['accuracy'] > 0.8
    assert len(read_cloud(moved)) > 0
    assert main([*arguments, '--map', str(tmp_path / 'map.txt')]) == 2
    assert 'expected a file ending in .ply' in capsys.readouterr().err


def test_replay_writes_a_film(room_bag: Path, tmp_path: Path) -> None:
    film = tmp_path / 'run.gif'
    arguments = ['replay', str(room_bag), '--out', str(tmp_path / 'o'), '--registrar', 'kiss-icp']
    assert main([*arguments, '--video', str(film)]) == 0
    with Image.open(film) as image:
        assert image.n_frames == 12
        image.seek(11)
        red, green, blue = np.asarray(image.convert('RGB'), int).reshape(-1, 3).T
    assert ((red > 180) & (green < 160) & (blue < 100)).sum() > 20, 'the moving box is orange'
    assert main([*arguments, '--overwrite', '--video', str(tmp_path / 'run.avi')]) == 2
    ffmpeg = pytest.importorskip('imageio_ffmpeg')
    film = tmp_path / 'run.mp4'
    assert main([*arguments, '--overwrite', '--video', str(film)]) == 0
    frames, seconds = ffmpeg.count_frames_and_secs(str(film))
    assert (frames, round(seconds, 1)) == (12, 1.2)
    about, *pictures = ffmpeg.read_frames(str(film))
    width, height = about['size']
    red, green, blue = np.frombuffer(pictures[11], np.uint8).reshape(height * width, 3).T
    assert ((red > 160) & (green < 170) & (blue < 110)).sum() > 20, 'the moving box is orange'

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Contact sheets: right colours at the right places, and pictures that can be read."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from test_shards import tiny

from hybridreg_ros.core.errors import DependencyError, FileFormatError
from hybridreg_ros.data.hybridmatch.preview import limits_of, panels, write_preview
from hybridreg_ros.data.hybridmatch.preview_raster import Projection, is_panorama, occupied, paint
from hybridreg_ros.data.hybridmatch.shards import encode_pair, write_shard
from hybridreg_ros.data.hybridmatch.splits_files import Row
from hybridreg_ros.data.hybridmatch.splits_summary import summarise

if TYPE_CHECKING:
    from pathlib import Path


def summary(count: int = 3):
    rows = [Row(f'tiny-{k}', 0.5, 0.2, 200, 217, 0.3) for k in range(count)]
    return summarise('room-match-10-30', 0, 'shards', 4, rows)


def test_both_pictures_are_written(tmp_path: Path) -> None:
    pytest.importorskip('matplotlib')
    write_shard(tmp_path / '0.hrs', [encode_pair(tiny(k)) for k in range(3)])
    sheet, charts = write_preview(tmp_path, summary(), rows=2)
    for path in (sheet, charts):
        assert path.read_bytes()[:8] == b'\x89PNG\r\n\x1a\n'
        assert path.stat().st_size > 3000


def test_a_folder_without_pairs_is_said(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match='holds no shards'):
        write_preview(tmp_path, summary())


def test_missing_matplotlib_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_shard(tmp_path / '0.hrs', [encode_pair(tiny(1))])
    monkeypatch.setattr('hybridreg_ros.core.errors.find_spec', lambda _: None)
    with pytest.raises(DependencyError, match='needs matplotlib'):
        write_preview(tmp_path, summary())


def test_the_nearest_point_is_in_front() -> None:
    points = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 3.0], [0.5, 0.0, 2.0]], np.float32)
    view = Projection('camera', np.eye(3), np.zeros(3), 100.0)
    image = paint(view, points, np.array([[200, 0, 0], [0, 200, 0], [0, 0, 200]]))
    middle = image[image.shape[0] // 2, image.shape[1] // 2]
    assert middle[0] > 100
    assert middle[1] == 0
    assert (image[0, 0] == 255).all()


def test_panels_of_rooms_and_streets() -> None:
    for pair in (tiny(1), tiny(2, reach=60.0)):
        assert is_panorama(pair.source)
        images = panels(pair)
        assert len(images) == 4
        assert all(i.dtype == np.uint8 and i.shape == images[0].shape for i in images)
        assert all((i != 255).any() for i in images)


def test_occupied_cells_are_those_of_near_points(rng: np.random.Generator) -> None:
    points = rng.uniform(-1.0, 1.0, (300, 3)).astype(np.float32)
    others = rng.uniform(-1.0, 1.0, (100, 3)).astype(np.float32)
    away = np.linalg.norm(points[:, None] - others[None], axis=2).min(1)
    found = occupied(points, others, 0.1)
    assert found[away < 0.1].all()
    assert not found[away > 0.35].any()


def test_limits_are_those_of_the_split() -> None:
    assert limits_of('street-lomatch-30-50') == {
        'overlap': (0.1, 0.3),
        'dynamic_share': (0.3, 0.5),
        'displacement_m': (0.25,),
    }
    assert limits_of('room-match-rigid') == {'overlap': (0.3,)}
    assert limits_of('room-train') == {'displacement_m': (0.25,)}

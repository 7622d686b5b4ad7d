# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from hybridreg_ros.core.errors import ConfigError, FileFormatError
from hybridreg_ros.data.loaders.labelled import LabelledScans, Moving, open_labelled
from hybridreg_ros.data.pair import Label

SCANS, POINTS = 8, 50


@pytest.fixture
def recording(tmp_path):
    """Eight scans 0.1 s apart, 1 m further along x each, with labels 0, 1, 2 in turn."""
    rng = np.random.default_rng(0)
    folder = tmp_path / 'street'
    (folder / 'velodyne').mkdir(parents=True)
    (folder / 'moving').mkdir()
    for k in range(SCANS):
        rows = rng.uniform(-20.0, 20.0, (POINTS, 4)).astype(np.float32)
        rows.tofile(folder / 'velodyne' / f'{k:06d}.bin')
        (np.arange(POINTS) % 3).astype(np.uint8).tofile(folder / 'moving' / f'{k:06d}.label')
    poses = [f'1 0 0 {k} 0 1 0 0 0 0 1 0' for k in range(SCANS)]
    (folder / 'poses.txt').write_text('\n'.join(poses), encoding='utf-8')
    times = [f'{0.1 * k:.6f}' for k in range(SCANS)]
    (folder / 'times.txt').write_text('\n'.join(times), encoding='utf-8')
    return folder


@pytest.mark.parametrize(('gap_s', 'step'), [(0.1, 1), (0.5, 5), (0.45, 5)])
def test_scans_are_the_asked_time_apart(recording, gap_s, step):
    found = LabelledScans(recording, gap_s=gap_s)
    assert found.pairs == [(j + step, j) for j in range(SCANS - step)]


def test_labels_and_pose_of_a_pair(recording):
    found = open_labelled(recording, 0.5).labelled(1)
    label = np.arange(POINTS) % 3
    assert found.pair.T_target_source[:3, 3] == pytest.approx([5.0, 0.0, 0.0])
    assert ((found.pair.source_label == Label.MOVING_RIGID) == (label == Moving.MOVING)).all()
    assert (found.source_known == (label != Moving.UNLABELLED)).all()
    assert found.target_known.sum() == found.source_known.sum()
    assert found.pair.name == 'street-000001_000006'


def test_what_is_wrong_is_said(recording, tmp_path):
    with pytest.raises(ConfigError, match=r'expected scans 2 s apart, found 0\.7 s'):
        open_labelled(recording, 2.0)
    with pytest.raises(FileFormatError, match=r'expected a recording with moving/\*\.label'):
        open_labelled(tmp_path, 0.5)
    path = recording / 'moving' / '000001.label'
    np.full(POINTS, 7, np.uint8).tofile(path)
    with pytest.raises(FileFormatError, match='expected 0, 1 or 2 per point, found 7'):
        open_labelled(recording, 0.5).labelled(1)
    np.zeros(3, np.uint8).tofile(path)
    with pytest.raises(FileFormatError, match='expected 50 labels of scan 1, found 3'):
        open_labelled(recording, 0.5).labelled(1)
    path.unlink()
    with pytest.raises(FileFormatError, match='cannot read'):
        open_labelled(recording, 0.5).labelled(1)
    (recording / 'times.txt').write_text('0.0\n', encoding='utf-8')
    with pytest.raises(FileFormatError, match=r'expected times\.txt'):
        open_labelled(recording, 0.5)

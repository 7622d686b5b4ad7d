# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The table that compares our static pairs with real ones at equal overlap."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path
    from types import ModuleType


@pytest.fixture
def report(script: Callable[[str], ModuleType]) -> ModuleType:
    return script('difficulty_report')


def scores(split: str, overlap: float, right: int, wrong: int) -> list[dict[str, Any]]:
    """Scores of pairs of scenes of two pairs each."""
    return [
        {
            'name': f'{split}-{overlap}-{k // 2}-{k}',
            'split': split,
            'overlap': overlap,
            'rmse_m': 0.1 if k < right else None,
            'threshold_m': 0.2,
        }
        for k in range(right + wrong)
    ]


def test_recall_is_weighted_to_the_overlaps_of_the_real_pairs(report: ModuleType) -> None:
    ours = {
        'room-match-rigid': scores('room-match-rigid', 0.5, 9, 1),
        'room-lomatch-rigid': scores('room-lomatch-rigid', 0.15, 2, 8),
    }
    real = scores('real', 0.5, 3, 0) + scores('real', 0.15, 0, 1)
    found = report.compare({**ours, 'real': real})
    assert found['ours_as_real']['RR'] == pytest.approx(0.75 * 0.9 + 0.25 * 0.2)
    low, high = found['ours_as_real']['RR_95']
    assert 0.4 < low < found['ours_as_real']['RR'] < high < 1.0
    assert found['real']['RR'] == 0.75
    above, below = found['spans'][:2]
    assert (above['ours']['RR'], above['real']['pairs']) == (0.9, 3)
    assert (below['ours']['pairs'], below['real']['RR']) == (10, 0.0)


def test_nothing_is_said_where_ours_has_no_such_overlap(report: ModuleType) -> None:
    ours = scores('room-match-rigid', 0.5, 3, 1)
    assert report.compare({'room-match-rigid': ours})['ours_as_real'] is None
    alone = {'room-match-rigid': ours, 'real': scores('real', 0.15, 1, 0)}
    found = report.compare(alone)
    assert found['ours_as_real'] is None
    assert found['spans'][1]['ours'] is None


def test_of_two_files_the_one_with_more_pairs_counts(report: ModuleType, tmp_path: Path) -> None:
    files = []
    for n in (4, 2):
        mine = scores('room-match-rigid', 0.5, n, 0)
        row = {
            'split': 'room-match-rigid',
            'pairs': n,
            'RR': 1.0,
            'RR_95': (0.5, 1.0),
            'RRE_deg': 1.0,
            'RTE_m': 0.1,
        }
        files.append(tmp_path / f'{n}.json')
        files[-1].write_text(
            json.dumps({'about': {'method': 'fpfh'}, 'rows': [row], 'scores': mine})
        )
    found = report.collect(files)
    assert found['splits']['room-match-rigid']['fpfh']['pairs'] == 4
    assert '| 0.3 to 1.0 | 100 (51 to 100; n = 4) | - |' in report.equal_table(found)
    assert 'room-match-rigid | 100 (50 to 100; n = 4)' in report.table(found)

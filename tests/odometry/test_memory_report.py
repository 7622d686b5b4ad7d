# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The report of resident memory over a looped sequence."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tiny_world import depth_rays, scans, walk

from hybridreg_ros.benchmark import suite_data, suite_memory
from hybridreg_ros.benchmark.suite_list import SEQUENCES

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path
    from types import ModuleType


@pytest.fixture
def report(script: Callable[[str], ModuleType]) -> ModuleType:
    return script('memory_report')


@pytest.mark.parametrize(
    ('count', 'frames'), [(1, [0, 0, 0, 0, 0]), (2, [0, 1, 0, 1, 0]), (3, [0, 1, 2, 1, 0])]
)
def test_frames_are_played_forth_and_back(
    report: ModuleType, count: int, frames: list[int]
) -> None:
    assert [report.looped(count, k) for k in range(5)] == frames


def test_scans_of_a_loop_are_not_bent(report: ModuleType, tmp_path: Path) -> None:
    street = replace(SEQUENCES['dev-street-8301'], frames=2)
    bent = suite_data.load(street, tmp_path, tmp_path)
    assert bent[0].scan.times is not None
    loop = report.loop_of(street, tmp_path, tmp_path)
    assert [s.times for s in loop] == [None, None]
    speed = np.linalg.norm(bent[1].T_world_sensor[:3, 3] - bent[0].T_world_sensor[:3, 3]) / 0.1
    late = bent[0].scan.times.argmax()
    off = np.linalg.norm(loop[0].points[late] - bent[0].scan.points[late])
    assert off == pytest.approx(speed * bent[0].scan.times[late], rel=0.3)


def test_growth_is_counted_from_where_the_loop_has_warmed_up(
    report: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = iter([700.0, 703.0, 703.5, 704.0])
    for module in (report, suite_memory):
        monkeypatch.setattr(module, 'WARM_STEPS', 1)
    monkeypatch.setattr(report, 'resident_mb', lambda: next(told))
    row = report.measure(scans(walk(3), depth_rays()), 0.1, 12)
    assert row['resident_mb'] == {'1': 700.0, '5': 703.0, '10': 703.5, '11': 704.0}
    row |= {'points': 10_800, 'steps': 12}
    assert report.table({'loop': row}).endswith('| 700.0 | 703.0 | 704.0 | 4.0 |')

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The report of resident memory over a looped sequence."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tiny_world import depth_rays, scans, walk

if TYPE_CHECKING:
    from collections.abc import Callable
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


def test_growth_is_counted_from_where_the_loop_has_settled(
    report: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    told = iter([700.0, 703.0, 703.5, 704.0])
    monkeypatch.setattr(report, 'SETTLED', 1)
    monkeypatch.setattr(report, 'resident_mb', lambda: next(told))
    row = report.measure(scans(walk(3), depth_rays()), 0.1, 8)
    assert row['resident_mb'] == {'1': 700.0, '4': 703.0, '5': 703.5, '7': 704.0}
    row |= {'points': 10_800, 'steps': 8}
    assert report.table({'loop': row}).endswith('| 700.0 | 703.5 | 704.0 | 4.0 |')

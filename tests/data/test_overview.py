# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Overview of splits: complete and begun ones, the table, the picture."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import pytest
from test_shards import tiny

from hybridreg_ros.core.errors import ConfigError, FileFormatError
from hybridreg_ros.data.hybridmatch import splits_work
from hybridreg_ros.data.hybridmatch.overview import draw_overview, overview_table, read_overview
from hybridreg_ros.data.hybridmatch.room_pairs import SPLITS
from hybridreg_ros.data.hybridmatch.splits import (
    SEEDS_PER_SPLIT,
    first_seed,
    generate_split,
    seed_range,
)
from hybridreg_ros.data.hybridmatch.take import Sample

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A complete split, and one that a killed run has begun."""

    def one(split: str, seed: int, **_: object) -> list[Sample]:
        return [Sample(tiny(seed, 60), 0.5, None)]  # type: ignore[arg-type]

    monkeypatch.setattr(splits_work, 'make_samples', one)
    generate_split('room-match-10-30', 9, 40, tmp_path / 'room-match-10-30')

    def stop(done: int, wanted: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        generate_split('street-match-rigid', 9, 80, tmp_path / 'street-match-rigid', progress=stop)
    return tmp_path


def test_complete_and_begun_splits_are_told(folder: Path) -> None:
    found = read_overview(folder)
    assert [s.split for s in found] == ['room-match-10-30', 'street-match-rigid']
    assert [(s.pairs, s.seed, s.scenes) for s in found] == [(9, 40, 12), (4, 80, 4)]
    table = overview_table(found)
    assert table.count('\n') == 4
    assert '| room-match-10-30 | 9 | 12 | 40 |' in table
    with pytest.raises(FileFormatError, match='holds no splits'):
        read_overview(folder / 'room-match-10-30')


def test_the_overview_is_drawn(folder: Path) -> None:
    pytest.importorskip('matplotlib')
    draw_overview(read_overview(folder), folder / 'overview.png')
    assert (folder / 'overview.png').read_bytes().startswith(b'\x89PNG')


def test_no_two_splits_share_a_scene() -> None:
    starts = {(part, s): first_seed(part, s) for part in ('train', 'val', 'test') for s in SPLITS}
    assert len(set(starts.values())) == len(starts)
    ordered = sorted(starts.values())
    assert all(b - a >= SEEDS_PER_SPLIT for a, b in pairwise(ordered))
    for (part, split), seed in starts.items():
        low, high = seed_range(seed)
        assert low == first_seed(part, SPLITS[0])
        assert seed + SEEDS_PER_SPLIT <= high, f'{part} {split}'
    with pytest.raises(ConfigError, match='part: expected one of train, val, test'):
        first_seed('exam', SPLITS[0])
    with pytest.raises(ConfigError, match='split: expected'):
        first_seed('test', 'room')

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Splits: exact numbers, the same bytes whatever happened on the way, honest statistics."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import tracemalloc
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from test_shards import tiny

from hybridreg_ros.core.errors import ConfigError, DependencyError, FileFormatError, HybridRegError
from hybridreg_ros.data.hybridmatch import splits, splits_work
from hybridreg_ros.data.hybridmatch.shards import open_split
from hybridreg_ros.data.hybridmatch.splits import generate_split, seed_range
from hybridreg_ros.data.hybridmatch.splits_summary import read_summary
from hybridreg_ros.data.hybridmatch.take import Sample

if TYPE_CHECKING:
    from pathlib import Path

TRUTH: Any = None
SPLIT = 'room-match-10-30'


@pytest.fixture
def scenes(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Replace the scenes by tiny pairs, seed % 3 from each; returns the seeds made so far."""
    made: list[int] = []

    def few(split: str, seed: int, *, count: int = 4, still: bool = False) -> list[Sample]:
        made.append(seed)
        pairs = [tiny(10 * seed + k, 60) for k in range(seed % 3)]
        return [Sample(p, 0.3 + 0.01 * seed, TRUTH, p.target if still else None) for p in pairs]

    monkeypatch.setattr(splits_work, 'make_samples', few)
    return made


def contents(folder: Path) -> dict[str, bytes]:
    return {
        str(p.relative_to(folder)): p.read_bytes()
        for p in sorted(folder.rglob('*'))
        if p.is_file()
    }


@pytest.mark.parametrize('layout', ['shards', 'official'])
@pytest.mark.parametrize('count', [1, 4, 7, 12])
def test_exactly_as_many_as_asked_for(
    tmp_path: Path, scenes: list[int], count: int, layout: str
) -> None:
    seen: list[tuple[int, int]] = []
    summary = generate_split(
        SPLIT, count, 0, tmp_path, layout=layout, progress=lambda *x: seen.append(x)
    )
    assert summary.pairs == count
    assert seen[-1] == (count, count)
    assert read_summary(tmp_path) == summary
    if layout == 'shards':
        found = [p.name for p in open_split(tmp_path)]
    else:
        found = sorted(
            (p.name for p in tmp_path.iterdir() if p.is_dir()), key=lambda n: int(n[5:])
        )
    expected = [f'tiny-{10 * s + k}' for s in range(40) for k in range(s % 3)][:count]
    assert found == expected
    assert summary.last_seed == scenes[-1]


@pytest.mark.parametrize('layout', ['shards', 'official'])
def test_a_stopped_run_goes_on_to_the_same_bytes(
    tmp_path: Path, scenes: list[int], layout: str
) -> None:
    generate_split(SPLIT, 11, 5, tmp_path / 'whole', layout=layout)
    once = len(scenes)

    def stop(done: int, wanted: int) -> None:
        if done >= 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        generate_split(SPLIT, 11, 5, tmp_path / 'cut', layout=layout, progress=stop)
    assert not (tmp_path / 'cut' / 'split.json').exists()
    before = len(scenes)
    generate_split(SPLIT, 11, 5, tmp_path / 'cut', layout=layout)
    assert contents(tmp_path / 'cut') == contents(tmp_path / 'whole')
    assert len(scenes) - before < once, 'what was there was not made again'


def test_a_torn_shard_and_left_overs_are_mended(tmp_path: Path, scenes: list[int]) -> None:
    generate_split(SPLIT, 11, 0, tmp_path / 'whole')
    folder = tmp_path / 'cut'

    def stop(done: int, wanted: int) -> None:
        if done >= 8:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        generate_split(SPLIT, 11, 0, folder, progress=stop)
    shard = sorted(folder.glob('*.hrs'))[1]
    shard.write_bytes(shard.read_bytes()[:-5])
    (folder / '.0000000.hrs.123.partial').write_bytes(b'half')
    (folder / '.blocks' / '0000000.json').write_text('[{"na')
    generate_split(SPLIT, 11, 0, folder)
    assert contents(folder) == contents(tmp_path / 'whole')


def test_a_complete_split_is_left_alone(tmp_path: Path, scenes: list[int]) -> None:
    first = generate_split(SPLIT, 5, 0, tmp_path)
    before, made = contents(tmp_path), len(scenes)
    assert generate_split(SPLIT, 5, 0, tmp_path) == first
    assert (contents(tmp_path), len(scenes)) == (before, made)


def test_nothing_is_mixed(tmp_path: Path, scenes: list[int]) -> None:
    generate_split(SPLIT, 5, 0, tmp_path / 'a')
    for other in ((SPLIT, 6, 0), (SPLIT, 5, 1), ('room-match-rigid', 5, 0)):
        with pytest.raises(ConfigError, match='choose another folder'):
            generate_split(*other, tmp_path / 'a')
    begun = tmp_path / 'b'

    def stop(done: int, wanted: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        generate_split(SPLIT, 5, 0, begun, progress=stop)
    with pytest.raises(ConfigError, match='was started with'):
        generate_split(SPLIT, 5, 3, begun)
    (tmp_path / 'c').mkdir()
    (tmp_path / 'c' / 'mine.txt').write_text('keep')
    with pytest.raises(ConfigError, match='neither empty nor an unfinished split'):
        generate_split(SPLIT, 5, 0, tmp_path / 'c')


def test_the_official_layout(tmp_path: Path, scenes: list[int]) -> None:
    generate_split(SPLIT, 2, 1, tmp_path, layout='official')
    pair = tiny(10)
    folder = tmp_path / 'tiny-10'
    assert sorted(p.name for p in folder.iterdir()) == [
        'ref.npy',
        'ref_back_indices.json',
        'ref_wo_anim.npy',
        'relative_transform.npy',
        'src.npy',
        'src_back_indices.json',
    ]
    pair = tiny(10, 60)
    np.testing.assert_array_equal(np.load(folder / 'src.npy'), pair.source)
    np.testing.assert_array_equal(np.load(folder / 'ref.npy'), pair.target)
    np.testing.assert_array_equal(np.load(folder / 'relative_transform.npy'), pair.T_target_source)
    rows = json.loads((folder / 'ref_back_indices.json').read_text())['back_indices']
    assert rows == np.flatnonzero(pair.target_label == 0).tolist()


def test_the_summary_counts_what_is_there(tmp_path: Path, scenes: list[int]) -> None:
    summary = generate_split(SPLIT, 9, 2, tmp_path)
    assert set(summary.distributions) == {'overlap', 'dynamic_share', 'points', 'displacement_m'}
    shape = summary.distributions
    assert sum(shape['overlap'].counts) == 9
    assert sum(shape['points'].counts) == 18
    assert (shape['points'].minimum, shape['points'].maximum) == (60, 77)
    assert shape['overlap'].median == pytest.approx(0.4)
    assert shape['displacement_m'].minimum == pytest.approx(0.32)
    for spread in shape.values():
        assert len(spread.edges) == len(spread.counts) + 1


def test_arguments_are_checked(tmp_path: Path, scenes: list[int]) -> None:
    with pytest.raises(ConfigError, match='split: expected'):
        generate_split('room', 5, 0, tmp_path)
    with pytest.raises(ConfigError, match='layout: expected'):
        generate_split(SPLIT, 5, 0, tmp_path, layout='zip')
    with pytest.raises(ConfigError, match='at least 1 pair'):
        generate_split(SPLIT, 0, 0, tmp_path)
    with pytest.raises(ConfigError, match='seed: expected'):
        generate_split(SPLIT, 1, -1, tmp_path)


def test_parts_do_not_share_scenes(tmp_path: Path, scenes: list[int]) -> None:
    assert [seed_range(s) for s in (0, 2_999_999, 3_000_000, 8_999_999)] == [
        (0, 3_000_000),
        (0, 3_000_000),
        (3_000_000, 6_000_000),
        (6_000_000, 9_000_000),
    ]
    assert max(high for _, high in splits.SEED_RANGES.values()) == 9_000_000
    assert seed_range(9_000_000)[0] == 9_000_000
    with pytest.raises(HybridRegError, match='6 scenes from seed 2999994 gave 6 of 50 pairs'):
        generate_split(SPLIT, 50, 2_999_994, tmp_path)
    assert max(scenes) == 2_999_999


def test_a_split_that_cannot_be_filled_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(splits_work, 'make_samples', lambda *_, **__: [])
    with pytest.raises(HybridRegError, match='gave 0 of 3 pairs'):
        generate_split(SPLIT, 3, 0, tmp_path)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_ten_thousand_pairs_need_no_more_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Real scenes need the same each; here, what the filling of a split holds on to."""
    one = tiny(3, 400)

    def many(split: str, seed: int, **_: object) -> list[Sample]:
        return [Sample(replace(one, name=f't-{seed}-{k}'), 0.5, TRUTH) for k in range(20)]

    monkeypatch.setattr(splits_work, 'make_samples', many)
    held: dict[int, int] = {}

    def note(done: int, wanted: int) -> None:
        held.setdefault(done // 1000, tracemalloc.get_traced_memory()[0])

    tracemalloc.start()
    generate_split(SPLIT, 10_000, 0, tmp_path, progress=note)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(open_split(tmp_path)) == 10_000
    per_pair = (held[9] - held[1]) / 8000
    assert per_pair < 1000, 'only the row of the statistics is kept of a pair'
    assert peak - held[1] < 40e6


def test_summaries_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match='cannot read'):
        read_summary(tmp_path)
    (tmp_path / 'split.json').write_text('{"split": 1}')
    with pytest.raises(FileFormatError, match='not a summary'):
        read_summary(tmp_path)


def test_dask_is_named_when_it_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, 'distributed', None)
    with pytest.raises(DependencyError, match='needs distributed'):
        generate_split(SPLIT, 1, 0, tmp_path, scheduler='tcp://127.0.0.1:1')


def _command(out: Path, workers: int) -> list[str]:
    return [
        sys.executable,
        '-m',
        'hybridreg_ros.cli.main',
        'generate',
        'room-match-rigid',
        '--pairs',
        '18',
        '--seed',
        '8995000',
        '--out',
        str(out),
        '--workers',
        str(workers),
    ]


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_kill_minus_nine_leaves_no_trace(tmp_path: Path) -> None:
    one, killed = tmp_path / 'one', tmp_path / 'killed'
    subprocess.run(_command(one, 1), check=True, timeout=280)
    process = subprocess.Popen(_command(killed, 2), start_new_session=True)
    deadline = time.monotonic() + 200.0
    while not list(killed.glob('*.hrs')) and time.monotonic() < deadline:
        time.sleep(0.05)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert not (killed / 'split.json').exists()
    subprocess.run(_command(killed, 2), check=True, timeout=280)
    assert contents(killed) == contents(one)
    assert len(open_split(killed)) == 18


@pytest.mark.slow
def test_dask_gives_the_same_bytes(tmp_path: Path) -> None:
    distributed = pytest.importorskip('distributed')
    generate_split('room-match-rigid', 3, 8_995_000, tmp_path / 'here')
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, dashboard_address=None, processes=False
    ) as cluster:
        address = cluster.scheduler_address
        generate_split('room-match-rigid', 3, 8_995_000, tmp_path / 'there', scheduler=address)
    assert contents(tmp_path / 'here') == contents(tmp_path / 'there')


@pytest.mark.slow
def test_no_scheduler_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip('distributed')
    monkeypatch.setattr(splits_work, '_CONNECT_S', '1s')
    with pytest.raises(HybridRegError, match='no Dask scheduler at'):
        generate_split(SPLIT, 1, 0, tmp_path, scheduler='tcp://127.0.0.1:9')

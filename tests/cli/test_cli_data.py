# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`generate all`, `evaluate --method` with `--keep`, `bench --data`: tiny runs, and what fails."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
import pytest

from hybridreg_ros.benchmark import bench_data
from hybridreg_ros.cli.main import main
from hybridreg_ros.data.hybridmatch import splits_work
from hybridreg_ros.data.hybridmatch.room_pairs import SPLITS
from hybridreg_ros.data.hybridmatch.shards import encode_pair, open_split, write_shard
from hybridreg_ros.data.hybridmatch.take import Sample
from hybridreg_ros.data.loaders.posed_frames import recorded_pair
from hybridreg_ros.training import baselines

if TYPE_CHECKING:
    from pathlib import Path

    from hybridreg_ros.data.pair import PointPair


def pair(name: str) -> PointPair:
    """A cloud and itself."""
    cloud = np.random.default_rng(len(name)).uniform(0.0, 2.0, (500, 3)).astype(np.float32)
    return recorded_pair(cloud, cloud, np.eye(4), 0.05, name)


def last_error(capsys: pytest.CaptureFixture[str], arguments: list[str]) -> str:
    assert main(arguments) == 2
    return capsys.readouterr().err.splitlines()[-1]


def test_all_splits_are_made_by_one_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    seeds: dict[str, int] = {}

    def one(split: str, seed: int, **_: object) -> list[Sample]:
        seeds.setdefault(split, seed)
        return [Sample(pair(f'{split}-{seed:07d}-0'), 0.5, None)]  # type: ignore[arg-type]

    monkeypatch.setattr(splits_work, 'make_samples', one)
    out = tmp_path / 'test'
    arguments = ['generate', 'all', '--part', 'test', '--out', str(out)]
    assert main([*arguments, '--pairs', '2', '--json', str(tmp_path / 's.json')]) == 0
    assert sorted(p.name for p in out.iterdir()) == sorted(SPLITS)
    assert all(len(open_split(out / split)) == 2 for split in SPLITS)
    assert len(set(seeds.values())) == len(SPLITS)
    assert all(6_000_000 <= seed < 9_000_000 for seed in seeds.values())
    assert [s['split'] for s in json.loads((tmp_path / 's.json').read_text())] == list(SPLITS)
    assert (
        main(['generate', 'street-match-rigid', '--part', 'val', '--out', str(tmp_path / 'v')])
        == 0
    )
    assert len(open_split(tmp_path / 'v')) == 100
    capsys.readouterr()
    assert 'leave --seed out' in last_error(capsys, [*arguments, '--seed', '4'])
    line = last_error(capsys, ['generate', 'room-match-rigid', '--out', str(tmp_path / 'x')])
    assert 'no default number of pairs: give --pairs' in line


def test_an_evaluation_goes_on_where_it_was(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[str] = []

    def right(p: PointPair) -> np.ndarray:
        seen.append(p.name)
        return np.eye(4)

    monkeypatch.setitem(baselines.METHODS, 'fpfh', right)
    write_shard(tmp_path / '0000000.hrs', [encode_pair(pair(f'set-{k:07d}-0')) for k in range(4)])
    arguments = ['evaluate', str(tmp_path), '--method', 'fpfh', '--keep', str(tmp_path / 'k')]
    assert main([*arguments, '--limit', '2']) == 0
    assert main([*arguments, '--json', str(tmp_path / 'r.json')]) == 0
    assert seen == [f'set-{k:07d}-0' for k in range(4)], 'no pair is measured twice'
    result = json.loads((tmp_path / 'r.json').read_text())
    assert result['about']['method'] == 'fpfh'
    assert result['rows'][0]['RR'] == 1.0
    assert result['rows'][0]['RR_95'][0] == pytest.approx(0.51, abs=0.01)
    capsys.readouterr()
    line = last_error(capsys, [*arguments[:3], 'kiss-matcher', *arguments[4:]])
    assert 'holds scores of' in line


@pytest.mark.slow
def test_bench_of_the_data(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip('embreex')
    monkeypatch.setattr(bench_data, 'SPLITS', ('room-match-rigid',))
    monkeypatch.setattr(bench_data, 'SCENES', ())
    out = tmp_path / 'b.json'
    assert main(['bench', '--data', '--pairs', '2', '--json', str(out)]) == 0
    assert 'ray casting' in capsys.readouterr().out
    (cost,) = json.loads(out.read_text())['costs']
    assert cost['pairs'] >= 2
    assert 0.0 < cost['cast_s'] < cost['cpu_s']
    assert 10 < cost['disk_kb'] < 150

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The stream of training pairs: seeds, uses, disk and shares, also over kills."""

from __future__ import annotations

import itertools
import json
import os
import signal
import time
from collections import Counter
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest
from conftest_training import TINY, make_pair

from hybridreg_ros.core.errors import ConfigError, FileFormatError, HybridRegError
from hybridreg_ros.data.hybridmatch import splits_work
from hybridreg_ros.data.hybridmatch.room_pairs import make_samples
from hybridreg_ros.data.hybridmatch.shards import decode_pair, encode_pair, read_offsets
from hybridreg_ros.model.budget import Budget
from hybridreg_ros.training import stream
from hybridreg_ros.training.config import BudgetConfig, StreamConfig
from hybridreg_ros.training.generator import Filler, Generator
from hybridreg_ros.training.samples import SampleStream
from hybridreg_ros.training.stream import PairStream, Shard, Use, pair_again, uses_in

if TYPE_CHECKING:
    from hybridreg_ros.data.pair import PointPair

LAST = 2_999_999
"""Last training seed: a stream that starts a few before it ends soon."""


@dataclass(frozen=True)
class _Made:
    pair: PointPair
    displacement_m: float = 0.0


def _pairs_of(kind, seed):
    """One or two tiny pairs a scene, none for each fifth seed; streets have fewer pairs."""
    if seed % 5 == 0:
        return []
    count = 1 if kind.startswith('street') else 2
    return [_Made(make_pair(10 * seed + k)) for k in range(count)]


@pytest.fixture
def tiny_scenes(monkeypatch):
    """Scenes of a few boxes in place of rooms and streets; returns the seeds that were made."""
    seeds = []

    def samples(kind, seed, **_):
        seeds.append((kind, seed))
        return _pairs_of(kind, seed)

    monkeypatch.setattr(splits_work, 'make_samples', samples)
    monkeypatch.setattr(stream, 'make_samples', _pairs_of)
    return seeds


def _config(**changes):
    return StreamConfig(
        **{'kinds': ('room-train',), 'first_seed': LAST - 9, 'buffer_mb': 100.0, **changes}
    )


def _drain(reader):
    """Draw until everything is used up; the names of the pairs."""
    names: list[str] = []

    def draw_on():
        names.extend(reader.draw(number).name for number in itertools.count())

    with pytest.raises(HybridRegError, match='every training seed has been used'):
        draw_on()
    return names


def _size(folder):
    return sum(path.stat().st_size for path in folder.glob('*.hrs'))


def test_a_seed_gives_the_same_pair_again():
    kind, seed = 'room-train', 2_000_001
    first = make_samples(kind, seed)[1].pair
    again = pair_again(Use(7, Shard(3, kind, seed).stem, 1))
    assert encode_pair(again) == encode_pair(decode_pair(encode_pair(first)))


def test_every_use_can_be_made_again(tmp_path, tiny_scenes):
    config = _config()
    Filler(tmp_path, config).fill()
    reader = PairStream(tmp_path, config, seed=1)
    drawn = [reader.draw(number) for number in range(6)]
    uses = list(uses_in(tmp_path))
    assert [use.number for use in uses] == list(range(6))
    for pair, use in zip(drawn, uses, strict=True):
        assert encode_pair(pair_again(use)) == encode_pair(pair)


def test_a_row_that_a_seed_does_not_give_is_reported(tiny_scenes):
    with pytest.raises(HybridRegError, match='row 9 of 2 pairs; another generator made it'):
        pair_again(Use(0, Shard(0, 'room-train', 2_000_001).stem, 9))


def test_names_of_shards():
    shard = Shard(12, 'street-recorded', 2_300_456)
    assert Shard.of(shard.stem) == shard
    with pytest.raises(FileFormatError, match='expected NUMBER-KIND-SEED'):
        Shard.of('3000000')


@pytest.mark.parametrize('uses', [1, 3])
def test_no_pair_is_used_more_often_than_it_may(tmp_path, tiny_scenes, uses):
    config = _config(uses=uses, window=3)
    Filler(tmp_path, config).fill()
    names = _drain(PairStream(tmp_path, config, seed=1))
    made = [p.pair.name for _, seed in tiny_scenes for p in _pairs_of('room-train', seed)]
    assert Counter(names) == dict.fromkeys(made, uses)
    assert not list(tmp_path.glob('*.hrs'))


def test_readers_share_the_pairs(tmp_path, tiny_scenes):
    config = _config(uses=1)
    Filler(tmp_path, config).fill()
    readers = [PairStream(tmp_path, config, seed=1, reader=r, readers=2) for r in range(2)]
    total = sum(len(read_offsets(path)) - 1 for path in tmp_path.glob('*.hrs'))
    mine = sum(
        len(read_offsets(path)) - 1
        for path in tmp_path.glob('*.hrs')
        if Shard.of(path.stem).number % 2 == 0
    )
    names = [
        [reader.draw(n).name for n in range(k)]
        for reader, k in zip(readers, (mine, total - mine), strict=True)
    ]
    assert len({*names[0], *names[1]}) == total


def test_uses_count_after_a_kill_of_the_reader(tmp_path, tiny_scenes):
    config = _config()
    Filler(tmp_path, config).fill()
    killed = PairStream(tmp_path, config, seed=1)
    before = [killed.draw(number).name for number in range(9)]
    with (tmp_path / 'uses-0.csv').open('a', encoding='utf-8') as log:
        log.write('9,000000')  # a kill in the middle of a line
    after = _drain(PairStream(tmp_path, config, seed=1))
    assert set(Counter(before + after).values()) == {2}
    assert len(list(uses_in(tmp_path))) == len(before + after)


def test_the_order_follows_the_seed(tmp_path, tiny_scenes):
    orders = []
    for name, seed in (('a', 1), ('b', 1), ('c', 2)):
        config = _config()
        Filler(tmp_path / name, config).fill()
        orders.append(_drain(PairStream(tmp_path / name, config, seed=seed)))
    assert orders[0] == orders[1] != orders[2]


def test_the_disk_is_bounded(tmp_path, tiny_scenes, monkeypatch):
    config = _config(first_seed=LAST - 39, buffer_mb=0.2, window=4)
    reader = PairStream(tmp_path, config, seed=1)
    numbers, sizes = itertools.count(), []

    def use_one(_):
        sizes.append(_size(tmp_path))
        reader.draw(next(numbers))

    monkeypatch.setattr('hybridreg_ros.training.generator.time.sleep', use_one)
    Filler(tmp_path, config).fill()
    largest = max(len(encode_pair(p.pair)) for p in _pairs_of('room-train', LAST)) * 2 + 1000
    assert len(sizes) > 20
    assert min(sizes) > 200_000
    assert max(sizes) <= 200_000 + largest


def test_a_killed_generator_goes_on_with_new_seeds(tmp_path, tiny_scenes, monkeypatch):
    config = _config()
    made = iter(range(4))

    def killed(kind, seed, **_):
        if next(made) == 3:
            raise KeyboardInterrupt
        tiny_scenes.append((kind, seed))
        return _pairs_of(kind, seed)

    with monkeypatch.context() as patch:
        patch.setattr(splits_work, 'make_samples', killed)
        with pytest.raises(KeyboardInterrupt):
            Filler(tmp_path, config).fill()
    Filler(tmp_path, config).fill()
    seeds = [seed for _, seed in tiny_scenes]
    lost = LAST - 9 + 3
    assert seeds == [s for s in range(LAST - 9, LAST + 1) if s != lost]
    shards = [Shard.of(path.stem) for path in sorted(tmp_path.glob('*.hrs'))]
    assert all(a.number < b.number for a, b in pairwise(shards))


def test_a_killed_process_is_started_again_with_new_seeds(tmp_path):
    config = StreamConfig(kinds=('room-train',), buffer_mb=1000.0)
    beside = Generator(tmp_path, config)
    try:
        first = _wait(lambda: list(tmp_path.glob('*.hrs')) and _pid(tmp_path))
        taken = _seeds(tmp_path)
        os.kill(first, signal.SIGKILL)
        _wait(lambda: _pid(tmp_path) != first and _seeds(tmp_path) > taken + 1)
    finally:
        beside.stop()
    shards = [Shard.of(path.stem) for path in tmp_path.glob('*.hrs')]
    assert len({s.seed for s in shards}) == len(shards)
    assert not any(s.seed >= _seeds(tmp_path) for s in shards)


def _pid(folder):
    return int((folder / 'generator.pid').read_text(encoding='utf-8'))


def _seeds(folder):
    made = json.loads((folder / 'made.json').read_text(encoding='utf-8'))
    return made['seeds']['room-train']


def _wait(found, limit_s=60.0):
    until = time.monotonic() + limit_s
    while time.monotonic() < until:
        if value := found():
            return value
        time.sleep(0.05)
    raise AssertionError('nothing came')


@pytest.mark.parametrize('shares', [(), (1.0, 3.0)])
def test_kinds_come_in_the_asked_shares(tmp_path, tiny_scenes, monkeypatch, shares):
    config = _config(
        kinds=('room-train', 'street-train'), shares=shares, first_seed=LAST - 99, buffer_mb=0.9
    )

    def stop(_):
        raise KeyboardInterrupt

    monkeypatch.setattr('hybridreg_ros.training.generator.time.sleep', stop)
    with pytest.raises(KeyboardInterrupt):
        Filler(tmp_path, config).fill()
    pairs = json.loads((tmp_path / 'made.json').read_text(encoding='utf-8'))['pairs']
    wanted = (shares or (1.0, 1.0))[1] / (shares or (1.0, 1.0))[0]
    assert sum(pairs.values()) > 15
    assert abs(pairs['street-train'] - wanted * pairs['room-train']) <= 2 * max(wanted, 1.0)


def test_wrong_settings_are_reported(tmp_path):
    with pytest.raises(ConfigError, match='expected 1 numbers, one per kind'):
        Filler(tmp_path, _config(shares=(1.0, 2.0)))
    with pytest.raises(ConfigError, match='split: expected'):
        Filler(tmp_path, _config(kinds=('cellar-train',)))


def test_budgets_are_drawn_within_bounds():
    rng = np.random.default_rng(0)
    config = BudgetConfig(fewest_points=2000, most_points=8000, max_superpoints=256)
    drawn = [budget for _ in range(2000) if (budget := config.drawn(rng))]
    assert len(drawn) == 2000
    points = np.array([budget.max_points for budget in drawn])
    assert points.min() >= 2000
    assert points.max() <= 8000
    assert abs(np.median(points) - 4000) < 200  # log-uniform
    assert {budget.max_superpoints for budget in drawn} == {256}
    assert config.validating() == Budget(5000, 256)
    assert BudgetConfig().drawn(rng) is None
    with pytest.raises(ConfigError, match='at most most_points = 8000'):
        BudgetConfig(fewest_points=9000)


def test_samples_keep_the_budget_and_go_on_after_a_kill(tmp_path, tiny_scenes, tiny_run):
    config = tiny_run(
        stream=_config(),
        budget=BudgetConfig(fewest_points=200, most_points=400),
    )
    folder = tmp_path / 'run' / 'stream'
    Filler(folder, config.stream).fill()
    first = list(itertools.islice(SampleStream(config, TINY), 5))
    later = list(itertools.islice(SampleStream(config, TINY, start=5), 3))
    for sample in (*first, *later):
        for pyramid in (sample.source, sample.target):
            assert len(pyramid.levels[0].points) <= 400
    uses = list(uses_in(folder))
    assert [use.number for use in uses] == list(range(8))
    assert max(Counter((use.stem, use.row) for use in uses).values()) <= 2

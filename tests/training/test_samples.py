# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import dataclasses
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from conftest_training import TINY, make_pair

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import ConfigError, FileFormatError
from hybridreg_ros.data.hybridmatch.shards import encode_pair, write_shard
from hybridreg_ros.training import sources
from hybridreg_ros.training.config import LossConfig
from hybridreg_ros.training.samples import (
    SampleStream,
    as_tensors,
    loader,
    patches_of,
    prepare,
    to_device,
)
from hybridreg_ros.training.sources import ShardSource, held_out_pairs


def test_prepared_labels_agree_with_the_true_transform():
    pair = make_pair(0)
    sample = prepare(pair, TINY, LossConfig(), np.random.default_rng(0))
    overlap = np.asarray(sample.labels.overlap)
    assert overlap.shape == (len(sample.source.superpoints), len(sample.target.superpoints))
    moved = se3.apply(pair.T_target_source, sample.source.metric(sample.source.superpoints))
    target = sample.target.metric(sample.target.superpoints)
    i, j = np.nonzero(overlap > 0.5)
    assert len(i) > 10
    assert np.linalg.norm(moved[i] - target[j], axis=1).max() < 0.8  # one superpoint voxel
    far = np.linalg.norm(moved[:, None] - target[None], axis=2) > 2.5
    assert (overlap[far] == 0).all()
    assert sample.labels.fine.shape[1:] == (17, 17)
    tensors: list[Any] = list(vars(as_tensors(sample).labels).values())
    assert all(isinstance(a, torch.Tensor) for a in tensors)


def test_moving_points_are_no_matches():
    pair = make_pair(1)
    still = dataclasses.replace(pair, source_label=np.zeros_like(pair.source_label))
    sample = prepare(still, TINY, LossConfig(), np.random.default_rng(0))
    patches = patches_of(sample.source, pair.source_label)
    moving = pair.source[pair.source_label > 0]
    lost = sample.source.metric(patches.points[~patches.static])
    assert len(lost) > 3
    nearest = np.linalg.norm(lost[:, None] - moving[None], axis=2).min(axis=1)
    assert nearest.max() < 0.25
    assert patches_of(sample.source, np.zeros(len(pair.source), np.uint8)).static.all()


def test_sample_numbers_decide_the_samples(tiny_run):
    config = tiny_run()
    streams = [iter(SampleStream(config, TINY, start=s)) for s in (0, 2)]
    first = [next(streams[0]) for _ in range(4)]
    later = [next(streams[1]) for _ in range(2)]
    for a, b in zip(first[2:], later, strict=True):
        assert np.array_equal(a.labels.overlap, b.labels.overlap)
        np.testing.assert_array_equal(a.source.superpoints, b.source.superpoints)
    assert not np.array_equal(first[0].source.superpoints, first[2].source.superpoints)
    assert len(first[0].pair.source) == 0


def test_ranks_share_out_the_numbers(tiny_run):
    config = tiny_run()
    whole = iter(SampleStream(config, TINY))
    together = [next(whole) for _ in range(4)]
    ranks = [iter(SampleStream(config, TINY, rank=r, world=2)) for r in range(2)]
    apart = [next(ranks[i % 2]) for i in range(4)]
    for a, b in zip(together, apart, strict=True):
        assert np.array_equal(a.labels.overlap, b.labels.overlap)


def test_a_worker_process_gives_the_same_samples(tiny_run):
    config = tiny_run()
    stream = SampleStream(config, TINY)
    alone, prefetched = loader(stream, 0), loader(stream, 2)
    for _ in range(3):
        a, b = next(alone), next(prefetched)
        assert np.array_equal(a.labels.overlap, b.labels.overlap)


def test_an_unusable_pair_is_replaced(tiny_run, tmp_path):
    broken = dataclasses.replace(
        make_pair(0),
        source=np.ones((2, 3), np.float32),
        source_label=np.zeros(2, np.uint8),
        source_instance=np.zeros(2, np.uint16),
        name='broken',
    )
    write_shard(tmp_path / '0.hrs', [encode_pair(p) for p in (broken, make_pair(1))])
    stream = iter(SampleStream(tiny_run(data=(str(tmp_path),)), TINY))
    assert {next(stream).pair.name for _ in range(8)} == {'boxes-1'}


def test_curriculum_starts_with_much_overlap(tiny_run, tmp_path):
    pairs = [dataclasses.replace(make_pair(s), overlap=o) for s, o in ((0, 0.1), (1, 0.9))]
    write_shard(tmp_path / '0.hrs', [encode_pair(p) for p in pairs])
    config = tiny_run(data=(str(tmp_path),), curriculum_pairs=1000)
    early, late = (iter(SampleStream(config, TINY, start=s)) for s in (0, 5000))
    assert {next(early).pair.overlap for _ in range(8)} == {0.9}
    assert {next(late).pair.overlap for _ in range(12)} == {0.1, 0.9}


def test_low_overlap_is_drawn_more_often_when_asked(tiny_run, tmp_path):
    pairs = [dataclasses.replace(make_pair(s), overlap=o) for s, o in ((0, 0.1), (1, 0.9))]
    write_shard(tmp_path / '0.hrs', [encode_pair(p) for p in pairs])
    low = {}
    for share in (0.0, 1.0):
        config = tiny_run(data=(str(tmp_path),), curriculum_pairs=1, low_overlap_share=share)
        stream = iter(SampleStream(config, TINY, start=10))
        low[share] = sum(next(stream).pair.overlap == 0.1 for _ in range(40))
    assert 10 <= low[0.0] <= 29  # expected 20
    assert 24 <= low[1.0] <= 38  # expected 30
    assert low[1.0] > low[0.0]


def test_prefetching_ends_when_the_trainer_is_killed(shards):
    code = f"""
import dataclasses, multiprocessing, sys, time
from hybridreg_ros.model.config import ModelConfig
from hybridreg_ros.training.config import TrainConfig
from hybridreg_ros.training.samples import SampleStream, loader
config = TrainConfig(data=({str(shards / 'train')!r},))
samples = loader(SampleStream(config, ModelConfig()), 1)
next(samples)
print(multiprocessing.active_children()[0].pid, flush=True)
time.sleep(60)
"""
    trainer = subprocess.Popen([sys.executable, '-c', code], stdout=subprocess.PIPE, text=True)
    assert trainer.stdout is not None
    worker = int(trainer.stdout.readline())
    assert alive(worker)
    trainer.kill()
    trainer.wait()
    end = time.monotonic() + 30.0
    while alive(worker) and time.monotonic() < end:
        time.sleep(0.1)
    assert not alive(worker)


def alive(pid):
    """Whether a process runs (one that ended and waits to be collected does not)."""
    try:
        return Path(f'/proc/{pid}/stat').read_text().rsplit(')', 1)[1].split()[0] != 'Z'
    except FileNotFoundError:
        return False


def test_voxel_factor_makes_coarser_pyramids():
    pair = make_pair(0)
    coarse = dataclasses.replace(TINY, voxel_factor=1.5)
    fine, thick = (
        prepare(pair, c, LossConfig(), np.random.default_rng(0)) for c in (TINY, coarse)
    )
    assert fine.source.voxel_size_m == pytest.approx(0.1)
    assert thick.source.voxel_size_m == pytest.approx(0.15)
    assert len(thick.source.fine_points) < len(fine.source.fine_points)


def test_new_shards_are_found(tmp_path, monkeypatch):
    write_shard(tmp_path / '0.hrs', [encode_pair(make_pair(0))])
    source = ShardSource((str(tmp_path),))
    write_shard(tmp_path / '1.hrs', [encode_pair(make_pair(1))])
    rng = np.random.default_rng(0)
    assert {source.draw(rng).name for _ in range(10)} == {'boxes-0'}
    monkeypatch.setattr(sources, 'RESCAN_S', -1.0)
    assert {source.draw(rng).name for _ in range(10)} == {'boxes-0', 'boxes-1'}


def test_shares_and_empty_folders(shards, tmp_path):
    empty = str(tmp_path)
    rng = np.random.default_rng(0)
    source = ShardSource((str(shards / 'train'), str(shards / 'val'), empty), (0.2, 0.8, 1.0))
    names = [source.draw(rng).name for _ in range(60)]
    held_out = sum(n in ('boxes-10', 'boxes-11') for n in names)
    assert 38 <= held_out <= 58
    with pytest.raises(ConfigError, match='expected 1 numbers'):
        ShardSource((empty,), (0.5, 0.5))
    with pytest.raises(FileFormatError, match='no pairs in'):
        ShardSource((empty,))
    with pytest.raises(FileFormatError, match='no split at'):
        ShardSource((empty + '/nothing',))
    with pytest.raises(FileFormatError, match='no pairs in'):
        held_out_pairs((empty,), 3)


def test_held_out_pairs_are_spread_over_folders(shards):
    folders = (str(shards / 'train'), str(shards / 'val'))
    names = [p.name for p in held_out_pairs(folders, 4)]
    assert names == ['boxes-0', 'boxes-3', 'boxes-10', 'boxes-11']
    assert len(held_out_pairs(folders, 100)) == 6


def test_to_device_reaches_every_tensor():
    sample = prepare(make_pair(0), TINY, LossConfig(), np.random.default_rng(0))
    sample = as_tensors(sample)
    moved = to_device(sample, 'meta')
    assert moved.labels.overlap.device.type == 'meta'
    assert moved.source.levels[0].conv.weights.device.type == 'meta'
    assert to_device(sample, 'cpu') is sample

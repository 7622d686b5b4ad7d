# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Tiny pairs, shards and networks for the training tests (imported by conftest.py)."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from hybridreg_ros.core import se3
from hybridreg_ros.data.hybridmatch.shards import encode_pair, write_shard
from hybridreg_ros.data.pair import Label, PointPair
from hybridreg_ros.model.checkpoint import save_network
from hybridreg_ros.model.config import ModelConfig
from hybridreg_ros.model.reference.network import HybridRegNet
from hybridreg_ros.training.config import AugmentConfig, LossConfig, TrainConfig

TINY = ModelConfig(
    stem=8,
    widths=(8, 16, 16, 32),
    groups=4,
    fine_dim=16,
    dim=32,
    blocks=1,
    heads=2,
    patch_size=16,
    top_pairs=16,
    sinkhorn_iterations=5,
)


def boxes(rng, count=6, points=900):
    """Points on the faces of a few random boxes, metres."""
    parts = []
    for _ in range(count):
        size, place = rng.uniform(0.2, 1.2, 3), rng.uniform(-1.2, 1.2, 3)
        face = rng.uniform(-0.5, 0.5, (points // count, 3))
        axis = rng.integers(0, 3, len(face))
        face[np.arange(len(face)), axis] = np.sign(face[np.arange(len(face)), axis]) * 0.5
        parts.append(face * size + place + [0.0, 0.0, 3.0])
    return np.concatenate(parts)


def make_pair(seed, moving=150):
    rng = np.random.default_rng(seed)
    world = boxes(rng)
    T = se3.exp(np.concatenate([rng.normal(0, 0.2, 3), rng.normal(0, 0.1, 3)]))
    source = np.concatenate([world, rng.uniform(-0.3, 0.3, (moving, 3)) + np.array([0.5, 0, 2])])
    target = np.concatenate([world, rng.uniform(-0.3, 0.3, (moving, 3)) + np.array([-0.5, 0, 2])])
    label = np.zeros(len(source), np.uint8)
    label[len(world) :] = Label.DEFORMING
    return PointPair(
        source=source.astype(np.float32),
        target=se3.apply(T, target).astype(np.float32),
        T_target_source=T,
        source_label=label,
        target_label=label,
        source_instance=(label > 0).astype(np.uint16),
        target_instance=(label > 0).astype(np.uint16),
        overlap=1.0,
        dynamic_share=moving / len(source),
        voxel_size_m=0.1,
        name=f'boxes-{seed}',
        seed=seed,
    )


@pytest.fixture(autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope='session')
def tiny_weights(tmp_path_factory):
    """A file with an untrained tiny network."""
    path = tmp_path_factory.mktemp('weights') / 'tiny.safetensors'
    torch.manual_seed(0)
    save_network(path, HybridRegNet(TINY), {})
    return path


@pytest.fixture(scope='session')
def shards(tmp_path_factory):
    """A folder with four tiny training pairs and one with two validation pairs."""
    folder = tmp_path_factory.mktemp('shards')
    for name, seeds in (('train', range(4)), ('val', range(10, 12))):
        (folder / name).mkdir()
        write_shard(folder / name / '0.hrs', [encode_pair(make_pair(s)) for s in seeds])
    return folder


@pytest.fixture
def tiny_run(shards, tiny_weights, tmp_path):
    """Function that gives a config of a tiny run in a folder of tmp_path, with changes."""

    def build(name='run', **changes):
        config = TrainConfig(
            data=(str(shards / 'train'),),
            validation=(str(shards / 'val'),),
            out=str(tmp_path / name),
            start_weights=str(tiny_weights),
            steps=5,
            validate_every=5,
            validation_pairs=2,
            log_every=2,
            workers=0,
            checkpoint_minutes=60.0,
            augment=AugmentConfig(any_rotation_share=0.0, large_share=0.0),
            loss=LossConfig(max_patch_pairs=8, max_anchors=16, descriptor_weight=0.5),
        )
        return dataclasses.replace(config, **changes)

    return build

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Settings of a training run; `config/train.yaml` is dumped from these classes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hybridreg_ros.core.config import option, validate
from hybridreg_ros.core.errors import ConfigError
from hybridreg_ros.model.budget import Budget


@dataclass(frozen=True)
class AugmentConfig:
    """What is done to a pair before the network sees it."""

    any_rotation_share: float = option(
        0.5,
        'share of pairs whose two clouds are turned by the same arbitrary rotation',
        low=0.0,
        high=1.0,
    )
    yaw_share: float = option(
        0.0,
        'share of the others that are turned about the vertical (z) by any angle',
        low=0.0,
        high=1.0,
    )
    tilt_share: float = option(
        0.0,
        'share of the others that are tilted about a random horizontal axis',
        low=0.0,
        high=1.0,
    )
    tilt_deg: float = option(25.0, 'maximum tilt, degrees', low=0.0, high=180.0)
    common_rotation_rad: float = option(
        0.2,
        'rotation of both clouds of the remaining pairs, standard deviation per axis, rad',
        low=0.0,
    )
    relative_rotation_rad: float = option(
        0.2,
        'additional rotation of one cloud, standard deviation per axis, rad',
        low=0.0,
        high=3.2,
    )
    large_share: float = option(
        0.15, 'share of pairs that get a large relative rotation instead', low=0.0, high=1.0
    )
    large_rotation_deg: float = option(
        60.0, 'maximum large rotation, degrees, about a random axis', low=0.0, high=180.0
    )
    scale_jitter: float = option(
        0.1, 'maximum change of scale of both clouds alike, as a share, uniform', low=0.0, high=0.5
    )
    noise_voxels: float = option(
        0.15, 'maximum standard deviation of the point noise, finest voxels', low=0.0, high=1.0
    )
    depth_noise: float = option(
        0.004,
        'maximum standard deviation of the noise along the ray, as a share of the range',
        low=0.0,
        high=0.1,
    )
    thin_share: float = option(
        0.3, 'share of clouds from which random points are removed', low=0.0, high=1.0
    )
    thin_keep: float = option(0.3, 'minimum share of points that this leaves', low=0.05, high=1.0)
    crop_share: float = option(
        0.2, 'share of clouds that lose everything beyond a random plane', low=0.0, high=1.0
    )
    crop_keep: float = option(0.7, 'minimum share of points that this leaves', low=0.1, high=1.0)
    hole_share: float = option(
        0.2, 'share of clouds with one occluded cone of view', low=0.0, high=1.0
    )
    hole_angle_deg: float = option(
        15.0, 'maximum half opening angle of that cone, degrees', low=0.0, high=60.0
    )

    def __post_init__(self) -> None:
        """Check ranges.

        Raises:
            ConfigError: a value is out of its range.
        """
        validate(self)


@dataclass(frozen=True)
class LossConfig:
    """Which loss terms count, and how much."""

    coarse: str = option(
        'cross_entropy',
        'superpoint loss',
        choices=('cross_entropy', 'circle', 'both'),
    )
    coarse_weight: float = option(0.5, 'weight of the superpoint cross-entropy', low=0.0)
    circle_weight: float = option(1.0, 'weight of the superpoint circle loss', low=0.0)
    temperature: float = option(
        0.07, 'temperature of the superpoint cross-entropy', low=0.005, high=1.0
    )
    fine_weight: float = option(1.0, 'weight of the point matching loss', low=0.0)
    descriptor_weight: float = option(
        0.5, 'weight of the InfoNCE loss of fine points over the whole cloud', low=0.0
    )
    false_match_weight: float = option(
        0.0, 'weight of the loss on fine points that are confident of a wrong match', low=0.0
    )
    mask: str = option(
        'bce',
        "mask loss: balanced BCE, L1, Laplace NLL per pair, or the paper's log-sum-exp form",
        choices=('none', 'bce', 'l1', 'nll', 'log_sum_exp'),
    )
    mask_weight: float = option(0.5, 'weight of the mask loss', low=0.0)
    mask_stop_gradient: bool = option(
        True, 'keep the Laplace forms from shaping the features (only the mask head learns)'
    )
    positive_overlap: float = option(
        0.1, 'overlap above which two superpoints are a positive pair', low=0.0, high=1.0
    )
    match_radius_voxels: float = option(
        1.5, 'fine points closer than this are matches, finest voxels', low=0.1, high=10.0
    )
    masked_correlation: bool = option(
        False,
        "superpoint cross-entropy on the correlation as weighted by the mask (paper's step h)",
    )
    max_patch_pairs: int = option(
        64,
        'maximum number of patch pairs in the point matching loss, per pair of clouds',
        low=1,
        high=1024,
    )
    max_anchors: int = option(
        256, 'maximum number of anchors in the InfoNCE loss, per pair of clouds', low=1, high=4096
    )

    def __post_init__(self) -> None:
        """Check ranges.

        Raises:
            ConfigError: a value is out of its range.
        """
        validate(self)


@dataclass(frozen=True)
class StreamConfig:
    """Pairs that are generated while the run goes on, each with its own seed."""

    kinds: tuple[str, ...] = option(
        (),
        'kinds of pairs generated beside the trainer, such as room-train; empty = read `data` '
        'instead',
    )
    shares: tuple[float, ...] = option((), 'share of pairs of each kind; empty = equal', low=0.0)
    first_seed: int = option(2_000_000, 'first scene seed', low=0, high=2_999_999)
    uses: int = option(2, 'number of times that a pair may be used', low=1, high=16)
    window: int = option(
        64, 'number of scenes from which pairs are drawn at a time, oldest first', low=1
    )
    buffer_mb: float = option(
        256.0, 'maximum size of the pairs waiting on disk; the generator pauses there', low=0.1
    )
    workers: int = option(1, 'number of generating processes', low=1, high=64)

    def __post_init__(self) -> None:
        """Check ranges.

        Raises:
            ConfigError: a value is out of its range.
        """
        validate(self)


@dataclass(frozen=True)
class BudgetConfig:
    """Size of the clouds in training: the voxel of a pair follows a budget of points."""

    fewest_points: int = option(
        0, 'smallest budget drawn for a pair (log-uniform); 0 = fixed voxel, thinned', low=0
    )
    most_points: int = option(8000, 'largest budget drawn', low=100)
    max_superpoints: int = option(
        256, 'maximum number of superpoints per cloud, at any budget', low=8
    )
    validation_points: int = option(5000, 'budget of the validation pairs', low=100)

    def __post_init__(self) -> None:
        """Check ranges.

        Raises:
            ConfigError: a value is out of its range.
        """
        validate(self)
        if self.fewest_points > self.most_points:
            raise ConfigError(
                f'fewest_points: expected at most most_points = {self.most_points}, found '
                f'{self.fewest_points}'
            )

    def drawn(self, rng: np.random.Generator) -> Budget | None:
        """A random budget, log-uniform; None when the voxel follows none."""
        if not self.fewest_points:
            return None
        low, high = np.log([self.fewest_points, self.most_points])
        return Budget(round(float(np.exp(rng.uniform(low, high)))), self.max_superpoints)

    def validating(self) -> Budget | None:
        """That of the validation pairs; None when the voxel follows none."""
        if not self.fewest_points:
            return None
        return Budget(self.validation_points, self.max_superpoints)


@dataclass(frozen=True)
class TrainConfig:
    """A training run."""

    profile: str = option('compact', 'network profile', choices=('compact', 'paper'))
    data: tuple[str, ...] = option(
        ('data/train',), 'folders of training shards; new shards are picked up while running'
    )
    shares: tuple[float, ...] = option(
        (), 'share of samples drawn from each folder; empty = in proportion to the pairs', low=0.0
    )
    validation: tuple[str, ...] = option(('data/val',), 'folders of validation shards')
    out: str = option('runs/compact', 'folder of the run: checkpoints, log.csv, validation.csv')
    start_weights: str = option('', 'weights to start from, with a fresh optimiser; empty = none')
    steps: int = option(40_000, 'number of optimiser steps', low=1)
    max_hours: float = option(
        0.0, 'wall-clock limit; the schedule ends with whichever comes first; 0 = none', low=0.0
    )
    seed: int = option(0, 'seed of weights, samples and augmentation', low=0, high=8_999_999)
    lr: float = option(4e-4, 'maximum learning rate of AdamW', low=0.0, high=1.0)
    weight_decay: float = option(1e-4, 'decoupled weight decay', low=0.0, high=1.0)
    warmup: float = option(
        0.03, 'share of the run during which the learning rate rises', low=0.0, high=0.9
    )
    final_lr: float = option(
        0.01, 'share of the learning rate that is left at the end', low=0.0, high=1.0
    )
    clip: float = option(1.0, 'maximum gradient norm', low=0.0)
    accumulate: int = option(1, 'number of pairs per optimiser step and process', low=1, high=1024)
    ema: float = option(
        0.999,
        'decay of the averaged weights that are validated and kept; 0 = off',
        low=0.0,
        high=0.99999,
    )
    curriculum_pairs: int = option(
        2000, 'number of pairs over which the minimum overlap drawn falls from 0.4 to 0', low=0
    )
    low_overlap_share: float = option(
        0.0, 'share of draws that keep the less overlapping of two pairs', low=0.0, high=1.0
    )
    max_points: int = option(
        4000,
        'maximum number of finest-level points per cloud in training; more are thinned',
        low=500,
    )
    workers: int = option(1, 'number of prefetching processes per trainer', low=0, high=64)
    device: str = option('cpu', 'torch device of the trainer')
    precision: str = option(
        'float32',
        'of the matrix products of the encoder; bf16 is for GPUs',
        choices=('float32', 'bf16'),
    )
    validate_every: int = option(600, 'number of steps between validations', low=1)
    validation_pairs: int = option(72, 'number of validation pairs used', low=1)
    checkpoint_minutes: float = option(3.0, 'time between checkpoints', low=0.0)
    log_every: int = option(20, 'number of steps averaged per line of log.csv', low=1)
    stream: StreamConfig = option(StreamConfig, 'pairs generated during the run')
    budget: BudgetConfig = option(BudgetConfig, 'voxel chosen by a budget of points')
    loss: LossConfig = option(LossConfig, 'loss terms')
    augment: AugmentConfig = option(AugmentConfig, 'augmentation')

    def __post_init__(self) -> None:
        """Check ranges.

        Raises:
            ConfigError: a value is out of its range.
        """
        validate(self)

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Samples: pairs from growing shard folders, augmented, with pyramids and labels.

Everything here runs in a data worker, so that a training step only does what learning needs.
Sample number i of a run depends on the seed, i and the shards present, on nothing else.
"""

from __future__ import annotations

import dataclasses
import itertools
import logging
import os
import signal
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch.utils.data import DataLoader, IterableDataset, get_worker_info

from hybridreg_ros.core.errors import RegistrationError
from hybridreg_ros.core.nested import mapped
from hybridreg_ros.data.pair import Label
from hybridreg_ros.model.geometry.pyramid import Pyramid, build_pyramid, voxel_transform
from hybridreg_ros.training.augment import augment
from hybridreg_ros.training.labels import PairLabels, Patches, pair_labels
from hybridreg_ros.training.sources import ShardSource
from hybridreg_ros.training.stream import PairStream

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from hybridreg_ros.data.pair import PointPair
    from hybridreg_ros.model.budget import Budget
    from hybridreg_ros.model.config import ModelConfig
    from hybridreg_ros.training.config import LossConfig, TrainConfig

CURRICULUM_OVERLAP = 0.4
CURRICULUM_TRIES = 20
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Sample:
    """One pair, ready for a step.

    Attributes:
        pair: the (augmented) pair; point arrays are empty when only learning needs it.
        source: pyramid of the source.
        target: pyramid of the target.
        labels: what is right.
    """

    pair: PointPair
    source: Pyramid
    target: Pyramid
    labels: PairLabels


def prepare(
    pair: PointPair,
    model: ModelConfig,
    loss: LossConfig,
    rng: np.random.Generator,
    budget: Budget | None = None,
) -> Sample:
    """Pyramids and labels of a pair.

    Args:
        pair: metres.
        model: sizes of the network.
        loss: radii and limits of the labels.
        rng: draws patch pairs and anchors.
        budget: the voxel follows it; None keeps that of the network.

    Raises:
        RegistrationError: a cloud has too few points.
    """
    voxel_m = model.voxel_factor * pair.voxel_size_m
    if budget is not None:
        voxel_m = budget.voxel_m(pair.source, pair.target, smallest_m=voxel_m)
    source = build_pyramid(pair.source, voxel_m, model)
    target = build_pyramid(pair.target, voxel_m, model)
    labels = pair_labels(
        patches_of(source, pair.source_label),
        patches_of(target, pair.target_label),
        voxel_transform(pair.T_target_source, source, target),
        radius=loss.match_radius_voxels,
        rng=rng,
        positive=loss.positive_overlap,
        max_pairs=loss.max_patch_pairs,
        max_anchors=loss.max_anchors if loss.descriptor_weight > 0.0 else 0,
    )
    return Sample(pair, source, target, labels)


def patches_of(pyramid: Pyramid, label: NDArray[np.uint8]) -> Patches:
    """Fine points, their static flags and the patches of a cloud; label: (N,) per input point."""
    cell = pyramid.input_to_level0.astype(np.int64)
    share = _cell_mean(cell, label == Label.STATIC, len(pyramid.levels[0].points))
    for level, above in itertools.pairwise(pyramid.levels[: pyramid.fine_level + 1]):
        assert level.up_index is not None
        share = _cell_mean(level.up_index, share, len(above.points))
    return Patches(pyramid.fine_points, share > 0.5, pyramid.patch_index)


def _cell_mean(cell: NDArray[np.int64], value: NDArray[Any], size: int) -> NDArray[np.float64]:
    """Mean (size,) of the values (N,) that fall into each cell; 0 for empty cells, -1 is none."""
    used = cell >= 0
    count = np.bincount(cell[used], minlength=size)
    total = np.bincount(cell[used], weights=value[used].astype(np.float64), minlength=size)
    return total / np.maximum(count, 1)


def as_tensors(sample: Sample) -> Sample:
    """A sample with tensors in place of what network and losses read.

    They change processes without a copy.
    """

    def tensor(leaf: Any) -> Any:
        return torch.from_numpy(leaf) if isinstance(leaf, np.ndarray) else leaf

    def read(pyramid: Pyramid) -> Pyramid:
        names = ('levels', 'patch_index', 'patch_mask', 'geometry')
        values: dict[str, Any] = {name: mapped(getattr(pyramid, name), tensor) for name in names}
        return dataclasses.replace(pyramid, **values)

    sides = read(sample.source), read(sample.target)
    return Sample(sample.pair, *sides, mapped(sample.labels, tensor))


def to_device(value: Any, device: str) -> Any:
    """The same nested dataclasses and tuples with every tensor on a device."""
    if device == 'cpu':
        return value

    def moved(leaf: Any) -> Any:
        return leaf.to(device, non_blocking=True) if isinstance(leaf, torch.Tensor) else leaf

    return mapped(value, moved)


class SampleStream(IterableDataset[Sample]):
    """Endless training samples of one process of a run."""

    def __init__(
        self,
        config: TrainConfig,
        model: ModelConfig,
        *,
        start: int = 0,
        rank: int = 0,
        world: int = 1,
    ) -> None:
        self._config = config
        thinned = not config.budget.fewest_points
        self._model = (
            dataclasses.replace(model, max_points=config.max_points) if thinned else model
        )
        self._start, self._rank, self._world = start, rank, world

    def __iter__(self) -> Iterator[Sample]:
        """Samples `start`, `start + 1`, ... of this process (every n-th in worker n)."""
        torch.set_num_threads(1)
        info = get_worker_info()
        first, stride = (0, 1) if info is None else (info.id, info.num_workers)
        source = self._source(first, stride)
        for index in itertools.count(self._start + first, stride):
            yield self.sample(source, index * self._world + self._rank)

    def _source(self, worker: int, workers: int) -> ShardSource | PairStream:
        config = self._config
        if not config.stream.kinds:
            return ShardSource(config.data, config.shares)
        return PairStream(
            Path(config.out) / 'stream',
            config.stream,
            config.seed,
            reader=self._rank * workers + worker,
            readers=self._world * workers,
        )

    def sample(self, source: ShardSource | PairStream, number: int) -> Sample:
        """Sample of a number; a pair that cannot be used is replaced by the next draw."""
        rng = np.random.default_rng([self._config.seed, number])
        while True:
            if isinstance(source, PairStream):
                pair, rng = source.draw(number), np.random.default_rng([self._config.seed, number])
            else:
                pair = self._draw(source, number, rng)
            try:
                return self.sample_of(pair, rng)
            except RegistrationError as error:
                _LOG.warning('pair %s left out: %s', pair.name, error)

    def sample_of(self, pair: PointPair, rng: np.random.Generator) -> Sample:
        """A sample of a pair, which decides it together with `rng`.

        Raises:
            RegistrationError: a cloud has too few points.
        """
        pair = augment(pair, self._config.augment, rng)
        budget = self._config.budget.drawn(rng)
        made = prepare(pair, self._model, self._config.loss, rng, budget)
        return as_tensors(dataclasses.replace(made, pair=_without_points(pair)))

    def _draw(self, source: ShardSource, number: int, rng: np.random.Generator) -> PointPair:
        """A random pair; early in a run those with much overlap only (as far as there are any).

        In a share of the draws it is the one of two that overlaps less.
        """
        late = number / max(self._config.curriculum_pairs, 1)
        smallest = CURRICULUM_OVERLAP * max(0.0, 1.0 - late)
        for _ in range(CURRICULUM_TRIES):
            pair = source.draw(rng)
            if self._config.low_overlap_share > rng.random():
                pair = min(pair, source.draw(rng), key=lambda p: p.overlap)
            if pair.overlap >= smallest:
                break
        return pair


def _without_points(pair: PointPair) -> PointPair:
    return dataclasses.replace(
        pair,
        source=pair.source[:0],
        target=pair.target[:0],
        source_label=pair.source_label[:0],
        target_label=pair.target_label[:0],
        source_instance=pair.source_instance[:0],
        target_instance=pair.target_instance[:0],
    )


def _alone(sample: Any) -> Any:
    return sample


def _end_with_parent(worker: int) -> None:
    """Let a prefetching process end when its trainer is killed: its full queue would hold it."""
    parent = os.getppid()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os.kill(os.getpid(), signal.SIGKILL)

    threading.Thread(target=watch, name=f'watch {worker}', daemon=True).start()


def loader(stream: SampleStream, workers: int) -> Iterator[Sample]:
    """Samples of a stream, in order, prefetched by worker processes (0 = in this process)."""
    return iter(
        DataLoader(
            stream,
            batch_size=None,
            collate_fn=_alone,
            num_workers=workers,
            worker_init_fn=_end_with_parent,
            prefetch_factor=6 if workers else None,
        )
    )

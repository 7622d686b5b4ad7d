# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""HybridMatch: pairs of clouds of rooms in which things move, made from a seed."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.errors import ConfigError
from hybridreg_ros.data.hybridmatch.cell import Cell
from hybridreg_ros.data.hybridmatch.stage import MIN_DISPLACEMENT_M, make_world
from hybridreg_ros.data.hybridmatch.take import Sample, choose_views, take_sample

if TYPE_CHECKING:
    from hybridreg_ros.data.hybridmatch.stage import World
    from hybridreg_ros.data.pair import PointPair

GENERATOR_VERSION = 5
"""Changes whenever the same seed gives other bytes."""

SCENES, KINDS = ('room', 'street'), ('match', 'lomatch')
MATCH, LOMATCH = (0.3, 0.98), (0.1, 0.3)
LEVELS = {'rigid': (0.0, 1.0), '10-30': (0.1, 0.3), '30-50': (0.3, 0.5)}
CROWD = (0.3, 0.5)
"""Share of points on what could move, in every pair of the twelve splits: in a rigid pair nothing
of it moves, in a 10-30 pair a part, in a 30-50 pair all."""
TRAIN, RECORDED = 'train', 'recorded'
"""Mixtures to train on: the cells of the splits, and pairs as recordings show them."""
PAIRS_A_SCENE = 6
SPLITS = tuple(f'{s}-{k}-{level}' for s in SCENES for k in KINDS for level in LEVELS)


def cell_of(split: str) -> Cell:
    """The cell of a split name such as `room-lomatch-10-30`.

    Raises:
        ConfigError: the name is not one of the twelve splits.
    """
    scene, kind, level = parse_split(split)
    del scene
    overlap = MATCH if kind == 'match' else LOMATCH
    return Cell(overlap, LEVELS[level], CROWD, frozen=level == 'rigid')


def parse_split(split: str) -> tuple[str, str, str]:
    """Scene, match kind and level of a split name.

    Raises:
        ConfigError: the name is not one of the twelve splits.
    """
    scene, _, rest = split.partition('-')
    kind, _, level = rest.partition('-')
    if scene not in SCENES or kind not in KINDS or level not in LEVELS:
        raise ConfigError(
            f'split: expected {{room,street}}-{{match,lomatch}}-{{rigid,10-30,30-50}} '
            f'or {{room,street}}-{{train,recorded}}, found {split!r}'
        )
    return scene, kind, level


def scene_of(split: str) -> str:
    """Scene of a split name, mixtures such as `room-train` and `street-recorded` included.

    Raises:
        ConfigError: the name is neither one of the twelve splits nor a mixture.
    """
    scene, _, rest = split.partition('-')
    known = rest in (TRAIN, RECORDED) and scene in SCENES
    return scene if known else parse_split(split)[0]


TRAIN_CELLS = (
    Cell(MATCH, LEVELS['10-30']),
    Cell(MATCH, LEVELS['30-50']),
    Cell(LOMATCH, LEVELS['10-30']),
    Cell(LOMATCH, LEVELS['30-50']),
    Cell(MATCH, frozen=True, fused=3, fusing=0.4),
    Cell(LOMATCH, frozen=True, fused=3, fusing=0.4),
    Cell((0.2, 0.98), (0.0, 0.6)),
    Cell((0.15, 0.98), (0.0, 0.6)),
)


def make_samples(
    split: str, seed: int, *, count: int = PAIRS_A_SCENE, still: bool = False
) -> list[Sample]:
    """Pairs of one random scene that belong to a split, with what the generator knows of them.

    Args:
        split: one of the twelve split names, or a mixture such as `room-train`.
        seed: any non-negative integer.
        count: most pairs from the scene; the mixtures for training have their own.
        still: take every target without motion, too; pairs as recorded have none.

    Returns:
        The samples; an empty list when the scene cannot give any.

    Raises:
        ConfigError: the split name is unknown.
    """
    scene = scene_of(split)
    if split == f'{scene}-{RECORDED}':
        return _recorded_samples(scene, seed)
    if scene == 'street':
        return _street_samples(split, seed, count, still=still)
    if split == f'room-{TRAIN}':
        return _training_samples(seed, still=still)
    cell = cell_of(split)
    rng = np.random.default_rng([seed, 1])
    world = make_world(rng, crowded=True, wanted=CROWD, cell=cell)
    samples: list[Sample] = []
    if world is None or not (cell.frozen or world.displacement_m > MIN_DISPLACEMENT_M):
        return samples
    for k, views in enumerate(choose_views(rng, world.view, cell, count + 3)):
        sample = _named(f'{split}-{seed:07d}-{k}', seed, k, world, cell, views, still=still)
        samples += [] if sample is None else [sample]
        if len(samples) == count:
            break
    return samples


def _training_samples(seed: int, *, still: bool) -> list[Sample]:
    """All pairs of one random room: one for each of the training cells that it can fill."""
    rng = np.random.default_rng([seed, 1])
    crowded = bool(seed % 2)
    world = make_world(rng, crowded=crowded, wanted=(0.25, 0.55) if crowded else (0.0, 0.35))
    samples: list[Sample] = []
    if world is None:
        return samples
    for k, cell in enumerate(TRAIN_CELLS):
        # Few scenes can fill the 30-50 % cells: those that can give two pairs of each.
        twice = crowded and cell.dynamic == LEVELS['30-50']
        for n, views in enumerate(choose_views(rng, world.view, cell, 1 + twice)):
            number = k + n * len(TRAIN_CELLS)
            name = f'room-{seed:07d}-{number}'
            sample = _named(name, seed, number, world, cell, views, still=still)
            samples += [] if sample is None else [sample]
    return samples


def _recorded_samples(scene: str, seed: int) -> list[Sample]:
    """All pairs of one random walk or drive."""
    from hybridreg_ros.data.hybridmatch.recorded_rooms import recorded_room
    from hybridreg_ros.data.hybridmatch.recorded_streets import recorded_street

    return recorded_room(seed) if scene == 'room' else recorded_street(seed)


def _street_samples(split: str, seed: int, count: int, *, still: bool) -> list[Sample]:
    """Pairs of one random street; a scene of the mixture serves one training cell."""
    from hybridreg_ros.data.hybridmatch.street_pairs import street_cell

    if split == f'street-{TRAIN}':
        return street_cell(seed, TRAIN_CELLS[seed % len(TRAIN_CELLS)], count, still=still)
    return street_cell(seed, cell_of(split), count, still=still, name=split)


def _named(
    name: str,
    seed: int,
    k: int,
    world: World,
    cell: Cell,
    views: tuple[int, int],
    *,
    still: bool,
) -> Sample | None:
    """Take a sample with its own noise, and name its pair."""
    rng = np.random.default_rng([seed, 2, k])
    sample = take_sample(rng, world, cell, views, still=still)
    if sample is None:
        return None
    return replace(sample, pair=replace(sample.pair, name=name, seed=seed))


def make_pairs(split: str, seed: int, count: int = PAIRS_A_SCENE) -> list[PointPair]:
    """The pairs of `make_samples`."""
    return [sample.pair for sample in make_samples(split, seed, count=count)]

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Open roads: country roads and motorways with rails, banks, trees and little else beside them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hybridreg_ros.data.meshes.scene import merge
from hybridreg_ros.data.meshes.shapes import box
from hybridreg_ros.data.streets.built import pole
from hybridreg_ros.data.streets.layout import Builder, Layout, centre_line, on_side
from hybridreg_ros.data.streets.nature import bush, make_terrain, tree

if TYPE_CHECKING:
    import numpy as np

    from hybridreg_ros.data.meshes.scene import Mesh


def road(rng: np.random.Generator, length_m: float) -> Layout:
    """One to three lanes each way, shoulders, rails or walls, banks, trees, houses far off."""
    count, lane = int(rng.choice([1, 2, 3], p=[0.55, 0.3, 0.15])), rng.uniform(3.1, 3.75)
    middle = float(rng.uniform(1.5, 6.0)) if count > 1 and rng.random() < 0.7 else 0.0
    half = 0.5 * middle + count * lane
    edge = half + float(rng.uniform(0.4, 3.0))
    profile = [(0.0, 0.0), (half, -0.02 * half), (edge, -0.025 * edge)]
    left, right = (
        [
            *profile,
            (edge + rng.uniform(2.0, 8.0), rng.uniform(-2.0, 2.5)),
            (edge + 30.0, rng.uniform(-3.0, 5.0)),
        ]
        for _ in range(2)
    )
    line = centre_line(rng, length_m, rng.uniform(0.0, 0.08))
    section = [(-d, z) for d, z in reversed(right)] + left[1:]
    b = Builder(rng, make_terrain(rng, line, section, wild=rng.uniform(0.1, 0.5)))
    if middle > 1.0 and rng.random() < 0.8:
        b.line(_rail(rng), 4.0, 0.0)
    for sign in (1.0, -1.0):
        _beside(rng, b, sign, edge)
    own = [-(0.5 * middle + (k + 0.5) * lane) for k in range(count)]
    place = own[int(rng.integers(count))]
    beside = (on_side(1.0, edge + 0.5, edge + 2.5), on_side(-1.0, edge + 0.5, edge + 2.5))
    lanes = tuple(own + [-d for d in own])
    return Layout(b.terrain, b.made, (place - 0.3, place + 0.3), lanes, beside, beside)


def _beside(rng: np.random.Generator, b: Builder, sign: float, edge_m: float) -> None:
    """What stands on one side of a road."""
    barrier = rng.random()
    if barrier < 0.4:
        b.line(_rail(rng), 4.0, sign * (edge_m + 0.2))
    elif barrier < 0.5:
        tall = rng.uniform(1.5, 4.0)
        b.line(box((4.0, 0.2, tall), (2.0, 0.0, 0.5 * tall)), 4.0, sign * (edge_m + 0.6))
    if rng.random() < 0.6:
        b.row(pole, (15.0, 50.0), sign * (edge_m + 0.6), keep=0.8)
    if rng.random() < 0.4:
        b.row(tree, (7.0, 20.0), sign * (edge_m + rng.uniform(1.5, 5.0)), keep=0.8)
    b.scatter(bush, rng.uniform(0.02, 0.3), on_side(sign, edge_m + 1.5, edge_m + 25.0))
    b.scatter(tree, rng.uniform(0.0, 0.35), on_side(sign, edge_m + 4.0, edge_m + 32.0))
    if rng.random() < 0.35:
        b.fronts(edge_m + rng.uniform(5.0, 25.0), sign, gap=rng.uniform(0.5, 0.9))


def _rail(rng: np.random.Generator) -> Mesh:
    """Four metres of a crash rail along x from 0."""
    height = rng.uniform(0.6, 0.85)
    return merge(
        [
            box((4.0, 0.06, 0.3), (2.0, 0.0, height)),
            box((0.12, 0.1, height), (0.1, 0.08, 0.5 * height)),
            box((0.12, 0.1, height), (2.1, 0.08, 0.5 * height)),
        ]
    )

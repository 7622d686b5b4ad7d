# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Vehicles of random shape: cars, vans, lorries, buses, fork-lifts, carts."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.errors import ConfigError
from hybridreg_ros.data.meshes.geometry import moved, rot_x
from hybridreg_ros.data.meshes.scene import Mesh, merge
from hybridreg_ros.data.meshes.shapes import box, cylinder, rings, tube

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    F64 = NDArray[np.float64]
    Ground = Callable[[float, float], float]

KINDS = ('car', 'van', 'lorry', 'bus', 'forklift')


def make_vehicle(rng: np.random.Generator, kind: str) -> Mesh:
    """Mesh of a random vehicle of a kind: x ahead, centred, wheels on z = 0, metres.

    Raises:
        ConfigError: the kind is unknown.
    """
    makers = {'car': _car, 'van': _van, 'lorry': _lorry, 'bus': _bus, 'forklift': _forklift}
    if kind not in makers:
        raise ConfigError(f'kind: expected one of {", ".join(KINDS)}, found {kind!r}')
    return makers[kind](rng)


def _hull(stations: F64, square: float = 0.35) -> Mesh:
    """Skin over cross-sections: rows x, half width, z low, z high, narrowing of the top."""
    phi = np.linspace(0.0, 2.0 * np.pi, 20, endpoint=False)
    c, s = np.cos(phi), np.sin(phi)
    y = np.sign(c) * np.abs(c) ** square
    z = np.sign(s) * np.abs(s) ** square
    x, half, low, high, tuck = (stations[:, k, None] for k in range(5))
    width = half * (1.0 - tuck * np.clip(z, 0.0, 1.0))
    loops = [x + 0.0 * y, width * y, 0.5 * (low + high) + 0.5 * (high - low) * z]
    return rings(np.stack(loops, axis=-1))


def _wheels(
    rng: np.random.Generator, axles: list[float], half: float, radius: float
) -> list[Mesh]:
    width = rng.uniform(0.16, 0.3)
    wheel = moved(cylinder(radius, width, 14), (0.0, 0.5 * width, 0.0), rot_x(np.pi / 2.0))
    return [
        moved(wheel, (x, side * (half - 0.5 * width), radius))
        for x in axles
        for side in (1.0, -1.0)
    ]


def _mirrors(x: float, half: float, z: float) -> list[Mesh]:
    return [box((0.12, 0.2, 0.14), (x, side * (half + 0.08), z)) for side in (1.0, -1.0)]


def _car(rng: np.random.Generator) -> Mesh:
    """Saloon, estate, hatchback, off-roader or pick-up, by one varied outline."""
    length, half = rng.uniform(3.4, 5.1), rng.uniform(0.8, 0.98)
    tall = rng.uniform(1.38, 1.85)
    clear = rng.uniform(0.14, 0.26)
    bonnet = rng.uniform(0.62, 0.75) * tall * (1.0 if tall < 1.6 else 0.93)
    boot = rng.choice([bonnet * rng.uniform(0.95, 1.08), 0.0], p=[0.55, 0.45])
    nose, tail = 0.5 * length, -0.5 * length
    body = _hull(np.array([
        [tail, 0.82 * half, clear + 0.2, 0.9 * bonnet, 0.0],
        [tail + 0.12, 0.96 * half, clear, bonnet, 0.02],
        [tail + 0.3 * length, half, clear, bonnet * 1.02, 0.02],
        [nose - 0.35 * length, half, clear, bonnet, 0.03],
        [nose - 0.15, 0.95 * half, clear, 0.88 * bonnet, 0.05],
        [nose, 0.75 * half, clear + 0.15, 0.72 * bonnet, 0.05],
    ]))  # fmt: skip
    screen = nose - rng.uniform(0.22, 0.3) * length
    roof_front = screen - rng.uniform(0.12, 0.2) * length
    roof_back = tail + (rng.uniform(0.22, 0.3) if boot else rng.uniform(0.05, 0.12)) * length
    if rng.random() < 0.08:
        roof_back = 0.0
    glass = tail + (0.15 if boot else 0.03) * length if roof_back < 0 else -0.08 * length
    tuck = rng.uniform(0.12, 0.28)
    low = 0.9 * bonnet
    cabin = _hull(
        np.array(
            [
                [glass, 0.9 * half, low, bonnet + 0.02, 0.05],
                [roof_back, 0.94 * half, low, tall - 0.04, tuck],
                [0.5 * (roof_front + roof_back), 0.95 * half, low, tall, tuck],
                [roof_front, 0.94 * half, low, tall - 0.03, tuck],
                [screen, 0.9 * half, low, bonnet + 0.02, 0.05],
            ]
        )
    )
    radius = rng.uniform(0.29, 0.38)
    axles = [nose - 0.19 * length, tail + 0.2 * length]
    parts = [
        body,
        cabin,
        *_wheels(rng, axles, half, radius),
        *_mirrors(screen - 0.2, half, bonnet),
    ]
    if rng.random() < 0.12:
        parts.append(box((1.3, 1.0, 0.35), (0.5 * (roof_front + roof_back), 0.0, tall + 0.22)))
    return merge(parts)


def _van(rng: np.random.Generator) -> Mesh:
    length, half = rng.uniform(4.5, 6.8), rng.uniform(0.92, 1.05)
    tall, clear = rng.uniform(1.85, 2.8), rng.uniform(0.2, 0.32)
    nose, tail = 0.5 * length, -0.5 * length
    bonnet = rng.uniform(1.0, 1.25)
    slope = rng.uniform(0.7, 1.3)
    body = _hull(np.array([
        [tail, 0.97 * half, clear + 0.1, 0.97 * tall, 0.03],
        [tail + 0.1, half, clear, tall, 0.05],
        [nose - slope - 0.5, half, clear, tall, 0.06],
        [nose - 0.55, 0.98 * half, clear, bonnet, 0.04],
        [nose - 0.1, 0.93 * half, clear, 0.9 * bonnet, 0.03],
        [nose, 0.8 * half, clear + 0.1, 0.7 * bonnet, 0.02],
    ]), 0.25)  # fmt: skip
    axles = [nose - 0.9, tail + rng.uniform(0.9, 1.4)]
    parts = [body, *_wheels(rng, axles, half, rng.uniform(0.32, 0.38))]
    return merge([*parts, *_mirrors(nose - 1.2, half, 1.35)])


def _lorry(rng: np.random.Generator) -> Mesh:
    length, half = rng.uniform(6.0, 12.0), rng.uniform(1.1, 1.26)
    tall, bed = rng.uniform(2.6, 3.9), rng.uniform(0.85, 1.2)
    nose, tail = 0.5 * length, -0.5 * length
    cab_long, cab_tall = rng.uniform(1.6, 2.4), rng.uniform(2.3, 3.4)
    cab = _hull(
        np.array(
            [
                [nose - cab_long, half * 0.97, 0.5, cab_tall, 0.03],
                [nose - 0.5, half * 0.97, 0.45, cab_tall, 0.05],
                [nose - 0.1, half * 0.93, 0.4, 0.8 * cab_tall, 0.05],
                [nose, half * 0.85, 0.5, 0.5 * cab_tall, 0.0],
            ]
        ),
        0.25,
    )
    deck_long = length - cab_long - 0.4
    centre = tail + 0.5 * deck_long
    parts = [cab, box((length - 1.0, 0.9, 0.25), (-0.2, 0.0, bed - 0.2))]
    style = rng.choice(['box', 'flat', 'tank', 'tipper'])
    if style == 'box':
        parts.append(box((deck_long, 2.0 * half, tall - bed), (centre, 0.0, 0.5 * (tall + bed))))
    elif style == 'tank':
        r = rng.uniform(0.8, 1.1)
        barrel = np.array(
            [
                [tail + 0.1, 0.6 * r, bed + 0.2, bed + 1.6 * r, 0.0],
                [tail + 0.3, r, bed, bed + 2 * r, 0.0],
                [tail + deck_long - 0.3, r, bed, bed + 2 * r, 0.0],
                [tail + deck_long, 0.6 * r, bed + 0.2, bed + 1.6 * r, 0],
            ]
        )
        parts.append(_hull(barrel, 1.0))
    else:
        parts.append(box((deck_long, 2.0 * half, 0.15), (centre, 0.0, bed)))
        wall = rng.uniform(0.3, 0.6) if style == 'flat' else rng.uniform(0.7, 1.3)
        parts += [
            box((deck_long, 0.06, wall), (centre, side * half, bed + 0.5 * wall))
            for side in (1.0, -1.0)
        ]
        x = tail + 0.3
        while x < tail + deck_long - 1.2:
            size = rng.uniform([0.6, 0.6, 0.3], [1.6, 2.0 * half - 0.2, 1.5])
            parts.append(box(size, (x + 0.5 * size[0], 0.0, bed + 0.07 + 0.5 * size[2])))
            x += size[0] + rng.uniform(0.05, 0.8)
    axles = [nose - 0.9, tail + 1.0, tail + 2.2] if length > 8 else [nose - 0.9, tail + 1.2]
    parts += [
        *_wheels(rng, axles, half, rng.uniform(0.42, 0.52)),
        *_mirrors(nose - 0.3, half, 2.0),
    ]
    return merge(parts)


def _bus(rng: np.random.Generator) -> Mesh:
    length, half, tall = rng.uniform(8.0, 13.0), rng.uniform(1.15, 1.27), rng.uniform(2.8, 3.5)
    nose, tail = 0.5 * length, -0.5 * length
    body = _hull(
        np.array(
            [
                [tail, 0.95 * half, 0.5, 0.95 * tall, 0.02],
                [tail + 0.2, half, 0.3, tall, 0.05],
                [nose - 0.3, half, 0.3, tall, 0.05],
                [nose, 0.93 * half, 0.35, 0.93 * tall, 0.03],
            ]
        ),
        0.22,
    )
    parts = [body, box((2.2, 1.6, 0.3), (rng.uniform(-2, 2), 0.0, tall + 0.15))]
    parts += _wheels(rng, [nose - 2.6, tail + 3.0], half, 0.48)
    return merge([*parts, *_mirrors(nose + 0.1, half, 2.2)])


def _forklift(rng: np.random.Generator) -> Mesh:
    half, top, mast = rng.uniform(0.5, 0.65), rng.uniform(1.9, 2.2), rng.uniform(2.0, 3.2)
    lift = rng.uniform(0.1, 1.2)
    parts = [
        _hull(np.array([[-1.1, 0.8 * half, 0.3, 1.0, 0.0], [-0.9, half, 0.2, 1.15, 0.05],
                        [0.2, half, 0.2, 0.7, 0.0], [0.9, 0.95 * half, 0.2, 0.65, 0.0]])),
        box((1.1, 2.0 * half - 0.1, 0.06), (-0.2, 0.0, top)),
        box((0.3, 0.5, 0.9), (-0.5, 0.0, 1.0)),
    ]  # fmt: skip
    for side in (1.0, -1.0):
        y = side * (half - 0.08)
        parts.append(tube([[-0.7, y, 1.0], [-0.7, y, top]], 0.035, 6))
        parts.append(tube([[0.5, y, 0.6], [0.3, y, top]], 0.035, 6))
        parts.append(box((0.12, 0.09, mast), (1.0, 0.5 * y, 0.5 * mast)))
        parts.append(box((1.1, 0.12, 0.05), (1.6, 0.5 * y, lift)))
    if rng.random() < 0.6:
        load = rng.uniform([0.7, 0.7, 0.4], [1.1, 1.1, 1.3])
        parts.append(box(load, (1.65, 0.0, lift + 0.03 + 0.5 * load[2])))
    return merge([*parts, *_wheels(rng, [-0.75, 0.6], half, 0.25)])


def cart(rng: np.random.Generator) -> Mesh:
    """A trolley, pram or pallet truck, x ahead, on z = 0."""
    size = rng.uniform([0.5, 0.35, 0.4], [1.2, 0.8, 1.2])
    z = rng.uniform(0.12, 0.4)
    parts = [box(size, (0.0, 0.0, z + 0.5 * size[2]))]
    parts += _wheels(rng, [0.35 * size[0], -0.35 * size[0]], 0.5 * size[1], 0.08)
    grip = moved(tube([[0, -0.2, 0], [0, 0.2, 0]], 0.02, 6), (-0.6 * size[0] - 0.1, 0.0, 1.0))
    parts.append(grip)
    for side in (1.0, -1.0):
        y = 0.2 * side
        parts.append(tube([[-0.5 * size[0], y, z], [-0.6 * size[0] - 0.1, y, 1.0]], 0.018, 6))
    return merge(parts)

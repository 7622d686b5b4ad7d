# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Pairs as recordings show them: a few scans of one sensor on its way, taken two by two."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.se3 import apply, inverse
from hybridreg_ros.data.hybridmatch.take import Sample
from hybridreg_ros.data.hybridmatch.truth import Truth
from hybridreg_ros.data.meshes.scene import Standing
from hybridreg_ros.data.overlap import near_cells
from hybridreg_ros.data.pair import PointPair

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hybridreg_ros.data.meshes.scene import Mover

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]
    Unit = tuple[Mover, ...]

SHOTS, PAIRS_A_SCENE = 5, 8
GAP_S, REACH_M = (0.1, 5.0), 15.0
"""Time between the scans of a pair, seconds, and how far apart they are at most, metres."""
MOVED_M = 0.05
"""What got less far than this between two scans, metres on average, counts as standing."""
_CALM_SHARE, _STANDS_SHARE = 0.08, 0.5
_LEAST_OF_MOST = 1.0 / 15.0
_STILL_PAIRS = 2
_LEAST_OVERLAP = 0.1
_MIN_POINTS = 2000


@dataclass(frozen=True, eq=False)
class Shot:
    """One scan, as a front end would hand it on.

    Attributes:
        points: (N, 3) float32 measured, sensor frame at the stamp, metres.
        true: (N, 3) float32 without noise.
        instance: (N,) uint16 number of the mover from 1; 0 = background and what stands.
        sigma_m: (N,) float32 standard deviation of the error of each point.
        T_world_sensor: (4, 4) at the stamp.
        time_s: of the stamp.
    """

    points: F32
    true: F32
    instance: NDArray[np.uint16]
    sigma_m: F32
    T_world_sensor: F64
    time_s: float


@dataclass(frozen=True, eq=False)
class Kind:
    """What differs between streets and rooms.

    Attributes:
        name: of the split.
        voxel_m: voxel size of the pairs, metres.
        seen_m: a point of the other scan as near as this shows the same place, metres.
        most_moving: largest share of moving points.
    """

    name: str
    voxel_m: float
    seen_m: float
    most_moving: float


@dataclass(eq=False)
class Bodies:
    """Movers of a scene with their meshes at the times asked for."""

    movers: Sequence[Mover]
    _known: dict[tuple[int, float], F32] = field(default_factory=dict)

    def vertices(self, number: int, time_s: float) -> F32:
        """Vertices (V, 3) of a mover at a time, world frame."""
        key = number, time_s
        if key not in self._known:
            self._known[key] = self.movers[number].mesh_at(time_s).vertices
        return self._known[key]

    def moved_m(self, number: int, first_s: float, second_s: float) -> float:
        """Mean displacement of the vertices of a mover between two times, metres."""
        change = self.vertices(number, second_s) - self.vertices(number, first_s)
        return float(np.linalg.norm(change, axis=1).mean())

    def away_m(self, number: int, time_s: float, places: F64) -> float:
        """Distance on the ground from a mover to the nearest of some places (P, 3), metres."""
        vertices = self.vertices(number, time_s)[:, :2]
        return float(np.sqrt(((vertices[:, None] - places[None, :, :2]) ** 2).sum(-1).min()))


def shot_times(rng: np.random.Generator, longest_s: float) -> F64:
    """Times (SHOTS,) from 0, their distances from the first even over the logarithm, seconds."""
    last = max(longest_s, 2.0 * GAP_S[0])
    later = np.exp(rng.uniform(np.log(GAP_S[0]), np.log(last), SHOTS - 1))
    return np.append(0.0, np.sort(later))


def who_moves(
    rng: np.random.Generator,
    units: Sequence[Unit],
    share: F64,
    may: NDArray[np.bool_],
    most: float,
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which units stay in the scene and which of these move: about half, as far as they fit.

    Args:
        rng: source of the choice.
        units: movers that belong together, U of them.
        share: (U,) share of the points that shows each.
        may: (U, 2) whether each may stand, and may move, without meeting the sensor.
        most: share of moving points that is not exceeded, save by what may not stand.

    Returns:
        Which are kept (U,), and which move (U,).
    """
    calm = rng.random() < _CALM_SHARE
    moves = np.zeros(len(units), np.bool_)
    total = 0.0
    # What may not stand, such as a car ahead, comes first.
    order = sorted(rng.permutation(len(units)).tolist(), key=lambda k: bool(may[k, 0]))
    for k in order:
        stands = may[k, 0] and rng.random() < _STANDS_SHARE
        fits = total + share[k] <= (most if may[k, 0] else 2.0 * most)
        if may[k, 1] and fits and not stands and not calm:
            moves[k] = True
            total += float(share[k])
    fit = may[:, 1] & (share <= most)
    if not calm and total < _LEAST_OF_MOST * most and fit.any():
        moves[np.argmax(np.where(fit, share, -1.0))] = True
    return moves | may[:, 0], moves


def with_standing(
    units: Sequence[Unit], kept: NDArray[np.bool_], moves: NDArray[np.bool_], stand_s: F64
) -> tuple[Mover, ...]:
    """The movers of the kept units; those that do not move stand as at their times (U,)."""
    return tuple(
        mover if moves[k] else Standing(mover, float(stand_s[k]))
        for k, unit in enumerate(units)
        if kept[k]
        for mover in unit
    )


def unit_shares(units: Sequence[Unit], instance: NDArray[np.uint16], count: int) -> F64:
    """Share (U,) of `count` points that shows each unit; instances number the movers from 1."""
    seen = np.bincount(instance.reshape(-1), minlength=1 + sum(len(u) for u in units))[1:]
    of = np.repeat(np.arange(len(units)), [len(u) for u in units])
    return np.bincount(of, seen, minlength=len(units)) / max(count, 1)


def recorded_samples(
    rng: np.random.Generator,
    kind: Kind,
    seed: int,
    shots: Sequence[Shot],
    movers: Sequence[Mover],
    count: int,
) -> list[Sample]:
    """Pairs of the scans of one scene, at most `count`, in random order and direction.

    Of those in which nothing moves, some are kept.
    """
    bodies = Bodies(movers)
    both = [(a, b) for k, a in enumerate(shots) for b in shots[k + 1 :] if _within(a, b)]
    samples: list[Sample] = []
    still = 0
    for row in rng.permutation(len(both)).tolist():
        source, target = both[row] if rng.random() < 0.5 else both[row][::-1]
        made = _sample(kind, source, target, bodies, f'{kind.name}-{seed:07d}-{row}', seed)
        if made is None:
            continue
        still += made.pair.dynamic_share == 0.0
        if made.pair.dynamic_share > 0.0 or still <= _STILL_PAIRS:
            samples.append(made)
        if len(samples) == count:
            break
    return samples


def _within(first: Shot, second: Shot) -> bool:
    gap = second.time_s - first.time_s
    apart = np.linalg.norm(second.T_world_sensor[:3, 3] - first.T_world_sensor[:3, 3])
    return bool(GAP_S[0] <= gap + 1e-6 and gap <= GAP_S[1] and apart <= REACH_M)


def _sample(
    kind: Kind, source: Shot, target: Shot, bodies: Bodies, name: str, seed: int
) -> Sample | None:
    """The pair of two scans; None when it is too small, too far apart or too much moves."""
    if min(len(source.points), len(target.points)) < _MIN_POINTS:
        return None
    numbers = np.union1d(source.instance, target.instance)
    apart = {
        int(n): bodies.moved_m(int(n) - 1, source.time_s, target.time_s) for n in numbers if n
    }
    moving = np.array([n for n, far in apart.items() if far > MOVED_M], np.int64)
    kinds = np.zeros(len(bodies.movers) + 1, np.uint8)
    kinds[moving] = [int(bodies.movers[n - 1].label) for n in moving]
    labels = [kinds[shot.instance] for shot in (source, target)]
    share = float(np.concatenate(labels).astype(np.bool_).mean())
    T = inverse(target.T_world_sensor) @ source.T_world_sensor
    static = [label == 0 for label in labels]
    seen = np.zeros(len(source.points), np.bool_)
    there: F64 = np.asarray(apply(T, source.true[static[0]].astype(np.float64)))
    seen[static[0]] = near_cells(there, target.true[static[1]].astype(np.float64), kind.seen_m)
    overlap = float(seen.sum() / max(static[0].sum(), 1))
    if share > kind.most_moving or overlap < _LEAST_OVERLAP:
        return None
    own = [
        np.where(s, 0, shot.instance).astype(np.uint16)
        for s, shot in zip(static, (source, target), strict=True)
    ]
    pair = PointPair(
        source.points,
        target.points,
        T,
        labels[0],
        labels[1],
        own[0],
        own[1],
        overlap,
        share,
        kind.voxel_m,
        name,
        seed,
    )
    truth = Truth(
        tuple(bodies.movers),
        (source.time_s, target.time_s),
        source.T_world_sensor,
        source.sigma_m,
        seen,
    )
    shown = np.bincount(np.concatenate(own), minlength=2)[1:]
    return Sample(pair, apart[int(shown.argmax()) + 1] if shown.any() else 0.0, truth)

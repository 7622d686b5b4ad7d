# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""How a camera walks through a room: a free, smooth path, and where to look on the way."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.data.meshes.raycast import Caster
    from hybridreg_ros.data.rooms.floor import FloorGrid
    from hybridreg_ros.data.rooms.motion import Stage

    F64 = NDArray[np.float64]

_CELL_M = 0.05
_YAWS = 24
_STEPS = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]


def walkable(stage: Stage, height_m: float, clearance_m: float) -> NDArray[np.bool_]:
    """Floor cells (nx, ny) that a camera at a height may pass without touching anything."""
    floor = stage.room.floor
    free = np.zeros(floor.taken.shape, np.bool_)
    spots = floor.clear_spots(clearance_m, 0.3)
    ij = np.floor((spots - floor.low) / _CELL_M).astype(int)
    free[ij[:, 0], ij[:, 1]] = True
    for low, high in stage.room.boxes.bounds():
        if low[2] < height_m + 0.3 and high[2] > height_m - 0.3:
            a = np.floor((low[:2] - clearance_m - floor.low) / _CELL_M).astype(int).clip(0)
            b = np.ceil((high[:2] + clearance_m - floor.low) / _CELL_M).astype(int).clip(0)
            free[a[0] : b[0], a[1] : b[1]] = False
    return free


def _distances(free: NDArray[np.bool_], start: tuple[int, int]) -> NDArray[np.int32]:
    """Steps (nx, ny) from a start cell over free cells; -1 where it cannot get."""
    steps = np.full(free.shape, -1, np.int32)
    reached = np.zeros_like(free)
    reached[start] = True
    k = 0
    while reached.any():
        steps[reached] = k
        grown = np.zeros_like(free)
        grown[1:] |= reached[:-1]
        grown[:-1] |= reached[1:]
        grown[:, 1:] |= reached[:, :-1]
        grown[:, :-1] |= reached[:, 1:]
        reached = grown & free & (steps < 0)
        k += 1
    return steps


def _descend(steps: NDArray[np.int32], cell: tuple[int, int]) -> list[tuple[int, int]]:
    """Cells from `cell` down to the start of `steps`."""
    path = [cell]
    while steps[cell] > 0:
        near = [
            (cell[0] + i, cell[1] + j)
            for i, j in _STEPS
            if 0 <= cell[0] + i < steps.shape[0] and 0 <= cell[1] + j < steps.shape[1]
        ]
        cell = min((c for c in near if steps[c] >= 0), key=lambda c: steps[c])
        path.append(cell)
    return path


def walk(
    rng: np.random.Generator,
    floor: FloorGrid,
    free: NDArray[np.bool_],
    around: F64,
    reach_m: tuple[float, float],
    length_m: float,
) -> F64 | None:
    """A smooth path over free cells, 5 cm steps; None when there is no room to walk.

    Args:
        rng: source of the way points.
        floor: where the cells lie.
        free: (nx, ny) cells that may be passed.
        around: (2,) way points stay about this place.
        reach_m: nearest and farthest way point from it.
        length_m: length to reach; the path turns back and forth when the room is small.

    Returns:
        (K, 2) points, metres.
    """
    cells = np.argwhere(free)
    if len(cells) < 20:
        return None
    away = np.linalg.norm(floor.low + (cells + 0.5) * _CELL_M - around, axis=1)
    fits = (away > reach_m[0]) & (away < reach_m[1])
    cells = cells[fits] if fits.sum() > 20 else cells
    here = cells[rng.integers(len(cells))]
    path: list[tuple[int, int]] = [(int(here[0]), int(here[1]))]
    for _ in range(80):
        steps = _distances(free, path[-1])
        known = steps[cells[:, 0], cells[:, 1]]
        far = cells[known >= min(40, max(int(known.max()) // 2, 8))]
        if len(far) == 0:
            return None
        goal = far[rng.integers(len(far))]
        path += _descend(steps, (int(goal[0]), int(goal[1])))[::-1][1:]
        points = _smoothed(floor.low + (np.array(path) + 0.5) * _CELL_M, floor, free)
        if _length(points)[-1] > length_m:
            return points
    return None


def _length(path: F64) -> F64:
    """Length (K,) of a path (K, 2) up to each of its points, metres."""
    step = np.linalg.norm(np.diff(path, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(step)])


def _smoothed(points: F64, floor: FloorGrid, free: NDArray[np.bool_], rounds: int = 80) -> F64:
    """Relax a path towards the mean of its neighbours wherever it stays on free cells."""
    points = points.copy()
    for _ in range(rounds):
        middle = points.copy()
        middle[2:-2] = (points[:-4] + points[1:-3] + points[3:-1] + points[4:]) / 4.0
        ij = np.floor((middle - floor.low) / _CELL_M).astype(int)
        allowed = free[ij[:, 0], ij[:, 1]]
        points = np.where(allowed[:, None], middle, points)
    return points


def at_speed(path: F64, speed_mps: float, times_s: F64) -> F64:
    """Places (N, 2) on a path (K, 2) at times, at one speed; it ends with the path."""
    length = _length(path)
    s = np.clip(speed_mps * times_s, 0.0, length[-1])
    return np.stack([np.interp(s, length, path[:, k]) for k in (0, 1)], axis=1)


def choose_gaze(
    caster: Caster,
    places: F64,
    times_s: F64,
    pitch_rad: float,
    range_m: tuple[float, float],
    wanted: tuple[float, float],
) -> tuple[F64, float]:
    """Yaw of the camera at each place: sees structure and the wanted movers, turns gently.

    The best sequence of 15 degree steps by dynamic programming, one step a place at most.

    Args:
        caster: the scene.
        places: (N, 3) eyes, metres.
        times_s: (N,).
        pitch_rad: tilt of the camera, negative looks down.
        range_m: of the camera.
        wanted: lowest and highest share of moving points.

    Returns:
        Unwrapped yaw (N,) radians and the mean share of moving points along it.
    """
    yaws = np.arange(_YAWS) * 2.0 * np.pi / _YAWS
    a, b = np.meshgrid(np.linspace(-0.48, 0.48, 16), np.linspace(-0.38, 0.38, 12))
    rays = _fan(yaws, a.ravel(), b.ravel() + pitch_rad)
    score = np.zeros((len(places), _YAWS))
    share = np.zeros_like(score)
    middle = 0.5 * (wanted[0] + wanted[1])
    for n, (place, time_s) in enumerate(zip(places, times_s, strict=True)):
        hits = caster.cast(
            float(time_s), place.astype(np.float32), rays.reshape(-1, 3).astype(np.float32)
        )
        distance = hits.distance.reshape(_YAWS, -1)
        seen = (distance > range_m[0]) & (distance < 0.85 * range_m[1])
        moving = seen & (hits.label.reshape(_YAWS, -1) > 0)
        static = seen & ~moving
        normal = np.where(static[..., None], hits.normal.reshape(_YAWS, -1, 3), 0.0)
        moment = np.einsum('yri,yrj->yij', normal, normal) / rays.shape[1]
        spread = np.sqrt(np.maximum(np.linalg.eigvalsh(moment)[:, 0], 0.0))
        share[n] = moving.sum(1) / np.maximum(seen.sum(1), 1)
        near = (distance < range_m[0]).mean(1)
        score[n] = np.minimum(static.mean(1), 0.5) + 2.0 * np.minimum(spread, 0.2) - 2.0 * near
        score[n] -= 2.5 * np.abs(share[n] - middle)
    best = _best_turns(score)
    return np.unwrap(yaws[best]), float(share[np.arange(len(best)), best].mean())


def _fan(yaws: F64, across: F64, up: F64) -> F64:
    """Unit directions (Y, R, 3) of a small image at each yaw."""
    yaw = yaws[:, None] + across[None, :]
    level = np.cos(up)
    return np.stack(
        [np.cos(yaw) * level, np.sin(yaw) * level, np.broadcast_to(np.sin(up), yaw.shape)], -1
    )


def _best_turns(score: F64) -> NDArray[np.int64]:
    """Column (N,) of each row that maximises the sum, moving by one column a row at most."""
    total, back = score[0], []
    for row in score[1:]:
        options = np.stack([np.roll(total, 1) - 0.05, total, np.roll(total, -1) - 0.05])
        pick = options.argmax(0)
        back.append(pick)
        total = row + options.max(0)
    k = int(total.argmax())
    result = [k]
    for pick in reversed(back):
        k = (k + (-1, 0, 1)[pick[k]]) % score.shape[1]
        result.append(k)
    return np.array(result[::-1])

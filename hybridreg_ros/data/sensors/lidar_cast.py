# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Rays of one lidar turn: the background once, each mover as it stands when the beam passes it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.data.meshes.raycast import Posed

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.data.meshes.raycast import Caster
    from hybridreg_ros.data.meshes.scene import Mesh

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]

_MOST_MOVED_M = 0.8
"""How far something may get during half a turn, metres."""
_EVERY_COLUMN = 64


def cast_turn(
    caster: Caster, o: NDArray[np.float32], d: F32, times: F64, frozen_s: float | None
) -> tuple[F32, F32, NDArray[np.uint16], NDArray[np.int32]]:
    """Distance (H, W), normal (H, W, 3), instance (H, W) and static triangle (H, W).

    The background is cast once. Each half of the turn has its own movers, each of them posed at
    the time at which the beams pass its middle; so what stands across the seam of the turn is cut
    there, as in a real scan.

    Args:
        caster: the scene.
        o: (H, W, 3) origins.
        d: (H, W, 3) unit directions.
        times: (W,) seconds of each column.
        frozen_s: the movers stand still as at this time; None lets them move.
    """
    shape = d.shape[:2]
    trace = caster.trace(float(times[0]), o.reshape(-1, 3), d.reshape(-1, 3), movers=False)
    distance, normal = trace.distance.reshape(shape), trace.normal.reshape(d.shape)
    face, instance = trace.face.reshape(shape), np.zeros(shape, np.uint16)
    movers = caster.scene.movers
    if not movers:
        return distance, normal, instance, face
    middle_s = float(times[shape[1] // 2]) if frozen_s is None else frozen_s
    meshes = [m.mesh_at(middle_s) for m in movers]
    margin = _MOST_MOVED_M if frozen_s is None else 0.1
    balls = np.array([_ball(mesh.vertices, margin) for mesh in meshes])
    half = shape[1] // 2
    for window in (slice(0, half), slice(half, shape[1])):
        near = _in_view(balls, o[0, window], d[:, window])
        if len(near) == 0:
            continue
        posed: list[Mesh] = [meshes[k] for k in near]
        if frozen_s is None:
            at = _passed(balls[near, :3], o[0, window], d[:, window], times[window])
            posed = [movers[k].mesh_at(t) for k, t in zip(near, at, strict=True)]
        rays = (slice(None), window)
        hit = Posed(posed).trace(o[rays].reshape(-1, 3), d[rays].reshape(-1, 3))
        reach = hit.distance.reshape(shape[0], -1)
        closer = reach < distance[rays]
        number = np.concatenate([[0], near + 1])[hit.instance].reshape(reach.shape)
        distance[rays] = np.where(closer, reach, distance[rays])
        normal[rays] = np.where(
            closer[..., None], hit.normal.reshape(*reach.shape, 3), normal[rays]
        )
        instance[rays] = np.where(closer, number, 0)
        face[rays] = np.where(closer, -1, face[rays])
    return distance, normal, instance, face


def _ball(vertices: F32, margin_m: float) -> F64:
    """Centre and radius (4,) of a ball around vertices (V, 3), and a margin."""
    low, high = vertices.min(0).astype(np.float64), vertices.max(0).astype(np.float64)
    return np.array([*(0.5 * (low + high)), 0.5 * np.linalg.norm(high - low) + margin_m])


def _passed(centres: F64, o: NDArray[np.float32], d: F32, times: F64) -> list[float]:
    """Times (K,) at which the middle ring of some columns comes nearest to points (K, 3)."""
    ray = d[len(d) // 2, :, :2].astype(np.float64)
    ray /= np.maximum(np.linalg.norm(ray, axis=1, keepdims=True), 1e-9)
    to = centres[:, :2] - o[len(o) // 2, :2]
    rows: list[float] = times[np.argmax(to @ ray.T, axis=1)].tolist()
    return rows


def _in_view(balls: F64, o: NDArray[np.float32], d: F32) -> NDArray[np.int64]:
    """Movers whose ball may be met by the rays of some columns (azimuth only)."""
    ray = d[len(d) // 2]
    middle = len(ray) // 2
    to = balls[:, :2] - o[middle, :2]
    away = np.hypot(to[:, 0], to[:, 1])
    half = np.arcsin(np.clip(balls[:, 3] / np.maximum(away, 1e-6), 0.0, 1.0))
    centre = np.arctan2(ray[middle, 1], ray[middle, 0])
    columns = np.append(np.arange(0, d.shape[1], _EVERY_COLUMN), d.shape[1] - 1)
    flat = d[:, columns, :2].reshape(-1, 2)
    spread = np.abs(_wrapped(np.arctan2(flat[:, 1], flat[:, 0]) - centre)).max()
    off = np.abs(_wrapped(np.arctan2(to[:, 1], to[:, 0]) - centre))
    seen: NDArray[np.int64] = np.nonzero((off < half + spread + 0.02) | (away <= balls[:, 3]))[0]
    return seen


def _wrapped(angle: NDArray[np.floating]) -> NDArray[np.floating]:
    wrapped: NDArray[np.floating] = (angle + np.pi) % (2.0 * np.pi) - np.pi
    return wrapped

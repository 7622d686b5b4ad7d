# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Rays of one lidar turn: the background once, each mover only where it can be seen."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.data.raycast import Caster
from hybridreg_ros.data.scene import Mesh, Scene

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]


_NOTHING = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32))


def cast_turn(
    caster: Caster, o: NDArray[np.float32], d: F32, times: F64, slices: int,
    frozen_s: float | None,
) -> tuple[F32, F32, NDArray[np.uint16], NDArray[np.int32]]:  # fmt: skip
    """Distance (H, W), normal (H, W, 3), instance (H, W) and static triangle (H, W).

    The background is cast once; each mover is posed only for those slices of columns in which
    it can be seen.
    """
    shape = d.shape[:2]
    trace = caster.trace(float(times[0]), o.reshape(-1, 3), d.reshape(-1, 3), movers=False)
    distance, normal = trace.distance.reshape(shape), trace.normal.reshape(d.shape)
    face, instance = trace.face.reshape(shape), np.zeros(shape, np.uint16)
    movers = caster.scene.movers
    if not movers:
        return distance, normal, instance, face
    ends = (float(times[0]), float(times[-1])) if frozen_s is None else (frozen_s,)
    spheres = np.array([_sphere([m.mesh_at(t).vertices for t in ends]) for m in movers])
    cuts = np.linspace(0, shape[1], slices + 1).astype(int)
    for first, stop in pairwise(cuts):
        now = float(times[(first + stop) // 2]) if frozen_s is None else frozen_s
        near = _in_view(spheres, o[0, first:stop], d[:, first:stop])
        if len(near) == 0:
            continue
        some = Caster(Scene(_NOTHING, tuple(movers[k] for k in near)))
        window = (slice(None), slice(first, stop))
        hit = some.trace(now, o[window].reshape(-1, 3), d[window].reshape(-1, 3))
        reach = hit.distance.reshape(shape[0], -1)
        closer = reach < distance[window]
        number = np.concatenate([[0], near + 1])[hit.instance].reshape(reach.shape)
        distance[window] = np.where(closer, reach, distance[window])
        normal[window] = np.where(
            closer[..., None], hit.normal.reshape(*reach.shape, 3), normal[window]
        )
        instance[window] = np.where(closer, number, 0)
        face[window] = np.where(closer, -1, face[window])
    return distance, normal, instance, face


def _sphere(poses: list[F32]) -> F64:
    """Centre and radius (4,) of a ball around all vertices (V, 3) of a few poses."""
    low = np.min([p.min(0) for p in poses], axis=0).astype(np.float64)
    high = np.max([p.max(0) for p in poses], axis=0).astype(np.float64)
    return np.array([*(0.5 * (low + high)), 0.5 * np.linalg.norm(high - low)])


def _in_view(spheres: F64, o: NDArray[np.float32], d: F32) -> NDArray[np.int64]:
    """Movers whose ball may be met by the rays of a few columns (azimuth only)."""
    ray = d[len(d) // 2]
    middle = len(ray) // 2
    to = spheres[:, :2] - o[middle, :2]
    reach = spheres[:, 3] + 0.1
    away = np.hypot(to[:, 0], to[:, 1])
    half = np.arcsin(np.clip(reach / np.maximum(away, 1e-6), 0.0, 1.0))
    centre = np.arctan2(ray[middle, 1], ray[middle, 0])
    flat = d[:, [0, -1], :2].reshape(-1, 2)
    spread = np.abs(_wrapped(np.arctan2(flat[:, 1], flat[:, 0]) - centre)).max()
    off = np.abs(_wrapped(np.arctan2(to[:, 1], to[:, 0]) - centre))
    seen: NDArray[np.int64] = np.nonzero((off < half + spread + 0.02) | (away <= reach))[0]
    return seen


def _wrapped(angle: NDArray[np.floating]) -> NDArray[np.floating]:
    wrapped: NDArray[np.floating] = (angle + np.pi) % (2.0 * np.pi) - np.pi
    return wrapped

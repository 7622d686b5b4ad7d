# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Rays into a scene: the static part is built once, the movers once per time (Embree)."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.core.errors import DependencyError
from hybridreg_ros.data.scene import Hits, merge

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.data.scene import Mesh, Scene

    F32 = NDArray[np.float32]

_FAR_M = np.float32(1e30)
_KEPT_TIMES = 3


@dataclass(frozen=True, eq=False)
class Trace:
    """Result of casting R rays, with the triangle that each met.

    Attributes:
        distance: (R,) float32 metres along the unit direction; inf = nothing hit.
        instance: (R,) uint16; 0 = static background.
        normal: (R, 3) float32 unit normal facing the ray; zeros at misses.
        face: (R,) int32 triangle of the static mesh; -1 at movers and misses.
    """

    distance: F32
    instance: NDArray[np.uint16]
    normal: F32
    face: NDArray[np.int32]


class _Triangles:
    """One committed Embree scene."""

    def __init__(self, mesh: Mesh) -> None:
        try:
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene
        except ImportError as error:
            raise DependencyError(
                f'ray casting needs embreex ({error}): pip install "hybridreg_ros[data]"'
            ) from None
        corners = np.ascontiguousarray(mesh.vertices[mesh.faces], dtype=np.float32)
        self._scene: Any = EmbreeScene()
        TriangleMesh(self._scene, corners)
        # Embree commits at the first query: pay for it here, not in the first image.
        self._scene.run(np.zeros((1, 3), np.float32), np.eye(1, 3, dtype=np.float32))

    def run(self, origins: F32, directions: F32, limit: F32) -> dict[str, Any]:
        result: dict[str, Any] = self._scene.run(origins, directions, dists=limit, output=1)
        return result


class Caster:
    """Casts rays into a `Scene` at any time.

    Attributes:
        cast_s: seconds spent inside Embree so far (queries and building).
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.cast_s = 0.0
        start = perf_counter()
        self._static = _Triangles(scene.static) if len(scene.static.faces) else None
        self.cast_s += perf_counter() - start
        self._labels = np.array([0, *(int(m.label) for m in scene.movers)], np.uint8)
        self._moving: dict[float, tuple[_Triangles, NDArray[np.uint16]]] = {}

    def cast(self, time_s: float, origins: F32, directions: F32) -> Hits:
        """Nearest hit of every ray.

        Args:
            time_s: time of the movers' poses, seconds.
            origins: (R, 3) or (3,) float32, world frame, metres.
            directions: (R, 3) float32 unit vectors, world frame.
        """
        trace = self.trace(time_s, origins, directions)
        return Hits(trace.distance, trace.instance, self._labels[trace.instance], trace.normal)

    def labels(self, instance: NDArray[np.uint16]) -> NDArray[np.uint8]:
        """`Label` of every instance number."""
        return self._labels[instance]

    def trace(self, time_s: float, origins: F32, directions: F32, *, movers: bool = True) -> Trace:
        """Like `cast`, and tells the static triangle; `movers=False` sees the bare background."""
        directions = np.ascontiguousarray(directions, dtype=np.float32)
        n = len(directions)
        origins = np.ascontiguousarray(np.broadcast_to(origins, (n, 3)), dtype=np.float32)
        distance = np.full(n, np.inf, np.float32)
        normal = np.zeros((n, 3), np.float32)
        face = np.full(n, -1, np.int32)
        instance = np.zeros(n, np.uint16)
        limit = np.full(n, _FAR_M, np.float32)
        if self._static is not None:
            start = perf_counter()
            found = self._static.run(origins, directions, limit)
            self.cast_s += perf_counter() - start
            hit = found['primID'] >= 0
            distance[hit] = found['tfar'][hit]
            normal[hit] = found['Ng'][hit]
            face[hit] = found['primID'][hit]
            limit = np.where(hit, distance, _FAR_M)
        if movers and self.scene.movers:
            triangles, owner = self._posed_movers(time_s)
            start = perf_counter()
            found = triangles.run(origins, directions, limit)
            self.cast_s += perf_counter() - start
            hit = found['primID'] >= 0
            distance[hit] = found['tfar'][hit]
            normal[hit] = found['Ng'][hit]
            face[hit] = -1
            instance[hit] = owner[found['primID'][hit]]
        return Trace(distance, instance, _facing(normal, directions), face)

    def _posed_movers(self, time_s: float) -> tuple[_Triangles, NDArray[np.uint16]]:
        """Movers' triangles at a time and the instance of each; the last few times are kept."""
        if time_s not in self._moving:
            meshes = [m.mesh_at(time_s) for m in self.scene.movers]
            owners = [np.full(len(m.faces), k + 1, np.uint16) for k, m in enumerate(meshes)]
            start = perf_counter()
            triangles = _Triangles(merge(meshes))
            self.cast_s += perf_counter() - start
            while len(self._moving) >= _KEPT_TIMES:
                del self._moving[next(iter(self._moving))]
            self._moving[time_s] = (triangles, np.concatenate(owners))
        return self._moving[time_s]


def _facing(normal: F32, directions: F32) -> F32:
    """Unit normals turned against the rays; zeros stay zero."""
    dot = np.einsum('ij,ij->i', normal, directions)
    norm = np.sqrt(np.einsum('ij,ij->i', normal, normal))
    scale = np.where(dot > 0.0, -1.0, 1.0) / np.maximum(norm, 1e-20)
    facing: F32 = (normal * scale[:, None]).astype(np.float32)
    return facing

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Rays into a scene: the static part is built once, the movers once per time (Embree)."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from time import thread_time
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.core.errors import DependencyError
from hybridreg_ros.data.meshes.scene import Hits, Scene, Standing, merge

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

    from hybridreg_ros.data.meshes.scene import Mesh, Mover

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


@dataclass
class CastClock:
    """What ray casting has cost this process so far.

    Attributes:
        seconds: processor time inside Embree, building and querying.
        rays: number of rays.
    """

    seconds: float = 0.0
    rays: int = 0


CLOCK = CastClock()


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
        start = thread_time()
        self._scene: Any = EmbreeScene()
        # Given as an index, since embreex copies number by number: half as many as corners.
        TriangleMesh(
            self._scene,
            np.ascontiguousarray(mesh.vertices, np.float32),
            np.ascontiguousarray(mesh.faces, np.int32),
        )
        # Embree commits at the first query: pay for it here, not in the first image.
        self._scene.run(np.zeros((1, 3), np.float32), np.eye(1, 3, dtype=np.float32))
        CLOCK.seconds += thread_time() - start

    def run(self, origins: F32, directions: F32, limit: F32) -> dict[str, Any]:
        start = thread_time()
        result: dict[str, Any] = self._scene.run(origins, directions, dists=limit, output=1)
        CLOCK.seconds += thread_time() - start
        CLOCK.rays += len(origins)
        return result


class Caster:
    """Casts rays into a `Scene` at any time."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._static = _Triangles(scene.static) if len(scene.static.faces) else None
        self._labels = np.array([0, *(int(m.label) for m in scene.movers)], np.uint8)
        self._moving: dict[float, Posed] = {}

    def halted(self, moves: NDArray[np.bool_], times_s: ArrayLike) -> Caster:
        """The same scene in which only some movers (K,) move and the others stand.

        Args:
            moves: which move.
            times_s: when the pose of each (K,) was as it now stays; one time for all will do.
        """
        twin = copy(self)
        times = np.broadcast_to(np.asarray(times_s, np.float64), moves.shape).tolist()
        movers = zip(self.scene.movers, moves, times, strict=True)
        twin.scene = Scene(
            self.scene.static, tuple(m if go else Standing(m, t) for m, go, t in movers)
        )
        twin._labels = np.where(np.append(True, moves), self._labels, np.uint8(0))
        # At a time that is common to all, nothing is elsewhere than in this scene.
        same = times[0] if len(set(times)) == 1 else None
        twin._moving = {t: posed for t, posed in self._moving.items() if t == same}
        return twin

    def peopled(self, movers: tuple[Mover, ...]) -> Caster:
        """The same static part with other movers."""
        twin = copy(self)
        twin.scene = Scene(self.scene.static, movers)
        twin._labels = np.array([0, *(int(m.label) for m in movers)], np.uint8)
        twin._moving = {}
        return twin

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
        face = np.full(n, -1, np.int32)
        instance = np.zeros(n, np.uint16)
        normal = np.zeros((n, 3), np.float32)
        reach = np.full(n, _FAR_M, np.float32)
        if self._static is not None:
            found = self._static.run(origins, directions, reach)
            face, normal = found['primID'], found['Ng']
            reach = np.where(face >= 0, found['tfar'], _FAR_M)
        if movers and self.scene.movers:
            posed = self._posed_movers(time_s)
            found = posed.triangles.run(origins, directions, reach)
            rows = np.flatnonzero(found['primID'] >= 0)
            reach[rows] = found['tfar'][rows]
            normal[rows] = found['Ng'][rows]
            face[rows] = -1
            instance = posed.owner[found['primID']]
        miss = reach >= _FAR_M
        distance = np.where(miss, np.float32(np.inf), reach)
        normal[miss] = 0.0
        return Trace(distance, instance, _facing(normal, directions), face)

    def _posed_movers(self, time_s: float) -> Posed:
        """The movers at a time; the last few times are kept."""
        if time_s not in self._moving:
            meshes = [m.mesh_at(time_s) for m in self.scene.movers]
            posed = Posed(meshes)
            while len(self._moving) >= _KEPT_TIMES:
                del self._moving[next(iter(self._moving))]
            self._moving[time_s] = posed
        return self._moving[time_s]


class Posed:
    """Some meshes by themselves.

    Attributes:
        triangles: of all of them.
        owner: (F + 1,) uint16 number of the mesh of each triangle, from 1; the last is 0.
    """

    def __init__(self, meshes: Sequence[Mesh]) -> None:
        owners = [np.full(len(m.faces), k + 1, np.uint16) for k, m in enumerate(meshes)]
        self.owner = np.append(np.concatenate(owners), np.uint16(0))
        self.triangles = _Triangles(merge(meshes))

    def trace(self, origins: F32, directions: F32) -> Trace:
        """Nearest hit of rays (R, 3), unit directions; `face` is -1 throughout."""
        origins, directions = np.ascontiguousarray(origins), np.ascontiguousarray(directions)
        found = self.triangles.run(origins, directions, np.full(len(origins), _FAR_M, np.float32))
        miss = found['primID'] < 0
        return Trace(
            np.where(miss, np.float32(np.inf), found['tfar']),
            self.owner[found['primID']],
            _facing(np.where(miss[:, None], np.float32(0.0), found['Ng']), directions),
            np.full(len(miss), -1, np.int32),
        )


def _facing(normal: F32, directions: F32) -> F32:
    """Unit normals turned against the rays; zeros stay zero."""
    dot = np.einsum('ij,ij->i', normal, directions)
    norm = np.sqrt(np.einsum('ij,ij->i', normal, normal))
    scale = np.copysign(np.float32(1.0), -dot) / np.maximum(norm, np.float32(1e-20))
    facing: F32 = normal * scale[:, None]
    return facing

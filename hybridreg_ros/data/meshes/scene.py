# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Scene: static triangles plus things that move, and rays cast into both (Embree)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np

from hybridreg_ros.data.pair import Label

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles.

    Attributes:
        vertices: (V, 3) float32, metres.
        faces: (F, 3) int32 rows of `vertices`.
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]


def merge(meshes: Sequence[Mesh]) -> Mesh:
    """One mesh of many; vertices are not shared between them."""
    if not meshes:
        return Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32))
    offsets = np.cumsum([0, *(len(m.vertices) for m in meshes[:-1])])
    return Mesh(
        np.concatenate([m.vertices for m in meshes]).astype(np.float32),
        np.concatenate([m.faces + o for m, o in zip(meshes, offsets, strict=True)]).astype(
            np.int32
        ),
    )


class Mover(Protocol):
    """Something that moves or deforms; its instance number is its place in the scene plus one."""

    @property
    def label(self) -> Label:
        """MOVING_RIGID or DEFORMING."""

    def mesh_at(self, time_s: float) -> Mesh:
        """World-frame triangles at a time (seconds from the start of the scene).

        Topology (faces, vertex order) must not depend on the time, so that vertex displacement
        between two times is well defined.
        """


@dataclass(frozen=True, eq=False)
class Standing:
    """A mover that stands as at one time for ever; it belongs to the background.

    Attributes:
        mover: what stands.
        since_s: the time whose pose it keeps, seconds.
        label: STATIC.
    """

    mover: Mover
    since_s: float
    label: Label = Label.STATIC

    def mesh_at(self, time_s: float) -> Mesh:
        """The same triangles at every time."""
        return self._mesh

    @cached_property
    def _mesh(self) -> Mesh:
        return self.mover.mesh_at(self.since_s)


@dataclass(frozen=True, eq=False)
class Scene:
    """A world: z up, metres.

    Attributes:
        static: everything that never moves.
        movers: everything that may; instance id of mover k is k + 1.
    """

    static: Mesh
    movers: tuple[Mover, ...] = ()


@dataclass(frozen=True, eq=False)
class Hits:
    """Result of casting R rays.

    Attributes:
        distance: (R,) float32 along the unit direction, metres; inf = nothing hit.
        instance: (R,) uint16; 0 = static background.
        label: (R,) uint8 of `Label`.
        normal: (R, 3) float32 unit normal of the triangle hit, facing the ray; zeros at misses.
    """

    distance: NDArray[np.float32]
    instance: NDArray[np.uint16]
    label: NDArray[np.uint8]
    normal: NDArray[np.float32]

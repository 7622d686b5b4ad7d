# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Furnished rooms from a seed: shell, furniture, clutter on it and in mid-air."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.data.meshes.geometry import bounds, moved, rot_z, turned
from hybridreg_ros.data.meshes.scene import Mesh, merge
from hybridreg_ros.data.rooms.clutter import Boxes, ClutterPool, mid_air_spot
from hybridreg_ros.data.rooms.floor import FloorGrid, Plan, random_plan
from hybridreg_ros.data.rooms.furniture_fittings import FAMILIES
from hybridreg_ros.data.rooms.shell import Part, build_shell

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.data.rooms.furniture import Piece

    F64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Movable:
    """Something in the room that people shift: its triangles and where it stands.

    Attributes:
        mesh: own frame, standing on z = 0 about the origin, metres.
        at: (3,) place in the room.
        yaw_rad: turn about z.
    """

    mesh: Mesh
    at: F64
    yaw_rad: float

    def placed(self) -> Mesh:
        """Triangles in the room frame."""
        return turned(self.mesh, self.yaw_rad, self.at)


@dataclass(eq=False)
class Room:
    """A furnished room, z up, floor at z = 0, metres.

    Attributes:
        plan: outline and height.
        floor: what is free on the floor.
        parts: everything that never moves.
        movable: furniture and clutter that may be moved; not in `parts`.
        boxes: bounds of everything placed, for things in mid-air.
        pool: shapes for clutter.
        focus: (K, 3) centres of the furniture, for choosing views.
    """

    plan: Plan
    floor: FloorGrid
    pool: ClutterPool
    parts: list[Part] = field(default_factory=list)
    movable: list[Movable] = field(default_factory=list)
    boxes: Boxes = field(default_factory=Boxes)
    focus: list[F64] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class Background:
    """The static triangles of a room with what the sensor needs to know about each.

    Attributes:
        mesh: all static triangles.
        plane: (F,) int32 number of the large plane of each triangle, 0 for none.
        loss: (F,) float32 share of rays that never return.
    """

    mesh: Mesh
    plane: NDArray[np.int32]
    loss: NDArray[np.float32]


def background(parts: list[Part], kept: list[Movable]) -> Background:
    """Merge the static parts and the movable things that stay where they are."""
    parts = parts + [Part(m.placed()) for m in kept]
    counts = [len(p.mesh.faces) for p in parts]
    return Background(
        merge([p.mesh for p in parts]),
        np.repeat(np.array([p.plane for p in parts], np.int32), counts),
        np.repeat(np.array([p.loss for p in parts], np.float32), counts),
    )


def make_room(rng: np.random.Generator, kind: str | None = None) -> Room:
    """Build a random furnished room.

    Args:
        rng: source of everything random.
        kind: room, corridor, office, hall, or None for a random one.
    """
    plan = random_plan(rng, kind)
    room = Room(plan, FloorGrid(plan.outline), ClutterPool(rng))
    room.parts = build_shell(rng, plan)
    _furnish(rng, room)
    _hang_in_air(rng, room)
    return room


def _area(outline: F64) -> float:
    x, y = outline.T
    return float(0.5 * abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def _furnish(rng: np.random.Generator, room: Room) -> None:
    """Place furniture until the room is as full as this room is meant to be."""
    names = list(FAMILIES)
    taste = np.array([FAMILIES[n][1] for n in names]) * rng.exponential(1.0, len(names)) ** 0.7
    taste /= taste.sum()
    wanted = int(np.clip(_area(room.plan.outline) * rng.uniform(0.35, 1.1), 5, 42))
    models: dict[str, list[Piece]] = {}
    for name in rng.choice(names, size=wanted, p=taste):
        known = models.setdefault(str(name), [])
        if known and rng.random() < min(0.75, 0.35 * len(known)):
            piece = known[rng.integers(len(known))]
        else:
            piece = FAMILIES[str(name)][0](rng)
            known.append(piece)
        placed = _place(rng, room, piece)
        if placed and name in ('table', 'desk') and rng.random() < 0.75:
            _seats_around(rng, room, piece, models)


def _place(rng: np.random.Generator, room: Room, piece: Piece, tries: int = 8) -> bool:
    """Put a piece at a free place: at a wall or anywhere; False when there was none."""
    low, high = bounds(piece.mesh)
    hangs = low[2] > 0.5
    for _ in range(tries):
        at, yaw = _wall_spot(rng, room, -low[1]) if piece.wall else _open_spot(rng, room)
        if hangs:
            if not room.boxes.free(np.array([*at, 1.6]), 0.3):
                continue
        elif not room.floor.fits(low[:2], high[:2], at, yaw):
            continue
        _install(rng, room, piece, at, yaw)
        return True
    return False


def _wall_spot(rng: np.random.Generator, room: Room, back_m: float) -> tuple[F64, float]:
    """A place along a random wall, the +y side of the piece facing into the room."""
    corners = room.plan.outline
    lengths = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    k = rng.choice(len(corners), p=lengths / lengths.sum())
    a, b = corners[k], corners[(k + 1) % len(corners)]
    along = (b - a) / lengths[k]
    gap = back_m + 0.04 + (rng.uniform(0.0, 0.25) if rng.random() < 0.3 else 0.0)
    at = a + rng.uniform(0.05, 0.95) * (b - a) + gap * np.array([-along[1], along[0]])
    wobble = float(rng.normal(0.0, 0.03)) if rng.random() < 0.4 else 0.0
    return at, float(np.arctan2(along[1], along[0])) + wobble


def _open_spot(rng: np.random.Generator, room: Room) -> tuple[F64, float]:
    """A place anywhere, mostly square to the walls."""
    low, high = room.plan.outline.min(0), room.plan.outline.max(0)
    yaw = float(rng.integers(4) * 0.5 * np.pi + rng.normal(0.0, 0.08))
    if rng.random() < 0.35:
        yaw = float(rng.uniform(0.0, 2.0 * np.pi))
    return rng.uniform(low, high), yaw


def _install(rng: np.random.Generator, room: Room, piece: Piece, at: F64, yaw: float) -> None:
    """Enter a piece and the clutter on it into the room."""
    low, high = bounds(piece.mesh)
    place = np.array([*at, 0.0])
    clutter: list[tuple[Mesh, F64]] = []
    for surface in piece.surfaces:
        if rng.random() < 0.85:
            clutter += room.pool.on_surface(rng, surface, int(rng.integers(1, 8)))
    if piece.movable:
        mesh = merge([piece.mesh, *(mesh for mesh, _ in clutter)])
        room.movable.append(Movable(mesh, place, yaw))
        placed = room.movable[-1].placed()
    else:
        loss = rng.uniform(0.2, 0.9) if rng.random() < 0.06 else 0.0
        placed = turned(piece.mesh, yaw, place)
        room.parts.append(Part(placed, 0, loss))
        for mesh, spot in clutter:
            if rng.random() < 0.5:
                room.parts.append(Part(turned(mesh, yaw, place)))
            else:
                there = place + rot_z(yaw) @ spot
                room.movable.append(Movable(moved(mesh, -spot), there, yaw))
    room.boxes.add([placed, *(turned(mesh, yaw, place) for mesh, _ in clutter)])
    if low[2] < 0.5:
        room.floor.take(low[:2], high[:2], at, yaw, float(high[2]))
    room.focus.append(np.array([*at, 0.5 * float(low[2] + high[2])]))


def _seats_around(
    rng: np.random.Generator, room: Room, piece: Piece, models: dict[str, list[Piece]]
) -> None:
    """Put chairs of one model around the table or desk that was placed last."""
    chairs = models.setdefault('chair', [])
    if not chairs or rng.random() < 0.4:
        chairs.append(FAMILIES['chair'][0](rng))
    chair = chairs[-1]
    centre, low, high = room.focus[-1][:2], *bounds(chair.mesh)
    reach = 0.5 * np.ptp(piece.mesh.vertices[:, :2], axis=0) + rng.uniform(0.05, 0.5)
    for angle in rng.uniform(0.0, 2.0 * np.pi, rng.integers(1, 7)):
        out = np.array([np.cos(angle), np.sin(angle)])
        at = centre + out * reach / max(np.abs(out))
        yaw = float(angle + 0.5 * np.pi + rng.normal(0.0, 0.3))
        if room.floor.fits(low[:2], high[:2], at, yaw, 0.0):
            _install(rng, room, chair, at, yaw)


def _hang_in_air(rng: np.random.Generator, room: Room) -> None:
    """Static free-form things in mid-air and on the floor."""
    wanted = int(_area(room.plan.outline) * rng.uniform(0.0, 0.6)) + int(rng.integers(0, 5))
    for _ in range(min(wanted, 24)):
        size = float(np.exp(rng.uniform(np.log(0.1), np.log(0.8))))
        spot = mid_air_spot(rng, room.floor, room.boxes, 0.5 * size)
        if spot is not None:
            mesh = room.pool.take(rng, size)
            room.parts.append(Part(moved(mesh, spot - [0.0, 0.0, 0.5 * size])))

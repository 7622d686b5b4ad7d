# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Cloth that waves and articulated things: curtains, flags, doors, fans, robot arms, suitcases."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.se3 import so3_exp, transform
from hybridreg_ros.data.bodies.loft import assemble, ball, loft
from hybridreg_ros.data.bodies.rig import Pose, Rig, RigidMover, SkinnedMover
from hybridreg_ros.data.bodies.track import KeyFrames, Way, loop_track
from hybridreg_ros.data.meshes.scene import Mesh
from hybridreg_ros.data.pair import Label

if TYPE_CHECKING:
    from numpy.typing import NDArray

    F64 = NDArray[np.float64]


def _heading(angle_rad: float) -> F64:
    return so3_exp(np.array([0.0, 0.0, angle_rad]))


@dataclass(frozen=True, eq=False)
class Cloth:
    """A sheet hanging from one edge, swinging and rippling.

    Attributes:
        rest: (V, 3) flat sheet in its own frame: x along the fixed edge, z up from 0 down.
        faces: (F, 3) int32.
        free: (V,) 0 at the fixed edge to 1 at the far edge.
        waves: (K, 5) amplitude (m), wave numbers along x and z (rad/m), rate (rad/s), phase.
        swing: (3,) amplitude (rad), rate (rad/s), phase of the swing about the fixed edge.
        draw: (3,) amplitude (share of the width), rate (rad/s), phase of being pushed together.
        T_world_cloth: (4, 4).
        kind: what it is.
        label: always DEFORMING.
    """

    rest: F64
    faces: NDArray[np.int32]
    free: F64
    waves: F64
    swing: F64
    draw: F64
    T_world_cloth: F64
    kind: str = 'cloth'
    label: Label = Label.DEFORMING

    def mesh_at(self, time_s: float) -> Mesh:
        """World-frame triangles at a time."""
        x, z = self.rest[:, 0], self.rest[:, 2]
        a, kx, kz, rate, phase = self.waves.T
        ripple = np.sin(np.outer(x, kx) + np.outer(z, kz) + rate * time_s + phase) @ a
        angle = self.swing[0] * np.sin(self.swing[1] * time_s + self.swing[2])
        lean = angle * (0.35 + 0.65 * self.free)
        pushed = 1.0 - self.draw[0] * (0.5 + 0.5 * np.sin(self.draw[1] * time_s + self.draw[2]))
        y = ripple * (0.15 + 0.85 * self.free) - z * np.sin(lean)
        points = np.stack([x * pushed, y, z * np.cos(lean)], axis=1)
        T = self.T_world_cloth
        return Mesh((points @ T[:3, :3].T + T[:3, 3]).astype(np.float32), self.faces)


def make_cloth(
    rng: np.random.Generator,
    anchor: F64,
    heading_rad: float = 0.0,
    *,
    width_m: float | None = None,
    height_m: float | None = None,
    gust: float | None = None,
) -> Cloth:
    """Build a hanging sheet (curtain, laundry, banner) that waves for ever.

    Args:
        rng: source of size, folds and wind.
        anchor: (3,) one upper corner, world frame, metres; the sheet hangs down from it.
        heading_rad: direction of its upper edge.
        width_m: length of the upper edge; random by default.
        height_m: drop; random by default.
        gust: strength of the wind, 0 = still, 1 = strong; random by default.
    """
    width = float(rng.uniform(0.7, 2.6)) if width_m is None else width_m
    height = float(rng.uniform(0.6, 2.2)) if height_m is None else height_m
    force = float(rng.uniform(0.4, 1.0)) if gust is None else gust
    columns, rows = max(int(width / 0.06), 6), max(int(height / 0.09), 6)
    x, z = np.meshgrid(np.linspace(0, width, columns), -np.linspace(0, height, rows))
    rest = np.stack([x.ravel(), np.zeros(x.size), z.ravel()], axis=1)
    k = np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)
    quads = [
        np.stack([k, k + columns, k + 1], -1),
        np.stack([k + 1, k + columns, k + columns + 1], -1),
    ]
    faces = np.concatenate([q.reshape(-1, 3) for q in quads]).astype(np.int32)
    count = 5
    folds = np.stack(
        [
            rng.uniform(0.015, 0.06, count),
            rng.uniform(4.0, 22.0, count),
            rng.uniform(-2.0, 2.0, count),
            rng.uniform(0.2, 1.5, count),
            rng.uniform(0.0, 6.3, count),
        ],
        axis=1,
    )
    gusts = np.stack(
        [
            rng.uniform(0.03, 0.16, 3) * force * height,
            rng.uniform(0.5, 3.0, 3),
            rng.uniform(-3.0, 3.0, 3),
            rng.uniform(1.5, 5.0, 3),
            rng.uniform(0.0, 6.3, 3),
        ],
        axis=1,
    )
    swing = np.array([rng.uniform(0.3, 0.8) * force, rng.uniform(1.0, 2.6), rng.uniform(0, 6.3)])
    draw = np.array([rng.uniform(0.0, 0.6), rng.uniform(0.4, 1.3), rng.uniform(0.0, 6.3)])
    T = transform(_heading(heading_rad), np.asarray(anchor, dtype=np.float64))
    return Cloth(rest, faces, -z.ravel() / height, np.concatenate([folds, gusts]), swing, draw, T)


def make_door(
    rng: np.random.Generator,
    hinge: F64,
    heading_rad: float = 0.0,
    *,
    width_m: float | None = None,
    height_m: float | None = None,
) -> RigidMover:
    """Build a door leaf with a handle that swings about its hinge.

    Args:
        rng: source of size, panels and swing.
        hinge: (3,) lower end of the hinge line, world frame, metres.
        heading_rad: direction of the closed leaf.
        width_m: width of the leaf; random by default.
        height_m: height of the leaf; random by default.
    """
    w = float(rng.uniform(0.65, 1.0)) if width_m is None else width_m
    h = float(rng.uniform(1.9, 2.15)) if height_m is None else height_m
    parts = [ball([w / 2, 0, h / 2], [w / 2, 0.02, h / 2], 0, square=40.0, rings=6, sides=16)]
    for side in (1.0, -1.0):
        parts.append(ball([0.92 * w, 0.05 * side, 1.0], [0.07, 0.012, 0.012], 0, rings=4, sides=6))
        parts += [
            ball([w / 2, 0.02 * side, z], [0.36 * w, 0.012, 0.1 * h], 0, square=12.0)
            for z in rng.uniform(0.2, 0.8, rng.integers(0, 4)) * h
        ]
    skin = assemble(parts)
    mesh = Mesh(skin.vertices.astype(np.float32), skin.faces.astype(np.int32))
    half, rate = rng.uniform(0.35, 0.75), rng.uniform(0.8, 2.0)
    phase, base = rng.uniform(0.0, 6.3), heading_rad + rng.choice([-1.0, 1.0]) * rng.uniform(0, 1)
    place = np.asarray(hinge, dtype=np.float64)

    def pose_at(time_s: float) -> F64:
        return transform(_heading(base + half * np.sin(rate * time_s + phase)), place)

    return RigidMover(mesh, pose_at, 'door')


def make_suitcase(
    rng: np.random.Generator,
    start: F64,
    heading_rad: float = 0.0,
    *,
    track: Way | None = None,
    speed_mps: float | None = None,
    reach_m: float = 1.2,
) -> RigidMover:
    """Build a suitcase, trolley or bin that rolls along a track.

    Args:
        rng: source of shape and speed.
        start: (3,) ground below it at time 0, world frame, metres.
        heading_rad: first heading.
        track: its path; by default a closed loop within 2 `reach_m` of start.
        speed_mps: rolling speed; random by default.
        reach_m: half extent of that loop, metres.
    """
    size = rng.uniform([0.12, 0.18, 0.22], [0.3, 0.35, 0.55])
    lift = 0.04
    body = ball([0, 0, size[2] + lift], size, 0, square=rng.uniform(4, 12), rings=10, sides=16)
    parts = [body]
    top = 2 * size[2] + lift
    grip = rng.uniform(0.15, 0.45)
    for y in (-0.4, 0.4):
        parts.append(
            ball(
                [-0.7 * size[0], y * size[1], top + grip / 2],
                [0.012, 0.012, grip / 2],
                0,
                rings=4,
                sides=6,
            )
        )
        parts.append(ball([0, 2 * y * size[1], lift], [0.04, 0.02, 0.04], 0, rings=5, sides=8))
    parts.append(
        ball([-0.7 * size[0], 0, top + grip], [0.015, 0.45 * size[1], 0.015], 0, rings=4, sides=6)
    )
    skin = assemble(parts)
    mesh = Mesh(skin.vertices.astype(np.float32), skin.faces.astype(np.int32))
    place = np.asarray(start, dtype=np.float64)
    path = track or loop_track(rng, place, heading_rad, reach_m)
    speed = float(rng.uniform(0.5, 1.5)) if speed_mps is None else speed_mps

    def pose_at(time_s: float) -> F64:
        xy, heading = path.at(speed * time_s)
        return transform(_heading(heading), np.array([xy[0], xy[1], place[2]]))

    return RigidMover(mesh, pose_at, 'suitcase')


@dataclass(frozen=True, eq=False)
class _Machine:
    """Motion of an articulated machine: key poses about a fixed foot.

    Attributes:
        keys: angles (J, 3), radians.
        spin: (J, 3) constant rates added to the keys, rad/s.
        place: (3,) its foot, world frame, metres.
        heading_rad: turn about z.
    """

    keys: KeyFrames
    spin: F64
    place: F64
    heading_rad: float

    def __call__(self, time_s: float) -> Pose:
        return Pose(self.keys.at(time_s) + self.spin * time_s, self.place, self.heading_rad)


def make_robot_arm(
    rng: np.random.Generator, start: F64, heading_rad: float = 0.0, *, size_m: float | None = None
) -> SkinnedMover:
    """Build an arm of four links on a foot (robot, crane, excavator, desk lamp).

    Args:
        rng: source of proportions and motion.
        start: (3,) its foot, world frame, metres.
        heading_rad: turn about z.
        size_m: length of the stretched arm; random by default.
    """
    size = float(rng.uniform(0.5, 1.8)) if size_m is None else size_m
    share = rng.dirichlet([3.0, 6.0, 6.0, 2.5]) * size
    z = np.concatenate([[0.0], np.cumsum(share)])
    joints = np.zeros((5, 3))
    joints[1:, 2] = z[:4]
    thick = rng.uniform(0.035, 0.09) * size
    parts = [ball([0, 0, 0.35 * thick], [2.2 * thick, 2.2 * thick, 0.35 * thick], 0, square=4.0)]
    for k in range(4):
        r = thick * (1.0 - 0.2 * k)
        parts.append(
            loft(
                [[0, 0, z[k]], [0, 0, z[k + 1]]],
                [[r, r], [0.7 * r, 0.8 * r], [r, r]],
                [k + 1],
                rings=7,
                sides=10,
                square=rng.uniform(2, 6),
            )
        )
        parts.append(ball([0, 0, z[k]], [1.3 * r, 1.5 * r, 1.3 * r], k + 1, rings=6, sides=10))
    tool = rng.uniform(0.6, 1.6) * thick
    parts.append(ball([0, 0, z[4]], [tool, 2.0 * tool, tool], 4, square=5.0, rings=6))
    spread = np.array([[0, 0, 0], [0, 0, 1.6], [0.1, 0.7, 0.2], [0.1, 1.0, 0.2], [0.5, 0.8, 1.0]])
    keys = rng.normal(0.0, 1.0, (32, 5, 3)) * spread
    keys[:, 2, 1] = np.clip(keys[:, 2, 1], -1.1, 1.1)
    motion = _Machine(
        KeyFrames(keys, float(rng.uniform(0.6, 1.4))),
        np.zeros((5, 3)),
        np.asarray(start, dtype=np.float64),
        heading_rad,
    )
    rig = Rig((-1, 0, 1, 2, 3), joints, assemble(parts), np.array([0]), np.zeros((1, 3)))
    return SkinnedMover(rig, motion, 0.0, 'robot arm')


def make_fan(
    rng: np.random.Generator, start: F64, heading_rad: float = 0.0, *, size_m: float | None = None
) -> SkinnedMover:
    """Build a standing fan whose blades turn while its head swings.

    Args:
        rng: source of proportions and motion.
        start: (3,) its foot, world frame, metres.
        heading_rad: turn about z.
        size_m: height of the hub; random by default.
    """
    h = float(rng.uniform(0.4, 1.4)) if size_m is None else size_m
    r = float(rng.uniform(0.16, 0.35)) * max(h, 0.6)
    joints = np.array([[0, 0, 0], [0, 0, h], [0.1, 0, h]], dtype=np.float64)
    parts = [
        ball([0, 0, 0.03], [0.5 * r + 0.08, 0.5 * r + 0.08, 0.03], 0, square=3.0, rings=5),
        loft([[0, 0, 0], [0, 0, h]], [[0.025, 0.025]] * 2, [0], rings=6, sides=8),
        ball([0, 0, h], [0.12, 0.07, 0.07], 1),
        ball([0.13, 0, h], [0.03, 0.05, 0.05], 2, rings=5),
    ]
    blades = int(rng.integers(3, 6))
    for k in range(blades):
        phi = 2.0 * np.pi * k / blades
        tip = [0.13, r * np.cos(phi), h + r * np.sin(phi)]
        side = (0.4, float(-np.sin(phi)), float(np.cos(phi)))
        wide = [[0.03, 0.008], [0.3 * r, 0.008], [0.28 * r, 0.008]]
        parts.append(loft([[0.13, 0, h], tip], wide, [2], rings=6, sides=8, side_axis=side))
    keys = np.zeros((8, 3, 3))
    keys[:, 1, 2] = rng.normal(0.0, 0.8, 8)
    keys[:, 1, 1] = rng.normal(0.0, 0.15)
    spin = np.zeros((3, 3))
    spin[2, 0] = rng.uniform(3.0, 14.0)
    motion = _Machine(
        KeyFrames(keys, float(rng.uniform(1.0, 2.0))),
        spin,
        np.asarray(start, dtype=np.float64),
        heading_rad,
    )
    rig = Rig((-1, 0, 1), joints, assemble(parts), np.array([0]), np.zeros((1, 3)))
    return SkinnedMover(rig, motion, 0.0, 'fan')

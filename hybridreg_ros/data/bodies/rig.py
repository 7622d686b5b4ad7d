# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Skeletons, poses and linear blend skinning: what moves a body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.se3 import apply
from hybridreg_ros.data.meshes.scene import Mesh
from hybridreg_ros.data.pair import Label

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    F64 = NDArray[np.float64]
    I64 = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Pose:
    """Where a skeleton stands and how it is bent.

    Attributes:
        angles: (J, 3) roll, pitch, yaw of each bone in its parent's frame, radians.
        place: (3,) world point on the ground below the root, metres.
        heading_rad: turn of the whole body about z.
    """

    angles: F64
    place: F64
    heading_rad: float


@dataclass(frozen=True, eq=False)
class Part:
    """A piece of skin in the rest pose, each vertex held by two bones.

    Attributes:
        vertices: (V, 3) float64, rest frame, metres.
        faces: (F, 3) int64.
        bone_a: (V,) int64.
        bone_b: (V,) int64.
        weight_b: (V,) float64, share of bone_b; bone_a has the rest.
        rings: rings of vertices and vertices of a ring, of a tube; (0, 0) for other skins.
    """

    vertices: F64
    faces: I64
    bone_a: I64
    bone_b: I64
    weight_b: F64
    rings: tuple[int, int] = (0, 0)


@dataclass(frozen=True, eq=False)
class Rig:
    """A skeleton with skin.

    Attributes:
        parents: parent of each bone, -1 for the root (bone 0); parents come first.
        joints: (J, 3) joint of each bone in the rest frame, metres.
        skin: the whole skin.
        contacts: (C,) bone of each point that may touch the ground.
        contact_points: (C, 3) those points, rest frame, metres.
    """

    parents: tuple[int, ...]
    joints: F64
    skin: Part
    contacts: I64
    contact_points: F64


def euler(angles: F64) -> F64:
    """Rotations (J, 3, 3) = Rz(yaw) Ry(pitch) Rx(roll) of angles (J, 3), radians."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(angles).T, np.sin(angles).T
    rows = [
        [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
        [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
        [-sy, cy * sx, cy * cx],
    ]
    R: F64 = np.moveaxis(np.array(rows), 2, 0)
    return R


def bone_transforms(rig: Rig, angles: F64) -> tuple[F64, F64]:
    """Rotations (J, 3, 3) and translations (J, 3) that carry rest points to the posed body."""
    local = euler(angles)
    R, t = np.empty_like(local), np.empty_like(rig.joints)
    for j, parent in enumerate(rig.parents):
        if parent < 0:
            R[j], at = local[j], rig.joints[j]
        else:
            R[j] = R[parent] @ local[j]
            at = R[parent] @ rig.joints[j] + t[parent]
        t[j] = at - R[j] @ rig.joints[j]
    return R, t


def pose_skin(rig: Rig, pose: Pose) -> NDArray[np.float32]:
    """World vertices (V, 3) of a rig in a pose, set down so that it just touches the ground."""
    R, t = bone_transforms(rig, pose.angles)
    touch = np.einsum('ci,ci->c', R[rig.contacts, 2], rig.contact_points) + t[rig.contacts, 2]
    c, s = np.cos(pose.heading_rad), np.sin(pose.heading_rad)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    t = t - np.array([rig.joints[0, 0], rig.joints[0, 1], touch.min()])
    R, t = turn @ R, t @ turn.T + pose.place
    skin = rig.skin
    a = np.einsum('vij,vj->vi', R[skin.bone_a], skin.vertices) + t[skin.bone_a]
    b = np.einsum('vij,vj->vi', R[skin.bone_b], skin.vertices) + t[skin.bone_b]
    blended: NDArray[np.float32] = (a + skin.weight_b[:, None] * (b - a)).astype(np.float32)
    return blended


@dataclass(frozen=True, eq=False)
class SkinnedMover:
    """A deforming body: a rig and its motion.

    Attributes:
        rig: skeleton and skin.
        motion: pose as a function of the time in seconds.
        speed_mps: walking speed, 0 for a body that stays.
        kind: what it is, for pictures and logs.
        label: always DEFORMING.
    """

    rig: Rig
    motion: Callable[[float], Pose]
    speed_mps: float = 0.0
    kind: str = 'body'
    label: Label = Label.DEFORMING

    def mesh_at(self, time_s: float) -> Mesh:
        """World-frame triangles at a time; the topology never changes."""
        return Mesh(pose_skin(self.rig, self.motion(time_s)), self.rig.skin.faces)  # type: ignore[arg-type]


@dataclass(frozen=True, eq=False)
class RigidMover:
    """A rigid thing on a path.

    Attributes:
        mesh: triangles in the object's own frame.
        pose_at: T_world_object (4, 4) as a function of the time in seconds.
        kind: what it is, for pictures and logs.
        label: always MOVING_RIGID.
    """

    mesh: Mesh
    pose_at: Callable[[float], F64]
    kind: str = 'object'
    label: Label = Label.MOVING_RIGID

    def mesh_at(self, time_s: float) -> Mesh:
        """World-frame triangles at a time."""
        moved = apply(self.pose_at(time_s), self.mesh.vertices)
        return Mesh(moved.astype(np.float32), self.mesh.faces)

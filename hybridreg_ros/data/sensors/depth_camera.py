# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Depth camera: pinhole rays, and the faults of a real sensor on top of the true depth."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.data.meshes.raycast import Caster

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]


@dataclass(frozen=True)
class DepthNoise:
    """Faults of a depth camera; all zero gives a perfect one.

    Attributes:
        base_m: noise that does not depend on the depth (standard deviation), metres.
        quadratic: noise per squared depth, 1/metre.
        disparity: disparity steps at 1 m depth; depth is quantised to its inverse; 0 = not at all.
        warp: relative depth error that varies slowly over the image (standard deviation).
        grazing: cosine of incidence below which returns begin to fail.
        edge_loss: share of pixels beside a depth step that are lost.
        flying: share of pixels beside a depth step that lie between both surfaces.
        ragged: share of pixels that take the depth of a neighbour.
        patchy: share of pixels lost in patches.
        seed: of the slow error, which belongs to the device and not to the image.
    """

    base_m: float = 0.0
    quadratic: float = 0.0
    disparity: float = 0.0
    warp: float = 0.0
    grazing: float = 0.0
    edge_loss: float = 0.0
    flying: float = 0.0
    ragged: float = 0.0
    patchy: float = 0.0
    seed: int = 0

    def sigma_m(self, depth_m: NDArray[np.floating]) -> NDArray[np.floating]:
        """Standard deviation of the depth error at depths, metres."""
        sigma: NDArray[np.floating] = self.base_m + self.quadratic * depth_m**2
        step = depth_m**2 / self.disparity if self.disparity > 0.0 else 0.0
        total: NDArray[np.floating] = np.sqrt(
            sigma**2 + step**2 / 12.0 + (self.warp * depth_m) ** 2
        )
        return total


@dataclass(frozen=True, eq=False)
class DepthImage:
    """What a depth camera saw. All arrays are (height, width).

    Attributes:
        depth: float32 measured depth along the optical axis, metres; NaN = no return.
        clean: float32 true depth; inf = nothing there. Range limits do not apply to it.
        label: uint8 of `Label`.
        instance: uint16, 0 = static background.
        face: int32 triangle of the static mesh, -1 where there is none.
    """

    depth: F32
    clean: F32
    label: NDArray[np.uint8]
    instance: NDArray[np.uint16]
    face: NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class DepthCamera:
    """Pinhole depth camera; optical frame: z forward, x right, y down.

    Attributes:
        width: pixels.
        height: pixels.
        fx: focal length, pixels.
        fy: focal length, pixels.
        cx: principal point, pixels (centre of the first pixel = 0).
        cy: principal point, pixels.
        min_depth_m: nearest depth that is measured.
        max_depth_m: farthest depth that is measured.
        noise: its faults.
    """

    width: int = 640
    height: int = 480
    fx: float = 585.0
    fy: float = 585.0
    cx: float = 319.5
    cy: float = 239.5
    min_depth_m: float = 0.3
    max_depth_m: float = 6.0
    noise: DepthNoise = field(default_factory=DepthNoise)

    def strided(self, step: float) -> DepthCamera:
        """The same view with one pixel per `step` x `step` pixels."""
        w, h = round(self.width / step), round(self.height / step)
        sx, sy = w / self.width, h / self.height
        return DepthCamera(
            w,
            h,
            self.fx * sx,
            self.fy * sy,
            (self.cx + 0.5) * sx - 0.5,
            (self.cy + 0.5) * sy - 0.5,
            self.min_depth_m,
            self.max_depth_m,
            self.noise,
        )

    @cached_property
    def rays(self) -> F64:
        """Ray (H, W, 3) through each pixel, z = 1, optical frame."""
        u, v = np.meshgrid(np.arange(self.width), np.arange(self.height))
        x, y = (u - self.cx) / self.fx, (v - self.cy) / self.fy
        return np.stack([x, y, np.ones_like(x)], -1)

    @cached_property
    def _unit(self) -> tuple[F32, F32]:
        """Unit ray (H*W, 3) through each pixel, and its length (H*W,) at depth 1."""
        rays = self.rays.reshape(-1, 3)
        length = np.linalg.norm(rays, axis=1)
        return (rays / length[:, None]).astype(np.float32), length.astype(np.float32)

    @cached_property
    def _warp(self) -> F32:
        """Relative depth error (H, W) of the device."""
        rng = np.random.default_rng([self.noise.seed, 77])
        field = _smooth_field(rng, (self.height, self.width), (4, 5))
        return (self.noise.warp * field).astype(np.float32)

    def render(
        self,
        caster: Caster,
        time_s: float,
        T_world_camera: F64,
        rng: np.random.Generator,
        *,
        loss: F32 | None = None,
    ) -> DepthImage:
        """Take one image.

        Args:
            caster: the scene.
            time_s: time of the movers.
            T_world_camera: (4, 4) pose of the optical frame.
            rng: source of the noise.
            loss: (F,) share of rays lost per static triangle, or None.
        """
        shape = (self.height, self.width)
        unit, length = self._unit
        directions = unit @ T_world_camera[:3, :3].T.astype(np.float32)
        trace = caster.trace(time_s, T_world_camera[:3, 3].astype(np.float32), directions)
        clean = trace.distance / length
        incidence = np.abs(np.einsum('ij,ij->i', trace.normal, directions))
        lost = np.zeros(len(clean), np.bool_)
        if loss is not None:
            hit = trace.face >= 0
            lost[hit] = rng.random(int(hit.sum())) < loss[trace.face[hit]]
        depth, source = self._measure(
            clean.reshape(shape), incidence.reshape(shape), lost.reshape(shape), rng
        )
        instance = trace.instance[source]
        label = caster.labels(instance)
        return DepthImage(
            depth,
            clean.reshape(shape),
            label.reshape(shape),
            np.where(label > 0, instance, np.uint16(0)).reshape(shape),
            trace.face[source].reshape(shape),
        )

    def points(self, depth: F32) -> F32:
        """Points (H, W, 3) float32 of a depth image (H, W), optical frame; NaN stays NaN."""
        return (self.rays * depth[..., None]).astype(np.float32)

    def points_of(self, kept: NDArray[np.bool_], *depths: F32) -> tuple[F32, ...]:
        """Points (N, 3) float32 of the kept pixels (H, W) of each of some depth images (H, W)."""
        rows = np.flatnonzero(kept)
        rays = self.rays.reshape(-1, 3)[rows]
        return tuple((rays * depth.reshape(-1)[rows, None]).astype(np.float32) for depth in depths)

    def _measure(
        self, clean: F32, incidence: F32, lost: NDArray[np.bool_], rng: np.random.Generator
    ) -> tuple[F32, NDArray[np.int64]]:
        """Measured depth (H, W), and the flat pixel that each measurement truly shows."""
        n = self.noise
        source = np.arange(clean.size).reshape(clean.shape)
        z = np.where(np.isfinite(clean), clean, np.float32(1e3))
        near, far = _range3(z)
        edge = far - near > 0.04 + 0.05 * near
        if n.ragged > 0.0:
            source = _ragged(source, n.ragged, rng)
            z = z.reshape(-1)[source]
        chance = rng.random(z.shape, np.float32)
        if n.flying > 0.0:
            mix = rng.random(z.shape, np.float32)
            fly = edge & (chance < n.flying) & (far < 50.0)
            z = np.where(fly, near + mix * (far - near), z)
        bad = (edge & (chance > 1.0 - n.edge_loss)) | lost
        if n.grazing > 0.0:
            bad |= incidence < n.grazing * rng.random(z.shape, np.float32)
        if n.patchy > 0.0:
            shape = (z.shape[0] // 12 + 2, z.shape[1] // 12 + 2)
            patch = _smooth_field(rng, z.shape, shape)
            bad |= patch > np.quantile(patch[::4, ::4], 1.0 - n.patchy)
        if n.warp > 0.0:
            z = z * (1.0 + self._warp)
        if n.base_m > 0.0 or n.quadratic > 0.0:
            shape = (z.shape[0] // 4 + 2, z.shape[1] // 4 + 2)
            grain = 0.7 * rng.standard_normal(z.shape, np.float32)
            grain = grain + 0.7 * _smooth_field(rng, z.shape, shape)
            z = z + (n.base_m + n.quadratic * z**2) * grain
        if n.disparity > 0.0:
            z = n.disparity / np.maximum(np.round(n.disparity / np.maximum(z, 0.05)), 0.5)
        bad |= (z < self.min_depth_m) | (z > self.max_depth_m)
        return np.where(bad, np.nan, z).astype(np.float32), source.reshape(-1)


def random_camera(rng: np.random.Generator) -> DepthCamera:
    """A depth camera of random geometry, range and faults, 640 x 480."""
    f = 320.0 / np.tan(np.deg2rad(rng.uniform(52.0, 80.0)) / 2.0)
    noise = DepthNoise(
        base_m=float(rng.uniform(0.0003, 0.003)),
        quadratic=float(np.exp(rng.uniform(np.log(0.0004), np.log(0.003)))),
        disparity=float(rng.choice([0.0, np.exp(rng.uniform(np.log(300.0), np.log(3000.0)))])),
        warp=float(rng.uniform(0.0, 0.006)),
        grazing=float(rng.uniform(0.05, 0.35)),
        edge_loss=float(rng.uniform(0.1, 0.9)),
        flying=float(rng.uniform(0.0, 0.12)),
        ragged=float(rng.uniform(0.0, 0.6)),
        patchy=float(rng.choice([0.0, rng.uniform(0.0, 0.1)])),
        seed=int(rng.integers(2**31)),
    )
    return DepthCamera(
        fx=f,
        fy=f * rng.uniform(0.98, 1.02),
        cx=319.5 + rng.normal(0.0, 6.0),
        cy=239.5 + rng.normal(0.0, 6.0),
        min_depth_m=float(rng.uniform(0.2, 0.7)),
        max_depth_m=float(rng.uniform(3.5, 8.0)),
        noise=noise,
    )


def _range3(z: F32) -> tuple[F32, F32]:
    """Smallest and largest value of each 3 x 3 neighbourhood."""
    near, far = z.copy(), z.copy()
    for axis in (0, 1):
        a, b = near.copy(), far.copy()
        lower, upper = [slice(None)] * 2, [slice(None)] * 2
        lower[axis], upper[axis] = slice(None, -1), slice(1, None)
        for to, fro in ((tuple(lower), tuple(upper)), (tuple(upper), tuple(lower))):
            near[to] = np.minimum(near[to], a[fro])
            far[to] = np.maximum(far[to], b[fro])
    return near, far


def _ragged(
    source: NDArray[np.int64], share: float, rng: np.random.Generator
) -> NDArray[np.int64]:
    """Let a share of pixels look at a neighbouring pixel."""
    h, w = source.shape
    pick = rng.random(source.shape, np.float32)
    side = (pick * (2.0 / share)).astype(np.int64)
    v, u = source // w, source % w
    step = (pick * 997.0).astype(np.int64) % 2 * 2 - 1
    u = np.clip(u + np.where(side == 0, step, 0), 0, w - 1)
    v = np.clip(v + np.where(side == 1, step, 0), 0, h - 1)
    pixel: NDArray[np.int64] = v * w + u
    return pixel


def _smooth_field(rng: np.random.Generator, shape: tuple[int, ...], knots: tuple[int, int]) -> F64:
    """Random field (H, W) of unit spread, bilinear between knots."""
    value = rng.standard_normal(knots)
    for axis in (0, 1):
        at = np.linspace(0.0, knots[axis] - 1.000001, shape[axis])
        low = at.astype(int)
        s = at - low
        s = s.reshape(-1, 1) if axis == 0 else s.reshape(1, -1)
        a, b = np.take(value, low, axis), np.take(value, low + 1, axis)
        value = (a * (1.0 - s) + b * s) / np.sqrt((1.0 - s) ** 2 + s**2)
    return value

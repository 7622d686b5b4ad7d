# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""P(static) of every input point under a pose: what the static head reads, and what it says."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hybridreg_ros.core.jit import compiled, compiled_fast
from hybridreg_ros.model.geometry.sight import COUNT, looks
from hybridreg_ros.model.network.forward_attention import unit_rows
from hybridreg_ros.model.network.output import sigmoid

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hybridreg_ros.model.encoded import EncodedCloud
    from hybridreg_ros.model.geometry.pyramid import Pyramid
    from hybridreg_ros.model.network.forward import Network

    F32 = NDArray[np.float32]
    F64 = NDArray[np.float64]
    I32 = NDArray[np.int32]
    I64 = NDArray[np.int64]

UNKNOWN = 0.5
"""Both probabilities of a row that holds NaN or inf."""


class PointMask(NamedTuple):
    """Of every input point of a cloud, under a pose; the two stay apart.

    Attributes:
        static: (N,) float32 P(static). Where the other cloud did not look it is by what the point
            looks like and what is around it, and uncertain; 0.5 for a row with NaN or inf.
        seen: (N,) float32 P(the other sensor saw the place of the point).
    """

    static: F32
    seen: F32


class HeadInput(NamedTuple):
    """What the static head reads of one cloud (`StaticHead.forward`).

    Attributes:
        rows: (K,) int64 input points that all that follows is about.
        answer: (N,) int64 of every input point, the one of these that speaks for it; -1: none.
        looks: (K, COUNT + 2) float32.
        fine: (F, fine_dim) float32 unit features.
        owners: int64, the finest voxel of every point, then of every voxel the one above it.
    """

    rows: I64
    answer: I64
    looks: F32
    fine: F32
    owners: tuple[I64, ...]


def head_input(
    source: EncodedCloud, target: EncodedCloud, T_target_source: F64, most: int = 0
) -> HeadInput:
    """What the head reads of the source.

    Args:
        source: encoded cloud.
        target: encoded cloud, same voxel size.
        T_target_source: (4, 4), metres.
        most: points of a finest voxel that are looked at, and speak for the others; 0: all.
    """
    pyramid = source.encoding.pyramid
    owners = _owners(pyramid)
    rows, answer = _speakers(owners[0], len(owners[1]), most)
    own = source.sight if most == 0 else replace(source.sight, points=source.sight.points[rows])
    seen, nearest = looks(own, target.sight, T_target_source)
    if most == 0:
        seen, nearest = seen[rows], nearest[rows]
    fine, others = (unit_rows(c.encoding.fine_features) for c in (source, target))
    holder, other = _fine_points(pyramid)[rows], _fine_points(target.encoding.pyramid)
    seen[:, COUNT] = np.log(pyramid.voxel_size_m)
    _likeness(fine, holder, others, other, nearest, seen[:, COUNT + 1])
    owners[0] = owners[0][rows]
    return HeadInput(rows, answer, seen, fine, tuple(owners))


@compiled
def _speakers(owner: I64, voxels: int, most: int) -> tuple[I64, I64]:
    """Rows (K,) of at most so many points of each voxel (0: all), evenly out of their order.

    And which one speaks for each point (N,); -1 for one in no voxel.
    """
    total, seen = np.zeros(voxels, np.int64), np.zeros(voxels, np.int64)
    for v in owner:
        if v >= 0:
            total[v] += 1
    rows, answer = np.empty(len(owner), np.int64), np.full(len(owner), -1)
    spoken, count = np.full((voxels, max(most, 1)), -1), 0
    for i in range(len(owner)):
        v = owner[i]
        if v < 0:
            continue
        share = 0 if most == 0 else seen[v] * most // max(total[v], most)
        seen[v] += 1
        if most == 0 or spoken[v, share] < 0:
            rows[count], spoken[v, share] = i, count
            count += 1
        answer[i] = spoken[v, share]
    return rows[:count].copy(), answer


def _owners(pyramid: Pyramid) -> list[I64]:
    """The finest voxel of every input point (-1: none), then of every voxel the one above it."""
    above = [v.up_index for v in pyramid.levels if v.up_index is not None]
    return [pyramid.input_to_level0.astype(np.int64), *above]


def _fine_points(pyramid: Pyramid) -> I64:
    """The fine point (N,) of every input point; -1 where there is none."""
    holder, *others = _owners(pyramid)
    for above in others[: pyramid.fine_level]:
        holder = np.where(holder >= 0, above[holder], -1)
    return holder


@compiled_fast
def _likeness(fine: F32, holder: I64, others: F32, other: I64, nearest: I32, out: F32) -> None:
    """Dot product (N,) of the features of every point and its nearest one; left where none is."""
    for i in range(len(holder)):
        if holder[i] < 0 or nearest[i] < 0 or other[nearest[i]] < 0:
            continue
        a, b = fine[holder[i]], others[other[nearest[i]]]
        total = np.float32(0.0)
        for c in range(len(a)):
            total += a[c] * b[c]
        out[i] = total


def point_mask(
    net: Network,
    source: EncodedCloud,
    target: EncodedCloud,
    T_target_source: F64,
    most: int = 0,
) -> PointMask:
    """What the static head of a network says of the source; arguments as of `head_input`."""
    found = head_input(source, target, T_target_source, most)
    said = sigmoid(net.static_logits(found.looks, found.fine, found.owners)).T
    out = np.where(found.answer >= 0, said[:, found.answer], np.float32(UNKNOWN))
    return PointMask(*out)

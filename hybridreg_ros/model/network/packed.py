# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The weights of a network in one array, as the compiled forward pass reads them.

Matrix i of a pack lies at `flat[shape[i, 0] :]` with `shape[i, 1]` rows and `shape[i, 2]` columns;
no rows: the network has no such matrix. Vectors are matrices of one row. The order is that of
`backbone_matrices` and `transformer_matrices`, and the compiled functions count along it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import nn

from hybridreg_ros.core.jit import compiled
from hybridreg_ros.model.network.attention import CrossLayer, SelfLayer
from hybridreg_ros.model.network.backbone import Residual, Unary

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from hybridreg_ros.model.network.backbone import Backbone
    from hybridreg_ros.model.network.network import HybridRegNet

    F32 = NDArray[np.float32]
    I64 = NDArray[np.int64]
    Tensor = torch.Tensor
    Pack = tuple[F32, I64]

PER_UNARY = 3
"""Matrices of a `Unary`: linear layer, gain, bias."""
PER_BLOCK = 12
"""Matrices of a residual block: reduce, convolution with its norm, expand, shortcut."""
PER_ATTENTION = 13
"""Matrices of an attention layer, the last of them the rows of the geometry table per head."""


@dataclass(frozen=True, eq=False)
class Weights:
    """A network, packed.

    Attributes:
        backbone: stem (3), residual blocks (12 each), decoder but its last layer (3 each), last
            layer of the decoder and projection (2 each).
        transformer: self- and cross-attention of every block (13 each), cross-attention of the
            mask (13), its two layers (2 each), output (2).
        parameters: what they were made from.
        versions: of the parameters then.
    """

    backbone: Pack
    transformer: Pack
    parameters: tuple[nn.Parameter, ...]
    versions: tuple[int, ...]


@compiled
def matrix(flat: F32, shape: I64, i: int) -> F32:
    """Matrix i of a pack, (rows, columns) without a copy."""
    first, rows, columns = shape[i]
    return flat[first : first + rows * columns].reshape(rows, columns)


def weights_of(net: HybridRegNet) -> Weights:
    """The weights of a network, packed once and again only when one of them has changed."""
    known = net.__dict__.get('_packed')
    # The parameters are kept: to look for them in all modules would take 2 ms.
    if isinstance(known, Weights) and known.versions == _versions(known.parameters):
        return known
    parameters = tuple(net.parameters())
    with torch.no_grad():
        found = Weights(
            _pack(_backbone_matrices(net.backbone, net.project)),
            _pack(_transformer_matrices(net)),
            parameters,
            _versions(parameters),
        )
    net.__dict__['_packed'] = found
    return found


def _versions(parameters: tuple[nn.Parameter, ...]) -> tuple[int, ...]:
    """How often each was changed."""
    return tuple(p._version for p in parameters)


def _pack(matrices: Iterator[Tensor | None]) -> Pack:
    """Matrices and vectors one after the other; None leaves a place without rows."""
    parts, shape, size = [], [], 0
    for m in matrices:
        if m is None:
            shape.append((0, 0, 0))
            continue
        array = np.atleast_2d(m.detach().cpu().numpy().astype(np.float32))
        parts.append(np.ascontiguousarray(array).ravel())
        shape.append((size, *array.shape))
        size += array.size
    return np.concatenate(parts), np.array(shape, np.int64)


def _backbone_matrices(backbone: Backbone, project: nn.Linear) -> Iterator[Tensor | None]:
    yield backbone.stem.weight
    yield from (backbone.stem_norm.weight, backbone.stem_norm.bias)
    yield from _residual(backbone.first)
    for strided, stage in zip(backbone.strided, backbone.stages, strict=True):
        for block in (strided, *stage):  # type: ignore[misc]
            yield from _residual(block)
    for layer in backbone.decoder:
        if isinstance(layer, Unary):
            yield from _unary(layer)
        else:
            yield from _linear(layer)  # type: ignore[arg-type]
    yield from _linear(project)


def _residual(block: nn.Module) -> Iterator[Tensor | None]:
    assert isinstance(block, Residual)
    yield from _unary(block.reduce)
    yield from (block.conv.weight, block.norm.weight, block.norm.bias)
    yield from _unary(block.expand)
    yield from _unary(block.shortcut)


def _unary(layer: nn.Module) -> Iterator[Tensor | None]:
    """The matrices of a `Unary`, or three of none for an identity."""
    if not isinstance(layer, Unary):
        yield from (None, None, None)
        return
    yield from (layer.linear.weight.t(), layer.norm.weight, layer.norm.bias)


def _linear(layer: nn.Linear) -> Iterator[Tensor]:
    yield from (layer.weight.t(), layer.bias)


def _transformer_matrices(net: HybridRegNet) -> Iterator[Tensor | None]:
    table = net.table()
    for own, cross in zip(net.self_layers, net.cross_layers, strict=True):
        yield from _attention(own, table)
        yield from _attention(cross)
    yield from _attention(net.mask.cross)
    for layer in (net.mask.hidden, net.mask.output, net.output):
        yield from _linear(layer)


def _attention(layer: nn.Module, table: Tensor | None = None) -> Iterator[Tensor | None]:
    """Scaled queries, keys and values in one product, then the rest in its order."""
    assert isinstance(layer, SelfLayer | CrossLayer)
    scale = layer.width**-0.5
    q, k, v = layer.query, layer.key, layer.value
    yield torch.cat([q.weight * scale, k.weight, v.weight]).t()
    yield torch.cat([q.bias * scale, k.bias, v.bias])
    yield from _linear(layer.merge)
    yield from (layer.norm.weight, layer.norm.bias)
    yield from _linear(layer.feed.widen)
    yield from _linear(layer.feed.narrow)
    yield from (layer.feed.norm.weight, layer.feed.norm.bias)
    if table is None:
        yield None
    else:
        assert isinstance(layer, SelfLayer)
        # (heads * width, bins): the rows of one head are its own matrix
        W = layer.position.weight.view(layer.heads, layer.width, -1)
        yield torch.matmul(W, table.t()).flatten(0, 1)

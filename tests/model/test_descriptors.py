# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Descriptor matches: mutual, found again in any order, bounded."""

from __future__ import annotations

import torch

from hybridreg_ros.model.descriptors import evenly_spread, mutual_neighbours


def _features(count: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(count, 16, generator=torch.Generator().manual_seed(seed))


def test_shuffled_features_find_themselves() -> None:
    x = _features(50)
    order = torch.randperm(50, generator=torch.Generator().manual_seed(1))
    index, similarity = mutual_neighbours(x, 3.0 * x[order])
    assert torch.equal(index[:, 0], torch.arange(50))
    assert torch.equal(order[index[:, 1]], index[:, 0])
    assert torch.allclose(similarity, torch.ones(50))


def test_pairs_are_mutual_and_the_same_from_both_sides() -> None:
    x, y = _features(40), _features(70, 1)
    there, _ = mutual_neighbours(x, y)
    back, _ = mutual_neighbours(y, x)
    assert {tuple(r) for r in there.tolist()} == {(j, i) for i, j in back.tolist()}
    cosine = torch.nn.functional.normalize(x, dim=1) @ torch.nn.functional.normalize(y, dim=1).T
    for i, j in there.tolist():
        assert int(cosine[i].argmax()) == j
        assert int(cosine[:, j].argmax()) == i
    assert 0 < len(there) < 40


def test_large_clouds_are_thinned_evenly() -> None:
    index, _ = mutual_neighbours(_features(300), _features(300), most=100)
    assert 0 < len(index) <= 100
    assert int(index.max()) > 250
    rows = evenly_spread(300, 100)
    assert len(rows) == 100
    assert int((rows[1:] - rows[:-1]).max()) <= 4
    assert evenly_spread(5, 100).tolist() == [0, 1, 2, 3, 4]

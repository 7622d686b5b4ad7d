# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Descriptor matches: the likeliest first, the same from both sides, bounded."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from hybridreg_ros.model.network.descriptors import evenly_spread, likely_pairs


def _features(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, 16)).astype(np.float32)


def _likelihood(x: np.ndarray, y: np.ndarray, temperature: float) -> torch.Tensor:
    """(F, G) by two plain softmaxes."""
    a, b = (torch.nn.functional.normalize(torch.from_numpy(z), dim=1) for z in (x, y))
    cosine = a @ b.T
    return torch.softmax(cosine / temperature, 0) * torch.softmax(cosine / temperature, 1)


def test_shuffled_features_find_themselves() -> None:
    x = _features(50)
    order = np.random.default_rng(1).permutation(50)
    index, likelihood = likely_pairs(x, np.float32(3.0) * x[order], 50, 0.02)
    assert sorted(index[:, 0].tolist()) == list(range(50))
    np.testing.assert_array_equal(order[index[:, 1]], index[:, 0])
    assert float(likelihood.min()) > 0.99


@pytest.mark.parametrize(('rows', 'columns', 'count'), [(40, 70, 25), (70, 40, 60), (40, 70, 500)])
def test_they_are_the_largest_of_the_dual_softmax(rows: int, columns: int, count: int) -> None:
    x, y = _features(rows), _features(columns, 1)
    index, likelihood = likely_pairs(x, y, count, 0.1)
    every = _likelihood(x, y, 0.1)
    largest = every.flatten().topk(count).values
    torch.testing.assert_close(torch.from_numpy(likelihood), largest)
    torch.testing.assert_close(every[index[:, 0], index[:, 1]], largest)
    assert len({tuple(r) for r in index.tolist()}) == count


def test_they_are_the_same_from_both_sides() -> None:
    x, y = _features(40), _features(70, 1)
    there, _ = likely_pairs(x, y, 30, 0.1)
    back, _ = likely_pairs(y, x, 30, 0.1)
    assert {tuple(r) for r in there.tolist()} == {(j, i) for i, j in back.tolist()}


def test_fewer_points_than_pairs_wanted() -> None:
    index, likelihood = likely_pairs(_features(3), _features(4, 1), 500, 0.1)
    assert len(index) == len(likelihood) == 12


def test_large_clouds_are_thinned_evenly() -> None:
    index, _ = likely_pairs(_features(300), _features(300), 80, 0.05, most=100)
    assert len(index) == 80
    assert int(index.max()) > 250
    rows = evenly_spread(300, 100)
    assert len(rows) == 100
    assert int((rows[1:] - rows[:-1]).max()) <= 4
    assert evenly_spread(5, 100).tolist() == [0, 1, 2, 3, 4]

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The whole network: both profiles, encode-once equal to joint, gradients, symmetries."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
import torch

from hybridreg_ros.core.errors import ConfigError, RegistrationError
from hybridreg_ros.model.config import ModelConfig
from hybridreg_ros.model.geometry.pyramid import build_pyramid
from hybridreg_ros.model.reference.network import HybridRegNet
from hybridreg_ros.model.register import HybridReg

if TYPE_CHECKING:
    from hybridreg_ros.model.encoded import EncodedCloud
    from hybridreg_ros.model.network.matching import MatchOutput
    from hybridreg_ros.model.network.output import Encoding

SHIFT_M = np.array([0.8, -0.4, 0.4], np.float32)  # whole superpoint voxels: the grids coincide


def _encodings(net: HybridRegNet, *clouds: np.ndarray) -> list[Encoding[torch.Tensor]]:
    with torch.no_grad():
        return [net.encode(build_pyramid(c, 0.05, net.config)) for c in clouds]


def _encoded(net: HybridRegNet, *clouds: np.ndarray) -> list[EncodedCloud]:
    return [HybridReg(net.config, net).encode(c, 0.05) for c in clouds]


def _match(net: HybridRegNet, source: EncodedCloud, target: EncodedCloud) -> MatchOutput:
    return HybridReg(net.config, net).matches(source, target)


def test_shifted_copy_is_found_even_with_random_weights(
    compact_net: HybridRegNet, room: np.ndarray
) -> None:
    match = _match(compact_net, *_encoded(compact_net, room, room + SHIFT_M))
    np.testing.assert_allclose(match.T_target_source[:3, :3], np.eye(3), atol=1e-3)
    np.testing.assert_allclose(match.T_target_source[:3, 3], SHIFT_M, atol=5e-3)
    moved = match.source_points + SHIFT_M
    near = np.linalg.norm(moved - match.target_points, axis=1) < 0.1
    assert match.estimate.inliers.sum() >= 3
    assert (match.estimate.inliers == near).mean() > 0.9
    assert len(match.weights) == len(match.source_points) == len(match.estimate.inliers)


def test_encode_once_equals_joint_forward(
    compact_net: HybridRegNet, room: np.ndarray, rng: np.random.Generator
) -> None:
    other = room[rng.random(len(room)) < 0.7] + np.float32(0.13)
    keyframe, first, second = _encoded(compact_net, room, other, room + SHIFT_M)
    _match(compact_net, second, keyframe)
    kept = _match(compact_net, first, keyframe)
    joint = _match(compact_net, *_encoded(compact_net, other, room))
    np.testing.assert_array_equal(kept.T_target_source, joint.T_target_source)
    np.testing.assert_array_equal(kept.weights, joint.weights)
    np.testing.assert_array_equal(kept.target_sigma2, joint.target_sigma2)


def test_order_of_the_points_does_not_matter(
    compact_net: HybridRegNet, room: np.ndarray, rng: np.random.Generator
) -> None:
    a, b = _encodings(compact_net, room, rng.permutation(room))
    torch.testing.assert_close(a.fine_features, b.fine_features, atol=1e-3, rtol=1e-3)
    torch.testing.assert_close(a.superpoint_features, b.superpoint_features, atol=1e-3, rtol=1e-3)


def test_correlate_is_symmetric(compact_net: HybridRegNet, room: np.ndarray) -> None:
    a, b = _encodings(compact_net, room, room[: len(room) // 2])
    one, two = compact_net.correlate(a, b), compact_net.correlate(b, a)
    torch.testing.assert_close(one.source_features, two.target_features)
    torch.testing.assert_close(one.source_sigma2, two.target_sigma2)
    torch.testing.assert_close(
        one.source_features.norm(dim=1), torch.ones(len(a.pyramid.superpoints))
    )
    assert ((one.source_sigma2 > 0) & (one.source_sigma2 < 1)).all()


def test_one_pair_of_patches_equals_the_batch(compact_net: HybridRegNet, room: np.ndarray) -> None:
    a, b = _encodings(compact_net, room, room + SHIFT_M)
    pairs = torch.tensor([[0, 3], [5, 5], [9, 1]])
    batch = compact_net.patch_scores(a, b, pairs)
    for i in range(3):
        single = compact_net.patch_scores(a, b, pairs[i : i + 1])
        torch.testing.assert_close(single[0], batch[i])


def test_every_parameter_learns(room: np.ndarray) -> None:
    torch.manual_seed(0)
    net = HybridRegNet(ModelConfig())
    half = room[room[:, 0] < 2.5]
    a, b = (net.encode(build_pyramid(c, 0.1, net.config)) for c in (room, half))
    coarse = net.correlate(a, b)
    fine = net.patch_scores(a, b, torch.tensor([[0, 0], [3, 4]]))
    loss = (coarse.source_features @ coarse.target_features.t()).square().sum()
    loss = loss + coarse.source_sigma2.sum() + coarse.target_sigma2.sum()
    loss = loss + fine[fine > -100].square().sum()
    loss.backward()
    silent = [n for n, p in net.named_parameters() if p.grad is None or not p.grad.abs().sum() > 0]
    # Adding one number to all scores of a query changes no softmax.
    assert all(n.endswith('key.bias') or n == 'table.distance.bias' for n in silent), silent


@pytest.mark.parametrize('name', ['compact', 'paper'])
def test_profiles_run(name: str, rng: np.random.Generator) -> None:
    torch.manual_seed(0)
    net = HybridRegNet(ModelConfig.profile(name)).eval()
    cloud = rng.uniform(0, 1, (400, 3)).astype(np.float32)
    match = _match(net, *_encoded(net, cloud, cloud))
    np.testing.assert_allclose(match.T_target_source, np.eye(4), atol=1e-2)


def test_sizes_of_the_profiles() -> None:
    def size(name: str) -> int:
        net = HybridRegNet(ModelConfig.profile(name))
        return sum(p.numel() for p in net.parameters())

    assert size('compact') < 3_000_000
    assert 9_000_000 < size('paper') < 12_000_000


def test_paper_mask_is_selectable(room: np.ndarray) -> None:
    torch.manual_seed(0)
    net = HybridRegNet(ModelConfig(mask_outputs=1, mask_combination='variance_product'))
    a, b = _encodings(net, room, room)
    assert net.correlate(a, b).source_logits.shape == (len(a.pyramid.superpoints), 1)
    assert len(_match(net, *_encoded(net, room, room)).weights) > 3


def test_ransac_is_selectable(room: np.ndarray) -> None:
    torch.manual_seed(3)
    net = HybridRegNet(ModelConfig(estimator='ransac'))
    match = _match(net, *_encoded(net, room, room + SHIFT_M))
    np.testing.assert_allclose(match.T_target_source[:3, 3], SHIFT_M, atol=5e-2)


def test_encodings_of_two_voxel_sizes_do_not_match(
    compact_net: HybridRegNet, room: np.ndarray
) -> None:
    a = compact_net.encode(build_pyramid(room, 0.05, compact_net.config))
    b = compact_net.encode(build_pyramid(room, 0.06, compact_net.config))
    with pytest.raises(RegistrationError, match=r'one voxel size, found 0\.05 m and 0\.06 m'):
        compact_net.correlate(a, b)


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'widths': (64, 128, 256)}, 'widths: expected 4 numbers, found 3'),
        ({'widths': (64, 128, 250, 512)}, 'multiples of groups=8, found 250'),
        ({'dim': 100, 'heads': 8}, 'dim: expected a multiple of 2.heads=16, found 100'),
        ({'angle_reduction': 'sum'}, 'angle_reduction: expected one of mean, max'),
    ],
)
def test_bad_configs(change: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        ModelConfig(**change)  # type: ignore[arg-type]


def test_unknown_profile() -> None:
    with pytest.raises(ConfigError, match="expected compact or paper, found 'huge'"):
        ModelConfig.profile('huge')

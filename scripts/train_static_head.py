# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
r"""Trains the static head of given weights on generated pairs; the network itself stays as it is.

    for kind in room-train street-train street-recorded room-recorded; do
        hybridreg generate $kind --pairs 600 --seed 2400000 --out data/head/$kind
    done
    python scripts/train_static_head.py data/head/* --out hybridreg-compact.safetensors

The network runs once over every pair; what the head reads of it is kept (about 0.4 MB a cloud),
and the head then passes over all of it several times. One scene in twelve is held out; prints
what the head makes of those. The file written differs from the one read in the head alone.
"""

from __future__ import annotations

import argparse
import dataclasses
import logging
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch
from torch.nn import functional

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import RegistrationError
from hybridreg_ros.core.progress import progress
from hybridreg_ros.data.loaders.openers import open_pairs
from hybridreg_ros.data.pair import Label
from hybridreg_ros.metrics.registration import roc_auc
from hybridreg_ros.model.budget import voxel_size_m
from hybridreg_ros.model.checkpoint import load_checkpoint, packaged_weights, save_network
from hybridreg_ros.model.geometry.sight import magnitude
from hybridreg_ros.model.reference.network import HybridRegNet
from hybridreg_ros.model.register import HybridReg
from hybridreg_ros.model.static_points import HeadInput, head_input
from hybridreg_ros.training.augment import augment
from hybridreg_ros.training.config import AugmentConfig, BudgetConfig
from hybridreg_ros.training.validation import split_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from hybridreg_ros.data.pair import PointPair
    from hybridreg_ros.model.reference.static_head import StaticHead

    F32 = NDArray[np.float32]
    Rng = np.random.Generator

AUGMENT = AugmentConfig(
    any_rotation_share=0.1,
    yaw_share=0.7,
    tilt_share=0.4,
    common_rotation_rad=0.05,
    relative_rotation_rad=0.0,  # the sensors stay where they were: free space hangs on it
    large_share=0.0,
    noise_voxels=0.08,
    thin_share=0.2,
    crop_share=0.05,
    hole_share=0.05,
)
BUDGET = BudgetConfig(fewest_points=2000, most_points=8000)
THINNED_SHARE, BODY_SHARE = 0.6, 0.3
"""Pairs whose clouds are thinned by cubes, as the front end does, and streets seen from a vehicle
of which the sensor sees a part: it moves along, and is no moving thing."""
MOVING, STATIC = 3000, 6000
"""Points kept of a cloud; those left out count through the weight of the others."""
HELD_OUT = 12
BATCH = 4
SEEN_WEIGHT = 0.3
SEEN_VOXELS = 1.5


class Example(NamedTuple):
    """One cloud of a pair; float16 to save memory."""

    found: HeadInput
    moving: NDArray[np.bool_]
    seen: NDArray[np.bool_]
    weight: NDArray[np.float32]
    kind: str
    held_out: bool


def seen_from_a_vehicle(pair: PointPair, rng: Rng) -> PointPair:
    """The pair with the same few boxes below the sensor in both clouds, labelled static."""
    count = int(rng.uniform(0.01, 0.2) * min(len(pair.source), len(pair.target)))
    boxes = []
    for _ in range(rng.integers(1, 4)):
        size = rng.uniform([0.3, 0.2, 0.05], [3.0, 1.8, 0.6])
        face = rng.uniform(-0.5, 0.5, (count // 2 + 1, 3))
        rows = np.arange(len(face)), rng.integers(0, 3, len(face))
        face[rows] = rng.choice([-0.5, 0.5], len(face))
        boxes.append(face * size + rng.uniform([-2.5, -0.8, -1.6], [1.5, 0.8, -0.4]))
    body = np.concatenate(boxes)
    ranges = np.linalg.norm(body, axis=1)
    body = body[(ranges > 0.7) & (ranges < 4.0)]
    changes: dict[str, Any] = {}
    for side in ('source', 'target'):
        seen = body[rng.random(len(body)) < 0.9]
        seen = (seen + 0.015 * rng.standard_normal(seen.shape)).astype(np.float32)
        label = getattr(pair, f'{side}_label')
        changes[side] = np.concatenate([getattr(pair, side), seen])
        changes[f'{side}_label'] = np.append(label, np.full(len(seen), Label.STATIC, label.dtype))
    return dataclasses.replace(pair, **changes)


def thinned(points: F32, label: NDArray[np.uint8], size_m: float) -> tuple[F32, NDArray[np.uint8]]:
    """The first point of every cube, as the front end thins a scan."""
    cubes = np.floor(points / size_m).astype(np.int64) & 0x1FFFFF
    _, first = np.unique(cubes @ np.array([1, 1 << 21, 1 << 42]), return_index=True)
    first.sort()
    return points[first], label[first]


def examples(model: HybridReg, pair: PointPair, rng: Rng, held_out: bool) -> Iterator[Example]:
    """Both clouds of a pair, as a front end with any sensor and a good pose would have them."""
    pair = augment(pair, AUGMENT, rng)
    behind = bool((pair.source[:, 2] < 0.0).any())
    kind = split_of(pair)
    if kind.startswith('street') and behind and rng.random() < BODY_SHARE:
        pair = seen_from_a_vehicle(pair, rng)
    clouds = [(pair.source, pair.source_label), (pair.target, pair.target_label)]
    if rng.random() < THINNED_SHARE:
        size_m = rng.uniform(0.4, 1.0) * pair.voxel_size_m
        clouds = [thinned(*cloud, size_m) for cloud in clouds]
    voxel_m = voxel_size_m(
        *(c for c, _ in clouds), factor=model.config.voxel_factor, budget=BUDGET.drawn(rng)
    )
    spread = rng.uniform(0.0, 2.0)
    error = np.r_[
        rng.normal(0.0, 0.1 * pair.voxel_size_m * spread, 3),
        rng.normal(0.0, np.deg2rad(0.05) * spread, 3),
    ]
    T = se3.exp(error) @ pair.T_target_source
    encoded = [model.encode(c, voxel_m) for c, _ in clouds]
    near = magnitude(SEEN_VOXELS * pair.voxel_size_m)
    for side, (_, label) in enumerate(clouds):
        pose = se3.inverse(T) if side else T
        found = head_input(encoded[side], encoded[1 - side], pose)
        moving = label[found.rows] != Label.STATIC
        yield _kept(found, moving, _seen(found.looks, moving, near), kind, held_out, rng)


def _seen(looks: F32, moving: NDArray[np.bool_], near: float) -> NDArray[np.bool_]:
    """Whether the other sensor saw the place of a point.

    A static point was seen if it was measured again; a moving one if nothing hid its place.
    """
    fine, wide = looks[:, 3] > 0.0, looks[:, 7] > 0.0
    again = (fine & (looks[:, 6] < near)) | (wide & (looks[:, 10] < near))
    bare = np.where(fine, looks[:, 5] < near, wide & (looks[:, 9] < near))
    return np.where(moving, bare, again)


def _kept(
    found: HeadInput,
    moving: NDArray[np.bool_],
    seen: NDArray[np.bool_],
    kind: str,
    held_out: bool,
    rng: Rng,
) -> Example:
    """An example of some of the points, moving ones as far as there is room."""
    weight, parts = np.ones(len(moving), np.float32), []
    for part, most in ((moving, MOVING), (~moving, STATIC)):
        rows = np.flatnonzero(part)
        if len(rows) > most:
            weight[rows] = len(rows) / most
            rows = rng.choice(rows, most, replace=False)
        parts.append(rows)
    rows = np.sort(np.concatenate(parts))
    kept = found._replace(
        rows=found.rows[rows],
        looks=found.looks[rows].astype(np.float16),
        fine=found.fine.astype(np.float16),
        owners=(found.owners[0][rows], *found.owners[1:]),
    )
    return Example(kept, moving[rows], seen[rows], weight[rows], kind, held_out)


class Scale(NamedTuple):
    """Brings what the head reads to about unit size.

    Attributes:
        mean: (C,) of the looks.
        deviation: (C,) of the looks.
        fine: factor of the fine features.
    """

    mean: F32
    deviation: F32
    fine: float

    @classmethod
    def of(cls, chosen: Sequence[Example]) -> Scale:
        """By the numbers of some examples."""
        looks = np.concatenate([e.found.looks[::50] for e in chosen]).astype(np.float32)
        fine = float(chosen[0].found.fine.shape[1]) ** 0.5
        return cls(looks.mean(axis=0), looks.std(axis=0) + np.float32(1e-3), fine)

    @torch.no_grad()
    def fold_into(self, head: StaticHead) -> None:
        """Make a head that was trained on scaled numbers read them as they are."""
        head.point.weight /= torch.from_numpy(self.deviation)
        head.point.bias.sub_(head.point.weight @ torch.from_numpy(self.mean))
        head.fine.weight *= self.fine


class Batch(NamedTuple):
    """Several examples side by side."""

    inputs: tuple[torch.Tensor, torch.Tensor, list[torch.Tensor], torch.Tensor]
    moving: torch.Tensor
    seen: torch.Tensor
    example: torch.Tensor


def batch_of(chosen: Sequence[Example], scale: Scale | None = None) -> Batch:
    """Examples as the head reads them, or scaled."""
    looks = np.concatenate([e.found.looks for e in chosen]).astype(np.float32)
    fine = np.concatenate([e.found.fine for e in chosen]).astype(np.float32)
    owners = []
    levels = len(chosen[0].found.owners)
    for level in range(levels):
        above = [e.found.owners[min(level + 1, levels - 1)] for e in chosen]
        sizes = [len(a) if level + 1 < levels else 1 + int(a.max()) for a in above]
        first = np.cumsum([0, *sizes])
        parts = (e.found.owners[level] + n for e, n in zip(chosen, first, strict=False))
        owners.append(torch.from_numpy(np.concatenate(list(parts))))
    weight = torch.from_numpy(np.concatenate([e.weight for e in chosen]))
    number = np.repeat(np.arange(len(chosen)), [len(e.moving) for e in chosen])
    moving, seen = (
        torch.from_numpy(np.concatenate([getattr(e, name) for e in chosen]).astype(np.float32))
        for name in ('moving', 'seen')
    )
    if scale is not None:
        looks, fine = (looks - scale.mean) / scale.deviation, scale.fine * fine
    x, y = torch.from_numpy(looks), torch.from_numpy(fine)
    return Batch((x, y, owners, weight), moving, seen, torch.from_numpy(number))


def loss_of(logits: torch.Tensor, batch: Batch) -> torch.Tensor:
    """Cross-entropy of P(static) and P(seen), every cloud alike.

    A moving point counts by one over the root of their share: a cloud has 0.2 to 50 % of them.
    """
    weight, at = batch.inputs[-1], batch.example
    sums = torch.zeros(2, int(at.max()) + 1)
    sums = sums.index_add(1, at, torch.stack([weight, weight * batch.moving]))
    rarity = (sums[1] / sums[0]).clamp_min(1e-3).rsqrt()
    share = weight / sums[0][at] / sums.shape[1]
    balanced = share * torch.where(batch.moving > 0, rarity[at], torch.ones_like(share))
    static = functional.binary_cross_entropy_with_logits(
        logits[:, 0], 1.0 - batch.moving, balanced, reduction='sum'
    )
    seen = functional.binary_cross_entropy_with_logits(
        logits[:, 1], batch.seen, share, reduction='sum'
    )
    return static + SEEN_WEIGHT * seen


def fit(head: StaticHead, chosen: list[Example], passes: float, lr: float, seed: int) -> None:
    """Train a head; afterwards it reads its inputs as they are, not scaled to unit size."""
    scale = Scale.of(chosen)
    optimizer = torch.optim.AdamW(head.parameters(), lr, weight_decay=1e-3)
    rng, order = np.random.default_rng(seed), np.empty(0, np.int64)
    steps = max(1, round(passes * len(chosen) / BATCH))
    for step in progress(range(steps), steps, 'fit', 'step'):
        if len(order) < BATCH:
            order = np.append(order, rng.permutation(len(chosen)))
        taken, order = order[:BATCH], order[BATCH:]
        for group in optimizer.param_groups:
            group['lr'] = lr * min(1.0, (step + 1) / 30) * 0.5 * (1 + np.cos(np.pi * step / steps))
        batch = batch_of([chosen[k] for k in taken], scale)
        optimizer.zero_grad()
        loss_of(head(*batch.inputs), batch).backward()
        torch.nn.utils.clip_grad_norm_(head.parameters(), 1.0)
        optimizer.step()
    scale.fold_into(head)


@torch.no_grad()
def report(head: StaticHead, held_out: Sequence[Example]) -> dict[str, dict[str, float]]:
    """AUC of P(static) of each kind: against all static points, and those that are seen."""
    found: dict[str, dict[str, float]] = {}
    for kind in sorted({e.kind for e in held_out}):
        chosen = [e for e in held_out if e.kind == kind]
        static = np.concatenate([head(*batch_of([e]).inputs)[:, 0].numpy() for e in chosen])
        still = ~np.concatenate([e.moving for e in chosen])
        seen = np.concatenate([e.seen for e in chosen]) | ~still
        found[kind] = {
            'clouds': len(chosen),
            'auc': roc_auc(still, static),
            'auc_seen': roc_auc(still[seen], static[seen]),
        }
    return found


def gathered(
    model: HybridReg, folders: Sequence[Path], seed: int, limit: int | None
) -> list[Example]:
    """Examples of all pairs; those that cannot be encoded are left out."""
    made: list[Example] = []
    for folder in folders:
        pairs = open_pairs(folder)
        count = len(pairs) if limit is None else min(limit, len(pairs))
        for row in progress(range(count), count, folder.name, 'pair'):
            pair = pairs[row]
            rng = np.random.default_rng([seed, row, pair.seed])
            try:
                made += examples(model, pair, rng, held_out=pair.seed % HELD_OUT == 0)
            except RegistrationError as error:
                logging.getLogger(__name__).warning('pair %s left out: %s', pair.name, error)
    return made


def main() -> None:
    """Gather, fit, write."""
    p = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    p.add_argument('data', type=Path, nargs='+', help='folders of generated pairs')
    p.add_argument('--out', type=Path, required=True, help='weights file to write, float16')
    p.add_argument('--weights', type=Path, help='network to give a head to; default: packaged')
    p.add_argument('--width', type=int, default=32, help='of the head')
    p.add_argument('--passes', type=float, default=6.0, help='over all examples')
    p.add_argument('--lr', type=float, default=6e-3, help='largest learning rate')
    p.add_argument('--seed', type=int, default=0)
    p.add_argument('--limit', type=int, help='pairs of a folder at most')
    args = p.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(args.seed)
    checkpoint = load_checkpoint(args.weights or packaged_weights())
    config = dataclasses.replace(checkpoint.network.config, static_width=args.width)
    network = HybridRegNet(config).eval()
    fresh = {k: v for k, v in network.state_dict().items() if k.startswith('static.')}
    network.load_state_dict(checkpoint.network.state_dict() | fresh)
    head = network.static
    assert head is not None
    made = gathered(HybridReg(config, network), args.data, args.seed, args.limit)
    learned = [e for e in made if not e.held_out]
    if not learned:
        p.error('every scene is held out: generate more pairs')
    fit(head, learned, args.passes, args.lr, args.seed)
    scores = report(head, [e for e in made if e.held_out])
    for kind, row in scores.items():
        print(kind, ' '.join(f'{name} {value:.4g}' for name, value in row.items()))
    about = {
        'pairs': len(learned) // 2,
        'folders': [folder.resolve().name for folder in args.data],
        **{name: getattr(args, name) for name in ('passes', 'lr', 'seed')},
        'held_out': scores,
    }
    provenance = {**checkpoint.provenance, 'static_head': about}
    save_network(args.out, network, provenance, checkpoint.calibration, half=True)


if __name__ == '__main__':
    main()

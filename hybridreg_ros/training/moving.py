# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""How well the mask tells moving from static points of labelled pairs, whole folders at a time."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.data.pair import Label
from hybridreg_ros.metrics import registration
from hybridreg_ros.model.budget import voxel_size_m
from hybridreg_ros.model.geometry.upsampling import upsample_to_level0, values_of_inputs
from hybridreg_ros.training.validation import MATCH_VOXELS, meets, overlap_points, threshold_m

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from hybridreg_ros.data.loaders.labelled import LabelledPair
    from hybridreg_ros.data.pair import PointPair
    from hybridreg_ros.model.budget import Budget
    from hybridreg_ros.model.encoded import EncodedCloud
    from hybridreg_ros.model.register import HybridReg
    from hybridreg_ros.model.result import RegistrationResult

    F32 = NDArray[np.float32]
    I64 = NDArray[np.int64]

RANGE_M = (1.0, 50.0)
"""Distances from the sensor at which points are scored."""
PEOPLE_RANGE_M = (5.0, 25.0)
"""Those of the points on people."""
_BINS = 4096


def histogram_auc(positive: I64, negative: I64) -> float:
    """AUC of two histograms over the same bins of a score; values of one bin are ties.

    Args:
        positive: (B,) counts.
        negative: (B,) counts.

    Returns:
        P(score of a positive > score of a negative), ties count half; NaN when one is empty.

    Examples:
        >>> histogram_auc(np.array([0, 1, 1]), np.array([1, 1, 0]))
        0.875
    """
    below = np.cumsum(negative) - 0.5 * negative
    pairs = float(positive.sum()) * float(negative.sum())
    return float((positive * below).sum() / pairs) if pairs else float('nan')


def best_iou(positive: I64, negative: I64) -> float:
    """Largest IoU (tp / (tp + fp + fn)) over all thresholds of a histogram; NaN if none positive.

    Examples:
        >>> best_iou(np.array([0, 1, 1]), np.array([1, 1, 0]))
        0.6666666666666666
    """
    if not positive.sum():
        return float('nan')
    tp, fp = np.cumsum(positive[::-1]), np.cumsum(negative[::-1])
    return float((tp / (positive.sum() + fp)).max())


@dataclass(frozen=True, eq=False)
class Tally:
    """Histograms of an uncertainty over points: static, moving, moving people, static and seen."""

    counts: I64 = field(default_factory=lambda: np.zeros((4, _BINS), np.int64))

    def add(
        self,
        uncertainty: F32,
        points: F32,
        label: NDArray[np.uint8],
        seen: NDArray[np.bool_],
    ) -> None:
        """Count points (N, 3).

        Args:
            uncertainty: (N,) in [0, 1].
            points: (N, 3) sensor frame, metres.
            label: (N,) of `Label`.
            seen: (N,) whether the other cloud has the place of a static point.
        """
        bins = np.minimum((_BINS * np.clip(uncertainty, 0.0, 1.0)).astype(np.int64), _BINS - 1)
        away = np.linalg.norm(points, axis=1)
        inside = (away >= RANGE_M[0]) & (away <= RANGE_M[1])
        near = (away >= PEOPLE_RANGE_M[0]) & (away <= PEOPLE_RANGE_M[1])
        for row, chosen in enumerate(
            (
                inside & (label == Label.STATIC),
                inside & (label != Label.STATIC),
                near & (label == Label.DEFORMING),
                inside & (label == Label.STATIC) & seen,
            )
        ):
            self.counts[row] += np.bincount(bins[chosen], minlength=_BINS)

    @property
    def auc(self) -> float:
        """Of moving against static points."""
        return histogram_auc(self.counts[1], self.counts[0])

    @property
    def seen_auc(self) -> float:
        """Of moving points against static ones that the other cloud sees."""
        return histogram_auc(self.counts[1], self.counts[3])

    @property
    def people_auc(self) -> float:
        """Of walking people, 5 to 25 m away, against static points."""
        return histogram_auc(self.counts[2], self.counts[0])

    @property
    def iou(self) -> float:
        """Of the moving points, at the best threshold."""
        return best_iou(self.counts[1], self.counts[0])


KINDS = ('network', 'result', 'static')
"""What is scored: the mask of the network alone, spread over the points; the uncertainty that
`register()` returns, corrected by the pose; and 1 - P(static) of the static head."""


@dataclass(eq=False)
class MovingScore:
    """What one folder of labelled pairs gives.

    Attributes:
        name: of the folder.
        tallies: one of each of `KINDS`.
        pairs: scored.
        right: of these, registered.
    """

    name: str
    tallies: dict[str, Tally] = field(default_factory=lambda: {kind: Tally() for kind in KINDS})
    pairs: int = 0
    right: int = 0

    def row(self) -> dict[str, Any]:
        """Numbers for the table and for JSON; NaN for what the weights do not have."""
        static, moving, people, _ = self.tallies['network'].counts.sum(axis=1).tolist()
        row = {
            'data': self.name,
            'pairs': self.pairs,
            'RR': self.right / self.pairs if self.pairs else float('nan'),
            'moving_share': moving / max(static + moving, 1),
            'people_points': people,
        }
        for kind, tally in self.tallies.items():
            row |= {
                f'AUC_{kind}': tally.auc,
                f'seen_AUC_{kind}': tally.seen_auc,
                f'IoU_{kind}': tally.iou,
                f'people_AUC_{kind}': tally.people_auc,
            }
        return row


def score_moving(
    model: HybridReg, pairs: Iterable[LabelledPair], name: str, budget: Budget | None = None
) -> MovingScore:
    """Register labelled pairs, one attempt each, and tally the masks of both clouds.

    Args:
        model: scored.
        pairs: metres; read one after the other.
        name: of the folder they come from.
        budget: by which the voxel is chosen; None: the full size.

    Raises:
        RegistrationError: a cloud has too few points.
    """
    score = MovingScore(name)
    for labelled in pairs:
        pair = labelled.pair
        voxel_m = voxel_size_m(
            pair.source, pair.target, factor=model.config.voxel_factor, budget=budget
        )
        source, target = (model.encode(c, voxel_m) for c in (pair.source, pair.target))
        result = model.match(source, target)
        said = {
            'network': _network_uncertainty(model, source, target),
            'result': (result.source_uncertainty, result.target_uncertainty),
        }
        if model.config.static_width:
            own = model.point_mask(source, target, result.T_target_source)
            other = model.point_mask(target, source, se3.inverse(result.T_target_source))
            said['static'] = (1.0 - own.static, 1.0 - other.static)
        seen = _seen(pair)
        for side, (cloud, label, known) in enumerate(
            (
                (pair.source, pair.source_label, labelled.source_known),
                (pair.target, pair.target_label, labelled.target_known),
            )
        ):
            for kind, both in said.items():
                score.tallies[kind].add(
                    both[side][known], cloud[known], label[known], seen[side][known]
                )
        score.pairs += 1
        score.right += _right(labelled, result)
    return score


def _seen(pair: PointPair) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Whether there is a static point of the other cloud at each point, (N,) and (M,)."""
    moved = se3.apply(pair.T_target_source, pair.source)
    own, other = pair.source_label == Label.STATIC, pair.target_label == Label.STATIC
    radius = MATCH_VOXELS * pair.voxel_size_m
    return meets(moved, pair.target[other], radius), meets(pair.target, moved[own], radius)


def _network_uncertainty(
    model: HybridReg, source: EncodedCloud, target: EncodedCloud
) -> tuple[F32, F32]:
    """The network's sigma2 of every input point of both clouds, (N,) and (M,)."""
    coarse = model.net.correlate(source.encoding, target.encoding)
    found = []
    for cloud, sigma2 in ((source, coarse.source_sigma2), (target, coarse.target_sigma2)):
        pyramid = cloud.encoding.pyramid
        spread = upsample_to_level0(pyramid, sigma2)
        found.append(values_of_inputs(pyramid, spread))
    return found[0], found[1]


def _right(labelled: LabelledPair, result: RegistrationResult) -> bool:
    """Whether the pose is right by the measure of `hybridreg evaluate`."""
    pair = labelled.pair
    error_m = registration.rmse_m(
        pair.T_target_source, result.T_target_source, overlap_points(pair)
    )
    return bool(error_m < threshold_m(pair.voxel_size_m))


def to_markdown(scores: Iterable[MovingScore]) -> str:
    """Table of some folders: AUC and IoU as network / result of `register()` / P(static)."""
    lines = [
        '| data | pairs | RR % | moving % | AUC, network / result / P(static) | '
        'against what is seen | best IoU | people 5 to 25 m: AUC |',
        '|---|---|---|---|---|---|---|---|',
    ]
    for score in scores:
        r = score.row()
        cells = (_each(r, key) for key in ('AUC', 'seen_AUC', 'IoU', 'people_AUC'))
        lines.append(
            f'| {r["data"]} | {r["pairs"]} | {100 * r["RR"]:.1f} | {100 * r["moving_share"]:.2f} '
            f'| {" | ".join(cells)} |'
        )
    return '\n'.join(lines) + '\n'


def _each(row: dict[str, Any], key: str) -> str:
    values = [row[f'{key}_{kind}'] for kind in KINDS]
    return ' / '.join('-' if np.isnan(v) else f'{v:.3f}' for v in values)

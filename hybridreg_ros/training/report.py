# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""EvalReport: results of one method on many pairs, as JSON and as a Markdown table."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.metrics import calibration, registration

if TYPE_CHECKING:
    from collections.abc import Sequence

INDOOR_VOXEL_M = 0.1
"""Pairs with a finer voxel than this count as indoor."""
INDOOR_THRESHOLD_M = registration.RMSE_THRESHOLD_M
OUTDOOR_THRESHOLD_M = 0.5


@dataclass(frozen=True)
class PairScore:
    """What one method did on one pair.

    Attributes:
        name: of the pair.
        split: the row of the table it belongs to.
        overlap: share of static source points that the target sees.
        dynamic_share: share of points that are not static.
        threshold_m: RMSE below which the pair counts as registered.
        rmse_m: of the final result, over static source points with a counterpart.
        rre_deg: rotation error of the final result.
        rte_m: translation error of the final result.
        coarse_rmse_m: RMSE before the final refinement (the network's own pose).
        inlier_ratio: share of correspondences within 2 voxels (0.1 m indoors).
        coarse_precision: share of superpoint pairs that truly overlap.
        mask_auc: of the network's 1 - sigma2 against static and overlapping superpoints; NaN if
            undefined.
        point_mask_auc: the same of the result's 1 - uncertainty over source points.
        confidence: of the final result, [0, 1]; NaN if the method gives none.
        seconds: wall time of the registration.
        features: what the confidence was computed from.
    """

    name: str
    split: str
    overlap: float
    dynamic_share: float
    threshold_m: float
    rmse_m: float
    rre_deg: float
    rte_m: float
    coarse_rmse_m: float = math.nan
    inlier_ratio: float = math.nan
    coarse_precision: float = math.nan
    mask_auc: float = math.nan
    point_mask_auc: float = math.nan
    confidence: float = math.nan
    seconds: float = math.nan
    features: tuple[float, ...] = ()

    @property
    def right(self) -> bool:
        """Registered."""
        return self.rmse_m < self.threshold_m

    @property
    def coarse_right(self) -> bool:
        """Registered already before the final refinement."""
        return self.coarse_rmse_m < self.threshold_m


@dataclass(frozen=True)
class EvalReport:
    """Scores of one method.

    Attributes:
        method: its name in tables.
        scores: one per pair.
        about: weights, data folders, dates: whatever tells two reports apart.
    """

    method: str
    scores: tuple[PairScore, ...]
    about: dict[str, Any] = field(default_factory=dict)

    def recall(self, *, coarse: bool = False) -> float:
        """RR over all pairs; `coarse` without the final refinement. NaN for no pairs."""
        rights = [s.coarse_right if coarse else s.right for s in self.scores]
        return float(np.mean(rights)) if rights else math.nan

    def rows(self) -> list[dict[str, Any]]:
        """One summary per split, and one over all when there are several."""
        splits = sorted({s.split for s in self.scores})
        rows = [summary(split, [s for s in self.scores if s.split == split]) for split in splits]
        if len(splits) > 1:
            rows.append(summary('all', self.scores))
        return rows


def score_to_plain(score: PairScore) -> dict[str, Any]:
    """Values for strict JSON (NaN becomes null)."""
    plain: dict[str, Any] = _strict(dataclasses.asdict(score))
    return plain


def score_from_plain(row: dict[str, Any]) -> PairScore:
    """Inverse of `score_to_plain`; an error that was infinite comes back as NaN: not right."""
    values: dict[str, Any] = {k: math.nan if v is None else v for k, v in row.items()}
    values['features'] = tuple(math.nan if v is None else v for v in row['features'])
    return PairScore(**values)


def summary(split: str, scores: Sequence[PairScore]) -> dict[str, Any]:
    """Table row of some scores; RRE and RTE are medians over registered pairs, as in the paper."""
    done = [s for s in scores if s.right]
    ratios = _known(s.inlier_ratio for s in scores)
    row: dict[str, Any] = {
        'split': split,
        'pairs': len(scores),
        'RR': _mean([float(s.right) for s in scores]),
        'RR_95': registration.wilson_interval(len(done), len(scores)),
        'RR_coarse': _mean([float(s.coarse_right) for s in scores]),
        'IR': _mean(ratios),
        'FMR': registration.feature_matching_recall(np.array(ratios)),
        'RRE_deg': _median([s.rre_deg for s in done]),
        'RTE_m': _median([s.rte_m for s in done]),
        'PIR': _mean(_known(s.coarse_precision for s in scores)),
        'mask_AUC': _mean(_known(s.mask_auc for s in scores)),
        'point_mask_AUC': _mean(_known(s.point_mask_auc for s in scores)),
        'ms': 1000.0 * _median(_known(s.seconds for s in scores)),
    }
    sure = [s for s in scores if not math.isnan(s.confidence)]
    row['ECE'] = calibration.expected_calibration_error(
        np.array([s.confidence for s in sure]), np.array([s.right for s in sure], dtype=bool)
    )
    return row


def _known(values: Any) -> list[float]:
    return [float(v) for v in values if not math.isnan(v)]


def _mean(values: list[float]) -> float:
    return float(np.mean(values)) if values else math.nan


def _median(values: list[float]) -> float:
    return float(np.median(values)) if values else math.nan


def _strict(value: Any) -> Any:
    """NaN and inf as null, tuples as lists."""
    if isinstance(value, dict):
        return {k: _strict(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_strict(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


_COLUMNS = (
    ('RR', 'RR %', 100.0, 1),
    ('RR_coarse', 'RR unrefined %', 100.0, 1),
    ('IR', 'IR %', 100.0, 1),
    ('FMR', 'FMR %', 100.0, 1),
    ('RRE_deg', 'RRE deg', 1.0, 2),
    ('RTE_m', 'RTE m', 1.0, 3),
    ('PIR', 'PIR %', 100.0, 1),
    ('mask_AUC', 'network mask AUC', 1.0, 3),
    ('point_mask_AUC', 'point mask AUC', 1.0, 3),
    ('ECE', 'ECE', 1.0, 3),
    ('ms', 'ms', 1.0, 0),
)


def to_markdown(reports: Sequence[EvalReport]) -> str:
    """One table of several methods, rows grouped by split."""
    lines = [
        '| split | method | pairs | ' + ' | '.join(c[1] for c in _COLUMNS) + ' |',
        '|' + '---|' * (3 + len(_COLUMNS)),
    ]
    table = [(row, report.method) for report in reports for row in report.rows()]
    order = {name: i for i, name in enumerate(dict.fromkeys(r['split'] for r, _ in table))}
    for row, method in sorted(table, key=lambda x: order[x[0]['split']]):
        cells = [_cell(row[key], factor, digits) for key, _, factor, digits in _COLUMNS]
        lines.append(f'| {row["split"]} | {method} | {row["pairs"]} | ' + ' | '.join(cells) + ' |')
    return '\n'.join(lines) + '\n'


def _cell(value: float, factor: float, digits: int) -> str:
    return '-' if value is None or math.isnan(value) else f'{factor * value:.{digits}f}'

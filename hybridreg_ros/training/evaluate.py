# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Model times pairs: registers every pair as users do and reports RR, IR, FMR, RRE, RTE."""

from __future__ import annotations

import json
import logging
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import FileFormatError
from hybridreg_ros.data.pair import PointPair
from hybridreg_ros.metrics import calibration as metric
from hybridreg_ros.metrics import registration
from hybridreg_ros.model.confidence import Calibration, feature_names
from hybridreg_ros.training.config import LossConfig
from hybridreg_ros.training.report import EvalReport, PairScore
from hybridreg_ros.training.samples import prepare
from hybridreg_ros.training.validation import (
    HeldOut,
    overlap_points,
    pair_score,
    split_of,
    threshold_m,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from numpy.typing import NDArray

    from hybridreg_ros.model.register import HybridReg

    F64 = NDArray[np.float64]

_LOG = logging.getLogger(__name__)
RECORDED_VOXEL_M = 0.05
CALIBRATED = ('log_inliers', 'overlap', 'residual', 'correction', 'fit', 'intrusion', 'lead')
"""Features that the confidence is fitted to; the others get no weight."""
GATE = 0.7
"""Confidence from which odometry takes up the network's pose by default."""
WRONG_SHARE = 0.02
FOLDS = 8


def evaluate(
    model: HybridReg, pairs: Iterable[PointPair], about: dict[str, Any] | None = None
) -> EvalReport:
    """Score a model on pairs.

    Args:
        model: with the calibration that its confidence is to be judged by.
        pairs: metres; read one after the other.
        about: noted in the report.
    """
    loss = LossConfig()
    scores = []
    for pair in pairs:
        sample = prepare(pair, model.config, loss, np.random.default_rng(0))
        scores.append(pair_score(model, HeldOut.of(sample)))
        _LOG.info('%s: rmse %.3f m', pair.name, scores[-1].rmse_m)
    return EvalReport('hybridreg', tuple(scores), about or {})


def evaluate_method(
    name: str, method: Callable[[PointPair], F64], pairs: Iterable[PointPair]
) -> EvalReport:
    """Score anything that maps a pair to T_target_source (4, 4), such as a baseline."""
    scores = []
    for pair in pairs:
        began = time.perf_counter()
        T = method(pair)
        seconds = time.perf_counter() - began
        T_true, points = pair.T_target_source, overlap_points(pair)
        scores.append(
            PairScore(
                name=pair.name,
                split=split_of(pair),
                overlap=float(pair.overlap),
                dynamic_share=float(pair.dynamic_share),
                threshold_m=threshold_m(pair.voxel_size_m),
                rmse_m=registration.rmse_m(T_true, T, points),
                rre_deg=registration.rotation_error_deg(T_true, T),
                rte_m=registration.translation_error_m(T_true, T),
                coarse_rmse_m=registration.rmse_m(T_true, T, points),
                seconds=seconds,
            )
        )
    return EvalReport(name, tuple(scores))


def calibrate(scores: Sequence[PairScore]) -> Calibration:
    """Confidence fitted to scores with features (from validation pairs, never from test data).

    A logistic model of the features in `CALIBRATED` (few, for validation pairs are few), judged
    by cross-validation: its log-odds are lowered until at most `WRONG_SHARE` of the held-out
    results above `GATE` are wrong. The confidence is thus cautious rather than unbiased.

    Raises:
        ValueError: all scores are right, or all are wrong.
    """
    usable = [s for s in scores if len(s.features) and np.isfinite(s.features).all()]
    columns = [feature_names().index(name) for name in CALIBRATED]
    features = np.array([s.features for s in usable])[:, columns]
    right = np.array([s.right for s in usable])
    fit = metric.fit_logistic(features, right, ridge=1.0)
    weights = np.zeros(len(feature_names()))
    weights[columns] = fit.weights
    caution = _caution(_held_out_odds(features, right), right)
    return Calibration(tuple(float(w) for w in weights), fit.bias - caution, True)


def _held_out_odds(features: F64, right: NDArray[np.bool_]) -> F64:
    """Log-odds of every result by models fitted without its fold."""
    order = np.random.default_rng(0).permutation(len(right))
    odds = np.full(len(right), -np.inf)
    for fold in range(FOLDS):
        held = order[fold::FOLDS]
        kept = np.setdiff1d(order, held)
        if right[kept].min() == right[kept].max():
            continue
        fit = metric.fit_logistic(features[kept], right[kept], ridge=1.0)
        odds[held] = features[held] @ fit.weights + fit.bias
    return odds


def _caution(odds: F64, right: NDArray[np.bool_]) -> float:
    """How far log-odds must fall for the results above the gate to be right."""
    gate = float(np.log(GATE / (1.0 - GATE)))
    order = np.argsort(-odds, kind='stable')
    wrong = np.cumsum(~right[order])
    allowed = wrong <= WRONG_SHARE * np.arange(1, len(order) + 1)
    if not allowed.any():
        return max(float(odds[order[0]]) - gate, 0.0) + 1.0
    last = int(np.flatnonzero(allowed)[-1])
    if last + 1 == len(order):
        return 0.0
    border = 0.5 * float(odds[order[last]] + odds[order[last + 1]])
    return max(border - gate, 0.0)


def recorded_pairs(folder: str | Path) -> list[PointPair]:
    """Recorded static pairs: `pairs.json` beside one npz per pair, or one npz of fragments.

    One npz per pair holds `src`, `ref` and `transform` (src to ref); `fragments.npz` holds
    `points_K` per fragment, and then `pairs.json` names `src`, `ref` and their `transform`.

    Raises:
        FileFormatError: a file is missing or lacks a key.
    """
    folder = Path(folder)
    try:
        rows = json.loads((folder / 'pairs.json').read_text(encoding='utf-8'))
        if (folder / 'fragments.npz').exists():
            with np.load(folder / 'fragments.npz') as clouds:
                points = {k: clouds[k] for k in clouds.files if k.startswith('points_')}
            return [
                _static_pair(
                    points[f'points_{r["src"]}'],
                    points[f'points_{r["ref"]}'],
                    np.array(r['transform'], dtype=np.float64),
                    float(r['overlap']),
                    f'{folder.name}-{r["ref"]}_{r["src"]}',
                )
                for r in rows
            ]
        pairs = []
        for row in rows:
            with np.load(folder / f'{row["name"]}.npz') as pair:
                pairs.append(
                    _static_pair(
                        pair['src'],
                        pair['ref'],
                        pair['transform'].astype(np.float64),
                        float(row['overlap_src']),
                        f'{folder.name}-{row["name"]}',
                    )
                )
        return pairs
    except (OSError, KeyError, ValueError) as error:
        raise FileFormatError(f'{folder} is not a folder of recorded pairs: {error}') from None


def _static_pair(
    source: NDArray[np.float32], target: NDArray[np.float32], T: F64, overlap: float, name: str
) -> PointPair:
    n, m = len(source), len(target)
    return PointPair(
        source=np.ascontiguousarray(source, dtype=np.float32),
        target=np.ascontiguousarray(target, dtype=np.float32),
        T_target_source=se3.orthonormalise(T),
        source_label=np.zeros(n, np.uint8),
        target_label=np.zeros(m, np.uint8),
        source_instance=np.zeros(n, np.uint16),
        target_instance=np.zeros(m, np.uint16),
        overlap=overlap,
        dynamic_share=0.0,
        voxel_size_m=RECORDED_VOXEL_M,
        name=name,
    )

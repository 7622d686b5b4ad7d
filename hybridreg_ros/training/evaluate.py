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
from hybridreg_ros.model.pose.confidence import PairCalibration, feature_names
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
SIGNS = {
    'matched': 1.0,
    'agreement': 1.0,
    'overlap': 1.0,
    'residual': -1.0,
    'fit': 1.0,
    'intrusion': -1.0,
    'lead': 1.0,
    'trusted': 1.0,
    'resemblance': 1.0,
}
"""Features that the confidence is fitted to, and which way each must act; others weigh nothing."""
GATE = 0.9
"""Confidence from which a registration counts as sure."""


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


def calibrate(scores: Sequence[PairScore]) -> PairCalibration:
    """Confidence fitted to scores with features (from validation pairs, never from test data).

    A logistic model of the features in `SIGNS` (few, for validation pairs are few). One that
    would act the wrong way is left out, the most harmful first: with so few wrong results such a
    weight is noise.

    Raises:
        ValueError: all scores are right, or all are wrong.
    """
    usable = [s for s in scores if len(s.features) and np.isfinite(s.features).all()]
    every = np.array([s.features for s in usable])
    right = np.array([s.right for s in usable])
    names = list(SIGNS)
    while True:
        columns = [feature_names().index(name) for name in names]
        fit = metric.fit_logistic(every[:, columns], right, ridge=1.0)
        harm = -np.array([SIGNS[n] for n in names]) * fit.weights * every[:, columns].std(axis=0)
        if len(names) == 1 or harm.max() <= 0.0:
            break
        names.pop(int(harm.argmax()))
    weights = np.zeros(len(feature_names()))
    weights[columns] = fit.weights
    return PairCalibration(tuple(float(w) for w in weights), float(fit.bias), True)


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
                static_pair(
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
                    static_pair(
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


def static_pair(
    source: NDArray[np.float32],
    target: NDArray[np.float32],
    T: F64,
    overlap: float,
    name: str,
    voxel_size_m: float = RECORDED_VOXEL_M,
) -> PointPair:
    """A pair in which nothing moves: source (N, 3), target (M, 3), T_target_source (4, 4)."""
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
        voxel_size_m=voxel_size_m,
        name=name,
    )

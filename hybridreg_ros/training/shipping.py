# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""From a training checkpoint to the file that ships: confidence fitted, halved, provenance."""

from __future__ import annotations

import dataclasses
import datetime
import json
from typing import TYPE_CHECKING, Any

from hybridreg_ros.core.config import to_dict
from hybridreg_ros.model.checkpoint import load_checkpoint, save_network
from hybridreg_ros.model.register import HybridReg
from hybridreg_ros.training.evaluate import calibrate, evaluate

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from hybridreg_ros.data.pair import PointPair
    from hybridreg_ros.model.budget import Budget
    from hybridreg_ros.training.report import EvalReport

MACHINE_KEYS = ('data', 'validation', 'out', 'start_weights')
"""Entries of the training config that name folders of one machine; they do not ship."""


def ship(
    weights: str | Path,
    pairs: Iterable[PointPair],
    out: str | Path,
    about: dict[str, Any] | None = None,
    budget: Budget | None = None,
) -> EvalReport:
    """Fit the confidence to validation pairs and write a weights file for users.

    Args:
        weights: checkpoint of a training run.
        pairs: validation pairs that nothing else is scored on.
        out: file to write, float16.
        about: further provenance, such as a description of the data.
        budget: at which the pairs are registered; None: the full size.

    Returns:
        Scores of the pairs, one attempt each, with the fitted confidence (without its fading for
        few points).

    Raises:
        WeightsError: the checkpoint cannot be read.
        ValueError: all results are right, or all are wrong.
    """
    checkpoint = load_checkpoint(weights)
    network = checkpoint.network
    network.config = dataclasses.replace(network.config, estimator='verified')
    single = dataclasses.replace(network.config, attempts=1)
    report = evaluate(HybridReg(single, network), pairs, budget=budget)
    calibration = calibrate(report.scores)
    save_network(
        out,
        network,
        {
            **_provenance(dict(checkpoint.provenance)),
            'calibration_pairs': len(report.scores),
            'calibration_budget': None if budget is None else to_dict(budget),
            'date': datetime.datetime.now(datetime.UTC).date().isoformat(),
            'licence': 'Apache-2.0',
            **(about or {}),
        },
        calibration,
        half=True,
    )
    judged = tuple(
        dataclasses.replace(s, confidence=calibration.logistic(s.features)) for s in report.scores
    )
    return dataclasses.replace(report, scores=judged)


def _provenance(found: dict[str, Any]) -> dict[str, Any]:
    """What a checkpoint says of its training, without folders of the machine it ran on."""
    kept = dict(found)
    if isinstance(kept.get('train_config'), str):
        config = json.loads(kept.pop('train_config'))
        kept['training'] = {k: v for k, v in config.items() if k not in MACHINE_KEYS}
    return kept

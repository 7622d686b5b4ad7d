# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`hybridreg replay --suite dev --fit`, `--fit-confidence`: missing runs, then the fit."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Any

from hybridreg_ros.cli.common import bar, odometry_config, write_result
from hybridreg_ros.core.errors import ConfigError, WeightsError
from hybridreg_ros.odometry import calibration
from hybridreg_ros.replay import suite_claims, suite_data, suite_fit, suite_run
from hybridreg_ros.replay.outputs import write_json
from hybridreg_ros.replay.suite_list import STRIDES

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable
    from pathlib import Path

    from hybridreg_ros.odometry.config import OdometryConfig
    from hybridreg_ros.replay.suite_list import Sequence

    Tick = Callable[[], Any]


def evidence(args: argparse.Namespace, sequences: list[Sequence]) -> int:
    """Fit evidence and covariance and write them.

    Raises:
        ConfigError: the suite is one that is scored.
    """
    _only_dev(args)
    config = odometry_config(args.config, args.registrar)
    mark = suite_run.fingerprint('ours-no-network', config, None)
    del mark['calibration']  # every pose is gathered, whatever its confidence
    strides = tuple(args.strides or STRIDES)
    runs = [(n, True) for n in strides] + [(max(1, n // 2), False) for n in strides]
    parts = []
    with bar(len(sequences) * len(runs), 'fit', 'run') as shown:
        for sequence in sequences:
            parts += _evidences(args, sequence, runs, config, mark, shown.update)
    found, quality = suite_fit.fit(parts)
    print(json.dumps({**found.evidence.to_dict(), 'covariance_scale': found.covariance_scale}))
    return _write_fit(args, args.fit, found, quality)


def _evidences(
    args: argparse.Namespace, sequence: Sequence, runs: list[tuple[int, bool]],
    config: OdometryConfig, mark: dict[str, Any], tick: Tick,
) -> list[suite_fit.Evidences]:  # fmt: skip
    """What a sequence gives to a fit; kept in the folder `fit` while code and settings stay.

    Each run has a stride, and predictions that are off or not.
    """
    parts, frames = [], None
    for stride, jolted in runs:
        path = args.out / 'fit' / f'{sequence.name}__{stride}{"" if jolted else "__plain"}.json'
        kept = _kept(path, sequence, mark)
        if kept is None:
            frames = frames or suite_data.load(sequence, args.data, args.out / 'cache')
            part = suite_fit.gather(sequence, frames, stride, config, jolted)
            kept = _keep(path, sequence, mark, part.to_dict())
        parts.append(suite_fit.Evidences.from_dict(kept))
        tick()
    return parts


def confidence(args: argparse.Namespace, sequences: list[Sequence]) -> int:
    """Fit the confidence that is reported and write it, with the packaged evidence.

    Raises:
        ConfigError: the suite is one that is scored.
    """
    _only_dev(args)
    config = odometry_config(args.config, args.registrar)
    mark = suite_run.fingerprint('ours', config, weights_of(args))
    mark['calibration'] = calibration.packaged().evidence.to_dict()
    strides = tuple(args.strides or STRIDES)
    parts = []
    with bar(len(sequences) * len(strides), 'fit', 'run') as shown:
        for sequence in sequences:
            parts += _claims(args, sequence, strides, config, mark, shown.update)
    found, quality = suite_claims.fit(parts)
    print(json.dumps(found.confidence.to_dict()))
    return _write_fit(args, args.fit_confidence, found, quality)


def _claims(
    args: argparse.Namespace, sequence: Sequence, strides: tuple[int, ...],
    config: OdometryConfig, mark: dict[str, Any], tick: Tick,
) -> list[suite_claims.Claims]:  # fmt: skip
    """Claims of a sequence; kept in the folder `claims` while code, settings and weights stay."""
    parts, frames = [], None
    for stride in strides:
        path = args.out / 'claims' / f'{sequence.name}__{stride}.json'
        kept = _kept(path, sequence, mark)
        if kept is None:
            frames = frames or suite_data.load(sequence, args.data, args.out / 'cache')
            part = suite_claims.gather(sequence, frames, stride, config, _model(args))
            kept = _keep(path, sequence, mark, part.to_dict())
        parts.append(suite_claims.Claims.from_dict(kept))
        tick()
    return parts


def _kept(path: Path, sequence: Sequence, mark: dict[str, Any]) -> dict[str, Any] | None:
    """What a file holds when it was made under the same mark, else None."""
    if not path.is_file():
        return None
    kept: dict[str, Any] = json.loads(path.read_text('utf-8'))
    same = kept.get('fingerprint') == mark and kept.get('frames') == sequence.frames
    return kept if same else None


def _keep(
    path: Path, sequence: Sequence, mark: dict[str, Any], values: dict[str, Any]
) -> dict[str, Any]:
    """Write what a run gave, with its mark."""
    kept = {'fingerprint': mark, 'frames': sequence.frames, **values}
    write_json(path, kept)
    return kept


def _only_dev(args: argparse.Namespace) -> None:
    if args.suite != 'dev':
        raise ConfigError('--fit needs --suite dev: what is scored must not be fitted on')


def _model(args: argparse.Namespace) -> Any:
    """The network of a fit, as HybridOdometry takes it."""
    if args.weights is None:
        return 'auto'
    from hybridreg_ros.model.register import HybridReg

    return HybridReg.from_pretrained(args.weights)


def _write_fit(
    args: argparse.Namespace, path: Path, found: calibration.Calibration, quality: dict[str, Any]
) -> int:
    write_json(path, found.to_dict())
    print(json.dumps(quality))
    print(f'written: {path}')
    write_result(args, found.to_dict())
    return 0


def weights_of(args: argparse.Namespace) -> Path | None:
    """The checkpoint that will be used: the one given, or the packaged one when it ships."""
    if args.weights is not None:
        given: Path = args.weights
        return given
    from hybridreg_ros.model.checkpoint import packaged_weights

    try:
        return packaged_weights()
    except WeightsError as error:
        print(f'hybridreg: no network: {error}', file=sys.stderr)
        return None

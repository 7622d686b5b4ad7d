# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`hybridreg replay --suite dev --fit`, `--fit-confidence`: missing runs, then the fit."""

from __future__ import annotations

import json
import logging
from functools import partial
from typing import TYPE_CHECKING, Any

from hybridreg_ros.benchmark import suite_confidence, suite_data, suite_fit, suite_run
from hybridreg_ros.benchmark.suite_list import STRIDES
from hybridreg_ros.core.errors import ConfigError, WeightsError
from hybridreg_ros.core.progress import bar
from hybridreg_ros.odometry.selection import calibration
from hybridreg_ros.replay.outputs import write_json
from hybridreg_ros.replay.session import odometry_config

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from hybridreg_ros.benchmark.suite_data import SuiteFrame
    from hybridreg_ros.benchmark.suite_list import Sequence

    Part = suite_fit.EvidenceSamples | suite_confidence.ReportedSamples
    Tick = Callable[[], Any]
    Fitted = tuple[str, dict[str, Any]]

_log = logging.getLogger(__name__)


def evidence(args: argparse.Namespace, sequences: list[Sequence]) -> Fitted:
    """Fit evidence and covariance and write them; text to print, and the weights.

    Raises:
        ConfigError: the suite is one that is scored.
    """
    _only_dev(args, '--fit')
    config = odometry_config(args.config, args.registrar)
    mark = suite_run.fingerprint('ours-no-network', config, None)
    del mark['calibration']  # every pose is gathered, whatever its confidence
    strides = tuple(args.strides or STRIDES)
    wanted = [(n, True) for n in strides] + [(max(1, n // 2), False) for n in strides]
    parts: list[dict[str, Any]] = []
    with bar(len(sequences) * len(wanted), 'fit', 'run') as shown:
        for sequence in sequences:
            runs = {
                f'fit/{sequence.name}__{stride}{"" if jolted else "__plain"}.json': partial(
                    suite_fit.gather, sequence, stride=stride, base=config, jolted=jolted
                )
                for stride, jolted in wanted
            }
            parts += _parts(args, sequence, mark, runs, shown.update)
    found, quality = suite_fit.fit([suite_fit.EvidenceSamples.from_dict(p) for p in parts])
    shown_first = {**found.evidence.to_dict(), 'covariance_scale': found.covariance_scale}
    return _written(args.fit, found, shown_first, quality)


def confidence(args: argparse.Namespace, sequences: list[Sequence]) -> Fitted:
    """Fit the reported confidence and write it, with the packaged evidence; as `evidence`.

    Raises:
        ConfigError: the suite is one that is scored.
    """
    _only_dev(args, '--fit-confidence')
    config = odometry_config(args.config, args.registrar)
    mark = suite_run.fingerprint('ours', config, weights_of(args))
    mark['calibration'] = calibration.packaged().evidence.to_dict()
    strides, model = tuple(args.strides or STRIDES), _model(args)
    parts: list[dict[str, Any]] = []
    with bar(len(sequences) * len(strides), 'fit', 'run') as shown:
        for sequence in sequences:
            runs = {
                f'confidence/{sequence.name}__{stride}.json': partial(
                    suite_confidence.gather, sequence, stride=stride, config=config, model=model
                )
                for stride in strides
            }
            parts += _parts(args, sequence, mark, runs, shown.update)
    found, quality = suite_confidence.fit(
        [suite_confidence.ReportedSamples.from_dict(p) for p in parts]
    )
    return _written(args.fit_confidence, found, found.confidence.to_dict(), quality)


def _parts(
    args: argparse.Namespace,
    sequence: Sequence,
    mark: dict[str, Any],
    runs: Mapping[str, Callable[[list[SuiteFrame]], Part]],
    tick: Tick,
) -> Iterator[dict[str, Any]]:
    """What each run of a sequence gave, by its file; kept while its mark stays.

    The frames are loaded when a run is missing.
    """
    mark = {'fingerprint': mark, 'frames': sequence.frames}
    frames = None
    for name, gather in runs.items():
        path = args.out / name
        kept = json.loads(path.read_text('utf-8')) if path.is_file() else {}
        if any(kept.get(key) != value for key, value in mark.items()):
            frames = frames or suite_data.load(sequence, args.data, args.out / 'cache')
            kept = {**mark, **gather(frames).to_dict()}
            write_json(path, kept)
        yield kept
        tick()


def _only_dev(args: argparse.Namespace, option: str) -> None:
    if args.suite != 'dev':
        raise ConfigError(
            f'{option} needs --suite dev: sequences that are scored must not be used for fitting'
        )


def _model(args: argparse.Namespace) -> Any:
    """The network of a fit, as HybridOdometry takes it."""
    if args.weights is None:
        return 'auto'
    from hybridreg_ros.model.register import HybridReg

    return HybridReg.from_pretrained(args.weights)


def _written(
    path: Path, found: calibration.OdometryCalibration, fitted: Any, quality: dict[str, Any]
) -> Fitted:
    write_json(path, found.to_dict())
    lines = json.dumps(fitted), json.dumps(quality), f'written: {path}'
    return '\n'.join(lines), found.to_dict()


def weights_of(args: argparse.Namespace) -> Path | None:
    """The checkpoint that will be used: the one given, or the packaged one when it ships."""
    if args.weights is not None:
        given: Path = args.weights
        return given
    from hybridreg_ros.model.checkpoint import packaged_weights

    try:
        return packaged_weights()
    except WeightsError as error:
        _log.warning('no network: %s', error)
        return None

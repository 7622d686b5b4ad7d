# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""`hybridreg replay --suite`: benchmark cells that do not exist yet, then table and plots."""

from __future__ import annotations

import json
import sys
from functools import partial
from typing import TYPE_CHECKING, Any

from hybridreg_ros.benchmark import (
    fits,
    suite_data,
    suite_memory,
    suite_plots,
    suite_run,
    suite_table,
)
from hybridreg_ros.benchmark.suite_list import METHODS, STRIDES, chosen
from hybridreg_ros.cli.common import told, write_result
from hybridreg_ros.core.errors import ConfigError, DependencyError, FileFormatError
from hybridreg_ros.core.progress import bar
from hybridreg_ros.replay.interrupt import StopRequest
from hybridreg_ros.replay.outputs import write_json
from hybridreg_ros.replay.session import odometry_config

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable
    from pathlib import Path

    from hybridreg_ros.benchmark.suite_list import Sequence
    from hybridreg_ros.odometry.config import OdometryConfig

EXIT_INTERRUPTED = 130


def run(args: argparse.Namespace) -> int:
    """Run what is missing, write the table, say what could not be run.

    Raises:
        ConfigError: no output folder, bags beside --suite, or an unknown name.
        FileFormatError: the figures of memory in the output folder are something else.
    """
    if args.bags:
        raise ConfigError('--suite takes no bags: leave one of them out')
    if args.out is None:
        raise ConfigError('--suite needs a folder for its results: give --out')
    methods = tuple(args.methods or METHODS)
    unknown = [m for m in methods if m not in METHODS]
    if unknown:
        raise ConfigError(
            f'--methods: expected some of {", ".join(METHODS)}, found {unknown[0]!r}'
        )
    sequences = chosen(args.suite, args.sequences, args.frames)
    if args.fit is not None:
        return told(args, *fits.evidence(args, sequences))
    if args.fit_confidence is not None:
        return told(args, *fits.confidence(args, sequences))
    memory = suite_memory.read(args.out)
    code = 0
    if not args.table_only:
        code = _run_all(args, sequences, methods, tuple(args.strides or STRIDES))
    cells = suite_table.read_cells(args.out / 'cells')
    table = suite_table.build(cells, memory=memory)
    write_json(args.out / 'suite.json', table)
    text = suite_table.markdown(table)
    (args.out / 'suite.md').write_text(text, 'utf-8')
    print(text)
    plots = _plots(cells, args.out / 'plots')
    print(f'written: suite.json suite.md {plots} in {args.out}; one JSON per cell in cells')
    write_result(args, table)
    return code


def _plots(cells: list[dict[str, Any]], folder: Path) -> str:
    """Write the plots; what to call them in the last line."""
    try:
        written = suite_plots.write_plots(cells, folder)
    except DependencyError as error:
        print(f'hybridreg: no plots: {error}', file=sys.stderr)
        return ''
    return f'and {len(written)} plots'


def _run_all(
    args: argparse.Namespace,
    sequences: list[Sequence],
    methods: tuple[str, ...],
    strides: tuple[int, ...],
) -> int:
    config = odometry_config(args.config, args.registrar)
    weights = fits.weights_of(args)
    prints = {m: suite_run.fingerprint(m, config, weights) for m in methods}
    with (
        StopRequest() as stop,
        bar(len(sequences) * len(methods) * len(strides), 'suite', 'cell') as shown,
    ):
        for sequence in sequences:
            wanted = [
                (method, stride)
                for stride in strides
                for method in methods
                if not _made(args.out, sequence, method, stride, prints[method])
            ]
            shown.update(len(methods) * len(strides) - len(wanted))
            if not wanted:
                continue
            try:
                frames = suite_data.load(sequence, args.data, args.out / 'cache')
            except (DependencyError, FileFormatError) as error:
                print(f'hybridreg: {sequence.name} left out: {error}', file=sys.stderr)
                shown.update(len(wanted))
                continue
            runner = partial(_run_cell, sequence, config, weights)
            _run_cells(args.out, frames, wanted, runner, stop, shown.update)
            if stop():
                return EXIT_INTERRUPTED
    return 0


def _run_cell(
    sequence: Sequence,
    config: OdometryConfig,
    weights: Path | None,
    frames: list[suite_data.SuiteFrame],
    method: str,
    stride: int,
) -> dict[str, Any]:
    return suite_run.run_cell(sequence, frames, method, stride, config, weights)


def _run_cells(
    out: Path,
    frames: list[suite_data.SuiteFrame],
    wanted: list[tuple[str, int]],
    runner: Callable[[list[suite_data.SuiteFrame], str, int], dict[str, Any]],
    stop: Callable[[], bool],
    tick: Callable[[], Any],
) -> None:
    """Cells of one sequence; a method whose package is missing is left out and named."""
    for method, stride in wanted:
        if stop():
            return
        if len(frames[::stride]) >= 2:
            try:
                cell = runner(frames, method, stride)
            except DependencyError as error:
                print(f'hybridreg: {method} left out: {error}', file=sys.stderr)
            else:
                write_json(_path(out, cell['sequence']['name'], method, stride), cell)
        tick()


def _path(out: Path, sequence: str, method: str, stride: int) -> Path:
    return out / 'cells' / f'{sequence}__{method}__{stride}.json'


def _made(
    out: Path, sequence: Sequence, method: str, stride: int, fingerprint: dict[str, Any]
) -> bool:
    """Whether a cell exists that the same code, settings and weights made on as many frames."""
    path = _path(out, sequence.name, method, stride)
    if not path.is_file():
        return False
    try:
        cell = json.loads(path.read_text('utf-8'))
    except json.JSONDecodeError:
        return False
    return bool(
        cell.get('version') == suite_run.VERSION
        and cell.get('fingerprint') == fingerprint
        and cell['sequence']['frames'] == sequence.frames
        and cell['sequence']['seed'] == sequence.seed
    )

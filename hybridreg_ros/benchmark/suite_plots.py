# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Plots of a benchmark from its cells: trajectories, confidence against error, reliability."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.core.errors import require
from hybridreg_ros.metrics.calibration import reliability, risk_coverage

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

Cell = dict[str, Any]
_COLUMNS = 4
_COLOURS = {'ours': 'C0', 'ours-no-network': 'C2', 'kiss-icp': 'C3', 'genz-icp': 'C1'}
_LEAST_MM = 0.1


def _figure(width: float, height: float) -> Any:
    require('a plot', 'data', 'matplotlib')
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout='constrained')


def write_plots(cells: Sequence[Cell], folder: Path) -> list[Path]:
    """Pictures per suite that has cells: trajectories, what the confidence is worth, masks.

    Args:
        cells: what `suite_run.run_cell` made.
        folder: where the PNG files go.

    Raises:
        DependencyError: matplotlib is not installed.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written: list[Path] = []
    for suite in ('rooms', 'streets', 'real'):
        mine = [c for c in cells if c['sequence']['suite'] == suite]
        if not mine:
            continue
        paths = folder / f'{suite}_trajectories.png', folder / f'{suite}_confidence.png'
        _trajectories([c for c in mine if c['stride'] == 1], suite).savefig(paths[0], dpi=80)
        _confidence([c for c in mine if c['method'] == 'ours'], suite).savefig(paths[1], dpi=80)
        written += paths
        seen = [c for c in mine if c['method'] == 'ours' and c['stride'] == 1 and c.get('views')]
        if seen:
            written.append(folder / f'{suite}_masks.png')
            _masks(seen, suite).savefig(written[-1], dpi=80)
    return written


def _masks(cells: Sequence[Cell], suite: str) -> Any:
    """The middle frame of each sequence as the sensor sees it, with what is called moving."""
    rows = max(1, -(-len(cells) // _COLUMNS))
    figure = _figure(3.2 * _COLUMNS, 2.6 * rows)
    figure.suptitle(
        f'{suite}: called moving (green: it does, red: it does not), missed (blue); degrees'
    )
    colours = np.array(['0.75', 'C3', 'C0', 'C2'])
    for number, cell in enumerate(cells):
        axes = figure.add_subplot(rows, _COLUMNS, number + 1)
        frame, points = next(iter(cell['views'].items()))
        across, up, kind = np.array(points).T
        axes.scatter(across, up, s=1, c=colours[kind.astype(np.int64)], linewidths=0)
        axes.set_title(f'{cell["sequence"]["name"]}, frame {frame}', fontsize=9)
        axes.tick_params(labelsize=7)
    return figure


def _trajectories(cells: Sequence[Cell], suite: str) -> Any:
    """One panel per sequence: the two axes along which the sensor moves most."""
    names = sorted({c['sequence']['name'] for c in cells})
    rows = max(1, -(-len(names) // _COLUMNS))
    figure = _figure(3.2 * _COLUMNS, 3.2 * rows)
    figure.suptitle(f'{suite}: positions after alignment, metres; black: truth')
    for number, name in enumerate(names):
        axes = figure.add_subplot(rows, _COLUMNS, number + 1)
        here = [c for c in cells if c['sequence']['name'] == name]
        truth = np.array(here[0]['trajectory']['truth'])
        first, second = np.sort(np.argsort(-np.ptp(truth, axis=0))[:2])
        axes.plot(truth[:, first], truth[:, second], 'k', linewidth=3, alpha=0.35)
        for cell in here:
            if cell['method'] in _COLOURS:
                line = np.array(cell['trajectory']['estimate'])
                axes.plot(
                    line[:, first],
                    line[:, second],
                    color=_COLOURS[cell['method']],
                    linewidth=1,
                    label=f'{cell["method"]} {1e3 * cell["scores"]["ate_m"]:.0f} mm',
                )
        axes.set_title(name, fontsize=9)
        axes.set_aspect('equal', 'datalim')
        axes.legend(fontsize=6)
        axes.tick_params(labelsize=7)
    return figure


def _confidence(cells: Sequence[Cell], suite: str) -> Any:
    """Confidence against step error, reliability diagram and risk-coverage curve of ours."""
    frames = [f for c in cells for f in c['frames'][1:] if f['confidence'] is not None]
    told = np.array([f['confidence'] for f in frames])
    right = np.array([f['pose_right'] for f in frames], np.bool_)
    figure = _figure(12.0, 3.8)
    figure.suptitle(
        f'{suite}: ours, all strides, {len(frames)} frames, {int((~right).sum())} wrong'
    )
    left, middle, last = (figure.add_subplot(1, 3, k) for k in (1, 2, 3))
    if frames:
        error = np.maximum(_LEAST_MM, 1e3 * np.array([f['step_m'] for f in frames]))
        left.scatter(told, error, s=6, c=np.where(right, 'C0', 'C3'))
        diagram = reliability(told, right)
        middle.plot([0, 1], [0, 1], 'k:', linewidth=1)
        middle.plot(diagram.confidence, diagram.accuracy, 'o-')
        for x, y, n in zip(*diagram, strict=True):
            if n:
                middle.annotate(str(n), (x, y), fontsize=7)
        curve = risk_coverage(told, right)
        last.plot(curve.coverage, 100.0 * curve.risk)
    left.set(xlabel='confidence', ylabel='step error, mm (red: wrong)', yscale='log')
    middle.set(xlabel='confidence', ylabel='share right (number of frames)')
    last.set(xlabel='share of frames accepted', ylabel='wrong among them, percent')
    return figure

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The benchmark table: every goal with its floor, figure and number of cells, from the JSONs."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.benchmark import suite_memory
from hybridreg_ros.benchmark.suite_list import BASELINES, METHODS, SEQUENCES, STRIDES
from hybridreg_ros.metrics.calibration import expected_calibration_error
from hybridreg_ros.metrics.mask import MaskCounts, score
from hybridreg_ros.odometry.config import GateConfig

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping
    from pathlib import Path

Cell = dict[str, Any]
OURS = 'ours'
_STATIC_REAL = ('lidar_balm_walk_a', 'lidar_kitti_raw_22scans', 'depth_7scenes')
_QUIET_REAL = ('lidar_balm_walk_a', 'depth_7scenes')
_NO_LOOP = f'memory: no loop of {suite_memory.STEPS:,} frames (scripts/memory_report.py)'
_DENSE = {'depth': ('depth_7scenes',), 'lidar': ('lidar_kitti_raw_22scans',)}


def read_cells(folder: Path) -> list[Cell]:
    """All cells in a folder, by name; files that are no JSON are skipped."""
    cells = []
    for path in sorted(folder.glob('*.json')):
        try:
            cells.append(json.loads(path.read_text('utf-8')))
        except json.JSONDecodeError:
            continue
    return cells


def build(
    cells: list[Cell], method: str = OURS, memory: Mapping[str, dict[str, Any]] | None = None
) -> dict[str, Any]:
    """The table of one of our methods as plain values.

    Args:
        cells: what `suite_run.run_cell` made.
        method: ours, ours-no-mask or ours-no-network.
        memory: what `suite_memory.read` gives; measured of ours alone.
    """
    loops = [r for r in (memory or {}).values() if r['steps'] >= suite_memory.STEPS]
    scored = [c for c in cells if c['sequence']['suite'] != 'dev']
    mine = [c for c in scored if c['method'] == method]
    return {
        'method': method,
        'rows': [*_rows(mine, scored), _memory(loops if method == OURS else [])],
        'cells': [_brief(c) for c in sorted(scored, key=_order)],
        'missing': [*_missing(scored), *([] if loops else [_NO_LOOP])],
        'provenance': scored[-1]['provenance'] if scored else {},
    }


def _order(cell: Cell) -> tuple[str, str, int, int]:
    sequence = cell['sequence']
    return sequence['suite'], sequence['name'], cell['stride'], METHODS.index(cell['method'])


def _brief(cell: Cell) -> dict[str, Any]:
    masks = [f['mask'] for f in cell['frames'] if f['mask'] is not None]
    mask = score(sum((MaskCounts(*m) for m in masks), MaskCounts()))
    times = [f['cpu_ms'] for f in cell['frames'][1:]]
    return {
        'sequence': cell['sequence']['name'],
        'share': cell['sequence']['share'],
        'method': cell['method'],
        'stride': cell['stride'],
        **cell['scores'],
        'cpu_ms_median': float(np.median(times)),
        'cpu_ms_p95': float(np.percentile(times, 95)),
        'iou': mask.iou,
        'precision': mask.precision,
        'recall': mask.recall,
        'by_network': sum(f['source'] == 'hybridreg' for f in cell['frames']),
    }


def _missing(cells: list[Cell]) -> list[str]:
    """What of the whole suite has no cell: sequence and how many of its cells."""
    have = {(c['sequence']['name'], c['method'], c['stride']) for c in cells}
    short = {c['sequence']['name']: c['sequence']['frames'] for c in cells}
    found = []
    for s in SEQUENCES.values():
        strides = [n for n in STRIDES if -(-s.frames // n) >= 2]
        wanted = [(s.name, m, n) for m in METHODS for n in strides]
        gone = [w for w in wanted if w not in have]
        if s.suite != 'dev' and gone:
            found.append(f'{s.name}: {len(gone)} of {len(wanted)} cells')
        if short.get(s.name, s.frames) < s.frames:
            found.append(f'{s.name}: run on {short[s.name]} of {s.frames} frames')
    return found


def _rows(mine: list[Cell], cells: list[Cell]) -> list[dict[str, Any]]:
    """Every row of the floor table."""
    heavy, still = ('30-50',), ('none',)
    rooms = [c for c in mine if c['sequence']['suite'] == 'rooms' and c['stride'] == 1]
    at_heavy = [c for c in rooms if c['sequence']['share'] in heavy]
    at_still = [c for c in rooms if c['sequence']['share'] in still]
    real = [c for c in mine if c['sequence']['name'] in _STATIC_REAL and c['stride'] == 1]
    fives = [f for c in mine if c['stride'] == 5 for f in c['frames'][1:]]
    keyframes = [c for c in mine if c['sequence']['name'] == 'lidar_kitti07_keyframes5']
    pairs = [f for c in keyframes if c['stride'] == 1 for f in c['frames'][1:]]
    frames = [f for c in mine for f in c['frames'][1:]]
    mask = _mask(c for c in mine if c['sequence']['source'] == 'simulated')
    quiet = _mask(c for c in mine if c['sequence']['name'] in _QUIET_REAL)
    row = _row
    return [
        row('ATE against the better of kiss-icp and genz-icp, rooms 30-50 %', 0.3, 0.05,
            _ratios(at_heavy, cells), 'median of ratios'),
        row('ATE in percent of the path, rooms static', 1.5, 0.3, _values(at_still, 'ate_percent'),
            'median'),
        row('ATE in percent of the path, rooms 30-50 %', 3.0, 0.5,
            _values(at_heavy, 'ate_percent'), 'median'),
        row('ATE against the better baseline, rooms 0 % and static real', 1.05, 0.8,
            _ratios([*at_still, *real], cells), 'median of ratios'),
        row('wrong steps at stride 5, all suites (right: 95 / 100 %)', 0.05, 0.0,
            [float(not f['step_right']) for f in fives], 'share', np.mean),
        row('wrong pairs of lidar_kitti07_keyframes5 (right: 4 of 4)', 0.0, 0.0,
            [float(not f['step_right']) for f in pairs], 'count', np.sum),
        row('wrong poses above the gate', 0.01, 0.0, _wrong_above(frames), 'share', np.mean),
        row('1 - IoU of the moving class, simulated (IoU 0.60 / 0.90)', 0.40, 0.10,
            [] if mask.total == 0 else [1.0 - score(mask).iou], 'all points'),
        row('1 - precision of the moving class (0.85 / 0.98)', 0.15, 0.02,
            [] if mask.total == 0 else [1.0 - score(mask).precision], 'all points'),
        row('points falsely called dynamic, balm and 7-Scenes', 0.01, 0.001,
            [] if quiet.total == 0 else [score(quiet).false_share], 'all points'),
        row('p95 of step(), 640x480 depth, CPU ms', 200.0, 60.0, _times(mine, 'depth'), 'p95',
            _p95),
        row('p95 of step(), 120,000-point lidar, CPU ms', 250.0, 80.0, _times(mine, 'lidar'),
            'p95', _p95),
        row("CPU time against kiss-icp's own step", 2.0, 0.8, _time_ratios(mine, cells),
            'median of ratios'),
        row('ECE of the confidence (no floor set)', float('nan'), float('nan'), _ece(frames),
            '10 bins'),
    ]  # fmt: skip


def _memory(loops: list[dict[str, Any]]) -> dict[str, Any]:
    """The row of loops that are long enough."""
    return _row(
        f'growth of resident memory over {suite_memory.STEPS:,} frames of a looped sequence, MB',
        50.0,
        5.0,
        [suite_memory.growth_mb(r) for r in loops],
        'largest',
        max,
    )


def _row(
    name: str,
    floor: float,
    goal: float,
    values: Iterable[float],
    how: str,
    reduce: Callable[[list[float]], Any] = np.median,
) -> dict[str, Any]:
    """One row; all figures are such that smaller is better."""
    kept = [float(v) for v in values]
    figure = float(reduce(kept)) if kept else None
    verdict = 'not run' if figure is None else ('pass' if figure <= floor else 'below floor')
    if figure is not None and math.isnan(floor):
        verdict = '-'
    return {
        'name': name,
        'floor': floor,
        'goal': goal,
        'figure': figure,
        'n': len(kept),
        'how': how,
        'verdict': 'goal' if figure is not None and figure <= goal else verdict,
    }


def _p95(values: list[float]) -> float:
    return float(np.percentile(values, 95))


def _values(cells: Iterable[Cell], key: str) -> list[float]:
    return [c['scores'][key] for c in cells]


def _ratios(mine: Iterable[Cell], cells: list[Cell]) -> list[float]:
    """Our ATE over the better baseline's, where at least one was run."""
    found = []
    for cell in mine:
        others = [
            c['scores']['ate_m'] for c in cells if _same(c, cell) and c['method'] in BASELINES
        ]
        if others:
            found.append(cell['scores']['ate_m'] / max(1e-9, min(others)))
    return found


def _same(a: Cell, b: Cell) -> bool:
    keys = ('name', 'frames', 'seed')
    return a['stride'] == b['stride'] and all(a['sequence'][k] == b['sequence'][k] for k in keys)


def _wrong_above(frames: list[dict[str, Any]]) -> list[float]:
    """1 for each frame above the gate whose pose is wrong, 0 for the others."""
    gate = GateConfig().enter
    return [float((f['confidence'] or 0.0) >= gate and not f['pose_right']) for f in frames]


def _mask(cells: Iterable[Cell]) -> MaskCounts:
    """Sum over stride 1."""
    masks = [
        MaskCounts(*f['mask'])
        for c in cells
        if c['stride'] == 1
        for f in c['frames'][1:]
        if f['mask'] is not None
    ]
    return sum(masks, MaskCounts())


def _times(cells: Iterable[Cell], kind: str) -> list[float]:
    """CPU milliseconds of single steps on the dense recordings; the first ones warm up."""
    return [
        f['cpu_ms']
        for c in cells
        if c['stride'] == 1 and c['sequence']['name'] in _DENSE[kind]
        for f in c['frames'][2:]
    ]


def _time_ratios(mine: Iterable[Cell], cells: list[Cell]) -> list[float]:
    found = []
    for cell in mine:
        for other in cells:
            if _same(other, cell) and other['method'] == 'kiss-icp' and cell['stride'] == 1:
                ours = [f['cpu_ms'] for f in cell['frames'][2:]]
                theirs = [f['cpu_ms'] for f in other['frames'][2:]]
                found.append(float(np.median(np.array(ours) / np.array(theirs))))
    return found


def _ece(frames: list[dict[str, Any]]) -> list[float]:
    told = [f for f in frames if f['confidence'] is not None]
    if not told:
        return []
    return [
        expected_calibration_error(
            np.array([f['confidence'] for f in told]), np.array([f['pose_right'] for f in told])
        )
    ]


def markdown(table: dict[str, Any]) -> str:
    """The table as Markdown."""
    lines = [
        f'Method: `{table["method"]}`. Smaller is better in every row; n counts what the figure',
        'is made of (cells, frames or 1 for a sum over all points).',
        '',
        '| | floor | goal | figure | n | |',
        '|---|---|---|---|---|---|',
    ]
    for r in table['rows']:
        figure = '-' if r['figure'] is None else f'{r["figure"]:.3g}'
        lines.append(
            f'| {r["name"]} ({r["how"]}) | {_number(r["floor"])} | {_number(r["goal"])} '
            f'| {figure} | {r["n"]} | {r["verdict"]} |'
        )
    lines += [
        '',
        '| sequence | moving | stride | method | frames | ATE mm | % of path '
        '| step median mm | right steps | lost | CPU ms median / p95 | IoU | precision '
        '| by network |',
        '|' + '---|' * 14,
    ]
    for c in table['cells']:
        lines.append(
            f'| {c["sequence"]} | {c["share"] or "-"} | {c["stride"]} | {c["method"]} '
            f'| {c["frames"]} | {1e3 * c["ate_m"]:.1f} | {_number(c["ate_percent"])} '
            f'| {c["step_median_mm"]:.1f} | {100 * c["right_share"]:.0f} % | {c["lost"]} '
            f'| {c["cpu_ms_median"]:.0f} / {c["cpu_ms_p95"]:.0f} | {_number(c["iou"])} '
            f'| {_number(c["precision"])} | {c["by_network"]} |'
        )
    if table['missing']:
        lines += ['', 'Not run: ' + '; '.join(table['missing']) + '.']
    return '\n'.join(lines) + '\n'


def _number(value: float | None) -> str:
    return '-' if value is None or math.isnan(value) else f'{value:.3g}'

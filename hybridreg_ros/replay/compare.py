# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Runs on the same logs compared frame by frame: is the other setting really better?"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.core.errors import FileFormatError
from hybridreg_ros.core.scan import NS_PER_S
from hybridreg_ros.metrics.bootstrap import Difference, paired

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

OVERALL = 'overall'


@dataclass(frozen=True)
class Quantity:
    """A value that every frame has.

    Attributes:
        key: of the JSON.
        text: with its unit.
        sign: 1 where more is better, -1 where less is.
    """

    key: str
    text: str
    sign: int


QUANTITIES = (
    Quantity('step_mm', 'step error (mm)', -1),
    Quantity('position_mm', 'position error (mm)', -1),
    Quantity('iou', 'IoU of the moving class', 1),
    Quantity('total_ms', 'time per frame (ms)', -1),
)


@dataclass(frozen=True, eq=False)
class Series:
    """The frames of one run of one log: stamps (N,) int64 ns, values (N,) by quantity."""

    stamps: NDArray[np.int64]
    values: dict[str, NDArray[np.float64]]


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes:
        log: name, or OVERALL.
        other: the run that is compared with the base.
        quantity: key.
        base: mean of the base over the frames that both have.
        value: the same of the other.
        difference: other - base.
        verdict: better, worse, or no sure difference.
    """

    log: str
    other: str
    quantity: str
    base: float
    value: float
    difference: Difference
    verdict: str


def runs_of(folder: Path) -> dict[str, Series]:
    """Runs in a folder of results, or in a folder of such folders, by name; one alone is ''.

    Raises:
        FileFormatError: there is none, or a metrics.json cannot be read.
    """
    files = [folder / 'metrics.json'] if (folder / 'metrics.json').exists() else []
    found = files or sorted(folder.glob('*/metrics.json'))
    if not found:
        raise FileFormatError(f'{folder}: expected results of replay (metrics.json), found none')
    return {'' if files else path.parent.name: _series(path) for path in found}


def _series(path: Path) -> Series:
    try:
        frames = json.loads(path.read_text('utf-8'))['per_frame']
        rows = {int(f['stamp']): f for f in frames if f['accepted']}
        stamps = sorted(rows)
        values = {
            q.key: np.array([_value(rows[s], q.key) for s in stamps], np.float64)
            for q in QUANTITIES
        }
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FileFormatError(f'{path}: expected a metrics.json of replay: {error!r}') from None
    return Series(np.array(stamps, np.int64), values)


def _value(frame: dict[str, Any], key: str) -> float:
    if key != 'iou':
        return float('nan') if frame.get(key) is None else float(frame[key])
    counts = frame.get('mask')
    if not counts or not (union := counts['tp'] + counts['fp'] + counts['fn']):
        return float('nan')
    return float(counts['tp'] / union)


def compare(runs: dict[str, dict[str, Series]]) -> list[Row]:
    """Every run against the first one, per log and overall.

    Args:
        runs: frames by name of the run and name of the log.

    Raises:
        FileFormatError: a run has no log or no frame in common with the first.
    """
    (base_name, base), *others = runs.items()
    rows = []
    for name, other in others:
        logs = [log for log in base if log in other]
        pairs = {log: _matched(base[log], other[log]) for log in logs}
        pairs = {log: p for log, p in pairs.items() if len(p[0].stamps)}
        if not pairs:
            raise FileFormatError(f'{name} and {base_name} have no log and stamp in common')
        for quantity in QUANTITIES:
            for log, chosen in [(k or base_name, [p]) for k, p in pairs.items()] + (
                [(OVERALL, list(pairs.values()))] if len(pairs) > 1 else []
            ):
                row = _row(log, name, quantity, chosen)
                rows += [row] if row is not None else []
    return rows


def _matched(a: Series, b: Series) -> tuple[Series, Series]:
    _, mine, theirs = np.intersect1d(a.stamps, b.stamps, return_indices=True)
    return _taken(a, mine), _taken(b, theirs)


def _taken(series: Series, rows: NDArray[np.int64]) -> Series:
    return Series(series.stamps[rows], {k: v[rows] for k, v in series.values.items()})


def _row(
    log: str, other: str, quantity: Quantity, pairs: Sequence[tuple[Series, Series]]
) -> Row | None:
    values = [(a.values[quantity.key], b.values[quantity.key]) for a, b in pairs]
    difference = paired([b - a for a, b in values])
    if difference is None:
        return None
    both = [(a[m], b[m]) for a, b in values if (m := np.isfinite(a) & np.isfinite(b)).any()]
    base, value = (float(np.mean([v[k].mean() for v in both])) for k in (0, 1))
    verdict = 'no sure difference'
    if difference.is_sure:
        verdict = 'better' if difference.mean * quantity.sign > 0.0 else 'worse'
    return Row(log, other, quantity.key, base, value, difference, verdict)


def seconds(series: Series) -> NDArray[np.float64]:
    """Times of the frames since the first (N,), seconds."""
    since: NDArray[np.float64] = (series.stamps - series.stamps[0]) / NS_PER_S
    return since

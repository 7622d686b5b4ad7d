# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Tables and tiles of the report, and the same score table as plain text for the terminal."""

from __future__ import annotations

import json
import math
from html import escape
from typing import TYPE_CHECKING, Any

from hybridreg_ros.core.scan import NS_PER_S
from hybridreg_ros.replay.outputs import plain, stage_times

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from hybridreg_ros.metrics.trajectory import TrajectoryScore
    from hybridreg_ros.replay.outputs import Scores
    from hybridreg_ros.replay.runner import ReplayLog

    Row = tuple[str, ReplayLog, Scores]

MISSING = '-'
SHOWN_DROPS = 50


def number(value: float | None, digits: int) -> str:
    """A number with so many digits; a dash for none."""
    if value is None or not math.isfinite(value):
        return MISSING
    return f'{value:.{digits}f}'


def _trajectory_cells(t: TrajectoryScore) -> list[str]:
    return [
        number(1000.0 * t.ate_rmse_m, 1),
        number(t.ate_percent, 2),
        number(t.step_mean_mm, 1),
        number(t.step_mean_deg, 3),
        number(t.drift.translation_percent if t.drift else None, 2),
    ]


def score_rows(runs: Sequence[Row]) -> list[list[str]]:
    """Header and one row per run, as text."""
    header = ['run', 'frames', 'ATE mm', 'ATE %', 'step mm', 'step deg', 'drift %']
    header += ['IoU', 'precision', 'recall', 'ms/frame', 'network', 'kiss-icp', 'lost']
    rows = [header]
    for name, log, scores in runs:
        t, m = scores.trajectory, scores.mask
        total = stage_times(log.frames).get('total', {}).get('median')
        sources = log.sources()
        rows.append(
            [
                name,
                str(sum(f.accepted for f in log.frames)),
                *(_trajectory_cells(t) if t else [MISSING] * 5),
                *([number(v, 3) for v in (m.iou, m.precision, m.recall)] if m else [MISSING] * 3),
                number(total, 1),
                *(
                    str(sources.get(s, 0)) if sources else MISSING
                    for s in ('hybridreg', 'kiss_icp', 'lost')
                ),
            ]
        )
    return rows


def text_table(rows: Sequence[Sequence[str]]) -> str:
    """Rows aligned in columns for a terminal; the first column is left, the others right."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines = []
    for row in rows:
        cells = [row[0].ljust(widths[0])]
        cells += [cell.rjust(w) for cell, w in zip(row[1:], widths[1:], strict=True)]
        lines.append('  '.join(cells).rstrip())
    lines.insert(1, '-' * max(len(line) for line in lines))
    return '\n'.join(lines)


def _cell(text: str, link: str | None) -> str:
    name = escape(text)
    return name if link is None else f'<a href="{escape(link, quote=True)}">{name}</a>'


def html_table(rows: Sequence[Sequence[str]], links: Mapping[str, str] | None = None) -> str:
    """Header and rows of text; a first cell that `links` knows leads there."""
    links = links or {}
    head = ''.join(f'<th scope="col">{escape(cell)}</th>' for cell in rows[0])
    body = ''.join(
        f'<tr><th scope="row">{_cell(row[0], links.get(row[0]))}</th>'
        + ''.join(f'<td>{escape(cell)}</td>' for cell in row[1:])
        + '</tr>'
        for row in rows[1:]
    )
    return (
        f'<div class="scroll"><table><thead><tr>{head}</tr></thead>'
        f'<tbody>{body}</tbody></table></div>'
    )


def score_table(runs: Sequence[Row]) -> str:
    """Scores of all runs as an HTML table."""
    note = (
        '<p class="soft">ATE: RMSE of positions after alignment. Step: mean error from one frame '
        'to the next. Drift: mean error of path segments. IoU, precision, recall: points called '
        'moving against true labels.</p>'
    )
    columns = [list(column) for column in zip(*score_rows(runs), strict=True)]
    known = [c for c in columns if any(cell != MISSING for cell in c[1:])]
    return note + html_table(known)


def time_table(log: ReplayLog) -> str:
    """Milliseconds per stage as an HTML table, without the scans that load and compile."""
    rows = [['stage', 'median', 'mean', '95 %']]
    rows += [
        [stage, number(v['median'], 1), number(v['mean'], 1), number(v['p95'], 1)]
        for stage, v in stage_times(log.frames).items()
    ]
    return html_table(rows)


def drop_table(log: ReplayLog, start: int) -> str:
    """Clouds that were not used, with their reason; '' when all were."""
    if not log.drops:
        return ''
    rows = [['time s', 'reason']]
    rows += [[f'{(d.stamp - start) / NS_PER_S:.3f}', d.reason] for d in log.drops[:SHOWN_DROPS]]
    more = len(log.drops) - SHOWN_DROPS
    tail = f'<p>{more} more are listed in metrics.json.</p>' if more > 0 else ''
    return f'<section><h2>Clouds not used</h2>{html_table(rows)}{tail}</section>'


def notices(log: ReplayLog, scores: Scores) -> str:
    """What a reader must know first: remarks on the clouds, a doubtful or missing score."""
    texts = [f'Note: {note}.' for note in log.notes]
    if scores.warning:
        texts.append(f'{scores.warning}.')
    if scores.note:
        texts.append(f'No trajectory score: {scores.note}.')
    return ''.join(f'<p class="notice">{escape(text)}</p>' for text in texts)


def tiles(log: ReplayLog, scores: Scores) -> str:
    """The few figures that count, as list items; those that are not known are left out."""
    items = [('frames', str(len(log.frames)))]
    if scores.trajectory is not None:
        t = scores.trajectory
        items += [
            ('ATE (mm)', number(1000.0 * t.ate_rmse_m, 1)),
            ('mean step error (mm)', number(t.step_mean_mm, 1)),
            ('path (m)', number(t.path_m, 2)),
        ]
    else:
        items.append(('path (m)', number(log.trajectory().path_m, 2)))
    if scores.mask is not None:
        items.append(('IoU of the moving class', number(scores.mask.iou, 3)))
    total = stage_times(log.frames).get('total')
    if total is not None:
        items.append(('median ms per frame', number(total['median'], 1)))
    return ''.join(
        f'<li><strong>{value}</strong>{escape(name)}</li>'
        for name, value in items
        if value != MISSING
    )


def provenance(metrics: Mapping[str, Any]) -> str:
    """What the result was made with, folded; '' without metrics."""
    if not metrics:
        return ''
    kept = {k: v for k, v in metrics.items() if k not in ('per_frame', 'drops')}
    text = json.dumps(plain(kept), indent=1)
    return (
        '<section><h2>Made with</h2><details><summary>Configuration, versions, checksum and all '
        f'figures</summary><pre>{escape(text)}</pre></details></section>'
    )

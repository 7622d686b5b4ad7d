# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""compare.html: curves of several runs over each other, and what of their difference is sure."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.replay import compare
from hybridreg_ros.replay.page import charts
from hybridreg_ros.replay.page.shell import section, write_page
from hybridreg_ros.replay.page.tables import html_table

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

CHARTED = 12
"""Logs whose curves are drawn; the table has all."""
_TEXTS = {q.key: q.text for q in compare.QUANTITIES}


def rows(found: Sequence[compare.Row]) -> list[list[str]]:
    """Header and lines, as text."""
    table = [['log', 'run', 'value', 'base', 'mean', 'difference', '95 % interval', 'verdict']]
    for r in found:
        d = r.difference
        table.append(
            [
                r.log,
                r.other,
                _TEXTS[r.quantity],
                f'{r.base:.3f}',
                f'{r.value:.3f}',
                f'{d.mean:+.3f}',
                f'{d.low:+.3f} to {d.high:+.3f}',
                r.verdict,
            ]
        )
    return table


def write_comparison(
    path: Path, runs: dict[str, dict[str, compare.Series]], found: Sequence[compare.Row]
) -> None:
    """Write the page."""
    base, *others = runs
    ordered = sorted(found, key=lambda r: r.log != compare.OVERALL)
    told = [
        f'{r.other}: {_TEXTS[r.quantity]} is {r.verdict} ({r.difference.mean:+.3f}).'
        for r in ordered
        if r.log == (compare.OVERALL if len(runs[base]) > 1 else (next(iter(runs[base])) or base))
    ]
    body = f'<p class="soft">Base: {escape(base)}. Compared: {escape(", ".join(others))}.</p>'
    body += f'<ul class="story">{"".join(f"<li>{escape(t)}</li>" for t in told)}</ul>'
    note = (
        '<p class="soft">Differences are paired frame by frame; the interval is a bootstrap over '
        'blocks of frames and over logs. A difference is sure when it leaves zero out.</p>'
    )
    body += section('Differences', note + html_table(rows(ordered)))
    for log in list(runs[base])[:CHARTED]:
        body += section(log or 'Curves', _curves(runs, log))
    write_page(path, f'{base} against {", ".join(others)}', body)


def _curves(runs: dict[str, dict[str, compare.Series]], log: str) -> str:
    body = ''
    for q in compare.QUANTITIES:
        series = [
            charts.Series(name, compare.seconds(logs[log]), logs[log].values[q.key], k)
            for k, (name, logs) in enumerate(runs.items())
            if log in logs and np.isfinite(logs[log].values[q.key]).any()
        ]
        if series:
            chart = charts.time_chart(series, q.text, f'{q.text} over time')
            body += f'<figure><figcaption>{escape(q.text)} of each frame.</figcaption>{chart}'
            body += '</figure>'
    return body

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Many runs on one page and in one table, the worst first."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from hybridreg_ros.replay.page.shell import write_page
from hybridreg_ros.replay.page.tables import MISSING, html_table, number

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

FAILED, SHORT, DONE, KEPT = 'failed', 'ended early', 'done', 'kept'
HEADER = ['log', 'status', 'frames', 'ATE mm', 'ATE %', 'step mm', 'kiss-icp ATE mm', 'IoU']
HEADER += ['lost', 'confidence', 'reason']


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of one log.

    Attributes:
        name: unique.
        folder: of its results.
        status: FAILED, SHORT, DONE, or KEPT when an earlier command had done it.
        reason: why it failed or is short.
        metrics: content of its metrics.json; empty when it failed.
    """

    name: str
    folder: Path
    status: str
    reason: str = ''
    metrics: Mapping[str, Any] = field(default_factory=dict)


def worst_first(outcomes: Sequence[Outcome]) -> list[Outcome]:
    """Failed ones, then by the share of lost poses, the ATE in percent and the confidence."""

    def key(o: Outcome) -> tuple[bool, float, float, float]:
        m = o.metrics
        lost = m.get('sources', {}).get('lost', 0) / max(m.get('frames', 0), 1)
        ate = (m.get('trajectory') or {}).get('ate_percent') or 0.0
        return (o.status not in (FAILED, SHORT), -lost, -ate, m.get('confidence_mean') or 0.0)

    return sorted(outcomes, key=key)


def rows(outcomes: Sequence[Outcome]) -> list[list[str]]:
    """Header and one row per log, as text."""
    table = [HEADER]
    for o in outcomes:
        m = o.metrics
        t, mask = m.get('trajectory') or {}, m.get('mask') or {}
        other = next(iter((m.get('beside') or {}).values()), None) or {}
        ates = [run.get('ate_rmse_m') for run in (t, other)]
        mm = [None if ate is None else 1000.0 * ate for ate in ates]
        table.append(
            [
                o.name,
                o.status,
                str(m['frames']) if m else MISSING,
                number(mm[0], 1),
                number(t.get('ate_percent'), 2),
                number(t.get('step_mean_mm'), 1),
                number(mm[1], 1),
                number(mask.get('iou'), 3),
                str(m['sources'].get('lost', 0)) if m.get('sources') else MISSING,
                number(m.get('confidence_mean'), 3),
                o.reason or MISSING,
            ]
        )
    return table


def write_index(path: Path, outcomes: Sequence[Outcome]) -> None:
    """Write the page; the names lead to the reports."""
    ordered = worst_first(outcomes)
    count = {s: sum(o.status == s for o in outcomes) for s in (DONE, KEPT, SHORT, FAILED)}
    told = ', '.join(f'{n} {status}' for status, n in count.items() if n)
    links = {
        o.name: quote(os.path.relpath(o.folder / 'report.html', path.parent))
        for o in ordered
        if o.status != FAILED
    }
    body = f'<p class="soft">{told}; the worst first. A heading sorts.</p>'
    write_page(path, f'{len(outcomes)} logs', body + html_table(rows(ordered), links))

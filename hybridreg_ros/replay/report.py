# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""report.html: one self-contained page about a replay, or several compared side by side."""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.core.scan import NS_PER_S
from hybridreg_ros.metrics.trajectory import Trajectory, aligned, associate, step_errors
from hybridreg_ros.replay import charts, pictures, report_tables
from hybridreg_ros.replay.outputs import plain

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from hybridreg_ros.replay.outputs import Scores
    from hybridreg_ros.replay.runner import ReplayLog

REFERENCE_STYLE = 9


@dataclass(frozen=True, eq=False)
class ReportRun:
    """One run in the report; the first one given is described in detail.

    Attributes:
        name: for example 'hybridreg' or 'kiss-icp alone'.
        log: its frames.
        scores: its scores.
        truth: the reference, None when there is none.
        views: frames to show with their mask.
        metrics: content of metrics.json, shown folded.
    """

    name: str
    log: ReplayLog
    scores: Scores
    truth: Trajectory | None = None
    views: Sequence[pictures.FrameView] = ()
    metrics: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class _Errors:
    """Errors over time of one run against the truth."""

    seconds: NDArray[np.float64]
    position_m: NDArray[np.float64]
    step_mm: NDArray[np.float64]
    path: NDArray[np.float64]
    truth_path: NDArray[np.float64]


def _errors(run: ReportRun, start: int) -> _Errors | None:
    if run.truth is None or run.scores.trajectory is None:
        return None
    estimate = run.log.trajectory()
    rows, others = associate(estimate, run.truth)
    est, ref = estimate.poses[rows], run.truth.poses[others]
    moved = aligned(est, ref)
    metres, _ = step_errors(est, ref)
    return _Errors(
        seconds=(estimate.stamps[rows] - start) / NS_PER_S,
        position_m=np.linalg.norm(moved[:, :3, 3] - ref[:, :3, 3], axis=1),
        step_mm=np.concatenate([[np.nan], 1000.0 * metres]),
        path=moved[:, :3, 3],
        truth_path=ref[:, :3, 3],
    )


def _figure(chart: str, caption: str, readout: bool = True) -> str:
    output = '<output aria-live="polite"></output>' if readout else ''
    return f'<figure>{chart}{output}<figcaption>{escape(caption)}</figcaption></figure>'


def _section(heading: str, body: str) -> str:
    return f'<section><h2>{escape(heading)}</h2>{body}</section>'


def _trajectories(runs: Sequence[ReportRun], errors: Sequence[_Errors | None]) -> str:
    """Paths on the two axes along which they extend most."""
    scored = [(i, r, e) for i, (r, e) in enumerate(zip(runs, errors, strict=True)) if e]
    if scored:
        paths = [(i, r.name, e.path, False) for i, r, e in scored]
        paths.insert(0, (REFERENCE_STYLE, 'truth', scored[0][2].truth_path, True))
    else:
        paths = [
            (i, r.name, r.log.trajectory().poses[:, :3, 3], False) for i, r in enumerate(runs)
        ]
    paths = [p for p in paths if len(p[2])]
    if not paths:
        return ''
    extent = np.max([np.ptp(p[2], axis=0) for p in paths], axis=0)
    a, b = sorted(np.argsort(-extent, kind='stable')[:2].tolist())
    series = [charts.Series(n, p[:, a], p[:, b], style, dash) for style, n, p, dash in paths]
    label = f'Paths of {", ".join(s.name for s in series)} in the {"xyz"[a]}-{"xyz"[b]} plane.'
    chart = charts.plan_chart(series, f'{"xyz"[a]} (m)', f'{"xyz"[b]} (m)', label)
    how = ', aligned to the truth by one rigid transform' if scored else ''
    caption = f'Paths{how}, on the two axes of largest extent. The ring marks the start.'
    return _section('Trajectory', _figure(chart, caption, readout=False))


def _error_charts(runs: Sequence[ReportRun], errors: Sequence[_Errors | None]) -> str:
    scored = [(i, r, e) for i, (r, e) in enumerate(zip(runs, errors, strict=True)) if e]
    if not scored:
        return ''
    position = [charts.Series(r.name, e.seconds, e.position_m, i) for i, r, e in scored]
    step = [charts.Series(r.name, e.seconds, e.step_mm, i) for i, r, e in scored]
    names = ', '.join(r.name for _, r, _ in scored)
    body = _figure(
        charts.time_chart(position, 'position error (m)', f'Position error over time: {names}.'),
        'Distance to the true position after alignment of the whole path.',
    ) + _figure(
        charts.time_chart(step, 'step error (mm)', f'Step error over time: {names}.'),
        'Translation error of each step from one frame to the next.',
    )
    return _section('Error of each frame', body)


def _bands(seconds: NDArray[np.float64], sources: Sequence[str]) -> list[charts.Band]:
    """Stretches of equal source."""
    bands: list[charts.Band] = []
    for i, (time, source) in enumerate(zip(seconds, sources, strict=True)):
        stop = float(seconds[min(i + 1, len(seconds) - 1)])
        if bands and bands[-1].kind == source:
            bands[-1] = charts.Band(bands[-1].start, stop, source)
        elif source:
            bands.append(charts.Band(float(time), stop, source))
    return bands


def _confidence(run: ReportRun, start: int) -> str:
    frames = run.log.frames
    if not frames:
        return ''
    seconds = np.array([(f.stamp - start) / NS_PER_S for f in frames])
    confidence = np.array([f.confidence for f in frames], dtype=np.float64)
    body = ''
    if np.isfinite(confidence).any():
        chart = charts.time_chart(
            [charts.Series('confidence', seconds, confidence, 0)],
            'confidence',
            f'Confidence and source of {run.name} over time.',
            _bands(seconds, [f.source for f in frames]),
            (0.0, 1.05),
        )
        key = ''.join(
            f'<li><span class="swatch {kind}"></span>{text}</li>'
            for kind, text in (
                ('hybridreg', 'the network'),
                ('kiss_icp', 'kiss-icp'),
                ('lost', 'lost'),
            )
        )
        body = _figure(
            f'{chart}<ul class="legend" aria-label="background">{key}</ul>',
            'Probability that the pose is right; the background says which branch made it.',
        )
    total = np.array([1000.0 * f.seconds.get('total', np.nan) for f in frames])
    if np.isfinite(total).any():
        body += _figure(
            charts.time_chart(
                [charts.Series('one step', seconds, total, 2)], 'ms', 'Time per frame.'
            ),
            'Time of one step of the front end.',
        )
    return _section(f'Confidence, source and time: {run.name}', body) if body else ''


def _pictures(run: ReportRun, start: int) -> str:
    if not run.views:
        return ''
    figures = []
    for view in run.views:
        data = base64.b64encode(pictures.render(view)).decode('ascii')
        at = (view.stamp - start) / NS_PER_S
        text = f'Frame at {at:.2f} s: {len(view.points)} points, '
        text += f'{int(view.moving.sum())} called moving'
        if view.truth is not None:
            text += f', {int(view.truth.sum())} truly moving'
        figures.append(
            f'<figure><img src="data:image/png;base64,{data}" alt="{escape(text)}" '
            f'loading="lazy"><figcaption>{escape(text)}.</figcaption></figure>'
        )
    labelled = any(v.truth is not None for v in run.views)
    entries = [(pictures.MOVING, 'called moving, and moves' if labelled else 'called moving')]
    if labelled:
        entries += [
            (pictures.FALSE_ALARM, 'called moving, but static'),
            (pictures.MISSED, 'moves, but called static'),
        ]
    key = ''.join(
        f'<li><span class="swatch" style="background:rgb{c}"></span>{t}</li>' for c, t in entries
    )
    body = f'<ul class="legend">{key}<li>grey: static, darker is farther</li></ul>'
    body += f'<div class="pictures">{"".join(figures)}</div>'
    return _section('Frames seen from the sensor', body)


def _frame_rows(run: ReportRun, errors: _Errors | None, start: int) -> list[dict[str, Any]]:
    """Data behind the readout of the charts."""
    step = {}
    if errors is not None:
        step = {round(t * 1000): e for t, e in zip(errors.seconds, errors.step_mm, strict=True)}
    rows = []
    for f in run.log.frames:
        t = (f.stamp - start) / NS_PER_S
        rows.append(
            {
                't': round(t, 4),
                's': f.source,
                'c': round(f.confidence, 3),
                'e': round(float(step.get(round(t * 1000), np.nan)), 2),
                'm': round(1000.0 * f.seconds.get('total', np.nan), 1),
                'p': f.points,
                'd': f.dynamic,
            }
        )
    return rows


def write_report(path: Path, title: str, subtitle: str, runs: Sequence[ReportRun]) -> None:
    """Write the page.

    Args:
        path: file to write.
        title: headline.
        subtitle: one line below it: input, frames, duration.
        runs: at least one; the first is shown in detail, the others beside it.
    """
    first = runs[0]
    stamps = [f.stamp for r in runs for f in r.log.frames]
    start = min(stamps, default=0)
    errors = [_errors(r, start) for r in runs]
    sections = (
        _section('Scores', report_tables.score_table([(r.name, r.log, r.scores) for r in runs])),
        _trajectories(runs, errors),
        _error_charts(runs, errors),
        _confidence(first, start),
        _pictures(first, start),
        _section('Time per stage', report_tables.time_table(first.log))
        if first.log.frames
        else '',
        report_tables.drop_table(first.log, start),
        report_tables.provenance(first.metrics),
    )
    template = Template(Path(__file__).with_suffix('.html').read_text('utf-8'))
    frames = json.dumps(plain(_frame_rows(first, errors[0], start)), separators=(',', ':'))
    page = template.substitute(
        title=escape(title),
        subtitle=escape(subtitle),
        notices=report_tables.notices(first.log, first.scores),
        tiles=report_tables.tiles(first.log, first.scores),
        sections=''.join(sections),
        frames=frames.replace('</', '<\\/'),
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(page, encoding='utf-8')

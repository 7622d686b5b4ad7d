# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""report.html: one self-contained page about a replay, or several compared side by side."""

from __future__ import annotations

import base64
from dataclasses import dataclass, field
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.core.errors import require
from hybridreg_ros.core.scan import NS_PER_S
from hybridreg_ros.odometry.warm_up import SCANS
from hybridreg_ros.replay.frame_errors import frame_errors
from hybridreg_ros.replay.page import charts, pictures, scene, story, tables
from hybridreg_ros.replay.page.shell import section, write_page

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from hybridreg_ros.metrics.trajectory import Trajectory
    from hybridreg_ros.replay.frame_errors import FrameErrors
    from hybridreg_ros.replay.outputs import Scores
    from hybridreg_ros.replay.runner import FrameLog, ReplayLog

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
        scene: what the 3D view shows, None for no view.
        beside: other runs on the same clouds.
    """

    name: str
    log: ReplayLog
    scores: Scores
    truth: Trajectory | None = None
    views: Sequence[pictures.FrameView] = ()
    metrics: Mapping[str, Any] = field(default_factory=dict)
    scene: scene.Scene | None = None
    beside: tuple[ReportRun, ...] = ()


def plotly_script() -> str:
    """The text of the library that draws the 3D view.

    Raises:
        DependencyError: a package that a report needs is not installed.
    """
    check_packages()
    return (files('plotly') / 'package_data' / 'plotly.min.js').read_text('utf-8')


def check_packages() -> None:
    """Find what a report needs before the work begins.

    Raises:
        DependencyError: a package is not installed.
    """
    require('a report', 'replay', 'PIL', 'evo', 'plotly')


def _errors(run: ReportRun) -> FrameErrors | None:
    if run.truth is None or run.scores.trajectory is None:
        return None
    return frame_errors(run.log, run.truth)


def _seconds(frames: Sequence[FrameLog], start: int) -> NDArray[np.float64]:
    return np.array([(f.stamp - start) / NS_PER_S for f in frames], np.float64)


def _figure(chart: str, caption: str, shows: str = '') -> str:
    """A chart below its caption; `shows` names the values of a frame that it can read out."""
    output = f'<output data-shows="{shows}" aria-live="polite"></output>' if shows else ''
    return f'<figure><figcaption>{escape(caption)}</figcaption>{chart}{output}</figure>'


def _trajectories(runs: Sequence[ReportRun], errors: Sequence[FrameErrors | None]) -> str:
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
    return section('Trajectory', _figure(chart, caption))


def _error_charts(
    runs: Sequence[ReportRun], errors: Sequence[FrameErrors | None], start: int
) -> str:
    scored = [(i, r, e) for i, (r, e) in enumerate(zip(runs, errors, strict=True)) if e]
    if not scored:
        return ''
    names = ', '.join(r.name for _, r, _ in scored)
    body = ''
    for what, key, caption in (
        ('position_mm', 'ep', 'Distance to the true position after alignment of the whole path.'),
        ('step_mm', 'e', 'Translation error of each step from one frame to the next.'),
    ):
        series = [
            charts.Series(r.name, _seconds(r.log.frames, start)[e.rows], getattr(e, what), i)
            for i, r, e in scored
        ]
        title = f'{"position" if key == "ep" else "step"} error'
        chart = charts.time_chart(series, f'{title} (mm)', f'{title} over time: {names}.')
        body += _figure(chart, caption, key)
    return section('Error of each frame', body)


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
    seconds = _seconds(frames, start)
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
        names = {'hybridreg': 'the network', 'kiss_icp': 'kiss-icp', 'lost': 'lost'}
        key = ''.join(
            f'<li><span class="swatch {kind}"></span>{text}</li>' for kind, text in names.items()
        )
        body = _figure(
            f'{chart}<ul class="legend" aria-label="background">{key}</ul>',
            'Probability that the pose is right; the background says which branch made it.',
            'c s',
        )
    total = np.array([1000.0 * f.seconds.get('total', np.nan) for f in frames])
    later = total[SCANS - 1 :]
    if np.isfinite(later).any():
        first = ', '.join(f'{ms:.0f}' for ms in total[: SCANS - 1])
        body += _figure(
            charts.time_chart(
                [charts.Series('one step', seconds[SCANS - 1 :], later, 2)], 'ms', 'Time per frame'
            ),
            'Time of one step of the front end. The first steps load code and compile it where '
            f'that is new; they are not drawn: {first} ms.',
            'm',
        )
    return section(f'Confidence, source and time: {run.name}', body) if body else ''


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
            f'<figure><img src="data:image/png;base64,{data}" alt="{escape(text)}">'
            f'<figcaption>{escape(text)}.</figcaption></figure>'
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
    return section('Frames seen from the sensor', body)


def _frame_rows(run: ReportRun, errors: FrameErrors | None, start: int) -> list[dict[str, Any]]:
    """What the charts read out and the 3D view draws, one entry per frame."""
    of = {} if errors is None else {int(k): i for i, k in enumerate(errors.rows)}
    rows = []
    turned = run.scene or scene.Scene(np.zeros((0, 3), np.float32), 0.0)
    for k, f in enumerate(run.log.frames):
        row = {
            't': round((f.stamp - start) / NS_PER_S, 4),
            's': f.source.replace('_', '-').replace('hybridreg', 'network'),
            'c': round(f.confidence, 3),
            'm': round(1000.0 * f.seconds.get('total', np.nan), 1),
            'p': f.points,
            'd': f.dynamic,
            'x': np.round(turned.upright(f.pose[None, :3, 3])[0], 4),
        }
        if errors is not None and k in of:
            row['e'] = round(float(errors.step_mm[of[k]]), 2)
            row['ep'] = round(float(errors.position_mm[of[k]]), 2)
        rows.append(row)
    return rows


def _scene(run: ReportRun, errors: FrameErrors | None, start: int) -> dict[str, Any]:
    """Data of the 3D view; empty for none."""
    if run.scene is None or not run.log.frames or not len(run.scene.still):
        return {}
    data = scene.for_page(run.scene, start)
    if errors is not None:
        truth = se3.apply(errors.T_odom_world, errors.truth_path)
        data['truth'] = np.round(run.scene.upright(truth), 3)
    return data


def _worst(run: ReportRun, errors: FrameErrors | None, start: int) -> str:
    """The story's last line: links to the frames to look at first."""
    links = ', '.join(
        f'<a href="#scene" data-frame="{row}">{(run.log.frames[row].stamp - start) / NS_PER_S:.2f}'
        f' s</a> ({escape(why)})'
        for row, why in story.worst(run.log, errors)
    )
    return f'<li>Look first at {links}.</li>' if links else ''


def _scene_section(shown: scene.Scene, errors: FrameErrors | None) -> str:
    colour = 'step error' if errors is not None else 'confidence'
    squares = ', keyframes (squares)' if shown.keyframes else ''
    text = (
        f'What stood still (grey), thinned to one point per {1000 * shown.voxel_m:.0f} mm, '
        f'the path coloured by {colour}{squares}, and what moves in the chosen frame (orange). '
        'Drag or use the arrow keys to turn, wheel or + and - to zoom.'
    )
    body = Path(__file__).with_name('report_scene.html').read_text('utf-8')
    return section('The scene', f'<p class="soft">{text}</p>{body}')


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
    errors = [_errors(r) for r in runs]
    others = [(r.name, r.scores) for r in runs[1:]]
    view = _scene(first, errors[0], start)
    sections = (
        _scene_section(first.scene, errors[0]) if view and first.scene else '',
        section('Scores', tables.score_table([(r.name, r.log, r.scores) for r in runs])),
        _trajectories(runs, errors),
        _error_charts(runs, errors, start),
        _confidence(first, start),
        _pictures(first, start),
        section('Time per stage (ms)', tables.time_table(first.log)) if first.log.frames else '',
        tables.drop_table(first.log, start),
        tables.provenance(first.metrics),
    )
    told = story.sentences(first.log, first.scores, start, others)
    body = (
        f'<p class="soft">{escape(subtitle)}</p><ul class="story">'
        f'{"".join(f"<li>{escape(t)}</li>" for t in told)}{_worst(first, errors[0], start)}</ul>'
        f'{tables.notices(first.log, first.scores)}'
        f'<ul class="tiles">{tables.tiles(first.log, first.scores)}</ul>{"".join(sections)}'
    )
    data = {'frames': _frame_rows(first, errors[0], start), 'scene-data': view}
    write_page(path, title, body, data, plotly_script() if view else '')

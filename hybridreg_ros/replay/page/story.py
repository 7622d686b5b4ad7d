# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A run in words: how far, how well, what went wrong and when."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core.scan import NS_PER_S
from hybridreg_ros.replay.outputs import stage_times

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hybridreg_ros.replay.frame_errors import FrameErrors
    from hybridreg_ros.replay.outputs import Scores
    from hybridreg_ros.replay.runner import FrameLog, ReplayLog

WORST = 5
JUMP = 6.0
"""A step is a jump where it differs from its neighbours by so many robust standard deviations of
all such differences: what a smooth walk of any length makes about never by chance."""


def jumps(log: ReplayLog) -> list[tuple[int, float]]:
    """Steps unlike those before and after them: row of `log.frames` and difference in mm.

    The pose of each frame is compared with the one half way between its neighbours. A walk turns
    and brakes, so what is usual is told by the run itself (median and its absolute deviation).
    """
    rows = [k for k, f in enumerate(log.frames) if f.accepted]
    if len(rows) < 8:
        return []
    stamps = np.array([log.frames[k].stamp for k in rows]) / NS_PER_S
    places = np.array([log.frames[k].pose[:3, 3] for k in rows])
    share = ((stamps[1:-1] - stamps[:-2]) / (stamps[2:] - stamps[:-2]))[:, None]
    off = 1000.0 * np.linalg.norm(
        places[1:-1] - (1.0 - share) * places[:-2] - share * places[2:], axis=1
    )
    usual = np.median(off)
    spread = 1.4826 * np.median(np.abs(off - usual))
    limit = usual + JUMP * max(spread, 1e-3)
    found = np.flatnonzero(off > limit)
    # Both neighbours of a jump look odd as well: the largest of a stretch stands for it.
    peaks = [k for k in found if off[k] == off[max(0, k - 1) : k + 2].max()]
    return sorted(((rows[k + 1], float(off[k])) for k in peaks), key=lambda j: -j[1])


def length(mm: float) -> str:
    """An error as text, always in millimetres."""
    return f'{mm:.1f} mm' if mm < 99.5 else f'{mm:,.0f} mm'


def stretches(frames: Sequence[FrameLog], start: int, source: str) -> str:
    """When a source made the poses, as times; '' for never."""
    spans: list[list[float]] = []
    before = False
    for frame in frames:
        is_it = frame.source == source
        at = (frame.stamp - start) / NS_PER_S
        if is_it and before:
            spans[-1][1] = at
        elif is_it:
            spans.append([at, at])
        before = is_it
    texts = [f'{a:.1f} s' if b - a < 0.05 else f'{a:.1f} to {b:.1f} s' for a, b in spans]
    more = f' and {len(texts) - 4} more times' if len(texts) > 4 else ''
    return ', '.join(texts[:4]) + more


def _how_far(log: ReplayLog, scores: Scores) -> str:
    frames = log.frames
    span = (frames[-1].stamp - frames[0].stamp) / NS_PER_S
    path = scores.trajectory.path_m if scores.trajectory else log.trajectory().path_m
    return f'{len(frames)} clouds in {span:.1f} s; the sensor went {path:.2f} m.'


def _how_well(scores: Scores, others: Sequence[tuple[str, Scores]]) -> list[str]:
    texts = []
    if scores.trajectory is not None:
        t = scores.trajectory
        ate = 1000.0 * t.ate_rmse_m
        text = f'The path is {length(ate)} off the truth (RMSE, aligned'
        text += f'; {t.ate_percent:.2f} % of its length)' if np.isfinite(t.ate_percent) else ')'
        text += f', a step {length(t.step_mean_mm)} on average'
        for name, other in others:
            if (o := other.trajectory) is not None:
                theirs = 1000.0 * o.ate_rmse_m
                more = theirs / max(ate, 1e-9)
                text += f'. {name} on the same clouds: {length(theirs)}, {more:.1f} times as much'
        texts.append(text + '.')
    if scores.mask is not None and np.isfinite(scores.mask.iou):
        m = scores.mask
        texts.append(
            f'{100 * m.recall:.0f} % of the moving points were found, and {100 * m.precision:.0f} '
            f'% of the points called moving do move (IoU {m.iou:.2f}).'
        )
    return texts


def _what_went_wrong(log: ReplayLog, start: int) -> list[str]:
    sources = log.sources()
    texts = []
    if n := sources.get('lost', 0):
        texts.append(f'The pose was lost in {n} frames: {stretches(log.frames, start, "lost")}.')
    if (n := sources.get('kiss_icp', 0)) and 'hybridreg' in sources:
        when = stretches(log.frames, start, 'kiss_icp')
        texts.append(f'kiss-icp made {n} of the poses, where the network was not sure: {when}.')
    if log.drops:
        texts.append(f'{len(log.drops)} clouds were not used; they are listed below.')
    if log.interrupted:
        texts.append(f'This run ended early: {log.interrupted}.')
    if not texts and sources:
        texts.append('No pose was lost, and every cloud was used.')
    return texts


def _speed(log: ReplayLog) -> list[str]:
    total = stage_times(log.frames).get('total')
    if total is None or len(log.frames) < 2:
        return []
    gap = 1e-6 * (log.frames[-1].stamp - log.frames[0].stamp) / (len(log.frames) - 1)
    took, verdict = total['median'], 'faster' if total['median'] < gap else 'slower'
    return [f'A cloud took {took:.0f} ms (median), {verdict} than they came (every {gap:.0f} ms).']


def sentences(
    log: ReplayLog, scores: Scores, start: int, others: Sequence[tuple[str, Scores]] = ()
) -> list[str]:
    """The run in a few sentences; empty for a run of no frames.

    Args:
        log: the run.
        scores: its scores.
        start: zero of the times, ns.
        others: name and scores of runs beside it.
    """
    if not log.frames:
        return []
    texts = [_how_far(log, scores), *_how_well(scores, others)]
    poses = log.trajectory().poses
    if scores.trajectory is None and len(poses) > 1:
        gap = np.linalg.norm(poses[-1, :3, 3] - poses[0, :3, 3])
        texts.append(f'Without truth: the path ends {gap:.2f} m from where it began.')
    texts += _what_went_wrong(log, start)
    if scores.trajectory is None and (found := jumps(log)):
        texts.append(
            f'{len(found)} steps are unlike those around them, the largest by '
            f'{length(found[0][1])} (at {(log.frames[found[0][0]].stamp - start) / NS_PER_S:.2f} '
            f's, reported with a confidence of {log.frames[found[0][0]].confidence:.2f}).'
        )
    return texts + _speed(log)


def worst(log: ReplayLog, errors: FrameErrors | None) -> list[tuple[int, str]]:
    """Frames to look at first: row of `log.frames` and why, the worst first.

    With truth those of the largest step error; without, lost ones, jumps and the least sure.
    """
    if errors is not None:
        order = np.argsort(-np.nan_to_num(errors.step_mm, nan=-1.0), kind='stable')[:WORST]
        return [
            (int(errors.rows[k]), f'step error {length(float(errors.step_mm[k]))}')
            for k in order
            if np.isfinite(errors.step_mm[k])
        ]
    frames = log.frames
    found = {k: 'lost' for k, f in enumerate(frames) if f.source == 'lost'}
    found |= {k: f'jump of {length(mm)}' for k, mm in jumps(log) if k not in found}
    sure = [(f.confidence, k) for k, f in enumerate(frames) if k and np.isfinite(f.confidence)]
    found |= {k: f'confidence {c:.2f}' for c, k in sorted(sure)[:WORST] if k not in found}
    return list(found.items())[:WORST]

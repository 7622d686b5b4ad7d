# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""A registered pair as one page: both clouds in the frame of the target, and what moves."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

import numpy as np

from hybridreg_ros.core import se3
from hybridreg_ros.replay.outputs import UPRIGHT
from hybridreg_ros.replay.page.pictures import BACKGROUND, MOVING, is_optical
from hybridreg_ros.replay.page.report import plotly_script
from hybridreg_ros.replay.page.shell import section, write_page

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from hybridreg_ros.model.result import RegistrationResult

SHOWN = 60_000
"""Points of each cloud that are drawn, drawn by lot from more."""
_COLOURS = (((86, 180, 233), MOVING), ((150, 158, 167), (240, 228, 66)))
"""Of source and target: what stands still, what moves."""


def moving_masks(result: RegistrationResult) -> list[NDArray[np.bool_]]:
    """Which points of source and target move, under the pose found.

    By P(static); of weights without a static head, by the uncertainty.
    """
    probability = (result.source_static_probability, result.target_static_probability)
    uncertainty = (result.source_uncertainty, result.target_uncertainty)
    return [
        doubt > 0.5 if static is None else static < 0.5
        for static, doubt in zip(probability, uncertainty, strict=True)
    ]


def write_pair(
    path: Path,
    title: str,
    clouds: tuple[NDArray[np.floating], NDArray[np.floating]],
    T: NDArray[np.float64],
    result: RegistrationResult,
    told: Sequence[str],
) -> None:
    """Write the page.

    Args:
        path: file to write.
        title: headline.
        clouds: source (N, 3) and target (M, 3).
        T: (4, 4) T_target_source, metres.
        result: outcome of the registration, for its mask.
        told: what was found, one line each.
    """
    import plotly.graph_objects as go

    turn = UPRIGHT if is_optical(clouds[1]) else np.eye(4)
    traces, rng, masks = [], np.random.default_rng(0), moving_masks(result)
    for k, name, way in ((1, 'target', turn), (0, 'source', turn @ T)):
        mask, points = masks[k], se3.apply(way, clouds[k].astype(np.float64))
        rows = np.flatnonzero(np.isfinite(points).all(axis=1))
        rows = np.sort(rng.permutation(rows)[:SHOWN])
        for moves, what in ((False, name), (True, f'{name}: moves')):
            x, y, z = points[rows[mask[rows] == moves]].astype(np.float32).T
            colour = f'rgb{_COLOURS[k][moves]}'
            marker = {'size': 2.5 if moves else 1.4, 'color': colour}
            traces.append(
                go.Scatter3d(
                    x=x, y=y, z=z, mode='markers', name=what, marker=marker, hoverinfo='skip'
                )
            )
    figure = go.Figure(traces)
    hidden = {'visible': False}
    figure.update_layout(
        scene={
            'xaxis': hidden,
            'yaxis': hidden,
            'zaxis': hidden,
            'aspectmode': 'data',
            'camera': {'eye': {'x': -1.1, 'y': -0.6, 'z': 0.7}},
        },
        margin={'l': 0, 'r': 0, 't': 0, 'b': 0},
        paper_bgcolor=f'rgb{BACKGROUND}',
        height=560,
        legend={'itemsizing': 'constant', 'font': {'color': 'white'}, 'x': 0, 'y': 1},
    )
    drawn = f'var pair = {figure.to_json()}; Plotly.newPlot("pair", pair.data, pair.layout, '
    drawn += '{responsive: true, scrollZoom: true});'
    lines = ''.join(f'<li>{escape(line)}</li>' for line in told)
    note = 'Both clouds in the frame of the target. Drag to turn; the legend hides and shows.'
    view = f'<p class="soft">{note}</p><div id="pair"></div>'
    body = f'<ul class="story">{lines}</ul>{section("Both clouds", view)}'
    write_page(path, title, body, library=f'{plotly_script()}\n{drawn}')

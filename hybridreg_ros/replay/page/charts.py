# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Line charts as SVG text: no network, no library, colours from the page's style sheet."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

WIDTH, HEIGHT = 900, 300
LEFT, RIGHT, TOP, BOTTOM = 108, 16, 14, 52
MAX_POINTS = 2000


@dataclass(frozen=True, eq=False)
class Series:
    """One line.

    Attributes:
        name: text of the legend.
        x: (N,) values.
        y: (N,) values; NaN breaks the line.
        style: number of the colour in the page's palette, from 0.
        dashed: True for the reference.
    """

    name: str
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    style: int = 0
    dashed: bool = False


@dataclass(frozen=True)
class Band:
    """A coloured stretch of the x axis: from, to, CSS class."""

    start: float
    stop: float
    kind: str


@dataclass(frozen=True)
class _Axes:
    """Linear map from data to pixels."""

    x0: float
    x1: float
    y0: float
    y1: float
    height: float

    def px(self, x: float) -> float:
        return LEFT + (x - self.x0) / (self.x1 - self.x0) * (WIDTH - LEFT - RIGHT)

    def py(self, y: float) -> float:
        return self.height - BOTTOM - (y - self.y0) / (self.y1 - self.y0) * self._span

    @property
    def _span(self) -> float:
        return self.height - TOP - BOTTOM


def ticks(low: float, high: float, wanted: int = 6) -> list[float]:
    """Round numbers between two limits.

    Examples:
        >>> ticks(0.0, 10.0)
        [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]
    """
    raw = max(high - low, 1e-12) / wanted
    power = 10.0 ** np.floor(np.log10(raw))
    step = float(power * min((1.0, 2.0, 5.0, 10.0), key=lambda m: abs(m * power - raw)))
    first = int(np.ceil(low / step - 1e-9))
    last = int(np.floor(high / step + 1e-9))
    return [round(k * step, 12) for k in range(first, last + 1)]


def _limits(values: Sequence[NDArray[np.float64]], from_zero: bool) -> tuple[float, float]:
    finite = np.concatenate([v[np.isfinite(v)] for v in values] or [np.zeros(0)])
    if not len(finite):
        return 0.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    if from_zero:
        low = min(low, 0.0)
    if high - low < 1e-9:
        high = low + max(abs(low) * 0.1, 1e-3)
    margin = 0.04 * (high - low)
    return (low if from_zero and low == 0.0 else low - margin), high + margin


def _path(axes: _Axes, series: Series) -> str:
    """SVG path of a line, thinned to what a screen can show."""
    every = max(1, len(series.x) // MAX_POINTS)
    parts, pen_down = [], False
    for x, y in zip(series.x[::every], series.y[::every], strict=True):
        if not (np.isfinite(x) and np.isfinite(y)):
            pen_down = False
            continue
        parts.append(f'{"L" if pen_down else "M"}{axes.px(x):.1f} {axes.py(y):.1f}')
        pen_down = True
    dash = ' dashed' if series.dashed else ''
    return f'<path class="line c{series.style}{dash}" d="{"".join(parts)}"/>'


def _grid(axes: _Axes, x_label: str, y_label: str) -> list[str]:
    parts = []
    bottom, right = axes.height - BOTTOM, WIDTH - RIGHT
    for k, y in enumerate(ticks(axes.y0, axes.y1, 5)):
        odd = ' odd' if k % 2 else ''  # left out on a narrow screen
        parts.append(f'<path class="grid" d="M{LEFT} {axes.py(y):.1f}H{right}"/>')
        parts.append(
            f'<text x="{LEFT - 8}" y="{axes.py(y) + 4:.1f}" class="end{odd}">{y:g}</text>'
        )
    for k, x in enumerate(ticks(axes.x0, axes.x1, 8)):
        odd = ' odd' if k % 2 else ''
        parts.append(f'<path class="grid" d="M{axes.px(x):.1f} {TOP}V{bottom}"/>')
        parts.append(f'<text x="{axes.px(x):.1f}" y="{bottom + 20}" class="mid{odd}">{x:g}</text>')
    middle = (TOP + bottom) / 2
    center, low = (LEFT + right) / 2, axes.height - 6
    turn = f'translate(18 {middle}) rotate(-90)'
    parts.append(f'<text x="{center}" y="{low}" class="mid">{escape(x_label)}</text>')
    parts.append(f'<text transform="{turn}" class="mid">{escape(y_label)}</text>')
    return parts


def legend(series: Sequence[Series]) -> str:
    """HTML list that names the lines."""
    items = ''.join(
        f'<li><svg width="28" height="10" aria-hidden="true"><path class="line c{s.style}'
        f'{" dashed" if s.dashed else ""}" d="M1 5H27"/></svg>{escape(s.name)}</li>'
        for s in series
    )
    return f'<ul class="legend">{items}</ul>'


def _svg(axes: _Axes, body: list[str], label: str, kind: str) -> str:
    return (
        f'<svg class="chart {kind}" viewBox="0 0 {WIDTH} {axes.height:g}" role="img" '
        f'aria-label="{escape(label, quote=True)}" data-x0="{axes.x0!r}" data-x1="{axes.x1!r}" '
        f'data-left="{LEFT}" data-right="{RIGHT}" data-top="{TOP}" data-bottom="{BOTTOM}">'
        f'{"".join(body)}</svg>'
    )


def time_chart(
    series: Sequence[Series],
    y_label: str,
    label: str,
    bands: Sequence[Band] = (),
    y_limits: tuple[float, float] | None = None,
) -> str:
    """Lines over time (s), the first on top, with a legend; `label` is read by screen readers."""
    x0, x1 = _limits([s.x for s in series], from_zero=False)
    y0, y1 = y_limits or _limits([s.y for s in series], from_zero=True)
    axes = _Axes(x0, x1, y0, y1, HEIGHT)
    body = [
        f'<rect class="band {b.kind}" x="{axes.px(b.start):.1f}" y="{TOP}" '
        f'width="{max(axes.px(b.stop) - axes.px(b.start), 1.0):.1f}" '
        f'height="{HEIGHT - TOP - BOTTOM}"/>'
        for b in bands
    ]
    body += _grid(axes, 'time (s)', y_label)
    body += [_path(axes, s) for s in reversed(series)]
    return _svg(axes, body, label, 'time') + legend(series)


def plan_chart(series: Sequence[Series], x_label: str, y_label: str, label: str) -> str:
    """Paths seen from above, the first on top, both axes on one scale."""
    x0, x1 = _limits([s.x for s in series], from_zero=False)
    y0, y1 = _limits([s.y for s in series], from_zero=False)
    width = WIDTH - LEFT - RIGHT
    height = float(np.clip((y1 - y0) / (x1 - x0) * width, 160, 480))
    scale = min(width / (x1 - x0), height / (y1 - y0))
    half_x, half_y = width / scale / 2, height / scale / 2
    mid_x, mid_y = (x0 + x1) / 2, (y0 + y1) / 2
    axes = _Axes(
        mid_x - half_x, mid_x + half_x, mid_y - half_y, mid_y + half_y, height + TOP + BOTTOM
    )
    body = _grid(axes, x_label, y_label) + [_path(axes, s) for s in reversed(series)]
    if len(series) and len(series[0].x):
        start = (axes.px(float(series[0].x[0])), axes.py(float(series[0].y[0])))
        body.append(f'<circle class="start" cx="{start[0]:.1f}" cy="{start[1]:.1f}" r="5"/>')
    return _svg(axes, body, label, 'plan') + legend(series)

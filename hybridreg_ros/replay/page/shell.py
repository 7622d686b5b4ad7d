# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""What every page has: head, style, script and the data that the script reads."""

from __future__ import annotations

import json
from html import escape
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

from hybridreg_ros.replay.outputs import plain

if TYPE_CHECKING:
    from collections.abc import Mapping

_HERE = Path(__file__).parent


def section(heading: str, body: str) -> str:
    """A part of a page; '' without a body."""
    return f'<section><h2>{escape(heading)}</h2>{body}</section>' if body else ''


def write_page(
    path: Path, title: str, body: str, data: Mapping[str, Any] | None = None, library: str = ''
) -> None:
    """Write a page that needs nothing but itself.

    Args:
        path: file; its folder is made.
        title: headline, as text.
        body: HTML.
        data: values for the script, by the id of their element.
        library: further script.
    """
    values = {'frames': [], 'scene-data': {}, **(data or {})}
    elements = [
        f'<script type="application/json" id="{name}">{_json(value)}</script>'
        for name, value in values.items()
    ]
    if library:
        elements.append(f'<script>{library}</script>')
    text = Template((_HERE / 'page.html').read_text('utf-8')).substitute(
        title=escape(title),
        body=body,
        style=(_HERE / 'style.css').read_text('utf-8'),
        data='\n'.join(elements),
        script=(_HERE / 'report.js').read_text('utf-8'),
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding='utf-8')


def _json(value: Any) -> str:
    """JSON that may stand inside a script element."""
    return json.dumps(plain(value), separators=(',', ':')).replace('</', '<\\/')

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Tables of the documentation live between two comments: replace what stands there."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path


def put(path: Path, name: str, text: str) -> None:
    """Write a text between `<!-- name -->` and `<!-- /name -->` of a file.

    Raises:
        ValueError: the file has no such place.
    """
    page = path.read_text(encoding='utf-8')
    begin, end = f'<!-- {name} -->', f'<!-- /{name} -->'
    if page.count(begin) != 1 or page.count(end) != 1:
        raise ValueError(f'{path} needs one {begin} and one {end}')
    head, rest = page.split(begin)
    tail = rest.split(end)[1]
    path.write_text(f'{head}{begin}\n{text.strip()}\n{end}{tail}', encoding='utf-8')

# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The notebooks run from top to bottom, find the right poses, and are kept without output."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

nbclient = pytest.importorskip('nbclient', reason='nbclient is not installed (extra test)')
nbformat = pytest.importorskip('nbformat', reason='nbformat is not installed (extra test)')
pytest.importorskip('ipykernel', reason='ipykernel is not installed (extra test)')
pytest.importorskip('rosbags', reason='rosbags is not installed (extra replay)')

NOTEBOOKS = Path(__file__).resolve().parents[1] / 'docs' / 'notebooks'
LARGEST_MM = {'pair': 30.0, 'sequence': 30.0}


def code_of(notebook: Any) -> list[Any]:
    return [cell for cell in notebook.cells if cell.cell_type == 'code']


@pytest.mark.timeout(900)
@pytest.mark.parametrize('name', [p.stem for p in sorted(NOTEBOOKS.glob('*.ipynb'))])
def test_it_runs(name: str) -> None:
    notebook = nbformat.read(NOTEBOOKS / f'{name}.ipynb', as_version=4)
    assert not any(cell.outputs or cell.execution_count for cell in code_of(notebook))
    at = {'metadata': {'path': str(NOTEBOOKS)}}
    nbclient.NotebookClient(notebook, timeout=800, resources=at).execute()
    said = ''.join(str(out.get('text', '')) for c in code_of(notebook) for out in c.outputs)
    errors_mm = [float(value) for value in re.findall(r'([\d.]+) mm', said)]
    assert errors_mm
    assert max(errors_mm) < LARGEST_MM[name], said
    assert 'application/vnd.plotly.v1+json' in code_of(notebook)[-1].outputs[-1].data

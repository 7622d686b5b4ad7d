# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""report.html in a real Chromium: it renders, its script runs, nothing is fetched."""

from __future__ import annotations

import re
import shutil
import subprocess
from typing import TYPE_CHECKING

import numpy as np
import pytest
from PIL import Image

from hybridreg_ros.cli.main import main

if TYPE_CHECKING:
    from pathlib import Path

CHROMIUM = shutil.which('chromium') or shutil.which('chromium-browser') or shutil.which('chrome')
pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason='Chromium is not installed'),
]
FLAGS = (
    '--headless',
    '--no-sandbox',
    '--disable-gpu',
    '--disable-quic',
    '--no-first-run',
    '--disable-background-networking',
    '--disable-component-update',
    '--disable-sync',
    '--hide-scrollbars',
    '--enable-logging=stderr',
    '--v=0',
)


@pytest.fixture(scope='module')
def page(room_bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Report of a replay of the room bag."""
    out = tmp_path_factory.mktemp('browser') / 'run'
    assert main(['replay', str(room_bag), '--registrar', 'kiss-icp', '--out', str(out)]) == 0
    return out / 'report.html'


def chromium(tmp_path: Path, page: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    profile = tmp_path / 'profile'
    shutil.rmtree(profile, ignore_errors=True)
    command = [str(CHROMIUM), *FLAGS, f'--user-data-dir={profile}', *arguments, page.as_uri()]
    return subprocess.run(command, capture_output=True, text=True, timeout=90, check=True)


def test_script_runs_and_nothing_fails(page: Path, tmp_path: Path) -> None:
    done = chromium(tmp_path, page, '--dump-dom')
    dom = done.stdout
    assert 'CONSOLE' not in done.stderr, done.stderr
    assert dom.count('>Point at the chart') == 4, 'script did not run'
    assert len(re.findall(r'<svg class="chart', dom)) == 5
    assert dom.count('<path class="cursor"') == 4
    assert 'NaN' not in re.sub(r'<pre>.*?</pre>', '', dom, flags=re.DOTALL)
    for image in re.findall(r'<img [^>]*>', dom):
        assert 'src="data:image/png;base64,' in image
        assert re.search(r'alt="Frame at .* points, \d+ called moving', image)
    assert all(
        re.search(r'aria-label="[^"]+"', svg)
        for svg in re.findall(r'<svg class="chart[^>]*>', dom)
    )


@pytest.mark.parametrize('dark', [False, True])
def test_picture_is_not_empty(page: Path, tmp_path: Path, dark: bool) -> None:
    shot = tmp_path / 'shot.png'
    mode = ['--blink-settings=preferredColorScheme=0'] if dark else []
    chromium(tmp_path, page, f'--screenshot={shot}', '--window-size=1000,3000', *mode)
    pixels = np.array(Image.open(shot).convert('RGB')).astype(int)
    corner = pixels[5, 5]
    assert (corner.mean() < 60) == dark
    different = np.abs(pixels - corner).sum(axis=2) > 60
    assert different[:, :].mean() > 0.03
    thirds = np.array_split(different, 3, axis=0)
    assert all(part.mean() > 0.01 for part in thirds), 'a third of the page is blank'


def test_narrow_screen_does_not_scroll_sideways(page: Path, tmp_path: Path) -> None:
    probe = tmp_path / 'probe.html'
    script = (
        '<script>document.title = document.documentElement.scrollWidth + "/" + innerWidth;'
        '</script></body>'
    )
    probe.write_text(page.read_text('utf-8').replace('</body>', script), 'utf-8')
    dom = chromium(tmp_path, probe, '--dump-dom', '--window-size=520,900').stdout
    match = re.search(r'<title>(\d+)/(\d+)</title>', dom)
    assert match
    assert int(match[1]) <= int(match[2])

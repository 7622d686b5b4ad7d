# SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
# SPDX-License-Identifier: Apache-2.0
"""report.html in a real Chromium: it renders, its script runs, nothing is fetched."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pytest
from PIL import Image

from hybridreg_ros.cli.main import main
from hybridreg_ros.model.result import Correspondences, RegistrationResult
from hybridreg_ros.replay.page.pair import write_pair

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
    '--use-angle=swiftshader',  # WebGL without a graphics card
    '--enable-unsafe-swiftshader',
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
    return subprocess.run(command, capture_output=True, text=True, timeout=240, check=True)


def probe(page: Path, tmp_path: Path, script: str, *arguments: str) -> dict[str, Any]:
    """What a script finds in the page; it may wait for `ready` and calls `tell` in the end."""
    code = (
        '<pre id="found"></pre><script>function tell(v) {'
        'document.getElementById("found").textContent = "FOUND" + JSON.stringify(v) + "END"; }'
        'var div = document.getElementById("scene"); function ready(go) { div.dataset.ready ? '
        f'go() : setTimeout(ready, 50, go); }} {script}</script></body>'
    )
    copy = tmp_path / 'probe.html'
    copy.write_text(page.read_text('utf-8').replace('</body>', code), 'utf-8')
    arguments = ('--virtual-time-budget=20000', *arguments)
    done = chromium(tmp_path, copy, '--dump-dom', *arguments)
    match = re.search('FOUND(.*)END</pre>', done.stdout)
    assert match, done.stderr
    found: dict[str, Any] = json.loads(match[1])
    return found


def test_script_runs_and_nothing_fails(page: Path, tmp_path: Path) -> None:
    done = chromium(tmp_path, page, '--dump-dom', '--virtual-time-budget=20000')
    said = [
        line
        for line in done.stderr.splitlines()
        if 'CONSOLE' in line and 'willReadFrequently' not in line  # a hint to plotly's authors
    ]
    assert not said
    dom = re.sub(r'<script.*?</script>', '', done.stdout, flags=re.DOTALL)
    assert 'data-ready="yes"' in dom, '3D view was not drawn'
    assert len(re.findall(r'<svg class="chart', dom)) == 5
    assert dom.count('<path class="cursor"') == 4
    text = re.sub(r'<pre>.*?</pre>|data:image[^"]*', '', dom, flags=re.DOTALL)
    assert 'NaN' not in text
    assert '<strong>-</strong>' not in dom, 'a tile without a value'
    for image in re.findall(r'<img [^>]*alt[^>]*>', dom):
        assert 'src="data:image/png;base64,' in image
        assert re.search(r'alt="Frame at .* points, \d+ called moving', image)
    assert all(
        re.search(r'aria-label="[^"]+"', svg)
        for svg in re.findall(r'<svg class="chart[^>]*>', dom)
    )
    assert page.stat().st_size < 15e6


def test_page_of_a_pair_draws_both_clouds_and_what_moves(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    clouds = [rng.uniform(-3, 3, (500, 3)).astype(np.float32) for _ in range(2)]
    T = np.eye(4)
    T[:3, 3] = 1.0
    static = [np.linspace(0.0, 1.0, 500, dtype=np.float32)] * 2
    nothing = Correspondences(clouds[0][:0], clouds[1][:0], static[0][:0])
    result = RegistrationResult(
        *(T, 0.9, *static, nothing, T, 0, 0.05, cast('Any', None), {}, 1, *static)
    )
    file = tmp_path / 'pair.html'
    write_pair(file, 'a & b', (clouds[0], clouds[1]), T, result, ['one <line>'])
    found = probe(
        file,
        tmp_path,
        """
        div = document.getElementById('pair');
        div.dataset.ready = 'yes';
        ready(function () { tell({traces: div._fullData.map(function (t) {
          return [t.name, t.x.length, Math.max.apply(null, t.x)]; }),
          canvas: div.querySelectorAll('canvas').length,
          story: document.querySelector('.story').textContent === 'one <line>'}); });
        """,
    )
    names = ['target', 'target: moves', 'source', 'source: moves']
    assert [(name, count) for name, count, _ in found['traces']] == [(n, 250) for n in names]
    assert max(x for name, _, x in found['traces'] if 'source' in name) > 3.5, 'aligned'
    assert found['canvas'] > 0
    assert found['story'], 'text is text'


def test_scrubber_moves_points_sensor_and_cursors(page: Path, tmp_path: Path) -> None:
    found = probe(
        page,
        tmp_path,
        """
        function state() {
          var at = div.data[5], moving = div.data[4];
          return {sensor: [at.x[0], at.y[0], at.z[0]], moving: Array.from(moving.x).slice(0, 5),
            cursor: document.querySelector('path.cursor').getAttribute('d'),
            text: document.getElementById('frame-text').textContent};
        }
        ready(function () {
          var slider = document.getElementById('frame'), seen = [];
          function put(value) {
            slider.value = value; slider.dispatchEvent(new Event('input'));
          }
          function when(said, before, then) {  // both are there: the text and the points
            var now = state();
            if (now.text.indexOf(said) === 0 && String(now.sensor) !== String(before)) then(now);
            else setTimeout(function () { when(said, before, then); }, 100);
          }
          var start = state().sensor;
          put(2);
          when('Frame 2 at', start, function (now) {
            seen.push(now);
            document.querySelector('[data-frame]').click();
            var linked = slider.value;
            put(9);
            when('Frame 9 at', now.sensor, function (then) {
              seen.push(then); tell({seen: seen, linked: linked,
                target: document.querySelector('[data-frame]').dataset.frame});
            });
          });
        });
        """,
    )
    first, second = found['seen']
    assert np.linalg.norm(np.subtract(first['sensor'], second['sensor'])) > 0.2
    assert first['moving'], 'frame 2 shows moving points'
    assert first['moving'] != second['moving']
    assert first['cursor'] != second['cursor']
    assert first['text'].startswith('Frame 2 at 0.20 s')
    assert found['linked'] == found['target'], 'a link of the story leads to its frame'


def test_view_turns_zooms_and_tables_sort(page: Path, tmp_path: Path) -> None:
    found = probe(
        page,
        tmp_path,
        """
        function eye() {
          var c = div._fullLayout.scene.camera;
          return [c.eye.x - c.center.x, c.eye.y - c.center.y, c.eye.z - c.center.z];
        }
        function key(name) {
          div.dispatchEvent(new KeyboardEvent('keydown', {key: name, bubbles: true}));
        }
        ready(function () {
          var eyes = [eye()];
          key('ArrowLeft');
          setTimeout(function () {
            eyes.push(eye()); key('+');
            setTimeout(function () {
              eyes.push(eye());
              var tables = document.querySelectorAll('table');
              var table = tables[tables.length - 1];
              table.tHead.rows[0].cells[1].querySelector('button').click();
              tell({eyes: eyes, column: Array.from(table.tBodies[0].rows).map(function (r) {
                return +r.cells[1].textContent; })});
            }, 1000);
          }, 1000);
        });
        """,
    )
    start, turned, nearer = (np.array(e) for e in found['eyes'])
    assert np.linalg.norm(turned) == pytest.approx(np.linalg.norm(start), rel=1e-6)
    assert np.linalg.norm(turned - start) > 0.1
    assert np.linalg.norm(nearer) < 0.9 * np.linalg.norm(turned)
    assert len(found['column']) > 2
    assert found['column'] == sorted(found['column'])


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


@pytest.mark.parametrize('width', [390, 520])
def test_narrow_screen_does_not_scroll_sideways(page: Path, tmp_path: Path, width: int) -> None:
    """In a frame as wide as a telephone: Chromium's own window cannot be that narrow."""
    script = (
        '<script>parent.document.title = document.documentElement.scrollWidth;</script></body>'
    )
    inner, outer = tmp_path / 'inner.html', tmp_path / 'outer.html'
    inner.write_text(page.read_text('utf-8').replace('</body>', script), 'utf-8')
    outer.write_text(f'<iframe src="inner.html" width="{width}" style="border:0"></iframe>')
    dom = chromium(tmp_path, outer, '--dump-dom', '--allow-file-access-from-files').stdout
    match = re.search(r'<title>(\d+)</title>', dom)
    assert match
    assert int(match[1]) <= width

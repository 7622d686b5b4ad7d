// SPDX-FileCopyrightText: 2026 The hybridreg_ros developers
// SPDX-License-Identifier: Apache-2.0
(function () {
  'use strict';
  var rows = JSON.parse(document.getElementById('frames').textContent);
  var data = JSON.parse(document.getElementById('scene-data').textContent);
  var texts = {
    s: ['source', ''], c: ['confidence', ''], e: ['step error', ' mm'],
    ep: ['position error', ' mm'], m: ['step', ' ms'], p: ['points', ''], d: ['moving', '']
  };
  var listeners = [], chosen = 0;
  var SIDE = [-1.0, -0.55, 0.7], CUT_M = 0.5;

  function quantile(list, q) { return list[Math.floor(q * (list.length - 1))]; }

  function has(value) { return value !== null && value !== undefined && value !== ''; }

  function told(row, keys) {
    return keys.filter(function (k) { return has(row[k]); }).map(function (k) {
      return texts[k][0] + ' ' + row[k] + texts[k][1];
    }).join(', ');
  }

  function choose(i) {
    chosen = Math.max(0, Math.min(rows.length - 1, i));
    listeners.forEach(function (hear) { hear(chosen, rows[chosen]); });
  }

  function nearest(list, t) {
    var best = 0;
    list.forEach(function (row, i) {
      if (Math.abs(row.t - t) < Math.abs(list[best].t - t)) { best = i; }
    });
    return best;
  }

  function arrows(event) {
    var step = {ArrowRight: 1, ArrowLeft: -1, PageUp: 10, PageDown: -10}[event.key];
    if (step) { choose(chosen + step); event.preventDefault(); }
  }

  function linkChart(figure) {
    var chart = figure.querySelector('svg.time');
    var out = figure.querySelector('output');
    if (!chart || !out) { return; }
    var x0 = +chart.dataset.x0, x1 = +chart.dataset.x1;
    var left = +chart.dataset.left, right = +chart.dataset.right;
    var box = chart.viewBox.baseVal;
    var cursor = document.createElementNS('http://www.w3.org/2000/svg', 'path');
    cursor.setAttribute('class', 'cursor');
    chart.appendChild(cursor);
    listeners.push(function (i, row) {
      var px = left + (row.t - x0) / (x1 - x0) * (box.width - left - right);
      var inside = px >= left && px <= box.width - right;
      cursor.setAttribute('d', inside ? 'M' + px + ' ' + chart.dataset.top + 'V' +
        (box.height - chart.dataset.bottom) : '');
      var values = told(row, out.dataset.shows.split(' '));
      out.textContent = 'Frame ' + i + ' at ' + row.t.toFixed(2) + ' s' +
        (values ? ': ' + values : '');
    });
    chart.setAttribute('tabindex', '0');
    function point(event) {
      var r = chart.getBoundingClientRect();
      var t = x0 + ((event.clientX - r.left) / r.width * box.width - left) /
        (box.width - left - right) * (x1 - x0);
      choose(nearest(rows, t));
    }
    chart.addEventListener('pointermove', point);
    chart.addEventListener('pointerdown', point);
    chart.addEventListener('keydown', arrows);
  }

  function points(text) {
    var raw = atob(text), n = raw.length / 6;
    var axes = [new Float32Array(n), new Float32Array(n), new Float32Array(n)];
    for (var i = 0; i < n; i += 1) {
      for (var k = 0; k < 3; k += 1) {
        var at = 6 * i + 2 * k;
        axes[k][i] = data.low[k] +
          data.step * (raw.charCodeAt(at) + 256 * raw.charCodeAt(at + 1));
      }
    }
    return {x: axes[0], y: axes[1], z: axes[2]};
  }

  function trace(at, more) {
    return Object.assign({type: 'scatter3d', mode: 'markers', hoverinfo: 'skip',
      showlegend: false}, at, more);
  }

  function columns(list) {
    return {
      x: list.map(function (p) { return p[0]; }),
      y: list.map(function (p) { return p[1]; }),
      z: list.map(function (p) { return p[2]; })
    };
  }

  function drawScene() {
    var div = document.getElementById('scene');
    if (!div || !data.still || !rows.length) { return; }
    var scored = rows.some(function (r) { return has(r.e); });
    var value = rows.map(function (r) { return scored ? r.e : r.c; });
    var first = value.find(has);
    value = value.map(function (v) { return has(v) ? v : first; });
    var sorted = value.slice().sort(function (a, b) { return a - b; });
    var still = points(data.still);
    var heights = Array.from(still.z).sort(function (a, b) { return a - b; });
    var path = columns(rows.map(function (r) { return r.x; }));
    var scale = [[0, '#4f9be0'], [0.5, '#cfc7ae'], [1, '#fff04a']];
    var traces = [
      trace(still, {marker: {size: 1.4, color: still.z, cmin: quantile(heights, 0.02),
        cmax: quantile(heights, 0.98), colorscale: [[0, '#4d5763'], [1, '#b9c2cc']]}}),
      trace(path, {mode: rows.length > 1 ? 'lines' : 'markers', line: {width: 7, color: value,
        colorscale: scale, reversescale: !scored,
        cmin: scored ? 0 : Math.min(sorted[0], 0.9),
        cmax: scored ? quantile(sorted, 0.98) : 1, showscale: true, colorbar: {
          title: {text: scored ? 'step error (mm)' : 'confidence', side: 'right',
            font: {color: '#e8ebee'}}, tickfont: {color: '#e8ebee'}, thickness: 10, len: 0.6,
          x: 1, xanchor: 'right', xpad: 8, outlinewidth: 0, bgcolor: '#12161c'}}}),
      trace(columns(data.truth || []), {mode: 'lines', line: {width: 3, color: '#ffffff',
        dash: 'dot'}}),
      trace(columns(data.keyframes.map(function (t) { return rows[nearest(rows, t)].x; })),
        {marker: {size: 3, symbol: 'square-open', color: '#ffffff'}}),
      trace({x: [], y: [], z: []}, {marker: {size: 2.4, color: '#ff8a2a'}}),
      trace({x: [], y: [], z: []}, {marker: {size: 7, symbol: 'diamond', color: '#ffffff'}})
    ];
    var frame = framing(still, path);
    var axis = function (k) { return {visible: false, range: [frame.low[k], frame.high[k]]}; };
    var layout = {margin: {l: 0, r: 0, t: 0, b: 0}, paper_bgcolor: '#12161c', uirevision: 1,
      scene: {xaxis: axis(0), yaxis: axis(1), zaxis: axis(2), aspectmode: 'manual',
        aspectratio: frame.aspect, dragmode: 'turntable', camera: camera(frame.centre, SIDE)}};
    var config = {responsive: true, scrollZoom: true, displayModeBar: false};
    Plotly.newPlot(div, traces, layout, config).then(function () {
      steer(div, frame, path);
      cutter(div, still, heights, path);
    });
  }

  // Where the camera looks: plotly's own units, in which the box of all points has `aspect`.
  function framing(still, path) {
    var lists = ['x', 'y', 'z'].map(function (k) {
      return Array.from(still[k]).concat(path[k]).sort(function (a, b) { return a - b; });
    });
    var low = lists.map(function (l) { return l[0]; });
    var high = lists.map(function (l) { return l[l.length - 1]; });
    var core = lists.map(function (l, k) {
      var way = path['xyz'[k]];
      return [Math.min(quantile(l, 0.03), Math.min.apply(null, way)),
        Math.max(quantile(l, 0.97), Math.max.apply(null, way))];
    });
    var unit = Math.max.apply(null, core.map(function (c) { return c[1] - c[0]; })) || 1;
    function place(p) {
      return {x: (p[0] - (low[0] + high[0]) / 2) / unit, y: (p[1] - (low[1] + high[1]) / 2) / unit,
        z: (p[2] - (low[2] + high[2]) / 2) / unit};
    }
    return {low: low, high: high, place: place,
      aspect: {x: Math.max(high[0] - low[0], 1e-6) / unit,
        y: Math.max(high[1] - low[1], 1e-6) / unit, z: Math.max(high[2] - low[2], 1e-6) / unit},
      centre: place(core.map(function (c) { return (c[0] + c[1]) / 2; }))};
  }

  function camera(centre, from) {
    return {center: centre, up: {x: 0, y: 0, z: 1},
      eye: {x: centre.x + from[0], y: centre.y + from[1], z: centre.z + from[2]}};
  }

  function steer(div, frame, path) {
    var slider = document.getElementById('frame'), play = document.getElementById('play');
    var shown = -1, wanted = null, timer = null;
    slider.max = rows.length - 1;
    function look(next) { return Plotly.relayout(div, {'scene.camera': next}); }
    function place(i) { return frame.place([path.x[i], path.y[i], path.z[i]]); }
    function current() { return div._fullLayout.scene.camera; }
    function offset() {
      var c = current();
      return [c.eye.x - c.center.x, c.eye.y - c.center.y, c.eye.z - c.center.z];
    }
    function draw() {
      var row = rows[wanted], update = {x: [[path.x[wanted]]], y: [[path.y[wanted]]],
        z: [[path.z[wanted]]]};
      wanted = null;
      var at = data.moving.length ? nearest(data.moving, row.t) : -1;
      var which = [5];
      if (at >= 0 && at !== shown) {
        var p = points(data.moving[at].p);
        update = {x: [p.x, update.x[0]], y: [p.y, update.y[0]], z: [p.z, update.z[0]]};
        which = [4, 5];
        shown = at;
      }
      Plotly.restyle(div, update, which);
    }
    listeners.push(function (i, row) {
      slider.value = i;
      document.getElementById('frame-text').textContent = 'Frame ' + i + ' at ' +
        row.t.toFixed(2) + ' s: ' + told(row, ['s', 'c', 'e', 'ep', 'd', 'p', 'm']);
      if (wanted === null) { requestAnimationFrame(draw); }
      wanted = i;
    });
    slider.addEventListener('input', function () { choose(+slider.value); });
    function stop() { clearInterval(timer); timer = null; }
    play.addEventListener('click', function () {
      if (timer) { stop(); } else {
        if (chosen === rows.length - 1) { choose(0); }
        timer = setInterval(function () {
          if (chosen === rows.length - 1) { play.click(); } else { choose(chosen + 1); }
        }, 200);
      }
      play.setAttribute('aria-pressed', String(Boolean(timer)));
      play.textContent = timer ? 'Stop' : 'Play';
    });
    document.querySelectorAll('[data-view]').forEach(function (button) {
      button.addEventListener('click', function () {
        if (button.dataset.view === 'top') { look(camera(frame.centre, [-0.001, 0, 1.5])); }
        if (button.dataset.view === 'side') { look(camera(frame.centre, SIDE)); }
        if (button.dataset.view === 'sensor') {
          look(camera(place(chosen), [-0.3, -0.15, 0.2]));
        }
      });
    });
    div.addEventListener('keydown', function (event) {
      var turn = {ArrowLeft: -0.15, ArrowRight: 0.15}[event.key] || 0;
      var tilt = {ArrowUp: 0.1, ArrowDown: -0.1}[event.key] || 0;
      var zoom = {'+': 0.85, '=': 0.85, '-': 1.18}[event.key] || 1;
      if (!turn && !tilt && zoom === 1) { return; }
      var o = offset(), flat = Math.hypot(o[0], o[1]), far = Math.hypot(flat, o[2]) * zoom;
      var azimuth = Math.atan2(o[1], o[0]) + turn;
      var height = Math.max(-1.5, Math.min(1.5, Math.atan2(o[2], flat) + tilt));
      look(camera(current().center, [far * Math.cos(height) * Math.cos(azimuth),
        far * Math.cos(height) * Math.sin(azimuth), far * Math.sin(height)]));
      event.preventDefault();
    });
    choose(chosen);
    div.dataset.ready = 'yes';
  }

  // Ceilings and roofs hide what is below: at first all that is well above the path is cut off.
  function cutter(div, still, heights, path) {
    var slider = document.getElementById('cut'), last = heights.length - 1;
    function cut() {
      var limit = quantile(heights, slider.value / 100);
      var keep = [];
      still.z.forEach(function (z, i) { if (z <= limit) { keep.push(i); } });
      var part = function (axis) { return keep.map(function (i) { return axis[i]; }); };
      var z = part(still.z);
      Plotly.restyle(div, {x: [part(still.x)], y: [part(still.y)], z: [z], 'marker.color': [z]},
        [0]);
    }
    var above = Math.max.apply(null, path.z) + CUT_M;
    var lower = heights.findIndex(function (z) { return z > above; });
    slider.value = lower < 0 ? 100 : Math.ceil(100 * lower / last);
    slider.addEventListener('change', cut);
    if (lower >= 0) { cut(); }
  }

  function sortable(table) {
    var body = table.tBodies[0];
    Array.from(table.tHead.rows[0].cells).forEach(function (head, k) {
      var button = document.createElement('button');
      button.type = 'button';
      button.textContent = head.textContent;
      head.textContent = '';
      head.appendChild(button);
      button.addEventListener('click', function () {
        var up = head.getAttribute('aria-sort') !== 'ascending';
        Array.from(table.tHead.rows[0].cells).forEach(function (other) {
          other.removeAttribute('aria-sort');
        });
        head.setAttribute('aria-sort', up ? 'ascending' : 'descending');
        Array.from(body.rows).sort(function (a, b) {
          var one = a.cells[k].textContent, two = b.cells[k].textContent;
          return (up ? 1 : -1) * one.localeCompare(two, 'en', {numeric: true});
        }).forEach(function (row) { body.appendChild(row); });
      });
    });
  }

  document.querySelectorAll('[data-frame]').forEach(function (link) {
    link.addEventListener('click', function () { choose(+link.dataset.frame); });
  });
  document.querySelectorAll('table').forEach(sortable);
  if (rows.length) {
    document.querySelectorAll('figure').forEach(linkChart);
    drawScene();
    choose(rows.reduce(function (best, row, i) { return row.d > rows[best].d ? i : best; }, 0));
  }
}());

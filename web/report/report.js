// SPDX-License-Identifier: Apache-2.0
// Draws the report from the JSON in the page. No network, no libraries but uPlot, which is in the page.
'use strict';
(() => {
  const root = document.documentElement;
  root.dataset.errors = '0';
  window.addEventListener('error', (e) => {
    root.dataset.errors = String(Number(root.dataset.errors) + 1);
    root.dataset.lastError = e.message;
  });

  const data = JSON.parse(document.getElementById('data').textContent);
  const page = document.getElementById('page');
  const AXES = ['x', 'y', 'z'];
  const num = (v) => (v === null || v === undefined ? NaN : v);

  // ---- small helpers -------------------------------------------------------------------------------------------------
  const SVG = 'http://www.w3.org/2000/svg';
  function fill(node, attributes, children) {
    for (const [key, value] of Object.entries(attributes || {})) {
      if (key === 'on') for (const [event, handler] of Object.entries(value)) node.addEventListener(event, handler);
      else if (value !== null && value !== undefined && value !== false) node.setAttribute(key, value === true ? '' : value);
    }
    for (const child of children.flat(Infinity)) if (child !== null && child !== undefined) node.append(child);
    return node;
  }
  const h = (tag, attributes, ...children) => fill(document.createElement(tag), attributes, children);
  const s = (tag, attributes, ...children) => fill(document.createElementNS(SVG, tag), attributes, children);
  const css = (name) => getComputedStyle(root).getPropertyValue('--' + name).trim();
  function figure(v) {
    v = num(v);
    if (!Number.isFinite(v)) return '–';
    const a = Math.abs(v);
    if (a >= 100) return Math.round(v).toLocaleString('en').replace(/,/g, '\u202f');
    return v.toFixed(a >= 10 ? 1 : a >= 1 ? 2 : 3);
  }
  const percent = (v) => (Number.isFinite(num(v)) ? (100 * v >= 99.995 ? '100' : (100 * v).toFixed(2)) : '–');
  const worst = (axes) => Math.max(...axes.map(num));

  const tip = document.getElementById('tip');
  function withTip(node, text) {
    node.addEventListener('pointermove', (e) => {
      tip.textContent = text;
      tip.hidden = false;
      const box = tip.getBoundingClientRect();
      tip.style.left = Math.max(4, Math.min(e.clientX + 14, innerWidth - box.width - 6)) + 'px';
      tip.style.top = Math.max(4, e.clientY + 18 + box.height > innerHeight ? e.clientY - box.height - 10 : e.clientY + 18) + 'px';
    });
    node.addEventListener('pointerleave', () => { tip.hidden = true; });
    return node;
  }

  // What must be drawn anew when the colours change.
  const redraws = [];
  let drawn = [];
  function drawAll() {
    for (const plot of drawn) plot.destroy();
    drawn = [];
    for (const redraw of redraws) redraw();
    root.dataset.charts = String(document.querySelectorAll('.uplot').length);
  }
  function setTheme(theme) {
    root.dataset.theme = theme;
    drawAll();
  }

  function section(title, note, ...children) {
    return h('section', {}, h('div', { class: 'head' }, h('div', {}, h('h2', {}, title), note ? h('p', { class: 'note' }, note) : null)), children);
  }
  function toggles(names, chosen, onChange) {
    const buttons = names.map((name, i) => h('button', { type: 'button', 'aria-pressed': String(i === chosen), on: { click: () => {
      buttons.forEach((b, k) => b.setAttribute('aria-pressed', String(k === i)));
      onChange(i);
    } } }, name));
    return h('div', { class: 'tools' }, buttons);
  }

  // ---- charts --------------------------------------------------------------------------------------------------------
  const watcher = new ResizeObserver((entries) => {
    for (const { target } of entries) {
      const plot = target.plot;
      const width = Math.floor(target.clientWidth);
      if (plot && width > 50 && Math.abs(plot.width - width) > 1) plot.setSize({ width, height: plot.height });
    }
  });

  // A place for a chart; make() gives uPlot's options and data each time it is drawn.
  function chart(height, make) {
    const place = h('div', { class: 'chart' });
    redraws.push(() => {
      place.replaceChildren();
      const { options, values } = make();
      const axis = (extra) => ({ stroke: css('soft'), font: '11.5px system-ui, sans-serif', grid: { stroke: css('grid'), width: 1 },
        ticks: { stroke: css('line'), width: 1, size: 4 }, gap: 4, size: 30, ...extra });
      const full = {
        width: Math.max(200, Math.floor(place.clientWidth) || 560), height, ms: 1, padding: [8, 12, 0, 0],
        cursor: { focus: { prox: 16 }, points: { size: 6 }, ...options.cursor },
        legend: { live: true, ...options.legend },
        ...options,
        scales: { x: { time: false }, ...options.scales },
        axes: [axis({ ...options.xAxis }), axis({ size: 58, ...options.yAxis })],
      };
      if (options.cursor) full.cursor = { focus: { prox: 16 }, points: { size: 6 }, ...options.cursor };
      const plot = new uPlot(full, values, place);
      place.plot = plot;
      place.fit = () => options.fit && options.fit(plot);
      drawn.push(plot);
      watcher.observe(place);
    });
    return place;
  }
  const value = (digits, unit) => (u, v) => (v === null || v === undefined ? '–' : v.toFixed(digits) + (unit ? ' ' + unit : ''));
  const line = (label, stroke, extra) => ({ label, stroke, width: 1.4, points: { show: false }, ...extra });
  const dots = (label, stroke, size, extra) => ({ label, stroke, fill: stroke, width: 0, paths: () => null,
    points: { show: true, size, fill: stroke, stroke, width: 0 }, ...extra });

  // A y scale that follows what compute(from, to) says of the x range in view.
  function fitY(options, compute) {
    const all = [-Infinity, Infinity];
    const range = (u) => (Number.isFinite(u.scales.x.min) ? compute(u.scales.x.min, u.scales.x.max) : compute(...all));
    options.scales = { ...options.scales, y: { range } };
    const fit = (u) => {
      const [min, max] = range(u);
      if (min !== u.scales.y.min || max !== u.scales.y.max) u.setScale('y', { min, max });
    };
    options.hooks = { setScale: [(u, key) => { if (key === 'x') fit(u); }] };
    options.fit = fit;
    return options;
  }

  // One component of an error with the filter's three-sigma bounds.
  function errorChart(axisName, unit, digits, days, error, sigma, view, sync) {
    const bound = sigma.map((v) => 3 * num(v));
    const negative = bound.map((v) => -v);
    return chart(168, () => {
      const colour = css(axisName);
      return {
        values: [days, error, bound, negative],
        options: fitY({
          cursor: { sync: { key: sync }, drag: { x: true, y: false } },
          series: [
            { label: 'day', value: value(2) },
            line(axisName + ' error', colour, { value: value(digits, unit), width: 1.5 }),
            line('3σ bound', css('bound'), { width: 1, value: value(digits, unit) }),
            line('−3σ', css('bound'), { width: 1, value: () => '' }),
          ],
          bands: [{ series: [2, 3], fill: css('band') }],
          yAxis: { label: axisName + ', ' + unit, labelSize: 16, labelFont: '11.5px system-ui, sans-serif', size: 52 },
          legend: { show: false },
        }, (from, to) => {
          const largest = (since) => {
            let size = 0;
            for (let i = 0; i < days.length; i++) if (days[i] >= Math.max(from, since) && days[i] <= to) size = Math.max(size, bound[i] || 0, Math.abs(error[i]) || 0);
            return size;
          };
          const size = (view.steady && largest(view.steadyDay)) || largest(-Infinity) || 1;
          return [-1.12 * size, 1.12 * size];
        }),
      };
    });
  }

  function errorSection(title, unit, digits, record, keys, summary, sync) {
    const steadyDay = record.steadyDay;
    const view = { steady: Number.isFinite(steadyDay), steadyDay };
    const axes = AXES.map((name, i) => errorChart(name, unit, digits, record.day, record[keys[0]][i], record[keys[1]][i], view, sync));
    const tools = toggles(['steady state', 'whole mission'], view.steady ? 0 : 1, (i) => {
      view.steady = i === 0 && Number.isFinite(steadyDay);
      axes.forEach((place) => { place.plot.setData(place.plot.data); place.fit(); });
    });
    const box = section(title, 'Estimate minus truth in ICRF axes, inside the filter’s own 3σ bounds; days along. Drag to zoom in, double-click to see all.', axes);
    box.querySelector('.head').append(tools);
    return box;
  }

  // ---- parts ---------------------------------------------------------------------------------------------------------
  function header(title, facts) {
    const dark = window.matchMedia && matchMedia('(prefers-color-scheme: dark)').matches;
    root.dataset.theme = dark ? 'dark' : 'light';
    return h('header', {},
      h('div', { class: 'grow' }, h('h1', {}, title), h('div', { class: 'facts' }, facts.filter(Boolean).map((f) => h('span', {}, f)))),
      h('button', { type: 'button', on: { click: () => setTheme(root.dataset.theme === 'dark' ? 'light' : 'dark') } }, 'light / dark'));
  }
  function card(label, main, unit, under, gauge) {
    return h('div', { class: 'card' }, h('div', { class: 'label' }, label),
      h('div', { class: 'value' }, main, unit ? h('small', {}, ' ' + unit) : null), gauge || null, under ? h('div', { class: 'under' }, under) : null);
  }
  function bandCard(label, mean, band, expected) {
    const [lo, hi] = band.map(num);
    const top = Math.max(hi * 1.35, num(mean) * 1.15, expected * 1.6) || 1;
    const inside = mean >= lo && mean <= hi;
    const at = (v) => Math.max(0, Math.min(100, (100 * v) / top)) + '%';
    const gauge = Number.isFinite(lo) && Number.isFinite(num(mean)) ? h('div', { class: 'gauge' },
      h('i', { style: `left:${at(lo)};width:calc(${at(hi)} - ${at(lo)})` }), h('b', { class: inside ? '' : 'out', style: `left:${at(mean)}` })) : null;
    return card(label, figure(mean), null, `95 % band ${figure(lo)} to ${figure(hi)}; expected ${expected}`, gauge);
  }
  function interval(path) {
    let node = data.confidence;
    for (const key of path) node = node && node[key];
    return Array.isArray(node) ? node : null;
  }
  function errorCard(label, key, unit) {
    const e = data.summary[key];
    const k = e.steady_3sigma_axis.map(num).indexOf(worst(e.steady_3sigma_axis));
    const ci = interval([key, 'steady_3sigma_axis', k]);
    return card(label, figure(worst(e.steady_3sigma_axis)), unit,
      (ci ? `95 %: ${figure(ci[0])} to ${figure(ci[1])}; ` : '') + `own bound ${figure(worst(e.formal_3sigma_axis))} ${unit}`);
  }
  function summaryCards() {
    const m = data.summary;
    const cards = [
      errorCard('Position, 3σ, worst axis', 'position_error_km', 'km'),
      errorCard('Velocity, 3σ, worst axis', 'velocity_error_m_s', 'm/s'),
      bandCard('NEES (6 states)', m.nees_mean, m.nees_band_95, 6),
      bandCard('NIS', m.nis_mean, m.nis_band_95, 2),
    ];
    if (Number.isFinite(num(m.vision.attitude_success_rate))) {
      cards.push(card('Attitude found', percent(m.vision.attitude_success_rate), '%', `${figure(m.vision.attitude_error_arcsec_1sigma.cross)}″ across, ${figure(m.vision.attitude_error_arcsec_1sigma.roll)}″ roll (1σ)`));
      cards.push(card('Planet found', percent(m.vision.planet_success_rate), '%', `${m.vision.false_planets} false; ${figure(m.vision.planet_error_px_1sigma)} px (1σ)`));
      cards.push(card('Onboard, per image', figure(m.time_ms_per_image.median), 'ms', `99 %: ${figure(m.time_ms_per_image.p99)} ms`));
    }
    cards.push(card(data.kind === 'campaign' ? 'Flown in' : 'Whole run', figure(m.wall_s), 's', `${figure(m.peak_memory_mb)} MB; ${m.images} ${m.level === 'mil' ? 'sights' : 'images'}`));
    return h('div', { class: 'cards', style: `--columns:${cards.length === 5 ? 5 : 4}` }, cards);
  }

  function figuresSection() {
    const m = data.summary;
    const rows = [];
    for (const [label, e] of [['position, km', m.position_error_km], ['velocity, m/s', m.velocity_error_m_s]]) {
      for (const [when, f] of [['after the second window', e], ['at the end of a coast', e.end_of_coast]]) {
        rows.push(h('tr', {}, h('td', {}, h('b', {}, label), ' ', when), f.steady_3sigma_axis.map((v) => h('td', {}, figure(v)))));
        rows.push(h('tr', { class: 'soft' }, h('td', {}, 'the filter’s own bound'), f.formal_3sigma_axis.map((v) => h('td', {}, figure(v)))));
      }
    }
    return section('Steady state, 3σ', null, h('div', { class: 'scroll' }, h('table', {}, h('thead', {}, h('tr', {}, ['', 'x', 'y', 'z'].map((t) => h('th', {}, t)))), h('tbody', {}, rows))));
  }

  // The solar system in three dimensions on a plain canvas: drag turns, the wheel zooms.
  function orbitView(orbit) {
    const canvas = h('canvas', { class: 'orbit', 'aria-label': 'Trajectory in three dimensions; drag to turn, wheel to zoom' });
    const view = { azimuth: -0.6, height: 0.95, zoom: 1, day: orbit.day[orbit.day.length - 1], exaggerate: orbit.exaggerate };
    const tilt = 23.4392911 * Math.PI / 180;  // ICRF to the ecliptic, so that the planets lie flat
    const ecliptic = ([x, y, z]) => [x, y * Math.cos(tilt) + z * Math.sin(tilt), -y * Math.sin(tilt) + z * Math.cos(tilt)];
    const truth = orbit.truth.map(ecliptic);
    const error = orbit.error.map(ecliptic);
    const planets = orbit.planets.map((p) => ({ name: p.name, track: p.track.map(ecliptic), ...style(p.name) }));
    function style(name) {
      return { mercury: { colour: '#b9a48f', size: 3 }, venus: { colour: '#f2d7a0', size: 4 }, earth: { colour: '#5aa9ff', size: 4.5 }, mars: { colour: '#ff7d55', size: 4 },
        jupiter: { colour: '#e3bb92', size: 6 }, saturn: { colour: '#e8d9a8', size: 5.5 }, uranus: { colour: '#9fe0e0', size: 5 }, neptune: { colour: '#7d9bff', size: 5 } }[name] || { colour: '#cccccc', size: 4 };
    }
    // The whole ellipse from place and velocity at the start (Kepler; AU and days).
    const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    const scale = (a, k) => [a[0] * k, a[1] * k, a[2] * k];
    const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
    const length = (a) => Math.sqrt(dot(a, a));
    function ellipse(track, span) {
      if (track.length < 3 || !(span > 0)) return track;
      const dt = span / (track.length - 1);
      const r = track[1];
      const v = scale(add(track[2], scale(track[0], -1)), 0.5 / dt);
      const mu = 2.9591220828559e-4;
      const momentum = cross(r, v);
      const e = add(scale(cross(v, momentum), 1 / mu), scale(r, -1 / length(r)));
      const ecc = length(e);
      const p = dot(momentum, momentum) / mu;
      if (!(ecc < 0.9)) return track;
      const P = ecc > 1e-6 ? scale(e, 1 / ecc) : scale(r, 1 / length(r));
      const W = scale(momentum, 1 / length(momentum));
      const Q = cross(W, P);
      const out = [];
      for (let i = 0; i <= 180; i++) {
        const f = (2 * Math.PI * i) / 180;
        const rho = p / (1 + ecc * Math.cos(f));
        out.push(add(scale(P, rho * Math.cos(f)), scale(Q, rho * Math.sin(f))));
      }
      return out;
    }
    const span = orbit.span;
    for (const planet of planets) planet.orbit = ellipse(planet.track, span);
    const reach = 1.18 * Math.max(...truth.map(length), 1);

    const at = (list, fraction) => {
      const x = Math.max(0, Math.min(1, fraction)) * (list.length - 1);
      const i = Math.min(list.length - 2, Math.floor(x));
      return i < 0 ? list[0] : add(scale(list[i], 1 - (x - i)), scale(list[i + 1], x - i));
    };
    const indexOf = (day) => {
      let i = 0;
      while (i + 1 < orbit.day.length && orbit.day[i + 1] <= day) i++;
      return i;
    };
    function draw() {
      const ratio = window.devicePixelRatio || 1;
      const width = canvas.clientWidth || 560;
      const height = canvas.clientHeight || 430;
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
      const c = canvas.getContext('2d');
      c.setTransform(ratio, 0, 0, ratio, 0, 0);
      c.clearRect(0, 0, width, height);
      const unit = (Math.min(width, height) / 2 / reach) * view.zoom;
      const [ca, sa, ce, se] = [Math.cos(view.azimuth), Math.sin(view.azimuth), Math.sin(view.height), Math.cos(view.height)];
      const project = ([x, y, z]) => {
        const px = ca * x - sa * y;
        const py = sa * x + ca * y;
        return [width / 2 + unit * px, height / 2 - unit * (py * ce + z * se)];
      };
      const path = (points) => {
        c.beginPath();
        points.forEach((p, i) => { const [u, v] = project(p); if (i) c.lineTo(u, v); else c.moveTo(u, v); });
      };
      const ball = (p, size, colour, label) => {
        const [u, v] = project(p);
        c.fillStyle = colour;
        c.beginPath();
        c.arc(u, v, size, 0, 2 * Math.PI);
        c.fill();
        if (label) { c.fillStyle = 'rgba(220,228,240,.85)'; c.fillText(label, u + size + 4, v - size); }
      };
      c.font = '11.5px system-ui, sans-serif';
      c.lineWidth = 1;
      c.strokeStyle = 'rgba(140,160,200,.10)';
      for (let k = -3; k <= 3; k++) {
        path([[k * 0.5, -1.5, 0], [k * 0.5, 1.5, 0]]); c.stroke();
        path([[-1.5, k * 0.5, 0], [1.5, k * 0.5, 0]]); c.stroke();
      }
      const fraction = (view.day - orbit.begin) / span;
      for (const planet of planets) {
        c.strokeStyle = planet.colour + '77';
        path(planet.orbit);
        c.stroke();
      }
      const glow = c.createRadialGradient(...project([0, 0, 0]), 1, ...project([0, 0, 0]), 26);
      glow.addColorStop(0, 'rgba(255,220,120,.9)');
      glow.addColorStop(1, 'rgba(255,200,80,0)');
      c.fillStyle = glow;
      c.beginPath();
      c.arc(...project([0, 0, 0]), 26, 0, 2 * Math.PI);
      c.fill();
      ball([0, 0, 0], 5, '#ffdf80', 'Sun');
      const now = indexOf(view.day);
      // The rest of the way is faint.
      c.strokeStyle = 'rgba(255,255,255,.25)';
      c.lineWidth = 1.2;
      path(truth);
      c.stroke();
      c.strokeStyle = '#ffffff';
      c.lineWidth = 2;
      path(truth.slice(0, now + 1));
      c.stroke();
      c.strokeStyle = '#ff5fa2';
      c.lineWidth = 1.3;
      // An error that would leave the picture (the first cycles) is not drawn.
      path(truth.slice(0, now + 1).map((p, i) => [p, scale(error[i], view.exaggerate)]).filter(([, d]) => length(d) < 0.3).map(([p, d]) => add(p, d)));
      c.stroke();
      const here = truth[now];
      const choice = [...orbit.beacons].reverse().find((b) => b.day <= view.day + 1e-9);
      for (const planet of planets) {
        const place = at(planet.track, fraction);
        if (choice && (choice.first === planet.name || choice.second === planet.name)) {
          c.strokeStyle = planet.colour + 'aa';
          c.setLineDash([4, 4]);
          c.lineWidth = 1.2;
          path([here, place]);
          c.stroke();
          c.setLineDash([]);
        }
        ball(place, planet.size, planet.colour, planet.name);
      }
      ball(here, 4, '#ffffff', null);
      c.strokeStyle = '#ff5fa2';
      c.lineWidth = 1.5;
      c.beginPath();
      c.arc(...project(here), 8, 0, 2 * Math.PI);
      c.stroke();
      dayText.textContent = `day ${view.day.toFixed(0)}` + (choice ? `, looking at ${[...new Set([choice.first, choice.second])].join(' and ')}` : '');
    }
    let last = null;
    canvas.addEventListener('pointerdown', (e) => { last = [e.clientX, e.clientY]; canvas.setPointerCapture(e.pointerId); });
    canvas.addEventListener('pointerup', () => { last = null; });
    canvas.addEventListener('pointermove', (e) => {
      if (!last) return;
      view.azimuth += (e.clientX - last[0]) * 0.008;
      view.height = Math.max(-1.57, Math.min(1.57, view.height + (e.clientY - last[1]) * 0.008));
      last = [e.clientX, e.clientY];
      draw();
    });
    canvas.addEventListener('wheel', (e) => {
      e.preventDefault();
      view.zoom = Math.max(0.03, Math.min(60, view.zoom * Math.exp(-e.deltaY * 0.0012)));
      draw();
    }, { passive: false });
    canvas.addEventListener('dblclick', () => { Object.assign(view, { azimuth: -0.6, height: 0.95, zoom: 1 }); draw(); });
    const dayText = h('span', {}, '');
    const slider = h('input', { type: 'range', min: orbit.begin, max: orbit.begin + span, step: span / 600, value: view.day, 'aria-label': 'day of the mission',
      style: 'flex:1;min-width:120px', on: { input: (e) => { view.day = Number(e.target.value); draw(); } } });
    let timer = null;
    const play = h('button', { type: 'button', on: { click: () => {
      if (timer) { clearInterval(timer); timer = null; play.textContent = 'play'; return; }
      play.textContent = 'pause';
      if (view.day >= orbit.begin + span * 0.999) view.day = orbit.begin;
      timer = setInterval(() => {
        view.day = Math.min(orbit.begin + span, view.day + span / 400);
        slider.value = view.day;
        draw();
        if (view.day >= orbit.begin + span) play.click();
      }, 33);
    } } }, 'play');
    const times = h('span', {}, '');
    const showTimes = () => { times.textContent = `errors ×${figure(Number(view.exaggerate.toPrecision(2)))}`; };
    const exaggerate = h('input', { type: 'range', min: 0, max: 5, step: 0.05, value: Math.log10(view.exaggerate), 'aria-label': 'exaggeration of the error',
      style: 'width:90px', on: { input: (e) => { view.exaggerate = 10 ** Number(e.target.value); showTimes(); draw(); } } });
    showTimes();
    redraws.push(draw);
    new ResizeObserver(draw).observe(canvas);
    return h('div', {}, canvas, h('div', { class: 'tools', style: 'margin-top:8px' }, play, slider, h('label', {}, dayText)),
      h('div', { class: 'tools', style: 'margin-top:4px' }, h('label', {}, exaggerate, times),
        h('div', { class: 'key', style: 'margin:0 0 0 auto' }, h('span', {}, h('i', { style: 'background:#dfe6f0;border:1px solid var(--faint)' }), 'truth'), h('span', {}, h('i', { style: 'background:#ff5fa2' }), 'estimate'))));
  }

  function timeline(beacons, span) {
    const bodies = [...new Set(beacons.flatMap((b) => b.candidates.map((c) => c.name)))];
    const [left, rowHeight, width] = [66, 26, 560];
    const height = bodies.length * rowHeight + 26;
    const x = (day) => left + ((width - left - 16) * day) / span;
    const svg = s('svg', { class: 'timeline', viewBox: `0 0 ${width} ${height}`, width: '100%', role: 'img', 'aria-label': 'Beacons over time' });
    const tick = span > 400 ? 100 : span > 120 ? 50 : 10;
    for (let day = 0; day <= span + 1e-9; day += tick) {
      svg.append(s('line', { class: 'gridline', x1: x(day), x2: x(day), y1: 0, y2: height - 22 }), s('text', { x: x(day), y: height - 7, 'text-anchor': 'middle' }, String(day)));
    }
    bodies.forEach((name, row) => {
      svg.append(s('text', { x: left - 8, y: row * rowHeight + 17, 'text-anchor': 'end' }, name));
      beacons.forEach((b, i) => {
        const c = b.candidates.find((k) => k.name === name);
        if (!c) return;
        const next = i + 1 < beacons.length ? beacons[i + 1].day : b.day + (i > 0 ? b.day - beacons[i - 1].day : span / 30);
        const used = b.first === name ? 'first' : b.second === name ? 'second' : null;
        const colour = used ? (used === 'first' ? 'var(--x)' : 'var(--y)') : c.visible ? 'var(--bound)' : 'var(--grid)';
        const cell = s('rect', { class: 'cell', x: x(b.day), y: row * rowHeight + 3, width: Math.max(1, x(Math.min(next, span * 1.02)) - x(b.day)), height: rowHeight - 6, rx: 2, fill: colour, 'fill-opacity': used ? 1 : c.visible ? 0.35 : 1 });
        withTip(cell, `day ${b.day.toFixed(0)}, ${name}: ${used ? 'tracked ' + used : c.visible ? 'visible, not needed' : 'not visible (' + c.why_not + ')'}\n` +
          `V ${c.v_mag.toFixed(1)}, ${c.sun_elongation_deg.toFixed(0)}° from the Sun, ${(c.distance_km / 149597870.7).toFixed(2)} AU away`);
        svg.append(cell);
      });
    });
    return h('div', {}, svg, h('div', { class: 'key' },
      h('span', {}, h('i', { style: 'background:var(--x)' }), 'tracked first'), h('span', {}, h('i', { style: 'background:var(--y)' }), 'tracked second'),
      h('span', {}, h('i', { style: 'background:var(--bound);opacity:.35' }), 'visible'), h('span', {}, h('i', { style: 'background:var(--grid)' }), 'not visible')));
  }

  function consistencySection(record) {
    const nees = chart(210, () => ({
      values: [record.cycle.day, record.cycle.nees, record.cycle.day.map(() => record.nees_bounds[0]), record.cycle.day.map(() => record.nees_bounds[1]), record.cycle.day.map(() => 6)],
      options: {
        series: [{ label: 'day', value: value(1) }, { ...line('NEES', css('accent'), { value: value(2) }), points: { show: true, size: 6, fill: css('accent'), stroke: css('accent') } },
          line('95 % low', css('bound'), { width: 1, value: value(2) }), line('95 % high', css('bound'), { width: 1, value: value(2) }), line('expected', css('faint'), { dash: [5, 5], width: 1, value: value(0) })],
        bands: [{ series: [3, 2], fill: css('band') }],
        scales: { y: { range: (u, min, max) => [0, Math.max(20, Math.min(60, max * 1.1))] } },
      },
    }));
    const w = record.window;
    const nis = chart(210, () => ({
      values: [w.index, w.nis, w.lo, w.hi, w.index.map(() => 2)],
      options: {
        series: [{ label: 'window', value: (u, v) => (v === null || v === undefined ? '–' : `${v} (day ${w.day[w.index.indexOf(v)].toFixed(0)}, ${w.body[w.index.indexOf(v)]})`) },
          dots('mean NIS', css('accent'), 6, { value: value(2) }), line('95 % low', css('bound'), { width: 1, value: value(2) }), line('95 % high', css('bound'), { width: 1, value: value(2) }), line('expected', css('faint'), { dash: [5, 5], width: 1, value: value(0) })],
        bands: [{ series: [3, 2], fill: css('band') }],
        scales: { y: { range: (u, min, max) => [0, Math.max(4, Math.min(12, max * 1.1))] } },
      },
    }));
    return h('div', { class: 'row' },
      section('NEES', 'Error of the six states over their covariance, when the second window of each cycle ends. One value in twenty may leave the band; neighbours are correlated.', nees),
      section('NIS', 'Innovations over their covariance, mean of each tracking window with the 95 % band of that mean.', nis));
  }

  function residualSection(images) {
    const hover = (u, v) => {
      if (v === null || v === undefined) return '–';
      const i = images.index.indexOf(v);
      return i < 0 ? String(v) : `${v} (day ${images.day[i].toFixed(2)}, ${images.body[i]})`;
    };
    const component = (k, label, colour) => chart(190, () => {
      const sigma = images.innovation_sigma[k].map((v) => 3 * v);
      return {
        values: [images.index, images.innovation[k], sigma, sigma.map((v) => -v)],
        options: fitY({
          cursor: { sync: { key: 'image' }, drag: { x: true, y: false } },
          series: [{ label: 'image', value: hover }, dots(label, css(colour), 3.2, { value: value(3, 'px') }), line('3σ', css('bound'), { width: 1, value: value(3, 'px') }), line('−3σ', css('bound'), { width: 1, value: () => '' })],
          bands: [{ series: [2, 3], fill: css('band') }],
          yAxis: { label: label + ', px', labelSize: 16, labelFont: '11.5px system-ui, sans-serif', size: 52 },
          legend: { show: k === 1 },
        }, (from, to) => {
          // What most images show; the first few may be far out while the place is not known.
          const seen = [];
          for (let i = 0; i < images.index.length; i++) if (images.index[i] >= from && images.index[i] <= to) seen.push(Math.max(Math.abs(num(images.innovation[k][i])) || 0, sigma[i] || 0));
          seen.sort((a, b) => a - b);
          const size = (seen.length && seen[Math.floor(0.94 * (seen.length - 1))]) || 1;
          return [-1.5 * size, 1.5 * size];
        }),
      };
    });
    return section('Residuals of the beacons', 'Measured minus predicted pixel of every image that the filter took, inside its own 3σ; images are counted along. Drag to zoom in, double-click to see all.',
      component(0, 'u', 'x'), component(1, 'v', 'y'));
  }

  // About the camera's x and y axes, inside 3 sigma; null where nothing was known.
  function attitudeChart(images, error, sigma) {
    const bound = (sign) => sigma[0].map((v) => (v === null ? null : sign * 3 * v));
    return chart(190, () => ({
      values: [images.index, error[0], error[1], bound(1), bound(-1)],
      options: {
        series: [{ label: 'image' }, dots('about x', css('x'), 3, { value: value(2, '″') }), dots('about y', css('y'), 3, { value: value(2, '″') }), line('3σ', css('bound'), { width: 1, value: value(2, '″') }), line('−3σ', css('bound'), { width: 1, value: () => '' })],
        bands: [{ series: [3, 4], fill: css('band') }],
        yAxis: { label: 'arcsec', labelSize: 16, labelFont: '11.5px system-ui, sans-serif', size: 52 },
        cursor: { sync: { key: 'image' } },
      },
    }));
  }

  function gyroSection(images) {
    const a = data.summary.attitude_filter;
    const words = `How far off the attitude of each image was that gyro and earlier images foretold. ${percent(a.by_prior_rate)} % of the images were found by it; from image to image it is good to ${figure(a.between_images_arcsec_1sigma.cross)}″, after a slew to ${figure(a.after_slew_arcsec_1sigma.cross)}″ (1σ, across), NEES (3) ${figure(a.nees_mean)} in ${figure(a.nees_band_95[0])} to ${figure(a.nees_band_95[1])}; the gyro’s bias is found to ${figure(a.gyro_bias_error_deg_h_1sigma)} deg/h.`;
    return section('Attitude between images', words, attitudeChart(images, images.foretold_error, images.foretold_sigma));
  }

  function visionSection(images) {
    const dotted = (height, label, values, colour, digits, unit) => chart(height, () => ({
      values: [images.index, values],
      options: {
        series: [{ label: 'image' }, dots(label, css(colour), 3, { value: value(digits, unit) })],
        scales: { y: { range: (u, min, max) => [0, max * 1.15 || 1] } },
        cursor: { sync: { key: 'image' } },
        yAxis: { label: label, labelSize: 16, labelFont: '11.5px system-ui, sans-serif', size: 52 },
        legend: { show: false },
      },
    }));
    return h('div', { class: 'row' }, section('Attitude error', 'About the camera’s x and y axes, from the stars of the same image; images are counted along.', attitudeChart(images, images.attitude_error, images.attitude_sigma)),
      section('Stars', 'How many stars each attitude rests on, and the rms error of their centres per axis.',
        dotted(104, 'matched', images.stars, 'z', 0), dotted(104, 'error, px', images.centroid, 'accent', 3, 'px')));
  }

  function frameView(frame) {
    const box = h('div', { class: 'frame' });
    const svg = s('svg', { viewBox: `0 0 ${frame.width} ${frame.height}`, role: 'img', 'aria-label': 'Frame with marks' });
    const scene = s('g', { transform: 'translate(0.5 0.5)' });  // a pixel's centre is a whole number
    svg.append(s('image', { href: 'data:image/png;base64,' + frame.png, width: frame.width, height: frame.height }), scene);
    const view = { x: 0, y: 0, size: 1 };
    const labels = [];
    const apply = () => {
      svg.setAttribute('viewBox', `${view.x} ${view.y} ${frame.width * view.size} ${frame.height * view.size}`);
      for (const label of labels) label.setAttribute('font-size', 17 * view.size * frame.width / 1024);
    };
    for (const m of frame.marks) {
      const mark = s('circle', { class: 'mark ' + m.kind, cx: m.u, cy: m.v, r: m.radius });
      const what = { star: 'star', planet: 'planet, found', predicted: 'where the navigation expects it', spot: 'neither star nor planet' }[m.kind] || m.kind;
      scene.append(withTip(mark, `${m.label || what}${m.label ? '\n' + what : ''}\nu ${m.u.toFixed(2)}, v ${m.v.toFixed(2)}`));
      if (m.kind === 'planet' && m.label) {
        const label = s('text', { class: 'planet', x: m.u + m.radius + 8, y: m.v + 6, 'font-size': 17 }, m.label);
        labels.push(label);
        scene.append(label);
      }
    }
    apply();
    svg.addEventListener('wheel', (e) => {
      e.preventDefault();
      const box2 = svg.getBoundingClientRect();
      const [fx, fy] = [(e.clientX - box2.left) / box2.width, (e.clientY - box2.top) / box2.height];
      const size = Math.max(0.01, Math.min(1, view.size * Math.exp(e.deltaY * 0.0015)));
      view.x = Math.max(0, Math.min(frame.width * (1 - size), view.x + fx * frame.width * (view.size - size)));
      view.y = Math.max(0, Math.min(frame.height * (1 - size), view.y + fy * frame.height * (view.size - size)));
      view.size = size;
      apply();
    }, { passive: false });
    let last = null;
    svg.addEventListener('pointerdown', (e) => { last = [e.clientX, e.clientY]; });
    window.addEventListener('pointerup', () => { last = null; });
    svg.addEventListener('pointermove', (e) => {
      if (!last) return;
      const k = (frame.width * view.size) / svg.getBoundingClientRect().width;
      view.x = Math.max(0, Math.min(frame.width * (1 - view.size), view.x - (e.clientX - last[0]) * k));
      view.y = Math.max(0, Math.min(frame.height * (1 - view.size), view.y - (e.clientY - last[1]) * k));
      last = [e.clientX, e.clientY];
      apply();
    });
    svg.addEventListener('dblclick', () => { Object.assign(view, { x: 0, y: 0, size: 1 }); apply(); });
    box.append(svg);
    const count = (kind) => frame.marks.filter((m) => m.kind === kind).length;
    return { box, figure: h('figure', {}, box, h('figcaption', {}, `${frame.epoch}: tracking ${frame.beacon}; ${count('star')} stars identified, ${count('spot')} other spots`)) };
  }
  function framesSection(frames) {
    const views = frames.map(frameView);
    const kinds = [['stars', 'star'], ['planet', 'planet'], ['predicted', 'predicted'], ['other spots', 'spot']];
    const buttons = kinds.map(([label, kind]) => {
      const b = h('button', { type: 'button', 'aria-pressed': 'true', on: { click: () => {
        const on = b.getAttribute('aria-pressed') !== 'true';
        b.setAttribute('aria-pressed', String(on));
        views.forEach((v) => v.box.classList.toggle('no-' + kind, !on));
      } } }, label);
      return b;
    });
    const box = section('What the camera saw', 'Frames as rendered, brightened, with what the onboard software made of them: blue stars are identified, yellow is the planet that was measured, pink where the navigation expected it. Wheel and drag to look closer, double-click to see all.',
      h('div', { class: 'frames' }, views.map((v) => v.figure)));
    box.querySelector('.head').append(h('div', { class: 'tools' }, buttons));
    return box;
  }

  function timingSection() {
    const m = data.summary;
    const onboard = [['centroids', m.time_ms.centroid, 'var(--x)'], ['identification and attitude', m.time_ms.identify, '#8b5cf6'], ['planet', m.time_ms.planets, 'var(--y)'],
      ['filter update', m.time_ms.update, 'var(--z)'], ['propagation', m.time_ms.propagate, '#64748b']].filter((r) => num(r[1]) > 0);
    const total = onboard.reduce((sum, r) => sum + r[1], 0) || 1;
    const rows = [h('h3', {}, `Onboard, mean per ${m.level === 'mil' ? 'sight' : 'image'}: ${figure(total)} ms`),
      h('div', { class: 'bar' }, onboard.map(([label, ms, colour]) => withTip(h('i', { style: `width:${(100 * ms) / total}%;background:${colour}` }), `${label}: ${figure(ms)} ms`))),
      h('div', { class: 'key' }, onboard.map(([label, ms, colour]) => h('span', {}, h('i', { style: 'background:' + colour }), `${label} ${figure(ms)} ms`)))];
    if (Number.isFinite(num(m.time_ms.render)) && m.time_ms.render > 0) rows.push(h('p', { class: 'note', style: 'margin-top:10px' }, `Beside it the simulator renders a frame in ${figure(m.time_ms.render)} ms. Measured on the machine that flew this run; the whole run took ${figure(m.wall_s)} s and ${figure(m.peak_memory_mb)} MB.`));
    const box = section('Timing', null, rows);
    if (data.image_ms && data.image_ms.counts.length) {
      box.append(h('h3', { style: 'margin-top:10px' }, 'Onboard time of an image, ms'), histogram(data.image_ms, 'ms', 'images', 'accent', 130));
    }
    return box;
  }

  function histogram(bins, xLabel, yLabel, colour, height, extra) {
    // Half a bin more at both ends: bars are drawn whole.
    const half = bins.centers.length > 1 ? 0.5 * (bins.centers[1] - bins.centers[0]) : 0.5;
    const whole = [bins.centers[0] - half, bins.centers[bins.centers.length - 1] + half];
    return chart(height, () => ({
      values: [bins.centers, bins.counts],
      options: {
        series: [{ label: xLabel, value: value(2) }, { label: yLabel, stroke: css(colour), fill: css(colour) + '55', paths: uPlot.paths.bars({ size: [0.92, 100] }), points: { show: false }, value: value(0) }],
        scales: { x: { time: false, range: (u, min, max) => (min <= bins.centers[0] && max >= bins.centers[bins.centers.length - 1] ? whole : [min, max]) }, y: { range: (u, min, max) => [0, max * 1.1 || 1] } },
        legend: { show: false },
        ...extra,
      },
    }));
  }

  // Where planets were found beside their true pixels: density of the error in two dimensions (Gaussian kernels).
  function planetErrorSection(images) {
    const all = images.body.map((body, i) => ({ body, u: num(images.planet_error[0][i]), v: num(images.planet_error[1][i]) }))
      .filter((p) => Number.isFinite(p.u) && Number.isFinite(p.v));
    const bodies = [...new Set(all.map((p) => p.body))];
    const canvas = h('canvas', { class: 'density', width: 520, height: 520, 'aria-label': 'Density of the error of planet pixels' });
    const words = h('table', {});
    const about = (points) => {
      const n = points.length || 1;
      const mean = (f) => points.reduce((sum, p) => sum + f(p), 0) / n;
      const [mu, mv] = [mean((p) => p.u), mean((p) => p.v)];
      return { n: points.length, mu, mv, su: Math.sqrt(mean((p) => p.u * p.u)), sv: Math.sqrt(mean((p) => p.v * p.v)),
        radius: points.map((p) => Math.hypot(p.u, p.v)).sort((a, b) => a - b)[Math.min(points.length - 1, Math.floor(0.9889 * points.length))] };
    };
    let chosen = all;
    function draw() {
      const size = canvas.width;
      const k = about(chosen);
      const reach = Math.max(1e-6, 1.15 * Math.max(3 * k.su, 3 * k.sv, k.radius || 0));
      const cells = 130;
      const kernel = Math.max(1.5, (0.25 * Math.min(k.su, k.sv) * cells) / (2 * reach));
      const grid = new Float64Array(cells * cells);
      const span = Math.ceil(3 * kernel);
      for (const p of chosen) {
        const [x, y] = [((p.u / reach + 1) * cells) / 2, ((p.v / reach + 1) * cells) / 2];
        for (let j = Math.max(0, Math.floor(y) - span); j <= Math.min(cells - 1, Math.floor(y) + span); j++) {
          for (let i = Math.max(0, Math.floor(x) - span); i <= Math.min(cells - 1, Math.floor(x) + span); i++) {
            grid[j * cells + i] += Math.exp(-((i + 0.5 - x) ** 2 + (j + 0.5 - y) ** 2) / (2 * kernel * kernel));
          }
        }
      }
      const top = Math.max(...grid) || 1;
      const g = canvas.getContext('2d');
      g.fillStyle = css('card');
      g.fillRect(0, 0, size, size);
      const cell = size / cells;
      const colour = css('accent');
      for (let j = 0; j < cells; j++) {
        for (let i = 0; i < cells; i++) {
          const share = grid[j * cells + i] / top;
          if (share < 0.004) continue;
          g.globalAlpha = Math.sqrt(share);
          g.fillStyle = colour;
          g.fillRect(i * cell, j * cell, cell + 0.6, cell + 0.6);
        }
      }
      g.globalAlpha = 1;
      g.strokeStyle = css('line');
      g.strokeRect(0.5, 0.5, size - 1, size - 1);
      g.beginPath();
      g.moveTo(0, size / 2); g.lineTo(size, size / 2); g.moveTo(size / 2, 0); g.lineTo(size / 2, size);
      g.stroke();
      g.lineWidth = 1.5;
      const at = (value) => (value / reach) * (size / 2);
      for (const sigmas of [1, 3]) {
        g.strokeStyle = css(sigmas === 1 ? 'soft' : 'bound');
        g.setLineDash(sigmas === 1 ? [4, 4] : []);
        g.beginPath();
        g.ellipse(size / 2, size / 2, at(sigmas * k.su), at(sigmas * k.sv), 0, 0, 2 * Math.PI);
        g.stroke();
      }
      g.setLineDash([]);
      // A round number for the ruler.
      const raw = reach / 3, power = 10 ** Math.floor(Math.log10(raw)), ruler = power * [1, 2, 5].filter((m) => m * power <= raw).pop();
      g.fillStyle = g.strokeStyle = css('ink');
      g.beginPath();
      g.moveTo(16, size - 20); g.lineTo(16 + at(ruler), size - 20);
      g.stroke();
      g.font = '15px system-ui, sans-serif';
      g.fillText(`${ruler} px`, 16, size - 28);
      g.fillStyle = css('soft');
      g.fillText('+u', size - 28, size / 2 - 8);
      g.fillText('+v', size / 2 + 8, size - 12);
    }
    words.append(h('thead', {}, h('tr', {}, ['', 'images', 'mean u, v, px', '3σ u', '3σ v', 'inside 98.9 %'].map((t) => h('th', {}, t)))),
      h('tbody', {}, [['all', all], ...bodies.map((b) => [b, all.filter((p) => p.body === b)])].map(([name, points]) => {
        const k = about(points);
        return h('tr', {}, [name, k.n, `${k.mu.toFixed(4)}, ${k.mv.toFixed(4)}`, (3 * k.su).toFixed(4), (3 * k.sv).toFixed(4), k.radius.toFixed(4)].map((t) => h('td', {}, String(t))));
      })));
    redraws.push(draw);
    const tools = toggles(['all', ...bodies], 0, (i) => { chosen = i === 0 ? all : all.filter((p) => p.body === bodies[i - 1]); draw(); });
    const box = section('Where the planets were found', 'Pixel of the planet minus its true pixel, every image: density, with ellipses of 1σ (dashed) and 3σ about zero. 98.9 % is what three sigma hold in two dimensions.',
      h('div', { class: 'row' }, canvas, h('div', { class: 'scroll' }, words)));
    box.querySelector('.head').append(tools);
    return box;
  }

  function scenarioSection(text) {
    return h('section', {}, h('details', {}, h('summary', {}, 'The scenario'), h('pre', {}, text)));
  }

  // ---- one mission ---------------------------------------------------------------------------------------------------
  function mission() {
    const m = data.summary;
    page.append(header(data.title, [`${m.level === 'mil' ? 'model in the loop' : m.level === 'sil' ? 'software in the loop' : m.level}`, `seed ${m.seed}`, data.span_text,
      `${m.cycles} navigation cycles`, `astronav ${m.version}`]));
    page.append(h('p', { class: 'words' }, data.words), summaryCards());
    const top = h('div', { class: 'row' });
    if (data.orbit.truth.length > 1) top.append(section('Trajectory', 'Drag to turn, wheel to zoom. The error of the estimate is drawn many times larger than it is.', orbitView(data.orbit)));
    const side = h('div', {});
    if (data.beacons.length) side.append(section('Beacons', 'Which planets were looked at, and which could have been; days along. Hover for the reason.', timeline(data.beacons, data.orbit.span)));
    side.append(figuresSection());
    top.append(side);
    page.append(top);
    page.append(h('div', { class: 'row' },
      errorSection('Position error', 'km', 1, data.errors, ['position', 'position_sigma'], m.position_error_km, 'errors'),
      errorSection('Velocity error', 'm/s', 3, data.errors, ['velocity', 'velocity_sigma'], m.velocity_error_m_s, 'errors')));
    page.append(consistencySection(data));
    if (data.images.index.length) page.append(residualSection(data.images));
    if (data.frames.length) page.append(framesSection(data.frames));
    if (data.images.planet_error[0].some((v) => v !== null)) page.append(planetErrorSection(data.images));
    if (m.level !== 'mil' && data.images.index.length) page.append(visionSection(data.images));
    if (m.attitude_filter.counts.foretold > 0) page.append(gyroSection(data.images));
    page.append(timingSection());
  }

  // ---- a campaign ----------------------------------------------------------------------------------------------------
  function manyLines(axisName, k, unit, keys) {
    const runs = data.runs.filter((r) => r.day.length);
    return chart(190, () => {
      const all = uPlot.join([...runs.map((r) => [r.day, r[keys[0]][k]]), [data.formal.day, data.formal[keys[1]][k].map((v) => 3 * v), data.formal[keys[1]][k].map((v) => -3 * v)]]);
      const n = runs.length;
      const colour = css(axisName);
      return {
        values: all,
        options: fitY({
          cursor: { sync: { key: 'campaign' }, drag: { x: true, y: false } },
          series: [{ label: 'day' }, ...runs.map((r) => line('seed ' + r.seed, colour + '88', { width: 1, spanGaps: true })),
            line('3σ', css('bound'), { width: 1.6, spanGaps: true }), line('−3σ', css('bound'), { width: 1.6, spanGaps: true })],
          bands: [{ series: [n + 1, n + 2], fill: css('band') }],
          yAxis: { label: axisName + ', ' + unit, labelSize: 16, labelFont: '11.5px system-ui, sans-serif', size: 52 },
          legend: { show: false },
        }, (from, to) => {
          let size = 0;
          for (let i = 0; i < all[0].length; i++) {
            if (all[0][i] < Math.max(from, num(data.formal.steadyDay) || 0) || all[0][i] > to) continue;
            for (let j = 1; j < all.length; j++) size = Math.max(size, Math.abs(all[j][i]) || 0);
          }
          return [-1.1 * size || -1, 1.1 * size || 1];
        }),
      };
    });
  }
  // Each sample's 3 x rms against its own bound, all axes.
  function againstFormal(key, unit) {
    const points = [];
    for (const r of data.samples) AXES.forEach((name, i) => points.push({ x: num(r[key].formal_3sigma_axis[i]), y: num(r[key].steady_3sigma_axis[i]), axis: i, seed: r.seed }));
    const good = points.filter((p) => Number.isFinite(p.x) && Number.isFinite(p.y)).sort((a, b) => a.x - b.x);
    const top = 1.08 * Math.max(...good.map((p) => p.x), 1e-9);
    const xs = [0, ...good.map((p) => p.x), top];
    const pick = (axis) => [null, ...good.map((p) => (p.axis === axis ? p.y : null)), null];
    return chart(260, () => ({
      values: [xs, pick(0), pick(1), pick(2), xs, xs.map((v) => 2.2 * v)],
      options: {
        series: [{ label: 'own bound', value: value(3, unit) }, dots('x', css('x'), 6, { value: value(3) }), dots('y', css('y'), 6, { value: value(3) }), dots('z', css('z'), 6, { value: value(3) }),
          line('equal', css('faint'), { dash: [5, 5], width: 1, value: value(3) }), line('2.2 times', css('bad'), { dash: [2, 4], width: 1, value: value(3) })],
        scales: { x: { time: false, range: () => [0, top] }, y: { range: (u, min, max) => [0, 1.1 * Math.max(...good.map((p) => p.y), top)] } },
        xAxis: { label: `3σ by the filter, ${unit}`, labelSize: 16, labelFont: '11.5px system-ui, sans-serif', size: 34 },
        yAxis: { label: `3 × rms, ${unit}`, labelSize: 16, labelFont: '11.5px system-ui, sans-serif', size: 52 },
      },
    }));
  }
  function consistencyOfSamples() {
    const seeds = data.samples.map((r) => r.seed);
    const one = (mean, band, expected) => chart(210, () => ({
      values: [seeds, data.samples.map((r) => r[mean]), data.samples.map((r) => r[band][0]), data.samples.map((r) => r[band][1]), seeds.map(() => expected)],
      options: {
        series: [{ label: 'seed', value: value(0) }, dots('mean', css('accent'), 6, { value: value(2) }), line('95 % low', css('bound'), { width: 1, value: value(2) }), line('95 % high', css('bound'), { width: 1, value: value(2) }), line('expected', css('faint'), { dash: [5, 5], width: 1, value: value(0) })],
        bands: [{ series: [3, 2], fill: css('band') }],
        scales: { y: { range: (u, min, max) => [expected === 2 ? Math.min(1.5, min * 0.97) : 0, max * 1.08] } },
      },
    }));
    return h('div', { class: 'row' }, section('NEES of each sample', 'Mean over the steady windows of a run. The band allows for windows being correlated in time.', one('nees_mean', 'nees_band_95', 6)),
      section('NIS of each sample', 'Mean over all measurements of a run.', one('nis_mean', 'nis_band_95', 2)));
  }
  function sampleTable() {
    const pictures = data.summary.level !== 'mil';
    const head = ['seed', 'position 3σ x / y / z, km', 'own bound, km', 'velocity 3σ x / y / z, m/s', 'own bound, m/s', 'NEES', 'NIS', ...(pictures ? ['attitude, %', 'planet, %'] : [])];
    const join = (a) => a.map(figure).join(' / ');
    return h('div', { class: 'scroll' }, h('table', {}, h('thead', {}, h('tr', {}, head.map((t) => h('th', {}, t)))),
      h('tbody', {}, data.samples.map((r) => h('tr', {}, [r.seed, join(r.position_error_km.steady_3sigma_axis), join(r.position_error_km.formal_3sigma_axis), join(r.velocity_error_m_s.steady_3sigma_axis),
        join(r.velocity_error_m_s.formal_3sigma_axis), figure(r.nees_mean), figure(r.nis_mean), ...(pictures ? [percent(r.vision.attitude_success_rate), percent(r.vision.planet_success_rate)] : [])].map((t) => h('td', {}, String(t))))),
        data.failed.map((f) => h('tr', {}, h('td', {}, String(f.seed)), h('td', { colspan: head.length - 1, style: 'text-align:left;color:var(--bad)' }, f.error))))));
  }
  function campaign() {
    const m = data.summary;
    page.append(header(data.title, [`campaign of ${m.runs} runs`, m.level === 'mil' ? 'model in the loop' : 'software in the loop', `seeds from ${data.first_seed}`, data.failed.length ? `${data.failed.length} failed` : null, `astronav ${m.version}`]));
    page.append(h('p', { class: 'words' }, data.words), summaryCards());
    const many = (title, unit, keys) => section(title, 'All samples when the second window of a cycle ends, inside the mean 3σ bound of their filters; days along.', AXES.map((name, k) => manyLines(name, k, unit, keys)));
    page.append(h('div', { class: 'row' }, many('Position error', 'km', ['position', 'position_sigma']), many('Velocity error', 'm/s', ['velocity', 'velocity_sigma'])));
    page.append(h('div', { class: 'row' }, section('Position against the own bound', 'One point per sample and axis.', againstFormal('position_error_km', 'km')),
      section('Velocity against the own bound', 'One point per sample and axis.', againstFormal('velocity_error_m_s', 'm/s'))));
    page.append(consistencyOfSamples());
    const histograms = AXES.map((name, k) => section(`Position error, ${name}`, 'Error over its own sigma, all steady windows; the line is what a normal law would give.',
      chart(170, () => ({ values: [data.normalised.centers, data.normalised.counts[k], data.normalised.expected],
        options: { series: [{ label: 'sigmas', value: value(1) }, { label: 'windows', stroke: css(name), fill: css(name) + '55', paths: uPlot.paths.bars({ size: [0.92, 100] }), points: { show: false }, value: value(0) },
          line('normal', css('soft'), { value: value(1), dash: [4, 4] })], scales: { y: { range: (u, min, max) => [0, max * 1.1 || 1] } }, legend: { show: false } } }))));
    page.append(h('div', { class: 'row', style: 'grid-template-columns:repeat(auto-fit,minmax(280px,1fr))' }, histograms));
    const again = `Each is one run: astronav run${m.level === 'mil' ? ' --level mil' : ''} --seed N flies it again.`;
    page.append(section('Samples', data.confidence_method ? `${again} Intervals above: ${data.confidence_method}.` : again, sampleTable()));
    page.append(timingSection());
  }

  if (data.kind === 'campaign') campaign(); else mission();
  page.append(scenarioSection(data.scenario), h('footer', {}, 'One file, no network. Errors are estimate minus truth; steady figures are read from the fourth cycle on, when the second window of a cycle ends; 3σ is 3 × rms about zero.'));
  drawAll();
  root.dataset.ready = 'yes';
})();

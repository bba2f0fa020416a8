// Draws measured and simulated curves of the held-out runs with their errors below, for one run at a time.
// Machines far from the measurements are hidden at first. All plots show the same part of the run: drag across a plot to enlarge it, double-click to see the whole run.
(() => {
  const host = document.getElementById('curves');
  const data = JSON.parse(document.getElementById('curve-data').textContent);
  if (!host || !data.runs.length) return;
  const LEFT = 58, RIGHT = 8, UPPER = [8, 178], LOWER = [196, 296], HEIGHT = 336;  // px
  const CONFIDENCE = 2.576;  // standard deviations that hold 99 % of the noise
  const decode = text => new Float32Array(Uint8Array.from(atob(text), c => c.charCodeAt(0)).buffer);
  const escaped = text => text.replace(/[&<>"]/g, c => ({'&': '&amp;', '<': '&lt;', '>': '&gt;', '"': '&quot;'})[c]);
  const hidden = new Set(data.machines.filter(m => !m.shown).map(m => m.key));
  let run, range, whole;

  const make = (tag, properties, parent) => parent.appendChild(Object.assign(document.createElement(tag), properties));
  host.textContent = '';
  const bar = make('div', {className: 'bar'}, host);
  const label = make('label', {textContent: 'Run '}, bar), choice = make('select', {}, label);
  data.runs.forEach((r, k) => make('option', {value: k, textContent: r.label + (k || data.runs.length < 2 ? '' : ' (worst)')}, choice));
  choice.onchange = () => select(data.runs[choice.value]);
  const button = (text, title, action) => Object.assign(make('button', {type: 'button', textContent: text, title}, bar), {onclick: action});
  const zoom = factor => {
    const center = (range[0] + range[1]) / 2, half = (range[1] - range[0]) / 2 * factor;
    show(center - half, center + half);
  };
  const move = part => { const step = part * (range[1] - range[0]); show(range[0] + step, range[1] + step); };
  button('Zoom in', 'Show half of the time', () => zoom(.5));
  button('Zoom out', 'Show twice the time', () => zoom(2));
  button('Earlier', 'Move to an earlier part', () => move(-.5));
  button('Later', 'Move to a later part', () => move(.5));
  button('Whole run', 'Show all of the run', () => show(...whole));
  const legend = make('div', {className: 'bar'}, host);
  for (const m of [{key: 'measured', label: 'measured', color: 'ink'}, ...data.machines]) {
    const toggle = make('button', {type: 'button', className: 'curve', title: 'Show or hide this curve'}, legend);
    make('span', {className: 'swatch'}, toggle).style.background = `var(--${m.color})`;
    toggle.append(m.label);
    toggle.setAttribute('aria-pressed', String(!hidden.has(m.key)));
    toggle.onclick = () => {
      if (!hidden.delete(m.key)) hidden.add(m.key);
      toggle.setAttribute('aria-pressed', String(!hidden.has(m.key)));
      draw();
    };
  }
  make('p', {className: 'muted', textContent: 'Drag across a plot to enlarge a part of the run; double-click to see all of it. ' +
    'The lower plot of each pair shows measured minus simulated; its band holds 99 % of the noise.'}, host);
  const plots = make('div', {className: 'figures wide'}, host);

  function select(chosen) {
    run = chosen;
    for (const c of run.channels) {
      if (c.values) continue;
      c.times = decode(c.time);
      const measured = decode(c.measured);
      c.values = {measured: measured.map(v => v * c.factor)};
      c.deviations = {};
      for (const m of data.machines) {
        const error = decode(c.errors[m.key]);
        c.values[m.key] = measured.map((v, i) => (v - error[i]) * c.factor);
        c.deviations[m.key] = error.map(v => v * c.error_factor);
      }
    }
    plots.textContent = '';
    for (const c of run.channels) {
      const figure = make('figure', {}, plots);
      c.box = make('div', {className: 'plot'}, figure);
      make('figcaption', {textContent: `${run.name}: ${c.name}`}, figure);
      listen(c.box);
    }
    whole = [0, Math.max(...run.channels.map(c => c.times[c.times.length - 1]), 1e-9)];
    range = whole;
    draw();
  }

  function show(from, to) {
    const length = Math.min(Math.max(to - from, 1e-4 * whole[1]), whole[1]);
    from = Math.min(Math.max(from, 0), whole[1] - length);
    range = [from, from + length];
    draw();
  }

  function listen(box) {
    let start = null;
    const at = event => event.clientX - box.getBoundingClientRect().left;
    const time = x => range[0] + (x - LEFT) / (box.clientWidth - LEFT - RIGHT) * (range[1] - range[0]);
    box.onpointerdown = event => { if (event.button === 0) { start = at(event); box.setPointerCapture(event.pointerId); } };
    box.onpointermove = event => {
      const mark = box.querySelector('.selection');
      if (start === null || !mark) return;
      mark.setAttribute('x', Math.min(start, at(event)));
      mark.setAttribute('width', Math.abs(at(event) - start));
    };
    box.onpointerup = event => {
      if (start === null) return;
      const [a, b] = [start, at(event)].sort((x, y) => x - y);
      start = null;
      if (b - a > 5) show(time(a), time(b)); else draw();
    };
    box.onpointercancel = () => { start = null; draw(); };
    box.ondblclick = () => show(...whole);
  }

  function ticks(low, high, count) {
    const raw = (high - low) / count, size = 10 ** Math.floor(Math.log10(raw));
    const step = size * [1, 2, 5, 10].find(k => k * size >= raw), values = [];
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) values.push(k * step);
    return values.map(v => [v, Math.abs(v) < 1e-9 * step ? '0' : String(Number(v.toPrecision(6)))]);
  }

  function extent(curves, times) {
    let low = Infinity, high = -Infinity;
    for (const curve of curves) for (let i = 0; i < curve.length; i++)
      if (times[i] >= range[0] && times[i] <= range[1] && Number.isFinite(curve[i])) {
        low = Math.min(low, curve[i]); high = Math.max(high, curve[i]);
      }
    return low > high ? null : [low, high];
  }

  function line(times, curve, x, y, color, width) {
    let path = '', open = false;
    const [first, last] = [times.findIndex(t => t >= range[0]) - 1, times.findIndex(t => t > range[1])];
    for (let i = Math.max(first, 0); i < (last < 0 ? times.length : last + 1); i++) {
      open = open && Number.isFinite(curve[i]);
      if (!Number.isFinite(curve[i])) continue;
      const height = Math.max(-1e4, Math.min(1e4, y(curve[i])));
      path += (open ? 'L' : 'M') + x(times[i]).toFixed(1) + ' ' + height.toFixed(1);
      open = true;
    }
    return path && `<path d="${path}" fill="none" stroke="var(--${color})" stroke-width="${width}" stroke-linejoin="round"/>`;
  }

  function draw() {
    run.channels.forEach((c, k) => { c.box.innerHTML = drawing(c, k); });
  }

  function drawing(c, k) {
    const width = Math.max(240, c.box.clientWidth), right = width - RIGHT;
    const x = t => LEFT + (t - range[0]) / (range[1] - range[0]) * (right - LEFT);
    const shown = data.machines.filter(m => !hidden.has(m.key));
    const all = [...(hidden.has('measured') ? [] : ['measured']), ...shown.map(m => m.key)];
    // A simulation that drifts away must not flatten the measurements: it leaves the plot instead.
    const seen = extent([c.values.measured], c.times) || [0, 1], span = (seen[1] - seen[0]) || Math.abs(seen[1]) || 1;
    const wide = extent(all.map(key => c.values[key]), c.times) || seen;
    const upper = [Math.max(wide[0], seen[0] - span), Math.min(wide[1], seen[1] + span)];
    const error = extent(shown.map(m => c.deviations[m.key]), c.times) || [-1, 1];
    const axis = ([low, high], [top, bottom], text) => {
      const margin = .06 * (high - low) || Math.abs(high) * .1 || 1;
      low -= margin; high += margin;
      const y = v => bottom - (v - low) / (high - low) * (bottom - top);
      let marks = '';
      for (const [v, name] of ticks(low, high, 4)) marks += `<line x1="${LEFT}" x2="${right}" y1="${y(v)}" y2="${y(v)}"/>` +
        `<text x="${LEFT - 6}" y="${y(v) + 4}" text-anchor="end">${name}</text>`;
      for (const [t, name] of ticks(...range, Math.max(3, Math.floor(width / 90)))) {
        marks += `<line x1="${x(t)}" x2="${x(t)}" y1="${top}" y2="${bottom}"/>`;
        if (bottom === LOWER[1] && x(t) < right - 6) marks += `<text x="${x(t)}" y="${bottom + 16}" text-anchor="middle">${name}</text>`;
      }
      const middle = (top + bottom) / 2;
      return [y, `<g class="axis">${marks}<text transform="translate(12 ${middle}) rotate(-90)" text-anchor="middle">${escaped(text)}</text></g>`];
    };
    const [y1, first] = axis(upper, UPPER, `${c.quantity}, ${c.unit}`);
    const [y2, second] = axis(error, LOWER, `error, ${c.error_unit}`);
    const clip = (name, [top, bottom]) =>
      `<clipPath id="clip-${name}${k}"><rect x="${LEFT}" y="${top}" width="${right - LEFT}" height="${bottom - top}"/></clipPath>`;
    const noise = c.noise && `<rect x="${LEFT}" width="${right - LEFT}" y="${y2(CONFIDENCE * c.noise)}" ` +
      `height="${Math.max(0, y2(-CONFIDENCE * c.noise) - y2(CONFIDENCE * c.noise))}" fill="var(--muted)" opacity=".22"/>`;
    const curves = shown.map(m => line(c.times, c.values[m.key], x, y1, m.color, 1.6)).join('');
    const errors = shown.map(m => line(c.times, c.deviations[m.key], x, y2, m.color, 1.3)).join('');
    const measured = hidden.has('measured') ? '' : line(c.times, c.values.measured, x, y1, 'ink', 1.1);
    const text = `${c.name} of ${run.name} from ${range[0].toPrecision(4)} to ${range[1].toPrecision(4)} s: ` +
      `measured and simulated values, and their difference, from ${error[0].toPrecision(3)} to ${error[1].toPrecision(3)} ${c.error_unit}`;
    return `<svg viewBox="0 0 ${width} ${HEIGHT}" width="${width}" height="${HEIGHT}" role="img" aria-label="${escaped(text)}">` +
      `<defs>${clip('a', UPPER)}${clip('b', LOWER)}</defs>${first}${second}` +
      `<g clip-path="url(#clip-a${k})">${curves}${measured}</g><g clip-path="url(#clip-b${k})">${noise || ''}${errors}</g>` +
      `<text class="axis-name" x="${(LEFT + right) / 2}" y="${HEIGHT - 6}" text-anchor="middle">time, s</text>` +
      `<rect class="selection" y="${UPPER[0]}" height="${LOWER[1] - UPPER[0]}" width="0"/></svg>`;
  }

  select(data.runs[0]);
  let last = host.clientWidth;
  new ResizeObserver(() => { if (host.clientWidth !== last) { last = host.clientWidth; draw(); } }).observe(host);
})();

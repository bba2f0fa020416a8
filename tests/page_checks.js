// Returns a list of everything that is wrong with a page; the body of a function that Chromium executes.
const faults = [], say = text => faults.push(text);
const shown = e => e.getClientRects().length > 0;
const name = e => e.tagName + ' "' + e.textContent.trim().slice(0, 40) + '"';
const root = document.documentElement;
if (root.scrollWidth > innerWidth) say('the page is ' + root.scrollWidth + ' px wide in ' + innerWidth);
if (root.lang !== 'en' || !document.title) say('no language or title');
if (document.querySelectorAll('h1').length !== 1) say('not exactly one h1');
let level = 0;
for (const h of document.querySelectorAll('h1, h2, h3, h4')) {
  const next = Number(h.tagName[1]);
  if (next > level + 1) say('heading level skipped: ' + name(h));
  level = next;
}
const ids = [...document.querySelectorAll('[id]')].map(e => e.id);
for (const id of ids) if (ids.indexOf(id) !== ids.lastIndexOf(id)) say('id twice: ' + id);
for (const a of document.querySelectorAll('a')) if (!document.querySelector(a.getAttribute('href'))) say('dead link ' + name(a));
for (const g of document.querySelectorAll('svg, img')) {
  const text = g.getAttribute('aria-label') || g.getAttribute('alt') || '';
  if (text.length < 30 || (g.tagName === 'svg' && g.getAttribute('role') !== 'img')) say('no alternative text: ' + text);
  for (const t of g.querySelectorAll('text'))
    if (shown(t) && t.textContent && Math.min(t.getBoundingClientRect().height, t.getBoundingClientRect().width * 4) < 6)
      say('small text in a plot: ' + t.textContent);
}
for (const use of document.querySelectorAll('use'))
  if (!document.querySelector(use.getAttribute('href'))) say('missing marker ' + use.getAttribute('href'));
for (const e of document.querySelectorAll('main *')) {
  const style = getComputedStyle(e);
  if (e.scrollWidth > e.clientWidth + 1 && style.overflowX === 'auto' && e.tabIndex !== 0) say('scrolls without keyboard: ' + name(e));
}
const rgb = text => (text.match(/[\d.]+/g) || []).map(Number);
const light = c => { const [r, g, b] = c.slice(0, 3).map(v => (v /= 255) <= .04045 ? v / 12.92 : ((v + .055) / 1.055) ** 2.4);
  return .2126 * r + .7152 * g + .0722 * b; };
const background = e => { for (; e; e = e.parentElement) { const c = rgb(getComputedStyle(e).backgroundColor);
  if (c.length === 3 || c[3] > 0) return c; } return [255, 255, 255]; };
for (const e of document.querySelectorAll('body *')) {
  const own = [...e.childNodes].some(n => n.nodeType === 3 && n.textContent.trim());
  if (!own || !shown(e) || e.closest('style, defs')) continue;
  const style = getComputedStyle(e), ink = rgb(e.closest('svg') ? style.fill : style.color);
  const [a, b] = [light(ink), light(background(e))].sort((x, y) => y - x), ratio = (a + .05) / (b + .05);
  if (ratio < 4.5) say('contrast ' + ratio.toFixed(2) + ': ' + name(e));
}
return faults;

// The map of a page of found leaders: a slider in the times of the file, and what is known of the id that was chosen.
// `data` is what `usnet_env.tracks.page.collect_data` returns.
"use strict";
const find = (name) => document.getElementById(name);
const map = find("map"), lagChart = find("lags"), chanceChart = find("chances"), slider = find("slider");
const chooser = find("chooser"), playButton = find("play"), follow = find("follow");
const GREY = "#8a8a8a", TRAIL = 40, NEAR = 14, TICK = 60; // instants of a trail; pixels; milliseconds between instants
const count = data.ids.length, shownLeaders = new Set(data.windows.flatMap((window) => window.leaders));
let instant = 0, chosen = data.first, pointed = -1, timer = 0;

const text = () => getComputedStyle(map).color;
const windowAt = (moment) => data.windows[data.window_of[moment]] || { leaders: [], followers: [], links: [], start: "", end: "" };
const seenAt = (i, moment) => data.points[i][2 * moment] >= 0;

/** A canvas at the pixels of the screen: its context, its width and its height. */
function prepare(canvas) {
  const { width, height } = canvas.getBoundingClientRect(), ratio = window.devicePixelRatio || 1;
  [canvas.width, canvas.height] = [width * ratio, height * ratio];
  const context = canvas.getContext("2d");
  context.scale(ratio, ratio);
  context.font = "12px system-ui, sans-serif";
  context.fillStyle = context.strokeStyle = text();
  return [context, width, height];
}

/** Pixels in a point of the map: of all of it, or of a part that holds all ids at any instant. */
function zoom(width, height) {
  const [across, up] = follow.checked ? data.spread : data.size;
  return Math.min((width - 40) / across, (height - 40) / up);
}

/** Where an id is on the map, in pixels; the middle is that of the map, or of the ids at the present instant. */
function place(i, moment, width, height) {
  const scale = zoom(width, height), middle = follow.checked ? data.middles[instant] : data.size.map((side) => side / 2);
  const [x, y] = [data.points[i][2 * moment], data.points[i][2 * moment + 1]];
  return [width / 2 + (x - middle[0]) * scale, height / 2 - (y - middle[1]) * scale];
}

function drawMap() {
  const [context, width, height] = prepare(map), now = windowAt(instant);
  const head = new Map(now.links.map((link) => [link.follower, link.head]));
  now.leaders.forEach((i) => head.set(i, i));
  const colorOf = (i) => data.colors[head.get(i)] || GREY;
  for (let i = 0; i < count; i++) {
    context.strokeStyle = colorOf(i);
    context.globalAlpha = 0.35;
    context.beginPath();
    for (let t = Math.max(0, instant - TRAIL); t <= instant; t++) {
      if (!seenAt(i, t)) continue;
      const [x, y] = place(i, t, width, height);
      t > 0 && seenAt(i, t - 1) ? context.lineTo(x, y) : context.moveTo(x, y);
    }
    context.stroke();
  }
  context.globalAlpha = 0.6;
  for (const link of now.links) {
    if (!seenAt(link.follower, instant) || !seenAt(link.leader, instant)) continue;
    context.strokeStyle = colorOf(link.follower);
    context.setLineDash(link.direct ? [] : [4, 4]);
    context.beginPath();
    context.moveTo(...place(link.follower, instant, width, height));
    context.lineTo(...place(link.leader, instant, width, height));
    context.stroke();
  }
  context.setLineDash([]);
  context.globalAlpha = 1;
  for (let i = 0; i < count; i++) {
    if (!seenAt(i, instant)) continue;
    const [x, y] = place(i, instant, width, height), leads = now.leaders.includes(i);
    context.fillStyle = colorOf(i);
    context.beginPath();
    context.arc(x, y, leads ? 7 : 4, 0, 7);
    context.fill();
    context.strokeStyle = context.fillStyle = text();
    context.lineWidth = i === chosen ? 3 : 1;
    if (leads || i === chosen) context.stroke();
    context.lineWidth = 1;
    if (leads || i === pointed || i === chosen) context.fillText(data.ids[i], x + 9, y - 7);
  }
  drawScale(context, width, height);
  find("time").textContent = data.times[instant];
  slider.value = instant;
  slider.setAttribute("aria-valuetext", data.times[instant]);
}

/** A bar of 1, 2 or 5 times a power of ten, about a fifth of the map. */
function drawScale(context, width, height) {
  const perUnit = zoom(width, height) * data.unit, rough = width / 5 / perUnit;
  const power = 10 ** Math.floor(Math.log10(rough)), length = power * [5, 2, 1].find((k) => k * power <= rough);
  context.fillStyle = text();
  context.fillRect(12, height - 10, length * perUnit, 2);
  context.fillText(`${length} ${data.length_unit}`, 12, height - 15);
}

/** Draw lines `{color, values, label}` over `x`, both axes with their ends named. */
function drawLines(canvas, x, lines, low, high, xLabels, marks) {
  const [context, width, height] = prepare(canvas), [left, right, top, bottom] = [34, 10, 8, 22];
  const across = (value) => left + ((value - x[0]) / (x[x.length - 1] - x[0] || 1)) * (width - left - right);
  const up = (value) => top + ((high - value) / (high - low)) * (height - top - bottom);
  context.strokeStyle = GREY;
  context.strokeRect(left, top, width - left - right, height - top - bottom);
  [low, high].forEach((value) => context.fillText(value, 4, up(value) + (value === high ? 10 : 0)));
  context.fillText(xLabels[0], left, height - 6);
  context.textAlign = "right";
  context.fillText(xLabels[1], width - right, height - 6);
  context.textAlign = "left";
  for (const { vertical, value, dash } of marks) {
    context.setLineDash(dash || []);
    context.beginPath();
    vertical ? context.moveTo(across(value), top) : context.moveTo(left, up(value));
    vertical ? context.lineTo(across(value), height - bottom) : context.lineTo(width - right, up(value));
    context.stroke();
  }
  context.setLineDash([]);
  for (const { color, values, wide } of lines) {
    context.strokeStyle = color;
    context.lineWidth = wide ? 2.5 : 1;
    context.beginPath();
    values.forEach((value, k) => {
      if (value === null) return;
      k > 0 && values[k - 1] !== null ? context.lineTo(across(x[k]), up(value)) : context.moveTo(across(x[k]), up(value));
      if (k === 0 || values[k - 1] === null) context.lineTo(across(x[k]) + 1, up(value));
    });
    context.stroke();
  }
  context.lineWidth = 1;
}

/** Seconds in a unit that reads well, as choose_unit does in Python. */
function writeTime(seconds) {
  const units = [["days", 86400, 2], ["h", 3600, 2], ["min", 60, 10]];
  const [unit, size] = units.find(([, size, least]) => Math.abs(seconds) >= least * size) || ["s", 1];
  return `${size === 1 ? seconds : Number((seconds / size).toPrecision(3))} ${unit}`;
}

/** How the velocity of a follower, or of all followers of a leader, repeats that of the leader. */
function drawLags() {
  const link = windowAt(instant).links.find((each) => each.follower === chosen);
  const all = [link && link.head, chosen, ...Object.keys(data.curves).map(Number)];
  const leader = all.find((i) => data.curves[i] && (i === chosen || chosen in data.curves[i].of));
  find("lag-part").hidden = leader === undefined;
  if (leader === undefined) return;
  const { lags, chance, of } = data.curves[leader];
  const lines = Object.entries(of).map(([i, values]) => ({
    color: [Number(i), leader].includes(chosen) ? data.colors[leader] : GREY, values, wide: Number(i) === chosen,
  }));
  const marks = [{ vertical: true, value: 0 }, { value: chance, dash: [4, 4] }];
  const ends = [lags[0], lags[lags.length - 1]].map(writeTime);
  drawLines(lagChart, lags, lines.sort((a, b) => a.wide - b.wide), -1, 1, ends, marks);
  find("lag-title").textContent =
    `Correlation with the velocity of ${data.ids[leader]}, by the time after it (dashed: at most by chance)`;
}

/** The probability to lead of the chosen id in each window, and dotted that of no leader. */
function drawChances() {
  find("chance-part").hidden = !data.chances;
  if (!data.chances) return;
  const x = data.windows.map((_, k) => k), color = data.colors[chosen] || text();
  const lines = [{ color: GREY, values: data.no_leader }, { color, values: data.chances[chosen], wide: true }];
  const ends = [data.windows[0].start, data.windows[x.length - 1].end];
  const mark = { vertical: true, value: data.window_of[instant] };
  drawLines(chanceChart, x, lines, 0, 1, ends, [mark]);
  find("chance-title").textContent =
    `Probability that ${data.ids[chosen]} leads, in each window (grey: that no id leads)`;
}

/** A sentence on the chosen id in the present window. */
function describe() {
  const now = windowAt(instant), name = data.ids[chosen], during = `from ${now.start} to ${now.end}`;
  const link = now.links.find((each) => each.follower === chosen);
  const behind = now.followers[now.leaders.indexOf(chosen)];
  if (behind !== undefined) return `${name} leads ${behind} id${behind === 1 ? "" : "s"} ${during}.`;
  if (!link) return now.end === "" ? `${name}: this time is in no window.` : `${name} follows no leader ${during}.`;
  const late = link.delay === null ? "" : ` ${writeTime(link.delay)} later`;
  const range = link.low === null || link.delay === null ? "" : ` (95 %: ${writeTime(link.low)} to ${writeTime(link.high)})`;
  return `${name} follows ${data.ids[link.leader]}${link.direct ? "" : ", directly or not,"}${late}${range} ${during}.`;
}

function drawAll() {
  drawMap();
  drawLags();
  drawChances();
  find("about").textContent = describe();
  chooser.value = chosen;
}

function choose(i) {
  chosen = i;
  drawAll();
}

/** The id nearest to the pointer on the map, or -1. */
function nearest(event) {
  const { left, top, width, height } = map.getBoundingClientRect();
  let best = -1, least = NEAR;
  for (let i = 0; i < count; i++) {
    if (!seenAt(i, instant)) continue;
    const [x, y] = place(i, instant, width, height);
    const away = Math.hypot(event.clientX - left - x, event.clientY - top - y);
    if (away < least) [best, least] = [i, away];
  }
  return best;
}

function show(moment) {
  instant = Math.max(0, Math.min(data.times.length - 1, moment));
  drawAll();
}

function play() {
  clearInterval(timer);
  const starts = timer === 0;
  timer = starts ? setInterval(() => (instant + 1 < data.times.length ? show(instant + 1) : play()), TICK) : 0;
  if (starts && instant + 1 >= data.times.length) show(0);
  playButton.textContent = starts ? "Stop" : "Play";
}

data.ids.forEach((name, i) => chooser.add(new Option(shownLeaders.has(i) ? `${name} (leads)` : name, i)));
if (count < data.all) find("some").textContent = `The map shows ${count} of ${data.all} ids, leaders and followers first.`;
slider.max = data.times.length - 1;
slider.oninput = () => show(Number(slider.value));
chooser.onchange = () => choose(Number(chooser.value));
playButton.onclick = play;
follow.checked = 3 * Math.max(...data.spread) < Math.max(...data.size);
follow.onchange = drawAll;
map.onmousemove = (event) => {
  pointed = nearest(event);
  map.style.cursor = pointed < 0 ? "default" : "pointer";
  drawMap();
};
map.onclick = (event) => nearest(event) < 0 || choose(nearest(event));
chanceChart.onclick = (event) => {
  const { left, width } = chanceChart.getBoundingClientRect();
  const last = data.windows.length - 1, share = (event.clientX - left - 34) / (width - 44);
  const wanted = Math.max(0, Math.min(last, Math.round(share * last)));
  if (data.window_of.includes(wanted)) show(data.window_of.indexOf(wanted));
};
window.addEventListener("resize", drawAll);
show(Math.max(data.begin, data.times.findIndex((_, t) => data.ids.every((_, i) => seenAt(i, t)))));

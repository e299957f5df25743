/* Fills the page from its document. Every text of the document becomes a text node or an attribute
   that only names something; none becomes markup, a style, an address or a script. */
(() => {
"use strict";

const data = JSON.parse(document.getElementById("data").textContent);
const { stats, bins } = data;
const FEW_BINS = 24;
const MOST_BARS = 100;
const SHOWN_SERIES = 8;
/* A phone has room for less at once, and most sections are folded there. */
const narrow = matchMedia("(max-width: 640px)");
const PAGE_ROWS = narrow.matches ? 25 : 100;
const FEW_ROWS = narrow.matches ? 5 : 12;
const FEW_FINDINGS = 6;
const MOST_FINDINGS = narrow.matches ? 8 : 30;
const MOST_TROUBLES = narrow.matches ? 3 : 5;
const UNFOLDED = ["findings", "against"];
const PRINTED_ROWS = 60;
const PRINTED_TRANSACTIONS = 40;
const MANY_COLUMNS = 3;
const MANY_SAMPLES = 150;
const VALUE_COLUMNS = 120;
const OPEN_CYCLES = 6;
const CHARTS_AT_ONCE = 12;
const LONGEST = 5;
const TICK_SPACE = 80;
const FONT = "12px system-ui, sans-serif";
const LOWER = 0.65;
const LANE_NAME = 140;
const DASHES = [[], [6, 4], [2, 3]];

/* ---- texts ---- */

/* A number and its unit stay in one line. */
const together = (text) => text.replace(/(\d) (?=%|(?:us|ms|s|min|h|d)\b)/g, "$1\u00a0");
/* Characters that show nothing, or turn the direction of a line, could hide what a text says. */
const clean = (text) => String(text ?? "").replace(/[\p{Cc}\p{Cf}\p{Cs}\p{Co}\p{Cn}]/gu, "?");
const count = (n) => (n ?? 0).toLocaleString("en");
const some = (n) => (n ? count(n) : "");
const plural = (n, noun) => `${count(n)} ${noun}${n === 1 ? "" : "s"}`;
const digits = (n) => (n === null || n === undefined ? "–"
  : n > 0 && n < 0.005 ? "<0.01" : n !== 0 && Math.abs(n) < 0.995 ? n.toFixed(2) : Math.abs(n) < 99.95 ? n.toFixed(1) : n.toFixed(0));
const share = (s) => (s === null || s === undefined ? "–"
  : s > 0 && s < 0.001 ? "<0.1 %" : `${(s * 100).toFixed(s < 0.1 ? 1 : 0)} %`);
const seconds = (s) => (s === null || s === undefined ? "–"
  : s < 10 ? s.toFixed(3) : s < 1000 ? s.toFixed(2) : s.toFixed(0));
const number = (v) => (Number.isInteger(v) ? String(v) : String(Number(v.toPrecision(7))));
const hex = (code) => code.toString(16).toUpperCase().padStart(2, "0");
const iso = (us) => {
  const moment = new Date(us / 1000);
  return Number.isNaN(moment.getTime()) ? `${us} us` : moment.toISOString();
};
const clock = (us) => iso(us).slice(11, 23);
const day = (us) => iso(us).slice(0, 10);
/* Before 1980 no capture was made: such times are those of a clock that counts from 0. */
const hasDate = (us) => us < 0 || us >= 315532800e6;
const moment = (us) => (hasDate(us) ? `${day(us)} ${clock(us)}` : clock(us));
const two = (whole, unit, rest, next) => `${whole} ${unit}${rest ? ` ${rest} ${next}` : ""}`;
const span = (s) => {
  if (s < 1) return `${digits(s * 1000)} ms`;
  if (s < 59.95) return `${digits(s)} s`;
  const whole = Math.round(s);
  return whole < 3600 ? two(Math.floor(whole / 60), "min", whole % 60, "s")
    : whole < 86400 ? two(Math.floor(whole / 3600), "h", Math.floor((whole % 3600) / 60), "min")
    : two(Math.floor(whole / 86400), "d", Math.floor((whole % 86400) / 3600), "h");
};
const milli = (ms) => (ms < 10000 ? `${digits(ms)} ms` : span(ms / 1000));
const baseName = (path) => path.split(/[\\/]/).pop() || path;
const several = stats.links.length > 1;
const isTimed = stats.links.some((link) => link.has_times);
const unitsSeen = () => new Set(stats.links.flatMap((link) => link.functions.filter((one) => one.unit !== null).map((one) => `${link.link} ${one.unit}`))).size;
const unitName = (link, unit) => `${unit === null ? "other units" : `unit ${unit}`}${several ? ` at ${link || "other links"}` : ""}`;

/* ---- elements ---- */

const get = (id) => document.getElementById(id);
/* The names of attributes and of tags are written in this file; only texts come from the data. */
function el(tag, attributes, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes || {})) {
    if (name === "on") for (const [event, act] of Object.entries(value)) made.addEventListener(event, act);
    else if (value !== undefined && value !== null && value !== false) made.setAttribute(name, value === true ? "" : clean(value));
  }
  for (const child of children.flat()) {
    if (child !== null && child !== undefined) made.append(child instanceof Node ? child : clean(child));
  }
  return made;
}
const foldOf = (id) => get(id).querySelector("details");
/* `hint` says what a folded section holds. */
function show(id, hint, ...children) {
  const fold = foldOf(id);
  fold.append(...children.flat().filter(Boolean));
  fold.querySelector(".hint").textContent = clean(hint);
  fold.open = !narrow.matches || UNFOLDED.includes(id);
  fold.addEventListener("toggle", () => { if (fold.open) drawMissing(); });
  get(id).hidden = false;
}
function unfold(id) {
  foldOf(id).open = true;
}
const soft = (text) => el("p", { class: "soft" }, text);

/* The heads of a table: one that begins with ">" is of numbers, "+" of long texts, "~" of names. A
   phone shows no head beside the cells of "#" (numbers), "=" (long texts) and "." */
const KINDS = { ">": "right", "+": "wide", "~": "name", "#": "right bare", "=": "wide bare", ".": "bare" };
const kindOf = (head) => KINDS[head[0]] ?? null;
const nameOf = (head) => head.replace(/^[>+~#=.]/, "");
/* On a phone, a table of `cards` shows the cells of a row behind each other, with their heads. Then
   the browser no longer knows that it is a table, unless the roles say so. */
function frame(caption, heads, body, cards, isNamed = true) {
  const role = (name) => (cards ? name : null);
  return el("div", { class: "scroll", role: "region", tabindex: "0", "aria-label": caption },
    el("table", { class: cards ? "cards" : null, role: role("table") }, isNamed ? el("caption", {}, caption) : null,
      el("thead", { role: role("rowgroup") }, el("tr", { role: role("row") }, heads.map((head) => el("th", { scope: "col", role: role("columnheader"), class: kindOf(head) }, nameOf(head))))), body));
}
/* A reference such as HR400001..400004 may be broken behind its dots. */
const breakable = (cell) => (typeof cell !== "string" || !cell.includes("..") ? cell
  : cell.split("..").flatMap((part, at, all) => (at < all.length - 1 ? [`${part}..`, el("wbr")] : [part])));
function tableRow(heads, cells, cards, attributes) {
  return el("tr", { role: cards ? "row" : null, ...attributes }, cells.map((cell, at) => el("td", { class: kindOf(heads[at]), role: cards ? "cell" : null, "data-label": cards ? nameOf(heads[at]) : null }, breakable(cell))));
}
/* Rows behind the first ones are folded, except those that `isKept` names by their place. */
function table(caption, allHeads, allRows, isNamed = true, printed = PRINTED_ROWS, isKept = () => false) {
  const filled = allHeads.map((_, at) => allRows.some((cells) => cells[at] !== "" && cells[at] !== "–" && cells[at] !== null));
  const heads = allHeads.filter((_, at) => filled[at]), rows = allRows.map((cells) => cells.filter((_, at) => filled[at]));
  const cards = heads.length > MANY_COLUMNS;
  const isFolded = (_, at) => at >= FEW_ROWS && !isKept(at), most = Math.max(FEW_ROWS, printed), isLeftOut = (_, at) => at >= most && !isKept(at);
  const row = (cells, at) => (isLeftOut(cells, at) ? null : tableRow(heads, cells, cards, isFolded(cells, at) ? { class: "on-paper" } : {}));
  const body = el("tbody", { role: cards ? "rowgroup" : null }, rows.map(row));
  const region = frame(caption, heads, body, cards, isNamed);
  const hidden = rows.filter(isFolded).length;
  if (hidden <= 0) return region;
  const more = el("button", { type: "button", on: { click: () => {
    body.replaceChildren(...rows.map((cells) => tableRow(heads, cells, cards, {})));
    tools.remove();
  } } }, `Show ${count(hidden)} more`);
  const tools = el("div", { class: "tools" }, more);
  const unprinted = rows.filter(isLeftOut).length;
  return el("div", {}, region, tools, unprinted > 0 ? el("p", { class: "soft printed" }, `${plural(unprinted, "row")} more on the screen.`) : null);
}

/* ---- charts ---- */

const charts = [];
const color = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const palette = (at) => color(`--c${(at % 8) + 1}`);
const utc = (s) => uPlot.tzDate(new Date(s * 1000), "Etc/UTC");
const axisTimes = (u, splits) => splits.map((s) => {
  const text = iso(s * 1e6), step = splits.length > 1 ? splits[1] - splits[0] : 1;
  return step >= 86400 ? text.slice(5, 10) : step >= 60 ? text.slice(11, 16)
    : step >= 1 ? text.slice(11, 19) : text.slice(14, 23);
});
/* Two ticks at least: where round times give fewer, they are at a tenth of the step. */
const STEPS = [0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 21600, 43200, 86400];
function timeSplits(u, axis, low, high) {
  const least = ((high - low) * TICK_SPACE) / Math.max(u.bbox.width / devicePixelRatio, 1);
  const step = STEPS.find((one) => one >= least) ?? Math.ceil(least / 86400) * 86400;
  const from = (by) => Math.ceil(low / by - 1e-6) * by;
  const begin = from(step) + step > high ? from(step / 10) : from(step);
  return Array.from({ length: Math.floor((high - begin) / step + 1e-6) + 1 }, (_, at) => begin + at * step);
}
const atTime = (s) => `${moment(s * 1e6)} UTC`;
const BINNED = `in bins of ${span(bins.width)}, UTC`;
const COUNT_STEPS = Array.from({ length: 12 }, (_, at) => [1, 2, 5].map((digit) => digit * 10 ** at)).flat();
const counted = { incrs: COUNT_STEPS };
const reachOf = (values, text) => { const [low, high] = [Math.min(...values), Math.max(...values)].map(text); return low === high ? `all ${low}` : `${low} to ${high}`; };
const inUnit = (unit) => ({ values: (u, splits) => splits.map((v) => `${v.toLocaleString("en", { maximumSignificantDigits: 6 })}${unit}`) });

/* All charts over time have the same time axis, until the reader zooms. */
const WHOLE_TIME = [bins.begin, bins.begin + bins.count * bins.width];
const timeRange = (x) => (u, low, high) => (low === null || (low <= x[0] && high >= x[x.length - 1]) ? WHOLE_TIME : [low, high]);
/* A step of a bin reaches to the begin of the next one, so the last bin needs its end. */
const withEnd = ([x, ...columns]) => [[...x, x[x.length - 1] + bins.width], ...columns.map((column) => [...column, column[column.length - 1]])];
const inMiddle = ([x, ...columns]) => [x.map((begin) => begin + bins.width / 2), ...columns];
/* Between few samples a line would show what nobody measured: counts are bars then, means points.
   Those of several series stand side by side in their bin, so that none hides another. */
const areFew = (series) => bins.count <= FEW_BINS && bins.count * Math.min(series, SHOWN_SERIES) <= MOST_BARS;
const isSparse = (column) => column.filter((one) => one !== null).length < column.length / 2;
const sideBySide = (width, place, of) => width * 0.8 * (place / of - 0.5);
const barPaths = (width, place, of) => (u, series, from, to) => {
  const path = new Path2D(), [x, y] = [u.data[0], u.data[series]], zero = u.valToPos(0, "y", true);
  for (let at = from; at <= to; at++) {
    if (!y[at]) continue;
    const [left, right] = [place, place + 1].map((edge) => u.valToPos(x[at] + sideBySide(width, edge, of), "x", true));
    const top = u.valToPos(y[at], "y", true);
    path.rect(left, top, Math.max(right - left, 1), zero - top);
  }
  return { stroke: path, fill: path };
};
const dotPaths = (width, place, of) => (u, series, from, to) => {
  const path = new Path2D(), [x, y] = [u.data[0], u.data[series]], radius = 3 * devicePixelRatio;
  for (let at = from; at <= to; at++) {
    if (y[at] === null || y[at] === undefined) continue;
    const left = u.valToPos(x[at] + sideBySide(width, place + 0.5, of), "x", true), top = u.valToPos(y[at], "y", true);
    path.moveTo(left + radius, top);
    path.arc(left, top, radius, 0, 2 * Math.PI);
  }
  return { stroke: path, fill: path };
};
/* How a chart with a value for each bin is drawn: its data, and what its series add. `kind` is
   "counts" or "means"; `shown` says which series are. */
function drawnBins(kind, columns, shown) {
  const seen = shown.map((is, at) => (is ? at : -1)).filter((at) => at >= 0);
  if (!areFew(columns.length - 1)) return kind === "counts" ? [withEnd(columns), () => ({ paths: stepped })] : [inMiddle(columns), (at) => (isSparse(columns[at + 1]) ? { paths: dotPaths(bins.width, 0, 1), fill: "ff" } : { spanGaps: true })];
  const [make, fill] = kind === "counts" ? [barPaths, "99"] : [dotPaths, "ff"];
  return [inMiddle(columns), (at) => ({ paths: make(bins.width, Math.max(seen.indexOf(at), 0), Math.max(seen.length, 1)), fill })];
}
/* One chart: `make` gives uPlot's series and data, and is asked again when the colours change. */
function chart(spec) {
  const plot = el("div", { class: "plot" });
  const readout = el("output", { class: "readout", "aria-live": "polite" }, "");
  const legend = el("ul", { class: "legend" });
  const figure = el("figure", { tabindex: "0", "aria-label": `Chart: ${spec.title}. ${spec.summary || ""} Left and right arrow keys read the values.` },
    el("figcaption", {}, el("b", {}, spec.title), spec.note ? ` ${together(clean(spec.note))}` : ""), spec.controls || null, plot, legend, readout);
  const shown = spec.series.map((one) => one.show !== false);
  const isHeld = (spec.bins === "counts" && !areFew(spec.series.length)) || spec.held;
  const mine = { plot: null, host: plot, build, figure };
  /* A step holds until the next one begins; of other charts the nearest value is read. */
  const pointed = (u) => {
    const { idx, left } = u.cursor;
    return isHeld && idx > 0 && u.data[0][idx] > u.posToVal(left, "x") ? idx - 1 : idx;
  };
  const read = (at) => {
    if (at === null || at === undefined || at > spec.data[0].length) return "";
    if (at === spec.data[0].length) return read(at - 1);
    const parts = spec.series.map((one, place) => [one, spec.data[place + 1][at], place])
      .filter(([, value, place]) => shown[place] && value !== null && value !== undefined)
      .map(([one, value]) => `${one.label}: ${one.text ? one.text(value) : number(value)}${spec.measure ? ` ${spec.measure}` : ""}`);
    return `${spec.at ? spec.at(spec.data[0][at]) : atTime(spec.data[0][at])} — ${parts.join(", ") || "nothing"}`;
  };
  function build(width, isPaper) {
    if (mine.plot) mine.plot.destroy();
    const ink = color("--soft"), rule = { stroke: color("--grid"), width: 1 };
    const axis = { stroke: ink, grid: rule, ticks: rule, font: FONT };
    const [drawn, extra] = spec.bins ? drawnBins(spec.bins, spec.data, shown) : [spec.data, () => ({})];
    mine.plot = new uPlot({
      width: Math.max(width || plot.clientWidth, 200), height: Math.round((spec.height || 200) * (isPaper && !spec.isWhole ? LOWER : 1)), tzDate: utc,
      padding: [8, 34, 0, 0], legend: { show: false },
      cursor: { sync: spec.sync ? { key: spec.sync } : undefined, drag: { x: true, y: false }, points: { size: 6 } },
      scales: { x: { time: !spec.at, range: spec.at ? undefined : timeRange(drawn[0]), ...(spec.scaleX || {}) }, y: spec.scaleY || { range: (u, low, high) => [Math.min(0, low ?? 0), (high ?? 0) > 0 ? high * 1.08 : 1] } },
      axes: [{ ...axis, space: 80, values: spec.at ? spec.axisX : axisTimes, splits: spec.at ? undefined : timeSplits, size: 30, ...(spec.axis0 || {}) }, { ...axis, size: (u, texts) => Math.max(64, texts ? laneRoom(texts.filter(Boolean)) : 0), space: 20, ...(spec.axisY || {}) }],
      series: [{}, ...spec.series.map((one, place) => {
        const stroke = palette(one.color ?? place), added = extra(place), fill = added.fill ?? one.fill;
        const samples = spec.data[place + 1].filter((v) => v !== null && v !== undefined).length;
        return {
          label: clean(one.label), stroke, width: one.width ?? 1.5, show: shown[place], dash: DASHES[Math.floor((one.color ?? place) / 8) % 3],
          paths: one.paths, fillTo: one.fillTo, spanGaps: false,
          points: { show: spec.dots !== false && !spec.bins && samples < 40, size: 5, filter: (u, at, isShown) => (isShown ? [...Array(one.measured ?? samples).keys()] : null) },
          ...added, fill: fill ? `${stroke}${fill === true ? "33" : fill}` : undefined,
        };
      })],
      bands: spec.bands ? [{ series: [2, 1], fill: `${palette(0)}44` }] : undefined,
      hooks: { setCursor: [(u) => { const text = read(pointed(u)); if (readout.textContent !== text) readout.textContent = clean(text); }] },
    }, drawn, plot);
    legend.replaceChildren(...(spec.series.length > 1 && spec.legend !== false ? spec.series.map((one, place) => {
      const swatch = el("span", { class: `swatch${["", " dashed", " dotted"][Math.floor((one.color ?? place) / 8) % 3]}`, "aria-hidden": "true" });
      swatch.style.color = palette(one.color ?? place);
      return el("li", {}, el("button", { type: "button", "aria-pressed": String(shown[place]), on: { click: (event) => {
        shown[place] = !shown[place];
        event.currentTarget.setAttribute("aria-pressed", String(shown[place]));
        if (spec.bins) mine.build(); else mine.plot.setSeries(place + 1, { show: shown[place] });
      } } }, swatch, one.label));
    }) : []));
  }
  figure.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: -1, ArrowRight: 1, PageUp: -10, PageDown: 10 }[event.key];
    if (!step || event.target !== figure || !mine.plot) return;
    event.preventDefault();
    const last = spec.data[0].length - 1;
    const at = Math.min(Math.max((mine.plot.cursor.idx ?? -1) + step, 0), last);
    mine.plot.setCursor({ left: mine.plot.valToPos(mine.plot.data[0][at], "x") + 1, top: 10 });
    readout.textContent = clean(read(at));
  });
  if (spec.asTable !== false) figure.append(asTable(spec));
  charts.push(mine);
  drawLater(mine);
  return figure;
}
/* The figures of a chart as a table, made when it is opened; of many points, the sums of some. */
function asTable(spec) {
  const details = el("details", { class: "data" }, el("summary", {}, "Figures as a table"));
  details.addEventListener("toggle", () => {
    if (!details.open || details.childElementCount > 1) return;
    const rows = spec.data[0].map((x, at) => [spec.at ? spec.at(x) : moment(x * 1e6),
      ...spec.series.map((one, place) => { const v = spec.data[place + 1][at]; return v === null || v === undefined ? "" : one.text ? one.text(v) : number(v); })])
      .filter((row) => row.slice(1).some((cell) => cell !== "" && (spec.held || cell !== "0")));
    details.append(table(spec.caption ?? spec.title, [spec.head || "time (UTC)", ...spec.series.map((one) => `>${one.label}`)], rows, true, 0));
  }, { passive: true });
  return details;
}
/* Charts are drawn one after another, so that the page answers meanwhile. */
const waiting = [];
function drawLater(one) {
  waiting.push(one);
  if (waiting.length === 1) setTimeout(drawNext);
}
function drawNext() {
  const one = waiting[0];
  if (isSeen(one) && !one.plot) one.build();
  waiting.shift();
  if (waiting.length) setTimeout(drawNext);
}
/* A chart in a folded section is drawn when the section is opened. */
const isSeen = (one) => one.host.isConnected && !one.host.closest("details:not([open])");
function drawMissing() {
  for (const one of charts) if (isSeen(one) && !(one.plot && one.plot.root.clientWidth <= one.host.clientWidth)) one.build();
}
function redraw(width) {
  for (const one of charts) if (isSeen(one)) one.build(width ? width(one) : undefined, width !== undefined);
}
let lastWidth = innerWidth;
addEventListener("resize", () => { if (innerWidth !== lastWidth) { lastWidth = innerWidth; redraw(); } });
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => redraw());
/* On paper every section is open, and every chart is drawn in the width of the paper, once before the
   pages are counted, and again when the style sheet has the colours of paper. */
const folded = [];
function toPaper() {
  folded.push(...document.querySelectorAll("section > details:not([open])"));
  for (const fold of folded) fold.open = true;
  rowsToPaper();
  redraw((one) => (one.figure.closest(".grid, .pair") ? 330 : 690));
}
function toScreen() {
  for (const fold of folded.splice(0)) fold.open = false;
  draw();
  redraw();
}
addEventListener("beforeprint", toPaper);
addEventListener("afterprint", toScreen);
matchMedia("print").addEventListener("change", (event) => (event.matches ? toPaper() : toScreen()));

const times = Array.from({ length: bins.count }, (_, at) => bins.begin + at * bins.width);
const stepped = uPlot.paths.stepped({ align: 1 });
/* Of so few bins a chart would be a dot; the tables have the same figures. */
const hasTimeline = bins.count > 2;
const added = (columns) => times.map((_, at) => columns.reduce((sum, one) => sum + one[at], 0));
const total = (column) => column.reduce((sum, one) => sum + one, 0);

/* ---- sections ---- */

function verdict() {
  const { level, sentence, troubles } = data.verdict;
  get("verdict").classList.add(level);
  get("sentence").textContent = together(clean(sentence));
  const names = stats.sources.map(baseName), shownNames = names.length > 4 ? `${names.slice(0, 3).join(", ")} and ${count(names.length - 3)} more files` : names.join(", ");
  const { title, note, where } = data.words;
  document.title = clean(title || `mbtool report: ${shownNames}`);
  get("what").append(title ? el("strong", {}, `${title} · `) : "", clean(shownNames), where ? clean(` · only ${where}`) : "");
  if (note) get("figures").before(...note.split("\n").filter((line) => line.trim()).map((line) => el("p", { class: "words" }, line)));
  const lead = (one, text) => el("button", { type: "button", class: "link screen", "aria-label": `${text}: show the transactions. ${one.text}`, on: { click: () => search(one.search) } }, text);
  const told = troubles.filter((one, at) => one.told && one.search && troubles.findIndex((other) => other.search === one.search) === at), others = troubles.filter((one) => !one.told);
  if (told.length) get("troubles").before(el("p", { class: "screen" }, "Transactions of ", told.flatMap((one, at) => [at ? ", " : "", lead(one, one.who)])));
  get("troubles").append(...others.slice(0, MOST_TROUBLES).map((one) => el("li", {}, one.text, " ", one.search ? lead(one, "show") : null)));
  const joint = troubles.filter((one) => one.others.length);
  if (joint.length) get("troubles").after(...joint.map((one) => el("details", {}, el("summary", {}, `${one.code}: all ${count(one.others.length + 1)}`), el("ul", {}, one.others.map((each) => el("li", {}, lead(each, each.who), ` ${each.text}`))))));
  if (others.length > MOST_TROUBLES) get("troubles").append(el("li", {}, "and ", el("a", { href: "#findings" }, `${count(others.length - MOST_TROUBLES)} more`)));
  get("troubles").hidden = !others.length;
  const all = (key) => stats.links.reduce((sum, link) => sum + link[key], 0);
  const watched = stats.watched_s;
  const begins = stats.links.filter((link) => link.begin_ns !== null).map((link) => link.begin_ns / 1000);
  const facts = [
    ["transactions", count(stats.transactions)], ["links", count(stats.links.length)], ["units", `${stats.is_counted_together ? "at least " : ""}${count(unitsSeen())}`],
    ["watched", watched ? span(watched) : "no times"], ["missing answers", count(all("no_answer"))], ...(all("late") ? [["late answers", count(all("late"))]] : []),
    ["exceptions", count(all("exception"))], ["retries", count(all("repetitions"))], ["broken rules", brokenText()],
  ];
  get("figures").append(...facts.map(([name, value]) => el("div", {}, el("dt", {}, name), el("dd", {}, value))));
  if (begins.length && hasDate(Math.min(...begins))) get("what").append(` · from ${moment(Math.min(...begins)).slice(0, 19)} UTC`);
}

/* Notes are facts worth knowing; they break no rule. */
function brokenText() {
  const { broken, notes } = data.findings;
  return el("span", {}, count(broken), notes ? el("span", { class: "aside" }, ` + ${plural(notes, "note")}`) : null);
}
function findings() {
  const { rows, broken, notes } = data.findings, counted = data.verdict.troubles.filter((one) => !one.is_rule);
  const none = "No rule of Modbus, or of a device’s manual, is broken";
  if (!rows.length && !counted.length && !stats.transactions) return;
  if (!rows.length && !counted.length) { show("findings", "", soft(`${none}.`)); return; }
  const body = el("tbody", { role: "rowgroup" }), heads = [".code", ".severity", ">times", "~where", "=what"];
  const lines = rows.map((one) => {
    const cases = [one.first, one.last].filter(Boolean);
    const text = `${one.code} ${one.severity} ${one.meaning} ${one.place} ${cases.map((each) => each.message).join(" ")}`.toLowerCase();
    const said = cases.map((each, at) => el("div", {}, jump(each.us, one.code), ` ${at && each.message === cases[0].message ? "the same" : each.message}`));
    const row = tableRow(heads, [
      matching(one.code).length ? el("button", { type: "button", class: "link", "aria-label": `${one.code}: the transactions with it`, on: { click: () => search(one.code) } }, one.code) : one.code,
      el("span", { class: `tag ${["error", "warning"].includes(one.severity) ? one.severity : "note"}` }, one.severity),
      count(one.count), one.place,
      el("div", {}, el("div", {}, one.meaning), el("div", { class: "soft" }, said),
        one.elsewhere ? el("div", { class: "soft" }, `and ${count(one.elsewhere)} times at other places`) : null)], true);
    return [text, row];
  });
  /* Troubles stand above the rules: a reader looks here for all that is wrong. */
  for (const one of counted.reverse()) {
    const find = one.search ? el("button", { type: "button", class: "link", "aria-label": `${one.code}: the transactions of ${one.who}`, on: { click: () => search(one.search) } }, one.code) : one.code;
    lines.unshift([`${one.code} ${one.severity} ${one.who} ${one.text}`.toLowerCase(), tableRow(heads, [find, el("span", { class: `tag ${one.severity}` }, one.severity), count(one.cases_of), one.who, el("div", {}, el("div", {}, one.text), casesOf(one))], true)]);
  }
  const told = el("span", { class: "soft", role: "status" });
  const fill = () => {
    const words = field.value.toLowerCase().split(/\s+/).filter(Boolean);
    const found = lines.filter(([text]) => words.every((word) => text.includes(word)));
    const hidden = isWhole || words.length ? 0 : Math.max(found.length - MOST_FINDINGS, 0);
    found.forEach(([, row], at) => row.classList.toggle("on-paper", at >= found.length - hidden));
    body.replaceChildren(...found.map(([, row]) => row));
    told.textContent = words.length ? `${count(found.length)} of ${count(lines.length)}` : "";
    more.hidden = !hidden;
    more.textContent = `Show ${count(hidden)} more`;
  };
  let isWhole = false;
  const more = el("button", { type: "button", on: { click: () => { isWhole = true; fill(); } } });
  const field = el("input", { type: "search", on: { input: fill } });
  const total = `${broken ? `Rules were broken ${plural(broken, "time")}` : none}${notes ? `; ${plural(notes, "note")}` : ""}.`;
  show("findings", count(lines.length), el("p", { class: "soft" }, total, rows.length ? el("span", { class: "screen" }, " A time leads to the transaction, a code to all of them.") : null),
    lines.length > FEW_FINDINGS ? el("div", { class: "tools" }, el("label", {}, "Search findings", field), told) : null,
    frame("Findings", heads, body, true, false), el("div", { class: "tools" }, more));
  fill();
}

/* When a trouble happened: its first cases, as the document says; else the first and the last of its
   transactions, or its longest ones. Of more failures than the table holds, the last is not known. */
function casesOf(one) {
  const line = (at, text) => el("div", { class: "soft" }, at, " ", text ? el("span", { class: text.length < 32 ? "nowrap" : "" }, text) : null);
  const longest = one.code === "POLL-PAUSED" ? "longest" : "first";
  if (one.cases.length) return [one.cases_of > one.cases.length ? line(`the ${one.cases.length === 1 ? "" : `${one.cases.length} `}${longest}:`, "") : null, ...one.cases.map(([us, text]) => line(exactly(us), text))];
  const words = one.search.split(" ").filter((word) => word && !word.startsWith("unit:") && !stats.links.some((link) => link.link === word));
  if (one.code !== "UNIT-SILENT" && !words.length) return null;
  const all = matching(one.search), of = (at, text) => line(linkTo(at, moment(usOf(rows[at]))), text);
  if (words.some((word) => word.startsWith("ms"))) return [all.length > LONGEST ? line(`the ${LONGEST} longest:`, "") : null, ...all.sort((a, b) => rows[b][LATENCY] - rows[a][LATENCY]).slice(0, LONGEST).map((at) => of(at, `after ${digits(rows[at][LATENCY] / 1000)} ms`))];
  const isAll = data.transactions.kept_with_trouble === data.transactions.with_trouble;
  return all.length > 1 ? [of(all[0], "the first"), isAll ? of(all[all.length - 1], "the last") : null] : all.map((at) => of(at, ""));
}

function against() {
  const one = data.against;
  if (!one) return;
  const rows = one.rows.map(([slave, kind, what, where, here, other]) => [slave, kind, what, where, here || "–", other || "–"]);
  show("against", plural(one.count, "difference"),
    soft(`Compared by meaning with ${one.other}: ${plural(one.count, "difference")} between its ${plural(one.other_transactions, "transaction")} and the ${count(one.transactions)} here. Ids, order and times do not count.`),
    one.is_whole ? null : el("p", { class: "notice" }, "There is more than can be compared at once; some traffic is left out."),
    rows.length ? table("Differences", ["slave", "differs", "function", "+what", "+here", `+in the other`], rows) : soft("They do not differ."),
    one.count > rows.length ? soft(`The first ${count(rows.length)} are listed.`) : null);
}

const FAILURES = [["no_answer", "missing answers", 1, "no_answer"], ["late", "late answers", 3, "late"], ["exceptions", "exceptions", 4, "exception"], ["bad_check", "wrong CRC", 6, "wrong_crc"], ["retries", "retries", 0, "repetitions"]];
function failures() {
  if (!stats.transactions) return;
  const make = (columns, title) => {
    const series = FAILURES.map(([key, label, at]) => ({ key, label, color: at, column: columns[key] })).filter((one) => total(one.column));
    if (!series.length) return null;
    const what = series.length > 1 ? "Failures" : `${series[0].label[0].toUpperCase()}${series[0].label.slice(1)}`;
    return chart({
      title: `${what} over time, ${title}`, note: `number ${BINNED}`, summary: `${series.map((one) => `${one.label}: ${count(total(one.column))}`).join(", ")}.`,
      sync: "time", bins: "counts", axisY: counted, data: [times, ...series.map((one) => one.column)],
      series: series.map((one) => ({ ...one, fill: true })),
    });
  };
  const place = el("div");
  const seen = unitsSeen(), all = bins.counted < seen ? `${count(bins.counted)} of ${count(seen)} units` : several ? "all links" : "all units";
  const failing = bins.units.filter((one) => FAILURES.some(([key]) => total(one[key])));
  const choice = hasTimeline && chooser("Unit", [all, ...failing.map((one) => unitName(one.link, one.unit))], (at) => {
    place.replaceChildren(make(at ? failing[at - 1] : bins.all, at ? unitName(failing[at - 1].link, failing[at - 1].unit) : all));
  });
  const whole = hasTimeline && make(bins.all, all);
  if (whole) place.append(whole);
  const rows = stats.links.flatMap((link) => link.functions.map((one) => [link, one]))
    .filter(([, one]) => one.no_answer || one.late || one.exception || one.malformed || one.unsolicited || one.not_captured || one.repetitions)
    .map(([link, one]) => [...(several ? [link.link] : []), one.unit === null ? "other" : String(one.unit), functionText(one), count(one.requests), some(one.late), some(one.no_answer), some(one.wrong_crc), some(one.exception),
      one.exceptions.map((each) => `${hex(each.code)} ${each.name} ×${count(each.count)}`).join(", "), some(one.repetitions), some(one.malformed), some(one.unsolicited), some(one.not_captured)]);
  const sumOf = (name) => total(stats.links.flatMap((link) => link.functions.map((one) => one[name] ?? 0))), damaged = sumOf("wrong_crc");
  const sums = FAILURES.map(([, label, , name]) => (name === "wrong_crc" ? "" : sumOf(name) && `${count(sumOf(name))} ${label}${name === "no_answer" && damaged ? `, of these ${count(damaged)} with a wrong CRC` : ""}`)).filter(Boolean);
  show("failures", sums.length ? sums.join("; ") : "none", failing.length > 1 ? choice : null, place, whole || rows.length ? null : soft("No request failed."),
    rows.length ? table("Failures by unit and function", [...(several ? ["link"] : []), ">unit", "~function", ">asked", ">late", ">no answer", ">of these wrong CRC", ">exceptions", "+which", ">retries", ">malformed", ">unsolicited", ">not captured"], rows) : null,
    rows.some((row) => row[row.length - 1]) ? soft("What was not captured is the capture’s loss, and no device’s fault.") : null,
    bins.units_left_out ? soft(`Of single units there are charts of the ${count(bins.units.length)} that are in trouble or were asked most; ${plural(unitsSeen() - bins.units.length, "unit")} left out.`) : null);
}

function chooser(label, names, choose) {
  if (names.length < 2) return null;
  const list = el("select", { on: { change: () => choose(list.selectedIndex) } }, names.map((name) => el("option", {}, name)));
  return el("div", { class: "tools" }, el("label", {}, label, list));
}

function latency() {
  const timed = bins.units.filter((one) => hasTimeline && one.mean_ms.some((ms) => ms !== null));
  const sources = stats.links.flatMap((link) => [
    ...(link.latency ? [[several ? link.link : "all units", link.latency, barsOf(link.link, null, null)]] : []),
    ...link.functions.filter((one) => one.latency && link.functions.length > 1)
      .map((one) => [[unitName(link.link, one.unit), functionText(one)].filter(Boolean).join(", "), one.latency, barsOf(link.link, one.unit, one.function)])]);
  if (!sources.length) return;
  const ms = (column) => column.filter((one) => one !== null);
  const overTime = (title, key, height) => {
    const reach = `${reachOf(timed.flatMap((one) => ms(one[key])), digits)} ms`;
    return chart({
      title, note: `${BINNED}; ${reach}`, measure: "ms", sync: "time", height, summary: `${plural(timed.length, "unit")}, ${reach}.`, bins: "means",
      data: [times, ...timed.map((one) => one[key])], axisY: inUnit(" ms"),
      series: timed.map((one, at) => ({ label: unitName(one.link, one.unit), show: at < SHOWN_SERIES })),
    });
  };
  const over = timed.length ? el("div", { class: "pair" }, overTime("Mean latency by unit over time", "mean_ms", 200), overTime("Longest latency by unit over time", "most_ms", 200)) : null;
  const place = el("div");
  const draw = (at) => place.replaceChildren(histogram(...sources[at]));
  draw(0);
  const percentiles = sources.length ? Object.keys(sources[0][1]).filter((key) => /^p\d+_ms$/.test(key)) : [];
  const rows = sources.map(([name, one]) => [name, count(one.count), digits(one.mean_ms), digits(one.min_ms), ...percentiles.map((key) => digits(one[key])), digits(one.max_ms)]);
  show("latency", `up to ${digits(Math.max(...sources.map(([, one]) => one.max_ms)))} ms`, soft("From the end of a request to the start of its response, in ms."), over, chooser("Histogram of", sources.map(([name]) => name), draw), place,
    table("Latency, ms", ["~unit and function", ">answers", ">mean", ">least", ...percentiles.map((key) => `>${key.slice(0, -3)}`), ">most"], rows));
}

/* Bars of equal width up to p99: a single late answer would leave all others one bar. */
const barsOf = (link, unit, code) => data.bars.find((one) => one.link === link && one.unit === unit && one.function === code);
function histogram(name, one, bars) {
  const steps = bars ? bars.steps.map(([from_ms, below_ms, n]) => ({ from_ms, below_ms, count: n })) : one.histogram;
  const longer = bars?.beyond ? `; ${plural(bars.beyond, "longer answer")}, up to ${digits(one.max_ms)} ms` : "", beyond = longer && `${longer}, not shown`;
  if (steps.length < 2) return soft(`${longer ? count(one.count - bars.beyond) : "All"} answers of ${name} took about ${digits(one.p50_ms)} ms${longer}.`);
  const labels = steps.map((step) => `${number(step.from_ms)}–${number(step.below_ms)}`);
  return chart({
    title: `Latency of ${name}`, note: `number of answers by latency in ms${beyond}`, head: "ms", height: 200,
    summary: `${plural(one.count, "answer")}, half of them within ${digits(one.p50_ms)} ms, 95 % within ${digits(one.p95_ms)} ms.`,
    data: [steps.map((_, at) => at), steps.map((step) => step.count)], at: (x) => `${labels[x] ?? ""} ms`,
    axisX: (u, splits) => {
      const every = Math.ceil((steps.length * 7 * Math.max(...labels.map((text) => text.length + 1))) / Math.max(u.bbox.width / devicePixelRatio, 1));
      return splits.map((x) => (steps[x] && x % every === 0 ? labels[x] : ""));
    },
    axis0: { grid: { show: false }, splits: () => steps.map((_, at) => at) }, scaleX: { range: () => [-0.6, steps.length - 0.4] },
    axisY: counted, dots: false, series: [{ label: "answers", paths: barPaths(1, 0, 1), fill: "99" }],
  });
}

const pollOf = (link, at) => link.polls.find((poll) => poll.number === at);
const functionText = (one) => (one.unit === null ? "" : `${hex(one.function)} ${one.function_name}`);
const pollText = (poll) => (poll ? `${poll.unit} ${hex(poll.function)} ${poll.reference || poll.function_name}${poll.sub_function !== null && !poll.reference ? ` ${hex(poll.sub_function)}` : ""}` : "a poll that is not listed");
function cycle() {
  const made = [];
  for (const link of stats.links) for (const master of link.masters) {
    const who = [several ? link.link : "", link.masters.length > 1 && master.master ? `master ${master.master}` : ""].filter(Boolean).join(", ");
    const asked = link.polls.filter((poll) => poll.master === master.master).reduce((sum, poll) => sum + poll.requests, 0);
    const part = asked > master.requests_looked_at ? `Of the last ${count(master.requests_looked_at)} of ${count(asked)} requests, ` : "";
    for (const list of master.lists) made.push(cycleTable(link, list, who, made.length < OPEN_CYCLES, part));
    const between = master.between.map((one) => `${pollText(pollOf(link, one.poll))} ×${count(one.count)}`);
    if (between.length && master.lists.length) made.push(soft(`In no cycle${who ? ` of ${who}` : ""}: ${between.slice(0, 20).join("; ")}${between.length > 20 ? ` and ${between.length - 20} more` : ""}.`));
    if (master.response_timeout_ms) made.push(soft(`The master${who ? ` (${who})` : ""} waits ${milli(master.response_timeout_ms)} for an answer.`));
  }
  if (!made.length) return;
  if (data.advice.length) made.push(el("h3", {}, "Fewer requests"), el("ul", {}, ...data.advice.map((line) => el("li", {}, line.trim()))));
  show("cycle", plural(made.filter((one) => one.tagName === "DETAILS").length, "list"), made.slice(0, 60));
}
function cycleTable(link, list, who, isOpen, part) {
  const whole = list.steps.reduce((sum, step) => sum + step.pause_ms + step.took_ms, 0) || 1;
  let from = 0;
  const rows = list.steps.map((step) => {
    from += step.pause_ms;
    const bar = el("div", { class: step.cycles_with_missing ? "bar missing" : "bar" });
    bar.style.left = `${(from / whole) * 100}%`;
    bar.style.width = `${(step.took_ms / whole) * 100}%`;
    from += step.took_ms;
    const track = el("div", { class: "track", role: "img", "aria-label": `begins at ${digits(from - step.took_ms)} ms, takes ${digits(step.took_ms)} ms` }, bar);
    return [pollText(pollOf(link, step.poll)), digits(step.pause_ms), digits(step.took_ms), some(step.cycles_with_missing), track];
  });
  const missing = list.with_missing_ms !== null && list.without_missing_ms !== null
    ? ` A cycle with a missing answer takes ${milli(list.with_missing_ms)}, one without ${milli(list.without_missing_ms)}.` : "";
  const [least, most] = [milli(list.min_ms), milli(list.max_ms)], took = least === most ? `${least} each` : `${least} to ${most}`;
  const other = list.other_cycles ? ` ${plural(list.other_cycles, "cycle")} had a poll more or less, or another order.` : "";
  return el("details", { open: isOpen }, el("summary", {}, el("h3", {}, `${who ? `${who}: ` : ""}${plural(list.steps.length, "poll")} every ${span(list.cycle_ms / 1000)}`)),
    soft(`${part}${plural(list.cycles, "cycle")} went in this order and took ${took}.${other}${missing}`),
    table(`One cycle in order${who ? `, ${who}` : ""}, every ${span(list.cycle_ms / 1000)}`, ["~poll", ">pause before, ms", ">took, ms", ">cycles with missing", "+timeline"], rows, true, PRINTED_ROWS, (at) => list.steps[at].cycles_with_missing));
}

/* How long each bin of a link counts (s). Its first and last bin hold requests for a part of their
   width only: over the whole width, a steady rate would seem to fall at both ends. They count from
   the first request to one mean interval behind the last one, and one mean interval for each
   request at least. */
function watchedIn({ link: name, requests }) {
  const link = stats.links.find((one) => one.link === name), begin = link.begin_ns / 1e9, end = link.end_ns / 1e9;
  const every = (end - begin) / Math.max(link.transactions - 1, 1) || bins.width;
  return times.map((from, at) => Math.min(Math.max(Math.min(from + bins.width, end + every) - Math.max(from, begin), requests[at] * every), bins.width) || bins.width);
}

const RATES = [[1, "a second", " /s"], [60, "a minute", " /min"], [3600, "an hour", " /h"]];
const PARTS = [["characters_share", "characters"], ["other_bytes_share", "bytes in no frame"], ["slaves_share", "waiting for slaves"], ["missing_share", "waiting for missing answers"]];
function load() {
  const made = [];
  for (const link of stats.links.filter((one) => one.load)) {
    const parts = el("div", { class: "parts", "aria-hidden": "true" }, PARTS.map(([key]) => {
      const part = el("span");
      part.style.width = `${link.load[key] * 100}%`;
      return part;
    }));
    made.push(el("h3", {}, `${link.link} ${link.settings || ""}`),
      soft(`There are characters on the line for ${share(link.load.busy_share)} of the time.`), parts,
      el("ul", { class: "legend keys" }, [...PARTS, ["pauses_share", "free"]].map(([key, name]) => el("li", {}, el("span", { class: "key", "aria-hidden": "true" }), `${name} ${share(link.load[key])}`))));
  }
  const timed = bins.links.filter((one) => hasTimeline && one.load);
  if (timed.length) made.push(chart({
    title: "Bus load over time", note: `share of the time in which there are characters on the line, ${BINNED}`, sync: "time", bins: "counts", summary: "",
    data: [times, ...timed.map((one) => { const watched = watchedIn(one); return one.load.map((part, at) => Math.min((part * 100 * bins.width) / watched[at], 100)); })],
    measure: "%", axisY: inUnit(" %"), series: timed.map((one, at) => ({ label: one.link, fill: true, show: at < SHOWN_SERIES, text: (v) => number(Number(v.toPrecision(3))) })),
  }));
  const rates = hasTimeline ? bins.links.map((one) => { const watched = watchedIn(one); return one.requests.map((n, at) => n / watched[at]); }) : [];
  const [factor, noun, unit] = RATES.find(([one]) => one * Math.max(...rates.flat()) >= 0.5) ?? RATES[RATES.length - 1];
  if (rates.length) made.push(chart({
    title: `Requests ${noun}`, note: BINNED, sync: "time", bins: "counts", summary: "", height: 170, axisY: inUnit(unit), measure: unit.trim(),
    data: [times, ...rates.map((one) => one.map((rate) => rate * factor))],
    series: bins.links.map((one, at) => ({ label: one.link, show: at < SHOWN_SERIES, text: (v) => number(Number(v.toPrecision(3))) })),
  }));
  const bad = [["bad_check", "wrong CRC or LRC", 6], ["no_frame", "bytes in no frame", 4], ["lacking", "missing in the capture", 7]]
    .map(([key, label, at]) => ({ label, color: at, column: added(bins.links.map((one) => one[key])) })).filter((one) => total(one.column));
  if (bad.length && hasTimeline) made.push(chart({ title: `Damage on the line and in the capture${bad.length > 1 ? "" : `: ${bad[0].label}`}`, note: `events ${BINNED}`, sync: "time", bins: "counts", height: 170,
    summary: bad.map((one) => `${one.label}: ${count(total(one.column))}`).join(", "), axisY: counted, data: [times, ...bad.map((one) => one.column)],
    series: bad.map((one) => ({ ...one, fill: true })) }));
  const rows = stats.links.flatMap((link) => link.connections.map((one) => [link.link, one.master || "", count(one.opened), some(one.joined), some(one.refused), some(one.resets), count(one.most_at_once)]));
  if (rows.length) made.push(table("Connections", ["slave", "master", ">opened", ">open before", ">refused", ">reset", ">most at once"], rows));
  const busy = stats.links.filter((one) => one.load).map((one) => share(one.load.busy_share));
  if (made.length) show("load", busy.length === 1 ? `line busy for ${busy[0]}` : "", made);
}

/* As in `stats`: where the times between requests vary more than their median, there is no period. */
function everyText(period) {
  if (!period) return ["–", "–"];
  if (period.jitter_ms <= period.p50_ms) return [seconds(period.p50_ms / 1000), period.count > 1 ? digits(period.jitter_ms) : "–"];
  return ["varies", "–"];
}
function polls() {
  const all = stats.links.flatMap((link) => link.polls.map((poll) => [link, poll]));
  if (!all.length) return;
  const failed = (one) => one.no_answer + one.late + one.exception + one.malformed;
  const ranked = all.sort(([, a], [, b]) => failed(b) - failed(a) || (b.latency?.p95_ms ?? 0) - (a.latency?.p95_ms ?? 0));
  const rows = ranked.map(([link, one]) => [...(several ? [link.link] : []), pollText(one), one.device || "", count(one.requests), ...everyText(one.period), digits(one.latency?.p50_ms), digits(one.latency?.p95_ms), digits(one.latency?.max_ms), some(one.exception), some(one.no_answer + one.late), one.load ? share(one.load.total_share) : ""]);
  const listed = all.length < stats.polls_listed ? ` Of ${count(stats.polls_listed)} polls the ${count(all.length)} that were asked most.` : "";
  show("polls", count(all.length), soft(`Equal requests, ${all.some(([, one]) => failed(one)) ? "those that failed most first, then " : ""}the slowest first; unit, function and address.${listed}`),
    table("Polls", [...(several ? ["link"] : []), "~poll", "device", ">asked", ">every s", ">± ms", ">p50 ms", ">p95 ms", ">most ms", ">exceptions", ">no answer", ">line"], rows, false));
}

function values() {
  const { series, constant } = data.values;
  if (!series.length && !constant.length) return;
  const ends = new Map(stats.links.map((link) => [link.link, (link.end_ns ?? 0) / 1e9]));
  const lines = (one) => {
    const x = one.samples.map(([ms]) => bins.begin + ms / 1000), y = one.samples.map(([, value]) => value), end = ends.get(one.link) ?? 0;
    if (x.length && x[x.length - 1] < end) { x.push(end); y.push(y[y.length - 1]); }
    return [x, y];
  };
  const title = (one) => `${one.name}${one.reference && one.reference !== one.name ? ` (${one.reference})` : ""}`;
  const bits = new Map();
  const specs = [];
  for (const one of series) {
    const where = unitName(one.link, one.unit);
    if (one.kind === "bit") {
      if (!bits.has(where)) bits.set(where, []);
      bits.get(where).push(one);
    } else specs.push(() => valueChart(one, where, title(one), lines(one)));
  }
  const bands = [...bits].flatMap(([where, some_]) => {
    const groups = [];
    for (let at = 0; at < some_.length; at += 16) groups.push(some_.slice(at, at + 16));
    return groups.map((group) => bandChart(group, where, lines, title));
  });
  const grid = el("div", { class: "grid" });
  const more = el("button", { type: "button" }, "");
  const tools = el("div", { class: "tools" }, more), unprinted = el("p", { class: "soft on-paper" });
  let drawn = 0;
  const draw = () => {
    grid.append(...specs.slice(drawn, drawn + CHARTS_AT_ONCE).map((make) => make()));
    drawn = Math.min(drawn + CHARTS_AT_ONCE, specs.length);
    more.textContent = `Show ${Math.min(CHARTS_AT_ONCE, specs.length - drawn)} more charts (${drawn} of ${specs.length} are shown)`;
    tools.hidden = unprinted.hidden = drawn >= specs.length;
    unprinted.textContent = `${drawn} of ${specs.length} charts of values are printed: those that were shown on the screen.`;
  };
  more.addEventListener("click", draw);
  draw();
  show("values", `${count(series.length)} changed`, soft(`${plural(series.length, "value")} changed, ${count(constant.length)} did not. A value holds until the next one is read or written.`),
    ...(hasTimeline ? [grid, tools, unprinted, ...bands] : [series.length && table("Values that changed", [...(several ? ["link"] : []), ">unit", "~name", "+values"],
      series.map((one) => [...(several ? [one.link] : []), String(one.unit), title(one), one.samples.map(([, value]) => new Map(one.texts).get(value) ?? number(value)).slice(0, 8).join(", ")]))]),
    constant.length ? table("Values that never changed", [...(several ? ["link"] : []), ">unit", "~name", "address", "+value"],
      constant.map(([link, unit, name, reference, value]) => [...(several ? [link] : []), String(unit), name, reference, value])) : null,
    data.values.left_out ? soft(`${plural(data.values.left_out, "more register")} or points were seen and are not followed.`) : null);
}
function valueChart(one, where, title, [x, y]) {
  const reach = reachOf(y, number);
  const texts = new Map(one.texts);
  const words = one.kind === "state";
  const known = [...new Set(y)].sort((a, b) => a - b);
  const named = new Map(known.map((v) => [v, laneName(clean(texts.get(v) ?? number(v)))]));
  const wrapped = words && [...named.values()].some((name) => name.includes("\n"));
  const y0 = words ? { splits: () => known, values: (u, splits) => splits.map((v) => named.get(v)), size: laneRoom([...named.values()]) } : y.every(Number.isInteger) ? counted : {};
  if (!words && x.length > MANY_SAMPLES) return bandOfValues(one, where, title, reach, [x, y]);
  return chart({
    title, caption: `${title}, ${where}`, note: `${where}, ${plural(one.changes, "change")}${words ? "" : `, ${reach}${one.measure ? ` ${one.measure}` : ""}`}`, sync: "time", height: 150, measure: words ? "" : one.measure,
    summary: words ? "" : `${reach}.`, data: [x, y], axisY: y0, held: true,
    scaleY: { range: (u, low, high) => { const room = (high - low) * 0.08 || Math.abs(high) * 0.05 || 1; return [low - (wrapped ? 3 * room : room), high + room]; } },
    series: [{ label: one.name, paths: stepped, measured: one.samples.length, text: (v) => texts.get(v) ?? number(v) }],
  });
}
/* Of many values, the least and the greatest in each part of the time: lines would fill the chart. */
function bandOfValues(one, where, title, reach, [x, y]) {
  const width = (bins.count * bins.width) / VALUE_COLUMNS, at = Array.from({ length: VALUE_COLUMNS }, (_, place) => bins.begin + place * width);
  const low = Array(VALUE_COLUMNS).fill(null), high = Array(VALUE_COLUMNS).fill(null);
  const note = (place, value) => { low[place] = Math.min(low[place] ?? value, value); high[place] = Math.max(high[place] ?? value, value); };
  x.forEach((time, place) => {
    const begin = Math.max(Math.floor((time - bins.begin) / width), 0);
    const end = place + 1 < x.length ? Math.floor((x[place + 1] - bins.begin) / width) : VALUE_COLUMNS - 1;
    for (let column = begin; column <= Math.min(end, VALUE_COLUMNS - 1); column++) note(column, y[place]);
  });
  return chart({
    title, caption: `${title}, ${where}`, note: `${where}, ${plural(one.changes, "change")}, ${reach}${one.measure ? ` ${one.measure}` : ""}; least and greatest in ${span(width)}`, sync: "time", height: 150, measure: one.measure, dots: false,
    summary: `${reach}.`, data: [at, low, high], legend: false, held: true, bands: true,
    scaleY: { range: (u, least, most) => { const room = (most - least) * 0.08 || Math.abs(most) * 0.05 || 1; return [least - room, most + room]; } },
    series: [{ label: "least", paths: stepped, color: 0, width: 1 }, { label: "greatest", paths: stepped, color: 0, width: 1 }],
  });
}
const measuring = document.createElement("canvas").getContext("2d");
function textWidth(text) {
  measuring.font = FONT;
  return measuring.measureText(text).width;
}
/* A name beside its lane: too long for a line, it has two, and ends with dots if that is too short. */
function laneName(text) {
  if (textWidth(text) <= LANE_NAME) return text;
  const fit = (part) => { let end = part.length; while (end > 1 && textWidth(part.slice(0, end)) > LANE_NAME) end--; return end; };
  const end = fit(text), space = text.lastIndexOf(" ", end), cut = space > end / 2 ? space : end;
  const rest = text.slice(cut).trim(), last = fit(rest);
  return `${text.slice(0, cut)}\n${last < rest.length ? `${rest.slice(0, last - 2)}…` : rest}`;
}
const laneRoom = (names) => Math.ceil(Math.max(...names.flatMap((name) => name.split("\n")).map(textWidth))) + 24;
function bandChart(group, where, lines, title) {
  const lane = (at) => group.length - 1 - at;
  const joined = uPlot.join(group.map((one, at) => { const [x, y] = lines(one); return [x, y.map((v) => lane(at) + (v ? 0.8 : 0.02))]; }));
  const names = group.map((one) => laneName(clean(one.name)));
  const spelled = (one, at) => (v) => { const bit = v > lane(at) + 0.5 ? 1 : 0; return new Map(one.texts).get(bit) ?? String(bit); };
  return chart({
    title: `Bits of ${where}`, note: "a bar where the bit is 1", sync: "time", height: 40 + 30 * group.length, isWhole: true, legend: false, dots: false, held: true,
    summary: group.map((one) => `${title(one)}: ${plural(one.changes, "change")}`).join(", "), data: joined,
    scaleY: { range: () => [-0.1, group.length] },
    axisY: { size: laneRoom(names), splits: () => names.map((name, at) => lane(at) + (name.includes("\n") ? 0.65 : 0.4)), values: () => names },
    series: group.map((one, at) => ({ label: one.name, color: at % 8, paths: stepped, fill: "88", fillTo: () => lane(at), text: spelled(one, at) })),
  });
}

function inventory() {
  const { slaves, masters } = data.inventory;
  if (!slaves.length && !masters.length) return;
  const rows = slaves.map((one) => [one.where, String(one.unit), one.role, one.profile, count(one.transactions), some(one.no_answer), some(one.unreached),
    el("ul", { class: "plain soft" }, one.details.map((line) => el("li", {}, line)))]);
  show("inventory", plural(data.inventory.slaves_seen, "unit"), table(`Units (${count(data.inventory.slaves_seen)})`, ["~host or line", ">unit", ".role", "profile", ">transactions", ">no answer", ">not reached", "=details"], rows),
    masters.length ? table(`Masters (${count(data.inventory.masters_seen)})`, ["host", ">asks units", ">writes to", ">requests", "seen (UTC)", "+MAC"],
      masters.map(([host, asks, writes, requests, seen, mac]) => [host, count(asks), count(writes), count(requests), seen, mac])) : null);
}

/* ---- transactions ---- */

const { rows, texts, begin_us: beginUs } = data.transactions;
const [NUMBER, US, LINK, UNIT, WHAT, RESULT, OUTCOME, LATENCY, CODES, IS_RETRY] = Array(10).keys();
const whatOf = (row) => `${texts[row[WHAT]]}${row[IS_RETRY] ? " (retry)" : ""}`;
const usOf = (row) => beginUs + row[US];
const oneDay = rows.every((row) => day(usOf(row)) === day(beginUs));
const rowTime = (row) => (oneDay ? clock(usOf(row)) : moment(usOf(row)));
const haystacks = [];
const haystack = (at) => {
  const row = rows[at];
  return (haystacks[at] ??= ` ${texts[row[LINK]]} unit:${row[UNIT]} #${row[NUMBER]} ${whatOf(row)} ${texts[row[RESULT]]} ${texts[row[OUTCOME]]} ${texts[row[CODES]]} ${clock(usOf(row))} `.toLowerCase());
};
let found = rows.map((_, at) => at), first = 0, here = -1;
const HEADS = ["#number", ...(isTimed ? [".time (UTC)"] : []), ...(several ? ["link"] : []), ">unit", "=request", "+result", ".outcome", ">ms", ".findings"];
const body = el("tbody", { role: "rowgroup" });
const told = el("span", { class: "soft", role: "status" }), onPaper = el("p", { class: "soft printed" });
const field = el("input", { type: "search", on: { input: () => { filter(); first = 0; draw(); } } });
const turn = (by) => el("button", { type: "button", on: { click: () => { first = Math.min(Math.max(first + by * PAGE_ROWS, 0), Math.max(found.length - 1, 0)); draw(); } } }, by < 0 ? "Earlier" : "Later");
const earlier = turn(-1), later = turn(1);
/* One word of a search as a test of a row: ms>400 compares the latency, unit:5 and #12 are exact. */
function testOf(word) {
  const [, sign, ms] = /^ms([<>]=?)(\d+\.?\d*)$/.exec(word) || [];
  if (!sign) { const part = /^(unit:|#)/.test(word) ? ` ${word} ` : word; return (at) => haystack(at).includes(part); }
  const limit = Number(ms) * 1000;
  return (at) => { const us = rows[at][LATENCY]; return us >= 0 && ((us === limit && sign.length > 1) || (sign[0] === ">" ? us > limit : us < limit)); };
}
function matching(text) {
  const tests = text.toLowerCase().split(/\s+/).filter(Boolean).map(testOf), some = [];
  for (let at = 0; at < rows.length; at++) if (tests.every((test) => test(at))) some.push(at);
  return some;
}
const filter = () => { found = matching(field.value); };
const hasFailed = (row) => !["ok", "broadcast"].includes(texts[row[OUTCOME]]);
function fill(page) {
  body.replaceChildren(...page.map((at) => {
    const row = rows[at], outcome = texts[row[OUTCOME]];
    const cells = [el("a", { href: `#t${Number(row[NUMBER])}`, "aria-label": `${count(row[NUMBER])}: transaction` }, count(row[NUMBER])),
      ...(isTimed ? [el("span", { class: "mono" }, rowTime(row))] : []), ...(several ? [texts[row[LINK]]] : []), String(row[UNIT]), whatOf(row), texts[row[RESULT]],
      el("span", { class: hasFailed(row) ? "nowrap bad-text" : "nowrap" }, outcome), row[LATENCY] < 0 ? "" : digits(row[LATENCY] / 1000), texts[row[CODES]]];
    return tableRow(HEADS, cells, true, { id: `t${row[NUMBER]}`, class: at === here ? "here" : null, tabindex: "-1" });
  }));
}
/* The rows of a trouble that neither fail nor have a code: late answers, and those beside pauses. */
function oddRows(one) {
  if (one.cases.length) return one.cases.map(([us]) => rowAt(us)).filter((at) => at >= 0).flatMap((at) => [at, at + 1]).filter((at) => at < rows.length);
  return /(^| )ms>/.test(one.search) ? matching(one.search) : [];
}
/* On paper stand what the reader searched, or else the rows that failed or that the findings name, of
   each kind alike many, each behind the row before it; without any, the first ones. */
function troubled() {
  const kinds = new Map(), chosen = new Set();
  rows.forEach((row, at) => {
    if (!hasFailed(row) && !texts[row[CODES]]) return;
    const kind = [LINK, UNIT, OUTCOME, CODES].map((place) => row[place]).join();
    kinds.set(kind, [...(kinds.get(kind) ?? []), at].slice(0, PRINTED_TRANSACTIONS + 1));
  });
  for (const one of data.verdict.troubles) kinds.set(one.text, oddRows(one));
  for (let turn = 0; turn < PRINTED_TRANSACTIONS; turn++) for (const list of kinds.values()) {
    const at = list[turn], hasBefore = at > 0 && rows[at - 1][NUMBER] === rows[at][NUMBER] - 1;
    const more = at === undefined ? [] : hasBefore ? [at - 1, at] : [at];
    if (chosen.size + more.length <= PRINTED_TRANSACTIONS) more.forEach((one) => chosen.add(one));
  }
  const isSome = data.transactions.kept_with_trouble < data.transactions.with_trouble || [...kinds.values()].flat().some((at) => !chosen.has(at));
  return [[...chosen].sort((a, b) => a - b), isSome];
}
function rowsToPaper() {
  const [bad, isSome] = field.value || rows.length <= PRINTED_TRANSACTIONS ? [[], false] : troubled(), page = bad.length ? bad : found.slice(first, first + PRINTED_TRANSACTIONS);
  const which = bad.length ? `: ${isSome ? "some of each kind of " : ""}those that failed or that the findings name, with the one before` : field.value ? `, found by ${field.value}` : "";
  fill(page);
  onPaper.textContent = page.length === data.transactions.transactions ? "" : clean(`On paper ${plural(page.length, "transaction")}${which}.`);
}
function draw() {
  const page = found.slice(first, first + PAGE_ROWS);
  fill(page);
  const last = Math.min(first + PAGE_ROWS, found.length);
  told.textContent = found.length ? `${count(first + 1)} to ${count(last)} of ${count(found.length)}` : "nothing fits";
  earlier.disabled = first === 0;
  later.disabled = last >= found.length;
}
function search(text) {
  field.value = text;
  filter();
  first = 0; here = -1;
  draw();
  unfold("transactions");
  get("transactions").scrollIntoView();
  field.focus({ preventScroll: true });
}
function goTo(at) {
  field.value = "";
  filter();
  here = at;
  first = Math.floor(at / PAGE_ROWS) * PAGE_ROWS;
  draw();
  unfold("transactions");
  const row = get(`t${rows[at][NUMBER]}`);
  row.scrollIntoView({ block: "center" });
  row.focus({ preventScroll: true });
}
/* The row of a finding: one that begins at its time, with its code if there are several. */
function nearest(us, code) {
  let best = -1, least = Infinity;
  rows.forEach((row, at) => {
    const far = Math.abs(usOf(row) - us) * 2 + (texts[row[CODES]].includes(code) ? 0 : 1);
    if (far < least) [best, least] = [at, far];
  });
  return best;
}
function jump(us, code) {
  if (!rows.length) return el("span", {}, moment(us));
  return linkTo(nearest(us, code), moment(us));
}
const linkTo = (at, text) => el("a", { href: `#t${Number(rows[at][NUMBER])}` }, text);
/* A time, as a link if the table has the transaction that began then. */
const rowAt = (us) => rows.findIndex((row) => Math.abs(usOf(row) - us) <= 2);
function exactly(us) {
  const at = rowAt(us);
  return at < 0 ? el("span", {}, moment(us)) : linkTo(at, moment(us));
}
function byHash() {
  const match = /^#t(\d+)$/.exec(location.hash), section = sections.find((one) => `#${one.id}` === location.hash);
  if (section) unfold(section.id);
  if (!match) return;
  const at = rows.findIndex((row) => row[NUMBER] === Number(match[1]));
  if (at >= 0) goTo(at);
}
function transactions() {
  if (!rows.length) return;
  const all = data.transactions, out = all.transactions - rows.length;
  const lost = all.with_trouble - all.kept_with_trouble;
  show("transactions", count(all.transactions),
    soft(`${out ? `${count(rows.length)} of ${count(all.transactions)} transactions: the first ones${all.late ? ", late answers" : ""}${all.beside_pauses ? ", those beside the longest pauses" : ""} and ${lost ? `${count(all.kept_with_trouble)} of the ${count(all.with_trouble)}` : "all"} that failed or have a finding. ${count(out)} are left out; mbtool report --all puts them all into the page.` : `All ${plural(all.transactions, "transaction")}.`} ${isTimed ? `Times are UTC${oneDay ? `, on ${day(beginUs)}` : ""}.` : "The capture has no times."}`),
    el("div", { class: "tools" }, el("label", {}, "Search transactions", field), earlier, later, told),
    el("p", { class: "soft screen" }, "Words must all occur; unit:5 and #12 are exact. Also: no-answer, wrong CRC, retry, exception, a code such as MB-401, a time, ms>400."),
    onPaper, frame("Transactions", HEADS, body, true, false));
  draw();
}

function capture() {
  const { files, remarks, lacking } = data.capture;
  const pairs = (list) => el("dl", { class: "pairs" }, list.flatMap(([name, value]) => [el("dt", {}, name), el("dd", {}, value)]));
  const made = files.slice(0, 20).map((one) => el("div", {}, el("h3", {}, one.file),
    one.capture.length ? pairs(one.capture) : soft("The file does not say how it was recorded."),
    one.links.map(([name, list]) => el("div", {}, el("p", {}, `Link ${name}`), pairs(list))),
    one.devices.length ? el("div", {}, el("p", {}, "Devices"), pairs(one.devices)) : null));
  if (files.length > 20) made.push(soft(`and ${count(data.capture.files_seen - 20)} more files`));
  const lines = stats.links.map((link) => [link.link, link.transport, link.settings || "", link.has_times ? `${(link.begin || "").slice(0, 19).replace("T", " ")}` : "no times", link.has_times ? `${(link.end || "").slice(0, 19).replace("T", " ")}` : "", span(link.watched_s), count(link.transactions)]);
  if (lines.length) made.push(table("Links", ["link", "transport", "settings", "from (UTC)", "to (UTC)", ">watched", ">transactions"], lines));
  made.push(el("h3", {}, "What the capture lacks"));
  const lost = stats.links.reduce((sum, link) => sum + link.not_captured, 0);
  if (lost) made.push(soft(`${plural(lost, "transaction")} not captured whole.`));
  if (stats.out_of_order) made.push(soft(`${plural(stats.out_of_order, "transaction")} came too late to be put in order.`));
  if (lacking.length) made.push(table(`Gaps (${count(data.capture.lacking_seen)})`, ["time (UTC)", "link", "+what"], lacking.map(([us, link, message]) => [moment(us), link, message])));
  if (remarks.length) made.push(el("ul", {}, remarks.map((line) => el("li", {}, line))));
  if (!lost && !lacking.length && !remarks.length) made.push(soft("As far as the files tell, nothing is lost or cut."));
  show("capture", remarks.length ? plural(remarks.length, "remark") : "", made);
}

for (const part of [verdict, transactions, findings, against, failures, latency, cycle, load, polls, values, inventory, capture]) part();
const sections = [...document.querySelectorAll("section[data-name]:not([hidden])")];
get("contents").append(...sections.map(({ id, dataset }) => el("li", {}, el("a", { href: `#${id}`, on: { click: () => unfold(id) } }, dataset.name))));
addEventListener("hashchange", byHash);
const made = `Made by mbtool ${clean(data.version)} on ${clean(data.made).slice(0, 19).replace("T", " ")} UTC. All times are UTC.`;
get("foot").append(`${made} docs/report.md and docs/findings.md explain the figures and the codes. Charts: uPlot, MIT licence.`);
get("made").append(made);
byHash();
})();

// Accuracy against cost, and curves over the scans of the picked rows.
const COST = "ms_per_scan";

function drawScatter() {
  const error = DATA.errors[state.data], W = 620, H = 430, L = 62, B = 44, T = 10, R = 14;
  if (!error) return byId("scatter").replaceChildren(el("p", { class: "quiet" }, "No row has an error."));
  const [errorKey, unit, title] = error;
  const points = DATA.rows.map((r, row) => ({ row, x: r.cells[COST], y: r.cells[errorKey], data: r.cells.data }))
    .filter((p) => p.data === state.data && p.x > 0 && p.y > 0);
  if (!points.length) return byId("scatter").replaceChildren(el("p", { class: "quiet" }, "No row has an error and a time."));
  const range = (values) => [Math.min(...values) / 1.25, Math.max(...values) * 1.25];
  const [x0, x1] = range(points.map((p) => p.x)), [y0, y1] = range(points.flatMap((p) => [p.y, ...DATA.rows[p.row].values.filter((v) => v > 0)]));
  const X = (v) => L + ((W - L - R) * Math.log(v / x0)) / Math.log(x1 / x0);
  const Y = (v) => H - B - ((H - B - T) * Math.log(v / y0)) / Math.log(y1 / y0);
  const out = svg("svg", { viewBox: `0 0 ${W} ${H}`, role: "group", "aria-label": `${title} against time a scan` });
  for (const v of logTicks(x0, x1)) out.append(svg("path", { class: "grid", d: `M${X(v)} ${T}V${H - B}` }), svg("text", { x: X(v), y: H - B + 18, "text-anchor": "middle" }, tickText(v)));
  for (const v of logTicks(y0, y1)) out.append(svg("path", { class: "grid", d: `M${L} ${Y(v)}H${W - R}` }), svg("text", { x: L - 8, y: Y(v) + 4, "text-anchor": "end" }, tickText(v)));
  out.append(svg("text", { x: (L + W - R) / 2, y: H - 6, "text-anchor": "middle" }, "time a scan (ms)"),
    svg("text", { transform: `translate(14 ${(T + H - B) / 2}) rotate(-90)`, "text-anchor": "middle" }, `${title} (${unit})`));
  const front = paretoFront(points);
  out.append(svg("path", { d: front.map((p, i) => `${i ? `H${X(p.x)}V` : `M${X(p.x)} `}${Y(p.y)}`).join(""), fill: "none", stroke: css("--quiet"), "stroke-width": 1.2, "stroke-dasharray": "2 3" }));
  let last = { x: -1e9, y: 0 };
  for (const p of front) {
    const at = { x: X(p.x), y: Y(p.y) - 10 };
    if (Math.abs(at.x - last.x) < 120 && Math.abs(at.y - last.y) < 15) continue;
    last = at;
    const left = at.x > W - 250;
    out.append(svg("text", { class: "name", x: at.x + (left ? -11 : 11), y: at.y + 1, "text-anchor": left ? "end" : "start" }, clipped(shortName(p.row), 34)));
  }
  for (const p of [...points].reverse()) out.append(scatterPoint(p, errorKey, unit, X, Y));
  byId("scatter").replaceChildren(out);
}
const clipped = (text, most) => (text.length > most ? `${text.slice(0, most - 1)}\u2026` : text);
function paretoFront(points) {
  const out = [];
  for (const p of [...points].sort((a, b) => a.x - b.x || a.y - b.y)) if (!out.length || p.y < out.at(-1).y) out.push(p);
  return out;
}
function scatterPoint(p, errorKey, unit, X, Y) {
  const { row } = p, { name, cells, best } = DATA.rows[row], look = lookOf(row), colour = colourOf(row);
  const dim = !passes(row), picked = state.picked.includes(row);
  const words = `${name}\n${three(p.y)} ${unit}, ${three(p.x)} ms a scan`;
  const low = cells[`${errorKey}_q1`], high = cells[`${errorKey}_q3`];
  const hint = (event) => showTip(words, event.clientX ?? 0, event.clientY ?? 0);
  const act = () => pick(row, !state.picked.includes(row));
  const group = svg("g", {
    tabindex: 0, role: "button", "aria-label": words, "aria-pressed": String(picked), "data-row": row, opacity: dim ? 0.15 : 1,
    onclick: act, onkeydown: (event) => { if (event.key === "Enter" || event.key === " ") { event.preventDefault(); act(); document.querySelector(`#scatter [data-row="${row}"]`)?.focus(); } },
    onpointermove: hint, onpointerleave: () => showTip(""), onblur: () => showTip(""),
    onfocus: (event) => { const box = event.target.getBoundingClientRect(); showTip(words, box.right, box.top); },
  });
  if (low > 0 && high > 0) group.append(svg("path", { d: `M${X(p.x)} ${Y(low)}V${Y(high)}`, stroke: colour, "stroke-width": 1.4 }));
  if (picked || best) group.append(svg("circle", { cx: X(p.x), cy: Y(p.y), r: 10.5, fill: "none", stroke: picked ? css("--ink") : css("--quiet"), "stroke-width": picked ? 1.6 : 1, "stroke-dasharray": picked ? "none" : "2 2" }));
  const mark = { d: markerPath(look.marker, best ? 6.5 : 5.2), transform: `translate(${X(p.x)} ${Y(p.y)})` };
  group.append(svg("path", { ...mark, fill: look.filled ? colour : css("--card"), stroke: colour, "stroke-width": 1.8 }));
  return group;
}

// A chart over scans: series {row, x, y, scan(i)}, drawn as lines or dots; the hovered scan is marked.
function lineChart(canvas, series, options) {
  const chart = { L: 58, R: 12, T: 10, B: 32 };
  const finite = (values) => { let low = Infinity, high = -Infinity; for (const v of values) if (v >= low || v <= high || low === Infinity) { if (!Number.isFinite(v)) continue; if (v < low) low = v; if (v > high) high = v; } return [low, high]; };
  const xs = series.map((s) => finite(s.x)), ys = series.map((s) => finite(s.y));
  let [x0, x1] = [Math.min(...xs.map((r) => r[0])), Math.max(...xs.map((r) => r[1]))];
  let [y0, y1] = [Math.min(options.from ?? Infinity, ...ys.map((r) => r[0])), Math.max(...ys.map((r) => r[1]))];
  if (!Number.isFinite(x0) || !Number.isFinite(y1)) [x0, x1, y0, y1] = [0, 1, 0, 1];
  if (x1 <= x0) x1 = x0 + 1;
  if (y1 <= y0) y1 = y0 + 1;
  // one path may be lost: then in powers of ten
  const tops = ys.map((r) => r[1]).filter((v) => v > 0), isLog = options.mayLog && Math.max(...tops) > 20 * Math.min(...tops);
  if (isLog) { y0 = Math.min(...tops) / 100; y1 *= 1.3; }
  const pad = isLog ? 0 : 0.06 * (y1 - y0);
  y1 = options.to ?? y1 + pad;
  if (options.from == null) y0 -= pad;
  const share = (v) => (isLog ? Math.log(Math.max(v, y0) / y0) / Math.log(y1 / y0) : (v - y0) / (y1 - y0));
  const draw = () => onCanvas(canvas, (c, w, h) => {
    const X = (v) => chart.L + ((w - chart.L - chart.R) * (v - x0)) / (x1 - x0), Y = (v) => h - chart.B - (h - chart.B - chart.T) * share(v);
    axes(c, w, h, chart, X, Y, ticks(x0, x1, w / 110), isLog ? logTicks(y0, y1).filter((v) => /^1e/.test(v.toExponential(0))) : ticks(y0, y1, 4), options.x, options.y);
    c.save();
    c.beginPath();
    c.rect(chart.L - 4, 0, w - chart.L - chart.R + 8, h - chart.B + 4);
    c.clip();
    if (options.line != null) stroke(c, css("--ink"), 1.2, [6, 4], [[chart.L, Y(options.line)], [w - chart.R, Y(options.line)]]);
    for (const s of [...series].reverse()) drawSeries(c, s, X, Y);
    c.restore();
    for (const s of series) markScan(c, s, X, Y);
  });
  canvas.onpointermove = (event) => {
    const box = canvas.getBoundingClientRect(), w = box.width;
    const v = x0 + ((event.clientX - box.left - chart.L) / (w - chart.L - chart.R)) * (x1 - x0), s = series[0];
    if (!s?.scan) return;
    state.hover = s.scan(nearest(s.x, v));
    emit("hover");
    showTip(hoverWords(series, options), event.clientX, event.clientY);
  };
  canvas.onpointerleave = () => { showTip(""); state.hover = null; emit("hover"); };
  canvas.onclick = () => { if (state.hover != null) { state.scan = state.hover; emit("scan"); } };
  draw();
  return draw;
}
function hoverWords(series, options) {
  const lines = series.filter((s) => s.index).map((s) => { const i = s.index(state.hover); return `${letterOf(s.row)}: ${three(+s.y[i])}`; });
  return [`scan ${state.hover}`, ...lines].join("\n") + (options.unit ? ` ${options.unit}` : "");
}
function axes(c, w, h, m, X, Y, xTicks, yTicks, xTitle, yTitle) {
  c.strokeStyle = css("--grid");
  c.fillStyle = css("--quiet");
  c.lineWidth = 1;
  c.textBaseline = "middle";
  for (const v of yTicks) { line(c, m.L, Y(v), w - m.R, Y(v)); c.textAlign = "right"; c.fillText(tickText(v), m.L - 7, Y(v)); }
  for (const v of xTicks) { line(c, X(v), m.T, X(v), h - m.B); c.textAlign = "center"; c.fillText(tickText(v), X(v), h - m.B + 10); }
  c.fillText(xTitle, (m.L + w - m.R) / 2, h - 6);
  c.save();
  c.translate(9, (m.T + h - m.B) / 2);
  c.rotate(-Math.PI / 2);
  c.fillText(yTitle, 0, 0);
  c.restore();
}
function line(c, a, b, x, y) { c.beginPath(); c.moveTo(a, b); c.lineTo(x, y); c.stroke(); }
function stroke(c, colour, width, dashes, points) {
  c.strokeStyle = colour;
  c.lineWidth = width;
  c.setLineDash(dashes);
  c.beginPath();
  points.forEach(([x, y], i) => (i ? c.lineTo(x, y) : c.moveTo(x, y)));
  c.stroke();
  c.setLineDash([]);
}
function drawSeries(c, s, X, Y) {
  const colour = s.colour || colourOf(s.row);
  if (s.dots) {
    c.fillStyle = colour;
    c.globalAlpha = s.x.length > 1500 ? 0.45 : 0.8;
    const r = s.x.length > 1500 ? 1 : 1.6;
    for (let i = 0; i < s.x.length; i++) if (Number.isFinite(s.y[i])) c.fillRect(X(s.x[i]) - r, Y(s.y[i]) - r, 2 * r, 2 * r);
    c.globalAlpha = 1;
    return;
  }
  c.strokeStyle = colour;
  c.lineWidth = s.width || 1.7;
  c.setLineDash(s.dashes || []);
  c.beginPath();
  let pen = false;
  for (let i = 0; i < s.x.length; i++) {
    if (!Number.isFinite(s.y[i])) { pen = false; continue; }
    if (pen) c.lineTo(X(s.x[i]), Y(s.y[i]));
    else c.moveTo(X(s.x[i]), Y(s.y[i]));
    pen = true;
  }
  c.stroke();
  c.setLineDash([]);
}
function markScan(c, s, X, Y) {
  const scan = state.hover ?? state.scan;
  if (!s.index || scan == null) return;
  const i = s.index(scan);
  if (i < 0 || !Number.isFinite(s.y[i])) return;
  c.fillStyle = s.colour || colourOf(s.row);
  c.strokeStyle = css("--card");
  c.lineWidth = 1.5;
  c.beginPath();
  c.arc(X(s.x[i]), Y(s.y[i]), 4.5, 0, 2 * Math.PI);
  c.fill();
  c.stroke();
}

const curveDraws = [];
async function drawCurves() {
  const picked = [...state.picked], runs = await Promise.all(picked.map(openRun));
  if (picked.join() !== state.picked.join()) return;
  const shown = picked.map((row, i) => ({ row, run: runs[i] })).filter((p) => p.run);
  const metres = await Promise.all(shown.map(({ run }) => unpack(DATA.scenes[run.scene]?.metres)));
  const box = byId("curves");
  box.replaceChildren();
  curveDraws.length = 0;
  const chart = (title, series, options) => {
    if (!series.length) return;
    const canvas = el("canvas", { role: "img", "aria-label": title });
    box.append(el("h3", null, title), canvas);
    curveDraws.push(lineChart(canvas, series, options));
  };
  const over = ({ row, run }, values) => ({ row, x: Float32Array.from({ length: run.n }, (_, i) => run.at(i)), y: values, scan: run.at, index: run.indexOf, dashes: lookOf(row).dashes });
  const pathOf = (p) => { const known = metres[shown.indexOf(p)]; return known ? Float32Array.from({ length: p.run.n }, (_, i) => known[p.run.at(i)]) : p.run.metres; };
  chart("Error over the path", shown.filter((p) => p.run.error).map((p) => ({ ...over(p, p.run.error), x: pathOf(p) })), { x: metres.some(Boolean) ? "true path travelled (m)" : "path travelled, by estimate (m)", y: "position (m)", from: 0, unit: "m", mayLog: true });
  chart("Error of relations", shown.filter((p) => p.run.relations).map((p) => ({ row: p.row, dots: true, x: p.run.relations.scan, y: p.run.relations.error, scan: (i) => p.run.relations.scan[i] })), { x: "scan of the later end", y: "|E| (m)", from: 0 });
  chart("Gap to the model scan", shown.filter((p) => p.run.gap).map((p) => ({ ...over(p, Float32Array.from(p.run.gap, (g) => g || NaN)), dots: true })), { x: "scan", y: "gap (scans)", from: 0, unit: "scans" });
  const scored = shown.filter((p) => p.run.score?.some(Number.isFinite));
  const bounds = new Set(scored.map((p) => DATA.rows[p.row].cells.threshold).filter((v) => typeof v === "number"));
  chart("Similarity to the model scan", scored.map((p) => ({ ...over(p, p.run.score), dots: true })), { x: "scan", y: "S", line: bounds.size === 1 ? [...bounds][0] : null });
  if (!shown.length) box.append(el("p", { class: "quiet" }, "Nothing is picked that has a path."));
}
on("pick theme", drawCurves);
on("hover scan resize", () => curveDraws.forEach((draw) => draw()));
on("pick theme filter data", drawScatter);

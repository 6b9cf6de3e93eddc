// What all parts of the page share: the data, what is chosen, elements, numbers, colours.
const DATA = JSON.parse(document.getElementById("data-of-page").textContent);
const state = { picked: [], focus: null, scan: 0, hover: null, data: null };
const hooks = {};
const on = (names, act) => names.split(" ").forEach((name) => (hooks[name] ||= []).push(act));
const emit = (name) => (hooks[name] || []).forEach((act) => act());
const byId = (id) => document.getElementById(id);

// Text goes in as text alone: whatever a run is called, it is no markup.
function fill(node, props, children) {
  for (const [key, value] of Object.entries(props || {})) {
    if (key.startsWith("on")) node.addEventListener(key.slice(2), value);
    else if (key === "style") Object.assign(node.style, value);
    else if (value === true) node.setAttribute(key, "");
    else if (value !== false && value != null) node.setAttribute(key, value);
  }
  node.append(...children.flat().filter((child) => child != null && child !== ""));
  return node;
}
const el = (tag, props, ...children) => fill(document.createElement(tag), props, children);
const svg = (tag, props, ...children) => fill(document.createElementNS("http://www.w3.org/2000/svg", tag), props, children);

// Deflated base64 to a typed array, once; integers were written as differences.
const KINDS = { i8: Int8Array, u8: Uint8Array, i16: Int16Array, i32: Int32Array, f32: Float32Array };
const unpacked = new Map();
function unpack(packed) {
  if (!packed) return Promise.resolve(null);
  if (!unpacked.has(packed)) unpacked.set(packed, inflate(packed));
  return unpacked.get(packed);
}
async function inflate({ t, d, z }) {
  const text = atob(z), bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
  const values = new KINDS[t](await new Response(stream).arrayBuffer());
  if (d) for (let i = d; i < values.length; i++) values[i] += values[i - d];
  return values;
}

// A run with its arrays unpacked, once. Poses are column by column; kept: which scans they are of.
const opened = new Map();
function openRun(row) {
  if (!opened.has(row)) opened.set(row, readRun(DATA.runs[row]));
  return opened.get(row);
}
async function readRun(run) {
  if (!run) return null;
  const names = ["poses", "kept", "error", "gap", "score", "fitness", "inlier_rmse_m", "rejected", "targets"];
  const [arrays, status, reason, recovered, relations] = await Promise.all([
    Promise.all(names.map((name) => unpack(run[name]))),
    unpack(run.status?.codes), unpack(run.reason?.codes), unpack(run.recovered?.codes),
    Promise.all(["scan", "error", "long"].map((name) => unpack(run.relations?.[name]))),
  ]);
  const out = { ...run, ...Object.fromEntries(names.map((name, i) => [name, arrays[i]])) };
  const n = (out.n = out.poses.length / (run.planar ? 3 : 7));
  out.x = out.poses.subarray(0, n);
  out.y = out.poses.subarray(n, 2 * n);
  out.z = run.planar ? null : out.poses.subarray(2 * n, 3 * n);
  out.metres = new Float32Array(n);
  for (let i = 1; i < n; i++) out.metres[i] = out.metres[i - 1] + Math.hypot(out.x[i] - out.x[i - 1], out.y[i] - out.y[i - 1], out.z ? out.z[i] - out.z[i - 1] : 0);
  out.at = (i) => (out.kept ? out.kept[i] : i);
  out.indexOf = (scan) => (out.kept ? nearest(out.kept, scan) : Math.min(scan, n - 1));
  out.word = (name, i) => run[name].words[{ status, reason, recovered }[name][i]];
  out.model = (i) => (out.gap && out.gap[i] ? i - out.gap[i] : -1);
  out.relations = run.relations && { scan: relations[0], error: relations[1], long: relations[2] };
  return out;
}
function nearest(sorted, value) {
  let low = 0, high = sorted.length - 1;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (sorted[middle] < value) low = middle + 1;
    else high = middle;
  }
  return low > 0 && value - sorted[low - 1] < sorted[low] - value ? low - 1 : low;
}

// The pose of scan i as a row-major 3 x 4 motion.
function poseOf(values, n, i, planar) {
  const at = (k) => values[k * n + i];
  if (planar) {
    const c = Math.cos(at(2)), s = Math.sin(at(2));
    return [c, -s, 0, at(0), s, c, 0, at(1), 0, 0, 1, 0];
  }
  const [x, y, z, w] = [3, 4, 5, 6].map(at);
  return [
    1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w), at(0),
    2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w), at(1),
    2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y), at(2),
  ];
}
const apply = (T, p) => [0, 4, 8].map((r) => T[r] * p[0] + T[r + 1] * p[1] + T[r + 2] * p[2] + T[r + 3]);
function between(A, B) { // inverse(A) B
  const t = [B[3] - A[3], B[7] - A[7], B[11] - A[11]], out = [];
  for (let r = 0; r < 3; r++) {
    for (let c = 0; c < 3; c++) out.push(A[r] * B[c] + A[4 + r] * B[4 + c] + A[8 + r] * B[8 + c]);
    out.push(A[r] * t[0] + A[4 + r] * t[1] + A[8 + r] * t[2]);
  }
  return out;
}

// Three significant digits, without an exponent for everyday numbers.
function three(value) {
  if (value == null || Number.isNaN(value)) return "";
  if (typeof value !== "number") return String(value);
  if (value === 0) return "0";
  const size = Math.abs(value);
  const text = Number.isInteger(value) && size < 1e6 ? String(value) : size >= 1e6 || size < 1e-4 ? value.toExponential(2) : value.toFixed(Math.max(0, 2 - Math.floor(Math.log10(size))));
  return text.replace("-", "\u2212");
}
function ticks(low, high, many) {
  const raw = (high - low) / many, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].find((f) => f * power >= raw * 0.999) * power, out = [];
  for (let v = Math.ceil(low / step - 1e-9) * step; v <= high + 1e-9 * step; v += step) out.push(Math.abs(v) < 1e-9 * step ? 0 : v);
  return out;
}
function logTicks(low, high) {
  const out = [];
  for (let e = Math.floor(Math.log10(low)); e <= Math.log10(high); e++) for (const f of [1, 2, 5]) out.push(f * 10 ** e);
  const inside = out.filter((v) => v >= low * 0.999 && v <= high * 1.001);
  if (inside.length < 3) return ticks(low, high, 4);
  return inside.length > 7 ? inside.filter((v) => /^1(e|$)/.test(v.toExponential().replace("1.0", "1"))) : inside;
}
const tickText = (v) => (Math.abs(v) >= 1e5 || (v && Math.abs(v) < 1e-3) ? v.toExponential(0) : String(+v.toPrecision(6)).replace("-", "\u2212"));

const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const isDark = () => document.documentElement.dataset.theme === "dark";
function colourOf(row) {
  const index = DATA.colours[DATA.rows[row].cells.backend];
  return index == null ? css("--quiet") : DATA.palette[isDark() ? "dark" : "light"][index];
}
// Backend and selector, with settings only where others share both.
function shortName(row) {
  const { cells, name } = DATA.rows[row], alike = (r) => ["data", "backend", "selector"].every((k) => r.cells[k] === cells[k]);
  return DATA.rows.filter(alike).length > 1 ? name : `${cells.backend} ${cells.selector}`;
}
const lookOf = (row) => DATA.looks[DATA.rows[row].cells.selector] || { marker: "o", dashes: [], filled: true };
const letterOf = (row) => String.fromCharCode(65 + state.picked.indexOf(row));

// matplotlib's markers as SVG paths of about radius r.
function markerPath(kind, r) {
  const ring = (n, turn, radii) => {
    const points = Array.from({ length: n * radii.length }, (_, i) => {
      const a = turn + (2 * Math.PI * i) / (n * radii.length), R = r * radii[i % radii.length];
      return `${(R * Math.cos(a)).toFixed(2)} ${(R * Math.sin(a)).toFixed(2)}`;
    });
    return `M${points.join("L")}Z`;
  };
  const up = -Math.PI / 2, k = 0.9 * r, w = 0.38 * r;
  const shapes = {
    s: () => `M${-k} ${-k}H${k}V${k}H${-k}Z`, "^": () => ring(3, up, [1.2]), v: () => ring(3, -up, [1.2]),
    "<": () => ring(3, Math.PI, [1.2]), ">": () => ring(3, 0, [1.2]), D: () => ring(4, 0, [1.2]), d: () => ring(4, up, [1.3, 0]).replace(/.*/, `M0 ${-1.3 * r}L${0.8 * r} 0L0 ${1.3 * r}L${-0.8 * r} 0Z`),
    h: () => ring(6, up, [1.1]), H: () => ring(6, 0, [1.1]), p: () => ring(5, up, [1.1]), "*": () => ring(5, up, [1.4, 0.6]),
    x: () => `M${-k} ${-k}L${k} ${k}M${-k} ${k}L${k} ${-k}`, "+": () => `M${-r} 0H${r}M0 ${-r}V${r}`,
    P: () => `M${-w} ${-r}H${w}V${-w}H${r}V${w}H${w}V${r}H${-w}V${w}H${-r}V${-w}H${-w}Z`,
    X: () => ring(4, up / 2, [1.3, 0.5]),
  };
  return (shapes[kind] || (() => `M${-r} 0A${r} ${r} 0 1 0 ${r} 0A${r} ${r} 0 1 0 ${-r} 0Z`))();
}
function swatch(row) {
  const look = lookOf(row), colour = colourOf(row);
  return svg("svg", { width: 34, height: 14, viewBox: "-17 -7 34 14", class: "swatch", style: { width: "34px" }, "aria-hidden": "true" },
    svg("path", { d: "M-16 0H16", stroke: colour, "stroke-width": 2, "stroke-dasharray": look.dashes.join(" ") || "none" }),
    svg("path", { d: markerPath(look.marker, 4.2), fill: look.filled ? colour : css("--card"), stroke: colour, "stroke-width": 1.6 }));
}
const key = (mark, text) => el("span", { class: "key" }, mark, text);
const dash = (colour, dashes, shape) => svg("svg", { width: 26, height: 12, viewBox: "-13 -6 26 12", style: { width: "26px" }, "aria-hidden": "true" },
  shape ? svg("path", { d: markerPath(shape, 4), fill: shape === "o" ? "none" : colour, stroke: colour, "stroke-width": 1.6 })
    : svg("path", { d: "M-12 0H12", stroke: colour, "stroke-width": 2, "stroke-dasharray": dashes || "none" }));

// A command with a button that copies it.
function command(text) {
  const button = el("button", { type: "button", onclick: async () => {
    try { await navigator.clipboard.writeText(text); } catch { byHand(text); }
    button.textContent = "copied";
    setTimeout(() => (button.textContent = "copy"), 1500);
  } }, "copy");
  return [el("code", null, text), button];
}
function byHand(text) { // where the clipboard is not given to a file
  const area = el("textarea", { style: { position: "fixed", opacity: "0" } });
  area.value = text;
  document.body.append(area);
  area.select();
  document.execCommand("copy");
  area.remove();
}

const tip = byId("tip");
function showTip(text, x, y) {
  tip.hidden = !text;
  tip.textContent = text || "";
  const w = tip.offsetWidth, h = tip.offsetHeight;
  tip.style.left = `${Math.max(4, Math.min(x + 14, innerWidth - w - 8))}px`;
  tip.style.top = `${y + 18 + h > innerHeight ? y - h - 10 : y + 18}px`;
}

// A canvas as sharp as the screen; draw(context, width, height) in CSS pixels.
function onCanvas(canvas, draw) {
  const box = canvas.getBoundingClientRect(), ratio = Math.min(devicePixelRatio || 1, 2);
  const w = Math.max(1, Math.round(box.width)), h = Math.max(1, Math.round(box.height));
  canvas.width = w * ratio;
  canvas.height = h * ratio;
  const context = canvas.getContext("2d", { willReadFrequently: canvas.id === "plane" });
  context.scale(ratio, ratio);
  context.font = "12px system-ui, 'DejaVu Sans', sans-serif";
  context.fillStyle = css("--card");
  context.fillRect(0, 0, w, h);
  draw(context, w, h);
}

// A plane, or space seen from a side, in one scale for all axes: dragged, zoomed, turned.
class View {
  constructor(canvas, draw) {
    Object.assign(this, { canvas, draw, centre: [0, 0, 0], scale: 10, turn: 0, tilt: Math.PI / 2, space: false });
    const pointers = new Map();
    canvas.addEventListener("wheel", (event) => { event.preventDefault(); this.zoom(Math.exp(-0.0015 * event.deltaY), event); }, { passive: false });
    canvas.addEventListener("pointerdown", (event) => { pointers.set(event.pointerId, event); this.moved = false; canvas.setPointerCapture(event.pointerId); });
    canvas.addEventListener("pointermove", (event) => {
      const before = pointers.get(event.pointerId);
      if (!before) return this.onhover?.(event);
      if (pointers.size === 2) {
        const other = [...pointers.values()].find((p) => p.pointerId !== event.pointerId);
        const span = (p) => Math.hypot(p.clientX - other.clientX, p.clientY - other.clientY);
        this.zoom(span(event) / Math.max(span(before), 1), event);
      } else this.drag(event.clientX - before.clientX, event.clientY - before.clientY, event.shiftKey);
      if (Math.hypot(event.clientX - before.clientX, event.clientY - before.clientY) > 0) this.moved = true;
      pointers.set(event.pointerId, event);
    });
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => pointers.delete(event.pointerId));
    canvas.addEventListener("click", (event) => { if (!this.moved) this.onpick?.(event); });
    canvas.addEventListener("dblclick", () => { this.fit(this.bounds); });
    canvas.addEventListener("keydown", (event) => {
      const moves = { ArrowLeft: [40, 0], ArrowRight: [-40, 0], ArrowUp: [0, 40], ArrowDown: [0, -40] }[event.key];
      if (moves) this.drag(...moves, event.shiftKey);
      else if (event.key === "+" || event.key === "=") this.zoom(1.25);
      else if (event.key === "-") this.zoom(0.8);
      else if (event.key === "0") this.fit(this.bounds);
      else return;
      event.preventDefault();
      event.stopPropagation();
    });
  }
  get size() { const box = this.canvas.getBoundingClientRect(); return [box.width, box.height]; }
  // Show all of [[x0, y0, z0], [x1, y1, z1]].
  fit(bounds) {
    this.bounds = bounds;
    if (!bounds || !Number.isFinite(bounds[0][0])) return;
    const [w, h] = this.size, span = bounds[1].map((v, i) => Math.max(v - bounds[0][i], 0.02));
    this.centre = bounds[0].map((v, i) => (v + bounds[1][i]) / 2);
    const across = this.space ? [Math.hypot(span[0], span[1]), Math.hypot(...span)] : span;
    this.scale = Math.min((w - 84) / across[0], (h - 64) / across[1]);
    this.redraw();
  }
  redraw() { onCanvas(this.canvas, (c, w, h) => { this.basis(w, h); this.draw(c, w, h, this); }); }
  basis(w, h) {
    const { scale: k, turn, tilt, centre: o } = this, c = Math.cos(turn), s = Math.sin(turn), up = Math.sin(tilt), z = this.space ? Math.cos(tilt) : 0;
    this.m = [k * c, k * s, 0, 0, k * s * up, -k * c * up, -k * z, 0];
    this.m[3] = w / 2 + 12 - this.m[0] * o[0] - this.m[1] * o[1];
    this.m[7] = h / 2 - 8 - this.m[4] * o[0] - this.m[5] * o[1] - this.m[6] * o[2];
  }
  at(x, y, z = 0) { const m = this.m; return [m[0] * x + m[1] * y + m[3], m[4] * x + m[5] * y + m[6] * z + m[7]]; }
  drag(dx, dy, other) {
    if (this.space && !other) {
      this.turn -= 0.008 * dx;
      this.tilt = Math.min(Math.PI / 2, Math.max(0, this.tilt + 0.008 * dy));
    } else {
      const c = Math.cos(this.turn), s = Math.sin(this.turn), up = this.space ? Math.max(Math.sin(this.tilt), 0.2) : 1;
      const u = -dx / this.scale, v = dy / (this.scale * up);
      this.centre = [this.centre[0] + c * u - s * v, this.centre[1] + s * u + c * v, this.centre[2]];
    }
    this.redraw();
  }
  zoom(factor, event) {
    if (event && !this.space) { // what is under the pointer stays there
      const box = this.canvas.getBoundingClientRect(), dx = event.clientX - box.left - box.width / 2 - 12, dy = event.clientY - box.top - box.height / 2 + 8;
      const far = (1 - 1 / factor) / this.scale;
      this.centre = [this.centre[0] + dx * far, this.centre[1] - dy * far, this.centre[2]];
    }
    this.scale *= factor;
    this.redraw();
  }
  grid(c, w, h) {
    c.fillStyle = css("--quiet");
    c.strokeStyle = css("--grid");
    c.lineWidth = 1;
    if (this.space) return this.bar(c, h);
    const [cx, cy] = this.centre, halfX = w / 2 / this.scale, halfY = h / 2 / this.scale;
    const xs = ticks(cx - halfX, cx + halfX, w / 90), step = xs[1] - xs[0] || 1, ys = [];
    for (let v = Math.ceil((cy - halfY) / step) * step; v < cy + halfY; v += step) ys.push(Math.abs(v) < 1e-9 * step ? 0 : v);
    c.textBaseline = "middle";
    for (const v of ys) { const y = this.at(0, v)[1]; line(c, 34, y, w, y); if (y > 20 && y < h - 40) { c.textAlign = "right"; c.fillText(tickText(+v.toPrecision(9)), 31, y); } }
    for (const v of xs) { const x = this.at(v, 0)[0]; line(c, x, 0, x, h - 20); if (x > 56 && x < w - 58) { c.textAlign = "center"; c.fillText(tickText(v), x, h - 11); } }
    c.textAlign = "left";
    c.fillText("x (m)", w - 32, h - 11);
    c.fillText("y (m)", 2, 8);
  }
  bar(c, h) { // in space a bar says the scale
    const length = ticks(0, 160 / this.scale, 2)[1];
    c.strokeStyle = css("--quiet");
    line(c, 14, h - 14, 14 + length * this.scale, h - 14);
    c.textAlign = "left";
    c.textBaseline = "bottom";
    c.fillText(`${tickText(length)} m; drag turns, shift and drag moves`, 14, h - 18);
  }
}
const rgb = (hex) => { const full = hex.length === 4 ? hex.replace(/\w/g, "$&$&") : hex; return [1, 3, 5].map((i) => parseInt(full.slice(i, i + 2), 16)); };

// Points as pixels, the darker the more of them: layers {points, axes, colour}.
function drawDots(c, view, layers, w, h, weight) {
  const ratio = c.canvas.width / w, W = c.canvas.width, H = c.canvas.height;
  const image = c.getImageData(0, 0, W, H), count = new Uint8Array(W * H), m = view.m;
  for (const { points, axes: stride, colour } of layers) {
    count.fill(0);
    for (let i = 0; i < points.length; i += stride) {
      const z = stride > 2 ? points[i + 2] : 0;
      const x = ((m[0] * points[i] + m[1] * points[i + 1] + m[3]) * ratio) | 0, y = ((m[4] * points[i] + m[5] * points[i + 1] + m[6] * z + m[7]) * ratio) | 0;
      if (x >= 0 && y >= 0 && x < W && y < H && count[y * W + x] < 255) count[y * W + x]++;
    }
    const [r, g, b] = rgb(colour), data = image.data;
    for (let p = 0, q = 0; p < count.length; p++, q += 4) {
      if (!count[p]) continue;
      const a = 1 - (1 - weight) ** count[p];
      data[q] += a * (r - data[q]);
      data[q + 1] += a * (g - data[q + 1]);
      data[q + 2] += a * (b - data[q + 2]);
    }
  }
  c.putImageData(image, 0, 0);
}

// The points of kept scan number k of a scene, in the sensor's frame.
async function openScene(index) {
  const scene = DATA.scenes[index];
  const [xyz, ends, truth] = await Promise.all([unpack(scene?.points?.xyz), unpack(scene?.points?.ends), unpack(scene?.truth)]);
  return { ...scene, xyz, ends, truth };
}
function pointsOf(scene, scan) {
  const { every, axes, scale } = scene.points, k = scan / every;
  if (!Number.isInteger(k) || k >= scene.ends.length) return null;
  const from = (k ? scene.ends[k - 1] : 0) * axes, out = [];
  for (let i = from; i < scene.ends[k] * axes; i += axes) out.push([scene.xyz[i] * scale, scene.xyz[i + 1] * scale, axes > 2 ? scene.xyz[i + 2] * scale : 0]);
  return out;
}
const MAP_POINTS = 160000;
const maps = new Map();
async function mapOf(row) {
  if (!maps.has(row)) maps.set(row, makeMap(row));
  return maps.get(row);
}
async function makeMap(row) {
  const run = await openRun(row), own = DATA.runs[row].map;
  if (own) {
    const xy = await unpack(own.xy);
    return { points: Float32Array.from(xy, (v) => v * own.scale), axes: 2, note: own.note };
  }
  if (run.scene == null) return null;
  const scene = await openScene(run.scene);
  if (!scene.xyz) return null;
  const { axes, scale, every } = scene.points, total = scene.xyz.length / axes, step = Math.ceil(total / MAP_POINTS);
  const points = new Float32Array(Math.ceil(total / step) * axes);
  let k = 0, T = null, from = -1;
  for (let i = 0, o = 0; i < total; i += step, o += axes) {
    while (i >= scene.ends[k]) k++;
    if (from !== k) { T = poseOf(run.poses, run.n, Math.min(k * every, run.n - 1), run.planar); from = k; }
    const p = apply(T, [scene.xyz[i * axes] * scale, scene.xyz[i * axes + 1] * scale, axes > 2 ? scene.xyz[i * axes + 2] * scale : 0]);
    for (let a = 0; a < axes; a++) points[o + a] = p[a];
  }
  return { points, axes, note: `${points.length / axes} of ${total} points drawn` };
}

const plane = { shown: [], maps: [], truths: [] };
function boundsOf(runs) {
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
  for (const run of runs) for (const [a, values] of [run.x, run.y, run.z || [0]].entries()) for (const v of values) { if (v < low[a]) low[a] = v; if (v > high[a]) high[a] = v; }
  return [low, high];
}
function drawPath(c, view, run, colour, width, dashes, step = 1) {
  const points = [];
  for (let i = 0; i < run.x.length; i += step) points.push(view.at(run.x[i], run.y[i], run.z ? run.z[i] : 0));
  stroke(c, colour, width, dashes, points);
  return points;
}
function mark(c, [x, y], kind, r, colour, filled) {
  c.save();
  c.translate(x, y);
  c.lineWidth = 1.8;
  c.strokeStyle = colour;
  c.fillStyle = filled ? colour : css("--card");
  const path = new Path2D(markerPath(kind, r));
  c.fill(path);
  c.stroke(path);
  c.restore();
}
const planeView = new View(byId("plane"), (c, w, h, view) => {
  view.grid(c, w, h);
  const layers = byId("with-map").checked ? plane.maps.map((map, i) => map && { ...map, colour: colourOf(plane.shown[i].row) }).filter(Boolean).reverse() : [];
  if (layers.length) drawDots(c, view, layers, w, h, layers.some((l) => l.points.length > 60000) ? 0.22 : 0.5);
  for (const truth of plane.truths) { c.globalAlpha = 0.55; drawPath(c, view, truth, css("--quiet"), 7, []); c.globalAlpha = 1; }
  const letters = [];
  for (const { row, run } of [...plane.shown].reverse()) {
    const look = lookOf(row), points = drawPath(c, view, run, colourOf(row), 2, look.dashes);
    mark(c, points.at(-1), look.marker, 5, colourOf(row), look.filled);
    c.fillStyle = css("--ink");
    c.textAlign = "left";
    let [x, y] = [points.at(-1)[0] + 9, points.at(-1)[1] - 9];
    while (letters.some((other) => Math.abs(other[0] - x) < 10 && Math.abs(other[1] - y) < 12)) x += 11;
    letters.push([x, y]);
    c.fillText(letterOf(row), x, y);
  }
  const scan = state.hover ?? state.scan;
  for (const { row, run } of plane.shown) {
    const i = run.indexOf(scan);
    mark(c, view.at(run.x[i], run.y[i], run.z ? run.z[i] : 0), "o", 5.5, colourOf(row), true);
  }
  if (plane.shown.length) { const { run } = plane.shown[0]; mark(c, view.at(run.x[0], run.y[0], run.z ? run.z[0] : 0), "^", 5, css("--ink"), false); }
});
planeView.onhover = (event) => {
  const box = planeView.canvas.getBoundingClientRect(), [px, py] = [event.clientX - box.left, event.clientY - box.top];
  let best = null;
  for (const { row, run } of plane.shown) for (let i = 0; i < run.n; i++) {
    const [x, y] = planeView.at(run.x[i], run.y[i], run.z ? run.z[i] : 0), far = (x - px) ** 2 + (y - py) ** 2;
    if (far < 625 && (!best || far < best.far)) best = { far, row, scan: run.at(i) };
  }
  if (!best && state.hover == null) return;
  state.hover = best ? best.scan : null;
  showTip(best ? `${letterOf(best.row)}: scan ${best.scan}` : "", event.clientX, event.clientY);
  emit("hover");
};
planeView.onpick = () => { if (state.hover != null) { state.scan = state.hover; emit("scan"); } };
byId("plane").addEventListener("pointerleave", () => { showTip(""); state.hover = null; emit("hover"); });
async function drawPlane() {
  const picked = [...state.picked], runs = await Promise.all(picked.map(openRun));
  const shown = picked.map((row, i) => ({ row, run: runs[i] })).filter((p) => p.run);
  const found = await Promise.all(shown.map(({ row }) => mapOf(row)));
  const scenes = await Promise.all([...new Set(shown.map((p) => p.run.scene).filter((s) => s != null))].map(openScene));
  if (picked.join() !== state.picked.join()) return;
  const truths = scenes.filter((scene) => scene.truth).map((scene) => { const n = scene.truth.length / (scene.planar ? 3 : 7); return { x: scene.truth.subarray(0, n), y: scene.truth.subarray(n, 2 * n), z: scene.planar ? null : scene.truth.subarray(2 * n, 3 * n) }; });
  Object.assign(plane, { shown, maps: found, truths });
  planeView.space = shown.some((p) => !p.run.planar);
  if (planeView.space && planeView.tilt === Math.PI / 2) planeView.tilt = 0.9;
  const notes = scenes.map((scene) => scene.note || scene.points?.thinned && `this page keeps ${scene.points.thinned}`);
  const words = [truths.length && "pale band: the truth", ...notes, ...new Set(found.filter(Boolean).map((map) => map.note)), shown.some((p) => !p.run.whole) && "thin paths: rows kept without their scans"];
  byId("plane-note").textContent = words.filter(Boolean).join("; ");
  planeView.fit(boundsOf([...shown.map((p) => p.run), ...truths, ...found.filter((map) => map && map.points.length).map(coreOf)]));
}
// Where a map's points lie, but for the outermost of either side.
function coreOf(map) {
  const axis = (a) => { const values = []; for (let i = a; i < map.points.length; i += map.axes * Math.ceil(map.points.length / 20000)) values.push(map.points[i]); values.sort((x, y) => x - y); return [values[Math.floor(0.01 * values.length)], values[Math.floor(0.99 * values.length)]]; };
  return { x: axis(0), y: axis(1), z: map.axes > 2 ? axis(2) : [0] };
}
on("pick", drawPlane);
on("theme hover scan resize", () => planeView.redraw());
byId("with-map").addEventListener("change", () => planeView.redraw());

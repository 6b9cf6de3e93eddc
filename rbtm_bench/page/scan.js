// One scan: the pair before and after, the window it was chosen from, the chain to the start.
const FATES = ["not chosen", "passed, not needed", "refused", "model scan", "no defined score"];
const [BELOW, PASSED, REFUSED, CHOSEN, UNDEFINED] = FATES.keys();
const view = { run: null, scene: null, choices: null, curve: null, pair: null };

async function openChoices(run) {
  const given = run?.choices;
  if (!given) return null;
  const [counts, gaps, scores, fates, guess] = await Promise.all(["counts", "gaps", "scores", "fates", "guess"].map((name) => unpack(given[name])));
  const starts = new Int32Array(counts.length + 1);
  for (let i = 0; i < counts.length; i++) starts[i + 1] = starts[i] + counts[i];
  const of = (j) => Array.from({ length: counts[j] || 0 }, (_, k) => {
    const at = starts[j] + k, score = scores[at];
    return { model: j - gaps[at], score: score === -32768 ? NaN : score * 1e-4, fate: fates[at] };
  });
  return { ...given, of, guess };
}
async function openFocus() {
  const row = state.focus, run = row == null ? null : await openRun(row);
  const scene = run?.scene == null ? null : await openScene(run.scene);
  const choices = await openChoices(run);
  const curve = run?.curve == null ? null : DATA.scenes[run.scene].curves[run.curve];
  const values = curve && (await unpack(curve.values));
  if (row !== state.focus) return;
  Object.assign(view, { run, scene, choices, curve: curve && { ...curve, values }, steps: run && jumps(run, choices) });
  byId("focus").replaceChildren(...DATA.rows.map((r, i) => DATA.runs[i]?.whole && el("option", { value: i, selected: i === row }, r.name)).filter(Boolean));
  byId("scan-body").hidden = !run;
  if (!run) return;
  state.scan = Math.min(state.scan, run.n - 1);
  byId("slider").max = byId("scan-number").max = run.n - 1;
  chainView.space = pairView.space = !run.planar;
  for (const one of [chainView, pairView]) if (one.space && one.tilt === Math.PI / 2) one.tilt = 0.9;
  chainView.fit(boundsOf([run]));
  view.pair = null;
  drawScan();
}
// Scans worth a look, for "next".
function jumps(run, choices) {
  const of = { refused: [], fallback: [], younger: [] };
  for (let i = 1; i < run.n; i++) {
    if (run.rejected[i]) of.refused.push(i);
    if (run.word("status", i) !== "registered") of.fallback.push(i);
    const oldest = choices && choices.of(i)[0];
    if (oldest && run.model(i) > oldest.model) of.younger.push(i);
  }
  for (const option of byId("jump-to").options) option.textContent = `${option.textContent.replace(/ \(\d+\)$/, "")} (${of[option.value].length})`;
  return of;
}
const reasonOf = (run, i, model) => (run.refused[i] || "").split("\n").find((text) => text.startsWith(`${model}: `))?.slice(String(model).length + 2);
const toScan = (scan) => el("button", { type: "button", class: "jump", onclick: () => { state.scan = scan; emit("scan"); } }, String(scan));

function drawScan() {
  const { run, choices } = view, i = state.scan;
  if (!run || i >= run.n) return;
  byId("slider").value = byId("scan-number").value = i;
  byId("slider").setAttribute("aria-valuetext", `scan ${i} of ${run.n}`);
  const candidates = choices ? choices.of(i) : [];
  byId("why").replaceChildren(...sentence(i, candidates));
  drawPair(i);
  drawWindow(i, candidates);
  drawChain(i);
  drawDescriptors(i);
}
// Why this model scan, in words.
function sentence(i, candidates) {
  const { run, choices } = view, model = run.model(i), status = run.word("status", i), reason = run.word("reason", i);
  if (i === 0) return ["Scan 0 is the start: its pose is the origin."];
  if (model < 0) return [`Scan ${i} has no model scan (${status}${reason ? `: ${reason}` : ""}): its pose is a prediction from scan ${i - 1}. `, ...refusals(i)];
  const out = [el("b", null, `Scan ${i} was registered to scan `), toScan(model), el("b", null, `, ${i - model} back`)];
  const scored = Number.isFinite(run.score[i]);
  out.push(scored ? `: similarity ${three(run.score[i])}` : "", reason ? ` (${reason})` : "", ". ");
  const older = candidates.filter((c) => c.model < model);
  if (candidates.length) {
    const passed = candidates.filter((c) => [PASSED, REFUSED, ...(status === "fallback" ? [] : [CHOSEN])].includes(c.fate)).length;
    const count = (fate, words) => { const n = older.filter((c) => c.fate === fate).length; return n ? `${n} ${words}` : null; };
    const why = [count(BELOW, "did not pass"), count(REFUSED, "refused"), count(UNDEFINED, "without a score"), count(PASSED, choices.triesAll ? "registered too, but not picked" : "passed")].filter(Boolean);
    out.push(choices.scored ? `${passed} of ${candidates.length} scans in the window passed. ` : `The window held ${candidates.length}. `, older.length ? `Of the ${older.length} older ones: ${why.join(", ")}. ` : "None in the window is older. ");
  }
  if (status === "fallback") out.push("It was the fallback. ");
  if (run.word("recovered", i)) out.push(`Recovered from ${run.word("recovered", i)}. `);
  out.push(`Fitness ${three(run.fitness[i])}, inlier RMSE ${three(1e3 * run.inlier_rmse_m[i])} mm${run.error ? `, position error ${three(run.error[i])} m` : ""}. `);
  return [...out, ...refusals(i)];
}
function refusals(i) {
  const { run } = view;
  if (!run.rejected[i]) return [];
  const known = (run.refused[i] || "").split("\n").filter(Boolean);
  return [el("span", { class: "bad" }, `Refused: ${known.length ? known.join("; ") : `${run.rejected[i]} registrations, the run does not say why`}. `)];
}

const pairView = new View(byId("pair"), (c, w, h, v) => {
  v.grid(c, w, h);
  if (!view.pair) return;
  const { target, before, after } = view.pair, put = (points, draw) => points?.forEach((p) => draw(...v.at(...p)));
  const small = (target?.length || 0) > 700, r = small ? 1.2 : 2;
  c.fillStyle = css("--quiet");
  put(target, (x, y) => c.fillRect(x - r, y - r, 2 * r, 2 * r));
  c.strokeStyle = tone(3);
  c.lineWidth = 1;
  put(before, (x, y) => { c.beginPath(); c.arc(x, y, small ? 1.6 : 2.8, 0, 7); c.stroke(); });
  c.fillStyle = tone(0);
  put(after, (x, y) => { c.beginPath(); c.arc(x, y, small ? 1.1 : 1.9, 0, 7); c.fill(); });
  mark(c, v.at(0, 0, 0), "^", 5, css("--ink"), false);
  if (view.pair.pose) mark(c, v.at(view.pair.pose[3], view.pair.pose[7], view.pair.pose[11]), "D", 4.5, tone(0), true);
});
const tone = (index) => DATA.palette[isDark() ? "dark" : "light"][index];
function drawPair(i) {
  const { run, scene, choices } = view, model = run.model(i), other = model < 0 ? Math.max(i - 1, 0) : model;
  const own = scene?.xyz && pointsOf(scene, i), target = scene?.xyz && pointsOf(scene, other);
  const T = between(poseOf(run.poses, run.n, other, run.planar), poseOf(run.poses, run.n, i, run.planar));
  const guess = choices?.guess && i ? poseOf(choices.guess, run.n, i, run.planar) : null;
  const move = (M) => own && M && own.map((p) => apply(M, p));
  const first = !view.pair || view.pair.target == null;
  view.pair = { own, target, before: move(guess), after: move(T), pose: T };
  const words = [
    scene?.note, scene?.xyz && !own && `of this data set every ${scene.points.every}th scan is kept: not this one`,
    target && `frame of ${model < 0 ? "the scan before" : "the model scan"} (\u25B3); \u25C6 where the new scan ended`,
    own && run.targets[i] > 1 && `the target was made of ${run.targets[i]} scans: the model scan alone is drawn`,
    guess && `the guess was off by ${three(1e3 * Math.hypot(guess[3] - T[3], guess[7] - T[7], guess[11] - T[11]))} mm`,
    ...(choices?.notes || []), scene?.points?.thinned && `thinned to ${scene.points.thinned}`,
  ];
  byId("pair-note").textContent = words.filter(Boolean).join("; ");
  byId("pair-keys").replaceChildren(key(el("span", { style: { width: "8px", height: "8px", background: css("--quiet"), display: "inline-block" } }), `scan ${other}`),
    key(dash(tone(3), "", "o"), `scan ${i} as guessed`), key(dash(tone(0), "", "D"), "as registered"));
  const all = [...(target || []), ...(view.pair.after || [])];
  const core = (a, share) => { const values = [...all.map((p) => p[a]), 0, T[4 * a + 3]].sort((x, y) => x - y); return values[Math.round(share * (values.length - 1))]; };
  const bounds = [[0, 1, 2].map((a) => Math.min(core(a, 0.03), 0)), [0, 1, 2].map((a) => Math.max(core(a, 0.97), 0))];
  if (first || !pairView.moved) { pairView.fit(bounds); pairView.moved = false; } else { pairView.bounds = bounds; pairView.redraw(); }
}
function drawWindow(i, candidates) {
  const { run, choices } = view, box = byId("window"), W = 620, H = 300, L = 48, B = 42, T = 8, R = 12;
  const note = run.unreplayed || (!choices && view.scene?.note) || (!choices && "no candidates are kept");
  const others = choices?.others ? `${choices.others} scans come out with another model scan than stored; ` : "";
  const kept = choices && choices.every > 1 && i % choices.every ? `candidates are kept for every ${choices.every}th scan; ` : "";
  byId("window-keys").textContent = choices ? `${others}${kept}window ${choices.window}, fallback ${choices.fallback}` : "";
  byId("candidates").replaceChildren();
  if (!candidates.length) return box.replaceChildren(el("p", { class: "quiet" }, note || "Nothing was asked of the window for this scan."));
  const finite = candidates.map((c) => c.score).filter(Number.isFinite), bound = typeof choices.threshold === "number" ? choices.threshold : null;
  const known = [...finite, ...(bound == null ? [] : [bound])], top = Math.max(...known, -1), low = Math.min(...known, 1);
  const [y0, y1] = known.length ? [low - Math.max(0.15 * (top - low), 0.02), Math.min(top + Math.max(0.1 * (top - low), 0.02), Math.max(top, 1.005))] : [0, 1], x0 = candidates[0].model - 0.5, x1 = candidates.at(-1).model + 0.5;
  const X = (v) => L + ((W - L - R) * (v - x0)) / (x1 - x0), Y = (v) => H - B - ((H - B - T) * ((Number.isFinite(v) ? v : y0) - y0)) / (y1 - y0);
  const out = svg("svg", { viewBox: `0 0 ${W} ${H}`, role: "img", "aria-label": "Similarity of each scan of the window" });
  for (const v of ticks(y0, y1, 5)) out.append(svg("path", { class: "grid", d: `M${L} ${Y(v)}H${W - R}` }), svg("text", { x: L - 7, y: Y(v) + 4, "text-anchor": "end" }, tickText(v)));
  for (const v of ticks(x0, x1, 8).filter(Number.isInteger)) out.append(svg("text", { x: X(v), y: H - B + 18, "text-anchor": "middle" }, String(v)));
  out.append(svg("text", { x: (L + W - R) / 2, y: H - 4, "text-anchor": "middle" }, "scan in the window, oldest left"), svg("text", { transform: `translate(12 ${(T + H - B) / 2}) rotate(-90)`, "text-anchor": "middle" }, choices.scored ? "similarity S" : "no similarity was asked for"));
  if (bound != null && choices.scored) out.append(svg("path", { d: `M${L} ${Y(bound)}H${W - R}`, stroke: css("--ink"), "stroke-dasharray": "6 4" }));
  const r = candidates.length > 60 ? 3 : 5;
  const looks = { [BELOW]: ["o", css("--quiet"), false], [PASSED]: ["o", tone(0), true], [REFUSED]: ["x", css("--bad"), false], [CHOSEN]: ["D", tone(1), true], [UNDEFINED]: ["+", css("--quiet"), false] };
  const mark = (kind, colour, filled) => ({ d: markerPath(kind, r), fill: filled ? colour : css("--card"), stroke: colour, "stroke-width": 1.8 });
  for (const c of [...candidates].sort((a, b) => a.fate - b.fate)) {
    const words = `scan ${c.model}, ${i - c.model} back: ${choices.scored ? `S ${three(c.score) || "undefined"}, ` : ""}${fateWords(c)}`;
    out.append(svg("path", { ...mark(...looks[c.fate]), transform: `translate(${X(c.model)} ${Y(c.score)})`, onpointermove: (event) => showTip(words, event.clientX, event.clientY), onpointerleave: () => showTip("") }));
  }
  const seen = [...new Set(candidates.map((c) => c.fate))].sort();
  box.replaceChildren(out, el("div", null, seen.map((fate) => key(svg("svg", { width: 16, height: 14, viewBox: "-8 -7 16 14", style: { width: "16px" } }, svg("path", mark(...looks[fate]))), fateWords({ fate }))), bound != null && choices.scored ? key(dash(css("--ink"), "6 4"), `threshold ${three(bound)}`) : ""));
  byId("candidates").append(el("table", null, candidates.map((c) => el("tr", { class: c.fate === CHOSEN && "chosen" }, el("td", null, "scan ", toScan(c.model)), el("td", null, `${i - c.model} back`), el("td", null, choices.scored ? `S ${three(c.score) || "undefined"}` : ""), el("td", null, fateWords(c), c.fate === REFUSED ? `: ${reasonOf(run, i, c.model) || "the run does not say why"}` : "")))));
}
function fateWords({ fate, score }) {
  if (fate === PASSED && view.choices.triesAll) return "registered, not picked";
  if (fate === BELOW && view.choices.scored && typeof view.choices.threshold === "number") return score > view.choices.threshold ? "not chosen" : "below the threshold";
  return FATES[fate];
}

const chainView = new View(byId("chain"), (c, w, h, v) => {
  const { run, path } = view;
  v.grid(c, w, h);
  if (!run) return;
  drawPath(c, v, run, css("--quiet"), 1, []);
  const at = (i) => v.at(run.x[i], run.y[i], run.z ? run.z[i] : 0), points = (path || []).map(at);
  stroke(c, tone(1), 2.4, [], points);
  for (const point of points.length < 400 ? points : []) { c.fillStyle = tone(1); c.beginPath(); c.arc(...point, 2.6, 0, 7); c.fill(); }
  mark(c, at(0), "^", 5, css("--ink"), false);
  mark(c, at(state.scan), "D", 5.5, tone(1), true);
});
const ENDS = 14;
function drawChain(i) {
  const { run } = view, path = [i];
  while (path.at(-1) > 0 && path.length <= run.n) { const last = path.at(-1), model = run.model(last); path.push(model < 0 ? last - 1 : model); }
  view.path = path;
  const shown = path.length > ENDS + 3 ? [...path.slice(0, ENDS), null, ...path.slice(-2)] : path;
  const children = [];
  for (let k = i + 1; k < Math.min(run.n, i + 2000); k++) if (run.model(k) === i) children.push(k);
  byId("chain-text").replaceChildren(el("b", null, `${path.length - 1} hops: `), ...shown.flatMap((scan, k) => [k ? " \u2190 " : "", scan == null ? `${path.length - shown.length + 1} more` : toScan(scan)]),
    el("br"), children.length ? el("span", null, `It is itself the model scan of ${children.length}: `, ...children.slice(0, 8).flatMap((scan, k) => [k ? ", " : "", toScan(scan)]), children.length > 8 ? ", \u2026" : "") : "No other scan was registered to it.");
  chainView.redraw();
}
function drawDescriptors(i) {
  const { run, scene, curve } = view, model = run.model(i);
  const of = (scan) => { const k = scan / (scene?.points?.every || 1); return curve && Number.isInteger(k) && scan >= 0 ? Float32Array.from(curve.values.subarray(k * curve.columns, (k + 1) * curve.columns), (v) => (v === -32768 ? NaN : v * curve.scale)) : null; };
  if (!curve && view.choices?.scored && view.pair?.own) return drawBearings(i, model);
  const own = of(i), other = of(model);
  byId("curve-note").textContent = curve ? [curve.columns < curve.of && `${curve.columns} of ${curve.of} values drawn`, !other && i && "no model scan is kept to compare with"].filter(Boolean).join("; ") : view.scene?.note || "this row's choice asks for no similarity";
  byId("curve").hidden = !own;
  byId("curve-keys").replaceChildren();
  if (!own) return;
  byId("curve-keys").append(key(dash(tone(0)), `scan ${i}`), other ? key(dash(tone(1), "5 3"), `scan ${model}`) : "");
  const x = Float32Array.from(own, (_, k) => (k * (curve.of - 1)) / Math.max(own.length - 1, 1));
  const drawn = [{ x, y: own, colour: tone(0), width: 1.4 }, ...(other ? [{ x, y: other, colour: tone(1), width: 1.4, dashes: [5, 3] }] : [])];
  view.curveDraw = lineChart(byId("curve"), drawn, { x: "beam", y: curve.name });
}
// A similarity that compares points has no curve: the points of both by their bearing.
function drawBearings(i, model) {
  const { own, target } = view.pair;
  const polar = (points, colour) => { const p = points.map(([x, y]) => [(Math.atan2(y, x) * 180) / Math.PI, Math.hypot(x, y)]).sort((a, b) => a[0] - b[0]); return { x: Float32Array.from(p, (q) => q[0]), y: Float32Array.from(p, (q) => q[1]), colour, dots: true }; };
  const ranges = own.map(([x, y]) => Math.hypot(x, y)).sort((a, b) => a - b), far = ranges[Math.floor(0.95 * ranges.length)] || 1;
  byId("curve").hidden = false;
  byId("curve-note").textContent = "this similarity compares the points themselves, moved by the initial guess: here each scan's by bearing";
  byId("curve-keys").replaceChildren(key(dash(tone(0)), `scan ${i}`), target ? key(dash(tone(1)), `scan ${model}`) : "");
  view.curveDraw = lineChart(byId("curve"), [polar(own, tone(0)), ...(target && model >= 0 ? [polar(target, tone(1))] : [])], { x: "bearing (deg)", y: "range (m)", from: 0, to: 1.3 * far });
}
byId("slider").addEventListener("input", () => { state.scan = +byId("slider").value; emit("scan"); });
byId("scan-number").addEventListener("change", () => { state.scan = Math.max(0, Math.min(+byId("scan-number").value || 0, view.run.n - 1)); emit("scan"); });
byId("focus").addEventListener("change", () => { state.focus = +byId("focus").value; openFocus(); });
byId("jump").addEventListener("click", () => {
  const list = view.steps?.[byId("jump-to").value] || [], next = list.find((scan) => scan > state.scan) ?? list[0];
  if (next != null) { state.scan = next; emit("scan"); }
});
byId("scans").addEventListener("keydown", (event) => {
  if (["INPUT", "SELECT", "CANVAS"].includes(event.target.tagName) || !view.run) return;
  const step = { ArrowLeft: -1, ArrowRight: 1, PageUp: -10, PageDown: 10, Home: -Infinity, End: Infinity }[event.key];
  if (!step) return;
  event.preventDefault();
  state.scan = Math.max(0, Math.min(state.scan + step, view.run.n - 1));
  emit("scan");
});
on("pick theme", openFocus);
on("scan", drawScan);
on("resize", () => { if (view.run) drawScan(); });

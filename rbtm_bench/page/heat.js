// The error over two swept settings, a panel for whatever else tells rows apart.
const VIRIDIS = [[253, 231, 37], [122, 209, 81], [34, 168, 132], [42, 120, 142], [65, 68, 135], [68, 1, 84]];

function drawHeat() {
  const [xKey, yKey] = [byId("axis-x").value, byId("axis-y").value], error = DATA.errors[state.data];
  if (!xKey || !yKey || !error) return byId("heat").replaceChildren();
  const [errorKey, unit, title] = error;
  const rows = DATA.rows.map((r, row) => ({ row, value: r.cells[errorKey], data: r.cells.data, x: r.settings[xKey], y: r.settings[yKey] }))
    .filter((r) => r.data === state.data && r.x != null && r.y != null);
  const values = rows.map((r) => r.value).filter((v) => v != null && v > 0);
  const low = Math.log(Math.min(...values)), high = Math.log(Math.max(...values));
  const shade = (v) => (v == null || !values.length ? null : high > low ? (Math.log(Math.max(v, 1e-12)) - low) / (high - low) : 0);
  const panels = new Map();
  for (const r of rows) {
    const name = ["backend", "selector"].filter((group) => ![xKey, yKey].includes(group)).map((group) => DATA.rows[r.row].cells[group]).join(" ") || "all";
    panels.set(name, [...(panels.get(name) || []), r]);
  }
  const drawn = [...panels].filter(([, cells]) => distinct(cells, "x").length > 1 || distinct(cells, "y").length > 1);
  byId("heat").replaceChildren(...drawn.map(([name, cells]) => heatPanel(name, cells, { xKey, yKey, shade })),
    el("p", { class: "quiet", style: { width: "100%" } }, `${title} (${unit}), dark is large, logarithmic; framed: the least of a panel, chosen on this very data. Of several rows in a cell the best.`));
  if (!drawn.length) byId("heat").replaceChildren(el("p", { class: "quiet" }, "No two settings vary together here: choose other axes."));
}
const distinct = (cells, axis) => [...new Set(cells.map((r) => r[axis]))].sort((a, b) => (typeof a === "number" && typeof b === "number" ? a - b : String(a).localeCompare(String(b))));
function heatPanel(name, cells, { xKey, yKey, shade }) {
  const xs = distinct(cells, "x"), ys = distinct(cells, "y").reverse();
  const known = cells.filter((r) => r.value != null).sort((a, b) => a.value - b.value), best = known[0]?.row;
  const short = (settingKey) => settingKey.split(".").pop().replaceAll("_", " ");
  const lines = ys.map((y) => el("tr", null, el("th", { scope: "row" }, setting(y)), xs.map((x) => {
    const here = [...known, ...cells.filter((r) => r.value == null)].find((r) => r.x === x && r.y === y);
    return el("td", null, here && heatCell(here, best, shade(here.value)));
  })));
  return el("table", { class: "heat" }, el("caption", null, name),
    el("tbody", null, lines, el("tr", null, el("th", null, `${short(yKey)} \u2191`), xs.map((x) => el("th", { class: "across" }, setting(x)))),
      el("tr", null, el("th"), el("th", { class: "across", colspan: xs.length }, `${short(xKey)} \u2192`))));
}
const setting = (value) => (typeof value === "number" ? tickText(value) : String(value));
function heatCell(cell, best, share) {
  const colour = share == null ? null : viridis(share), light = colour && colour[0] * 0.3 + colour[1] * 0.59 + colour[2] * 0.11 > 125;
  return el("button", {
    type: "button", "data-row": cell.row, class: share == null ? "failed" : cell.row === best ? "best" : "",
    style: colour ? { background: `rgb(${colour.map(Math.round).join(" ")})`, color: light ? "#111" : "#fff" } : {},
    title: DATA.rows[cell.row].name,
    onclick: () => { state.picked = []; pick(cell.row, true); byId(DATA.runs[cell.row] ? "compare" : "behind").scrollIntoView(); },
  }, share == null ? "failed" : three(cell.value));
}
function viridis(share) {
  const at = Math.min(Math.max(share, 0), 1) * (VIRIDIS.length - 1), i = Math.min(Math.floor(at), VIRIDIS.length - 2);
  return VIRIDIS[i].map((v, k) => v + (at - i) * (VIRIDIS[i + 1][k] - v));
}
function startHeat() {
  const swept = DATA.axes.length > 1 && DATA.axes.some((axis) => axis.includes("."));
  byId("sweep").hidden = byId("to-sweep").hidden = !swept;
  if (!swept) return;
  for (const [id, start] of [["axis-x", 1], ["axis-y", 0]]) {
    byId(id).replaceChildren(...DATA.axes.map((axis) => el("option", { value: axis }, axis)));
    byId(id).value = DATA.axes[start];
    byId(id).addEventListener("change", drawHeat);
  }
  on("data theme", drawHeat);
}

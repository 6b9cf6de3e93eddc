// The table of methods: sorted, filtered, its rows picked.
const MOST_PICKED = 6;
const SETTINGS = new Set(["window", "threshold", "seeds", "replicates"]); // as they were set, all digits
const sorting = { key: null, down: false };

function shownColumns() {
  return DATA.columns.filter((column) => column.short || byId("wide").checked);
}
function passes(row) {
  const cells = DATA.rows[row].cells;
  const text = [DATA.rows[row].name, DATA.rows[row].shown, ...Object.values(cells), ...DATA.rows[row].reasons].join(" ").toLowerCase();
  return byId("filter").value.toLowerCase().split(/\s+/).filter(Boolean).every((word) => {
    const bound = word.match(/^([\w.]+)([<>])(.+)$/);
    if (bound && Number.isFinite(+bound[3])) {
      const value = cells[bound[1]];
      return typeof value === "number" && (bound[2] === "<" ? value < +bound[3] : value > +bound[3]);
    }
    return word.startsWith("-") && word.length > 1 ? !text.includes(word.slice(1)) : text.includes(word);
  });
}
function sortedRows() {
  const rows = DATA.rows.map((_, row) => row).filter(passes);
  if (!sorting.key) return rows;
  const value = (row) => DATA.rows[row].cells[sorting.key];
  const missing = (v) => v == null || v === "";
  return rows.sort((a, b) => {
    const [x, y] = [value(a), value(b)];
    if (missing(x) || missing(y)) return missing(x) - missing(y); // last, either way
    const order = typeof x === "number" && typeof y === "number" ? x - y : String(x).localeCompare(String(y));
    return sorting.down ? -order : order;
  });
}
function drawTable() {
  const columns = shownColumns(), rows = sortedRows();
  const head = columns.map((column) => {
    const sorted = sorting.key === column.key ? (sorting.down ? "descending" : "ascending") : null;
    const unit = column.unit && !column.name.endsWith(`_${column.unit}`) ? ` (${column.unit})` : "";
    const sort = () => {
      sorting.down = sorting.key === column.key && !sorting.down;
      sorting.key = column.key;
      drawTable();
    };
    return el("th", { scope: "col", class: column.number && "number", "aria-sort": sorted },
      el("button", { type: "button", onclick: sort, title: column.about }, column.name.replaceAll("_", " ") + unit));
  });
  byId("table").tHead.replaceChildren(el("tr", null, el("th", { scope: "col" }, el("button", { type: "button", onclick: () => { sorting.key = null; drawTable(); }, title: "back to the ranking" }, "\u2605")), ...head));
  byId("table").tBodies[0].replaceChildren(...rows.map((row) => tableRow(row, columns)));
  byId("rows-shown").textContent = `${rows.length} of ${DATA.rows.length} rows`;
}
function tableRow(row, columns) {
  const { cells, best, control, name } = DATA.rows[row];
  const toggle = el("input", { type: "checkbox", "aria-label": `pick ${name}` });
  toggle.checked = state.picked.includes(row);
  toggle.disabled = !DATA.runs[row];
  toggle.addEventListener("change", () => pick(row, toggle.checked));
  const line = el("tr", { class: [best && "best", toggle.checked && "picked"].filter(Boolean).join(" "), "data-row": row });
  line.addEventListener("click", (event) => {
    if (event.target === toggle) return;
    if (toggle.disabled) byId("behind").scrollIntoView();
    pick(row, !state.picked.includes(row));
  });
  line.append(el("td", null, toggle, best ? " \u2605" : "", control ? " +" : ""));
  for (const column of columns) line.append(tableCell(row, column, cells[column.key]));
  return line;
}
function tableCell(row, column, value) {
  const { values, reasons, dead, cells } = DATA.rows[row];
  if (column.key === "backend") return el("td", null, swatch(row), String(value ?? "?"));
  if (column.key === "settings" || column.key === "data") return el("td", { class: "settings" }, String(value ?? ""));
  if (column.key === "status") return el("td", { class: `reason ${value === "done" && !dead ? "" : "failed"}` }, [value, ...reasons, dead].filter(Boolean).join(": "));
  const cell = el("td", { class: [column.number && "number", column.main && "main"].filter(Boolean).join(" ") }, SETTINGS.has(column.key) ? setting(value ?? "") : three(value));
  const low = cells[`${column.key}_q1`];
  if (column.main && low != null) cell.append(el("span", { class: "spread" }, ` [${three(low)} \u2013 ${three(cells[`${column.key}_q3`])}]`));
  if (column.main && values.length > 1 && value != null) cell.append(strip(row, values));
  return cell;
}
// The error of every replicate or seed as a dot, all rows of a data set in one scale.
function strip(row, values) {
  const data = DATA.rows[row].cells.data;
  const every = DATA.rows.filter((r) => r.cells.data === data).flatMap((r) => r.values).filter((v) => v > 0);
  const low = Math.log(Math.min(...every)), high = Math.log(Math.max(...every));
  const at = (v) => 4 + (72 * (Math.log(Math.max(v, 1e-12)) - low)) / (high - low || 1);
  return svg("svg", { width: 80, height: 10, viewBox: "0 0 80 10", style: { width: "80px", marginLeft: "auto" }, role: "img", "aria-label": `${values.length} runs` },
    svg("path", { d: "M4 5H76", class: "axis" }),
    values.map((v) => svg("circle", { cx: at(v), cy: 5, r: 2.4, fill: colourOf(row), "fill-opacity": 0.65 })));
}
function pick(row, wanted) {
  state.picked = state.picked.filter((other) => other !== row);
  if (wanted) state.picked = [...state.picked, row].slice(-MOST_PICKED);
  if (wanted && DATA.runs[row]?.whole) state.focus = row;
  else if (!state.picked.includes(state.focus)) state.focus = state.picked.find((other) => DATA.runs[other]?.whole) ?? null;
  emit("pick");
}
function drawChips() {
  byId("chips").replaceChildren(...state.picked.map((row) => {
    const { name, of, shown } = DATA.rows[row];
    const title = of > 1 ? `drawn: ${shown}, one of ${of} runs` : shown;
    return el("button", { type: "button", class: "chip", title: `${title}; click to remove`, onclick: () => pick(row, false) }, `${letterOf(row)} `, swatch(row), shortName(row), " \u00d7");
  }));
  if (!state.picked.length) byId("chips").append(el("span", { class: "quiet" }, "none: tick a row of the table"));
}
// The rows stay the elements they are: a checkbox that is toggled keeps the focus.
function markPicked() {
  for (const line of byId("table").tBodies[0].rows) {
    const picked = state.picked.includes(+line.dataset.row);
    line.classList.toggle("picked", picked);
    line.querySelector("input").checked = picked;
  }
}
on("pick", markPicked);
on("theme", drawTable);
on("pick theme", drawChips);
byId("filter").addEventListener("input", () => { drawTable(); emit("filter"); });
byId("wide").addEventListener("change", drawTable);

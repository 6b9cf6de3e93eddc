// The page begins: words, provenance, theme, what is picked first.
function drawWords() {
  const [methods, runs, failed] = DATA.counts;
  byId("title").textContent = DATA.title;
  byId("counts").textContent = `${methods} methods, ${runs} runs${failed ? `, ${failed} not done` : ""}`;
  byId("findings").replaceChildren(...DATA.answer.map(([head, text], i) => {
    const [, word, columns] = head.match(/^(.*?)(?: (\(.*\)))?$/s); // "winner (ape_rmse_m)"
    return el("div", { class: head.startsWith("alarm") ? "alarm" : i ? "" : "first" }, el("dt", null, word), el("dd", null, text, columns ? el("span", { class: "quiet" }, ` ${columns}`) : ""));
  }));
  byId("next").replaceChildren(el("span", { class: "quiet" }, "next"), ...command(DATA.next));
  const more = [...DATA.verdict, ...DATA.warnings];
  byId("verdict").hidden = !more.length;
  byId("verdict").append(...more.map((text) => el("p", null, text)));
  byId("limits").replaceChildren(...DATA.notes.map((text) => el("p", null, `Note: ${text}.`)), el("p", null, "Made by rbtm-bench report. Numbers are those of rbtm-bench table; 16-bit points, thinned where it says so. Nothing is fetched."));
}
function drawProvenance() {
  byId("provenance").replaceChildren(...state.picked.map((row) => {
    const { name, about, again, of, shown } = DATA.rows[row];
    const parts = [el("h3", null, swatch(row), name, of > 1 ? el("span", { class: "quiet" }, ` ${shown}, one of ${of} runs`) : "")];
    if (again) parts.push(el("div", { class: "command" }, ...command(again)));
    return el("div", { class: "card" }, ...parts, el("pre", { tabindex: 0 }, about));
  }));
  if (!state.picked.length) byId("provenance").append(el("p", { class: "quiet" }, "Pick a row: its command, settings, versions and data are shown."));
}
function setTheme(dark) {
  document.documentElement.dataset.theme = dark ? "dark" : "light";
  byId("theme").textContent = dark ? "light" : "dark";
}
function firstPicks() {
  const rows = DATA.rows.map((_, row) => row).filter((row) => DATA.runs[row] && DATA.rows[row].cells.data === state.data);
  const best = rows.find((row) => DATA.rows[row].best) ?? rows[0];
  const backend = (row) => DATA.rows[row].cells.backend;
  const rbtm = rows.find((row) => row !== best && DATA.rows[row].cells.selector === "rbtm" && backend(row) !== "none");
  const none = rows.find((row) => backend(row) === "none" && row !== best);
  return [...new Set([best, rbtm, none].filter((row) => row != null))];
}
function start() {
  const wanted = matchMedia("(prefers-color-scheme: dark)");
  setTheme(wanted.matches);
  wanted.addEventListener("change", () => { setTheme(wanted.matches); emit("theme"); });
  byId("theme").addEventListener("click", () => { setTheme(!isDark()); emit("theme"); });
  const sets = Object.keys(DATA.errors);
  const all = [...new Set(DATA.rows.map((row) => row.cells.data))];
  state.data = sets[0] ?? all[0];
  byId("data").replaceChildren(...sets.map((name) => el("option", { value: name }, name)));
  byId("data").hidden = sets.length < 2;
  byId("data").addEventListener("change", () => { state.data = byId("data").value; emit("data"); });
  drawWords();
  startHeat();
  drawTable();
  on("pick theme", drawProvenance);
  state.picked = firstPicks();
  state.focus = state.picked.find((row) => DATA.runs[row].whole && DATA.rows[row].cells.selector.startsWith("rbtm")) ?? state.picked.find((row) => DATA.runs[row].whole) ?? null;
  state.scan = state.focus == null ? 0 : Math.floor(DATA.runs[state.focus].scans / 2);
  emit("pick");
  emit("data");
  let waiting = 0;
  addEventListener("resize", () => { cancelAnimationFrame(waiting); waiting = requestAnimationFrame(() => emit("resize")); });
  if (DATA.served) setInterval(watch, 5000);
}
async function watch() {
  try {
    const version = await (await fetch("/version")).text();
    byId("newer").hidden = version === DATA.served;
  } catch { /* the server has ended: the page stays as it is */ }
}
byId("newer").addEventListener("click", () => location.reload());
start();

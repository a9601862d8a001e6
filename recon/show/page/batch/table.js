// A table of clips, sorted by a click on a heading, filtered by a text and a list, and linked to the plots.

/** Order cells by number or by text; cells without a value come last in both directions. */
function ordered(a, b, way) {
  if (a === "" || b === "") return (a === "") - (b === "");
  const numbers = !Number.isNaN(Number(a)) && !Number.isNaN(Number(b));
  return way * (numbers ? a - b : a.localeCompare(b, "en", { numeric: true }));
}

function sortBy(head) {
  const column = head.cellIndex, body = head.closest("table").tBodies[0];
  const down = head.ariaSort ? head.ariaSort !== "descending" : head.classList.contains("n"), way = down ? -1 : 1;
  for (const other of head.parentElement.children) other.removeAttribute("aria-sort");
  head.setAttribute("aria-sort", down ? "descending" : "ascending");
  const value = (row) => row.cells[column].dataset.v;
  body.append(...[...body.rows].sort((a, b) => ordered(value(a), value(b), way)));
}

for (const button of document.querySelectorAll("th button")) button.onclick = () => sortBy(button.parentElement);

const filter = document.querySelector(".filter");
if (filter) {
  const [text, state, shown] = ["input", "select", "output"].map((tag) => filter.querySelector(tag));
  const rows = [...document.querySelectorAll("tr[data-state]")], dots = [...document.querySelectorAll("svg [data-clip]")];
  const choose = () => {
    const wanted = text.value.trim().toLowerCase(), names = new Set();
    for (const row of rows) {
      const fits = row.cells[1].textContent.toLowerCase().includes(wanted)
        && (!state.value || row.dataset.state === state.value);
      row.hidden = !fits;
      if (fits) names.add(row.cells[1].dataset.v);
    }
    for (const dot of dots) dot.classList.toggle("faint", !names.has(dot.dataset.clip));
    shown.textContent = `${names.size} of ${rows.length} ${filter.dataset.unit ?? "clips"}`;
  };
  text.oninput = choose;
  state.onchange = choose;
  filter.hidden = false;
  choose();
}

/** Mark a clip in all plots and in the table. */
function mark(name) {
  for (const part of document.querySelectorAll("[data-clip]")) part.classList.toggle("near", part.dataset.clip === name);
}

for (const kind of ["pointerover", "focusin"]) {
  document.addEventListener(kind, (event) => {
    const part = event.target.closest("[data-clip]") ?? event.target.querySelector?.(":scope > [data-clip]");
    mark(part?.dataset.clip);
  });
}

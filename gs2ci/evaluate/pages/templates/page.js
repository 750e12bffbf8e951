// One state for the whole page: which view is shown. Everything that shows a view follows it.
(() => {
  "use strict";
  const root = document.documentElement;
  const all = (selector, within = document) => [...within.querySelectorAll(selector)];
  const pickers = all(".picker");
  root.classList.add("js");

  function show(index) {
    for (const element of all("[data-index]")) element.classList.toggle("on", Number(element.dataset.index) === index);
    const viewer = document.querySelector("[data-viewer]");
    const names = viewer ? viewer.dataset.names.split(" ") : [];
    for (const picker of pickers) {
      picker.querySelector(".view").value = index + 1;
      if (names.length) picker.querySelector("output").textContent = `${names[index]} of ${names.at(-1)}`;
    }
    for (const line of all(".now")) line.textContent = document.querySelector(".frame.on figcaption")?.textContent ?? "";
  }

  for (const viewer of all("[data-viewer]")) {
    const stage = viewer.querySelector(".stage"), split = viewer.querySelector(".split");
    const chips = { left: viewer.querySelector(".chip.left"), right: viewer.querySelector(".chip.right") };
    const divide = () => {
      stage.style.setProperty("--at", `${split.value}%`);
      chips.left.hidden = split.value < 12;
      chips.right.hidden = split.value > 88;
    };
    split.addEventListener("input", divide);
    for (const choice of all(".choice input", viewer)) {
      choice.addEventListener("change", () => {
        viewer.dataset.left = choice.value;
        chips.left.textContent = choice.dataset.label;
        split.setAttribute("aria-label", `Divide between ${choice.dataset.label}, left, and the recovered view, right`);
      });
      // A browser that restores a form after a reload fires nothing.
      if (choice.checked) choice.dispatchEvent(new Event("change"));
    }
    divide();
  }

  let timer = 0;
  function play(on) {
    clearInterval(timer);
    timer = 0;
    for (const button of all(".play")) {
      button.setAttribute("aria-pressed", String(on));
      button.textContent = on ? "❚❚" : "▶";
    }
    if (!on) return;
    let step = 1;
    timer = setInterval(() => {
      const slider = document.querySelector(".view"), last = Number(slider.max) - 1, here = Number(slider.value) - 1;
      // There and back again: a camera path seldom closes.
      if (here + step < 0 || here + step > last) step = -step;
      show(Math.min(Math.max(here + step, 0), last));
    }, 160);
  }
  for (const picker of pickers) {
    picker.querySelector(".view").addEventListener("input", (event) => { play(false); show(Number(event.target.value) - 1); });
    picker.querySelector(".play").addEventListener("click", () => play(timer === 0));
  }
  if (pickers.length) show(Number(pickers[0].querySelector(".view").value) - 1);

  // A heading's button sorts its column; what has no figure stays last.
  for (const table of all("table[data-sortable]")) {
    const body = table.tBodies[0], headings = all("thead th", table);
    headings.forEach((heading, column) => {
      if (!heading.textContent) return;
      const button = document.createElement("button");
      button.type = "button";
      button.append(...heading.childNodes);
      heading.append(button);
      button.addEventListener("click", () => {
        const down = heading.getAttribute("aria-sort") === "ascending";
        for (const other of headings) other.removeAttribute("aria-sort");
        heading.setAttribute("aria-sort", down ? "descending" : "ascending");
        const numeric = heading.classList.contains("n"), turn = down ? -1 : 1;
        const keyed = [...body.rows].map((row) => {
          const cell = row.cells[column];
          return [numeric ? Number(cell.dataset.value ?? NaN) : cell.textContent, row];
        });
        keyed.sort(([a], [b]) => {
          if (!numeric) return turn * a.localeCompare(b, undefined, { numeric: true });
          return Number.isNaN(a) - Number.isNaN(b) || turn * (a - b) || 0;
        });
        body.append(...keyed.map(([, row]) => row));
      });
    });
  }

  // What is folded belongs on paper too.
  const folds = all("details.fold");
  let wasOpen = [];
  addEventListener("beforeprint", () => { wasOpen = folds.map((fold) => fold.open); for (const fold of folds) fold.open = true; });
  addEventListener("afterprint", () => { folds.forEach((fold, i) => { fold.open = wasOpen[i]; }); });
})();

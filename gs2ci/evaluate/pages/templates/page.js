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
    for (const veil of all(".veiled")) draw(veil);
    for (const line of all(".now")) line.textContent = document.querySelector(".frame.on figcaption")?.textContent ?? "";
  }

  // The recovered view, grey where its standard error is larger than the slider says. The map's colours grow lighter
  // with the error, so that their lightness, looked up on the map's own scale, tells it.
  function pixels(image, width, height) {
    const sheet = new OffscreenCanvas(width, height).getContext("2d");
    sheet.drawImage(image, 0, 0, width, height);
    return sheet.getImageData(0, 0, width, height);
  }
  const lightness = (data, at) => 0.3 * data[at] + 0.59 * data[at + 1] + 0.11 * data[at + 2];
  function draw(veil) {
    const map = veil.querySelector(".stack img.on"), slider = veil.querySelector("input");
    const view = map && document.querySelector(`.frame[data-index="${map.dataset.index}"] img[data-layer="recovered"]`);
    const scale = veil.querySelector(".scale img"), canvas = veil.querySelector("canvas");
    const share = slider.value / 100, unit = veil.dataset.unit;
    veil.querySelector("output").textContent = `${Number((share * veil.dataset.most).toPrecision(2))}${unit}`;
    if (!view || ![map, view, scale].every((image) => image.complete && image.naturalWidth)) return;
    const width = canvas.width = view.naturalWidth, height = canvas.height = view.naturalHeight;
    const shown = pixels(view, width, height), errors = pixels(map, width, height).data;
    const strip = pixels(scale, 256, 1).data, most = lightness(strip, 4 * Math.round(255 * share));
    for (let at = 0; share < 1 && at < errors.length; at += 4) {
      if (lightness(errors, at) > most + 0.5) shown.data.fill(128, at, at + 3);
    }
    canvas.getContext("2d", { willReadFrequently: true }).putImageData(shown, 0, 0);
  }
  for (const veil of all(".veiled")) {
    veil.querySelector("input").addEventListener("input", () => draw(veil));
    addEventListener("load", () => draw(veil));
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

"use strict";
const $ = (id) => document.getElementById(id);
const token = [...crypto.getRandomValues(new Uint8Array(16))].map((b) => b.toString(16).padStart(2, "0")).join("");
const headers = { "X-Live-Token": token };
let state = null, drawn = 0, views = 0, best = 0, busy = 0, loading = false;

async function act(request) {
  busy += 1;
  press();
  try {
    const answer = await fetch("/act", { method: "POST", headers, body: JSON.stringify(request) });
    const told = await answer.json();
    $("error").hidden = answer.ok;
    $("error").textContent = told.error || "";
  } catch (error) {
    $("lost").hidden = false;
  } finally {
    busy -= 1;
  }
  await refresh();
}

function number(value, digits) {
  return value.toLocaleString("en", { maximumSignificantDigits: digits });
}

function press() {
  const may = Boolean(state && state.holds);
  for (const one of document.querySelectorAll("button, input, select")) {
    one.disabled = !may || (busy > 0 && one.id !== "disarm");
  }
}

function show() {
  $("name").textContent = `${state.name} (${state.kind})`;
  document.title = `Live: ${state.name}`;
  const armed = state.armed.length > 0;
  $("armed").textContent = armed ? state.armed.join(", ") : "nothing is armed";
  $("armed").classList.toggle("on", armed);
  $("role").hidden = state.holds;
  $("camera").textContent = state.camera ? "Switch off" : "Switch on";
  $("camera").classList.toggle("on", state.camera);
  $("mask").max = state.masks;
  if (document.activeElement !== $("exposure")) $("exposure").value = number(state.exposure_s * 1e3, 6).replaceAll(",", "");
  figures();
  arrows();
  axes();
  const taken = state.taken;
  $("taken").textContent = state.taking ? "taking …" : taken ? `${taken.views} views of ${number(taken.exposure_s * 1e3, 4)} ms, taken in ${number(taken.seconds, 3)} s` : "";
  if (taken && taken.number !== views) decoded(taken);
  $("notes").replaceChildren(...state.notes.map((text) => Object.assign(document.createElement("li"), { textContent: text })));
  press();
}

function figures() {
  const found = state.figures;
  if (!found.histogram) return;
  $("saturated").textContent = `${number(found.saturated * 100, 3)} %`;
  $("saturated").classList.toggle("bad", found.saturated > 0.001);
  $("mean").textContent = `${number(found.mean_dn, 4)} of ${found.top_dn}`;
  $("peak").textContent = String(found.peak_dn);
  $("sharpness").textContent = number(found.sharpness, 4);
  best = Math.max(best, found.sharpness);
  $("best").textContent = number(best, 4);
  const most = Math.log1p(Math.max(...found.histogram));
  const bars = found.histogram.map((count, i) => {
    const bar = document.createElementNS("http://www.w3.org/2000/svg", "rect");
    const height = most > 0 ? (24 * Math.log1p(count)) / most : 0;
    for (const [key, value] of Object.entries({ x: i, y: 24 - height, width: 0.9, height })) bar.setAttribute(key, value);
    if (i === found.histogram.length - 1) bar.classList.add("end");
    return bar;
  });
  $("histogram").replaceChildren(...bars);
}

function arrows() {
  const found = state.residual, [height, width] = state.size;
  const marks = [];
  if (found && state.camera) {
    $("arrows").setAttribute("viewBox", `0 0 ${width} ${height}`);
    const long = Math.max(...found.arrows.map(([, , down, right]) => Math.hypot(down, right)), 1);
    const scale = width / 12 / long;
    for (const [row, column, down, right] of found.arrows) {
      const line = document.createElementNS("http://www.w3.org/2000/svg", "line");
      for (const [key, value] of Object.entries({ x1: column, y1: row, x2: column + scale * right, y2: row + scale * down })) line.setAttribute(key, value);
      const dot = document.createElementNS("http://www.w3.org/2000/svg", "circle");
      for (const [key, value] of Object.entries({ cx: column, cy: row, r: width / 200 })) dot.setAttribute(key, value);
      marks.push(line, dot);
    }
    const way = (value, more, less) => `${number(Math.abs(value), 3)} px ${value >= 0 ? more : less}`;
    $("residual").textContent = found.arrows.length === 0 ? "not found" : `${way(found.right_px, "right", "left")}, ${way(found.down_px, "down", "up")}` + (found.found ? `, turned ${number(found.rotation_deg, 2)}°, scale ${number(1 + found.scale, 5)}` : "");
  } else {
    $("residual").textContent = "–";
  }
  $("arrows").replaceChildren(...marks);
}

function axes() {
  const names = Object.keys(state.axes);
  $("stage").hidden = names.length === 0;
  if ($("axes").dataset.names !== names.join()) {
    $("axes").dataset.names = names.join();
    $("axes").replaceChildren(...names.map((name) => {
      const row = Object.assign(document.createElement("div"), { className: "row" });
      const label = Object.assign(document.createElement("label"), { id: `axis-${name}` });
      const button = (sign, id) => {
        const one = Object.assign(document.createElement("button"), { textContent: sign < 0 ? "−" : "+", id });
        one.setAttribute("aria-label", `move ${name} ${sign < 0 ? "back" : "on"}`);
        one.addEventListener("click", () => act({ action: "jog", axis: name, mm: sign * Number($("step").value) }));
        return one;
      };
      row.append(label, button(-1, `back-${name}`), button(1, `on-${name}`));
      return row;
    }));
  }
  for (const name of names) {
    const axis = state.axes[name];
    $(`axis-${name}`).textContent = `${name} ${number(axis.mm, 7)} mm of ${number(axis.min_mm, 5)} to ${number(axis.max_mm, 5)}`;
  }
}

function decoded(taken) {
  views = taken.number;
  $("views").hidden = false;
  $("views").replaceChildren(...Array.from({ length: taken.views }, (_, i) => {
    const figure = document.createElement("figure");
    const picture = Object.assign(new Image(), { src: `/view/${i}.png?${views}`, alt: `decoded view ${i + 1}` });
    figure.append(picture, Object.assign(document.createElement("figcaption"), { textContent: `view ${i + 1}` }));
    return figure;
  }));
}

async function refresh() {
  try {
    const answer = await fetch("/state", { headers });
    state = await answer.json();
    $("lost").hidden = true;
  } catch (error) {
    $("lost").hidden = false;
    return;
  }
  show();
  $("picture").hidden = state.picture === 0;
  $("nothing").hidden = state.camera || state.picture > 0;
  if (state.picture !== drawn && !loading) {
    // Put in place when it is whole: the page never shows half a picture, or none between two.
    loading = true;
    drawn = state.picture;
    const next = Object.assign(new Image(), { src: `/picture.png?${drawn}`, id: "picture", alt: "The camera's picture" });
    next.decode().then(() => $("picture").replaceWith(next), () => 0).finally(() => { loading = false; });
  }
}

$("disarm").addEventListener("click", () => act({ action: "disarm" }));
$("camera").addEventListener("click", () => act({ action: "camera", on: !state.camera }));
$("expose").addEventListener("click", () => { best = 0; act({ action: "exposure", seconds: Number($("exposure").value) / 1e3 }); });
$("dark").addEventListener("click", () => act({ action: "show", what: "dark" }));
$("open").addEventListener("click", () => { best = 0; act({ action: "show", what: "open" }); });
$("sequence").addEventListener("click", () => act({ action: "show", what: "sequence" }));
$("show").addEventListener("click", () => { best = 0; act({ action: "show", what: "mask", index: Number($("mask").value) - 1 }); });
$("take").addEventListener("click", () => act({ action: "take" }));
addEventListener("pagehide", () => navigator.sendBeacon("/leave", token));

(async function watch() {
  await refresh();
  setTimeout(watch, document.hidden ? 1000 : 150);
})();

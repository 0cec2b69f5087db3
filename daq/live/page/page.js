// Frames as they come: a text with what is known, then pixels; the next ones are sent when these have been drawn.
"use strict";
const at = (id) => document.getElementById(id);
const HEAD = 40, SATURATED = 65535, NOTHING = 0;
const view = { mode: "split", low: 0, high: 1, split: 0.5, part: [0, 0, 0], fit: true, blink: false };
const shown = {}; // last picture of each name
let words = {}, waiting = 0, drawn = 0, begun = performance.now(), socket = null;
window.rtpivLive = { get drawn() { return drawn; }, get words() { return words; }, view, shown, first_ms: null };

function connect() {
  const token = location.hash.slice(1);
  socket = new WebSocket(`ws://${location.host}/frames`);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => socket.send(JSON.stringify({ token }));
  socket.onmessage = (event) => (typeof event.data === "string" ? told(JSON.parse(event.data)) : taken(event.data));
  socket.onclose = (event) => say(at("state"), words.over ? "the run is over" : event.reason || "the run is gone");
}

function say(element, text) { if (element.textContent !== text) element.textContent = text; } // never as HTML

function told(said) {
  if (said.over) { words.over = true; say(at("state"), "the run is over"); return; }
  words = said;
  waiting = said.shown.length;
  if (waiting === 0) finish();
}

function taken(buffer) {
  const head = new DataView(buffer);
  const name = new TextDecoder().decode(new Uint8Array(buffer, 24, 16)).replace(/\0+$/, "");
  shown[name] = {
    left: head.getUint32(8, true), top: head.getUint32(12, true), width: head.getUint16(16, true),
    height: head.getUint16(18, true), block: head.getFloat32(20, true), pixels: new Uint16Array(buffer.slice(HEAD)),
  };
  waiting -= 1;
  if (waiting === 0) finish();
}

function finish() {
  requestAnimationFrame(() => {
    draw();
    drawn += 1;
    if (drawn === 1) window.rtpivLive.first_ms = performance.now() - begun;
    const wanted = view.mode === "split" || view.mode === "blink" ? ["raw", "corrected"] : [view.mode];
    if (socket.readyState === 1) socket.send(JSON.stringify({ drawn: words.number, part: view.part, wanted }));
  });
}

function draw() {
  const two = view.mode === "split" && shown.corrected;
  if (view.mode === "blink") view.blink = !view.blink;
  const single = view.mode === "blink" ? (view.blink ? "raw" : "corrected") : view.mode;
  for (const name of ["raw", "corrected"]) {
    const canvas = at(name), on = shown[name] && (two || name === single || (!shown.corrected && name === "raw"));
    canvas.hidden = !on;
    canvas.style.clipPath = two && name === "corrected" ? `inset(0 0 0 ${100 * view.split}%)` : "none";
    if (on) paint(canvas, shown[name]);
  }
  at("split").hidden = !two;
  at("split").style.left = `${100 * view.split}%`;
  figures();
}

function paint(canvas, picture) {
  const { width, height, pixels } = picture, white = (words.figures && words.figures.white) || SATURATED;
  if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
  if (view.fit) fitContrast(shown.raw || picture, white);
  const low = view.low * white, gain = 255 / Math.max(1, (view.high - view.low) * white);
  const image = new ImageData(width, height), out = new Uint32Array(image.data.buffer);
  for (let i = 0; i < out.length; i++) {
    const value = pixels[i];
    if (value === SATURATED) out[i] = 0xff2020ff; // red, ABGR
    else if (value === NOTHING) out[i] = 0xff402010; // not recovered: dark blue
    else {
      const grey = Math.max(0, Math.min(255, (value - 1 - low) * gain)) | 0;
      out[i] = 0xff000000 | (grey << 16) | (grey << 8) | grey;
    }
  }
  canvas.getContext("2d").putImageData(image, 0, 0);
}

function fitContrast(picture, white) {
  const step = Math.max(1, picture.pixels.length >> 13), some = [];
  for (let i = 0; i < picture.pixels.length; i += step) if (picture.pixels[i] !== NOTHING) some.push(picture.pixels[i]);
  some.sort((a, b) => a - b);
  if (some.length < 10) return;
  view.low = Math.min(0.999, some[Math.floor(0.01 * some.length)] / white);
  view.high = Math.max(view.low + 0.002, Math.min(1, some[Math.floor(0.997 * some.length)] / white));
  at("low").value = Math.round(1000 * view.low);
  at("high").value = Math.max(1, Math.round(1000 * view.high));
}

function figures() {
  const worth = words.figures || {};
  say(at("run"), words.run || "rtpiv live");
  const seconds = (performance.now() - begun) / 1000;
  say(at("state"), words.doing || "running");
  const rows = Object.entries(words.counters || {}).map(([name, [text, wrong]]) => [name, text, wrong]);
  rows.push(["pictures drawn", `${drawn}, ${(drawn / seconds).toFixed(1)} a second`, false]);
  rows.push(["not shown to you", String(words.missed || 0), false]);
  if (worth.saturated !== undefined) rows.push(["saturated", `${(100 * worth.saturated).toFixed(3)} %`, worth.saturated > 1e-3]);
  table(rows);
  say(at("advice"), advice(worth));
  if (worth.histogram) histogram(worth.histogram);
  if (worth.maps) map(worth.maps[at("which").value] || []);
}

function table(rows) {
  const body = at("counters");
  while (body.rows.length > rows.length) body.deleteRow(-1);
  rows.forEach(([name, text, wrong], index) => {
    const row = body.rows[index] || body.insertRow();
    while (row.cells.length < 2) row.insertCell();
    row.className = wrong ? "wrong" : "";
    say(row.cells[0], name);
    say(row.cells[1], text);
  });
}

function middle(rows) {
  const some = rows.flat().filter((x) => x !== null).sort((a, b) => a - b);
  return some.length ? some[some.length >> 1] : null;
}

function advice(worth) {
  if (!worth.maps) return "";
  if (worth.saturated > 1e-3) return "too bright: close the aperture, or less light";
  if (words.shows === "chessboard") return "";
  const density = middle(worth.maps.density), diameter = middle(worth.maps.diameter_px);
  if (density === null || density < 5e-4) return "no particles: is there light, seeding, and the cap off? Open the aperture";
  if (diameter !== null && diameter < 2) return `particles of ${diameter.toFixed(1)} px: displacements will lock to whole pixels; close the aperture, or defocus a little`;
  if (diameter !== null && diameter > 6) return `particles of ${diameter.toFixed(1)} px: out of focus, or the aperture is very small`;
  return "";
}

function histogram(counts) {
  const canvas = at("histogram"), pen = canvas.getContext("2d"), most = Math.log1p(Math.max(...counts));
  const wide = canvas.width / counts.length;
  pen.clearRect(0, 0, canvas.width, canvas.height);
  counts.forEach((count, i) => {
    const high = most ? (canvas.height * Math.log1p(count)) / most : 0;
    pen.fillStyle = i === counts.length - 1 ? "#d32f2f" : "#7890a0";
    pen.fillRect(i * wide, canvas.height - high, Math.max(1, wide - 1), high);
  });
}

function map(rows) {
  const canvas = at("map"), pen = canvas.getContext("2d"), some = rows.flat().filter((x) => x !== null);
  pen.clearRect(0, 0, canvas.width, canvas.height);
  if (!some.length) { say(at("range"), "nothing to be told yet"); return; }
  const low = Math.min(...some), high = Math.max(...some), side = canvas.width / Math.max(rows.length, rows[0].length);
  say(at("range"), `${low.toPrecision(3)} (blue) to ${high.toPrecision(3)} (yellow)`);
  rows.forEach((row, down) => row.forEach((value, right) => {
    if (value === null) return;
    const share = high > low ? (value - low) / (high - low) : 0.5;
    pen.fillStyle = `rgb(${Math.round(40 + 210 * share)}, ${Math.round(60 + 150 * share)}, ${Math.round(160 - 120 * share)})`;
    pen.fillRect(right * side, down * side, side, side);
  }));
}

function choose(mode) {
  view.mode = mode;
  document.querySelectorAll("button[data-mode]").forEach((button) => button.setAttribute("aria-pressed", button.dataset.mode === mode));
}

document.querySelectorAll("button[data-mode]").forEach((button) => { button.onclick = () => choose(button.dataset.mode); });
at("fit").onclick = () => { view.fit = true; };
at("whole").onclick = () => { view.part = [0, 0, 0]; };
for (const id of ["low", "high"]) at(id).oninput = () => { view.fit = false; view[id] = at(id).value / 1000; };
at("stage").onpointermove = (event) => { if (event.buttons & 1 && view.mode === "split") slide(event); };
at("stage").ondblclick = (event) => {
  const box = at("stage").getBoundingClientRect(), picture = shown.raw;
  if (!picture) return;
  const size = Math.round((Math.max(picture.width, picture.height) * picture.block) / 3);
  const u = picture.left + ((event.clientX - box.left) / box.width) * picture.width * picture.block;
  const v = picture.top + ((event.clientY - box.top) / box.height) * picture.height * picture.block;
  view.part = [Math.max(0, Math.round(u - size / 2)), Math.max(0, Math.round(v - size / 2)), size];
};
function slide(event) {
  const box = at("stage").getBoundingClientRect();
  view.split = Math.max(0, Math.min(1, (event.clientX - box.left) / box.width));
  draw();
}
document.onkeydown = (event) => {
  if ((event.target.matches && event.target.matches("input, select")) || event.ctrlKey || event.metaKey || event.altKey) return;
  const modes = { s: "split", r: "raw", c: "corrected", b: "blink" };
  if (modes[event.key]) choose(modes[event.key]);
  else if (event.key === "a") view.fit = true;
  else if (event.key === "w") view.part = [0, 0, 0];
  else if (event.key === "ArrowLeft") view.split = Math.max(0, view.split - 0.02);
  else if (event.key === "ArrowRight") view.split = Math.min(1, view.split + 0.02);
};
choose("split");
connect();

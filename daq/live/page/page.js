// Frames as they come: a text with what is known, then pixels; the next ones are sent when these have been drawn.
"use strict";
const at = (id) => document.getElementById(id);
const HEAD = 44, AROUND = 0.05, SATURATED = 65535, NOTHING = 0, OLD_MS = 1500, SILENT_MS = 3000, GONE_MS = 20000, BLINK_MS = 500;
const view = { mode: "split", low: 0, high: 1, split: 0.5, part: [0, 0, 0], fit: true, lines: true, folds: true, vectors: true };
const shown = {}; // last picture of each name
const images = {}, palette = { key: "", table: new Uint32Array(SATURATED + 1) };
let words = {}, waiting = 0, drawn = 0, begun = performance.now(), socket = null;
let heard_ms = 0, came_ms = 0, doing = "", since_ms = 0, ended = ""; // when anything was heard, the picture was taken, it began
let changes = 0, marked_as = "", drawn_ms = 0, drawn_then = 0, slid_ms = -1e9, fitted_ms = -1e9, mapped = "";
window.rtpivLive = { get drawn() { return drawn; }, get words() { return words; }, get ended() { return ended; }, view, shown, first_ms: null };

function connect() {
  const token = location.hash.slice(1);
  socket = new WebSocket(`ws://${location.host}/frames`);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => socket.send(JSON.stringify({ token, ...wishes() }));
  socket.onmessage = (event) => {
    heard_ms = performance.now();
    if (typeof event.data === "string") told(JSON.parse(event.data));
    else taken(event.data);
  };
  socket.onclose = (event) => {
    if (event.reason) ended = event.reason;
    if (!ended) setTimeout(connect, 1000); // its server is started again as long as the run lives
    age();
  };
}

// What is done now and how old the picture is, twice a second: a run that stands still must not look as if it went on.
function age() {
  const now = performance.now(), seconds = (since) => `${((now - since) / 1000).toFixed(0)} s`;
  const silent_ms = now - (heard_ms || begun), old = came_ms && now - came_ms > OLD_MS, step = `${doing}, for ${seconds(since_ms)}`;
  let said = doing;
  if (ended) said = ended;
  else if (silent_ms > GONE_MS) said = `nothing has answered for ${seconds(heard_ms || begun)}: the run has gone with its server, or the way to its computer is cut; this page tries on`;
  else if (silent_ms > SILENT_MS || (heard_ms && socket.readyState !== 1)) said = `the server of this page has said nothing for ${seconds(heard_ms || begun)}; it is started again, the run goes on without it`;
  else if (!heard_ms) said = "connecting ...";
  else if (!came_ms) said = `no picture yet: ${step}`;
  else if (old) said = step;
  at("state").className = at("stage").className = ended || old || silent_ms > SILENT_MS ? "old" : "";
  say(at("state"), said);
  at("age").hidden = !old && came_ms;
  say(at("age"), old ? `this picture is ${seconds(came_ms)} old` : said); // before the first one the stage says it
  at("numbers").hidden = !came_ms;
  if (came_ms) figures(); // not with every picture: text moves everything
  if (view.mode === "blink" && (shown.raw || shown.corrected)) draw();
}

// What somebody has chosen is drawn now, and what is missing for it is asked for now.
function redraw(anew) {
  if (shown.raw || shown.corrected) draw();
  if (anew && socket && socket.readyState === 1) socket.send(JSON.stringify({ now: true, ...wishes() }));
}

function say(element, text) { if (element.textContent !== text) element.textContent = text; } // never as HTML

function told(said) {
  if (said.over) { ended = said.over; age(); return; }
  [doing, since_ms] = [said.doing, performance.now() - 1000 * said.doing_s];
  if (!said.number) return; // a sign of life
  for (const name of ["lines", "figures", "arrows"]) { // sent when they have changed
    if (name in said) changes += 1;
    else said[name] = words[name];
  }
  came_ms = performance.now() - 1000 * said.age_s;
  words = said;
  waiting = said.shown.length;
  for (const name of Object.keys(shown)) if (!said.has.includes(name)) delete shown[name]; // of an earlier frame
  if (waiting === 0) finish();
}

function taken(buffer) {
  const head = new DataView(buffer);
  const name = new TextDecoder().decode(new Uint8Array(buffer, 28, 16)).replace(/\0+$/, "");
  shown[name] = {
    left: head.getUint32(8, true), top: head.getUint32(12, true), width: head.getUint16(16, true),
    height: head.getUint16(18, true), block: head.getFloat32(20, true),
    first: head.getUint16(24, true), count: head.getUint16(26, true), pixels: new Uint16Array(buffer, HEAD), // columns that came
  };
  waiting -= 1;
  if (waiting === 0) finish();
}

function finish() {
  requestAnimationFrame(() => {
    draw();
    drawn += 1;
    if (drawn === 1) window.rtpivLive.first_ms = performance.now() - begun;
    if (socket.readyState === 1) socket.send(JSON.stringify({ drawn: words.number, ...wishes() }));
  });
}

// What the next moment is to bring: the pictures that are drawn, the part that is looked at, as large as there is room;
// of two beside each other the columns that are seen, unless the slider may be about to move.
function wishes() {
  const box = at("stage"), room = Math.round(Math.max(box.clientWidth, box.clientHeight) * (window.devicePixelRatio || 1));
  const still = view.mode === "split" && shown.corrected && !box.matches(":hover, :focus") && performance.now() - slid_ms > 1000;
  const columns = still ? { raw: [0, view.split + AROUND], corrected: [view.split - AROUND, 1] } : {};
  return { wanted: view.mode === "split" || view.mode === "blink" ? ["raw", "corrected"] : [view.mode], part: view.part, room_px: room, columns };
}

function draw() {
  const two = view.mode === "split" && shown.corrected;
  const blinks = Math.floor(performance.now() / BLINK_MS) % 2 ? "raw" : "corrected";
  const single = view.mode === "blink" ? blinks : view.mode;
  if (view.fit && shown.raw) fitContrast(shown.raw, words.white || SATURATED);
  for (const name of ["raw", "corrected"]) {
    const canvas = at(name), on = shown[name] && (two || name === single || (!shown.corrected && name === "raw"));
    canvas.hidden = !on;
    if (on) paint(canvas, shown[name], two && name === "corrected" ? view.split : 0, two && name === "raw" ? view.split : 1);
  }
  for (const button of document.querySelectorAll("button[data-mode]")) button.disabled = button.dataset.mode !== "raw" && !(words.has || []).includes("corrected");
  at("split").hidden = !two;
  at("split").style.left = `${100 * view.split}%`;
  marks(two ? ["raw", "corrected"] : [shown.corrected ? single : "raw"]);
}

// Where a picture lies on the stage, in units of its canvas: as large as fits, in the middle.
function fitted(picture, width, height) {
  const scale = Math.min(width / picture.width, height / picture.height);
  return [scale, (width - scale * picture.width) / 2, (height - scale * picture.height) / 2];
}

// Outlines of the scene and vectors of the last pair, over the part of the stage that shows their picture.
function marks(names) {
  const canvas = at("marks"), box = at("stage"), dense = window.devicePixelRatio || 1, pen = canvas.getContext("2d");
  const wide = Math.round(box.clientWidth * dense), high = Math.round(box.clientHeight * dense);
  const seen = names.map((name) => shown[name] && [name, shown[name].left, shown[name].top, shown[name].width, shown[name].height, shown[name].block]);
  const now = JSON.stringify([wide, high, seen, names.length > 1 && view.split, view.lines, view.folds, view.vectors, changes]);
  if (now === marked_as) return; // they stand still, and drawing them costs as much as a picture
  marked_as = now;
  canvas.width = wide; canvas.height = high;
  for (const name of names) {
    const picture = shown[name], marked = (words.lines || {})[name] || {};
    if (!picture) continue;
    const [scale, beside, above] = fitted(picture, wide, high);
    const place = ([u, v]) => [beside + scale * ((u + 0.5 - picture.left) / picture.block), above + scale * ((v + 0.5 - picture.top) / picture.block)];
    const from = names.length > 1 && name === "corrected" ? view.split * canvas.width : 0;
    const to = names.length > 1 && name === "raw" ? view.split * canvas.width : canvas.width;
    pen.save();
    pen.beginPath(); pen.rect(from, 0, to - from, canvas.height); pen.clip();
    pen.lineWidth = 1.5 * dense;
    if (view.folds) folded(pen, marked, place, dense);
    if (view.lines) outlined(pen, marked, place, dense);
    if (view.vectors && name === "corrected") arrows(pen, words.arrows || [], place, scale / picture.block, dense);
    pen.restore();
  }
}

// Folds in violet, masks dashed: a colour each that neither outlines nor arrows have.
function folded(pen, marked, place, dense) {
  for (const [kind, colour, dash] of [["masks", "#9e9e9e", [4 * dense, 3 * dense]], ["folds", "#e040fb", []]]) {
    pen.strokeStyle = colour;
    pen.setLineDash(dash);
    pen.beginPath();
    for (const points of marked[kind] || []) points.forEach((point, i) => (i ? pen.lineTo(...place(point)) : pen.moveTo(...place(point))));
    pen.stroke();
  }
  pen.setLineDash([]);
}

function outlined(pen, marked, place, dense) {
  pen.strokeStyle = pen.fillStyle = "#4dd0e1";
  pen.font = `${12 * dense}px system-ui`;
  (marked.lines || []).forEach(([name, points], number) => {
    pen.beginPath();
    points.forEach((point, i) => (i ? pen.lineTo(...place(point)) : pen.moveTo(...place(point))));
    pen.closePath(); pen.stroke();
    const [u, v] = place(points.reduce((a, b) => (b[1] < a[1] ? b : a)));
    pen.fillText(name, u + 4 * dense, v - (4 + 14 * (number % 3)) * dense);
  });
  if (!marked.cross) return;
  const [u, v] = place(marked.cross), arm = 8 * dense;
  pen.beginPath(); pen.moveTo(u - arm, v); pen.lineTo(u + arm, v); pen.moveTo(u, v - arm); pen.lineTo(u, v + arm); pen.stroke();
}

function arrows(pen, every, place, scale, dense) {
  if (!every.length) return;
  const lengths = every.map(([, , u, v]) => Math.hypot(u, v)).sort((a, b) => a - b);
  const longest = Math.max(lengths[Math.floor(0.95 * (lengths.length - 1))], 0.1), reach = (28 * dense) / longest;
  pen.strokeStyle = "#ffd54a";
  pen.beginPath();
  for (const [x, y, u, v] of every) {
    const [a, b] = place([x, y]), short = Math.min(1, (1.5 * longest) / Math.hypot(u, v)) * reach;
    const c = a + short * u, d = b + short * v, turn = Math.atan2(d - b, c - a);
    pen.moveTo(a, b); pen.lineTo(c, d);
    for (const side of [2.6, -2.6]) { pen.moveTo(c, d); pen.lineTo(c + 5 * dense * Math.cos(turn + side), d + 5 * dense * Math.sin(turn + side)); }
  }
  pen.stroke();
}

// Draw the columns of a picture between two shares of the stage; the canvas is no larger than they are.
function paint(canvas, picture, from, to) {
  const { width, height, pixels } = picture, box = at("stage"), table = colours();
  const [scale, beside, above] = fitted(picture, box.clientWidth, box.clientHeight);
  const column = (share) => Math.max(0, Math.min(width, Math.round((share * box.clientWidth - beside) / scale)));
  const first = Math.max(column(from), picture.first), count = Math.min(to < 1 ? column(to) : width, picture.first + picture.count) - first;
  if (count < 1) { canvas.hidden = true; return; }
  if (canvas.width !== count || canvas.height !== height) { canvas.width = count; canvas.height = height; delete images[canvas.id]; }
  Object.assign(canvas.style, { left: `${beside + first * scale}px`, top: `${above}px`, width: `${count * scale}px`, height: `${height * scale}px` });
  canvas.style.imageRendering = scale >= 1 ? "pixelated" : "auto"; // pixels are seen as such, but none is left out
  const image = images[canvas.id] || (images[canvas.id] = new ImageData(count, height)), out = new Uint32Array(image.data.buffer);
  for (let row = 0, k = 0; row < height; row++) {
    const begin = row * picture.count + first - picture.first;
    for (let i = begin; i < begin + count; i++) out[k++] = table[pixels[i]];
  }
  canvas.getContext("2d", { alpha: false }).putImageData(image, 0, 0);
}

// Colours [ABGR] of all values that a picture can have, made anew when the contrast is another one.
function colours() {
  const white = words.white || SATURATED, key = `${view.low} ${view.high} ${white}`;
  if (palette.key === key) return palette.table;
  const low = view.low * white, gain = 255 / Math.max(1, (view.high - view.low) * white), table = palette.table;
  for (let value = 1; value < SATURATED; value++) {
    const grey = Math.max(0, Math.min(255, (value - 1 - low) * gain)) | 0;
    table[value] = 0xff000000 | (grey << 16) | (grey << 8) | grey;
  }
  table[SATURATED] = 0xff2020ff; // red
  table[NOTHING] = 0xff402010; // not recovered: dark blue
  palette.key = key;
  return table;
}

function fitContrast(picture, white) {
  if (performance.now() - fitted_ms < 1000) return;
  fitted_ms = performance.now();
  const step = Math.max(1, picture.pixels.length >> 13), some = new Uint16Array(Math.floor(picture.pixels.length / step));
  let count = 0;
  for (let i = 0; i < some.length; i++) if (picture.pixels[i * step] !== NOTHING) some[count++] = picture.pixels[i * step];
  const order = some.subarray(0, count).sort();
  if (count < 10) return;
  view.low = Math.min(0.999, order[Math.floor(0.01 * count)] / white);
  view.high = Math.max(view.low + 0.002, Math.min(1, order[Math.floor(0.997 * count)] / white));
  at("low").value = Math.round(1000 * view.low);
  at("high").value = Math.max(1, Math.round(1000 * view.high));
}

function figures() {
  const worth = words.figures || {};
  say(at("run"), words.run || "rtpiv bench live");
  const now_ms = performance.now(), rate = (1000 * (drawn - drawn_then)) / (now_ms - drawn_ms);
  [drawn_ms, drawn_then] = [now_ms, drawn];
  laser(now_ms);
  const { focus, ...counters } = words.counters || {}; // whoever turns a ring stands away from the screen
  say(at("focus"), focus ? `focus ${focus[0]}` : "");
  const rows = Object.entries(counters).map(([name, [text, wrong]]) => [name, text, wrong]);
  rows.push(["pictures drawn", `${drawn}, ${rate.toFixed(0)} a second`, false]);
  rows.push(["not shown to you", String(words.missed || 0), false]);
  if (worth.saturated !== undefined) rows.push(["saturated", `${(100 * worth.saturated).toFixed(3)} %`, worth.saturated > 1e-3]);
  table(rows);
  say(at("advice"), advice(worth));
  const now = `${changes} ${at("which").value}`;
  if (now === mapped) return;
  mapped = now;
  if (worth.histogram) histogram(at("histogram"), worth.histogram, true);
  moved(words.arrows || []);
  if (worth.maps) map(worth.maps[at("which").value] || worth.maps.edge_px || []);
}

// The state is as old as the picture, and worth nothing once the run has ended or does not answer.
function laser(now_ms) {
  const [light, wrong] = words.laser || ["", false], old_ms = now_ms - came_ms;
  const unknown = ended || socket.readyState !== 1 || now_ms - heard_ms > SILENT_MS;
  at("laser").hidden = !light;
  at("laser").className = wrong || unknown || old_ms > OLD_MS ? "wrong" : "";
  const before = old_ms > OLD_MS ? ` ${(old_ms / 1000).toFixed(0)} s ago` : "";
  say(at("laser"), unknown ? "laser unknown: rtpiv laser off" : `laser ${light}${before}`);
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
  if (worth.bright !== undefined && worth.bright < 0.25) return `dark: the brightest reach ${(100 * worth.bright).toFixed(0)} % of white; ${(0.7 / Math.max(worth.bright, 1e-3)).toFixed(1)} times the light or exposure would fill the scale`;
  if (words.shows === "chessboard") return "";
  const density = middle(worth.maps.density), diameter = middle(worth.maps.diameter_px);
  if (density === null || density < 5e-4) return "no particles: is there light, seeding, and the cap off? Open the aperture";
  if (diameter !== null && diameter < 2) return `particles of ${diameter.toFixed(1)} px: displacements will lock to whole pixels; close the aperture, or defocus a little`;
  if (diameter !== null && diameter > 6) return `particles of ${diameter.toFixed(1)} px: out of focus, or the aperture is very small`;
  return "";
}

function moved(every) {
  at("moved").hidden = !every.length;
  if (!every.length) return;
  const lengths = every.map(([, , u, v]) => Math.hypot(u, v)), top = Math.max(...lengths, 0.1), counts = new Array(32).fill(0);
  for (const length of lengths) counts[Math.min(31, Math.floor((32 * length) / top))] += 1;
  histogram(at("lengths"), counts, false);
  say(at("lengths-of"), `displacements of the last pair, 0 to ${top.toFixed(1)} px, logarithmic`);
}

function histogram(canvas, counts, marked) {
  const pen = canvas.getContext("2d"), most = Math.log1p(Math.max(...counts));
  const wide = canvas.width / counts.length;
  pen.clearRect(0, 0, canvas.width, canvas.height);
  counts.forEach((count, i) => {
    const high = most ? (canvas.height * Math.log1p(count)) / most : 0;
    pen.fillStyle = marked && i === counts.length - 1 ? "#d32f2f" : "#7890a0";
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
  redraw(true);
}

document.querySelectorAll("button[data-mode]").forEach((button) => { button.onclick = () => choose(button.dataset.mode); });
at("fit").onclick = () => { view.fit = true; fitted_ms = -1e9; redraw(false); };
const toggle = (id) => { view[id] = !view[id]; at(id).setAttribute("aria-pressed", view[id]); draw(); };
for (const id of ["lines", "folds", "vectors"]) at(id).onclick = () => toggle(id);
at("whole").onclick = () => { view.part = [0, 0, 0]; redraw(true); };
for (const id of ["low", "high"]) at(id).oninput = () => { view.fit = false; view[id] = at(id).value / 1000; redraw(false); };
at("stage").onpointermove = (event) => { if (event.buttons & 1 && view.mode === "split") slide(event); };
at("stage").ondblclick = (event) => {
  const box = at("stage").getBoundingClientRect(), picture = shown.raw || shown.corrected;
  if (!picture) return;
  const size = Math.round((Math.max(picture.width, picture.height) * picture.block) / 3);
  const [scale, beside, above] = fitted(picture, box.width, box.height);
  const u = picture.left + ((event.clientX - box.left - beside) / scale) * picture.block;
  const v = picture.top + ((event.clientY - box.top - above) / scale) * picture.block;
  view.part = [Math.max(0, Math.round(u - size / 2)), Math.max(0, Math.round(v - size / 2)), size];
  redraw(true);
};
function slide(event) {
  const box = at("stage").getBoundingClientRect();
  slide_to((event.clientX - box.left) / box.width);
}
function slide_to(share) {
  view.split = Math.max(0, Math.min(1, share));
  slid_ms = performance.now();
  draw();
}
document.onkeydown = (event) => {
  if ((event.target.matches && event.target.matches("input, select")) || event.ctrlKey || event.metaKey || event.altKey) return;
  const modes = { s: "split", r: "raw", c: "corrected", b: "blink" };
  if (modes[event.key]) choose(modes[event.key]);
  else if (event.key === "o") toggle("lines");
  else if (event.key === "f") toggle("folds");
  else if (event.key === "v") toggle("vectors");
  else if (event.key === "a") at("fit").onclick();
  else if (event.key === "w") at("whole").onclick();
  else if (event.key === "ArrowLeft") slide_to(view.split - 0.02);
  else if (event.key === "ArrowRight") slide_to(view.split + 0.02);
};
choose("split");
connect();
age();
setInterval(age, BLINK_MS);

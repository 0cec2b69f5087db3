"use strict";
// Places are in the unit of the file, y up. Fields are rows of increasing y.
const at = (name) => document.getElementById(name);
const canvas = at("drawing"), pen = canvas.getContext("2d");
const EMPTY = "#8a8a8a", REJECTED = "#ff2d6f", MARGIN = 46;
let about = null, fields = {}, image = null, rejected = new Set(), place = null, line = null, pressed = null;
let socket = null, awaited = null, timer = 0;

// ---- messages: JSON, and for fields and frames bytes behind it

const send = (words) => socket.send(JSON.stringify(words));

function say(text, wrong) {
  at("state").textContent = text;
  at("state").className = wrong ? "old" : "";
}

function connect() {
  socket = new WebSocket(`ws://${location.host}/vectors`);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => send({ token: location.hash.slice(1) });
  socket.onclose = (event) => say(event.reason || "the page is gone: start rtpiv report --view again", true);
  socket.onmessage = (message) => {
    if (typeof message.data !== "string") return awaited(message.data);
    const words = JSON.parse(message.data);
    if (words.names) begin(words);
    else if (words.refused) { at("checked").textContent = words.refused; say(words.refused, true); }
    else if (words.written) say(`${words.written} is written: ${words.rejected} vectors rejected`);
    else if (words.windows) showWindows(words.windows);
    else if (words.rejected) showRejected(words);
    else if (words.frame) awaited = showFrame;
    else if ("time" in words) awaited = (bytes) => showFields(words, bytes);
  };
}

function begin(words) {
  about = words;
  at("run").textContent = `${about.folder}/${about.file}`;
  document.title = about.file;
  fill(at("time"), Array.from({ length: about.times }, (_, k) => [k, k + 1]));
  at("time").parentElement.hidden = about.times < 2;
  fill(at("colour"), [["length", about.kind === "velocity" ? "speed" : "displacement"],
    ["sigma", "uncertainty"], ...about.names.map((name) => [name, name])]);
  fill(at("frame"), about.frame ? [["", "none"], ["a", "A"], ["b", "B"]] : [["", "none"]]);
  if (about.no_frames) at("notes").textContent += ` ${about.no_frames}.`;
  at("write").title = `writes ${about.writes}`;
  say("");
  send({ time: 0 });
}

function fill(select, options) {
  select.replaceChildren(...options.map(([value, text]) => new Option(text, value)));
}

function showFields(words, bytes) {
  const all = new Float32Array(bytes), size = about.x.length * about.y.length;
  fields = {};
  about.names.forEach((name, k) => { fields[name] = all.subarray(k * size, (k + 1) * size); });
  const parts = ["total_sigma_", "sigma_"].map((name) => [fields[`${name}u`], fields[`${name}v`]]).find(([u]) => u);
  fields.length = fields.u.map((u, k) => Math.hypot(u, fields.v[k]));
  fields.sigma_of = parts || null;
  fields.sigma = parts ? parts[0].map((u, k) => Math.hypot(u, parts[1][k])) : fields.u.map(() => NaN);
  if (words.tag) at("run").textContent = `${about.folder}/${about.file}: ${words.tag}`;
  check();
  draw();
}

function showFrame(bytes) {
  const grey = new Uint8Array(bytes), { width, height } = about.frame;
  const pixels = new ImageData(width, height);
  for (let k = 0; k < grey.length; k++) {
    pixels.data.fill(grey[k], 4 * k, 4 * k + 3);
    pixels.data[4 * k + 3] = 255;
  }
  image = document.createElement("canvas");
  [image.width, image.height] = [width, height];
  image.getContext("2d").putImageData(pixels, 0, 0);
  draw();
}

// ---- picture

function scales() {  // pixels of the canvas for a place, and back
  const [x, y] = [about.x, about.y], step = { x: (x[1] ?? x[0] + 1) - x[0], y: (y[1] ?? y[0] + 1) - y[0] };
  const wide = x[x.length - 1] - x[0] + step.x, high = y[y.length - 1] - y[0] + step.y;
  const k = Math.min((canvas.width - 2 * MARGIN) / wide, (canvas.height - MARGIN) / high);
  const left = x[0] - step.x / 2, bottom = y[0] - step.y / 2, base = high * k;
  return {
    k, step, wide, high,
    to: (a, b) => [MARGIN + (a - left) * k, base - (b - bottom) * k],
    from: (u, v) => [left + (u - MARGIN) / k, bottom + (base - v) / k],
  };
}

function colour(share) {  // viridis by three polynomials, good to a few of 255
  const t = Math.min(Math.max(share, 0), 1);
  const poly = (c) => c.reduceRight((sum, a) => sum * t + a, 0) * 255;
  return [poly([0.277, 0.105, -0.330, -4.634, 6.228, 4.776, -5.435]),
    poly([0.005, 1.404, 0.214, -5.799, 14.179, -13.745, 4.646]),
    poly([0.334, 1.384, 0.095, -19.332, 56.691, -65.353, 26.312])].map((c) => Math.min(Math.max(Math.round(c), 0), 255));
}

function range(values) {
  const known = Array.from(values).filter(Number.isFinite).sort((a, b) => a - b);
  if (!known.length) return [0, 1];
  const top = known[Math.floor(0.995 * (known.length - 1))], bottom = known[Math.floor(0.005 * (known.length - 1))];
  const from = bottom >= 0 && bottom < 0.3 * top ? 0 : bottom;
  return [from, Math.max(from + (top - from) * (at("top").value / 100), from + 1e-12)];
}

function draw() {
  if (!about || !fields.u) return;
  const s = scales(), chosen = at("colour").value, values = fields[chosen], [low, high] = range(values);
  pen.fillStyle = "#fff";
  pen.fillRect(0, 0, canvas.width, canvas.height);
  if (image && at("frame").value) {
    const f = about.frame, [u, v] = s.to(f.x0 - f.pitch / 2, f.y0 + f.pitch / 2);
    pen.save();
    pen.beginPath();
    pen.rect(MARGIN, 0, s.wide * s.k, s.high * s.k);
    pen.clip();
    pen.drawImage(image, u, v, f.width * f.pitch * s.k, f.height * f.pitch * s.k);
    pen.restore();
  } else cells(s, values, low, high);
  if (at("arrows").ariaPressed === "true") arrows(s, values, low, high);
  bar(s, low, high, chosen);
  marks(s);
}

function cells(s, values, low, high) {
  const wide = Math.ceil(s.step.x * s.k), tall = Math.ceil(s.step.y * s.k);
  about.y.forEach((b, i) => about.x.forEach((a, j) => {
    const value = values[i * about.x.length + j], [u, v] = s.to(a - s.step.x / 2, b + s.step.y / 2);
    pen.fillStyle = Number.isFinite(value) ? `rgb(${colour((value - low) / (high - low))})` : "#d5d5d5";
    pen.fillRect(Math.floor(u), Math.floor(v), wide, tall);
  }));
}

function arrows(s, values, low, high) {
  const every = Math.max(1, Math.ceil(13 / (s.step.x * s.k)));
  const [, longest] = [0, range(fields.length)[1] / (at("top").value / 100)];
  const unit = (1.2 * every * s.step.x * s.k / longest) * 10 ** (at("scale").value / 20);
  const overFrame = image && at("frame").value;
  for (let i = Math.floor(every / 2); i < about.y.length; i += every)
    for (let j = Math.floor(every / 2); j < about.x.length; j += every) {
      const n = i * about.x.length + j, [du, dv] = [fields.u[n] * unit, -fields.v[n] * unit];
      if (!Number.isFinite(du + dv)) continue;
      const [u, v] = s.to(about.x[j], about.y[i]), size = Math.hypot(du, dv), head = Math.min(4, 0.4 * size);
      pen.strokeStyle = rejected.has(n) ? REJECTED
        : overFrame ? `rgb(${colour((values[n] - low) / (high - low))})` : "#fff";
      pen.lineWidth = rejected.has(n) ? 2.5 : 1.2;
      pen.beginPath();
      pen.moveTo(u - du / 2, v - dv / 2);
      pen.lineTo(u + du / 2, v + dv / 2);
      if (size > 2) for (const turn of [2.6, -2.6]) {
        const [c, q] = [Math.cos(turn), Math.sin(turn)];
        pen.moveTo(u + du / 2, v + dv / 2);
        pen.lineTo(u + du / 2 + head * (c * du - q * dv) / size, v + dv / 2 + head * (q * du + c * dv) / size);
      }
      pen.stroke();
    }
}

function bar(s, low, high, chosen) {
  const top = s.high * s.k, left = MARGIN + s.wide * s.k + 8;
  for (let k = 0; k < 100; k++) {
    pen.fillStyle = `rgb(${colour(k / 99)})`;
    pen.fillRect(left, top * (1 - (k + 1) / 100), 12, Math.ceil(top / 100) + 1);
  }
  pen.fillStyle = "#16202a";
  pen.font = "13px system-ui, sans-serif";
  [[high, 12], [(low + high) / 2, top / 2], [low, top]].forEach(([value, v]) => pen.fillText(within(value, high - low), left + 14, v));
  for (const share of [0, 0.5, 1]) {
    const middle = (axis) => axis[Math.round(share * (axis.length - 1))], [a, b] = [middle(about.x), middle(about.y)];
    const [u, v] = s.to(a, b);
    pen.fillText(within(a, s.wide), u - 14, top + 16);
    pen.fillText(within(b, s.high), 2, Math.max(v + 4, 12));
  }
  pen.fillText(`x, y [${about.length}]; colour: ${label(chosen)}`, MARGIN + 40, top + 34);
}

const unitOf = (name) => about.units[{ length: "u", sigma: "u" }[name] ?? name] || "";
const label = (name) => `${at("colour").querySelector(`option[value="${name}"]`).textContent} [${unitOf(name)}]`;
const within = (value, span) => value.toFixed(Math.min(Math.max(Math.ceil(-Math.log10(span || 1)) + 2, 0), 12)).replace(/^-(0*\.?0*)$/, "$1");
const withSigma = (value, sigma) => (Number.isFinite(sigma) && sigma > 0 ? `${within(value, 10 * sigma)} ± ${within(sigma, 10 * sigma)}` : short(value));
const short = (value) => (Number.isFinite(value) ? Number(value.toPrecision(3)).toString() : "-");

function marks(s) {
  pen.lineWidth = 2;
  pen.strokeStyle = REJECTED;
  for (const n of rejected) {
    const [u, v] = s.to(about.x[n % about.x.length], about.y[Math.floor(n / about.x.length)]);
    pen.strokeRect(u - 3, v - 3, 6, 6);
  }
  pen.strokeStyle = "#ff9d00";
  pen.fillStyle = "#ff9d00";
  if (place) {
    const [u, v] = s.to(...place);
    pen.strokeRect(u - 6, v - 6, 12, 12);
  }
  if (line) {
    const [a, b] = [s.to(...line[0]), s.to(...line[1])];
    pen.beginPath();
    pen.moveTo(...a);
    pen.lineTo(...b);
    pen.stroke();
    for (const [u, v] of [a, b]) pen.fillRect(u - 3, v - 3, 6, 6);
  }
}

// ---- values, lines

function nearest(x, y) {
  const index = (axis, value) => Math.min(Math.max(Math.round((value - axis[0]) / (((axis[1] ?? axis[0] + 1) - axis[0]) || 1)), 0), axis.length - 1);
  return index(about.y, y) * about.x.length + index(about.x, x);
}

function showValue(x, y) {
  const n = nearest(x, y), [i, j] = [Math.floor(n / about.x.length), n % about.x.length];
  const component = (k) => (Number.isFinite(fields.u[n]) ? withSigma(fields["uv"[k]][n], fields.sigma_of?.[k][n]) : "-");
  const more = ["length", "sigma", "u", "v"].includes(at("colour").value) ? "" : `, ${at("colour").value} ${short(fields[at("colour").value][n])} ${unitOf(at("colour").value)}`;
  const flag = fields.flag && fields.flag[n] ? `, ${about.flags.split(", ")[fields.flag[n]]?.slice(2) ?? ""}` : "";
  at("value").textContent = `x ${short(about.x[j])}, y ${short(about.y[i])} ${about.length}: u ${component(0)}, v ${component(1)} ${unitOf("u")}${more}${flag}${rejected.has(n) ? ", rejected" : ""}`;
}

function bilinear(values, x, y) {  // NaN where a corner has no vector
  const share = (axis, value) => (value - axis[0]) / ((axis[1] ?? axis[0] + 1) - axis[0]);
  const [p, q] = [share(about.x, x), share(about.y, y)], [j, i] = [Math.floor(p), Math.floor(q)];
  if (i < 0 || j < 0 || i >= about.y.length - 1 || j >= about.x.length - 1) return NaN;
  const [a, b, n] = [p - j, q - i, i * about.x.length + j];
  const value = (k) => (rejected.has(k) ? NaN : values[k]);
  return (1 - b) * ((1 - a) * value(n) + a * value(n + 1)) + b * ((1 - a) * value(n + about.x.length) + a * value(n + about.x.length + 1));
}

function showLine() {
  const plot = at("profile"), p = plot.getContext("2d");
  p.clearRect(0, 0, plot.width, plot.height);
  at("scale-found").textContent = "";
  if (!line) return;
  const [[x0, y0], [x1, y1]] = line, length = Math.hypot(x1 - x0, y1 - y0), count = 120;
  const along = (values) => Array.from({ length: count }, (_, k) => bilinear(values, x0 + (x1 - x0) * k / (count - 1), y0 + (y1 - y0) * k / (count - 1)));
  const [u, v] = [along(fields.u), along(fields.v)], sigma = fields.sigma_of ? fields.sigma_of.map(along) : null;
  const bands = [u, v].flatMap((values, which) => values.flatMap((value, k) => [-1, 1].map((sign) => value + sign * (sigma?.[which][k] || 0))));
  const known = bands.filter(Number.isFinite), ends = [Math.min(...known), Math.max(...known)];
  if (!known.length) return void (at("line").textContent = "no vectors along this line");
  const zero = Math.min(...ends.map(Math.abs)) < 2 * (ends[1] - ends[0]), [low, high] = zero ? [Math.min(0, ends[0]), Math.max(0, ends[1])] : ends;
  const y = (value) => plot.height - 14 - (value - low) / (high - low || 1) * (plot.height - 26), x = (k) => 4 + k / (count - 1) * (plot.width - 8);
  [[u, "#2f7fd6", 0], [v, "#e07a1f", 1]].forEach(([values, tint, which]) => {
    if (sigma) {
      p.fillStyle = `${tint}44`;
      values.forEach((value, k) => Number.isFinite(value) && p.fillRect(x(k), y(value + sigma[which][k]), 3, y(value - sigma[which][k]) - y(value + sigma[which][k])));
    }
    p.strokeStyle = tint;
    p.lineWidth = 2;
    p.beginPath();
    values.forEach((value, k) => (Number.isFinite(value) ? (k && Number.isFinite(values[k - 1]) ? p.lineTo(x(k), y(value)) : p.moveTo(x(k), y(value))) : 0));
    p.stroke();
  });
  p.fillStyle = EMPTY;
  if (zero) p.fillRect(4, y(0), plot.width - 8, 1);
  p.font = "12px system-ui, sans-serif";
  p.fillText(within(high, high - low), 4, 11);
  p.fillText(within(low, high - low), 4, plot.height - 2);
  at("line").textContent = `u (blue), v (orange) [${unitOf("u")}] over ${short(length)} ${about.length}, from ${short(x0)}, ${short(y0)} to ${short(x1)}, ${short(y1)}; bands: one standard uncertainty`;
  const true_mm = number("length");
  if (true_mm) at("scale-found").textContent = about.length === "mm"
    ? `measured ${short(length)} mm: ${(100 * (length / true_mm - 1)).toFixed(2)} % too large`
    : `${(true_mm / length).toPrecision(5)} mm/px: evaluate again with --mm-per-px ${(true_mm / length).toPrecision(5)}`;
}

// ---- criteria

const number = (name) => { const value = parseFloat(at(name).value.replace(",", ".")); return Number.isFinite(value) ? value : null; };

function criteria() {
  const chosen = { interpolate: at("interpolate").value === "1" }, wide = 1e30;
  for (const along of ["u", "v"]) {
    const [low, high] = [number(`${along}0`), number(`${along}1`)];
    if (low !== null || high !== null) chosen[`${along}_limits`] = [low ?? -wide, high ?? wide];
  }
  for (const name of ["deviations", "local_median"]) if (number(name) !== null) chosen[name] = number(name);
  return chosen;
}

function check() {
  clearTimeout(timer);
  timer = setTimeout(() => send({ check: criteria(), time: Number(at("time").value) }), 150);
}

function showRejected(words) {
  rejected = new Set(words.rejected);
  at("checked").textContent = `${rejected.size} of ${words.measured} vectors would be rejected; "write" writes ${about.writes}`;
  scatter();
  showLine();
  draw();
}

let spread = null;  // of the scatter plot: place of a pixel

function scatter() {
  const plot = at("scatter"), p = plot.getContext("2d"), [w, h] = [plot.width, plot.height];
  p.clearRect(0, 0, w, h);
  const known = (values) => Array.from(values).filter(Number.isFinite), ends = (values) => values.reduce(([a, b], c) => [Math.min(a, c), Math.max(b, c)], [Infinity, -Infinity]);
  const [u0, u1] = ends(known(fields.u)), [v0, v1] = ends(known(fields.v)), k = 0.9 / Math.max((u1 - u0) / w, (v1 - v0) / h, 1e-30);
  spread = { to: (u, v) => [w / 2 + (u - (u0 + u1) / 2) * k, h / 2 - (v - (v0 + v1) / 2) * k], from: (a, b) => [(a - w / 2) / k + (u0 + u1) / 2, (h / 2 - b) / k + (v0 + v1) / 2] };
  const [zero_u, zero_v] = spread.to(0, 0);
  p.fillStyle = EMPTY;
  p.fillRect(0, zero_v, w, 1);
  p.fillRect(zero_u, 0, 1, h);
  p.font = "12px system-ui, sans-serif";
  p.fillText(`u ${short(u0)} to ${short(u1)}, v ${short(v0)} to ${short(v1)} ${unitOf("u")}`, 4, h - 4);
  for (let n = 0; n < fields.u.length; n++) {
    if (!Number.isFinite(fields.u[n])) continue;
    const [a, b] = spread.to(fields.u[n], fields.v[n]);
    p.fillStyle = rejected.has(n) ? REJECTED : "#2f7fd6";
    p.fillRect(a - 1, b - 1, 2, 2);
  }
}

function showWindows(rows) {
  const pixels = (value) => (value === undefined ? "-" : value.toFixed(3));
  const cells = [["window [px]", "u, v [px]", "uncertainty"], ...rows.map((row) => [`${row.side}`,
    row.refused || row.flag || `${pixels(row.u)}, ${pixels(row.v)}`, row.u === undefined ? "" : `${pixels(row.sigma_u)}, ${pixels(row.sigma_v)}`])];
  at("windows").replaceChildren(...cells.map((texts) => {
    const tr = document.createElement("tr");
    tr.append(...texts.map((text) => { const td = document.createElement("td"); td.textContent = text; return td; }));
    return tr;
  }));
  say("");
}

// ---- what the person does

function spot(event, target) {
  const box = target.getBoundingClientRect();
  return [(event.clientX - box.left) * target.width / box.width, (event.clientY - box.top) * target.height / box.height];
}

canvas.addEventListener("pointerdown", (event) => { if (about) { pressed = spot(event, canvas); canvas.setPointerCapture(event.pointerId); } });
canvas.addEventListener("pointermove", (event) => {
  if (!fields.u) return;
  const [u, v] = spot(event, canvas), s = scales();
  showValue(...s.from(u, v));
  if (pressed && Math.hypot(u - pressed[0], v - pressed[1]) > 6) {
    line = [s.from(...pressed), s.from(u, v)];
    showLine();
    draw();
  }
});
canvas.addEventListener("pointerup", (event) => {
  if (!pressed || !fields.u) return;
  const [u, v] = spot(event, canvas);
  if (Math.hypot(u - pressed[0], v - pressed[1]) <= 6) {
    const n = nearest(...scales().from(u, v));
    place = [about.x[n % about.x.length], about.y[Math.floor(n / about.x.length)]];
    at("again").disabled = !about.frame;
  }
  pressed = null;
  draw();
});
document.addEventListener("keydown", (event) => { if (event.key === "Escape") { place = line = null; showLine(); draw(); } });

let corner = null;
at("scatter").addEventListener("pointerdown", (event) => { corner = spot(event, at("scatter")); });
at("scatter").addEventListener("pointerup", (event) => {
  if (!corner || !spread) return;
  const [a, b] = [spread.from(...corner), spread.from(...spot(event, at("scatter")))];
  corner = null;
  if (a[0] === b[0] || a[1] === b[1]) return;
  [["u", 0], ["v", 1]].forEach(([along, k]) => {
    at(`${along}0`).value = Math.min(a[k], b[k]).toPrecision(4);
    at(`${along}1`).value = Math.max(a[k], b[k]).toPrecision(4);
  });
  check();
});

at("time").addEventListener("change", () => send({ time: Number(at("time").value) }));
at("frame").addEventListener("change", () => (at("frame").value ? send({ frame: at("frame").value }) : draw()));
at("arrows").addEventListener("click", () => { at("arrows").ariaPressed = String(at("arrows").ariaPressed !== "true"); draw(); });
for (const name of ["colour", "scale", "top"]) at(name).addEventListener("input", draw);
for (const name of ["u0", "u1", "v0", "v1", "deviations", "local_median"]) at(name).addEventListener("input", check);
at("length").addEventListener("input", showLine);
at("interpolate").addEventListener("change", check);
at("clear").addEventListener("click", () => { for (const name of ["u0", "u1", "v0", "v1", "deviations", "local_median"]) at(name).value = ""; check(); });
at("write").addEventListener("click", () => send({ write: criteria() }));
at("again").addEventListener("click", () => { say("evaluating ..."); send({ windows: place }); });
at("save").addEventListener("click", () => {
  const link = document.createElement("a");
  link.href = canvas.toDataURL("image/png");
  link.download = `${about.folder}-${about.file.replace(/\.nc$/, "")}.png`;
  link.click();
});
addEventListener("resize", fit);

function fit() {  // as many pixels as there is room for, so that letters keep their size
  canvas.width = Math.max(canvas.clientWidth, 320);
  canvas.height = Math.round(0.82 * canvas.width);
  draw();
}

fit();
connect();

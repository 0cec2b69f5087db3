"use strict";
// Outlines are in pixels of the frame: (0, 0) is the middle of the first one.
const at = (name) => document.getElementById(name);
const canvas = at("drawing"), pen = canvas.getContext("2d");
let outlines = [], corners = [], frame = null, socket = null;

function said(text, wrong) {
  at("state").textContent = text;
  at("state").className = wrong ? "old" : "";
}

function draw() {
  if (!frame) return;
  pen.putImageData(frame, 0, 0);
  const width = Math.max(1, frame.width / 600);
  for (const outline of outlines) path(outline, true, width);
  if (corners.length) path(corners, false, width);
}

function path(points, closed, width) {
  pen.beginPath();
  points.forEach(([u, v], k) => (k ? pen.lineTo(u + 0.5, v + 0.5) : pen.moveTo(u + 0.5, v + 0.5)));
  if (closed) {
    pen.closePath();
    pen.fillStyle = "rgba(255, 120, 60, 0.35)";
    pen.fill("evenodd");
  }
  pen.lineWidth = width;
  pen.strokeStyle = closed ? "#ff783c" : "#ffd54a";
  pen.stroke();
  for (const [u, v] of closed ? [] : points) {
    pen.fillStyle = "#ffd54a";
    pen.fillRect(u + 0.5 - 2 * width, v + 0.5 - 2 * width, 4 * width, 4 * width);
  }
}

function end() {
  if (corners.length >= 3) outlines.push(corners);
  corners = [];
  draw();
}

function back() {
  if (corners.length) corners.pop();
  else outlines.pop();
  draw();
}

function write() {
  end();
  if (!outlines.length) return said("nothing is drawn yet", true);
  socket.send(JSON.stringify({ outlines }));
}

canvas.addEventListener("click", (event) => {
  if (!frame || event.detail > 1) return;
  const box = canvas.getBoundingClientRect();
  const u = ((event.clientX - box.left) * frame.width) / box.width - 0.5;
  const v = ((event.clientY - box.top) * frame.height) / box.height - 0.5;
  corners.push([Math.round(u * 10) / 10, Math.round(v * 10) / 10]);
  draw();
});
canvas.addEventListener("dblclick", end);
at("end").addEventListener("click", end);
at("back").addEventListener("click", back);
at("clear").addEventListener("click", () => { outlines = []; corners = []; draw(); });
at("write").addEventListener("click", write);
document.addEventListener("keydown", (event) => {
  if (event.target.tagName === "BUTTON" && event.key === "Enter") return;
  const does = { Enter: end, Backspace: back, s: write }[event.key];
  if (does) { event.preventDefault(); does(); }
});

function connect() {
  socket = new WebSocket(`ws://${location.host}/outlines`);
  socket.binaryType = "arraybuffer";
  let size = null;
  socket.onopen = () => socket.send(JSON.stringify({ token: location.hash.slice(1) }));
  socket.onclose = (event) => said(event.reason || "the page is gone: give rtpiv setup mask again", true);
  socket.onmessage = (message) => {
    if (typeof message.data !== "string") {
      const grey = new Uint8Array(message.data), image = new ImageData(size.width, size.height);
      for (let k = 0; k < grey.length; k++) {
        image.data[4 * k] = image.data[4 * k + 1] = image.data[4 * k + 2] = grey[k];
        image.data[4 * k + 3] = 255;
      }
      frame = image;
      return draw();
    }
    const words = JSON.parse(message.data);
    if (words.width) {
      size = words;
      canvas.width = words.width;
      canvas.height = words.height;
      outlines = words.outlines;
      at("run").textContent = `${words.name}: what is to be left out, into ${words.file}`;
      said("draw");
    } else if (words.saved) said(`${words.saved} is written: leaves out ${(100 * words.share).toFixed(1)} % of the frame`);
    else said(words.refused, true);
  };
}
connect();

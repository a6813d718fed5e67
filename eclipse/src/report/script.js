"use strict";
// One slider turns all pictures of a frame; without scripts the first frame stays.
const data = JSON.parse(document.getElementById("data").textContent);
const slider = document.getElementById("frame");
if (slider) {
  const show = () => {
    const frame = data.frames[slider.value];
    document.getElementById("frame-name").textContent = `frame ${frame.name}`;
    for (const [kind, source] of Object.entries(frame.pictures)) {
      document.getElementById(`frame-${kind}`).src = source;
    }
  };
  slider.addEventListener("input", show);
  show();
}
// An edge between photograph and render.
const edge = document.getElementById("edge");
if (edge) {
  const wipe = () => {
    document.getElementById("frame-photograph").style.clipPath = `inset(0 ${100 - edge.value}% 0 0)`;
  };
  edge.addEventListener("input", wipe);
  wipe();
}
// The environment is kept as radiance, so that any exposure can be looked at.
const canvas = document.getElementById("environment");
const exposure = document.getElementById("exposure");
const floats = (text) => new Float32Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer);
const radiance = floats(data.environment.radiance);
const deviation = data.environment.deviation ? floats(data.environment.deviation) : null;
const context = canvas.getContext("2d");
const pixels = context.createImageData(canvas.width, canvas.height);
const encode = (v) => 255 * (v <= 0.0031308 ? 12.92 * v : 1.055 * v ** (1 / 2.4) - 0.055);
const draw = () => {
  const scale = data.environment.exposure * 2 ** exposure.value;
  for (let i = 0; i < canvas.width * canvas.height; i++) {
    for (let c = 0; c < 3; c++) {
      pixels.data[4 * i + c] = encode(Math.min(1, Math.max(0, scale * radiance[3 * i + c])));
    }
    pixels.data[4 * i + 3] = 255;
  }
  context.putImageData(pixels, 0, 0);
  document.getElementById("stops").textContent = `${exposure.value > 0 ? "+" : ""}${exposure.value} stops`;
};
exposure.addEventListener("input", draw);
draw();
document.getElementById("environment-still").hidden = true;
canvas.hidden = false;
// What is known of the direction under the pointer, in either map.
const read = (event) => {
  const box = event.target.getBoundingClientRect();
  const inside = (share, count) => Math.min(count - 1, Math.max(0, Math.floor(share * count)));
  const column = inside((event.clientX - box.left) / box.width, canvas.width);
  const row = inside((event.clientY - box.top) / box.height, canvas.height);
  const azimuth = 180 - 360 * (column + 0.5) / canvas.width, elevation = 90 - 180 * (row + 0.5) / canvas.height;
  const at = 3 * (row * canvas.width + column);
  const rgb = [...radiance.subarray(at, at + 3)].map((v, c) => {
    const doubt = deviation ? ` ± ${Number(deviation[at + c].toPrecision(2))}` : "";
    return Number(v.toPrecision(3)) + doubt;
  });
  document.getElementById("texel").textContent =
    `Azimuth ${azimuth.toFixed(0)}° from +x, elevation ${elevation.toFixed(0)}°: ${rgb.join(", ")}`;
};
for (const id of ["environment", "environment-sd"]) {
  document.getElementById(id)?.addEventListener("pointermove", read);
}

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
  const { width, height } = canvas;
  const clamp = (v, most) => Math.min(most - 1, Math.max(0, Math.floor(v)));
  const column = clamp((event.offsetX / event.target.clientWidth) * width, width);
  const row = clamp((event.offsetY / event.target.clientHeight) * height, height);
  const azimuth = Math.round(180 - (360 * (column + 0.5)) / width);
  const elevation = Math.round(90 - (180 * (row + 0.5)) / height);
  const at = 3 * (row * width + column);
  const values = ["R", "G", "B"].map((name, c) => {
    const doubt = deviation ? ` ± ${deviation[at + c].toPrecision(2)}` : "";
    return `${name} ${radiance[at + c].toPrecision(3)}${doubt}`;
  });
  document.getElementById("texel").textContent =
    `azimuth ${azimuth}°, elevation ${elevation}°: ${values.join(", ")}`;
};
for (const id of ["environment", "environment-sd"]) {
  document.getElementById(id)?.addEventListener("mousemove", read);
}

// The recovered object in the recovered light and in any other: orbit, exposure, rotation, maps chosen or dropped.
const object = data.object;
const element = (name) => document.getElementById(`viewer-${name}`);
const canvas = element("canvas"), message = element("message");
const view = { azimuth: object.azimuth, elevation: object.elevation, distance: 4.2, turn: 0, stops: 0, backdrop: true, shown: 0 };
const ANGLE = 30 * Math.PI / 180;
const recovered = { width: Number(canvas.dataset.columns), height: Number(canvas.dataset.rows), data: radiance };
// Every map is shown as bright as the recovered light, so that the slider means the same for all.
const white = object.exposure * meanRadiance(recovered);
let light = null, stage = null;

const say = (text, bad) => {
  message.textContent = text;
  message.classList.toggle("bad", Boolean(bad));
};

/// Everything that lives on the graphics card; again after it was lost.
function begin() {
  const gl = canvas.getContext("webgl2", { antialias: true, alpha: false });
  if (!gl) return null;
  const program = (vertex, fragment) => {
    const made = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(made, shader);
    }
    gl.linkProgram(made);
    if (!gl.getProgramParameter(made, gl.LINK_STATUS) && !gl.isContextLost()) {
      throw new Error(`its shaders do not compile here: ${gl.getProgramInfoLog(made)}`);
    }
    const places = {};
    return { made, at: (name) => (places[name] ??= gl.getUniformLocation(made, name)) };
  };
  const solid = program(OBJECT_VERTEX, OBJECT_FRAGMENT), backdrop = program(BACKDROP_VERTEX, BACKDROP_FRAGMENT);
  const mesh = gl.createVertexArray(), empty = gl.createVertexArray();
  gl.bindVertexArray(mesh);
  const bytesOf = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const attribute = (name, text, size, type) => {
    const place = gl.getAttribLocation(solid.made, name);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, bytesOf(text), gl.STATIC_DRAW);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, size, type, true, 0, 0);
  };
  attribute("place", object.places, 4, gl.UNSIGNED_SHORT);
  attribute("normal", object.normals, 4, gl.SHORT);
  attribute("albedo", object.albedo, 4, gl.UNSIGNED_BYTE);
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  const faces = bytesOf(object.faces);
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, faces, gl.STATIC_DRAW);
  gl.enable(gl.DEPTH_TEST);
  // The backdrop lies at the far end itself.
  gl.depthFunc(gl.LEQUAL);
  const texture = (unit, target, wrap) => {
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(target, gl.createTexture());
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(target, filter, gl.LINEAR);
    gl.texParameteri(target, gl.TEXTURE_WRAP_S, wrap);
    gl.texParameteri(target, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
  };
  texture(0, gl.TEXTURE_2D, gl.REPEAT);
  texture(1, gl.TEXTURE_2D_ARRAY, gl.REPEAT);
  texture(2, gl.TEXTURE_2D, gl.CLAMP_TO_EDGE);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA16F, 32, 32, 0, gl.RGBA, gl.FLOAT, reflected(32, 256));
  return { gl, solid, backdrop, mesh, empty, indices: faces.length / 4 };
}

/// Gathers the light of a map and puts it on the card.
function illuminate(map, name) {
  const mean = meanRadiance(map);
  if (!(mean > 0) || !Number.isFinite(mean)) throw new Error("it is black, or not finite");
  const relative = (image) => image.data.map((v) => Math.min(6e4, v / mean));
  const shown = map.width > 1024 ? resampled(map, 1024, 512) : map;
  const small = resampled(shown, COLUMNS, ROWS);
  small.data = small.data.map((v) => v / mean);
  light = { name, shown: { ...shown, data: relative(shown) }, ...gathered(small, object.coated) };
  upload();
}

function upload() {
  const { gl } = stage, { shown, layers, count } = light;
  const rgba = new Float32Array(4 * shown.width * shown.height);
  for (let i = 0; i < shown.width * shown.height; i++) rgba.set(shown.data.subarray(3 * i, 3 * i + 3), 4 * i);
  gl.activeTexture(gl.TEXTURE0);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA16F, shown.width, shown.height, 0, gl.RGBA, gl.FLOAT, rgba);
  gl.activeTexture(gl.TEXTURE1);
  const limited = layers.map((v) => Math.min(6e4, v));
  gl.texImage3D(gl.TEXTURE_2D_ARRAY, 0, gl.RGBA16F, COLUMNS, ROWS, count, 0, gl.RGBA, gl.FLOAT, limited);
  say(light.name);
  redraw();
}

let asked = false;
function redraw() {
  if (asked) return;
  asked = true;
  requestAnimationFrame(() => {
    asked = false;
    if (stage && light && !stage.gl.isContextLost()) paint();
  });
}

function paint() {
  const { gl, solid, backdrop, mesh, empty, indices } = stage;
  const ratio = Math.min(2, window.devicePixelRatio || 1);
  const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((side) => Math.max(1, Math.round(side * ratio)));
  if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
  gl.viewport(0, 0, width, height);
  const [ca, sa] = [Math.cos(view.azimuth), Math.sin(view.azimuth)];
  const [ce, se] = [Math.cos(view.elevation), Math.sin(view.elevation)];
  const forward = [-ca * ce, -sa * ce, -se], right = [-sa, ca, 0], up = [-ca * se, -sa * se, ce];
  const distance = view.distance * object.radius, eye = forward.map((v) => -distance * v);
  const tall = Math.tan(ANGLE / 2), wide = tall * width / height;
  const exposure = white * 2 ** view.stops;
  gl.clearColor(0.11, 0.12, 0.14, 1);
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  const shared = (program) => {
    gl.useProgram(program.made);
    gl.uniform1f(program.at("turn"), view.turn);
    gl.uniform1f(program.at("exposure"), exposure);
    gl.uniform1i(program.at("map"), 0);
  };
  if (view.backdrop && view.shown === 0) {
    gl.bindVertexArray(empty);
    shared(backdrop);
    gl.depthMask(false);
    gl.uniform3fv(backdrop.at("right"), right.map((v) => wide * v));
    gl.uniform3fv(backdrop.at("up"), up.map((v) => tall * v));
    gl.uniform3fv(backdrop.at("forward"), forward);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.depthMask(true);
  }
  gl.bindVertexArray(mesh);
  shared(solid);
  const near = Math.max(0.01 * object.radius, distance - 1.1 * object.radius), far = distance + 1.1 * object.radius;
  const rows = [right.map((v) => v / wide), up.map((v) => v / tall)];
  const depth = (far + near) / (far - near), shift = -2 * far * near / (far - near);
  const matrix = [];
  for (let k = 0; k < 3; k++) matrix.push(rows[0][k], rows[1][k], depth * forward[k], forward[k]);
  matrix.push(0, 0, depth * distance + shift, distance);
  gl.uniformMatrix4fv(solid.at("clipFromWorld"), false, matrix);
  gl.uniform3fv(solid.at("low"), object.low);
  gl.uniform3fv(solid.at("extent"), object.extent);
  gl.uniform3fv(solid.at("eye"), eye);
  gl.uniform1f(solid.at("coated"), object.coated ? 1 : 0);
  gl.uniform1f(solid.at("layers"), light.count);
  gl.uniform1f(solid.at("kappaWhite"), object.kappaWhite);
  gl.uniform1i(solid.at("shown"), view.shown);
  gl.uniform1i(solid.at("lobes"), 1);
  gl.uniform1i(solid.at("brdf"), 2);
  gl.drawElements(gl.TRIANGLES, indices, gl.UNSIGNED_INT, 0);
}

const absent = (text) => {
  say(text, true);
  canvas.hidden = true;
  element("controls").hidden = true;
};
function start() {
  try {
    stage = begin();
    if (!stage) {
      absent("This needs WebGL 2, which this browser does not offer: it may be switched off, or lack a graphics driver. " +
        "eclipse relight renders the same object, with its shadows.");
      return;
    }
    if (light) upload();
    else illuminate(recovered, "Under the recovered light.");
  } catch (error) {
    absent(`The viewer cannot run: ${error.message}.`);
  }
}
canvas.addEventListener("webglcontextlost", (event) => {
  event.preventDefault();
  say("The graphics card was taken away; the picture returns with it.", true);
});
canvas.addEventListener("webglcontextrestored", start);

// Orbit: one pointer turns, two or the wheel come closer, arrow keys do too.
const limit = (value, low, high) => Math.min(high, Math.max(low, value));
const orbit = (across, down) => {
  view.azimuth -= across;
  view.elevation = limit(view.elevation + down, -1.55, 1.55);
  redraw();
};
const closer = (factor) => {
  view.distance = limit(view.distance * factor, 1.3, 20);
  redraw();
};
const pointers = new Map();
const spread = () => {
  const [a, b] = [...pointers.values()];
  return Math.hypot(a[0] - b[0], a[1] - b[1]);
};
canvas.addEventListener("pointerdown", (event) => {
  canvas.setPointerCapture(event.pointerId);
  pointers.set(event.pointerId, [event.clientX, event.clientY]);
});
canvas.addEventListener("pointermove", (event) => {
  const last = pointers.get(event.pointerId);
  if (!last) return;
  const before = pointers.size === 2 ? spread() : 0;
  pointers.set(event.pointerId, [event.clientX, event.clientY]);
  if (pointers.size === 1) orbit((event.clientX - last[0]) / 150, (event.clientY - last[1]) / 150);
  else if (pointers.size === 2) closer(before / Math.max(1, spread()));
});
for (const kind of ["pointerup", "pointercancel"]) canvas.addEventListener(kind, (event) => pointers.delete(event.pointerId));
canvas.addEventListener("wheel", (event) => {
  // The page scrolls on unless the canvas was touched: nobody gets caught in it.
  if (document.activeElement !== canvas) return;
  event.preventDefault();
  closer(2 ** (event.deltaY / 500));
}, { passive: false });
canvas.addEventListener("keydown", (event) => {
  const steps = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] };
  if (steps[event.key]) orbit(...steps[event.key]);
  else if (event.key === "+" || event.key === "-") closer(event.key === "+" ? 1 / 1.1 : 1.1);
  else return;
  event.preventDefault();
});

const control = (name, act) => element(name).addEventListener("input", (event) => {
  act(event.target);
  redraw();
});
control("exposure", ({ value }) => {
  view.stops = Number(value);
  element("stops").textContent = `${value > 0 ? "+" : ""}${value} stops`;
});
control("rotation", ({ value }) => {
  view.turn = Number(value) * Math.PI / 180;
  element("degrees").textContent = `${value}°`;
});
control("backdrop", ({ checked }) => (view.backdrop = checked));
control("shown", ({ value }) => (view.shown = Number(value)));

/// Takes a chosen or dropped file; what cannot be read changes nothing but the message.
async function take(file) {
  if (!file || !stage) return;
  say(`Reading ${file.name} …`);
  try {
    const bytes = await file.arrayBuffer();
    const map = isOpenExr(bytes) ? await readOpenExr(bytes) : readRadiance(bytes);
    // The message is painted before the work begins.
    await new Promise((done) => setTimeout(done, 20));
    illuminate(map, `Under ${file.name}, ${map.width} × ${map.height}.`);
  } catch (error) {
    say(`${file.name} cannot be used: ${error.message}.`, true);
  }
}
element("file").addEventListener("change", (event) => {
  take(event.target.files[0]);
  event.target.value = "";
});
const place = element("drop");
place.addEventListener("dragover", (event) => {
  event.preventDefault();
  place.classList.add("over");
});
place.addEventListener("dragleave", () => place.classList.remove("over"));
place.addEventListener("drop", (event) => {
  event.preventDefault();
  place.classList.remove("over");
  take(event.dataTransfer.files[0]);
});
element("recovered").addEventListener("click", () => stage && illuminate(recovered, "Under the recovered light."));
element("lamp").addEventListener("click", () => stage && illuminate(lamp(), "Under a lamp from +x, a little above, in a dim room."));
if (window.ResizeObserver) new ResizeObserver(redraw).observe(canvas);
// Nothing is computed before somebody scrolls this far.
new IntersectionObserver((entries, observer) => {
  if (entries.some((entry) => entry.isIntersecting)) {
    observer.disconnect();
    start();
  }
}, { rootMargin: "300px" }).observe(place);

/// A lamp of 12° across, for whoever has no map at hand.
function lamp() {
  const map = { width: 128, height: 64, data: new Float32Array(3 * 128 * 64) };
  const [x, z] = [Math.cos(0.6), Math.sin(0.6)];
  for (let r = 0; r < 64; r++) {
    const theta = Math.PI * (r + 0.5) / 64;
    for (let c = 0; c < 128; c++) {
      const phi = 2 * Math.PI * (0.5 - (c + 0.5) / 128);
      const cos = x * Math.sin(theta) * Math.cos(phi) + z * Math.cos(theta);
      map.data.set(cos > Math.cos(0.105) ? [300, 280, 240] : [0.25, 0.27, 0.3], 3 * (128 * r + c));
    }
  }
  return map;
}

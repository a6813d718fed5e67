// Radiance's picture format (Ward, "Real Pixels", Graphics Gems II): RGBE, flat or run-length coded, rows from the top.
//
// An image here is {width, height, data}: three floats a pixel, row 0 at the top.
const MOST_TEXELS = 8192 * 4096;

function readRadiance(buffer) {
  const bytes = new Uint8Array(buffer);
  let at = 0;
  const line = () => {
    const from = at;
    while (at < bytes.length && bytes[at] !== 10) at++;
    if (at - from > 4096 || at >= bytes.length) throw new Error("its header does not end");
    return String.fromCharCode(...bytes.subarray(from, at++));
  };
  if (bytes[0] !== 35 || bytes[1] !== 63) {
    throw new Error("it is neither an OpenEXR picture nor a Radiance picture, which begins with #?RADIANCE");
  }
  const factors = [1, 1, 1];
  for (let text = line(); text.trim() !== ""; text = line()) {
    multiply(factors, text);
    if (text.startsWith("FORMAT=") && text.trim() !== "FORMAT=32-bit_rle_rgbe") {
      throw new Error(`its ${text.trim()} is not 32-bit_rle_rgbe`);
    }
  }
  const resolution = line();
  const size = /^-Y (\d+) \+X (\d+)$/.exec(resolution.trim());
  if (!size) throw new Error(`its size reads "${resolution}" where "-Y rows +X columns" was expected`);
  const [height, width] = [Number(size[1]), Number(size[2])];
  if (width !== 2 * height || height < 1) {
    throw new Error(`it has ${width} × ${height} pixels; a map of all directions is twice as wide as high`);
  }
  if (width * height > MOST_TEXELS) throw new Error(`its ${width} × ${height} pixels are more than 8192 × 4096`);
  const data = new Float32Array(3 * width * height);
  const row = new Uint8Array(4 * width);
  for (let y = 0; y < height; y++) {
    at = bytes[at] === 2 && bytes[at + 1] === 2 && bytes[at + 2] < 128 && width >= 8 && width < 32768
      ? planes(bytes, at, row, width)
      : pixels(bytes, at, row, width);
    for (let x = 0; x < width; x++) {
      const exponent = row[4 * x + 3];
      const scale = exponent === 0 ? 0 : 2 ** (exponent - 136);
      for (let c = 0; c < 3; c++) data[3 * (y * width + x) + c] = row[4 * x + c] * scale / factors[c];
    }
  }
  return { width, height, data };
}

/// Multiplies by what a line of the header says the values were multiplied with.
function multiply(factors, line) {
  const [, name, value] = /^\s*(EXPOSURE|COLORCORR)\s*=(.*)$/.exec(line) ?? [];
  if (!name) return;
  const numbers = value.trim().split(/\s+/).map(Number);
  for (let c = 0; c < 3; c++) {
    factors[c] *= numbers[name === "EXPOSURE" ? 0 : c];
    if (!(factors[c] > 0 && factors[c] < Infinity)) {
      throw new Error(`its header says "${line.trim()}", by which no light can have been multiplied`);
    }
  }
}

const ENDS = "it ends within a row";

/// A row whose four channels are coded one after the other; returns where the next begins.
function planes(bytes, at, row, width) {
  if ((bytes[at + 2] << 8 | bytes[at + 3]) !== width) throw new Error("a row has another length than its header says");
  at += 4;
  for (let c = 0; c < 4; c++) {
    for (let x = 0; x < width;) {
      if (at + 1 >= bytes.length) throw new Error(ENDS);
      const count = bytes[at++];
      const run = count > 128;
      const length = run ? count - 128 : count;
      if (length === 0 || x + length > width || (!run && at + length > bytes.length)) throw new Error("a run of it is damaged");
      for (let k = 0; k < length; k++) row[4 * x++ + c] = run ? bytes[at] : bytes[at + k];
      at += run ? 1 : length;
    }
  }
  return at;
}

/// A row of pixels, some of which may say how often to repeat the one before.
function pixels(bytes, at, row, width) {
  let shift = 0;
  for (let x = 0; x < width;) {
    if (at + 4 > bytes.length) throw new Error(ENDS);
    const pixel = bytes.subarray(at, at + 4);
    at += 4;
    if (pixel[0] === 1 && pixel[1] === 1 && pixel[2] === 1) {
      const length = pixel[3] * 2 ** shift;
      if (x === 0 || x + length > width) throw new Error("a run of it is damaged");
      for (let k = 0; k < length; k++, x++) row.copyWithin(4 * x, 4 * (x - 1), 4 * x);
      shift += 8;
    } else {
      row.set(pixel, 4 * x++);
      shift = 0;
    }
  }
  return at;
}

// Light gathered by lobes: what a surface of each roughness receives around every direction, for a map of all directions.
//
// Maps are equirectangular, top row +z, centre column +x, azimuth falling to the right. A lobe that looks the same from all
// sides is, from row to row, a circular convolution along the azimuth: the sums over all texels are exact, by Fourier
// transforms of rows.
const COLUMNS = 256;
const ROWS = COLUMNS / 2;
/// Roughness √α of the gathered lobes.
const ROUGHNESSES = [0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0];

/// The mean over all directions of the mean over channels.
function meanRadiance(map) {
  let sum = 0, weights = 0;
  for (let y = 0; y < map.height; y++) {
    const weight = solidAngle(y, map.height, map.width);
    for (let k = 3 * y * map.width; k < 3 * (y + 1) * map.width; k++) sum += weight * map.data[k] / 3;
    weights += weight * map.width;
  }
  return sum / weights;
}

function solidAngle(row, rows, columns) {
  const z = (v) => Math.cos(Math.PI * v / rows);
  return (z(row) - z(row + 1)) * 2 * Math.PI / columns;
}

/// The map on another grid: averaged over areas where that is coarser, interpolated where finer.
function resampled(map, width, height) {
  const across = taps(map.width, width, true), down = taps(map.height, height, false);
  const wide = new Float32Array(3 * width * map.height);
  for (let y = 0; y < map.height; y++) {
    across.forEach((list, x) => list.forEach(([source, weight]) => {
      for (let c = 0; c < 3; c++) wide[3 * (y * width + x) + c] += weight * map.data[3 * (y * map.width + source) + c];
    }));
  }
  const data = new Float32Array(3 * width * height);
  down.forEach((list, y) => {
    // Rows near a pole are shorter: they count by their solid angle.
    const weights = list.map(([source, weight]) => weight * solidAngle(source, map.height, 1));
    const total = weights.reduce((a, b) => a + b);
    list.forEach(([source], k) => {
      for (let i = 0; i < 3 * width; i++) data[3 * width * y + i] += weights[k] / total * wide[3 * width * source + i];
    });
  });
  return { width, height, data };
}

/// For each of `to` cells the cells of `from` that it takes from, with weights that sum to one.
function taps(from, to, wraps) {
  return Array.from({ length: to }, (_, index) => {
    const inside = (k) => (wraps ? (k + from) % from : Math.min(from - 1, Math.max(0, k)));
    if (from <= to) {
      const place = (index + 0.5) * from / to - 0.5, low = Math.floor(place);
      return [[inside(low), 1 - place + low], [inside(low + 1), place - low]];
    }
    const begin = index * from / to, end = (index + 1) * from / to, list = [];
    for (let k = Math.floor(begin); k < Math.min(from, end); k++) {
      const part = Math.min(end, k + 1) - Math.max(begin, k);
      if (part > 1e-9) list.push([k, part / (end - begin)]);
    }
    return list;
  });
}

/// The layers for one map of COLUMNS × ROWS, RGBA: a lobe's mean for each of ROUGHNESSES, then irradiance over π.
///
/// `coated`: light that a coat lets in counts, (1 − (1 − cos)⁵); the rest of Schlick's factor is constant.
function gathered(map, coated) {
  const kernels = [...ROUGHNESSES.map(lobe), coated ? coatedCosine : cosine];
  const size = COLUMNS * ROWS, half = COLUMNS / 2 + 1;
  const rows = spectra(map);
  const layers = new Float32Array(4 * size * kernels.length);
  // The sphere looks the same upside down: what a row gives to another, their mirror images give to each other.
  const sums = [0, 1].map(() => kernels.map(() => new Float64Array(6 * half)));
  const totals = new Float64Array(kernels.length);
  const re = new Float64Array(COLUMNS), im = new Float64Array(COLUMNS);
  for (let out = 0; out < ROWS / 2; out++) {
    sums.flat().forEach((sum) => sum.fill(0));
    totals.fill(0);
    for (let row = 0; row < ROWS; row++) {
      const angles = cosines(out, row), area = solidAngle(row, ROWS, COLUMNS);
      // Column 0 is nearest: all of the row lies behind.
      if (angles[0] <= 0) continue;
      // Two kernels at once: both are even, so their transforms are real.
      for (let k = 0; k < kernels.length; k += 2) {
        for (let x = 0; x < half; x++) {
          re[x] = kernels[k](angles[x]);
          im[x] = kernels[k + 1](angles[x]);
        }
        for (let x = half; x < COLUMNS; x++) [re[x], im[x]] = [re[COLUMNS - x], im[COLUMNS - x]];
        fourier(re, im);
        [row, ROWS - 1 - row].forEach((from, side) => {
          accumulate(sums[side][k], re, rows, from);
          accumulate(sums[side][k + 1], im, rows, from);
        });
        totals[k] += area * re[0];
        totals[k + 1] += area * im[0];
      }
    }
    [out, ROWS - 1 - out].forEach((to, side) => kernels.forEach((_, k) => {
      // Lobes are means; irradiance is a sum, over π.
      const factor = 1 / COLUMNS / (k < ROUGHNESSES.length ? totals[k] : Math.PI);
      for (let c = 0; c < 3; c++) {
        const offset = 2 * c * half;
        for (let x = 0; x < COLUMNS; x++) {
          // The inverse transform is the forward one of the conjugate; only real parts are of interest.
          const f = x < half ? x : COLUMNS - x, sign = x < half ? -1 : 1;
          re[x] = sums[side][k][offset + f];
          im[x] = sign * sums[side][k][offset + half + f];
        }
        fourier(re, im);
        for (let x = 0; x < COLUMNS; x++) layers[4 * (k * size + to * COLUMNS + x) + c] = Math.max(0, factor * re[x]);
      }
    }));
  }
  return { layers, count: kernels.length };
}

const cosine = (cos) => Math.max(0, cos);
const coatedCosine = (cos) => (cos > 0 ? cos * (1 - (1 - cos) ** 5) : 0);

/// GGX mirrored about the middle of a lobe that is seen along it, times the cosine (Karis, "Real Shading in Unreal Engine 4").
function lobe(roughness) {
  const a2 = roughness ** 4;
  return (cos) => {
    if (cos <= 0) return 0;
    // Half the angle: sin² and cos² without cancellation.
    const s = (1 - cos) / 2 + a2 * (1 + cos) / 2;
    return a2 * cos / (s * s);
  };
}

/// Cosines of the angles between the middle of row `a`, column 0, and the first half of row `b`.
function cosines(a, b) {
  const u = Math.PI * (a + 0.5) / ROWS, v = Math.PI * (b + 0.5) / ROWS;
  const constant = Math.cos(u) * Math.cos(v), factor = Math.sin(u) * Math.sin(v);
  return AZIMUTHS.map((c) => constant + factor * c);
}
const AZIMUTHS = Float64Array.from({ length: COLUMNS / 2 + 1 }, (_, x) => Math.cos(2 * Math.PI * x / COLUMNS));

/// The transform of each row's light: for each row and channel real parts, then imaginary ones.
function spectra(map) {
  const half = COLUMNS / 2 + 1, found = new Float64Array(6 * half * ROWS);
  const re = new Float64Array(COLUMNS), im = new Float64Array(COLUMNS);
  for (let row = 0; row < ROWS; row++) {
    const area = solidAngle(row, ROWS, COLUMNS);
    for (let c = 0; c < 3; c++) {
      for (let x = 0; x < COLUMNS; x++) re[x] = area * map.data[3 * (row * COLUMNS + x) + c];
      im.fill(0);
      fourier(re, im);
      found.set(re.subarray(0, half), (6 * row + 2 * c) * half);
      found.set(im.subarray(0, half), (6 * row + 2 * c + 1) * half);
    }
  }
  return found;
}

function accumulate(sum, kernel, rows, row) {
  const half = COLUMNS / 2 + 1, offset = 6 * half * row;
  for (let part = 0; part < 6; part++) {
    for (let f = 0; f < half; f++) sum[part * half + f] += kernel[f] * rows[offset + part * half + f];
  }
}

/// The transform in place, of a length that is COLUMNS.
function fourier(re, im) {
  for (let i = 0; i < COLUMNS; i++) {
    const j = REVERSED[i];
    if (i < j) [re[i], re[j], im[i], im[j]] = [re[j], re[i], im[j], im[i]];
  }
  for (let length = 2; length <= COLUMNS; length *= 2) {
    const half = length / 2, step = COLUMNS / length;
    for (let from = 0; from < COLUMNS; from += length) {
      for (let k = 0; k < half; k++) {
        const c = TURNS_RE[k * step], s = TURNS_IM[k * step], a = from + k, b = a + half;
        const x = c * re[b] - s * im[b], y = c * im[b] + s * re[b];
        re[b] = re[a] - x;
        im[b] = im[a] - y;
        re[a] += x;
        im[a] += y;
      }
    }
  }
}
const TURNS_RE = Float64Array.from({ length: COLUMNS / 2 }, (_, k) => Math.cos(2 * Math.PI * k / COLUMNS));
const TURNS_IM = Float64Array.from({ length: COLUMNS / 2 }, (_, k) => -Math.sin(2 * Math.PI * k / COLUMNS));
const REVERSED = Uint16Array.from({ length: COLUMNS }, (_, i) => {
  let reversed = 0;
  for (let bit = 1; bit < COLUMNS; bit *= 2) reversed = 2 * reversed + (i & bit ? 1 : 0);
  return reversed;
});

/// What a lobe reflects under even light, by n·o (columns) and √α (rows): factor of κ, and the rest. S1–S7 of the paper.
function reflected(size, samples) {
  const table = new Float32Array(4 * size * size);
  for (let row = 0; row < size; row++) {
    const alpha = Math.max(0.02, ((row + 0.5) / size) ** 2), k = (alpha + 1) ** 2 / 8;
    for (let column = 0; column < size; column++) {
      const o = (column + 0.5) / size, sine = Math.sqrt(1 - o * o);
      let scale = 0, rest = 0;
      for (let i = 0; i < samples; i++) {
        const u = (i + 0.5) / samples, phi = 2 * Math.PI * ((i * 0.618033988749895) % 1);
        const cos = Math.sqrt((1 - u) / (1 + (alpha * alpha - 1) * u)), sin = Math.sqrt(1 - cos * cos);
        const difference = sine * sin * Math.cos(phi) + o * cos, incident = 2 * difference * cos - o;
        if (incident <= 0 || difference <= 0) continue;
        const weight = incident * difference / ((k + (1 - k) * incident) * (k + (1 - k) * o) * cos) / samples;
        const grazing = (1 - difference) ** 5;
        scale += weight * (1 - grazing);
        rest += weight * grazing;
      }
      table.set([scale, rest, 0, 1], 4 * (row * size + column));
    }
  }
  return table;
}

// OpenEXR's picture format: one part of scan lines, stored, run-length coded or deflated (openexr.com, "OpenEXR File Layout").
//
// An image here is {width, height, data}: three floats a pixel, row 0 at the top.
const COMPRESSIONS = ["NONE", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "B44", "B44A", "DWAA", "DWAB"];
/// Rows that are compressed together, of the kinds that are read.
const ROWS_OF_BLOCK = { NONE: 1, RLE: 1, ZIPS: 1, ZIP: 16 };
const BYTES_OF_SAMPLE = [4, 2, 4];

function isOpenExr(buffer) {
  return buffer.byteLength >= 8 && new DataView(buffer).getUint32(0, true) === 20000630;
}

async function readOpenExr(buffer) {
  const view = new DataView(buffer);
  const header = exrHeader(view);
  const { top, width, height, channels, compression } = header;
  const rows = ROWS_OF_BLOCK[compression];
  const bytesOfRow = width * channels.reduce((sum, channel) => sum + BYTES_OF_SAMPLE[channel.type], 0);
  const colours = coloursOf(channels);
  const data = new Float32Array(3 * width * height);
  const blocks = Math.ceil(height / rows);
  if (header.end + 8 * blocks > buffer.byteLength) throw new Error("it ends within its table of rows");
  for (let k = 0; k < blocks; k++) {
    const at = Number(view.getBigUint64(header.end + 8 * k, true));
    if (at + 8 > buffer.byteLength) throw new Error("its rows lie behind its end");
    const first = view.getInt32(at, true) - top, length = view.getInt32(at + 4, true);
    if (first < 0 || first >= height || length < 0 || at + 8 + length > buffer.byteLength) throw new Error("a block of its rows is damaged");
    const count = Math.min(rows, height - first);
    const packed = new Uint8Array(buffer, at + 8, length);
    const raw = await unpacked(packed, compression, count * bytesOfRow);
    const block = new DataView(raw.buffer, raw.byteOffset, raw.byteLength);
    for (let row = 0; row < count; row++) {
      for (const { offset, type, targets } of colours) {
        for (let x = 0; x < width; x++) {
          const value = sampleAt(block, row * bytesOfRow + width * offset + x * BYTES_OF_SAMPLE[type], type);
          if (Number.isNaN(value)) throw new Error("it holds NaN");
          // As eclipse reads maps: negative light is none, infinite light the largest half float.
          for (const c of targets) data[3 * ((first + row) * width + x) + c] = Math.min(Math.max(value, 0), 65504);
        }
      }
    }
  }
  return { width, height, data };
}

/// What its attributes say, and where they end.
function exrHeader(view) {
  const version = view.getUint32(4, true);
  for (const [bit, what] of [[0x200, "tiles"], [0x800, "deep samples"], [0x1000, "several parts"]]) {
    if (version & bit) throw new Error(`it has ${what} where rows of one part were expected`);
  }
  let at = 8;
  const byte = () => {
    if (at >= view.byteLength) throw new Error("its header does not end");
    return view.getUint8(at++);
  };
  const text = () => {
    let found = "";
    for (let c = byte(); c !== 0; c = byte()) {
      if (found.length >= 256) throw new Error("its header is damaged");
      found += String.fromCharCode(c);
    }
    return found;
  };
  const found = {};
  for (let name = text(); name !== ""; name = text()) {
    text();
    if (at + 4 > view.byteLength) throw new Error("its header does not end");
    const length = view.getInt32(at, true);
    at += 4;
    if (length < 0 || at + length > view.byteLength) throw new Error("its header does not end");
    const start = at;
    if (name === "compression" && length === 1) {
      found.compression = COMPRESSIONS[view.getUint8(start)] ?? "unknown";
    } else if (name === "dataWindow" && length === 16) {
      const [left, top, right, bottom] = [0, 4, 8, 12].map((k) => view.getInt32(start + k, true));
      Object.assign(found, { top, width: right - left + 1, height: bottom - top + 1 });
    } else if (name === "channels") {
      found.channels = [];
      for (let channel = text(); channel !== ""; channel = text()) {
        if (at + 16 > start + length) throw new Error("its list of channels is damaged");
        const type = view.getInt32(at, true);
        const full = view.getInt32(at + 8, true) === 1 && view.getInt32(at + 12, true) === 1;
        if (!(type in BYTES_OF_SAMPLE) || !full) throw new Error(`its channel ${channel} is not of one number a pixel`);
        found.channels.push({ name: channel, type });
        at += 16;
      }
    }
    at = start + length;
  }
  const { width, height, channels, compression } = found;
  if (!channels || compression === undefined || width === undefined) throw new Error("its header lacks channels, compression or dataWindow");
  if (width !== 2 * height || height < 1) {
    throw new Error(`it has ${width} × ${height} pixels; a map of all directions is twice as wide as high`);
  }
  if (width * height > MOST_TEXELS) throw new Error(`its ${width} × ${height} pixels are more than 8192 × 4096`);
  if (!(compression in ROWS_OF_BLOCK)) {
    throw new Error(`its compression is ${compression}; NONE, RLE, ZIPS and ZIP are read here, the others by eclipse relight`);
  }
  return { ...found, end: at };
}

/// The channels of colours: where they lie in a row, in samples' bytes for a pixel, and which of red, green and blue they are.
function coloursOf(channels) {
  let offset = 0;
  const placed = channels.map((channel) => {
    const at = offset;
    offset += BYTES_OF_SAMPLE[channel.type];
    return { ...channel, offset: at };
  });
  const named = (name) => placed.find((channel) => channel.name === name) ?? placed.find((channel) => channel.name.endsWith(`.${name}`));
  const colours = ["R", "G", "B"].map(named);
  if (colours.every((channel) => channel)) return colours.map((channel, c) => ({ ...channel, targets: [c] }));
  const grey = named("Y");
  if (!grey) throw new Error(`it has no channels R, G and B, but ${channels.map((channel) => channel.name).join(", ")}`);
  return [{ ...grey, targets: [0, 1, 2] }];
}

function sampleAt(block, at, type) {
  if (type === 2) return block.getFloat32(at, true);
  if (type === 0) return block.getUint32(at, true);
  const half = block.getUint16(at, true);
  const [sign, exponent, fraction] = [half >> 15 ? -1 : 1, half >> 10 & 31, half & 1023];
  if (exponent === 31) return fraction ? NaN : sign * Infinity;
  return sign * (exponent ? (1 + fraction / 1024) * 2 ** (exponent - 15) : fraction * 2 ** -24);
}

/// The bytes of some rows.
async function unpacked(packed, compression, size) {
  if (compression === "NONE" || packed.length === size) {
    if (packed.length !== size) throw new Error("a block of its rows has another size than its header says");
    return packed;
  }
  const coded = compression === "RLE" ? runs(packed, size) : await inflated(packed, size);
  for (let k = 1; k < size; k++) coded[k] = coded[k - 1] + coded[k] - 128;
  // Bytes at even places come first, then those at odd ones.
  const bytes = new Uint8Array(size), half = (size + 1) >> 1;
  for (let k = 0; k < size; k++) bytes[k] = coded[k & 1 ? half + (k >> 1) : k >> 1];
  return bytes;
}

function runs(packed, size) {
  const bytes = new Uint8Array(size);
  let to = 0;
  for (let at = 0; at < packed.length;) {
    const count = packed[at++] << 24 >> 24;
    const length = count < 0 ? -count : count + 1;
    const read = count < 0 ? length : 1;
    if (to + length > size || at + read > packed.length) throw new Error("a run of it is damaged");
    for (let k = 0; k < length; k++) bytes[to++] = packed[count < 0 ? at + k : at];
    at += read;
  }
  if (to !== size) throw new Error("a run of it is damaged");
  return bytes;
}

/// No more than `size` bytes, whatever is promised.
async function inflated(packed, size) {
  const bytes = new Uint8Array(size);
  let to = 0;
  const reader = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate")).getReader();
  for (let part = await reader.read().catch(damaged); !part.done; part = await reader.read().catch(damaged)) {
    if (to + part.value.length > size) {
      await reader.cancel();
      damaged();
    }
    bytes.set(part.value, to);
    to += part.value.length;
  }
  if (to !== size) damaged();
  return bytes;
}

function damaged() {
  throw new Error("a block of its rows is damaged");
}

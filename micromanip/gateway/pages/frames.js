// A binary message: a header of JSON, then arrays of 32-bit numbers (see frames.py).
const TYPES = { f4: Float32Array, u4: Uint32Array };
const text = new TextDecoder();

export function parsed(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  let at = 4 + length;
  const header = JSON.parse(text.decode(new Uint8Array(buffer, 4, length)));
  const arrays = {};
  for (const [name, type, count] of header.arrays) {
    arrays[name] = new TYPES[type](buffer, at, count);
    at += 4 * count;
  }
  return [header, arrays];
}

/** Times (s) from the cycle `zero` on, and {name: [least, greatest]}, of a frame. */
export function traced(header, arrays, zero, period_s) {
  const times = Float64Array.from(arrays.cycles, (cycle) => (cycle + header.origin - zero) * period_s);
  const traces = Object.fromEntries([...header.fields, "state"].map((name) => [name, [arrays[`${name} low`], arrays[`${name} high`]]]));
  return { times, traces };
}

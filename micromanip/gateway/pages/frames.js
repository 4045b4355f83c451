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

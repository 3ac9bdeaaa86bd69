// The safetensors format: eight bytes of length, a JSON header, and the numbers.

/**
 * @param {ArrayBuffer} buffer a whole file
 * @returns {Record<string, Float32Array>} its tensors, flat, in row-major order
 */
export function readSafetensors(buffer) {
  const length = Number(new DataView(buffer).getBigUint64(0, true));
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 8, length)));
  const tensors = {};
  for (const [name, { dtype, data_offsets: [begin, end] }] of Object.entries(header)) {
    if (name === "__metadata__") continue;
    if (dtype !== "F32") throw new Error(`the tensor ${name} is of ${dtype}, and only F32 is read`);
    // A copy, because the numbers need not begin at a multiple of four bytes.
    tensors[name] = new Float32Array(buffer.slice(8 + length + begin, 8 + length + end));
  }
  return tensors;
}

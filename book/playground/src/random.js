// Random numbers from seeds: the same seeds give the same numbers on every machine.

/** A generator (sfc32) that is seeded by several whole numbers: its purpose, and the episode. */
export class Random {
  /** @param {...number} seeds */
  constructor(...seeds) {
    let hash = 0x9e3779b9;
    const next = () => {
      hash = (hash + 0x6d2b79f5) | 0;
      let t = Math.imul(hash ^ (hash >>> 15), hash | 1);
      t ^= t + Math.imul(t ^ (t >>> 7), t | 61);
      return (t ^ (t >>> 14)) | 0;
    };
    for (const seed of seeds) {
      hash ^= Math.imul(seed + 1, 0x85ebca6b);
      hash = next();
    }
    this.state = Int32Array.from({ length: 4 }, next);
    this.spare = null;
    for (let i = 0; i < 12; i++) this.uniform();
  }

  /** A number in [0, 1). */
  uniform() {
    const s = this.state;
    const t = (((s[0] + s[1]) | 0) + s[3]) | 0;
    s[3] = s[3] + 1;
    s[0] = s[1] ^ (s[1] >>> 9);
    s[1] = s[2] + (s[2] << 3);
    s[2] = ((s[2] << 21) | (s[2] >>> 11)) + t;
    return (t >>> 0) / 4294967296;
  }

  /** A standard normal number (Box and Muller). */
  normal() {
    if (this.spare !== null) {
      const spare = this.spare;
      this.spare = null;
      return spare;
    }
    const radius = Math.sqrt(-2 * Math.log(1 - this.uniform()));
    const angle = 2 * Math.PI * this.uniform();
    this.spare = radius * Math.sin(angle);
    return radius * Math.cos(angle);
  }

  /** @param {number} n @returns {Float64Array} */
  normals(n) {
    return Float64Array.from({ length: n }, () => this.normal());
  }
}

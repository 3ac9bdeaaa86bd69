// When to attack (detden_lite/attacks/timing.py).
import { Random } from "./random.js";

/** The step from which on the timing "after" attacks a robot that is already walking. */
export const AFTER = 100;

/** The timings by name. */
export const TIMINGS = {
  always: "at every step",
  after: `from step ${AFTER} on`,
  vulnerable: "when V is below C_vul",
  random: "at random steps",
  key: "while you hold A or the button",
};

/** One timing in one episode. */
export class Timing {
  /** @param {number} seed of the episode */
  constructor(seed) {
    this.random = new Random(5, seed);
  }

  /**
   * Whether to attack now.
   * @param {string} name a key of TIMINGS
   * @param {{step: number, value: number, cVul: number, rate: number, pressed: boolean}} now
   */
  strikes(name, { step, value, cVul, rate, pressed }) {
    const drawn = this.random.uniform(); // at every step, so that another timing before it changes nothing
    return { always: true, after: step >= AFTER, vulnerable: value < cVul, random: drawn < rate, key: pressed }[name];
  }
}

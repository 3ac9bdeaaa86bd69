// Attacks within the l-infinity ball around an observation (detden_lite/attacks, core/ascent.py).
import { Random } from "./random.js";

/** @typedef {(x: Float32Array, slope: boolean) => {value: number, gradient?: Float64Array}} Objective */

/** The nearest point of the ball. */
export function project(obs, x, epsilon) {
  return Float32Array.from(obs, (o, i) => Math.min(Math.max(x[i], o - epsilon), o + epsilon));
}

/**
 * Projected gradient ascent: the best of all points that were visited. Steps shrink evenly from epsilon towards 0.
 * @param {Objective} objective
 * @param {Float32Array} obs
 * @param {number} epsilon
 * @param {Random} random where the start comes from
 * @param {number} steps 1 is FGSM
 * @returns {Float32Array}
 */
export function ascend(objective, obs, epsilon, random, steps) {
  let x = Float32Array.from(obs, (o) => o + epsilon * (2 * random.uniform() - 1));
  x = project(obs, x, epsilon);
  let best = { x: obs, value: -Infinity };
  for (let step = 0; step <= steps; step++) {
    const { value, gradient } = objective(x, step < steps);
    if (value > best.value) best = { x, value };
    if (step < steps) {
      const size = epsilon * (1 - step / steps);
      const there = x.map((xi, i) => xi + size * Math.sign(gradient[i]));
      x = project(obs, there, epsilon);
    }
  }
  return best.x;
}

/** l_op: how far the policy's action moves, squared, in units of a Gaussian policy's standard deviations. */
export function oppositeObjective(victim, obs) {
  const action = victim.mean(obs);
  return (x, slope) => {
    const moved = victim.mean(x).map((a, i) => a - action[i]);
    const value = moved.reduce((sum, d, i) => sum + victim.precision[i] * d * d, 0);
    return slope ? { value, gradient: victim.backward(moved.map((d, i) => 2 * victim.precision[i] * d)) } : { value };
  };
}

/** -Q(o, pi(.)): how bad the action is that the policy takes; Q always sees the true observation. */
export function badnessObjective(victim, obs) {
  return (x, slope) => {
    const q = victim.meanQ(obs, victim.act(x));
    return slope ? { value: -q.value, gradient: victim.backward(q.gradient.map((g) => -g)) } : { value: -q.value };
  };
}

/**
 * Every attack: its title, and how it makes a perturbed observation of a true one. `of` has what it may know: the
 * victim, the learned adversaries by name, the offset that is held by hand, the radius epsilon, the number of steps,
 * and a generator of the episode.
 */
export const ATTACKS = {
  none: { title: "none", perturb: (obs) => obs },
  uniform: {
    title: "uniform noise",
    perturb: (obs, { epsilon, random }) => obs.map((o) => o + epsilon * (2 * random.uniform() - 1)),
  },
  corner: {
    title: "held corner",
    perturb: (obs, of) => {
      of.corner ??= Float64Array.from(obs, () => (of.random.normal() < 0 ? -1 : 1));
      return obs.map((o, i) => o + of.epsilon * of.corner[i]);
    },
  },
  hand: {
    title: "your own offset",
    perturb: (obs, { epsilon, offset }) => obs.map((o, i) => o + epsilon * (offset[i] ?? 0)),
  },
  fgsm: {
    title: "FGSM",
    perturb: (obs, { victim, epsilon, random }) => ascend(oppositeObjective(victim, obs), obs, epsilon, random, 1),
  },
  opposite: {
    title: "opposite (PGD)",
    steps: true,
    perturb: (obs, { victim, epsilon, random, steps }) => ascend(oppositeObjective(victim, obs), obs, epsilon, random, steps),
  },
  qfunction: {
    title: "Q-function (PGD)",
    steps: true,
    perturb: (obs, { victim, epsilon, random, steps }) => ascend(badnessObjective(victim, obs), obs, epsilon, random, steps),
  },
  linear: { title: "linear adversary", learned: true },
  optimal: { title: "optimal adversary", learned: true },
  offset: { title: "held offset, found", learned: true },
  "adaptive-optimal": { title: "optimal, adaptive", learned: true },
};
for (const [name, attack] of Object.entries(ATTACKS)) {
  if (!attack.learned) continue;
  attack.perturb = (obs, { adversaries, epsilon }) => {
    const direction = adversaries[name].act(obs);
    return obs.map((o, i) => o + epsilon * direction[i]);
  };
}

/** One attack in one episode. */
export class Attack {
  /**
   * @param {string} name a key of ATTACKS
   * @param {{victim: object, adversaries: object, epsilon: number, steps: number, offset: ArrayLike<number>}} of
   * @param {number} seed of the episode
   */
  constructor(name, of, seed) {
    this.name = name;
    this.of = { ...of, random: new Random(0, seed) };
  }

  /** The perturbed observation, in the ball. @param {Float32Array} obs @returns {Float32Array} */
  perturb(obs) {
    return project(obs, ATTACKS[this.name].perturb(obs, this.of), this.of.epsilon);
  }
}

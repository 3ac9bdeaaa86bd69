// The settings of the playground: their defaults, the named scenes, the challenges, and how a link states them.
import { ATTACKS } from "./attacks.js";
import { DEFENSES } from "./defense.js";
import { ROBOTS } from "./robot.js";
import { TIMINGS } from "./timing.js";

export const ALGORITHMS = { td3: "TD3", ppo: "PPO" };
export const SPEEDS = { 0.1: "0.1 ×", 0.25: "0.25 ×", 0.5: "0.5 ×", 1: "real time", 2: "2 ×", max: "as fast as it goes" };

/**
 * @typedef {object} Settings
 * @property {string} robot @property {string} algo @property {string} attack @property {string} timing
 * @property {string} defense each a key of its list
 * @property {number} steps gradient steps
 * @property {number} epsilon in radii of the paper's ball
 * @property {number} rate of the random timing
 * @property {boolean} compare whether a bare robot runs beside the defended one
 * @property {number} seed @property {string} speed
 * @property {string} watch the observation whose trace is drawn
 * @property {Record<string, number>} offset by observation, in radii; what is not named is 0
 * @property {string} challenge a key of CHALLENGES, or nothing
 */

/** @type {Settings} */
export const DEFAULTS = {
  robot: "hopper", algo: "td3", attack: "opposite", steps: 5, epsilon: 1, timing: "after", rate: 0.2, defense: "none",
  compare: false, seed: 1, speed: "1", watch: "pitch", offset: {}, challenge: "",
};

/** Settings that a link names by one word. */
export const SCENES = {
  clean: { attack: "none" },
  fall: { attack: "opposite" },
  compare: { attack: "opposite", defense: "mixed", compare: true },
  optimal: { attack: "optimal", defense: "mixed", compare: true },
  broken: { robot: "walker2d", algo: "ppo", attack: "corner", defense: "mixed", compare: true },
  hold: { attack: "hand", defense: "detector", offset: { pitch: 0.5 } },
  push: { attack: "none", defense: "detector" },
  seldom: { attack: "opposite", timing: "vulnerable", steps: 20 },
};

/**
 * Five challenges. A scene fixes the settings in `fixed`; `score` judges an episode that is over, from 0 to 100, and is
 * null where the goal was missed. `used` has the largest offset and the number of observations that were ever moved.
 */
export const CHALLENGES = {
  "one-number": {
    title: "One number",
    goal: "Fell the bare Hopper by moving one observation alone, as little as you can.",
    rule: "The score is 100 for an offset of 0, and 0 for one of the whole radius.",
    fixed: { robot: "hopper", algo: "td3", attack: "hand", epsilon: 1, timing: "always", defense: "none", watch: "pitch" },
    score: ({ fallen }, used) => (fallen && used.moved === 1 ? 100 * (1 - used.largest) : null),
  },
  "few-strikes": {
    title: "Few strikes",
    goal: "Fell the bare Hopper with the gradient attack, and strike as seldom as you can: hold A when it counts.",
    rule: "Each step that you attack costs two points.",
    fixed: { robot: "hopper", algo: "ppo", attack: "opposite", steps: 20, epsilon: 1, timing: "key", defense: "none" },
    score: ({ fallen, strikes }) => (fallen ? 100 - 2 * strikes : null),
  },
  unheard: {
    title: "Unheard",
    goal: "Find an offset that fells this Hopper within 100 steps, with as few alarms as you can.",
    rule: "Each alarm costs two points.",
    fixed: { robot: "hopper", algo: "ppo", attack: "hand", epsilon: 1, timing: "always", defense: "detector" },
    score: ({ fallen, steps, alarms }) => (fallen && steps <= 100 ? 100 - 2 * alarms : null),
  },
  through: {
    title: "Through the defence",
    goal: "Find an offset that fells the defended Walker2d, as soon as you can.",
    rule: "Each ten steps that it lives cost a point.",
    fixed: { robot: "walker2d", algo: "ppo", attack: "hand", epsilon: 1, timing: "always", defense: "mixed" },
    score: ({ fallen, steps }) => (fallen ? 100 - steps / 10 : null),
  },
  backwards: {
    title: "Backwards",
    goal: "HalfCheetah cannot fall. Find an offset that makes it run backwards.",
    rule: "The score is a tenth of how far its return of 1,000 steps is below 0.",
    fixed: { robot: "halfcheetah", algo: "ppo", attack: "hand", epsilon: 1, timing: "always", defense: "none", watch: "z" },
    score: ({ steps, return: sum }) => (steps === 1000 && sum < 0 ? -sum / 10 : null),
  },
};

/** What a challenge leaves no choice of. @param {string} challenge @returns {Partial<Settings>} */
export function fixedBy(challenge) {
  return challenge ? { compare: false, ...CHALLENGES[challenge].fixed } : {};
}

const LISTS = { robot: ROBOTS, algo: ALGORITHMS, attack: ATTACKS, timing: TIMINGS, defense: DEFENSES, speed: SPEEDS, challenge: CHALLENGES };
const RANGES = { steps: [1, 50], epsilon: [0, 2], rate: [0, 1], seed: [0, 1e6] };

/** @param {Record<string, number>} offset @returns {string} "pitch:0.5,z:-1" */
const writeOffset = (offset) =>
  Object.entries(offset)
    .filter(([, size]) => size)
    .map(([name, size]) => `${name}:${+size.toFixed(3)}`)
    .join(",");

const readOffset = (text) =>
  Object.fromEntries(
    text
      .split(",")
      .map((part) => [part.split(":")[0], Math.min(Math.max(Number(part.split(":")[1]), -1), 1)])
      .filter(([name, size]) => name && Number.isFinite(size)),
  );

/**
 * The settings that a link states; what it does not know, or gets wrong, is left at its default.
 * @param {string} query "?scene=fall&seed=3"
 * @returns {Settings}
 */
export function readQuery(query) {
  const asked = new URLSearchParams(query);
  const scene = SCENES[asked.get("scene")] ?? {};
  const settings = { ...DEFAULTS, ...scene, offset: { ...scene.offset } };
  for (const [key, text] of asked) {
    if (key in LISTS && Object.hasOwn(LISTS[key], text)) settings[key] = text;
    else if (key in RANGES && text !== "" && text >= RANGES[key][0] && text <= RANGES[key][1]) settings[key] = Number(text);
    else if (key === "compare") settings.compare = text === "1";
    else if (key === "watch") settings.watch = text;
    else if (key === "offset") settings.offset = readOffset(text);
  }
  for (const whole of ["steps", "seed"]) settings[whole] = Math.round(settings[whole]);
  return { ...settings, ...fixedBy(settings.challenge) };
}

/** The link's query for settings: what differs from the defaults. @param {Settings} settings */
export function writeQuery(settings) {
  const query = new URLSearchParams();
  const fixed = fixedBy(settings.challenge);
  for (const [key, value] of Object.entries(settings)) {
    const text = key === "offset" ? writeOffset(value) : key === "compare" ? (value ? "1" : "") : String(value);
    const usual = key === "offset" || key === "compare" ? "" : String(DEFAULTS[key]);
    if (text !== usual && !(key in fixed)) query.set(key, text);
  }
  return query.toString();
}

/** Keeps, step by step, what a challenge asks of the offset that was held. */
export class Used {
  moved = 0;
  largest = 0;
  #names = new Set();

  /** @param {Record<string, number>} offset */
  see(offset) {
    for (const [name, size] of Object.entries(offset)) {
      if (!size) continue;
      this.#names.add(name);
      this.moved = this.#names.size;
      this.largest = Math.max(this.largest, Math.abs(size));
    }
  }
}

/** The score of an episode that is over: a whole number from 0 to 100, or null if the goal was missed. */
export function judge(challenge, episode, used) {
  const score = CHALLENGES[challenge].score(episode, used);
  return score === null ? null : Math.round(Math.min(Math.max(score, 0), 100));
}

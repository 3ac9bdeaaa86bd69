// Brings what a robot needs, once: the physics engine, the robot's model, its policy, adversaries and defence.
import { ATTACKS } from "./attacks.js";
import { Defense } from "./defense.js";
import { GruVae } from "./gruvae.js";
import { Robot } from "./robot.js";
import { readSafetensors } from "./safetensors.js";
import { Victim } from "./victim.js";

/**
 * @typedef {object} Card what the build has gathered of a victim, see book/tools/playground.py
 * @property {string} task
 * @property {string} algo
 * @property {string} model the robot's XML
 * @property {string[]} names of the observations
 * @property {number} epsilon the radius of the paper's ball
 * @property {number} c_vul
 * @property {number} rate how often that timing strikes
 * @property {number} threshold C_anomaly
 * @property {Record<string, object>} networks the file's name without its ending, and its settings
 */

/** The files of the adversaries. */
const ADVERSARIES = {
  linear: "adversary-linear",
  optimal: "adversary",
  offset: "adversary-offset",
  "adaptive-optimal": "adversary-adaptive",
};

/**
 * @param {(name: string) => Promise<ArrayBuffer>} read brings one file
 * @returns {Promise<{card: Card, tensors: Record<string, Record<string, Float32Array>>}>}
 */
export async function readVictim(read) {
  const card = JSON.parse(new TextDecoder().decode(await read("robot.json")));
  const files = Object.keys(card.networks).map(async (name) => [name, readSafetensors(await read(`${name}.safetensors`))]);
  return { card, tensors: Object.fromEntries(await Promise.all(files)) };
}

/** What acts in one episode: networks with a memory of their own. @returns the argument of Episode */
export function makeCast({ card, tensors }) {
  const { networks } = card;
  const critic = networks.critic && { activation: networks.critic.activation, tensors: tensors.critic };
  const adversaries = Object.fromEntries(
    Object.entries(ADVERSARIES)
      .filter(([, file]) => file in networks)
      .map(([name, file]) => [name, new Victim(networks[file], tensors[file])]),
  );
  const [detector, denoiser] = ["detector-diverse", "denoiser-mixed"].map(
    (name, i) => new GruVae(networks[name], tensors[name], 2 + i),
  );
  return {
    victim: new Victim(networks.victim, tensors.victim, critic),
    adversaries,
    defense: new Defense(detector, card.threshold, { mixed: denoiser }),
    cVul: card.c_vul,
  };
}

/** The attacks that can be made on a victim: those that need no adversary, and those whose adversary there is. */
export function possibleAttacks({ card }) {
  return Object.keys(ATTACKS).filter((name) => !ATTACKS[name].learned || ADVERSARIES[name] in card.networks);
}

/** Everything comes from one folder, and nothing is asked for twice. */
export class Assets {
  /** @param {string} base the address of the folder, with a slash at its end */
  constructor(base) {
    this.base = base;
    this.kept = new Map();
  }

  #once(key, make) {
    if (!this.kept.has(key)) {
      const promise = make();
      promise.catch(() => this.kept.delete(key)); // so that it can be tried again
      this.kept.set(key, promise);
    }
    return this.kept.get(key);
  }

  async #fetch(path) {
    const answer = await fetch(this.base + path);
    if (!answer.ok) throw new Error(`the file ${path} could not be loaded (${answer.status})`);
    return answer;
  }

  /** The physics engine. It lies there compressed, since not every server compresses. */
  mujoco() {
    return this.#once("mujoco", async () => {
      const [{ default: start }, packed] = await Promise.all([import("@mujoco/mujoco"), this.#fetch("mujoco.bin")]);
      const unpacked = new Response(packed.body.pipeThrough(new DecompressionStream("gzip")));
      const quiet = () => {}; // MuJoCo warns of an old element in HalfCheetah's model
      return start({ wasmBinary: await unpacked.arrayBuffer(), print: quiet, printErr: quiet });
    });
  }

  /** @param {string} task @param {string} algo */
  victim(task, algo) {
    const read = async (name) => (await this.#fetch(`${task}-${algo}/${name}`)).arrayBuffer();
    return this.#once(`${task}-${algo}`, () => readVictim(read));
  }

  /** @param {string} task @param {string} xml */
  robot(task, xml) {
    return this.#once(task, async () => new Robot(await this.mujoco(), task, xml));
  }
}

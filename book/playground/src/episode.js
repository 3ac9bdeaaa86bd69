// One episode, attacked and defended: the loop of figure 2 of the paper (detden_lite/simulation/rollout.py).
import { Attack } from "./attacks.js";
import { Timing } from "./timing.js";

export const HORIZON = 1000; // steps

/**
 * What may change while an episode runs.
 * @typedef {object} Conditions
 * @property {string} attack a key of ATTACKS
 * @property {number} epsilon the radius of the ball, in the environment's units
 * @property {number} steps gradient steps of an attack
 * @property {ArrayLike<number>} offset the one that is held by hand, in radii
 * @property {string} timing a key of TIMINGS
 * @property {number} rate of the random timing
 * @property {boolean} pressed whether the attacker presses the key
 * @property {string} defense a key of DEFENSES
 */

export class Episode {
  /**
   * @param {import("./robot.js").World} world
   * @param {{victim: object, adversaries: object, defense: object, cVul: number}} cast see assets.js
   * @param {number} seed
   */
  constructor(world, cast, seed) {
    Object.assign(this, { world, cast, seed });
    this.obs = world.reset(seed);
    cast.defense.reset(seed);
    this.timing = new Timing(seed);
    this.made = ""; // of which attack and settings this.attack is made
    this.steps = this.return = this.strikes = this.alarms = 0;
    this.fallen = false;
    this.last = null; // what happened at the last step
  }

  get over() {
    return this.fallen || this.steps >= HORIZON;
  }

  /** @param {Conditions} conditions */
  step(conditions) {
    const { victim, adversaries, defense, cVul } = this.cast;
    const true_ = this.obs;
    const made = `${conditions.attack} ${conditions.steps}`;
    if (made !== this.made) {
      this.attack = new Attack(conditions.attack, { victim, adversaries, ...conditions }, this.seed);
      this.made = made;
    }
    Object.assign(this.attack.of, { epsilon: conditions.epsilon, offset: conditions.offset });
    const value = victim.value(true_);
    const strikes = this.timing.strikes(conditions.timing, { ...conditions, step: this.steps, value, cVul });
    const found = this.attack.perturb(true_); // even if it is not used: its random numbers belong to the step
    const attacked = strikes && conditions.attack !== "none";
    const perturbed = attacked ? found : true_;
    const verdict = defense.judge(perturbed, this.last?.action ?? null, conditions.defense, { truth: true_, attacked });
    const action = victim.act(verdict.obs);
    const { obs, reward, fallen } = this.world.step(action);
    const { denoised, score, alarm } = verdict;
    this.last = { true: true_, perturbed, denoised, shown: verdict.obs, action, reward, value, attacked, score, alarm };
    this.obs = obs;
    this.steps += 1;
    this.return += reward;
    this.strikes += Number(attacked);
    this.alarms += Number(alarm);
    this.fallen = fallen;
    return this.last;
  }
}

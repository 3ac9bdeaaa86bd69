// One robot of the playground: its world and networks, its episode and what happened in it, and its picture.
import { makeCast } from "./assets.js";
import { h } from "./dom.js";
import { Episode, HORIZON } from "./episode.js";
import { Used } from "./scenes.js";
import { Stage } from "./stage.js";
import { World } from "./robot.js";

const NUMBERS = { steps: "steps", return: "return", strikes: "attacked", alarms: "alarms" };

export class Lane {
  /** @param {object} brought see readVictim @param {import("./robot.js").Robot} robot */
  constructor(brought, robot) {
    this.world = new World(robot);
    this.cast = makeCast(brought);
    this.canvas = h("canvas", { class: "pg-stage", tabindex: 0, role: "img" });
    this.stage = new Stage(this.canvas, robot.task);
    this.title = h("strong", {});
    this.numbers = Object.fromEntries(Object.keys(NUMBERS).map((key) => [key, h("dd", { "data-number": key }, "0")]));
    const list = Object.entries(NUMBERS).map(([key, name]) => h("div", {}, h("dt", {}, name), this.numbers[key]));
    this.element = h("div", { class: "pg-lane" }, this.canvas, h("div", { class: "pg-caption" }, this.title, h("dl", {}, ...list)));
  }

  /** Begin an episode. @param {number} seed */
  restart(seed) {
    this.world.push(0, 0, 0);
    this.episode = new Episode(this.world, this.cast, seed);
    this.rows = [];
    this.used = new Used();
    this.pushed = null; // {body, force, steps}
  }

  /** One step. @param {import("./episode.js").Conditions} conditions @param {Record<string, number>} held */
  step(conditions, held) {
    if (this.pushed && this.pushed.steps-- <= 0) this.push(null);
    if (this.pushed) this.world.push(this.pushed.body, ...this.pushed.force);
    if (conditions.attack === "hand") this.used.see(held);
    const x = this.world.view("qpos")[0];
    this.rows.push({ x, ...this.episode.step(conditions) });
  }

  /** Push a body from the next step on, for a number of steps; null ends it. */
  push(pushed) {
    this.pushed = pushed;
    if (!pushed) this.world.push(0, 0, 0);
  }

  /** What the picture shows: the last step, or the start. */
  get now() {
    return this.rows.at(-1) ?? { x: this.world.view("qpos")[0], true: this.episode.obs };
  }

  /** How the episode stands, in words. */
  get report() {
    const { steps, fallen, over, return: sum } = this.episode;
    const how = fallen ? `Fell at step ${steps}` : over ? `Did not fall in ${HORIZON} steps` : `Step ${steps}`;
    return `${how}; return ${sum.toFixed(0)}.`;
  }

  /**
   * @param {World} mirror a world of the same robot, which is only posed
   * @param {?Float32Array} shown the first ghost
   * @param {?{from: number[], to: number[]}} arrow
   */
  draw(mirror, shown, arrow, colours) {
    const { x, true: true_, denoised } = this.now;
    const pose = (obs) => {
      if (!obs) return null;
      mirror.imagine(x, obs);
      return mirror.pose();
    };
    const scene = { x, body: pose(true_), shown: pose(shown), denoised: pose(denoised), over: this.episode.over, push: arrow };
    this.stage.draw(scene, colours);
    for (const [key, cell] of Object.entries(this.numbers)) {
      const text = this.episode[key].toFixed(0);
      if (cell.textContent !== text) cell.textContent = text;
    }
    return scene;
  }
}

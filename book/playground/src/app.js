// The playground: loads a robot, lets episodes run, and keeps form, pictures and traces in step with them.
import { Assets, possibleAttacks } from "./assets.js";
import { ATTACKS } from "./attacks.js";
import { Controls } from "./controls.js";
import { h } from "./dom.js";
import { Hands } from "./hands.js";
import { Lane } from "./lane.js";
import { layOut } from "./layout.js";
import { ROBOTS, World } from "./robot.js";
import { ALGORITHMS, CHALLENGES, judge, readQuery, writeQuery } from "./scenes.js";
import { drawTraces, panels } from "./traces.js";

const COLOURS = ["true", "shown", "denoised", "alarm", "body", "floor", "muted", "text"];
const LONGEST_FRAME = 0.25; // seconds; a page that was away does not catch up
const BUSY = { share: 0.7, least: 0.012, most: 0.12 }; // how much of a frame's time steps may take; seconds
let active = null; // the one playground that runs

/** Opens a playground inside an element, in the state of a query; see scenes.js. */
export async function mount(root, { base, query = "", run = false, folded = false }) {
  const playground = (root.playground = new Playground(root, base, query, folded)); // for the console
  await playground.load();
  if (run && !matchMedia("(prefers-reduced-motion: reduce)").matches) playground.run(true);
  return playground;
}

class Playground {
  constructor(root, base, query, folded) {
    Object.assign(this, { root, base, settings: readQuery(query), lanes: [], running: false, pressed: false });
    this.assets = new Assets(base);
    this.controls = new Controls((key, value) => this.change(key, value));
    this.hands = new Hands(this);
    Object.assign(this, layOut(this, folded));
    root.replaceChildren(this.element);
    this.hands.hold(this.strikeButton);
    this.hands.listen(this.element);
    new ResizeObserver(() => this.draw()).observe(this.element);
    this.#watchTheme();
  }

  #watchTheme() {
    const read = () => {
      const style = getComputedStyle(this.element);
      this.colours = Object.fromEntries(COLOURS.map((name) => [name, style.getPropertyValue(`--pg-${name}`).trim()]));
      this.draw();
    };
    new MutationObserver(read).observe(document.documentElement, { attributeFilter: ["data-theme"] });
    read();
  }

  /** Bring the robot of the settings, and begin an episode. */
  async load() {
    const { robot: task, algo } = this.settings;
    this.run(false);
    this.say("Loading the robot and MuJoCo …");
    this.element.setAttribute("aria-busy", "true");
    try {
      this.assets.mujoco().catch(() => {}); // beside the victim; a failure is met when the robot needs it
      const brought = await this.assets.victim(task, algo);
      const robot = await this.assets.robot(task, brought.card.model);
      if (task !== this.settings.robot || algo !== this.settings.algo) return; // another one was chosen meanwhile
      Object.assign(this, { brought, robot, card: brought.card });
      const possible = possibleAttacks(brought);
      if (!possible.includes(this.settings.attack)) this.settings.attack = "opposite";
      if (!this.card.names.includes(this.settings.watch)) this.settings.watch = "pitch";
      this.controls.offer(this.card.names, possible);
      this.#free();
      this.mirror = new World(robot);
      this.restart();
      this.element.setAttribute("aria-busy", "false");
    } catch (error) {
      this.say(`The playground could not start: ${error.message}. `);
      this.status.append(h("button", { type: "button", onclick: () => this.load() }, "Try again"));
      console.warn(error);
    }
  }

  #free() {
    for (const world of [this.mirror, ...this.lanes.map((lane) => lane.world)]) world?.data.delete();
    this.lanes = [];
  }

  /** Begin the episode anew, with as many robots as the settings have. */
  restart() {
    const wanted = this.settings.compare ? 2 : 1;
    while (this.lanes.length > wanted) this.lanes.pop().world.data.delete();
    while (this.lanes.length < wanted) this.lanes.push(new Lane(this.brought, this.robot));
    this.robots.replaceChildren(...this.lanes.map((lane) => lane.element));
    for (const lane of this.lanes) lane.restart(this.settings.seed);
    this.told = false;
    this.say("Ready.");
    this.show();
  }

  /** Which defence a lane has: of two, the first is bare. */
  defense(lane) {
    return this.settings.compare && lane === this.lanes[0] ? "none" : this.settings.defense;
  }

  /** Change a setting, as the form does. */
  change(key, value) {
    this.settings[key] = value;
    if (key === "compare" && value && this.settings.defense === "none") this.settings.defense = "mixed";
    if (key === "robot" || key === "algo") this.load();
    else if (key === "seed" || key === "compare" || key === "challenge") this.restart();
    else this.show();
  }

  /** Let the form, the words and the pictures say what the settings say. */
  show() {
    const { settings, card } = this;
    this.controls.show(settings, card.epsilon);
    this.strikeButton.hidden = settings.timing !== "key";
    this.address.href = `${new URL("../playground.html", this.base).href}?${writeQuery(settings)}`;
    const who = `${ROBOTS[settings.robot].title}, ${ALGORITHMS[settings.algo]}`;
    for (const lane of this.lanes) {
      const kind = this.defense(lane);
      lane.title.textContent = { none: `${who}, bare`, detector: `${who}, detector`, oracle: `${who}, oracle` }[kind] ?? `${who}, defended`;
      const attack = settings.attack === "none" ? "not attacked" : `attacked: ${ATTACKS[settings.attack].title}`;
      lane.canvas.setAttribute("aria-label", `${lane.title.textContent}, ${attack}, seen from the side`);
    }
    this.traces.setAttribute("aria-label", `Traces of ${settings.watch.replaceAll("_", " ")}, of the detector's score and of the value`);
    this.#showChallenge();
    this.draw();
  }

  #showChallenge() {
    const { challenge } = this.settings;
    this.challenge.hidden = !challenge;
    if (!challenge) return;
    const { title, goal, rule } = CHALLENGES[challenge];
    const leave = h("button", { type: "button", onclick: () => this.change("challenge", "") }, "Leave the challenge");
    this.result = h("p", { class: "pg-score" });
    this.challenge.replaceChildren(h("strong", {}, `Challenge: ${title}`), h("p", {}, `${goal} ${rule}`), this.result, leave);
    if (this.told) this.#score();
  }

  #score() {
    const [lane] = this.lanes;
    const score = judge(this.settings.challenge, lane.episode, lane.used);
    const about = `“${CHALLENGES[this.settings.challenge].title}”, seed ${this.settings.seed}`;
    this.result.textContent = score === null ? "Missed: read the goal again, and restart." : `${score} of 100 points in ${about}.`;
  }

  get conditions() {
    const { attack, steps, epsilon, timing, rate, offset } = this.settings;
    const held = this.card.names.map((name) => offset[name] ?? 0);
    return { attack, steps, epsilon: epsilon * this.card.epsilon, timing, rate, offset: held, pressed: this.pressed };
  }

  get over() {
    return this.lanes.every((lane) => lane.episode.over);
  }

  /** One step of every robot whose episode goes on. */
  advance() {
    const conditions = this.conditions;
    for (const lane of this.lanes) {
      if (lane.episode.over) continue;
      this.hands.drag(lane);
      lane.step({ ...conditions, defense: this.defense(lane) }, this.settings.offset);
    }
    if (this.over && !this.told) {
      this.told = true;
      this.run(false);
      this.say(this.lanes.map((lane) => (this.lanes.length > 1 ? `${lane.title.textContent}: ${lane.report}` : lane.report)).join(" "));
      if (this.settings.challenge) this.#score();
    }
  }

  single() {
    if (!this.lanes.length) return;
    this.run(false);
    if (!this.over) this.advance();
    if (!this.over) this.say(`Paused. ${this.lanes.at(-1).report}`);
    this.draw();
  }

  /** Let the episode run, or pause it. */
  run(on) {
    if (on && (!this.lanes.length || this.running)) return;
    if (on && this.over) this.restart();
    if (on && active !== this) active?.run(false);
    if (!on && this.running) this.say(`Paused. ${this.lanes.at(-1).report}`);
    this.running = on;
    this.runButton.textContent = on ? "Pause" : "Run";
    if (!on) return;
    active = this;
    this.say("Running.");
    this.due = 0;
    this.before = null;
    requestAnimationFrame((now) => this.#frame(now));
  }

  #frame(now) {
    if (!this.running || !this.element.isConnected) return;
    const { speed } = this.settings;
    const passed = Math.min((now - (this.before ?? now)) / 1000, LONGEST_FRAME);
    this.before = now;
    this.due = speed === "max" ? Infinity : this.due + (passed * Number(speed)) / this.robot.dt;
    const end = performance.now() + 1000 * Math.min(Math.max(BUSY.share * passed, BUSY.least), BUSY.most);
    while (this.due >= 1 && this.running && performance.now() < end) {
      this.advance();
      this.due -= 1;
    }
    this.due = Math.min(this.due, 30); // a machine that is too slow runs slowly, and owes nothing
    this.draw();
    if (this.running) requestAnimationFrame((next) => this.#frame(next));
  }

  /** What the first ghost of a lane shows: the last step's, or the offset that is held right now. */
  shown(lane) {
    const { now } = lane;
    const { attack, offset, epsilon } = this.conditions;
    if (attack === "hand") return now.true.map((o, i) => o + epsilon * offset[i]);
    return now.attacked ? now.perturbed : null;
  }

  draw() {
    if (!this.lanes.length || !this.colours) return;
    for (const lane of this.lanes) {
      lane.scene = lane.draw(this.mirror, this.shown(lane), this.hands.arrow(lane), this.colours);
    }
    const lane = this.lanes.at(-1);
    const { names, epsilon, threshold, c_vul: cVul } = this.card;
    const kind = this.defense(lane);
    const level = kind === "none" ? null : kind === "oracle" ? 0.5 : threshold;
    const about = { index: names.indexOf(this.settings.watch), name: this.settings.watch, epsilon, cVul, threshold: level };
    drawTraces(this.traces, lane.rows, panels(about, this.colours), this.colours);
  }

  say(text) {
    this.status.textContent = text;
  }
}

// The form with the settings.
import { ATTACKS } from "./attacks.js";
import { DEFENSES } from "./defense.js";
import { h, newId } from "./dom.js";
import { ROBOTS } from "./robot.js";
import { ALGORITHMS, SPEEDS, fixedBy } from "./scenes.js";
import { TIMINGS } from "./timing.js";

const titles = (list) => Object.entries(list).map(([name, entry]) => [name, entry.title ?? entry]);

export class Controls {
  /** @param {(key: string, value: unknown) => void} change is called when the reader changes a setting */
  constructor(change) {
    this.change = change;
    this.inputs = {}; // by setting: {input, row, show}
    this.offsets = {}; // by observation
    const group = (legend, ...rows) => h("fieldset", {}, h("legend", {}, legend), ...rows);
    this.sliders = h("div", { class: "pg-sliders" });
    const zero = h("button", { type: "button", onclick: () => this.change("offset", {}) }, "All to zero");
    this.offsetGroup = group("The offset that you hold, in radii of the ball", this.sliders, zero);
    this.offsetGroup.classList.add("pg-offsets");
    this.element = h(
      "form",
      { class: "pg-controls", onsubmit: (event) => event.preventDefault() },
      this.offsetGroup,
      group("Robot", this.#select("robot", "robot", titles(ROBOTS)), this.#select("algo", "policy", titles(ALGORITHMS)), this.#number("seed", "seed", 0, 1e6)),
      group(
        "Attack",
        this.#select("attack", "attack", titles(ATTACKS)),
        this.#range("epsilon", "radius ε", 0, 2, 0.05),
        this.#number("steps", "gradient steps", 1, 50),
        this.#select("timing", "when", titles(TIMINGS)),
        this.#range("rate", "share of the steps", 0, 1, 0.05),
      ),
      group("Defence", this.#select("defense", "defence", titles(DEFENSES)), this.#check("compare", "beside a bare robot")),
      group("View", this.#select("watch", "trace of", []), this.#select("speed", "speed", titles(SPEEDS))),
    );
  }

  #row(key, label, input, show) {
    const [id, output] = [newId(), h("output", {})];
    input.id = id;
    input.name = key;
    output.setAttribute("for", id);
    const row = h("div", { class: "pg-row" }, h("label", { for: id }, label), input, output);
    this.inputs[key] = { input, row, output, show };
    return row;
  }

  #select(key, label, options) {
    const input = h("select", { onchange: () => this.change(key, input.value) });
    input.append(...options.map(([value, title]) => h("option", { value }, title)));
    return this.#row(key, label, input, (value) => (input.value = value));
  }

  #number(key, label, min, max) {
    const take = () => {
      if (input.value !== "" && input.checkValidity()) this.change(key, Number(input.value));
    };
    const input = h("input", { type: "number", min, max, step: 1, required: true, onchange: take });
    return this.#row(key, label, input, (value) => (input.value = value));
  }

  #range(key, label, min, max, step) {
    const input = h("input", { type: "range", min, max, step, oninput: () => this.change(key, Number(input.value)) });
    return this.#row(key, label, input, (value) => (input.value = value));
  }

  #check(key, label) {
    const input = h("input", { type: "checkbox", onchange: () => this.change(key, input.checked) });
    return this.#row(key, label, input, (value) => (input.checked = value));
  }

  /** Offer what this victim has. @param {string[]} names of the observations @param {string[]} attacks */
  offer(names, attacks) {
    const watch = this.inputs.watch.input;
    watch.replaceChildren(...names.map((name) => h("option", { value: name }, name.replaceAll("_", " "))));
    for (const option of this.inputs.attack.input.options) option.hidden = option.disabled = !attacks.includes(option.value);
    this.offsets = {};
    const rows = names.map((name) => {
      const [id, output] = [newId(), h("output", {})];
      const input = h("input", { type: "range", id, min: -1, max: 1, step: 0.05 });
      input.addEventListener("input", () => this.change("offset", { ...this.held, [name]: Number(input.value) }));
      this.offsets[name] = { input, output };
      return h("div", { class: "pg-row" }, h("label", { for: id }, name.replaceAll("_", " ")), input, output);
    });
    this.sliders.replaceChildren(...rows);
  }

  /** Show the settings. @param {import("./scenes.js").Settings} settings @param {number} radius of the paper's ball */
  show(settings, radius) {
    const fixed = fixedBy(settings.challenge);
    for (const [key, { input, show }] of Object.entries(this.inputs)) {
      show(settings[key]);
      input.disabled = key in fixed && key !== "watch";
    }
    const { epsilon, rate, steps } = this.inputs;
    epsilon.output.value = `${settings.epsilon.toFixed(2)} × ${radius}`;
    rate.output.value = `${Math.round(100 * settings.rate)} %`;
    steps.row.hidden = !ATTACKS[settings.attack].steps;
    rate.row.hidden = settings.timing !== "random";
    this.inputs.timing.row.hidden = epsilon.row.hidden = settings.attack === "none";
    this.offsetGroup.hidden = settings.attack !== "hand";
    this.held = settings.offset;
    for (const [name, { input, output }] of Object.entries(this.offsets)) {
      const size = settings.offset[name] ?? 0;
      input.value = size;
      output.value = size.toFixed(2);
    }
  }
}

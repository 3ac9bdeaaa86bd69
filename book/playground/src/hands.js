// What the reader does to the robots by hand: push them, bend the ghost, strike, and press keys.

const PUSH = 25; // newtons a kilogram, at most: two and a half times the weight
const SHOVE = 0.1; // seconds that a button's push lasts

const middle = ({ from, to }) => [(from[0] + to[0]) / 2, (from[1] + to[1]) / 2];

export class Hands {
  constructor(playground) {
    this.playground = playground;
    this.held = null; // by the pointer: {lane, event, body, ...}
  }

  /** Push every robot's trunk for a moment: backwards (-1) or forwards (1). */
  shove(way) {
    const { robot, lanes } = this.playground;
    const steps = Math.ceil(SHOVE / (robot?.dt ?? 1));
    for (const lane of lanes) lane.push({ body: 1, force: [way * PUSH * robot.mass, 0], steps });
  }

  /** Let a button strike as long as it is pressed, by pointer or keyboard. */
  hold(button) {
    const press = (on) => () => (this.playground.pressed = on);
    button.addEventListener("pointerdown", press(true));
    for (const end of ["pointerup", "pointerleave", "pointercancel"]) button.addEventListener(end, press(false));
    button.addEventListener("keydown", (event) => [" ", "Enter"].includes(event.key) && press(true)());
    button.addEventListener("keyup", press(false));
  }

  release() {
    this.playground.pressed = false;
  }

  /** @param {HTMLElement} element */
  listen(element) {
    element.addEventListener("keydown", (event) => this.#key(event));
    element.addEventListener("keyup", (event) => event.key.toLowerCase() === "a" && this.release());
    element.addEventListener("focusout", () => this.release());
    element.addEventListener("pointerdown", (event) => this.#grab(event));
    element.addEventListener("pointermove", (event) => this.#move(event));
    for (const end of ["pointerup", "pointercancel"]) element.addEventListener(end, () => this.#drop());
  }

  #key(event) {
    const { playground } = this;
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("input:not([type=range], [type=checkbox]), select")) return;
    const onStage = event.target.matches(".pg-stage");
    const acts = {
      p: () => playground.run(!playground.running),
      s: () => playground.single(),
      r: () => playground.restart(),
      a: () => (playground.pressed = true),
      ...(onStage && {
        " ": () => playground.run(!playground.running),
        ArrowLeft: () => this.shove(-1),
        ArrowRight: () => this.shove(1),
      }),
    };
    const act = acts[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!act || !playground.lanes.length) return;
    event.preventDefault();
    if (!event.repeat || event.key.startsWith("Arrow")) act();
  }

  #grab(event) {
    const { playground } = this;
    const lane = playground.lanes.find(({ canvas }) => canvas === event.target);
    if (!lane) return;
    const bending = playground.settings.attack === "hand";
    const at = lane.stage.point(event);
    const capsules = (bending && lane.scene.shown) || lane.scene.body;
    const away = (capsule) => Math.hypot(middle(capsule)[0] - at[0], middle(capsule)[1] - at[1]);
    const { body } = capsules.reduce((nearest, capsule) => (away(capsule) < away(nearest) ? capsule : nearest));
    event.target.setPointerCapture(event.pointerId);
    this.held = { lane, event, body, bending, at, x: lane.now.x, offset: { ...playground.settings.offset } };
  }

  #move(event) {
    if (!this.held) return;
    this.held.event = event;
    if (this.held.bending) this.#bend();
    else this.playground.running || this.playground.draw();
  }

  #drop() {
    if (!this.held) return;
    if (!this.held.bending) this.held.lane.push(null);
    this.held = null;
    this.playground.draw();
  }

  /** Turn the joint of the body that is held, or lift and tilt the trunk, as far as the ball allows. */
  #bend() {
    const { playground, held } = this;
    const { lane, body, at, offset, x } = held;
    const { names } = playground.card;
    const radius = playground.conditions.epsilon || 1;
    const [toX, toZ] = lane.stage.point(held.event);
    const to = [toX - (lane.now.x - x), toZ]; // the camera follows the robot
    const turned = { ...offset };
    const bend = (name, size) => (turned[name] = Math.min(Math.max((offset[name] ?? 0) + size / radius, -1), 1));
    if (body === 1) {
      bend("z", to[1] - at[1]);
      bend("pitch", to[0] - at[0]);
    } else {
      const joint = playground.robot.joints.lastIndexOf(body);
      const [ax, az] = playground.mirror.anchors()[joint];
      const angle = (p, shift) => Math.atan2(p[1] - az, p[0] - ax + shift);
      const turn = angle(at, lane.now.x - x) - angle(to, lane.now.x - x);
      const way = playground.robot.axes[joint];
      bend(names[joint - 1], way * Math.atan2(Math.sin(turn), Math.cos(turn)));
    }
    playground.change("offset", turned);
  }

  #force({ lane, body, event }) {
    const { mass } = this.playground.robot;
    const from = middle(lane.scene.body.find((capsule) => capsule.body === body));
    const to = lane.stage.point(event);
    const [dx, dz] = [to[0] - from[0], to[1] - from[1]];
    const far = Math.hypot(dx, dz);
    const size = far < 0.05 ? 0 : Math.min(far, 1) * PUSH * mass; // full strength at a metre
    return { from, to, force: [(size * dx) / (far || 1), (size * dz) / (far || 1)] };
  }

  /** Before a step: a robot that is dragged is pushed. */
  drag(lane) {
    if (this.held?.lane === lane && !this.held.bending) {
      lane.push({ body: this.held.body, force: this.#force(this.held).force, steps: 1 });
    }
  }

  /** The arrow of a push, if there is one. */
  arrow(lane) {
    if (this.held?.lane === lane && !this.held.bending && lane.scene) {
      const { from, to, force } = this.#force(this.held);
      return force[0] || force[1] ? { from, to } : null;
    }
    if (!lane.pushed || !lane.scene) return null;
    const from = middle(lane.scene.body.find(({ body }) => body === lane.pushed.body));
    return { from, to: [from[0] + 0.4 * Math.sign(lane.pushed.force[0]), from[1]] };
  }
}

// Draws a robot with its ghosts: the pose that the policy is shown, and the one that the denoiser believes.

const VIEW = { hopper: 2, walker2d: 1.9, halfcheetah: 1.45 }; // metres from top to bottom
const GROUND = 0.14; // of the height lies below the floor

/** A capsule's outline in pixels. */
function outline([x1, y1], [x2, y2], r) {
  const path = new Path2D();
  const angle = Math.atan2(y2 - y1, x2 - x1);
  path.arc(x1, y1, r, angle + Math.PI / 2, angle - Math.PI / 2);
  path.arc(x2, y2, r, angle - Math.PI / 2, angle + Math.PI / 2);
  path.closePath();
  return path;
}

/** Fits a canvas to its place in the page, in the screen's own pixels. @returns {CanvasRenderingContext2D} */
export function fit(canvas) {
  const ratio = Math.min(window.devicePixelRatio || 1, 2);
  const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((size) => Math.max(1, Math.round(size * ratio)));
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  return context;
}

export class Stage {
  /** @param {HTMLCanvasElement} canvas @param {string} task */
  constructor(canvas, task) {
    Object.assign(this, { canvas, view: VIEW[task], x: null });
  }

  get scale() {
    return this.canvas.clientHeight / this.view;
  }

  /** From metres to pixels. */
  place([x, z]) {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    return [width / 2 + (x - this.x) * this.scale, height * (1 - GROUND) - z * this.scale];
  }

  /** From a place on the screen to metres. */
  point({ clientX, clientY }) {
    const { left, top, width, height } = this.canvas.getBoundingClientRect();
    return [(clientX - left - width / 2) / this.scale + this.x, (height * (1 - GROUND) - (clientY - top)) / this.scale];
  }

  /**
   * @param {object} scene
   * @param {number} scene.x where the robot is, which stays in the middle
   * @param {object[]} scene.body the robot's capsules, see World.pose
   * @param {?object[]} scene.shown the first ghost, and scene.denoised the second
   * @param {boolean} scene.over whether the episode is over
   * @param {?{from: number[], to: number[]}} scene.push an arrow
   * @param {Record<string, string>} colours
   */
  draw({ x, body, shown, denoised, over, push }, colours) {
    this.x = x;
    const context = fit(this.canvas);
    this.#floor(context, colours);
    context.globalAlpha = over ? 0.55 : 1;
    this.#fill(context, body, colours.body, colours.true);
    context.globalAlpha = 1;
    if (denoised) this.#ghost(context, denoised, colours.denoised, [2, 3]);
    if (shown) this.#ghost(context, shown, colours.shown, [7, 4]);
    if (push) this.#arrow(context, push, colours.alarm);
  }

  #floor(context, colours) {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const y = height * (1 - GROUND);
    context.fillStyle = colours.floor;
    context.fillRect(0, y, width, height - y);
    context.strokeStyle = context.fillStyle = colours.muted;
    context.lineWidth = 1;
    context.beginPath();
    context.moveTo(0, y + 0.5);
    context.lineTo(width, y + 0.5);
    context.font = "12px sans-serif";
    context.textAlign = "center";
    const half = width / 2 / this.scale;
    for (let metre = Math.ceil(this.x - half); metre <= this.x + half; metre++) {
      const [at] = this.place([metre, 0]);
      context.moveTo(at, y);
      context.lineTo(at, y + 6);
      context.fillText(`${metre} m`, at, y + 20);
    }
    context.stroke();
  }

  #paths(capsules) {
    return capsules.map(({ from, to, radius }) => outline(this.place(from), this.place(to), radius * this.scale));
  }

  #fill(context, capsules, fill, line) {
    context.fillStyle = fill;
    context.strokeStyle = line;
    context.lineWidth = 4;
    const paths = this.#paths(capsules);
    for (const path of paths) context.stroke(path); // the inner half is painted over: what is left is one outline
    for (const path of paths) context.fill(path);
  }

  #ghost(context, capsules, colour, dash) {
    context.strokeStyle = context.fillStyle = colour;
    context.lineWidth = 2.2;
    context.setLineDash(dash);
    for (const path of this.#paths(capsules)) {
      context.globalAlpha = 0.1;
      context.fill(path);
      context.globalAlpha = 1;
      context.stroke(path);
    }
    context.setLineDash([]);
  }

  #arrow(context, { from, to }, colour) {
    const [[x1, y1], [x2, y2]] = [this.place(from), this.place(to)];
    const angle = Math.atan2(y2 - y1, x2 - x1);
    context.strokeStyle = context.fillStyle = colour;
    context.lineWidth = 4;
    context.beginPath();
    context.moveTo(x1, y1);
    context.lineTo(x2, y2);
    context.stroke();
    context.beginPath();
    context.moveTo(x2 + 10 * Math.cos(angle), y2 + 10 * Math.sin(angle));
    for (const turn of [2.5, -2.5]) context.lineTo(x2 + 8 * Math.cos(angle + turn), y2 + 8 * Math.sin(angle + turn));
    context.fill();
  }
}

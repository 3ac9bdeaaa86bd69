// Draws the traces of an episode: one observation, the detector's score, and the policy's value.
import { fit } from "./stage.js";

const WINDOW = 250; // steps that are seen at once
const LEFT = 46; // pixels for the numbers
const GAP = 24; // pixels above each panel, for its title

const number = (x) => (Math.abs(x) >= 100 ? x.toFixed(0) : Math.abs(x) >= 1 ? x.toFixed(2) : x.toFixed(3));

/**
 * @typedef {object} Panel
 * @property {string} title
 * @property {number} share of the height
 * @property {{of: (row: object) => ?number, colour: string, dash: number[]}[]} lines
 * @property {?number} level a threshold, drawn as a dashed line
 * @property {boolean} log whether the axis is logarithmic
 * @property {number} least the smallest range of the axis
 * @property {?(row: object) => boolean} marks steps with a tick at the panel's foot
 */

/**
 * The panels for the present settings.
 * @param {{index: number, name: string, epsilon: number, cVul: number, threshold: ?number}} about
 * @param {Record<string, string>} colours
 * @returns {Panel[]}
 */
export function panels({ index, name, epsilon, cVul, threshold }, colours) {
  const of = (key) => (row) => row[key]?.[index] ?? null;
  const traces = [
    { of: of("true"), colour: colours.true, dash: [] },
    { of: (row) => (row.attacked ? row.perturbed[index] : null), colour: colours.shown, dash: [7, 4] },
    { of: of("denoised"), colour: colours.denoised, dash: [2, 3] },
  ];
  const score = { of: (row) => row.score, colour: colours.text, dash: [] };
  const value = { of: (row) => row.value, colour: colours.text, dash: [] };
  const ringing = threshold === null ? "detector: off" : "detector's score (log), its threshold, and alarms";
  return [
    { title: `${name.replaceAll("_", " ")}: true, shown, denoised; ticks: attacked`, share: 0.46, lines: traces, level: null, log: false, least: 3 * epsilon, marks: (row) => row.attacked },
    { title: ringing, share: 0.27, lines: [score], level: threshold, log: true, least: 0, marks: (row) => row.alarm },
    { title: "V of the true observation, and C_vul", share: 0.27, lines: [value], level: cVul, log: false, least: 1e-3, marks: null },
  ];
}

/** Draw the last steps of an episode. @param {HTMLCanvasElement} canvas @param {object[]} rows @param {Panel[]} drawn */
export function drawTraces(canvas, rows, drawn, colours) {
  const context = fit(canvas);
  const width = canvas.clientWidth - LEFT - 4;
  const height = canvas.clientHeight - GAP * drawn.length - 6;
  const first = Math.max(0, rows.length - WINDOW);
  const seen = rows.slice(first);
  const at = (i) => LEFT + (width * i) / (WINDOW - 1);
  let top = 0;
  for (const { title, share, lines, level, log, least, marks } of drawn) {
    top += GAP;
    const tall = share * height;
    const scaled = log ? (v) => Math.log10(Math.max(v, 1e-4)) : (v) => v;
    const values = lines.map(({ of }) => seen.map((row) => of(row)).map((v) => (v === null ? null : scaled(v))));
    const all = [...values.flat(), level === null ? null : scaled(level)].filter((v) => v !== null);
    let [low, high] = all.length ? [Math.min(...all), Math.max(...all)] : [0, 1];
    const room = Math.max(least - (high - low), (high - low) * 0.12, 1e-6) / 2;
    [low, high] = [low - room, high + room];
    const y = (v) => top + tall - (tall * (v - low)) / (high - low);

    context.font = "12px sans-serif";
    context.textBaseline = "alphabetic";
    context.textAlign = "left";
    context.fillStyle = colours.text;
    context.fillText(title, LEFT, top - 7, width);
    context.textAlign = "right";
    context.fillStyle = colours.muted;
    if (all.length) {
      const back = log ? (v) => 10 ** v : (v) => v;
      context.fillText(number(back(high)), LEFT - 6, top + 10);
      context.fillText(number(back(low)), LEFT - 6, top + tall);
    }
    context.fillStyle = colours.floor;
    context.fillRect(LEFT, top, width, tall);
    context.lineWidth = 1.6;
    if (level !== null) {
      context.setLineDash([5, 4]);
      context.strokeStyle = colours.alarm;
      context.beginPath();
      context.moveTo(LEFT, y(scaled(level)));
      context.lineTo(LEFT + width, y(scaled(level)));
      context.stroke();
    }
    lines.forEach(({ colour, dash }, k) => {
      context.setLineDash(dash);
      context.strokeStyle = colour;
      context.beginPath();
      let drawing = false;
      values[k].forEach((v, i) => {
        if (v !== null) context[drawing ? "lineTo" : "moveTo"](at(i), y(v));
        drawing = v !== null;
      });
      context.stroke();
    });
    context.setLineDash([]);
    if (marks) {
      context.fillStyle = colours.alarm;
      seen.forEach((row, i) => marks(row) && context.fillRect(at(i), top + tall - 5, Math.max(1.5, width / WINDOW), 5));
    }
    top += tall;
  }
}

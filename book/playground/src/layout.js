// The parts of a playground, from top to bottom.
import { h } from "./dom.js";

const LEGEND = {
  true: "the robot, and what is true",
  shown: "what the policy’s sensors show",
  denoised: "what the denoiser believes",
};
const HELP =
  "Keys: P run or pause, S one step, R restart, A attack (held), and with the picture in focus ← and → push. " +
  "Drag the robot to push it; with your own offset, drag the dashed robot to bend it. ";

/**
 * @param {object} playground whose methods the buttons call
 * @param {boolean} folded whether the settings are folded away
 * @returns {Record<string, HTMLElement>} the whole as element, and the parts that change
 */
export function layOut(playground, folded) {
  const button = (text, act, more = {}) => h("button", { type: "button", onclick: act, ...more }, text);
  const parts = {
    challenge: h("div", { class: "pg-challenge", hidden: true }),
    robots: h("div", { class: "pg-robots" }),
    runButton: button("Run", () => playground.run(!playground.running), { class: "pg-run", "aria-keyshortcuts": "P" }),
    strikeButton: button("Attack", () => {}, { "aria-keyshortcuts": "A", hidden: true }),
    status: h("p", { class: "pg-status", role: "status" }),
    traces: h("canvas", { class: "pg-traces", role: "img" }),
    address: h("a", { class: "pg-link" }, "link to these settings"),
  };
  const legend = Object.entries(LEGEND).map(([name, text]) => h("li", { class: `pg-key-${name}` }, text));
  const bar = [
    parts.runButton,
    button("Step", () => playground.single(), { "aria-keyshortcuts": "S" }),
    button("Restart", () => playground.restart(), { "aria-keyshortcuts": "R" }),
    button("Push back", () => playground.hands.shove(-1)),
    button("Push forward", () => playground.hands.shove(1)),
    parts.strikeButton,
  ];
  const form = playground.controls.element;
  parts.element = h(
    "div",
    { class: "pg" },
    parts.challenge,
    parts.robots,
    h("ul", { class: "pg-legend" }, ...legend),
    h("div", { class: "pg-bar", role: "group", "aria-label": "Episode" }, ...bar),
    parts.status,
    parts.traces,
    folded ? h("details", {}, h("summary", {}, "Settings"), form) : form,
    h("p", { class: "pg-help" }, HELP, parts.address),
  );
  return parts;
}

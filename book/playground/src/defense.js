// Detect and denoise: the policy sees the denoised observation where the detector raises an alarm
// (detden_lite/defense/detector.py, pipeline.py, oracles.py).

/** What may stand between the sensors and the policy. */
export const DEFENSES = {
  none: "none",
  detector: "detector alone",
  mixed: "detect and denoise",
  oracle: "oracle",
};

/**
 * The detector's score: the worst reconstruction error of an observation, in standard deviations.
 * @param {Float32Array} obs
 * @param {Float32Array} reconstruction
 * @param {Float32Array} scale
 */
export function score(obs, reconstruction, scale) {
  return obs.reduce((worst, x, i) => Math.max(worst, Math.abs((x - reconstruction[i]) / scale[i])), 0);
}

/**
 * All networks see every observation, whatever is switched on, so that their memories stay in step with the episode and
 * a defence can be switched on in its middle.
 */
export class Defense {
  /**
   * @param {{step: Function, reset: Function, obsStd: Float32Array}} detector
   * @param {number} threshold C_anomaly
   * @param {Record<string, {step: Function, reset: Function}>} denoisers by their key in DEFENSES
   */
  constructor(detector, threshold, denoisers) {
    Object.assign(this, { detector, threshold, denoisers });
  }

  /** Begin a new episode. @param {number} seed */
  reset(seed) {
    for (const part of [this.detector, ...Object.values(this.denoisers)]) part.reset(seed);
  }

  /**
   * The verdict on one observation.
   * @param {Float32Array} seen what the sensors say
   * @param {?Float32Array} action what the policy did one step before
   * @param {string} kind a key of DEFENSES
   * @param {{truth: Float32Array, attacked: boolean}} secret for the oracle alone
   * @returns {{obs: Float32Array, denoised: ?Float32Array, score: ?number, alarm: boolean}} obs is what the policy gets
   */
  judge(seen, action, kind, { truth, attacked }) {
    const error = score(seen, this.detector.step(seen), this.detector.obsStd);
    const estimates = {};
    for (const [name, denoiser] of Object.entries(this.denoisers)) estimates[name] = denoiser.step(seen, action);
    if (kind === "none") return { obs: seen, denoised: null, score: null, alarm: false };
    if (kind === "oracle") return { obs: attacked ? truth : seen, denoised: truth, score: Number(attacked), alarm: attacked };
    const alarm = error > this.threshold;
    const denoised = estimates[kind] ?? null; // the detector alone has none
    return { obs: alarm && denoised ? denoised : seen, denoised, score: error, alarm };
  }
}

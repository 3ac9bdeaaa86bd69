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
 * Both networks see every observation, whatever is switched on, so that their memories stay in step with the episode
 * and a defence can be switched on in its middle.
 */
export class Defense {
  /**
   * @param {import("./gruvae.js").GruVae} detector
   * @param {number} threshold C_anomaly
   * @param {import("./gruvae.js").GruVae} denoiser
   */
  constructor(detector, threshold, denoiser) {
    Object.assign(this, { detector, threshold, denoiser });
  }

  /** Begin a new episode. @param {number} seed */
  reset(seed) {
    this.detector.reset(seed);
    this.denoiser.reset(seed);
  }

  /**
   * The verdict on one observation.
   * @param {Float32Array} shown what the sensors say
   * @param {string} kind a key of DEFENSES
   * @param {Float32Array} truth for the oracle alone
   * @param {boolean} attacked for the oracle alone
   */
  judge(shown, kind, truth, attacked) {
    const error = score(shown, this.detector.step(shown), this.detector.obsStd);
    const estimate = this.denoiser.step(shown);
    if (kind === "oracle") {
      return { obs: attacked ? truth : shown, denoised: truth, score: Number(attacked), alarm: attacked, threshold: 0.5 };
    }
    const alarm = error > this.threshold;
    const verdict = { denoised: estimate, score: error, alarm, threshold: this.threshold };
    if (kind === "mixed") return { ...verdict, obs: alarm ? estimate : shown };
    if (kind === "detector") return { ...verdict, obs: shown, denoised: null };
    return { obs: shown, denoised: null, score: null, alarm: false, threshold: null };
  }
}

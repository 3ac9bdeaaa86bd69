// The GRU-VAE of detector and denoiser, run step by step (detden_lite/defense/gruvae.py, memory.py).
import { Gru, affine } from "./nets.js";
import { Random } from "./random.js";

export class GruVae {
  /**
   * @param {{latent: number, residual: boolean | boolean[]}} config of its sidecar
   * @param {Record<string, Float32Array>} tensors
   * @param {number} purpose a seed of its own: detector and denoiser draw different latent samples
   */
  constructor(config, tensors, purpose) {
    this.encoder = new Gru(tensors, "encoder.");
    this.decoder = new Gru(tensors, "decoder.");
    const linear = (name) => ({ weight: tensors[`${name}.weight`], bias: tensors[`${name}.bias`] });
    [this.toMean, this.toLogVariance, this.toOutput] = ["to_mean", "to_log_variance", "to_output"].map(linear);
    this.obsMean = tensors.obs_mean;
    this.obsStd = tensors.obs_std;
    this.added = Float64Array.from(this.obsMean, (_, i) => Number(Array.isArray(config.residual) ? config.residual[i] : config.residual));
    this.mean = new Float64Array(config.latent);
    this.logVariance = new Float64Array(config.latent);
    this.out = new Float64Array(this.obsMean.length);
    this.purpose = purpose;
    this.reset(0);
  }

  /** Begin a new episode. @param {number} seed */
  reset(seed) {
    this.encoder.reset();
    this.decoder.reset();
    this.random = new Random(this.purpose, seed);
  }

  /** The output for the next observation, both raw. @param {Float32Array} obs @returns {Float32Array} */
  step(obs) {
    const noise = this.random.normals(this.mean.length);
    const scored = Float64Array.from(obs, (x, i) => (x - this.obsMean[i]) / this.obsStd[i]);
    const encoded = this.encoder.step(scored);
    affine(this.toMean, encoded, this.mean);
    affine(this.toLogVariance, encoded, this.logVariance);
    const latent = this.mean.map((mu, i) => mu + Math.exp(0.5 * Math.min(Math.max(this.logVariance[i], -20), 10)) * noise[i]);
    affine(this.toOutput, this.decoder.step(latent), this.out);
    return Float32Array.from(obs, (_, i) => (this.added[i] * scored[i] + this.out[i]) * this.obsStd[i] + this.obsMean[i]);
  }
}

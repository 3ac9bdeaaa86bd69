// A frozen policy with its critic (detden_lite/victims/victim.py). A learned adversary is one too.
import { Mlp } from "./nets.js";

const clamp = (x, low, high) => Math.min(Math.max(x, low), high);

export class Victim {
  /**
   * @param {{activation: string, critic_activation: ?string, gaussian: boolean}} config of its sidecar
   * @param {Record<string, Float32Array>} tensors
   * @param {?{activation: string, tensors: Record<string, Float32Array>}} critic one that was learned afterwards
   */
  constructor(config, tensors, critic = null) {
    this.gaussian = config.gaussian;
    this.actor = Mlp.from(tensors, "actor.", config.activation, !this.gaussian);
    this.valueNet = "value_net.0.weight" in tensors ? Mlp.from(tensors, "value_net.", config.activation) : null;
    this.critics = [];
    while (`critics.${this.critics.length}.0.weight` in tensors) {
      const activation = config.critic_activation ?? config.activation;
      this.critics.push(Mlp.from(tensors, `critics.${this.critics.length}.`, activation));
    }
    if (critic) this.critics = [Mlp.from(critic.tensors, "", critic.activation)];
    this.obsMean = tensors.obs_mean;
    this.obsStd = tensors.obs_std;
    this.obsClip = tensors.obs_clip[0];
    this.low = tensors.action_low;
    this.high = tensors.action_high;
    this.precision = Float64Array.from(this.low, (_, i) => (this.gaussian ? tensors.action_std[i] ** -2 : 1));
    this.seen = null; // what the actor saw at its last call
  }

  get obsDim() {
    return this.obsMean.length;
  }

  get actionDim() {
    return this.low.length;
  }

  /** What the networks see of a raw observation; a new array. */
  normalize(obs) {
    return Float64Array.from(obs, (o, i) => clamp((o - this.obsMean[i]) / this.obsStd[i], -this.obsClip, this.obsClip));
  }

  /** The policy's output before a Gaussian policy's mean is clipped to the action bounds; a new array. */
  mean(obs) {
    this.seen = this.normalize(obs);
    const out = this.actor.forward(this.seen).slice();
    if (!this.gaussian) {
      for (let i = 0; i < out.length; i++) out[i] = this.low[i] + 0.5 * (out[i] + 1) * (this.high[i] - this.low[i]);
    }
    return out;
  }

  /** pi(o), inside the action bounds; a new array. */
  act(obs) {
    return this.mean(obs).map((a, i) => clamp(a, this.low[i], this.high[i]));
  }

  /** From a gradient with respect to the last mean to that with respect to its observation; a new array. */
  backward(gradient) {
    const outer = this.gaussian ? gradient : gradient.map((g, i) => (g * (this.high[i] - this.low[i])) / 2);
    return this.actor.backward(outer).map((g, i) => (Math.abs(this.seen[i]) < this.obsClip ? g / this.obsStd[i] : 0));
  }

  /** Q(o, a) of each critic. */
  qs(obs, action) {
    const x = this.#criticInput(obs, action);
    return this.critics.map((critic) => critic.forward(x)[0]);
  }

  /** The mean of the critics, and its gradient with respect to the action. */
  meanQ(obs, action) {
    const q = this.qs(obs, action);
    const gradient = new Float64Array(action.length);
    for (const critic of this.critics) {
      const ofInput = critic.backward([1 / q.length]).subarray(this.obsDim);
      for (let i = 0; i < gradient.length; i++) gradient[i] += (ofInput[i] * 2) / (this.high[i] - this.low[i]);
    }
    return { value: q.reduce((sum, x) => sum + x, 0) / q.length, gradient };
  }

  /** V(o): the value network's, or the smallest Q(o, pi(o)). */
  value(obs) {
    if (this.valueNet) return this.valueNet.forward(this.normalize(obs))[0];
    return Math.min(...this.qs(obs, this.act(obs)));
  }

  #criticInput(obs, action) {
    const scaled = Array.from(action, (a, i) => (2 * (a - this.low[i])) / (this.high[i] - this.low[i]) - 1);
    return Float64Array.of(...this.normalize(obs), ...scaled);
  }
}

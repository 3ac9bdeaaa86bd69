// Small networks for one observation at a time: their outputs, and their gradients with respect to the input.

/** @typedef {{weight: Float32Array, bias: Float32Array}} Linear weight is [outputs, inputs], row by row */

/**
 * out = weight x + bias.
 * @param {Linear} layer
 * @param {ArrayLike<number>} x
 * @param {Float64Array} out
 */
export function affine({ weight, bias }, x, out) {
  const n = x.length;
  for (let i = 0, row = 0; i < out.length; i++, row += n) {
    let even = bias[i];
    let odd = 0;
    let j = 0;
    for (; j + 1 < n; j += 2) {
      even += weight[row + j] * x[j];
      odd += weight[row + j + 1] * x[j + 1];
    }
    if (j < n) even += weight[row + j] * x[j];
    out[i] = even + odd;
  }
}

/**
 * out = weight^T gradient.
 * @param {Linear} layer
 * @param {Float64Array} gradient
 * @param {Float64Array} out
 */
function transposed({ weight }, gradient, out) {
  const n = out.length;
  out.fill(0);
  for (let i = 0, row = 0; i < gradient.length; i++, row += n) {
    const g = gradient[i];
    if (g === 0) continue; // of half of the ReLUs
    for (let j = 0; j < n; j++) out[j] += g * weight[row + j];
  }
}

/** A multilayer perceptron. What its methods return is overwritten by their next call. */
export class Mlp {
  /**
   * @param {Linear[]} layers
   * @param {"relu" | "tanh"} activation of the hidden layers
   * @param {boolean} squash whether a tanh follows the last layer
   */
  constructor(layers, activation, squash = false) {
    this.layers = layers;
    this.kinds = layers.map((_, i) => (i < layers.length - 1 ? activation : squash ? "tanh" : "none"));
    this.outputs = layers.map(({ bias }) => new Float64Array(bias.length));
    const inputs = layers.map(({ weight, bias }) => weight.length / bias.length);
    this.gradients = inputs.map((n) => new Float64Array(n));
  }

  /**
   * The network that is stored under a prefix: "actor." has "actor.0.weight", "actor.0.bias", "actor.2.weight", ...
   * @param {Record<string, Float32Array>} tensors
   * @param {string} prefix
   */
  static from(tensors, prefix, activation, squash = false) {
    const layers = [];
    for (let i = 0; `${prefix}${i}.weight` in tensors; i += 2) {
      layers.push({ weight: tensors[`${prefix}${i}.weight`], bias: tensors[`${prefix}${i}.bias`] });
    }
    if (!layers.length) throw new Error(`the file has no network ${prefix}`);
    return new Mlp(layers, activation, squash);
  }

  /** @param {ArrayLike<number>} x @returns {Float64Array} */
  forward(x) {
    for (let k = 0; k < this.layers.length; k++) {
      const out = this.outputs[k];
      affine(this.layers[k], x, out);
      if (this.kinds[k] === "relu") {
        for (let i = 0; i < out.length; i++) if (out[i] < 0) out[i] = 0;
      } else if (this.kinds[k] === "tanh") {
        for (let i = 0; i < out.length; i++) out[i] = Math.tanh(out[i]);
      }
      x = out;
    }
    return this.outputs[this.layers.length - 1];
  }

  /**
   * The input gradient of a function of the last forward's output.
   * @param {ArrayLike<number>} outer the function's gradient with respect to that output
   * @returns {Float64Array}
   */
  backward(outer) {
    let gradient = Float64Array.from(outer);
    for (let k = this.layers.length - 1; k >= 0; k--) {
      const out = this.outputs[k];
      if (this.kinds[k] === "relu") {
        for (let i = 0; i < out.length; i++) if (out[i] <= 0) gradient[i] = 0;
      } else if (this.kinds[k] === "tanh") {
        for (let i = 0; i < out.length; i++) gradient[i] *= 1 - out[i] * out[i];
      }
      transposed(this.layers[k], gradient, this.gradients[k]);
      gradient = this.gradients[k];
    }
    return gradient;
  }
}

const sigmoid = (x) => 1 / (1 + Math.exp(-x));

/** A GRU of one layer or several, which remembers (the equations of torch.nn.GRU). */
export class Gru {
  /**
   * @param {Record<string, Float32Array>} tensors
   * @param {string} prefix "encoder." for "encoder.weight_ih_l0", ...
   */
  constructor(tensors, prefix) {
    this.cells = [];
    for (let l = 0; `${prefix}weight_ih_l${l}` in tensors; l++) {
      const [input, state] = ["ih", "hh"].map((way) => ({
        weight: tensors[`${prefix}weight_${way}_l${l}`],
        bias: tensors[`${prefix}bias_${way}_l${l}`],
      }));
      const gates = input.bias.length;
      this.cells.push({
        input,
        state,
        ofInput: new Float64Array(gates),
        ofState: new Float64Array(gates),
        hidden: new Float64Array(gates / 3),
      });
    }
  }

  /** Forget everything. */
  reset() {
    for (const { hidden } of this.cells) hidden.fill(0);
  }

  /** The next hidden state of the last layer. @param {ArrayLike<number>} x @returns {Float64Array} */
  step(x) {
    for (const { input, state, ofInput, ofState, hidden } of this.cells) {
      const n = hidden.length;
      affine(input, x, ofInput);
      affine(state, hidden, ofState);
      for (let i = 0; i < n; i++) {
        const reset = sigmoid(ofInput[i] + ofState[i]);
        const keep = sigmoid(ofInput[n + i] + ofState[n + i]);
        const fresh = Math.tanh(ofInput[2 * n + i] + reset * ofState[2 * n + i]);
        hidden[i] = (1 - keep) * fresh + keep * hidden[i];
      }
      x = hidden;
    }
    return /** @type {Float64Array} */ (x);
  }
}

// A robot's physics in MuJoCo, with gymnasium's observations, rewards and ends (version 5 of its environments).
import { Random } from "./random.js";

/** What the three environments have of their own. */
export const ROBOTS = {
  hopper: {
    title: "Hopper", frameSkip: 4, controlCost: 1e-3, healthyReward: 1, noise: 5e-3, clip: 10,
    healthy: (qpos, qvel) =>
      qpos[1] > 0.7 && Math.abs(qpos[2]) < 0.2 && [...qpos.subarray(2), ...qvel].every((x) => Math.abs(x) < 100),
  },
  walker2d: {
    title: "Walker2d", frameSkip: 4, controlCost: 1e-3, healthyReward: 1, noise: 5e-3, clip: 10,
    healthy: (qpos) => qpos[1] > 0.8 && qpos[1] < 2 && Math.abs(qpos[2]) < 1,
  },
  halfcheetah: {
    title: "HalfCheetah", frameSkip: 5, controlCost: 0.1, healthyReward: 0, noise: 0.1, clip: Infinity, normalVelocity: true,
    healthy: () => true,
  },
};

const CAPSULE = 3; // mjtGeom

/** The model of a robot, which its worlds share. */
export class Robot {
  /**
   * @param {object} mujoco the WebAssembly module
   * @param {string} task a key of ROBOTS
   * @param {string} xml gymnasium's model
   */
  constructor(mujoco, task, xml) {
    Object.assign(this, { mujoco, task, ...ROBOTS[task] });
    const model = (this.model = mujoco.MjModel.from_xml_string(xml));
    this.dt = model.opt.timestep * this.frameSkip; // seconds from one action to the next
    const [sizes, bodies, types] = [model.geom_size, model.geom_bodyid, model.geom_type].map((view) => view.slice());
    this.capsules = []; // the robot's parts: where they are, and on which body
    for (let geom = 0; geom < model.ngeom; geom++) {
      if (types[geom] !== CAPSULE) continue;
      this.capsules.push({ geom, body: bodies[geom], radius: sizes[3 * geom], half: sizes[3 * geom + 1] });
    }
    this.joints = model.jnt_bodyid.slice(); // the body that each joint moves; all joints have one position
    this.axes = Array.from(this.joints, (_, j) => Math.sign(model.jnt_axis[3 * j + 1])); // 1 or -1 of a hinge
    this.mass = model.body_mass.reduce((sum, mass) => sum + mass, 0);
  }
}

/** One world of a robot. */
export class World {
  /** @param {Robot} robot */
  constructor(robot) {
    this.robot = robot;
    this.data = new robot.mujoco.MjData(robot.model);
    this.views = {};
  }

  /** MuJoCo's own array of this name. A view is lost when the memory of the module grows, and is taken anew. */
  view(name) {
    if (!this.views[name]?.length) this.views[name] = this.data[name];
    return this.views[name];
  }

  /**
   * Begin a new episode.
   * @param {number} seed
   * @returns {Float32Array} the first observation
   */
  reset(seed) {
    const { mujoco, model, noise, normalVelocity } = this.robot;
    const random = new Random(1, seed);
    const near = () => noise * (2 * random.uniform() - 1);
    mujoco.mj_resetData(model, this.data);
    const [qpos, qvel] = [this.view("qpos"), this.view("qvel")];
    for (let i = 0; i < qpos.length; i++) qpos[i] += near();
    for (let i = 0; i < qvel.length; i++) qvel[i] += normalVelocity ? noise * random.normal() : near();
    mujoco.mj_forward(model, this.data);
    return this.observe();
  }

  /** All positions but the first, the place on the floor, and all velocities. */
  observe() {
    const { clip } = this.robot;
    const velocities = this.view("qvel").map((v) => Math.min(Math.max(v, -clip), clip));
    return Float32Array.of(...this.view("qpos").subarray(1), ...velocities);
  }

  /**
   * One control step.
   * @param {ArrayLike<number>} action
   * @returns {{obs: Float32Array, reward: number, fallen: boolean}}
   */
  step(action) {
    const { mujoco, model, frameSkip, dt, controlCost, healthyReward } = this.robot;
    const before = this.view("qpos")[0];
    // As gymnasium is given them: rounded to single precision.
    const rounded = Float32Array.from(action);
    this.view("ctrl").set(rounded);
    for (let i = 0; i < frameSkip; i++) mujoco.mj_step(model, this.data);
    const [qpos, qvel] = [this.view("qpos"), this.view("qvel")];
    const healthy = this.robot.healthy(qpos, qvel);
    const effort = rounded.reduce((sum, a) => sum + a * a, 0);
    const reward = (qpos[0] - before) / dt + (healthy ? healthyReward : 0) - controlCost * effort;
    return { obs: this.observe(), reward, fallen: !healthy };
  }

  /** Push a body, until it is pushed otherwise. @param {number} body @param {number} x newtons @param {number} z newtons */
  push(body, x, z) {
    const forces = this.view("xfrc_applied").fill(0);
    forces[6 * body] = x;
    forces[6 * body + 2] = z;
  }

  /**
   * Take the pose that an observation describes, at a place on the floor.
   * @param {number} x
   * @param {Float32Array} obs
   */
  imagine(x, obs) {
    const qpos = this.view("qpos");
    qpos[0] = x;
    for (let i = 1; i < qpos.length; i++) qpos[i] = obs[i - 1];
    this.robot.mujoco.mj_kinematics(this.robot.model, this.data);
  }

  /** The capsules as they lie now: both ends of the axis, [x, z] in metres, and the radius. */
  pose() {
    const [places, turns] = [this.view("geom_xpos"), this.view("geom_xmat")];
    return this.robot.capsules.map(({ geom, body, radius, half }) => {
      const [x, z] = [places[3 * geom], places[3 * geom + 2]];
      const [dx, dz] = [half * turns[9 * geom + 2], half * turns[9 * geom + 8]];
      return { body, radius, from: [x - dx, z - dz], to: [x + dx, z + dz] };
    });
  }

  /** Where the joints are, [x, z] each. */
  anchors() {
    const anchors = this.view("xanchor");
    return Array.from(this.robot.joints, (_, j) => [anchors[3 * j], anchors[3 * j + 2]]);
  }
}

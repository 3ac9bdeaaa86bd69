// Answers a question about the playground's modules in JSON: the tests compare the answer with Python's.
import { readFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const { root, victim, questions } = JSON.parse(readFileSync(0, "utf8"));
const module = (path) => import(pathToFileURL(`${root}/${path}`));
const source = (name) => module(`book/playground/src/${name}.js`);
const [{ makeCast, readVictim }, { Attack, badnessObjective, oppositeObjective }, { Episode }, { Robot, World }] =
  await Promise.all(["assets", "attacks", "episode", "robot"].map(source));

const folder = `${root}/_build/vendor/playground/${victim}/`;
const brought = await readVictim(async (name) => new Uint8Array(readFileSync(folder + name)).buffer);
const { card } = brought;
const floats = (row) => Float32Array.from(row);

let robot; // starting MuJoCo takes a moment
async function world() {
  if (!robot) {
    const { default: start } = await module("_build/playground/node_modules/@mujoco/mujoco/mujoco.js");
    const quiet = () => {};
    robot = new Robot(await start({ print: quiet, printErr: quiet }), card.task, card.model);
  }
  return new World(robot);
}

const answers = {
  /** Outputs and gradients of the policy and its critics at each observation. */
  networks({ obs, action }) {
    const { victim } = makeCast(brought);
    return obs.map((row, i) => {
      const opposite = oppositeObjective(victim, floats(obs[(i + 1) % obs.length]))(floats(row), true);
      const bad = badnessObjective(victim, floats(obs[(i + 1) % obs.length]))(floats(row), true);
      const opposed = [opposite.value, ...opposite.gradient];
      return {
        act: [...victim.act(row)], qs: victim.qs(row, action[i]), value: victim.value(row),
        opposite: opposed, badness: [bad.value, ...bad.gradient],
      }; // prettier-ignore
    });
  },
  /** What each learned adversary makes of each observation. */
  adversaries({ obs }) {
    const cast = makeCast(brought);
    const of = { ...cast, epsilon: card.epsilon };
    const perturb = (name) => obs.map((row) => [...new Attack(name, of, 0).perturb(floats(row))]);
    return Object.fromEntries(Object.keys(cast.adversaries).map((name) => [name, perturb(name)]));
  },
  /** An attack, step by step in one episode. */
  attack({ name, obs, steps, epsilon, seed, offset = [] }) {
    const attack = new Attack(name, { ...makeCast(brought), steps, epsilon, offset }, seed);
    return obs.map((row) => [...attack.perturb(floats(row))]);
  },
  /** The defence's verdicts on a sequence, with the latent noise of both networks given. */
  defense({ obs, noise }) {
    const { defense } = makeCast(brought);
    const draws = noise.map((rows) => rows[Symbol.iterator]());
    [defense.detector, defense.denoisers.mixed].forEach((net, i) => {
      net.random = { normals: () => draws[i].next().value };
    });
    return obs.map((row) => {
      const { obs: shown, denoised, score, alarm } = defense.judge(floats(row), null, "mixed", {});
      return { shown: [...shown], denoised: [...denoised], score, alarm };
    });
  },
  /** Observations, rewards and ends under given actions, from a given state. */
  async physics({ state, actions }) {
    const one = await world();
    one.reset(0);
    const qpos = one.view("qpos");
    qpos.set(state.slice(0, qpos.length));
    one.view("qvel").set(state.slice(qpos.length));
    one.robot.mujoco.mj_forward(one.robot.model, one.data);
    return actions.map((action) => {
      const { obs, reward, fallen } = one.step(action);
      return { obs: [...obs], state: [...one.view("qpos"), ...one.view("qvel")], reward, fallen };
    });
  },
  /** First observations of episodes. */
  async starts({ seeds }) {
    const one = await world();
    return seeds.map((seed) => [...one.reset(seed)]);
  },
  /** Whole episodes. */
  async episodes({ seeds, ...given }) {
    const [one, cast] = [await world(), makeCast(brought)];
    const conditions = {
      attack: "none", epsilon: card.epsilon, steps: 20, offset: [], timing: "always", rate: card.rate, pressed: false,
      defense: "none", ...given,
    }; // prettier-ignore
    return seeds.map((seed) => {
      const episode = new Episode(one, cast, seed);
      while (!episode.over) episode.step(conditions);
      const { steps, return: sum, strikes, alarms, fallen } = episode;
      return { steps, return: sum, strikes, alarms, fallen };
    });
  },
};

const found = [];
for (const { ask, ...about } of questions) found.push(await answers[ask](about));
process.stdout.write(JSON.stringify(found));

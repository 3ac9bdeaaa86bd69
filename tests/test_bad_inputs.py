"""Bad input over the public face and the command line: every one is refused, by an error that names what is wrong."""

import json
import re
from dataclasses import replace
from math import inf, nan
from pathlib import Path

import numpy as np
import pytest
import torch
from builders import BUDGET, HOPPER, make_defense, make_gruvae, make_victim
from hypothesis import given, settings
from hypothesis import strategies as st

import detden_lite as dd
from detden_lite.core.files import ArtifactError
from detden_lite.recipe.cli import main
from detden_lite.store import manifest, tensors

VICTIM, GAUSSIAN, WALKER = make_victim(), make_victim(gaussian=True), make_victim(dd.get_task("walker2d"))
OBS = torch.zeros(2, 11)
WAVES = dd.Trajectories(np.zeros((4, 10, 11), np.float32), np.full(4, 10))
NOT_FINITE = dd.Trajectories(np.full((4, 10, 11), np.nan, np.float32), np.full(4, 10))
RECIPE = dd.VAERecipe(hidden=4, latent=2, epochs=1, batch=2)


class Leaves(dd.UniformNoise):
    """Goes out of its ball."""

    def __call__(self, obs, world):
        return obs + 2 * self.budget.epsilon


class WrongShape(dd.UniformNoise):
    def __call__(self, obs, world):
        return obs[:, 1:]


class WrongType(dd.UniformNoise):
    def __call__(self, obs, world):
        return obs.double()


class NotFinite(dd.UniformNoise):
    def __call__(self, obs, world):
        return obs * nan


class NeedsTooMuch(dd.UniformNoise):
    needs = frozenset({"root password"})


class OddTiming(dd.Always):
    def __call__(self, obs):
        return torch.ones(len(obs))


class NoVerdict:
    needs = frozenset()

    def reset(self, episodes):
        pass

    def restart(self, i, episode):
        pass

    def __call__(self, obs, action=None):
        return obs


def roll(*args, **kwargs):
    return lambda: dd.rollout(*(args or (VICTIM, HOPPER, range(2))), **dict(steps=2) | kwargs)


def struck(make, obs=OBS):
    def strike():
        attack = make()
        attack.reset([0, 1])
        return attack(obs, None)

    return strike


def fitted(**changes):
    return lambda: dd.train_gruvae(replace(RECIPE, **changes), [(WAVES, WAVES)], 0)


def predicted(obs, **kwargs):
    return lambda: dd.Defended(VICTIM, HOPPER, make_defense()).predict(obs, **kwargs)


def judged(obs, rows=2, defense=None):
    def judge():
        made = defense or make_defense()
        made.reset(range(rows))
        return made(obs)

    return judge


# Each: a name, what to do, and a word that the error must say.
CASES = [
    # The ball
    *((f"budget epsilon {e}", lambda e=e: dd.Budget(e), "epsilon") for e in (-1, -0.1, inf, -inf, nan, "0.1", None)),
    *((f"budget norm {n}", lambda n=n: dd.Budget(0.1, n), "norm") for n in (0, 3, -1, nan, "inf", None)),
    *(
        (f"budget scale {s}", lambda s=s: dd.Budget(0.1, scale=s), "scale")
        for s in (0.0, -1.0, nan, inf, [1.0, 0.0], [1.0, nan], torch.tensor([-1.0]), "wide", [])
    ),
    *(
        (
            f"scale of {n} numbers, {m}",
            lambda n=n, m=m, x=x: getattr(dd.Budget(0.1, scale=[1.0] * n), m)(OBS, x),
            "scale",
        )
        for n in (2, 10, 12)
        for m, x in (("project", OBS), ("contains", OBS), ("sample", dd.RandomStreams(0)))
    ),
    # Tasks and random numbers
    *(
        (f"task {n!r}", lambda n=n: dd.get_task(n), "choose one of")
        for n in ("", "Hopper", "hopper-v5", "cartpole", None)
    ),
    *((f"seeds purpose {p!r}", lambda p=p: dd.seeds(p, 3), "purpose") for p in ("reports", "", None)),
    *((f"seeds count {n!r}", lambda n=n: dd.seeds("report", n), "n") for n in (-1, 1.5)),
    *((f"streams seed {s!r}", lambda s=s: dd.RandomStreams(s), "seed") for s in (-1, 1.5, "a", None)),
    *((f"streams episode {s!r}", lambda s=s: dd.RandomStreams(0, [s]), "episode") for s in (-1, 1.5, "a", None)),
    ("streams rows", lambda: dd.RandomStreams(0, [1, 2]).normal(3, 1), "rows"),
    # Rollout
    *((f"rollout steps {s!r}", roll(steps=s), "steps") for s in (0, -1, 1.5, "all")),
    *((f"rollout seeds {s!r}", roll(VICTIM, HOPPER, s), "seeds") for s in ([], [1.5], [-1], ["a"], [None], [nan])),
    *((f"rollout noise rate {s!r}", roll(noise_rate=s), "noise_rate") for s in (-0.1, nan, 1.1)),
    *((f"rollout noise {s!r}", roll(action_noise=s), "action_noise") for s in (-0.1, nan, inf, [0.1, -0.1])),
    *(
        (f"rollout attack of type {type(a).__name__}", roll(attack=a), "attack")
        for a in ("opposite", 1, dd.UniformNoise, object())
    ),
    *((f"rollout timing {a!r}", roll(attack=dd.UniformNoise(BUDGET), timing=a), "timing") for a in ("always", 1)),
    *((f"rollout defense {a!r}", roll(defense=a), "defense") for a in ("mixed", 1, make_gruvae())),
    ("rollout of another task", roll(WALKER, HOPPER, range(2)), "victim"),
    ("attack leaves its ball", roll(attack=Leaves(BUDGET)), "attack"),
    ("attack of a wrong shape", roll(attack=WrongShape(BUDGET)), "attack"),
    ("attack of a wrong type", roll(attack=WrongType(BUDGET)), "attack"),
    ("attack gives NaN", roll(attack=NotFinite(BUDGET)), "attack"),
    ("attack needs what there is not", roll(attack=NeedsTooMuch(BUDGET)), "attack"),
    ("attack of another task", roll(attack=dd.OppositeAttack(WALKER, BUDGET)), "victim"),
    ("attack without its defence", roll(attack=dd.AdaptiveAttack(dd.OppositeAttack(VICTIM, BUDGET))), "defense"),
    ("timing gives floats", roll(attack=dd.UniformNoise(BUDGET), timing=OddTiming()), "timing"),
    ("defence gives no verdict", roll(defense=NoVerdict()), "defense"),
    ("defence of another task", roll(defense=make_defense(17)), "obs"),
    # Attacks
    *(
        (f"{kind.__name__} {name} {value!r}", lambda k=kind, n=name, v=value: k(VICTIM, BUDGET, **{n: v}), name)
        for kind in (dd.OppositeAttack, dd.QFunctionAttack)
        for name in ("steps", "restarts")
        for value in (0, -1, 1.5)
    ),
    *(
        (f"{kind.__name__} budget {value!r}", lambda k=kind, v=value: k(VICTIM, v), "budget")
        for kind in (dd.OppositeAttack, dd.QFunctionAttack)
        for value in (0.1, None, "0.1")
    ),
    ("opposite without a victim", lambda: dd.OppositeAttack("td3", BUDGET), "victim"),
    ("scale of another task", lambda: dd.OppositeAttack(VICTIM, dd.Budget(0.1, scale=[1.0] * 17)), "scale"),
    ("Q attack without a critic", struck(lambda: dd.QFunctionAttack(GAUSSIAN, BUDGET)), "Q-function"),
    *(
        (f"{kind.__name__} of NaN observations", struck(lambda k=kind: k(VICTIM, BUDGET), OBS * nan), "obs")
        for kind in (dd.OppositeAttack, dd.QFunctionAttack)
    ),
    ("attack before reset", lambda: dd.OppositeAttack(VICTIM, BUDGET)(OBS, None), "reset"),
    ("noise before reset", lambda: dd.UniformNoise(BUDGET)(OBS, None), "reset"),
    *((f"noise budget {b!r}", lambda b=b: dd.UniformNoise(b), "budget") for b in (0.1, None)),
    *((f"vulnerable {t!r}", lambda t=t: dd.Vulnerable(VICTIM, t), "threshold") for t in (nan, "low", None)),
    *((f"random {r!r}", lambda r=r: dd.Random(r), "rate") for r in (-0.1, 1.1, nan, "often")),
    *((f"after {s!r}", lambda s=s: dd.After(s), "step") for s in (-1, 1.5, nan)),
    *(
        (f"adaptive {n} {v!r}", lambda n=n, v=v: dd.AdaptiveAttack(dd.OppositeAttack(VICTIM, BUDGET), **{n: v}), n)
        for n in ("steps", "restarts", "samples", "fresh")
        for v in (0, -1, 1.5)
    ),
    *(
        (f"coupled pace {p!r}", lambda p=p: dd.CoupledAttack(dd.OppositeAttack(VICTIM, BUDGET), p), "pace")
        for p in (0, -1, nan)
    ),
    ("coupled in another norm", lambda: dd.CoupledAttack(dd.OppositeAttack(VICTIM, dd.Budget(0.1, 2))), "norm"),
    ("printed form", lambda: dd.PrintedAttack(dd.OppositeAttack(VICTIM, BUDGET), "footnote"), "form"),
    ("adversary of another task", struck(lambda: dd.OptimalAttack(WALKER, BUDGET)), "adversary"),
    *(
        (f"threat {n} {v!r}", lambda n=n, v=v: dd.Threat(BUDGET, **{n: v}), n)
        for n, v in (("steps", 0), ("restarts", 0), ("rate", 1.5), ("rate", nan), ("c_vul", nan))
    ),
    ("threat of an unknown attack", lambda: dd.Threat(BUDGET).attack("tickle", VICTIM, HOPPER), "attack"),
    ("threat of an unknown timing", lambda: dd.Threat(BUDGET).timing("never", VICTIM), "timing"),
    *(
        (f"ascend {n} {v!r}", lambda n=n, v=v: dd.ascend(lambda x: x.sum(-1), OBS, BUDGET, None, **{n: v}), n)
        for n in ("steps", "restarts")
        for v in (0, -1)
    ),
    *(
        (f"planner {n} {v!r}", lambda n=n, v=v: dd.CEMPlanner("Hopper-v5", **{n: v}), n)
        for n, v in (
            ("horizon", 0),
            ("population", 0),
            ("iterations", 0),
            ("elites", 0),
            ("elites", 1_000),
            ("floor", -1.0),
        )
    ),
    ("planner of an unknown task", lambda: dd.CEMPlanner("Swimmer-v5"), "env_id"),
    (
        "attacked env with a planner",
        lambda: dd.AttackedObservations(None, dd.EnchantingAttack(VICTIM, BUDGET, None)),
        "attack",
    ),
    ("attacked env by name", lambda: dd.AttackedObservations(None, "opposite"), "attack"),
    # The defence
    *(
        (f"recipe {n} {v!r}", lambda n=n, v=v: replace(RECIPE, **{n: v}), n)
        for n, v in (
            ("hidden", 0),
            ("layers", 0),
            ("latent", 0),
            ("epochs", 0),
            ("batch", 0),
            ("chunk", 0),
            ("learning_rate", 0.0),
            ("learning_rate", -1.0),
            ("learning_rate", nan),
            ("beta", -1.0),
            ("beta", nan),
            ("lam", -1.0),
            ("lam", nan),
            ("least_share", -0.1),
            ("least_share", 1.1),
            ("least_size", 2.0),
            ("prior", "flat"),
            ("epochs", 1.5),
        )
    ),
    ("training on NaN", lambda: dd.train_gruvae(RECIPE, [(NOT_FINITE, NOT_FINITE)], 0), "pairs"),
    ("training on nothing", lambda: dd.train_gruvae(RECIPE, [], 0), "pairs"),
    ("regularizer forgotten", fitted(lam=0.1), "regularizer"),
    ("gaussian of NaN", lambda: dd.Gaussian.fit(NOT_FINITE), "normal"),
    ("linear model of NaN", lambda: dd.LinearModel.fit(NOT_FINITE), "normal"),
    ("ridge", lambda: dd.Gaussian.fit(WAVES, 0.0), "ridge"),
    *(
        (f"detector threshold {t!r}", lambda t=t: dd.Detector(make_gruvae(), t), "threshold")
        for t in (nan, "high", None)
    ),
    *(
        (f"calibrate rate {r!r}", lambda r=r: dd.calibrate(np.ones(9), r), "false_alarm_rate")
        for r in (0, 1, -0.1, 1.1, nan)
    ),
    *(
        (f"calibrate scores {s}", lambda s=s: dd.calibrate(np.array(s)), "clean_scores")
        for s in ([], [nan], [inf, 1.0])
    ),
    *(
        (f"conformal {s}", lambda s=s: dd.conformal_threshold([np.array(e) for e in s]), "episodes")
        for s in ([], [[]], [[1.0], [nan]])
    ),
    ("tuned on clean steps alone", lambda: dd.tuned_threshold(np.ones(3), np.zeros(3, bool)), "attacked"),
    ("tuned misses", lambda: dd.tuned_threshold(np.ones(3), np.array([True, False, True]), 1.0), "misses"),
    ("defence before reset", lambda: make_defense()(OBS), "reset"),
    ("defence of other rows", judged(OBS, rows=3), "rows"),
    ("defence of NaN", judged(OBS * nan), "obs"),
    ("defence of doubles", judged(OBS.double()), "obs"),
    ("judging another task", judged(torch.zeros(2, 17)), "obs"),
    (
        "oracle outside of rollout",
        judged(OBS, defense=dd.DetectAndDenoise(dd.OracleDetector(), dd.Identity())),
        "truth",
    ),
    *(
        (f"predict {name}", predicted(obs), "obs")
        for name, obs in (
            ("nothing", np.zeros((0, 11))),
            ("another task", np.zeros(17)),
            ("NaN", np.full(11, nan)),
            ("three axes", np.zeros((1, 1, 11))),
            ("a number", 3.0),
            ("text", "left"),
        )
    ),
    ("predict with other starts", predicted(np.zeros((2, 11)), episode_start=np.zeros(3, bool)), "episode_start"),
    *((f"augment {a!r}", lambda a=a: dd.augment(WAVES, a), "attack") for a in ("opposite", None)),
    ("augment with a planner", lambda: dd.augment(WAVES, dd.EnchantingAttack(VICTIM, BUDGET, None)), "attack"),
    *(
        (f"intermittent {n} {v!r}", lambda n=n, v=v: dd.intermittent(WAVES.obs, WAVES.obs, **{n: v}), n)
        for n, v in (("least_share", -0.1), ("least_size", 1.1), ("run", 0))
    ),
    *(
        (
            f"collect {n} {v!r}",
            lambda n=n, v=v: dd.collect_normal(VICTIM, HOPPER, range(2), **dict(steps=2) | {n: v}),
            n,
        )
        for n, v in (("lockstep", -1), ("lockstep", 0), ("action_noise", (-0.1,)), ("action_noise", ()), ("steps", 0))
    ),
    # Estimates
    *((f"estimate {v}", lambda v=v: dd.estimate(np.array(v)), "values") for v in ([], [nan], [[1.0]], [inf])),
    ("scores of other shapes", lambda: dd.detector_scores(np.ones(2, bool), np.ones(3, bool)), "shape"),
    *((f"f1 {v}", lambda v=v: dd.f1_at(*v), "rate") for v in ((0, 0, 0), (1.1, 0, 0), (0.5, -1, 0), (0.5, 0, 2))),
    # Victims and critics
    *(
        (f"Q recipe {n} {v!r}", lambda n=n, v=v: dd.QRecipe(**{n: v}), n)
        for n, v in (
            ("epochs", 0),
            ("batch", 0),
            ("learning_rate", 0.0),
            ("gamma", 1.5),
            ("noise", 0.0),
            ("noise_rate", 1.5),
            ("episodes", 0),
        )
    ),
    ("a victim from nothing", lambda: dd.Victim.from_sb3(object()), "model"),
    ("a victim from a path", lambda: dd.Victim.from_sb3("model.zip"), "model"),
    ("mlp activation", lambda: dd.mlp([2, 2], "sigmoid"), "activation"),
    ("Q of a victim without", lambda: GAUSSIAN.q(OBS, torch.zeros(2, 3)), "Q-function"),
    ("a critic of other sizes", lambda: GAUSSIAN.with_critic([3, 1], {}), "critic"),
    # One call
    *(
        (f"defend {n} {v!r}", lambda n=n, v=v: _defend(**{n: v}), n)
        for n, v in (
            ("budget", 0.1),
            ("budget", None),
            ("budget", dd.Budget(0.1, scale=[1.0] * 3)),
            ("env", "Hopper-v0"),
            ("env", "CartPole-v1"),
            ("env", None),
            ("scale", "huge"),
            ("scale", 3),
            ("seed", 1.5),
            ("seed", -1),
            ("victim", WALKER),
        )
    ),
    ("defend a path", lambda: _defend(victim="model.zip"), "model"),
    # What is shipped
    *(
        (f"load_victim {t!r} {a!r}", lambda t=t, a=a: dd.load_victim(t, a), "victim")
        for t, a in (("hopper", "sac"), ("cart", "td3"))
    ),
    ("load_defense", lambda: dd.load_defense("hopper", "td3", "armour"), "armour"),
    ("load_record", lambda: dd.load_record("hopper-td3.none.never.none"), "hopper-td3.none.never.none"),
    ("load_adversary", lambda: dd.load_adversary("hopper", "td3", "lazy"), "kind"),
    ("Run.of a scale", lambda: dd.Run.of(Path("runs"), "hopper", "td3", "huge"), "scale"),
    ("Run.of an algorithm", lambda: dd.Run.of(Path("runs"), "hopper", "sac", "tiny"), "algorithm"),
]


def _defend(**changes):
    """Nothing may be left behind by a call that is refused: the folder is looked at below."""
    return dd.defend(
        **dict(victim=VICTIM, env="Hopper-v5", budget=BUDGET, scale="tiny", folder=_defend.folder) | changes
    )


@pytest.mark.parametrize(("do", "says"), [case[1:] for case in CASES], ids=[case[0] for case in CASES])
def test_bad_input_is_refused_by_a_named_error(do, says, tmp_path):
    _defend.folder = tmp_path / "defended"
    with pytest.raises((ValueError, ArtifactError)) as refused:
        do()
    assert re.search(rf"\b{re.escape(says)}\b", str(refused.value))
    assert not _defend.folder.exists()


def test_there_are_two_hundred_bad_inputs():
    assert len(CASES) + len(COMMANDS) + len(DAMAGES) >= 200
    assert len({case[0] for case in CASES}) == len(CASES)


# The command line

COMMANDS = [
    [],
    ["walk"],
    ["victim", "--task", "cart"],
    ["victim", "--algo", "sac"],
    ["victim", "--scale", "huge"],
    ["victim", "--seed", "x"],
    ["denoiser", "--variant", "armour"],
    ["collect", "--data", "none"],
    ["evaluate", "--attacks", "tickle"],
    ["evaluate", "--defenses", "armour"],
    ["adapt", "--defenses", "none"],
    ["table", "--task", "hopper"],
    ["--root", "x"],
    ["adversary", "--member", "99"],
    ["adversary", "--member", "-1"],
    ["select"],
    ["qfunction"],
    ["collect"],
    ["augment"],
    ["detector"],
    ["denoiser"],
    ["timing"],
    ["choose"],
    ["linear"],
    ["evaluate"],
    ["publish"],
    ["table"],
]


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_a_command_that_cannot_run_ends_with_one_line(command, tmp_path, capsys):
    if command and not command[0].startswith("-") and command[0] != "walk":
        command = [*command, "--root", str(tmp_path / "run")]
    with pytest.raises(SystemExit) as ended:
        main(command)
    said = str(ended.value) + capsys.readouterr().err
    assert ended.value.code not in (0, None) and "error: " in said and "Traceback" not in said


# Files

SIDECAR = dict(threshold=1.0)


def _write(path: Path, content: bytes, root: Path) -> None:
    manifest.write_bytes(path, content, root)


DAMAGES = dict(
    missing=lambda path, root: path.unlink(),
    truncated=lambda path, root: path.write_bytes(path.read_bytes()[:-9]),
    altered=lambda path, root: path.write_bytes(path.read_bytes()[:-1] + b"\x00"),
    pickled=lambda path, root: _write(path, b"\x80\x04]\x94.", root),
    unlisted=lambda path, root: (root / "manifest.json").write_text("{}"),
    manifest_list=lambda path, root: (root / "manifest.json").write_text("[]"),
    manifest_cut=lambda path, root: (root / "manifest.json").write_text("{"),
    manifest_latin=lambda path, root: (root / "manifest.json").write_bytes(b'{"\xe9": "0"}'),
    sidecar_missing=lambda path, root: path.with_suffix(".json").unlink(),
    sidecar_list=lambda path, root: _write(path.with_suffix(".json"), b"[]", root),
    sidecar_text=lambda path, root: _write(path.with_suffix(".json"), b"not json", root),
    sidecar_without_threshold=lambda path, root: _write(
        path.with_suffix(".json"), json.dumps(dict(config=make_gruvae().config)).encode(), root
    ),
    sidecar_nan_threshold=lambda path, root: _write(
        path.with_suffix(".json"), json.dumps(dict(config=make_gruvae().config, threshold=nan)).encode(), root
    ),
    weights_nan=lambda path, root: tensors.save_tensors(
        path, {k: v * nan for k, v in make_gruvae().state_dict().items()},
        dict(SIDECAR, config=make_gruvae().config), root,
    ),
    weights_of_other_sizes=lambda path, root: tensors.save_tensors(
        path, make_gruvae(17).state_dict(), dict(SIDECAR, config=make_gruvae().config), root
    ),
)  # fmt: skip


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_detector_is_refused_by_name(damage, tmp_path):
    from detden_lite.store import models

    models.save_model("hopper", "td3", "detector-diverse", make_gruvae(), SIDECAR, tmp_path)
    models.save_model("hopper", "td3", "denoiser-mixed", make_gruvae(), dict(data="diverse"), tmp_path)
    path = tmp_path / "hopper-td3" / "detector-diverse.safetensors"
    DAMAGES[damage](path, tmp_path)
    with pytest.raises(ArtifactError) as refused:
        dd.load_defense("hopper", "td3", "mixed", tmp_path)
    assert "detector-diverse" in str(refused.value) or "manifest.json" in str(refused.value)


# Whatever it is

JUNK = st.one_of(
    st.none(), st.text(max_size=3), st.floats(allow_nan=True), st.integers(-5, 0), st.lists(st.floats(), max_size=2)
)


@settings(deadline=None, derandomize=True, max_examples=50)
@given(JUNK)
def test_junk_for_an_attack_timing_or_defence_never_passes(junk):
    for argument in ("attack", "timing", "defense"):
        if junk is not None:
            with pytest.raises(ValueError, match=argument):
                dd.rollout(VICTIM, HOPPER, range(2), steps=1, **dict(attack=dd.UniformNoise(BUDGET)) | {argument: junk})

"""The defences that are assembled around the main one, from parts that are trained in seconds."""

import json

import numpy as np
import pytest
from builders import make_victim

from detden_lite.attacks.opposite import OppositeAttack
from detden_lite.attacks.timing import Random
from detden_lite.core import files
from detden_lite.defense import variants
from detden_lite.defense.variants import MAIN
from detden_lite.recipe import ablations, defense_stages, evaluation
from detden_lite.recipe.episode_seeds import seeds
from detden_lite.recipe.run import Run
from detden_lite.recipe.trajectories import load_trajectories
from detden_lite.results import records
from detden_lite.simulation.rollout import rollout
from detden_lite.store import manifest, models


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Run:
    """The parts of the main defence of an untrained victim, and the baselines."""
    run = Run.of(tmp_path_factory.mktemp("ablations"), "hopper", "td3", "tiny")
    models.save_victim("hopper", "td3", make_victim(), {}, run.root)
    defense_stages.collect(run, "diverse")
    defense_stages.augment(run, "diverse")
    defense_stages.train_detector(run, "diverse")
    defense_stages.train_denoiser(run, MAIN)
    ablations.fit_baselines(run)
    ablations.tune_threshold(run)
    return run


def play(run: Run, defense):
    victim = run.victim()
    attack = OppositeAttack(victim, run.budget, steps=3)
    return rollout(victim, run.task, seeds("report", 4), attack=attack, timing=Random(0.5), defense=defense, steps=20)


def error(episodes) -> np.ndarray:
    return np.abs(episodes.denoised - episodes.obs)[episodes.mask]


def test_every_assembled_defence_has_one_maker():
    assert list(ablations._MAKERS) == list(variants.ASSEMBLED)


@pytest.mark.parametrize("name", variants.ASSEMBLED)
def test_every_assembled_defence_runs_and_differs_from_the_main_one(run, name):
    main, other = play(run, ablations.build_defense(run, MAIN)), play(run, ablations.build_defense(run, name))
    assert other.mask.any() and np.isfinite(other.shown[other.mask]).all()
    same = [np.array_equal(getattr(main, part), getattr(other, part)) for part in ("shown", "denoised", "score")]
    assert not all(same) or name == "tuned"  # whose threshold has a test of its own


def test_each_ablation_changes_what_its_name_says(run):
    main = ablations.build_defense(run, MAIN)
    always = play(run, ablations.build_defense(run, "always"))
    assert np.array_equal(always.shown[always.mask], always.denoised[always.mask])
    projected = play(run, ablations.build_defense(run, "projected"))
    assert np.abs(projected.denoised - projected.perturbed)[projected.mask].max() <= run.budget.epsilon + 1e-5
    assert ablations.build_defense(run, "detector-only").denoiser is None
    mean = ablations.build_defense(run, "latent-mean")
    assert not mean.detector.sample and not mean.denoiser.sample and main.detector.sample
    identity = play(run, ablations.build_defense(run, "identity"))
    assert np.array_equal(identity.denoised, identity.perturbed)


def test_the_ceilings_know_the_truth(run):
    assert error(play(run, ablations.build_defense(run, "oracle-denoiser"))).max() == 0
    told = play(run, ablations.build_defense(run, "oracle-detector"))
    assert np.array_equal(told.alarm, told.attacked)


def test_the_baselines_are_calibrated_and_closer_to_normal_than_chance(run):
    """They raise the alarm on the share of held-out clean observations that they were calibrated to."""
    held_out = load_trajectories(run, "calibration")
    for name in ("mahalanobis", "prediction"):
        detector = ablations.build_defense(run, name).detector
        alarms = (ablations.clean_scores(detector, held_out) > detector.threshold).mean()
        assert alarms <= 0.01
    kalman = error(play(run, ablations.build_defense(run, "kalman"))).mean()
    assert kalman < 2 * error(play(run, ablations.build_defense(run, "identity"))).mean()


def test_the_tuned_defence_has_the_tuned_threshold(run):
    defense = ablations.build_defense(run, "tuned")
    found = json.loads((run.folder / "threshold.json").read_text())
    assert defense.detector.threshold == found["threshold"] and found["seeds"] == [seeds("tuning", 1)[0], 4]
    assert defense.detector.threshold != ablations.build_defense(run, MAIN).detector.threshold


def test_a_lost_part_is_made_again_the_same(run):
    def contents():
        return {path.name: path.read_bytes() for path in run.folder.iterdir() if path.is_file()}

    before = contents()
    for name in ("autoencoder.safetensors", "baselines.json", "threshold.json"):
        (run.folder / name).unlink()
    ablations.fit_baselines(run)
    ablations.tune_threshold(run)
    assert contents() == before


def test_an_unknown_name_and_a_missing_part_are_refused(run, tmp_path):
    with pytest.raises(ValueError, match="defense must be one of printed, .*oracle-denoiser, not 'prayer'"):
        ablations.build_defense(run, "prayer")
    empty = Run.of(tmp_path, "hopper", "td3", "tiny")
    with pytest.raises(files.ArtifactError, match="missing"):
        ablations.build_defense(empty, "kalman")


def test_records_of_assembled_defences_name_their_changes(run):
    manifest.write_json(run.folder / "timing.json", dict(c_vul=0.0, attack_rate=0.5), run.root)
    evaluation.evaluate(run, ("always", "oracle-denoiser"), ("none", "opposite"))
    always = records.load_record("hopper-td3.opposite.always.always", run.root)
    oracle = records.load_record("hopper-td3.opposite.always.oracle-denoiser", run.root)
    assert always["settings"]["always"] and oracle["settings"]["truth"] and oracle["denoiser_mae"] == 0
    assert always["auroc_clean"] is not None and always["live_dimensions"] > 0

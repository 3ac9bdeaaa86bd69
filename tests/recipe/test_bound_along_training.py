import numpy as np
import pytest
import torch
from builders import make_gruvae, ship_victim
from scipy.stats import norm

from detden_lite.defense.detector import Detector
from detden_lite.recipe import bound_along_training, defense_stages
from detden_lite.recipe.bound_along_training import both_sides, discounted, noise_of, play, total_variations
from detden_lite.recipe.cli import main
from detden_lite.recipe.run import Run
from detden_lite.store import manifest, models


@pytest.fixture
def run(tmp_path):
    ship_victim(tmp_path)
    models.save_model("hopper", "td3", "detector-diverse", make_gruvae(), dict(threshold=1.0), tmp_path)
    models.save_model("hopper", "td3", "denoiser-residual", make_gruvae(), dict(data="diverse"), tmp_path)
    return Run.of(tmp_path, "hopper", "td3", "tiny")


def nothing():
    """A denoiser that does nothing."""
    model = make_gruvae(residual=True)
    model.to_output.weight.zero_(), model.to_output.bias.zero_()
    return model


def test_the_discounted_return_sums_the_steps_before_the_end(run):
    episodes = play(run, run.victim(), 2)
    for i, length in enumerate(episodes.lengths):
        by_hand = sum(0.9**t * episodes.reward[t, i] for t in range(length))
        assert discounted(episodes, 0.9)[i] == pytest.approx(by_hand)


def test_the_total_variation_is_that_of_the_actions(run):
    """Along the line through the means two Gaussians are one-dimensional: Phi(d / 2) - Phi(-d / 2)."""
    victim = run.victim()
    episodes = play(run, victim, 2, run.opposite(victim))
    true, shown = (torch.from_numpy(x[episodes.mask]) for x in (episodes.obs, episodes.shown))
    distance = ((victim.mean(true) - victim.mean(shown)) / noise_of(victim)).norm(dim=-1).detach().numpy()
    found = total_variations(victim, episodes)
    assert np.allclose(found, norm.cdf(distance / 2) - norm.cdf(-distance / 2), atol=1e-5) and found.max() > 0
    assert not total_variations(victim, play(run, victim, 2)).any()


def test_both_sides_are_known_for_a_denoiser_that_does_nothing(run):
    """The largest error is the distance to a corner of the box, and the value lost is that of the bare victim."""
    victim, detector = run.victim(), Detector(make_gruvae(), 0.0)
    clean, bare = play(run, victim, 4), play(run, victim, 4, run.opposite(victim))
    found = both_sides(run, nothing(), detector, clean)
    corner = run.task.epsilon * 11**0.5
    assert 0.97 * corner < found["median"] <= found["error"] < 1.0001 * corner
    assert np.allclose(found["lost"], discounted(clean) - discounted(bare), atol=1e-3)
    assert found["tv"] == pytest.approx(total_variations(victim, bare).median().item(), abs=1e-4)
    assert found["mae"] == pytest.approx(np.abs(bare.perturbed - bare.obs)[bare.mask].mean(), rel=1e-3)


def test_a_killed_stage_resumes_at_the_next_epoch(run, tmp_path, monkeypatch):
    defense_stages.collect(run, "diverse")
    defense_stages.augment(run, "diverse", ["adversarial"])
    measure, seen = both_sides, []

    def killed(*arguments):
        seen.append(1)
        if len(seen) == 2:
            raise KeyboardInterrupt
        return measure(*arguments)

    monkeypatch.setattr(bound_along_training, "both_sides", killed)
    with pytest.raises(KeyboardInterrupt):
        main(["curve", "--root", str(tmp_path)])
    main(["curve", "--root", str(tmp_path)])
    assert len(seen) == 3  # the first epoch is not measured again, and the second is
    record = manifest.read_json(run.folder / "curve.json", tmp_path)
    assert record["variant"] == "residual" and len(record["epochs"]) == run.scale.defense.epochs
    # The repeated training gives the stored denoiser, which is measured after the last epoch.
    defense_stages.train_denoiser(run, "residual")
    model = models.load_model("hopper", "td3", "denoiser-residual", tmp_path)[0]
    clean = play(run, run.victim(), record["seeds"][1])
    found = measure(run, model, run.defense("residual").detector, clean)
    assert all(record["epochs"][-1][name] == pytest.approx(value) for name, value in found.items())
    main(["curve", "--root", str(tmp_path)])
    assert len(seen) == 3

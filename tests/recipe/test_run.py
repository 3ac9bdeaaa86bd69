import torch

from detden_lite.recipe.run import Run
from detden_lite.store import manifest, models
from detden_lite.victims.victim import Victim


def a_victim(seed: int) -> Victim:
    torch.manual_seed(seed)
    return Victim([11, 16, 3], [14, 16, 1])


def test_a_new_victim_removes_only_what_the_last_led_to(tmp_path):
    run = Run.of(tmp_path, "hopper", "td3", "tiny")
    run.forget_others(a_victim(0))  # there was none before
    models.save_victim("hopper", "td3", a_victim(0), {}, tmp_path)
    made = [
        "hopper-td3/timing.json",
        "hopper-td3/normal-plain/00000.json",
        "hopper-td3/checkpoints/denoiser-printed.ckpt",
        "hopper-td3/checkpoints/adversary-0/recipe.json",
        "hopper-td3/checkpoints/linear/recipe.json",
        "hopper-td3/adversary.json",
    ]
    made += ["results/hopper-td3.none.always.none.json", "results/hopper-td3.done"]
    kept = ["hopper-td3/checkpoints/victim-0/recipe.json", "results/hopper-ppo.none.always.none.json"]
    kept += ["walker2d-td3/timing.json"]
    for name in made + kept:
        manifest.write_json(tmp_path / name, {}, tmp_path)
    run.forget_others(a_victim(0))
    assert all((tmp_path / name).exists() for name in made + kept)
    (tmp_path / "hopper-td3" / "victim.safetensors").unlink()  # as Snakemake does before it runs select again
    run.forget_others(a_victim(1))
    assert not [name for name in made if (tmp_path / name).exists()]
    assert all((tmp_path / name).exists() for name in kept)

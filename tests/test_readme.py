"""What the README promises of one's own policy runs as it is printed, with smaller numbers."""

import re
from pathlib import Path

import numpy as np
from stable_baselines3 import TD3

from detden_lite import attacks, budget, defense, metrics, rollout, tasks, victims
from detden_lite.defense import augmentation, detector, training

README = Path(__file__).parents[1] / "README.md"


def test_the_ten_lines_defend_a_policy_of_ones_own():
    (code,) = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    for large, small in (("range(1_000)", "range(6)"), ("1_000, 1_100", "6, 9"), ("2_000, 2_100", "20, 23")):
        assert large in code
        code = code.replace(large, small)
    code = code.replace("VAERecipe(", "VAERecipe(epochs=1, hidden=8, latent=4, ")
    names = {}
    for module in (attacks, budget, defense, metrics, rollout, tasks, victims, augmentation, detector, training):
        names |= vars(module)
    names["model"] = TD3("MlpPolicy", "Hopper-v5", policy_kwargs=dict(net_arch=[16]), seed=0)
    exec(code, names)
    assert np.isfinite(names["threshold"]) and names["defense"].detector.threshold == names["threshold"]

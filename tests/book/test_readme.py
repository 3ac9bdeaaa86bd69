"""What the README promises of one's own policy runs as it is printed, with smaller numbers."""

import re
from pathlib import Path

import numpy as np
import torch
from stable_baselines3 import TD3

README = Path(__file__).parents[2] / "README.md"


def test_the_lines_of_the_readme_defend_a_policy_of_ones_own(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    code = "".join(re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL))
    for large, small in (('scale="lite"', 'scale="tiny"'), ("range(100)", "range(3)")):
        assert code.count(large) == 1
        code = code.replace(large, small)
    model = TD3("MlpPolicy", "Hopper-v5", policy_kwargs=dict(net_arch=[16]), seed=0, buffer_size=10)
    names = dict(model=model, obs=np.zeros(11))
    exec(code, names)
    shown = names["defended"].verdict.obs
    assert np.allclose(names["action"], model.predict(shown[0].numpy())[0], atol=1e-5)
    assert torch.isfinite(shown).all() and (tmp_path / "defended" / "hopper-td3" / "defend.json").exists()
    assert len(capsys.readouterr().out.splitlines()) == 2

"""The defender's side: detector, denoiser and pipeline (section 3.1), their training, baselines and oracles.

Nothing here needs a simulator: a robot that carries a defence has no MuJoCo.
"""

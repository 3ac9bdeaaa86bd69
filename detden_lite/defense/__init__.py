"""The defender's side: detector, denoisers and pipeline (section 3.1), baselines and oracles.

Nothing here needs a simulator: a robot that carries a defence has no MuJoCo.
"""

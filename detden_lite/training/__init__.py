"""How victims and adversaries are trained: hyperparameters, the worlds they learn in, checkpoints, selection.

Only this room needs stable-baselines3 and sbx-rl.
"""

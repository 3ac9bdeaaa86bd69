"""How victims and adversaries are trained: hyperparameters, worlds to learn in, checkpoints.

Only this room needs stable-baselines3 and sbx-rl.
"""

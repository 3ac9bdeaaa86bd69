"""detden_lite: detect-and-denoise defences of deep reinforcement-learning policies, small enough to read."""

__version__ = "0.1.0"

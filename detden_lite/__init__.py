"""Detect-and-denoise defences of deep reinforcement-learning policies (Xiong et al., ECML-PKDD 2022)."""


def __getattr__(name: str):
    """``detden_lite.defend`` and what belongs to it, loaded when they are asked for: they bring the whole library."""
    if name == "defend":
        from detden_lite.own import defend

        return defend
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

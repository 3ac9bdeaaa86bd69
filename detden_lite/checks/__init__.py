"""The checks of exercises, one module a chapter: a ``check_*`` raises an AssertionError that says what differs.

Example:
    >>> from detden_lite.checks.attacks import check_vulnerable
    >>> check_vulnerable(lambda policy, q, obs, c_vul: q(obs, policy(obs)) < c_vul)
    Right. The attacker needs the policy, its critic and one threshold.
"""

"""The attacker's side (sections 3.2 and 4.4): one attack a module, timings, adversaries and the world they learn in.

Only the attacks that know the defence (``informed``, ``outcome``, ``adaptive``, ``printed``) import from
``detden_lite.defense``.
"""

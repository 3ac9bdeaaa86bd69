"""The attacker's side (sections 3.2 and 4.4): one attack a module, timings, and the list of all.

Only the attacks that know the defence (``informed``, ``adaptive``, ``printed``) import from
``detden_lite.defense``.
"""

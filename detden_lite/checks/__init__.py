"""The checks of exercises, one module a chapter: a ``check_*`` raises an AssertionError that says what differs."""

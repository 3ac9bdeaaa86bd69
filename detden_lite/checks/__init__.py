"""What exercises are checked with, one module a chapter: each ``check_*`` is silent or raises an AssertionError that says what differs."""

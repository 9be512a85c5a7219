"""Helpers that know nothing of road networks."""

import time

LOADED = time.time_ns()
"""When this process loaded the package, whose rooms all load this one first, in nanoseconds since 1970."""

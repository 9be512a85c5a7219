"""Helpers that know nothing of road networks."""

import time

LOADED = time.time_ns()
"""When this process loaded the package, in nanoseconds since 1970.

Every room of the package loads this room first.
"""

"""Studies of the package, in rooms. Run one from a checkout: `python -m experiments.ROOM.NAME`."""

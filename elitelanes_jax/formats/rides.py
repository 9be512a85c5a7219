"""Rides on a map in a JSON file: poses that `elitelanes drive` records and `elitelanes explore` plays."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.checks import check_named, is_real, is_whole
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.files import MIB, parse_json, read_text
from elitelanes_jax._util.types import Plain
from elitelanes_jax.network.checks import check_grid

RIDES = "elitelanes rides, version 1"
"""The file's entry ``format``."""

MOST_POSES = 2_000_000
"""The limit of all poses in a file, 18 hours, so that it also has room for a map of 1024 x 1024 tiles."""


class RecordedRide(NamedTuple):
    """A ride, 30 poses per second."""

    goal: tuple[int, int]  # row and column
    success: bool  # whether it was reached
    poses: NDArray[np.float32]  # [3, T], tiles east, tiles south, radians counter-clockwise from east


def read_rides(file: str | Path) -> tuple[NDArray[np.int8], list[RecordedRide]] | None:
    """Returns the map and the rides of a file; None for another kind of file.

    Raises:
      InputError: for a damaged file of rides; the message names the file.
    """
    try:
        text = read_text(file, 64 * MIB)
        values = parse_json(text) if RIDES in text else None
    except (OSError, ValueError, RecursionError):
        return None  # the next reader of the file reports its errors
    if not isinstance(values, dict) or values.get("format") != RIDES:
        return None
    return check_named(str(file), _rides, values.get("codes"), values.get("rides"))


def _rides(codes: Plain, rides: Plain) -> tuple[NDArray[np.int8], list[RecordedRide]]:
    grid = np.array(check_grid(codes))
    if not isinstance(rides, list):
        raise InputError("rides: expected a list")
    return grid, [_ride(ride) for ride in rides]


def _ride(values: Plain) -> RecordedRide:
    if not isinstance(values, dict):
        raise InputError("rides: expected tables of goal, success, x, y and theta")
    goal, tracks = values.get("goal"), [values.get(name) for name in ("x", "y", "theta")]
    lists = [track for track in tracks if isinstance(track, list) and track and all(map(_is_near, track))]
    if len(lists) < 3 or len({len(track) for track in lists}) > 1:
        raise InputError("rides: expected numbers x, y and theta up to 1e6, as many of each")
    if not isinstance(goal, list) or len(goal) != 2 or not all(map(is_whole, goal)):
        raise InputError("rides: expected a goal of two whole numbers, row and column")
    return RecordedRide((goal[0], goal[1]), values.get("success") is True, np.array(lists, np.float32))


def _is_near(value: Plain) -> bool:
    return is_real(value) and abs(value) <= 1e6

"""Maps for a floor: signs and lights stand on it, and a tile more would not."""

import numpy as np
import pytest
from refusals import refused

from elitelanes_jax import InputError, rotate
from elitelanes_jax.maps import floor_size, furnish
from elitelanes_jax.maps.furnishing.floors import floor_margin
from elitelanes_jax.maps.furnishing.space import outline_of

TILE = 0.585


@pytest.mark.parametrize("quarter_turns", range(4))
def test_what_furnish_places_is_within_the_margin_and_touches_it(quarter_turns):
    """Crossings at two borders, with stop signs or lights at corners that the seeds choose."""
    codes = rotate([[6, 5, 7, 5, 3], [10, 0, 10, 0, 10], [12, 5, 13, 5, 9]], quarter_turns)
    height, width = np.shape(codes)
    farthest = 0.0
    for seed in range(8):
        for thing in furnish(codes, f"all signs street_names lights={seed % 2}", seed=seed).objects:
            for x, y in outline_of(thing):
                farthest = max(farthest, -x, -y, x - width, y - height)
    assert farthest * TILE == pytest.approx(floor_margin(), abs=1e-6)


def test_a_floor_has_the_largest_map():
    assert floor_size(4, 3) == (4, 6)
    margin = floor_margin()
    for rows, columns in ((2, 2), (3, 7), (12, 5)):
        depth, width = rows * TILE + 2 * margin, columns * TILE + 2 * margin
        assert floor_size(width, depth) == (rows, columns)
        assert floor_size(width + TILE - 1e-4, depth) == (rows, columns)
        if min(rows, columns) > 2:
            assert floor_size(width - 1e-4, depth - 1e-4) == (rows - 1, columns - 1)


@pytest.mark.parametrize("width", [0, -1, "wide", float("nan"), 601])
def test_other_floors_are_refused(width):
    with refused("width", repr(width)):
        floor_size(width, 3)


def test_a_floor_that_is_too_small_is_refused():
    with refused("floor", "1.2 x 3 m", expected="1.592 x 1.592"):
        floor_size(1.2, 3)


def test_the_least_floor_that_a_message_names_is_large_enough():
    with pytest.raises(InputError) as caught:
        floor_size(1.59, 1.59)
    least = float(str(caught.value).split()[4])
    assert floor_size(least, least) == (2, 2)

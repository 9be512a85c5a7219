"""The experiment on photographs of tiles: where its camera says that tiles are, and that it runs."""

import numpy as np
import pytest

from elitelanes_jax.tiles import load_tiles
from elitelanes_jax.tiles.tileset import default_tiles
from experiments.perception.cutting import main
from experiments.perception.synthetic_photographs import FLOORS, photograph


def test_pixels_of_a_photograph_are_those_of_its_tiles():
    rng = np.random.default_rng(3)
    seen = photograph(rng, np.array([[15, 0]], np.int8), load_tiles(), "light lino", fill=(0.6, 0.8))
    places = rng.uniform(0, [2, 1], (50, 2))
    np.testing.assert_allclose(seen.tiles_of(seen.pixels_of(places)), places, atol=1e-6)
    # Just inside the tile's west side is white tape or asphalt, outside of it the floor of the room.
    y = np.linspace(0.2, 0.8, 7)
    inside, outside = (seen.pixels_of(np.stack([np.full(7, x), y], axis=1)).round().astype(int) for x in (0.2, -0.05))
    brightness = [seen.image[pixels[:, 1], pixels[:, 0]].mean() for pixels in (inside, outside)]
    assert brightness[0] < 0.7 * brightness[1]


@pytest.mark.slow
def test_photographs_are_cut_and_measured(tmp_path):
    assert main(["--count", "1", "--tiles", str(default_tiles()), "--out", str(tmp_path)]) == 0
    for kind in ("floors", "tiles"):
        lines = (tmp_path / f"{kind}.md").read_text().splitlines()
        floor, total = (line.split("|")[2:] for line in lines[2:])
        assert lines[2].startswith(f"| {next(iter(FLOORS))} |") and floor == total
        assert [cell.strip() for cell in total[:4]] == ["1", "100.0%", "0.0%", "0"]

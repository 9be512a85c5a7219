"""Maps of other generators: networks become the tiles that lie along their roads."""

import sys

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from elitelanes_jax import InputError
from elitelanes_jax.formats import tile_graph, to_duckietown
from elitelanes_jax.network import plain_measure
from experiments.realism.references import netgenerate_grid, netgenerate_rand, rasterised, use_map_utils
from experiments.realism.study import SIZES, shares

RING = [[6, 3], [12, 9]]


@settings(max_examples=30)
@given(st.data(), st.integers(1, 3), st.integers(1, 3))
def test_tiles_lie_along_the_roads_and_nowhere_else(data, down, right):
    streets = sorted(nx.grid_2d_graph(3, 4).edges)
    chosen = data.draw(st.lists(st.sampled_from(streets), min_size=1, unique=True))
    both = [
        (str(pair[way]), str(pair[1 - way])) for pair in chosen for way in data.draw(st.sampled_from([[0], [0, 1]]))
    ]
    junctions = sorted({end for pair in chosen for end in pair})
    top, left = (min(end[axis] for end in junctions) for axis in (0, 1))
    places = {str((row, column)): (7.5 * right * column - 3, 90 - 7.5 * down * row) for row, column in junctions}
    codes = rasterised(places, both, 7.5)

    expected = nx.Graph()
    for (row, column), (other_row, other_column) in chosen:
        first = np.multiply((row - top, column - left), (down, right))
        last = np.multiply((other_row - top, other_column - left), (down, right))
        count = np.abs(last - first).sum()
        nx.add_path(expected, [tuple((first + (last - first) * step // count).tolist()) for step in range(count + 1)])
    made = tile_graph(codes)
    assert nx.utils.graphs_equal(nx.Graph(made.edges), nx.Graph(expected.edges))
    assert plain_measure(codes)["mismatches"] == 0 and np.count_nonzero(codes) == len(expected)


@pytest.mark.parametrize(("x", "y", "message"), [(0.5, 1, "junctions on a lattice of 1 m"), (1, 1, "roads along rows")])
def test_what_is_no_map_of_tiles_is_refused(x, y, message):
    with pytest.raises(InputError, match=message):
        rasterised({"a": (0, 0), "b": (x, y)}, [("a", "b")], 1)


def test_each_of_peoples_maps_gets_its_part():
    parts = shares(200)
    assert sum(parts.values()) == 200 and set(parts) == set(SIZES)
    assert all(abs(part - 200 * SIZES.count(size) / 18) < 1 for size, part in parts.items())


def test_what_is_missing_is_named(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "sumo", None)
    with pytest.raises(InputError, match=r"^netgenerate needs eclipse-sumo: pip install eclipse-sumo$"):
        netgenerate_grid({(3, 3): 1})
    for folder in (None, tmp_path):
        with pytest.raises(InputError, match=r"map-utils: expected a folder with its generator.py, got "):
            use_map_utils(folder)


def test_map_utils_is_run_for_each_map_with_a_seed_of_its_own(tmp_path):
    program = tmp_path / "generator.py"
    text = to_duckietown(RING)
    program.write_text(
        "import random, sys\nfrom pathlib import Path\n"
        f"Path('output.yaml').write_text({text!r})\n"
        f"Path({str(tmp_path)!r}, 'log').open('a').write(f'{{random.random()}} {{sys.argv[1:]}}\\n')\n"
    )
    make = use_map_utils(tmp_path)
    made = make({(3, 5): 2})
    assert [grid.tolist() for grid in made] == [RING, RING]
    make({(3, 5): 1})
    first, second, again = (tmp_path / "log").read_text().splitlines()
    assert first != second and first == again
    assert first.endswith("['--height', '3', '--width', '5', '--no-border']")
    program.write_text("raise SystemExit('no luck')")
    with pytest.raises(InputError, match="map-utils: expected a map, got: no luck"):
        make({(3, 5): 1})


@pytest.mark.slow
def test_netgenerates_networks_are_maps():
    pytest.importorskip("sumo", reason="SUMO is not here: make sumo")
    parts = {(3, 3): 1, (5, 9): 6, (10, 19): 3}
    for size, grid in zip([(3, 3)] + 6 * [(5, 9)] + 3 * [(10, 19)], netgenerate_grid(parts), strict=True):
        assert grid.shape == size and 0 not in grid[[0, -1]] and 0 not in grid[:, [0, -1]]
    made = netgenerate_rand(parts, networks=40)
    assert len(made) == 10 and all(grid.any() for grid in made)
    for grid in made:
        metrics = plain_measure(grid)
        assert not any(
            metrics[name] for name in ("dead_ends", "mismatches", "crowded_crossings", "unlinked_neighbours")
        )
        assert metrics["components"] == 1

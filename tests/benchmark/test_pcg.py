"""Road networks in the PCG Benchmark: quality, diversity and control are what they are said to be."""

import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused

from elitelanes_jax import mirror, rotate
from elitelanes_jax.benchmark import find_task
from elitelanes_jax.benchmark.interop import (
    VARIANTS,
    RoadNetworks,
    Variant,
    draw_roads,
    read_links,
    register_pcg_problems,
)
from elitelanes_jax.benchmark.measuring import measure_grids
from elitelanes_jax.network.plain_metrics import plain_measure

EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "pcg_roads.py"

each_variant = pytest.mark.parametrize("variant", VARIANTS.values(), ids=VARIANTS)


def links_of(codes):
    """Returns the links of a network, cell by cell, with random ones beyond its right and lower sides."""
    links = np.random.default_rng(0).integers(4, size=codes.shape)
    height, width = codes.shape
    for row, column in np.ndindex(codes.shape):
        right, down = codes[row, column] & 4 > 0, codes[row, column] & 2 > 0
        beyond_right, beyond_down = links[row, column] & 2, links[row, column] & 1
        links[row, column] = (2 * right if column < width - 1 else beyond_right) + (
            down if row < height - 1 else beyond_down
        )
    return links


def content_of(codes, variant):
    """Returns the content that describes a network."""
    return (links_of(codes) if variant.has_links else codes).tolist()


@each_variant
def test_certified_networks_pass_and_random_ones_have_partial_quality(variant):
    roads, task = RoadNetworks(variant), find_task(f"{variant.size}-10000")
    for witness, cyclomatic in zip(task.witnesses, task.cyclomatic, strict=True):
        info = roads.info(content_of(witness, variant))
        assert roads.quality(info) == roads.controlability(info, {"cyclomatic": cyclomatic}) == 1
        for other in set(task.cyclomatic) - {cyclomatic}:
            assert 0 < roads.controlability(info, {"cyclomatic": np.int64(other)}) < 1
    random = np.random.default_rng(1).integers(4 if variant.has_links else 16, size=(5, *task.shape))
    codes = np.stack([read_links(grid) for grid in random]) if variant.has_links else random
    flaws = measure_grids(task, codes).flaws
    assert (flaws > 0).all()
    cells = task.shape[0] * task.shape[1]
    assert [roads.quality(roads.info(grid)) for grid in random] == pytest.approx((cells / (cells + flaws)).tolist())


@each_variant
def test_content_without_roads_has_no_quality(variant):
    roads = RoadNetworks(variant)
    assert roads.quality(roads.info(np.zeros(roads.shape, int))) == 0


@each_variant
def test_every_value_of_the_control_has_a_network(variant):
    low, high = RoadNetworks(variant).cyclomatic
    assert list(range(low, high + 1)) == find_task(f"{variant.size}-10000").cyclomatic.tolist()


@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.integers(1, 6))
def test_links_describe_each_network_without_mismatches_once(seed, height, width):
    links = np.random.default_rng(seed).integers(4, size=(height, width)).astype(np.int8)
    codes = read_links(links)
    metrics = plain_measure(codes)
    assert metrics["mismatches"] == metrics["boundary_violations"] == 0
    np.testing.assert_array_equal(read_links(links_of(codes).astype(np.int8)), codes)
    # The links that are read are those of the content, and no others.
    inside = links & 2
    inside[:, -1] = 0
    below = links & 1
    below[-1] = 0
    assert metrics["edges"] == np.count_nonzero(inside) + np.count_nonzero(below)


def test_a_network_does_not_differ_from_its_images_elsewhere():
    roads = RoadNetworks(Variant("7x7B"))
    town = np.zeros((7, 7), int)
    town[1:4, 2:5] = [[6, 5, 3], [10, 0, 10], [12, 5, 9]]
    town[2, 3:6] = [0, 14, 5]
    moved = np.roll(town, (2, 1), axis=(0, 1))
    for image in (town, moved, rotate(town), mirror(rotate(moved, 3))):
        for one, other in ((town, image), (image, town)):
            assert roads.diversity(roads.info(one), roads.info(other)) == 0
    witnesses = [roads.info(grid) for grid in find_task("7x7B-10000").witnesses]
    between = np.array([[roads.diversity(one, other) for other in witnesses] for one in witnesses])
    np.testing.assert_array_equal(between, between.T)
    assert (np.diag(between) == 0).all() and between.max() == 1


def test_other_contents_are_refused():
    roads = RoadNetworks(Variant("7x7B"))
    # In int8, 258 would be code 2.
    with refused("grid", "258 at A1 ([0, 0])"):
        roads.info(np.full((7, 7), 258))
    with refused("content", "[3, 3]", expected="tile"):
        roads.info(np.zeros((3, 3), int))
    of_links = RoadNetworks(Variant("7x7B", has_links=True))
    with refused("content", "4 at A1 ([0, 0])"):
        of_links.info(np.full((7, 7), 4))
    with refused("content", "[3, 3]", expected="links"):
        of_links.info(np.zeros((3, 3), int))


def test_pictures_show_each_open_side():
    codes = np.arange(16).reshape(4, 4)
    picture = draw_roads(codes)
    assert picture.shape == (64, 64, 3) and picture.dtype == np.uint8
    road = (picture == picture[24, 56]).all(axis=-1).reshape(4, 16, 4, 16).swapaxes(1, 2)  # the middle of code 7
    ends = {8: road[:, :, 0, 8], 4: road[:, :, 8, 15], 2: road[:, :, 15, 8], 1: road[:, :, 8, 0]}
    for side, shown in ends.items():
        np.testing.assert_array_equal(shown, codes & side > 0)


def test_the_example_of_the_page_runs(tmp_path, monkeypatch, capsys):
    pytest.importorskip("pcg_benchmark")
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(EXAMPLE))
    passed, best = map(float, capsys.readouterr().out.split())
    assert passed == 0 and 0.1 < best < 1
    assert (tmp_path / "pcg-roads.png").read_bytes()[:4] == b"\x89PNG"


def test_the_pcg_benchmark_makes_evaluates_and_draws_them():
    """Its own test of a problem, `test.py`, with values that are checked."""
    benchmark = pytest.importorskip("pcg_benchmark")
    names = register_pcg_problems()
    assert register_pcg_problems() == names and set(names) <= set(benchmark.list())
    for name in names:
        env = benchmark.make(name)
        env.seed(3)
        contents = [env.content_space.sample() for _ in range(20)]
        controls = [env.control_space.sample() for _ in range(20)]
        passed, different, controlled, details, infos = env.evaluate(contents, controls)
        assert passed == 0 and different == 1 and 0 <= controlled < 1
        assert all(len(values) == len(infos) == 20 for values in details.values())
        assert all(0 <= value <= 1 for values in details.values() for value in values)
        again = env.evaluate(env.content_space.sample(), env.control_space.sample())
        assert 0 < again[3]["quality"] < 1
        task = find_task(f"{VARIANTS[name].size}-10000")
        contents = [content_of(witness, VARIANTS[name]) for witness in task.witnesses]
        passed, _, controlled, *_ = env.evaluate(contents, [{"cyclomatic": int(number)} for number in task.cyclomatic])
        assert passed == controlled == 1
        height, width = task.shape
        assert env.render(contents[0]).size == (16 * width, 16 * height)
        flat = env.content_space.restructure(env.content_space.sampleFlat())
        assert env.content_space.isSampled(flat)


def test_generators_of_the_benchmark_run_and_continue(tmp_path, capsys):
    pytest.importorskip("pcg_benchmark")
    pytest.importorskip("generators")
    from experiments.search.pcg import main

    command = ["--problems", "roads-links-5x5-v0", "--generators", "random", "es", "--out", str(tmp_path), "--seeds"]
    assert main([*command, "3"]) == 0
    rows = sorted((tmp_path / "rows").iterdir())
    texts = [row.read_text() for row in rows]
    assert len(set(texts)) > 2
    assert main([*command, "4"]) == 0
    assert [row.read_text() for row in rows] == texts
    assert len(list((tmp_path / "rows").iterdir())) == 8
    lines = (tmp_path / "pcg.md").read_text().splitlines()
    assert "| roads-links-5x5-v0 | random search | 4 | 0 | 0.00 (0.00 to 0.49) |" in lines[4]
    assert main(["--problems", "roads"]) == 2
    assert "--problems: expected some of roads-links-5x5-v0" in capsys.readouterr().err


def test_a_missing_benchmark_is_named(tmp_path, monkeypatch, capsys):
    from experiments.search.pcg import main

    monkeypatch.setitem(sys.modules, "pcg_benchmark", None)
    assert main(["--seeds", "1", "--out", str(tmp_path)]) == 2
    assert "pcg_benchmark" in capsys.readouterr().err

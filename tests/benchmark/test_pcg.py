"""Road networks in the PCG Benchmark: quality, diversity and control are what they are said to be."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from elitelanes_jax import InputError, mirror, rotate
from elitelanes_jax.benchmark import find_task
from elitelanes_jax.benchmark.interop import VARIANTS, RoadNetworks, draw_roads, register_pcg_problems
from elitelanes_jax.benchmark.measuring import measure_grids

EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "pcg_roads.py"

each_size = pytest.mark.parametrize("size", VARIANTS.values())


@each_size
def test_certified_networks_pass_and_random_ones_have_partial_quality(size):
    roads, task = RoadNetworks(size), find_task(f"{size}-10000")
    for witness, cyclomatic in zip(task.witnesses, task.cyclomatic, strict=True):
        info = roads.info(witness.tolist())
        assert roads.quality(info) == roads.controlability(info, {"cyclomatic": cyclomatic}) == 1
        for other in set(task.cyclomatic) - {cyclomatic}:
            assert 0 < roads.controlability(info, {"cyclomatic": np.int64(other)}) < 1
    random = np.random.default_rng(1).integers(16, size=(5, *task.shape))
    flaws = measure_grids(random, fill=task.fill).flaws
    assert (flaws > 0).all()
    assert [roads.quality(roads.info(grid)) for grid in random] == pytest.approx((1 / (1 + flaws)).tolist())


@each_size
def test_every_value_of_the_control_has_a_network(size):
    low, high = RoadNetworks(size).cyclomatic
    assert list(range(low, high + 1)) == find_task(f"{size}-10000").cyclomatic.tolist()


def test_a_network_does_not_differ_from_its_images_elsewhere():
    roads = RoadNetworks("7x7B")
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
    roads = RoadNetworks("7x7B")
    # In int8, 258 would be code 2.
    with pytest.raises(InputError, match="^grid: expected tile codes 0 to 15, got 258 at A1 "):
        roads.info(np.full((7, 7), 258))
    with pytest.raises(InputError, match=r"^content: expected 7 x 7 tile codes, got \[3, 3\]"):
        roads.info(np.zeros((3, 3), int))


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
    assert capsys.readouterr().out.startswith("0.0 0.0")
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
        task = find_task(f"{VARIANTS[name]}-10000")
        passed, _, controlled, *_ = env.evaluate(
            task.witnesses.tolist(), [{"cyclomatic": int(number)} for number in task.cyclomatic]
        )
        assert passed == controlled == 1
        height, width = task.shape
        assert env.render(contents[0]).size == (16 * width, 16 * height)
        flat = env.content_space.restructure(env.content_space.sampleFlat())
        assert env.content_space.isSampled(flat)

"""Records: each is checked when it is made, whatever it is of; those of JAX are pytrees."""

import re
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from elitelanes_jax import DatasetSpec, GenerateSpec, InputError, SearchSpec, load_tiles
from elitelanes_jax.drive import Camera, LaneDriveParams, RoadNavParams, make_levels, make_sight
from elitelanes_jax.drive.robot import Robot
from elitelanes_jax.formats.streets import Streets
from elitelanes_jax.optimizers import (
    AnnealedGwoConfig,
    AnnealedMapElitesConfig,
    AnnealedPsoConfig,
    AnnealingConfig,
    EvolutionConfig,
    GwoConfig,
    MapElitesConfig,
    Move,
    MoveWeights,
    PsoConfig,
)
from elitelanes_jax.optimizers._moves import KNOWN_MOVES

NO_MOVES = dict.fromkeys((*KNOWN_MOVES, "fill_probability"), 0)


@cache
def levels():
    return make_levels(jax.random.key(0), np.array([[[6, 3], [12, 9]]], np.int8))


def level():
    return jax.tree.map(lambda part: part[0], levels())


def sight():
    return make_sight(load_tiles(), Camera(rows=4, columns=4), tile_px=16)


@pytest.mark.usefixtures("any_types")
@pytest.mark.parametrize(
    ("kind", "wrong", "message"),
    [
        (EvolutionConfig, {"population": 0}, "population: expected a whole number, 1 or more, got 0"),
        (EvolutionConfig, {"offspring": 2.0}, "offspring: expected a whole number, 1 or more, got 2.0"),
        (EvolutionConfig, {"tournament": -1}, "tournament: expected"),
        (EvolutionConfig, {"survivors": "best"}, "survivors: expected one of plus, comma, got 'best'"),
        (EvolutionConfig, {"survivors": "comma", "offspring": 10}, "offspring: expected .* population, 20, .* got 10"),
        (EvolutionConfig, {"tile_rate": 1.5}, "tile_rate: expected a number, 0 to 1, got 1.5"),
        (EvolutionConfig, {"crossing_rate": "often"}, "crossing_rate: expected a number, 0 to 1, got 'often'"),
        (EvolutionConfig, {"crossing_rate": float("nan")}, "crossing_rate: expected a number"),
        (MapElitesConfig, {"parents": "none"}, "parents: expected one of population, archive, got 'none'"),
        (MapElitesConfig, {"loop": 3}, "loop: expected EvolutionConfig, got 3"),
        (PsoConfig, {"particles": 0}, "particles: expected a whole number, 1 or more, got 0"),
        (PsoConfig, {"inertia": -1}, "inertia: expected a number, 0 to 3, got -1"),
        (PsoConfig, {"social": 4}, "social: expected a number, 0 to 3, got 4"),
        (PsoConfig, {"fastest": "fast"}, "fastest: expected a number, 0 to 16, got 'fast'"),
        (GwoConfig, {"wolves": True}, "wolves: expected a whole number, 2 or more, got True"),
        (GwoConfig, {"horizon": 0}, "horizon: expected a whole number, 1 to 32767, got 0"),
        (GwoConfig, {"horizon": 2**15}, "horizon: expected a whole number, 1 to 32767, got 32768"),
        (GwoConfig, {"omega": "best"}, "omega: expected one of own, worst, got 'best'"),
        (GwoConfig, {"perturbation": 20}, "perturbation: expected a number, 0 to 16, got 20"),
        (AnnealingConfig, {"population": 0}, "population: expected a whole number, 1 or more, got 0"),
        (AnnealingConfig, {"population": 10}, "population: expected a multiple of the 4 chains of an island, got 10"),
        (AnnealingConfig, {"coldest": 90}, "coldest: expected at most the hottest, 60, got 90"),
        (AnnealingConfig, {"cycle": 0}, "cycle: expected a whole number, 1 or more, got 0"),
        (AnnealedPsoConfig, {"cognitive": 0.7, "social": 0.7}, r"social: expected cognitive \+ social to be at most 1"),
        (AnnealedGwoConfig, {"leaders": 0}, "leaders: expected a whole number, 1 or more, got 0"),
        (
            AnnealedMapElitesConfig,
            {"restart_length": 2**22 + 1},
            "restart_length: expected a whole number, 1 to 4194304, got 4194305",
        ),
        (AnnealedMapElitesConfig, {"restart": 2}, "restart: expected a number, 0 to 1, got 2"),
        (AnnealedMapElitesConfig, {"bin_penalty": 10**6}, "bin_penalty: expected a whole number, 1 to 10000"),
        (AnnealedMapElitesConfig, {"annealing": jnp.zeros(3)}, "annealing: expected AnnealingConfig, got Array"),
        (MoveWeights, {"link": -1}, "link: expected a whole number, 0 or more, got -1"),
        (MoveWeights, {"fill_probability": 2}, "fill_probability: expected a number, 0 to 1, got 2"),
        (MoveWeights, NO_MOVES, "link: expected a weight over 0 for at least one move, got none"),
        (
            MoveWeights,
            {"link": 2**30, "corner": 1},
            "link: .* that add up to at most 1073741824, got",
        ),
        (Robot, {"dt": -1}, "dt: expected a number over 0, up to 0.1, got -1"),
        (Robot, {"latency": 5}, "latency: expected a number, 0 to 4, got 5"),
        (Camera, {"pitch": 120}, "pitch: expected a number, -90 to 90, got 120"),
        (Camera, {"sky": (1, 2)}, "sky: expected three numbers, 0 to 255"),
        (RoadNavParams, {"levels": np.zeros((2, 2))}, "levels: expected a batch of levels .* got an array"),
        (RoadNavParams, {"levels": level}, "levels: expected a batch of levels .* got one of shape"),
        (RoadNavParams, {"levels": levels, "window": 4}, "window: expected an odd number of tiles, or 0 .* got 4"),
        (RoadNavParams, {"levels": levels, "goal": "smell"}, "goal: expected one of compass, mark, both, none, got"),
        (RoadNavParams, {"levels": levels, "limit": 0}, "limit: expected a whole number, 1 or more, got 0"),
        (RoadNavParams, {"levels": levels, "tile_cost": float("nan")}, "tile_cost: expected a number"),
        (LaneDriveParams, {"levels": levels, "task": "park"}, "task: expected one of route, lane, got 'park'"),
        (LaneDriveParams, {"levels": levels, "observe": "camera"}, "sight: expected a result of make_sight, .* None"),
        (LaneDriveParams, {"levels": levels, "sight": sight}, "observe: expected 'camera', to see .* got 'lane'"),
        (Streets, {"tile_size": 6}, "tile_size: expected more than two lanes, 6.4 m, got 6 m"),
    ],
)
def test_a_record_is_checked_when_it_is_made(kind, wrong, message):
    wrong = {name: value() if callable(value) else value for name, value in wrong.items()}
    with pytest.raises(InputError, match=f"^{message}"):
        kind(**wrong)
    if "levels" not in wrong:
        with pytest.raises(InputError, match=f"^{message}"):
            kind().replace(**wrong)


def test_replaced_fields_are_named():
    for made, wrong, message in (
        (GenerateSpec(), {"mpas": 3}, "mpas: expected one of size, maps, .*; is it maps?"),
        (GwoConfig(), {"wolfs": 3}, "wolfs: expected one of wolves, .*; is it wolves?"),
        (SearchSpec(), {"generations": 3, "evaluations": 9}, "generations: expected none with evaluations=9, got 3$"),
        (DatasetSpec(), {"views": 0}, "views: expected a whole number, 1 or more"),
    ):
        with pytest.raises(InputError, match=f"^{message}"):
            made.replace(**wrong)
    assert GwoConfig().replace() == GwoConfig()
    assert GwoConfig().replace(wolves=3, horizon=np.int64(7)) == GwoConfig(wolves=3, horizon=7)


@pytest.mark.usefixtures("any_types")
def test_numbers_become_plain_and_arrays_pass():
    assert type(EvolutionConfig(tile_rate=1).tile_rate) is float
    assert type(AnnealingConfig(cycle=np.int32(3)).cycle) is int
    rates = jnp.array([0.1, 0.7])
    assert EvolutionConfig(tile_rate=rates).tile_rate is rates


@pytest.mark.usefixtures("any_types")
def test_arrays_are_checked_as_numbers_are_and_tracers_by_their_dtype():
    limits = np.array([0.1], np.float32)
    assert Robot(dt=limits).dt.tolist() == limits.tolist() and float(limits[0]) > 0.1
    wrong = {
        "tile_rate: expected a number, 0 to 1, got 7.0": lambda: EvolutionConfig(tile_rate=jnp.array([0.1, 7.0])),
        "tile_rate: expected a number, 0 to 1, got nan": lambda: EvolutionConfig(tile_rate=np.array([0.1, np.nan])),
        "inertia: expected a number, 0 to 3, got -1.0": lambda: PsoConfig(inertia=np.array([-1.0, 0.5])),
        "tile_rate: expected numbers, got bool [2]": lambda: EvolutionConfig(tile_rate=np.array([True, False])),
        "tile_rate: expected numbers, got complex64 []": lambda: EvolutionConfig(tile_rate=jnp.array(1j)),
        "horizon: expected whole numbers, got float32 [2]": lambda: GwoConfig(horizon=jnp.array([1.5, 2.0])),
        "horizon: expected a whole number, 1 to .*, got -3": lambda: GwoConfig(horizon=jnp.array([4, -3])),
        "cycle: expected a whole number, 1 or more, got 2.0": lambda: AnnealingConfig(cycle=np.array(2.0)),
        "link: expected whole numbers, got float32 [2]": lambda: MoveWeights(link=jnp.ones(2)),
        "user_moves: zigzag: expected whole numbers, got float32 []": lambda: MoveWeights(
            user_moves={"zigzag": (jnp.ones(()), Move(2, lambda bits, grid, mate: grid))}
        ),
        "sky: expected a number, 0 to 255, got 256.0": lambda: Camera(sky=jnp.array([256.0, 0, 0])),
        "ground: expected a number, 0 to 255, got -1.0": lambda: Camera(ground=(jnp.array([-1.0, 9.0]), 0, 0)),
        "distortion: expected a number, -10 to 10, got 11": lambda: Camera(distortion=np.array([0, 11])),
    }
    for message, make in wrong.items():
        with pytest.raises(InputError, match="^" + re.escape(message).replace(r"\.\*", ".*")):
            make()
    sums = jax.vmap(lambda horizon: GwoConfig(horizon=horizon).horizon + 1)(jnp.array([4, -3]))
    assert sums.tolist() == [5, -2], "the numbers of tracers are unknown"
    with pytest.raises(InputError, match=r"^horizon: expected whole numbers, got float32 \[\]"):
        jax.vmap(lambda horizon: GwoConfig(horizon=horizon).horizon)(jnp.ones(2))


@pytest.mark.parametrize("made", [AnnealedMapElitesConfig(), MapElitesConfig(), Camera(), RoadNavParams])
def test_a_pytree_goes_through_transformations(made):
    """Whatever stands in its fields meanwhile: it is not checked again."""
    made = made(levels()) if made is RoadNavParams else made
    leaves, structure = jax.tree.flatten(made)
    back = jax.tree.unflatten(structure, leaves)
    assert type(back) is type(made) and jax.tree.structure(back) == structure
    assert vars(back).keys() == vars(made).keys()
    assert all(one is other for one, other in zip(jax.tree.leaves(back), leaves, strict=True))
    axes = jax.tree.map(lambda _: None, made)
    assert jax.tree.leaves(axes) == []
    assert jax.tree.leaves(jax.tree.map(lambda _: object, made)) == [object] * len(leaves)
    paths = [jax.tree_util.keystr(path) for path, _ in jax.tree_util.tree_leaves_with_path(made)]
    assert all(eval(f"made{path}", {"made": made}) is leaf for path, leaf in zip(paths, leaves, strict=True))


def test_static_fields_choose_the_program_and_traced_ones_do_not():
    traces = []

    @jax.jit
    def doubled(config):
        traces.append(config)
        return 2 * config.tile_rate

    assert doubled(EvolutionConfig(tile_rate=0.25)) == 0.5 and doubled(EvolutionConfig(tile_rate=0.5)) == 1
    assert len(traces) == 1
    doubled(EvolutionConfig(population=3))
    assert len(traces) == 2
    both = jax.vmap(doubled)(EvolutionConfig(tile_rate=jnp.array([0.25, 0.5]), crossing_rate=jnp.zeros(2)))
    np.testing.assert_array_equal(both, [0.5, 1])

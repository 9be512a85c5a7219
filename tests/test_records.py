"""Records: each is checked when it is made, whatever it is of; those of JAX are pytrees."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from refusals import refused

from elitelanes_jax import DatasetSpec, GenerateSpec, SearchSpec, load_tiles
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
    ("kind", "wrong", "subject", "got", "expected"),
    [
        (EvolutionConfig, {"population": 0}, "population", "0", ""),
        (EvolutionConfig, {"offspring": 2.0}, "offspring", "2.0", ""),
        (EvolutionConfig, {"tournament": -1}, "tournament", "-1", ""),
        (EvolutionConfig, {"survivors": "best"}, "survivors", "'best'", ""),
        (EvolutionConfig, {"survivors": "comma", "offspring": 10}, "offspring", "10", "20"),
        (EvolutionConfig, {"tile_rate": 1.5}, "tile_rate", "1.5", ""),
        (EvolutionConfig, {"crossing_rate": "often"}, "crossing_rate", "'often'", ""),
        (EvolutionConfig, {"crossing_rate": float("nan")}, "crossing_rate", "nan", ""),
        (MapElitesConfig, {"parents": "none"}, "parents", "'none'", ""),
        (MapElitesConfig, {"loop": 3}, "loop", "3", ""),
        (PsoConfig, {"particles": 0}, "particles", "0", ""),
        (PsoConfig, {"inertia": -1}, "inertia", "-1", ""),
        (PsoConfig, {"social": 4}, "social", "4", ""),
        (PsoConfig, {"fastest": "fast"}, "fastest", "'fast'", ""),
        (GwoConfig, {"wolves": True}, "wolves", "True", ""),
        (GwoConfig, {"horizon": 0}, "horizon", "0", ""),
        (GwoConfig, {"horizon": 2**15}, "horizon", "32768", ""),
        (GwoConfig, {"omega": "best"}, "omega", "'best'", ""),
        (GwoConfig, {"perturbation": 20}, "perturbation", "20", ""),
        (AnnealingConfig, {"population": 0}, "population", "0", ""),
        (AnnealingConfig, {"population": 10}, "population", "10", "multiple"),
        (AnnealingConfig, {"coldest": 90}, "coldest", "90", "60"),
        (AnnealingConfig, {"cycle": 0}, "cycle", "0", ""),
        (AnnealedPsoConfig, {"cognitive": 0.7, "social": 0.7}, "social", "0.7 + 0.7", "at most 1"),
        (AnnealedGwoConfig, {"leaders": 0}, "leaders", "0", ""),
        (
            AnnealedMapElitesConfig,
            {"restart_length": 2**22 + 1},
            "restart_length",
            "4194305",
            "",
        ),
        (AnnealedMapElitesConfig, {"restart": 2}, "restart", "2", ""),
        (AnnealedMapElitesConfig, {"bin_penalty": 10**6}, "bin_penalty", "1000000", ""),
        (AnnealedMapElitesConfig, {"annealing": jnp.zeros(3)}, "annealing", "Array(...", "AnnealingConfig"),
        (MoveWeights, {"link": -1}, "link", "-1", ""),
        (MoveWeights, {"fill_probability": 2}, "fill_probability", "2", ""),
        (MoveWeights, NO_MOVES, "link", "none", ""),
        (
            MoveWeights,
            {"link": 2**30, "corner": 1},
            "link",
            "1073741858",
            "at most 1073741824",
        ),
        (Robot, {"dt": -1}, "dt", "-1", ""),
        (Robot, {"latency": 5}, "latency", "5", ""),
        (Camera, {"pitch": 120}, "pitch", "120", ""),
        (Camera, {"sky": (1, 2)}, "sky", "(1, 2)", ""),
        (RoadNavParams, {"levels": np.zeros((2, 2))}, "levels", "an array", ""),
        (RoadNavParams, {"levels": level}, "levels", "one of shape (2, 2)", ""),
        (RoadNavParams, {"levels": levels, "window": 4}, "window", "4", ""),
        (RoadNavParams, {"levels": levels, "goal": "smell"}, "goal", "'smell'", ""),
        (RoadNavParams, {"levels": levels, "limit": 0}, "limit", "0", ""),
        (RoadNavParams, {"levels": levels, "tile_cost": float("nan")}, "tile_cost", "nan", ""),
        (LaneDriveParams, {"levels": levels, "task": "park"}, "task", "'park'", ""),
        (LaneDriveParams, {"levels": levels, "observe": "camera"}, "sight", "None", ""),
        (LaneDriveParams, {"levels": levels, "sight": sight}, "observe", "'lane'", ""),
        (Streets, {"tile_size": 6}, "tile_size", "6 m", "6.4"),
    ],
)
def test_a_record_is_checked_when_it_is_made(kind, wrong, subject, got, expected):
    wrong = {name: value() if callable(value) else value for name, value in wrong.items()}
    with refused(subject, got, expected):
        kind(**wrong)
    if "levels" not in wrong:
        with refused(subject, got, expected):
            kind().replace(**wrong)


def test_replaced_fields_are_named():
    for made, wrong, subject, got, hint in (
        (GenerateSpec(), {"mpas": 3}, "mpas", "'mpas'", "maps"),
        (GwoConfig(), {"wolfs": 3}, "wolfs", "'wolfs'", "wolves"),
        (SearchSpec(), {"generations": 3, "evaluations": 9}, "generations", "3", ""),
        (DatasetSpec(), {"views": 0}, "views", "0", ""),
    ):
        with refused(subject, got, hint=hint):
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
    for make, subject, got, expected in (
        (lambda: EvolutionConfig(tile_rate=jnp.array([0.1, 7.0])), "tile_rate", "7.0", "0 to 1"),
        (lambda: EvolutionConfig(tile_rate=np.array([0.1, np.nan])), "tile_rate", "nan", "0 to 1"),
        (lambda: PsoConfig(inertia=np.array([-1.0, 0.5])), "inertia", "-1.0", "0 to 3"),
        (lambda: EvolutionConfig(tile_rate=np.array([True, False])), "tile_rate", "bool [2]", "numbers"),
        (lambda: EvolutionConfig(tile_rate=jnp.array(1j)), "tile_rate", "complex64 []", "numbers"),
        (lambda: GwoConfig(horizon=jnp.array([1.5, 2.0])), "horizon", "float32 [2]", "whole numbers"),
        (lambda: GwoConfig(horizon=jnp.array([4, -3])), "horizon", "-3", "1 to"),
        (lambda: AnnealingConfig(cycle=np.array(2.0)), "cycle", "2.0", "whole number"),
        (lambda: MoveWeights(link=jnp.ones(2)), "link", "float32 [2]", "whole numbers"),
        (
            lambda: MoveWeights(user_moves={"zigzag": (jnp.ones(()), Move(2, lambda bits, grid, mate: grid))}),
            "user_moves: zigzag",
            "float32 []",
            "whole numbers",
        ),
        (lambda: Camera(sky=jnp.array([256.0, 0, 0])), "sky", "256.0", "0 to 255"),
        (lambda: Camera(ground=(jnp.array([-1.0, 9.0]), 0, 0)), "ground", "-1.0", "0 to 255"),
        (lambda: Camera(distortion=np.array([0, 11])), "distortion", "11", "-10 to 10"),
    ):
        with refused(subject, got, expected):
            make()
    sums = jax.vmap(lambda horizon: GwoConfig(horizon=horizon).horizon + 1)(jnp.array([4, -3]))
    assert sums.tolist() == [5, -2], "the numbers of tracers are unknown"
    with refused("horizon", "float32 []"):
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

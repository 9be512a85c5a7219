"""One search on many islands: the same bits on any number of processes."""

import socket
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from elitelanes_jax import InputError, Result, evolve, evolve_islands, road_problem
from elitelanes_jax.optimizers import PRESETS, make_optimizer
from elitelanes_jax.problem.archive import VACANT

SHAPE = (5, 6)
SMALL = {"preset": "standard", "generations": 23, "progress": False}

PROGRAM = """
import sys

import jax

address, count, number, islands, preset, out = sys.argv[1:]
jax.distributed.initialize(address, int(count), int(number))

from elitelanes_jax.search._islands import evolve_islands

small = {"preset": preset, "generations": 23, "progress": False}
evolve_islands(7, (5, 6), islands=int(islands), every=10, **small).save(out, state=False)
"""


def test_islands_take_over_the_best_elite_of_each_niche():
    """The same islands as seeds, between whose archives the elites are exchanged by hand."""
    keys = jnp.stack([jax.random.fold_in(jax.random.key(7), island) for island in range(3)])
    optimizer = make_optimizer(road_problem(SHAPE), PRESETS["map-elites", "standard"])
    structure = jax.tree.structure(jax.eval_shape(optimizer.init, keys[0]))
    result, best_fitness = None, []
    for generations in (0, 10, 10, 3):
        state = result and result.state
        result = evolve(keys, SHAPE, **SMALL | {"generations": generations}, state=state)
        states = jax.tree.unflatten(structure, result.state.inner)
        archive = jax.tree.map(np.array, states.archive)
        for niche in range(archive.fitness.shape[1]):
            best = min(range(3), key=lambda island: archive.fitness[island, niche])  # the first of equals
            worse = archive.fitness[:, niche] > archive.fitness[best, niche]
            for array in archive:
                array[worse, niche] = array[best, niche]
        best_fitness.append(archive.fitness.min())
        inner = states._replace(archive=jax.tree.map(jnp.asarray, archive))
        result = replace(result, state=result.state._replace(inner=tuple(jax.tree.leaves(inner))))
    together = evolve_islands(jax.random.key(7), SHAPE, islands=3, every=10, **SMALL)
    found, history = together.elites, together.history
    valid = archive.fitness[0] < VACANT
    np.testing.assert_array_equal(found.fitness, archive.fitness[0])
    np.testing.assert_array_equal(found.valid, valid)
    np.testing.assert_array_equal(np.asarray(found.grids)[valid], archive.grids[0][valid])
    assert history.generation.tolist() == [10, 20, 23]
    assert history.evaluations.tolist() == [10 * 120, 20 * 120, 23 * 120]
    assert history.best_fitness.tolist() == best_fitness[1:] and history.elite_count[-1] == valid.sum()


@pytest.mark.parametrize(
    ("preset", "processes", "islands"),
    [("standard", 2, 4), *(pytest.param("tuned", count, 4, marks=pytest.mark.slow) for count in (2, 4))],
)
def test_processes_that_are_connected_return_what_one_returns(preset, processes, islands, tmp_path):
    with socket.socket() as probe:
        probe.bind(("localhost", 0))
        address = f"localhost:{probe.getsockname()[1]}"
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    files = [tmp_path / f"{number}.npz" for number in range(processes)]
    running = [
        subprocess.Popen(
            [sys.executable, program, address, *map(str, (processes, number, islands)), preset, file],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        for number, file in enumerate(files)
    ]
    for process in running:
        _, errors = process.communicate(timeout=300)
        assert process.returncode == 0, errors[-2000:]
    evolve_islands(7, SHAPE, islands=islands, every=10, **SMALL | {"preset": preset}).save(
        tmp_path / "one", state=False
    )
    whole = (tmp_path / "one").read_bytes()
    assert [file.read_bytes() == whole for file in files] == [True] * processes
    assert Result.load(Path(files[0])).elites.valid.any()


@pytest.mark.usefixtures("any_types")
@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"method": "ea"}, "method: expected map-elites, which has an archive to exchange, got ea"),
        ({"spec": "ea"}, "spec: expected"),
        ({"islands": 0}, "islands: expected a whole number, 1 or more, got 0"),
        ({"every": 0}, "every: expected a whole number, 1 or more, got 0"),
        ({"key": jax.random.split(jax.random.key(0), 2)}, "key: expected one key for all islands, got 2 keys"),
    ],
)
def test_what_cannot_be_is_refused(given, message):
    with pytest.raises(InputError) as error:
        evolve_islands(**{"shape": SHAPE, "islands": 2, **given})
    assert str(error.value).startswith(message)

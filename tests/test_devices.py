"""More devices than one: the same results, bit for bit."""

import os
import subprocess
import sys

PROGRAM = """
import chex
import jax
from jax.sharding import NamedSharding, PartitionSpec

from elitelanes_jax import evolve, measure, random_grids
from elitelanes_jax.optimizers.map_elites import map_elites
from elitelanes_jax.optimizers.run import advance, start
from elitelanes_jax.problem.road_problem import road_problem

mesh, split = jax.make_mesh((2,), ("batch",), axis_types=(jax.sharding.AxisType.Auto,)), PartitionSpec("batch")


def shared(function):
    return jax.jit(jax.shard_map(function, mesh=mesh, in_specs=split, out_specs=split))


# Large grids are labelled in another way than those of the search below.
grids = random_grids(jax.random.key(0), 6, (20, 20))
there = jax.device_put(grids, NamedSharding(mesh, split))
chex.assert_trees_all_equal(shared(jax.vmap(measure))(there), jax.jit(jax.vmap(measure))(grids))

optimizer = map_elites(road_problem((5, 6)))


def search(keys):
    return advance(optimizer, keys, start(optimizer, keys), 1, 20, most=20)[0]


keys = jax.random.split(jax.random.key(1), 4)
there = jax.device_put(keys, NamedSharding(mesh, split))
chex.assert_trees_all_equal(jax.jit(search)(there), jax.jit(search)(keys))
print("done")
"""


def test_grids_and_seeds_spread_over_devices():
    environment = os.environ | {"XLA_FLAGS": "--xla_force_host_platform_device_count=2", "JAX_PLATFORMS": "cpu"}
    ran = subprocess.run([sys.executable, "-c", PROGRAM], env=environment, capture_output=True, text=True, check=False)
    assert ran.stdout == "done\n", ran.stderr[-2000:]

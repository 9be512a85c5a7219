"""Counts what compiled programs consist of, so that a larger program is seen; a noisy machine cannot blur the counts.

    python tests/test_program_sizes.py    # writes the counts to program_sizes.json beside it

For each program: the operations of its lowered form, the kilobytes that they read and write by XLA's own estimate, and
the loops of its form for a GPU, where every round of a loop of unknown length waits for the processor. And the
operations that devices may round differently. There are none: a search gives the same bits on all of them.
"""

import json
import re
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import pytest

from elitelanes_jax import Weights, fitness, measure, repair, road_problem
from elitelanes_jax.network import measure_town
from elitelanes_jax.optimizers import PRESETS, make_optimizer
from elitelanes_jax.optimizers.loop import advance, start

FILE = Path(__file__).with_name("program_sizes.json")
SHAPE, SEEDS = (12, 12), 16

# Multiplications are not among them: searches multiply floats by powers of two alone, which is exact.
ROUNDED = (
    r"(?:chlo\.\w+|stablehlo\.(?:add|subtract|divide|remainder|sqrt|rsqrt|cbrt|exponential\w*|log\w*|power|sine|cosine|tan"
    r"|tanh|atan2|dot\w*))\b.*(?:f16|f32|f64)"
)


def count_of(function, *arguments):
    traced = jax.jit(function).trace(*arguments)
    lowered, for_gpu = traced.lower(), traced.lower(lowering_platforms=("cuda",)).as_text()
    return {
        "operations": sum(" = " in line for line in lowered.as_text().splitlines()),
        "kilobytes": round(lowered.cost_analysis()["bytes accessed"] / 1000),
        "loops on a GPU": for_gpu.count("stablehlo.while"),
        "roundings": len(re.findall(ROUNDED, for_gpu)),
    }


def count_all(presets=PRESETS):
    grids = jax.ShapeDtypeStruct((64, *SHAPE), jnp.int8)
    kernels = {
        "measure": measure,
        "fitness": lambda grid: fitness(measure(grid), Weights()),
        "repair": repair,
        "measure_town": measure_town,
    }
    counts = {name: count_of(jax.vmap(kernel), grids) for name, kernel in kernels.items()}
    keys = jax.eval_shape(lambda: jax.random.split(jax.random.key(0), SEEDS))
    for method, preset in presets:
        optimizer = make_optimizer(road_problem(SHAPE), PRESETS[method, preset])
        counts[f"{method}, {preset}, start"] = count_of(partial(start, optimizer), keys)
        states = jax.eval_shape(partial(start, optimizer), keys)

        def run(keys, states, optimizer=optimizer):
            return advance(optimizer, keys, states, 1, 100, most=100)

        counts[f"{method}, {preset}"] = count_of(run, keys, states)
    return {"jax": jax.__version__, "programs": counts}


# Lowering takes most of the time.
@pytest.mark.parametrize("presets", [[("map-elites", "tuned")], pytest.param([*PRESETS], marks=pytest.mark.slow)])
def test_programs_are_as_large_as_the_file_says(presets):
    kept = json.loads(FILE.read_text(encoding="utf-8"))
    if kept["jax"] != jax.__version__:
        pytest.skip(f"the counts are those of JAX {kept['jax']}")
    found = count_all(presets)["programs"]
    assert set(found) <= set(kept["programs"]) and (len(presets) == 1 or len(found) == len(kept["programs"]))
    for name, counts in found.items():
        for unit, count in counts.items():
            assert count == pytest.approx(kept["programs"][name][unit], rel=0.02), (name, unit)


if __name__ == "__main__":
    FILE.write_text(json.dumps(count_all(), indent=2) + "\n", encoding="utf-8")

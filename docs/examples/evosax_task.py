"""Road networks by one of evosax's strategies, from logits: ``python docs/examples/evosax_task.py``."""

import jax
from evosax.algorithms import SNES

from elitelanes_jax import road_problem
from elitelanes_jax.optimizers.interop import evosax_task

task = evosax_task(road_problem((6, 6), fill=True))
key = jax.random.key(0)
strategy = SNES(population_size=64, solution=task.sample(key))
params = strategy.default_params
state, task_state = strategy.init(key, task.sample(key), params), task.init(key)


def generation(carry, key):
    state, task_state = carry
    ask, tell, score = jax.random.split(key, 3)
    population, state = strategy.ask(ask, state, params)
    fitness, task_state, _ = task.eval(score, population, task_state)
    state, metrics = strategy.tell(tell, population, fitness, state, params)
    return (state, task_state), metrics["best_fitness"]


(state, _), best = jax.lax.scan(generation, (state, task_state), jax.random.split(key, 100))
print(best[0], best[-1])
print(task.decode(state.best_solution))

"""Road networks in QDax's own MAP-Elites, and the best of them drawn: ``python docs/examples/qdax_map_elites.py``."""

from functools import partial

import jax
from qdax.core.emitters.standard_emitters import MixingEmitter
from qdax.core.map_elites import MAPElites
from qdax.utils.metrics import default_qd_metrics

from elitelanes_jax import road_problem
from elitelanes_jax.optimizers.interop import qdax_centroids, qdax_moves, qdax_scoring_fn
from elitelanes_jax.plots import road_map

problem = road_problem((12, 12), "tuned", fill=True)
mutate, vary = qdax_moves(problem)
emitter = MixingEmitter(mutate, vary, variation_percentage=0.5, batch_size=64)
search = MAPElites(qdax_scoring_fn(problem), emitter, partial(default_qd_metrics, qd_offset=0.0))

first, start, run = jax.random.split(jax.random.key(0), 3)
repertoire, state, _ = search.init(problem.random(first, 64), qdax_centroids(problem.axes), start)
(repertoire, *_), history = jax.lax.scan(search.scan_update, (repertoire, state, run), length=300)
print(history["max_fitness"][0], history["max_fitness"][-1])
road_map(repertoire.genotypes[repertoire.fitnesses.argmax()]).figure.savefig("qdax-map.png")

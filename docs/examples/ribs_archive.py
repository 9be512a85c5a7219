"""Road networks in pyribs's own loop: ``python docs/examples/ribs_archive.py``."""

from ribs.archives import GridArchive
from ribs.emitters import IsoLineEmitter
from ribs.schedulers import Scheduler

from elitelanes_jax import road_problem
from elitelanes_jax.optimizers.interop import ribs_archive_space, ribs_evaluate, ribs_grids

problem = road_problem((6, 6), ["cyclomatic:12:1", "straight_share:10"], fill=True)
evaluate = ribs_evaluate(problem)

archive = GridArchive(**ribs_archive_space(problem), seed=0)
middle = [len(problem.alphabet) / 2] * archive.solution_dim
emitters = [IsoLineEmitter(archive, iso_sigma=0.5, line_sigma=0.5, x0=middle, batch_size=64, seed=0)]
scheduler = Scheduler(archive, emitters)
for generation in range(200):
    scheduler.tell(*evaluate(scheduler.ask()))
    if generation % 50 == 0:
        print(generation, archive.stats.num_elites, archive.stats.obj_max)
print(archive.stats.num_elites, archive.stats.obj_max)
print(ribs_grids(problem)(archive.best_elite["solution"][None])[0])

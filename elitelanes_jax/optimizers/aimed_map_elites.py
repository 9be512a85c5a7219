"""The tuned MAP-Elites: annealed chains on islands, each island aiming at a niche.

An island is what the literature calls an improvement emitter (Fontaine et al., "Covariance matrix adaptation for the
rapid illumination of behavior space", 2020), with annealing in the place of a distribution that adapts. For a cycle it
pursues one niche: what is off it is worth the less. It starts from the elite that is worth most for the niche, or anew,
and takes parts of elites near it. All that is evaluated comes before the archive.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from chex import Array, Numeric, PRNGKey

from elitelanes_jax.annealing import (
    AnnealingConfig,
    Cooling,
    Draw,
    accepts,
    fresh_grid,
    island_mates,
    tuned_move,
)
from elitelanes_jax.archive import Archive, describe, empty_archive, insert, niche_bins
from elitelanes_jax.checks import check_count, check_real
from elitelanes_jax.draws import below, chance
from elitelanes_jax.errors import InputError
from elitelanes_jax.evolution import Population, evaluated, taken
from elitelanes_jax.optimizers.base import Elites, Info, Optimizer
from elitelanes_jax.problem import Problem

__all__ = ["AimedMapElitesConfig", "AimedMapElitesState", "aimed_map_elites"]

# Random words of each chain in a step, beside those of the move: aims and mates take four, the contest the rest.
_OTHER_WORDS = 12
_LARGEST_CONTEST = _OTHER_WORDS - 4


class AimedMapElitesConfig(NamedTuple):
    """Settings; the defaults are the preset `tuned`.

    Attributes:
      annealing: of the chains; its cycles do not grow, and are by default half as long as those of the tuned EA.
      pull: what a bin of distance from the niche aimed at adds to the fitness.
      nudge: likewise on axes with an aim, whose flaws cost fitness anyway.
      anew: probability that an island starts a cycle from random grids.
      frontier: probability that it aims at a vacant niche, one that an elite off the aim is a step to or that lies
        beside a filled one, if there is any.
      foreign: probability that a mate comes from the archive.
      contest: among how many elites the one worth most for the niche becomes that mate.
    """

    annealing: AnnealingConfig = AnnealingConfig()
    pull: int = 400
    nudge: int = 1
    anew: Numeric = 0.3
    frontier: Numeric = 0.3
    foreign: Numeric = 0.5
    contest: int = 4

    def checked(self) -> "AimedMapElitesConfig":
        """The settings with probabilities as floats.

        Raises:
          InputError: for a setting out of its range.
        """
        for name in ("pull", "nudge", "contest"):
            check_count("config", name, getattr(self, name))
        if self.contest > _LARGEST_CONTEST:
            raise InputError(f"config: expected contest to be at most {_LARGEST_CONTEST}, got {self.contest}")
        chances = {
            name: check_real("config", name, getattr(self, name), 0, 1) for name in ("anew", "frontier", "foreign")
        }
        return self._replace(annealing=self.annealing.checked(), **chances)


class AimedMapElitesState(NamedTuple):
    """What is carried from step to step.

    Attributes:
      chains: the grids that the chains are at.
      aims: int32 ``[I, D]``, the bins of the niche that each island aims at.
      archive: the best of all grids evaluated so far, by niche.
      cooling: where in its cycle the run is.
    """

    chains: Population
    aims: Array
    archive: Archive
    cooling: Cooling


def aimed_map_elites(problem: Problem, config: AimedMapElitesConfig = AimedMapElitesConfig()) -> Optimizer:  # noqa: B008
    """MAP-Elites whose islands aim at niches; its elites are the archive.

    Args:
      problem: with a shape, an alphabet, a fitness and axes; niches off an axis' aim serve as steps.
      config: the defaults are the preset `tuned`.

    Raises:
      InputError: for a setting out of its range.
    """
    config = config.checked()
    annealing, axes = config.annealing, problem.axes
    count, chains_each = annealing.population, annealing.chains_on(problem.shape)
    islands = count // chains_each
    move = tuned_move(problem, annealing.moves)
    bins = tuple(axis.bins for axis in axes)
    places = np.indices(bins).reshape(len(bins), -1).T.astype(np.int32)  # of all niches, [N, D]
    free = np.array([axis.aim is None for axis in axes])
    aims = np.array([axis.aim or 0 for axis in axes], np.int32)
    wanted = (free | (places == aims)).all(axis=1)
    price = np.where(free, config.pull, config.nudge).astype(np.int32)

    def worth(fitness: Array, place: Array, aim: Array) -> Array:
        """What a grid is worth to those who aim at a niche."""
        return fitness + (jnp.abs(place - aim) * price).sum(axis=-1, dtype=jnp.int32)

    def store(archive: Archive, found: Population) -> Archive:
        return insert(archive, axes, found.grids, found.fitness, found.counts)

    def elite_worth(archive: Archive, niche: Array, aim: Array) -> Array:
        known = jnp.minimum(archive.fitness[niche], 2**29)  # a vacant niche is worth less than any elite
        return worth(known, jnp.asarray(places)[niche], aim)

    def new_aims(words: Array, archive: Archive) -> Array:
        """Niches to aim at, int32 ``[I, D]``: vacant ones within reach, or filled ones."""
        filled = archive.filled
        seen = filled.reshape(bins).any(axis=tuple(np.flatnonzero(~free).tolist()), keepdims=True)
        near = jnp.broadcast_to(seen | _beside(seen, free), bins).reshape(-1) & wanted & ~filled
        kept = filled & wanted
        kept = jnp.where(kept.any(), kept, filled)
        chosen = jnp.where(
            (chance(words[:, 0], config.frontier) & near.any()), _one(words[:, 1], near), _one(words[:, 1], kept)
        )
        # Where none on the aim is filled, one off it stands for the one that it is a step to.
        return jnp.where(free, jnp.asarray(places)[chosen], aims)

    def init(key: PRNGKey) -> AimedMapElitesState:
        chains = evaluated(problem, problem.random(key, count))
        archive = store(empty_archive(axes, problem.shape), chains)
        length = annealing.first_cycle(problem.shape) // (1 if annealing.cycle else 2)
        cooling = Cooling(jnp.int32(0), jnp.int32(max(1, length)))
        return AimedMapElitesState(chains, jnp.zeros((islands, len(axes)), jnp.int32), archive, cooling)

    def step(key: PRNGKey, state: AimedMapElitesState) -> tuple[AimedMapElitesState, Info]:
        chains, aim, archive, cooling = state
        draw = Draw.of(key, count, move, others=_OTHER_WORDS)
        start, first = cooling.begins, np.arange(islands) * chains_each
        aim = jnp.where(start, new_aims(draw.other[first], archive), aim)
        own_aim = jnp.repeat(aim, chains_each, axis=0)

        nearest = jnp.argmin(elite_worth(archive, np.arange(len(places)), aim[:, None]), axis=1)
        anew = jnp.repeat(chance(draw.other[first, 2], config.anew), chains_each)
        starts = jnp.repeat(archive.grids[nearest], chains_each, axis=0)
        rivals = _one(draw.other[:, 4 : 4 + config.contest], archive.filled)
        best_rival = jnp.argmin(elite_worth(archive, rivals, own_aim[:, None]), axis=1)
        foreign = archive.grids[jnp.take_along_axis(rivals, best_rival[:, None], axis=1)[:, 0]]
        mates = island_mates(draw.mate, chains.grids, chains_each)
        mates = jnp.where(chance(draw.other[:, 3], config.foreign)[:, None, None], foreign, mates)

        def child(grid: Array, mate: Array, elite: Array, random: Array, word: Array, words: Array) -> Array:
            varied = move.apply(words, grid, mate)
            fresh, rank = fresh_grid(problem, word)
            first_grid, first_rank = jnp.where(random, fresh, elite), jnp.where(random, rank, 0)
            return problem.repair(jnp.where(start, first_grid, varied.grid), jnp.where(start, first_rank, varied.dirty))

        grids = jax.vmap(child)(chains.grids, mates, starts, anew, draw.fresh, draw.move)
        children = evaluated(problem, grids)

        def at(found: Population) -> Array:
            return worth(found.fitness, niche_bins(describe(found.counts, axes), axes), own_aim)

        temperature = cooling.temperature(annealing, problem.shape)
        accepted = accepts(draw.accept, temperature, at(chains), at(children)) | start
        chains = taken(accepted, children, chains)
        archive = store(archive, children)
        info = Info(best_fitness=archive.fitness.min(), elite_count=archive.filled.sum(dtype=jnp.int32))
        return AimedMapElitesState(chains, aim, archive, cooling.after(grows=False)), info

    def elites(state: AimedMapElitesState) -> Elites:
        archive = state.archive
        return Elites(archive.grids, archive.fitness, archive.counts, valid=archive.filled)

    return Optimizer(init, step, elites, evaluations_per_step=count)


def _one(words: Array, among: Array) -> Array:
    """A place that is True, each alike likely, for each of the words; the last place where none is."""
    rank = jnp.cumsum(among, dtype=jnp.int32)
    drawn = below(words, jnp.maximum(rank[-1], 1))
    return jnp.minimum(jnp.searchsorted(rank, drawn, side="right"), among.size - 1)


def _beside(filled: Array, axes: np.ndarray) -> Array:
    """Which places have a neighbour along one of the given axes."""
    near = jnp.zeros_like(filled)
    for axis in np.flatnonzero(axes).tolist():
        ends = [(0, 0)] * filled.ndim
        for end, start in (((1, 0), 0), ((0, 1), 1)):
            ends[axis] = end
            shifted = jnp.pad(filled, ends)
            near |= jax.lax.slice_in_dim(shifted, start, start + filled.shape[axis], axis=axis)
    return near

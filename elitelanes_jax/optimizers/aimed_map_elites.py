"""The tuned MAP-Elites: annealed chains on islands, each island aiming at a niche.

An island is what the literature calls an improvement emitter (Fontaine et al., "Covariance matrix adaptation for the
rapid illumination of behavior space", 2020), with annealing in the place of a distribution that adapts. For a cycle it
pursues one niche: what is off it is worth the less. It starts from the elite that is worth most for the niche, or anew,
and takes parts of elites near it. All that is evaluated comes before the archives.

Elites descend from each other, so that one archive soon holds one family of networks, good in most niches, and what
would lead to the rest is lost. Half of the islands are therefore parted into regions, each with an archive of its own
that is all it knows; what all find meets in one more archive, which is the result, and the other islands start from
that. A region that long fills no more niches has come to the end of its family, and begins again with random grids.

A network that is good for its niche may be a trap on the way to the next one, and what rewards leads into it. While
niches are vacant in the result, some of the islands that begin with random grids are therefore scouts: for one long
cycle they see flaws alone, and aim past the niche, at the end of the axes, so that nothing holds them where it lies.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from chex import Array, Numeric, PRNGKey

from elitelanes_jax.annealing import (
    LONGEST_CYCLE,
    AnnealingConfig,
    Cooling,
    Draw,
    accepts,
    fresh_grid,
    island_mates,
    tuned_move,
)
from elitelanes_jax.archive import (
    MOST_NICHES,
    VACANT,
    Archive,
    describe,
    empty_archive,
    insert_at,
    niche_bins,
    niche_of,
)
from elitelanes_jax.checks import check_count, check_real
from elitelanes_jax.draws import below, chance
from elitelanes_jax.errors import InputError
from elitelanes_jax.evolution import Population, evaluated, taken
from elitelanes_jax.moves import twinned
from elitelanes_jax.optimizers.base import Elites, Info, Optimizer
from elitelanes_jax.problem import Problem

__all__ = ["AimedMapElitesConfig", "AimedMapElitesState", "Growth", "Scouts", "aimed_map_elites"]

# Random words of each chain in a step, beside those of the move: cycles and mates take six, the contest the rest.
_LARGEST_CONTEST = 8
_OTHER_WORDS = 6 + _LARGEST_CONTEST


class Scouts(NamedTuple):
    """Cycles from random grids that go past a vacant niche and see flaws alone.

    Each draws a niche that is vacant in the result and within reach, and goes past it to the end of each axis on the
    way to which fewer niches are filled.

    Attributes:
      share: how many of the cycles from random grids are scouts', while there are such niches.
      symmetric: probability that one starts with symmetric grids and twins all moves; else none.
      longer: how many times as long as cycles from elites theirs are.
      pull: what a bin of distance from the end of an axis adds to the flaws.
      hottest: temperature at the start of such a cycle, in units of fitness at 12 x 12.
      coldest: at its end.
    """

    share: Numeric = 0.4
    symmetric: Numeric = 0.9
    longer: int = 49
    pull: int = 200
    hottest: int = 50
    coldest: int = 25

    def checked(self) -> "Scouts":
        """The settings with probabilities as floats.

        Raises:
          InputError: for a setting out of its range.
        """
        for name in ("longer", "pull"):
            check_count("config", name, getattr(self, name))
        AnnealingConfig(hottest=self.hottest, coldest=self.coldest).checked()
        chances = {name: check_real("config", name, getattr(self, name), 0, 1) for name in ("share", "symmetric")}
        return self._replace(**chances)


class AimedMapElitesConfig(NamedTuple):
    """Settings; the defaults are the preset `tuned`.

    Attributes:
      annealing: of the chains; its cycles do not grow. By default each chain is an island, and a cycle a thirty-second
        of the first one of the tuned EA.
      pull: what a bin of distance from the niche aimed at adds to the fitness.
      nudge: likewise on axes with an aim, beside what the flaws cost anyway.
      anew: probability that an island of a region starts a cycle from random grids.
      longer: how many times as long as others such a cycle is.
      frontier: probability that it aims at a vacant niche, one that an elite off the aim is a step to or that lies
        beside a filled one, if there is any.
      foreign: probability that a mate comes from the archive that the island knows.
      contest: among how many niches the elite that is worth most for the niche aimed at becomes that mate.
      twins: probability that in a cycle from an elite a move is made in the place opposite too (see `twinned`).
      symmetric: probability that a cycle from random grids starts with symmetric ones and twins all moves; else none.
        Scouts have their own.
      regions: in how many parts half of the islands are parted, at most; the others know all that is found.
      scouts: of those cycles from random grids, see `Scouts`.
      patience: after how many cycles at the earliest a region begins again; it does once it has filled no niche in the
        second half of its time.
    """

    annealing: AnnealingConfig = AnnealingConfig(chains=1, hottest=40, coldest=12)
    pull: int = 400
    nudge: int = 100
    anew: Numeric = 0.1
    longer: int = 16
    frontier: Numeric = 0.5
    foreign: Numeric = 0.5
    contest: int = 8
    twins: Numeric = 0.5
    symmetric: Numeric = 0.5
    scouts: Scouts = Scouts()
    regions: int = 8
    patience: int = 160

    def checked(self) -> "AimedMapElitesConfig":
        """The settings with probabilities as floats.

        Raises:
          InputError: for a setting out of its range.
        """
        for name in ("pull", "nudge", "longer", "contest", "regions", "patience"):
            check_count("config", name, getattr(self, name))
        if self.contest > _LARGEST_CONTEST:
            raise InputError(f"config: expected contest to be at most {_LARGEST_CONTEST}, got {self.contest}")
        names = ("anew", "frontier", "foreign", "twins", "symmetric")
        chances = {name: check_real("config", name, getattr(self, name), 0, 1) for name in names}
        return self._replace(annealing=self.annealing.checked(), scouts=self.scouts.checked(), **chances)


class Growth(NamedTuple):
    """How a region comes on.

    Attributes:
      age: int32, steps since it began.
      gained: int32, the age at which it last filled a niche.
    """

    age: Array
    gained: Array

    def stalls(self, patience: int) -> Array:
        """Bool: whether it is time to begin again."""
        return self.age >= jnp.maximum(patience, 2 * self.gained)

    def after(self, *, gains: Array, begins: Array) -> "Growth":
        """The same after one more step."""
        age = jnp.where(begins, 0, self.age) + 1
        return Growth(age, jnp.where(gains, age, jnp.where(begins, 0, self.gained)))


class AimedMapElitesState(NamedTuple):
    """What is carried from step to step.

    Attributes:
      chains: the grids that the chains are at.
      aims: int32 ``[I, D]``, the bins of the niche that each island aims at.
      twins: float32 ``[I]``, how probable twins are in each island's cycle; 0 or 1 if it is from random grids.
      scouts: bool ``[I]``, whether each island's cycle is a scout's.
      archive: of each region, one after another, and last the best of all grids evaluated so far, by niche.
      cooling: arrays ``[I]``, where in its cycle each island is.
      growth: arrays ``[R]``, of each region.
    """

    chains: Population
    aims: Array
    twins: Array
    scouts: Array
    archive: Archive
    cooling: Cooling
    growth: Growth


def aimed_map_elites(problem: Problem, config: AimedMapElitesConfig = AimedMapElitesConfig()) -> Optimizer:  # noqa: B008
    """MAP-Elites whose islands aim at niches; its elites are the archive.

    Args:
      problem: with a shape, an alphabet, a fitness and axes; niches off an axis' aim serve as steps.
      config: the defaults are the preset `tuned`.

    Raises:
      InputError: for a setting out of its range.
    """
    config = config.checked()
    annealing, axes, scouting = config.annealing, problem.axes, config.scouts
    count, chains_each = annealing.population, annealing.chains_on(problem.shape)
    islands = count // chains_each
    island = np.arange(count) // chains_each  # of each chain
    length = annealing.cycle or max(16, annealing.first_cycle(problem.shape) // 32)
    length = max(1, min(length, LONGEST_CYCLE // max(config.longer, scouting.longer)))
    move = tuned_move(problem, annealing.moves)
    bins = tuple(axis.bins for axis in axes)
    places = np.indices(bins).reshape(len(bins), -1).T.astype(np.int32)  # of all niches, [N, D]
    niches = len(places)
    free = np.array([axis.aim is None for axis in axes])
    aims = np.array([axis.aim or 0 for axis in axes], np.int32)
    wanted = (free | (places == aims)).all(axis=1)
    price = np.where(free, config.pull, config.nudge).astype(np.int32)
    scouts_price = np.where(free, scouting.pull, 0).astype(np.int32)
    ends = np.array(bins, np.int32) - 1
    scouts_annealing = annealing._replace(hottest=scouting.hottest, coldest=scouting.coldest)
    apart = islands // 2
    regions = min(config.regions, apart, MOST_NICHES // niches - 1)
    # Where the archive begins that each island knows.
    region = np.append(np.arange(apart) * regions // max(1, apart), np.full(islands - apart, regions))
    known = (niches * region).astype(np.int32)
    starts_anew = (region < regions) | (regions == 0)
    patience = min(config.patience * length, LONGEST_CYCLE)

    def worth(fitness: Array, place: Array, aim: Array, price: np.ndarray = price) -> Array:
        """What a grid is worth to those who aim at a niche."""
        return fitness + (jnp.abs(place - aim) * price).sum(axis=-1, dtype=jnp.int32)

    def elite_worth(fitness: Array, niche: Array, aim: Array) -> Array:
        return worth(jnp.minimum(fitness, 2**29), jnp.asarray(places)[niche], aim)  # vacant: less than any elite

    def store(archive: Archive, found: Population) -> Archive:
        niche = niche_of(describe(found.counts, axes), axes)
        return insert_at(archive, jnp.stack([niche + known[island], niche + niches * regions]), *found)

    def wanted_filled(archive: Archive) -> Array:
        """How many of the niches that are wanted each region has filled, int32 ``[R]``."""
        filled = archive.filled[:-niches].reshape(regions, niches)
        return (filled & wanted).sum(axis=1, dtype=jnp.int32)

    def within_reach(filled: Array) -> Array:
        """Which niches are vacant and may be aimed at, bool ``[N]``."""
        seen = filled.reshape(bins).any(axis=tuple(np.flatnonzero(~free).tolist()), keepdims=True)
        return jnp.broadcast_to(seen | _beside(seen, free), bins).reshape(-1) & wanted & ~filled

    def new_aim(words: Array, filled: Array) -> Array:
        """A niche to aim at, int32 ``[D]``: a vacant one within reach, or a filled one."""
        near = within_reach(filled)
        kept = filled & wanted
        kept = jnp.where(kept.any(), kept, jnp.where(filled.any(), filled, wanted))
        chosen = jnp.where((chance(words[0], config.frontier) & near.any()), _one(words[1], near), _one(words[1], kept))
        # Where none on the aim is filled, one off it stands for the one that it is a step to.
        return jnp.where(free, jnp.asarray(places)[chosen], aims)

    def past(niche: Array, filled: Array) -> Array:
        """The end of each axis on the way to which, from a niche, fewer ones are filled, int32 ``[D]``."""
        kept = filled & wanted
        kept = jnp.where(kept.any(), kept, wanted)
        behind = (jnp.sign(jnp.asarray(places)[niche] - places) * kept[:, None]).sum(axis=0, dtype=jnp.int32)
        return jnp.where(free, jnp.where(behind > 0, ends, 0), aims)

    def new_cycle(
        words: Array, begin: Array, may: Array, must: Array, fitness: Array, vacant: Array
    ) -> tuple[Array, Array, Array, Array]:
        """An island's aim, whether it starts anew, whether it scouts, the place of the elite it starts from else."""
        own, filled = jax.lax.dynamic_slice_in_dim(fitness, begin, niches), fitness[-niches:] < vacant
        open_to_all = within_reach(filled)
        anew = may & chance(words[2], config.anew) | must
        scouts = anew & open_to_all.any() & chance(words[5], scouting.share)
        aim = jnp.where(scouts, past(_one(words[1], open_to_all), filled), new_aim(words, own < vacant))
        nearest = jnp.argmin(elite_worth(own, np.arange(niches), aim)).astype(jnp.int32)
        return aim, anew, scouts, begin + nearest

    def init(key: PRNGKey) -> AimedMapElitesState:
        chains = evaluated(problem, problem.random(key, count))
        archive = store(empty_archive(axes, problem.shape, times=regions + 1), chains)
        cooling = Cooling(jnp.zeros(islands, jnp.int32), jnp.full(islands, length, jnp.int32))
        growth = Growth(jnp.zeros(regions, jnp.int32), jnp.zeros(regions, jnp.int32))
        aim, twins = jnp.zeros((islands, len(axes)), jnp.int32), jnp.zeros(islands, jnp.float32)
        return AimedMapElitesState(chains, aim, twins, jnp.zeros(islands, bool), archive, cooling, growth)

    def step(key: PRNGKey, state: AimedMapElitesState) -> tuple[AimedMapElitesState, Info]:
        chains, aim, twins, scouts, archive, cooling, growth = state
        draw = Draw.of(key, count, twinned(0, move), others=_OTHER_WORDS)
        stalled = growth.stalls(patience)
        emptied = jnp.append(stalled, False)
        archive = archive._replace(fitness=jnp.where(jnp.repeat(emptied, niches), VACANT, archive.fitness))
        restarted = emptied[region] & ~scouts
        cooling = cooling._replace(step=jnp.where(restarted, 0, cooling.step))
        start, before = cooling.begins, wanted_filled(archive)

        def begun(carry: tuple[Array, ...]) -> tuple[Array, ...]:
            words = draw.other[np.arange(islands) * chains_each]
            # The number is given so that XLA does not see that it could do all this outside the loop.
            vacant = jnp.where(carry[0], VACANT, 0)
            each = jax.vmap(new_cycle, (0, 0, 0, 0, None, None))
            new_aims, anew, new_scouts, nearest = each(
                words, jnp.asarray(known), jnp.asarray(starts_anew), restarted, archive.fitness, vacant
            )
            return (
                jnp.array(False),
                jnp.where(start[:, None], new_aims, aim),
                anew,
                jnp.where(start, new_scouts, scouts),
                nearest,
            )

        # A loop of one round or none: what is seldom needed is seldom computed.
        carry = start.any(), aim, jnp.zeros(islands, bool), scouts, jnp.zeros(islands, jnp.int32)
        _, aim, anew, scouts, nearest = jax.lax.while_loop(lambda carry: carry[0], begun, carry)
        lengths = jnp.where(scouts, scouting.longer, jnp.where(anew, config.longer, 1)) * length
        cooling = cooling._replace(length=jnp.where(start, lengths, cooling.length))
        symmetry = jnp.where(scouts, jnp.float32(scouting.symmetric), jnp.float32(config.symmetric))
        symmetric = chance(draw.other[np.arange(islands) * chains_each, 3], symmetry)
        twins = jnp.where(start, jnp.where(anew, symmetric, jnp.float32(config.twins)), twins)
        own_aim, starts, begin = aim[island], start[island], jnp.asarray(known)[island]
        flaws_alone = scouts[island]

        rivals = below(draw.other[:, 6 : 6 + config.contest], niches)
        known_rivals = rivals + begin[:, None]
        best = jnp.argmin(elite_worth(archive.fitness[known_rivals], rivals, own_aim[:, None]), axis=1)
        foreign = jnp.take_along_axis(known_rivals, best[:, None], axis=1)[:, 0]
        is_foreign = chance(draw.other[:, 4], config.foreign) & (archive.fitness[foreign] < VACANT) & ~flaws_alone
        mates = island_mates(draw.mate, chains.grids, chains_each)
        mates = jnp.where(is_foreign[:, None, None], archive.grids[foreign], mates)

        def child(
            starts: Array, grid: Array, mate: Array, elite: Array, anew: Array, twins: Array, word: Array, words: Array
        ) -> Array:
            varied = twinned(twins, move).apply(words, grid, mate)
            fresh, rank = fresh_grid(problem, word, symmetric=twins > 0)
            first, first_rank = jnp.where(anew, fresh, elite), jnp.where(anew, rank, 0)
            return problem.repair(jnp.where(starts, first, varied.grid), jnp.where(starts, first_rank, varied.dirty))

        elite = archive.grids[nearest[island]]
        each = starts, chains.grids, mates, elite, anew[island], twins[island], draw.fresh, draw.move
        grids = jax.vmap(child)(*each)
        children = evaluated(problem, grids)

        def at(found: Population) -> Array:
            place = niche_bins(describe(found.counts, axes), axes)
            flawed = worth(problem.flaws(found.counts), place, own_aim, scouts_price)
            return jnp.where(flaws_alone, flawed, worth(found.fitness, place, own_aim))

        usual, scouted = (cooling.temperature(one, problem.shape) for one in (annealing, scouts_annealing))
        temperature = jnp.where(scouts, scouted, usual)[island]
        chains = taken(accepts(draw.accept, temperature, at(chains), at(children)) | starts, children, chains)
        archive = store(archive, children)
        found = archive.fitness[-niches:]
        info = Info(best_fitness=found.min(), elite_count=(found < VACANT).sum(dtype=jnp.int32))
        growth = growth.after(gains=wanted_filled(archive) > before, begins=stalled)
        return AimedMapElitesState(chains, aim, twins, scouts, archive, cooling.after(grows=False), growth), info

    def elites(state: AimedMapElitesState) -> Elites:
        found = jax.tree.map(lambda array: array[-niches:], state.archive)
        return Elites(found.grids, found.fitness, found.counts, valid=found.filled)

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

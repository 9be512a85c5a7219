"""What the explorer shows of a run, a result or maps: grids of one size, and their metadata."""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float32, Int, Int8, Int32, Shaped

from elitelanes_jax._util.cells import describe_size
from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax._util.files import read_json
from elitelanes_jax._util.folders import has_unfinished
from elitelanes_jax._util.types import Plain
from elitelanes_jax.benchmark.tasks import SIZES, find_task
from elitelanes_jax.formats.road_map import RoadMap, read_map
from elitelanes_jax.network.codes import KINDS
from elitelanes_jax.network.records import METRIC_NAMES, Weights
from elitelanes_jax.network.weighted_sum import fitness as weighted_sum
from elitelanes_jax.problem.descriptor import Axis, niche_index, resolve_axes, tuned_axes
from elitelanes_jax.problem.features import FEATURES
from elitelanes_jax.problem.ranges import range_limits, range_penalty

if TYPE_CHECKING:
    from elitelanes_jax.search.records import History
    from elitelanes_jax.search.resolve import Search
    from elitelanes_jax.search.result import Result

# The shown entries of a run's record.
_RECORDED = ("settings", "config", "archives", "tile_set", "elites", "versions", "device", "times")


class ShownRun(NamedTuple):
    """E grids of one size, and their metadata.

    Attributes:
      name: the name of the run.
      grids: the codes of the grids.
      fitness: the fitness of each grid, of 32 bits; None if the page computes it from the weights.
      seed: the index of the run's seed that found each grid, from 0.
      seeds: the number of seeds.
      axes: the axes of the niches.
      weights: the weights of metrics and features in the fitness.
      alphabet: the codes that off_alphabet does not count; None for all.
      features: what is measured beside the metrics, by name.
      niche: the niche of each grid, see `niche_index`; None if the page computes it from metrics.
      labels: a name for each grid, or None.
      maps: the chosen maps: the index of each among the grids, its name, and the map itself.
      history: the history of the run.
      usual_fitness: whether the fitness is the weighted sum of metrics and features, without a
        penalty of ranges.
      floors: the proven minimum of the weighted sum by cyclomatic number; None if none is known.
      record: the entries of the run's record that are shown.
    """

    name: str
    grids: Int8[np.ndarray, "E H W"]
    fitness: Shaped[np.ndarray, " E"] | None
    seed: Int[np.ndarray, " E"]
    seeds: int
    axes: tuple[Axis, ...]
    weights: Mapping[str, int]
    alphabet: tuple[int, ...] | None
    features: Mapping[str, Int32[np.ndarray, " E"]] = {}
    niche: Int32[np.ndarray, " E"] | None = None
    labels: tuple[str, ...] | None = None
    maps: tuple[tuple[int, str, RoadMap], ...] = ()
    history: "History | None" = None
    usual_fitness: bool = True
    floors: Mapping[int, int] | None = None
    record: Mapping[str, Plain] = {}


def from_result(result: "Result", name: str) -> ShownRun:
    """Returns the elites and the history of a result."""
    result = result.with_seed_axis()
    elites = result.elites
    # The mask has shape [S, N]. It is False in vacant niches.
    valid = np.asarray(elites.valid)
    if not valid.any():
        raise InputError(name, "a result with at least one elite", "none")
    search = result.search
    alphabet = search.settings.alphabet
    # Stubs and empty cells are counted by metrics of their own, and not by off_alphabet.
    if alphabet is not None:
        alphabet = alphabet + KINDS["end"] + KINDS["empty"]
    # Values of vacant niches are left out everywhere, so that all arrays have one entry per elite.
    features = {}
    for feature, values in elites.features.items():
        features[feature] = np.asarray(values)[valid]
    descriptor = np.asarray(elites.descriptor)[valid]
    has_usual_fitness = _has_usual_fitness(result)
    # Certified minima are of the usual fitness alone. A penalty of ranges is never negative.
    floors = None
    if has_usual_fitness:
        floors = _floors(search)
    return ShownRun(
        name,
        grids=np.asarray(elites.grids)[valid],
        fitness=np.asarray(elites.fitness)[valid],
        # This order is that of `values[valid]`.
        seed=np.nonzero(valid)[0],
        seeds=len(valid),
        axes=search.axes,
        weights=search.weights._asdict() | dict(search.settings.weights),
        alphabet=alphabet,
        niche=np.asarray(niche_index(descriptor, search.axes), np.int32),
        features=features,
        history=result.history,
        # The page computes the fitness of drawn maps, but not the penalty of ranges.
        usual_fitness=has_usual_fitness and not search.ranges,
        floors=floors,
        record={"settings": {"search": search.to_plain()}},
    )


def _has_usual_fitness(result: "Result") -> bool:
    """Returns whether the fitness of a result is the usual one.

    The usual fitness is the weighted sum of features plus the penalty of ranges. A result does not
    say whether a user gave the fitness, so the function computes the sum and compares it.
    """
    elites = result.elites
    search = result.search
    names = search.feature_names
    # The three parts of the fitness are added in turn: metrics, features, and the penalty of
    # ranges.
    measured = elites.by_name()
    columns = [np.asarray(measured[name], np.int32) for name in names]
    features = np.stack(columns, axis=-1)
    usual_fitness = np.asarray(weighted_sum(elites.metrics, search.weights))
    if search.feature_weights is not None:
        feature_weights = np.array(search.feature_weights, np.int32)
        usual_fitness = usual_fitness + features[..., len(METRIC_NAMES) :] @ feature_weights
    limits = range_limits(search.ranges, names)
    usual_fitness = usual_fitness + range_penalty(features, names, limits, search.shape)
    # Vacant niches have no grid to compare.
    is_usual = np.asarray(elites.fitness) == usual_fitness
    return bool(is_usual[np.asarray(elites.valid)].all())


def _floors(search: "Search") -> dict[int, int] | None:
    """Returns the certified optima of flawless networks by cyclomatic number.

    Returns None if they do not apply to a search.
    """
    height, width = search.shape
    # The tasks of the benchmark have a variant for filled grids, A, and one with empty cells, B.
    track = "A" if search.fills_all_cells else "B"
    size = f"{height}x{width}{track}"
    if size not in SIZES or search.settings.rules is not None:
        return None
    # The certificates are of the default weights.
    if search.weights != Weights() or search.feature_weights:
        return None
    # All budgets of a size have the same certificates.
    task = find_task(f"{size}-10000")
    return dict(zip(task.cyclomatic.tolist(), task.optimum.tolist(), strict=True))


def of_maps(maps: Iterable[RoadMap], group: str) -> list[ShownRun]:
    """Returns maps by their sizes. `group` is the name of all, or ""."""
    named_maps = [(f"map {index}", road_map) for index, road_map in enumerate(maps)]
    runs = by_size(named_maps)
    if not group:
        return runs
    # Maps of one size need no size in the name.
    if len(runs) == 1:
        return [runs[0]._replace(name=group)]
    return [run._replace(name=f"{group}, {run.name}") for run in runs]


def by_size(named_maps: Sequence[tuple[str, RoadMap]]) -> list[ShownRun]:
    """Returns maps with their names as a run for each size."""
    maps_by_size: dict[tuple[int, ...], list[tuple[str, RoadMap]]] = {}
    for name, road_map in named_maps:
        maps_by_size.setdefault(road_map.codes.shape, []).append((name, road_map))
    runs = []
    for (height, width), maps_of_size in maps_by_size.items():
        # A run has grids of one size, so each size is a run of its own.
        run = _run_of_maps(maps_of_size, (height, width))
        if len(maps_by_size) > 1:
            run = run._replace(name=f"maps of {height} x {width}")
        runs.append(run)
    return runs


def _run_of_maps(named_maps: Sequence[tuple[str, RoadMap]], shape: tuple[int, int]) -> ShownRun:
    """Returns a run of maps of one shape."""
    known_fitness = []
    labels = []
    chosen = []
    for index, (name, road_map) in enumerate(named_maps):
        labels.append(name)
        # Each map counts as chosen, so that the page shows its recorded tiles and objects.
        chosen.append((index, name, road_map))
        if road_map.fitness is not None:
            known_fitness.append(road_map.fitness)
    # A map whose fitness is a fraction comes from a fitness function of a user.
    is_whole = all(isinstance(value, int) for value in known_fitness)
    # If one map lacks its fitness, the page computes those of all, so that they can be compared.
    fitness = None
    if len(known_fitness) == len(named_maps):
        fitness = _fitness_array(known_fitness, is_whole)
    return ShownRun(
        name="maps",
        grids=np.stack([road_map.codes for _, road_map in named_maps]),
        fitness=fitness,
        seed=np.zeros(len(named_maps), int),
        seeds=1,
        axes=tuned_axes(shape),
        weights=Weights()._asdict(),
        alphabet=None,
        usual_fitness=is_whole and all(_is_usual(road_map) for _, road_map in named_maps),
        labels=tuple(labels),
        maps=tuple(chosen),
    )


def _is_usual(road_map: RoadMap) -> bool:
    """Returns whether the fitness of a map, if it has one, is the sum of the default weights."""
    weights, metrics = Weights(), road_map.metrics
    if road_map.fitness is None or not metrics:
        return True
    # One component is no fault. An empty grid has none.
    total = weights.components * max(metrics.get("components", 1) - 1, 0) + weights.constant
    for name in Weights._fields[1:-1]:
        total += getattr(weights, name) * metrics.get(name, 0)
    return road_map.fitness == total


def _fitness_array(
    values: Sequence[float], is_whole: bool
) -> Int32[np.ndarray, " E"] | Float32[np.ndarray, " E"]:
    """Returns fitness values of files, limited to what 32 bits can hold."""
    # In Python's numbers, because NumPy refuses whole numbers that are longer than 64 bits.
    if is_whole:
        most = np.iinfo(np.int32).max
        return np.array([min(max(value, -most), most) for value in values], np.int32)
    largest = float(np.finfo(np.float32).max)
    return np.array([min(max(value, -largest), largest) for value in values], np.float32)


def read_run(folder: Path) -> ShownRun:
    """Reads the folder of a run: its record, and its archive, its chosen maps or both."""
    file = folder / "run.json"
    record = _read_record(file)
    # The chosen maps are read in the order of their folders' names.
    chosen_maps = []
    for path in sorted(folder.glob("maps/*/map.json")):
        chosen_maps.append((path.parent.name, read_map(path)))
    name = folder.resolve().name
    # An archive has all elites, and chosen maps are marked among them. `pick` writes maps alone.
    if (folder / "archive.npz").exists():
        run = _with_chosen(read_archive(folder / "archive.npz", name), chosen_maps)
    elif chosen_maps:
        runs = by_size(chosen_maps)
        if len(runs) > 1:
            expected = "maps of one size, as a run writes them"
            raise InputError(folder, expected, "several")
        run = _with_recorded_axes(runs[0]._replace(name=name), record, file)
    else:
        raise InputError(folder, "an archive.npz or maps beside run.json", "neither")
    # The record may have entries that the page does not know.
    shown_record = {key: record[key] for key in _RECORDED if key in record}
    run = run._replace(record=shown_record)
    size = setting(run, "size")
    # Another size means that the files are not all of one run.
    if size is not None and size != list(run.grids.shape[1:]):
        got = describe_size(run.grids.shape[1:])
        raise InputError(folder, f"maps of {shorten(json.dumps(size))}, as run.json says", got)
    return run


def read_archive(file: Path, name: str) -> ShownRun:
    # This import loads the search, which pages of maps do not need.
    from elitelanes_jax.search.result import Result

    return from_result(Result.load(file), name)


def _read_record(file: Path) -> dict[str, Plain]:
    try:
        record = read_json(file)
    except OSError:
        hint = ""
        # An interrupted search leaves its unfinished work next to the folder.
        if has_unfinished(file.parent):
            hint = "its search is unfinished, the same generate command resumes it"
        raise InputError(file.parent, "a folder with run.json", "one without", hint) from None
    except InputError:
        # The error names the file.
        raise
    except (ValueError, RecursionError) as error:
        raise InputError(file, "the JSON of a run", shorten(str(error))) from None
    # All records of this package have the versions.
    if not isinstance(record, dict) or "versions" not in record:
        raise InputError(file, "the record of a run of this package", "other JSON")
    return record


def _with_chosen(run: ShownRun, chosen: Sequence[tuple[str, RoadMap]]) -> ShownRun:
    index_of: dict[bytes, int] = {}
    for index, grid in enumerate(run.grids):
        # Several seeds may have found the same grid. The first one is shown as chosen.
        index_of.setdefault(grid.tobytes(), index)
    maps = []
    for name, road_map in chosen:
        if road_map.codes.shape != run.grids.shape[1:]:
            expected = describe_size(run.grids.shape[1:])
            got = describe_size(road_map.codes.shape)
            raise InputError(
                f"{run.name}/maps/{name}", f"a map of {expected}, as the archive's", got
            )
        elite = index_of.get(road_map.codes.tobytes())
        # Maps that are no elites of the archive have no place among its niches.
        if elite is not None:
            maps.append((elite, name, road_map))
    return run._replace(maps=tuple(maps))


def _with_recorded_axes(run: ShownRun, record: dict[str, Plain], file: Path) -> ShownRun:
    """Returns a run of maps in the niches of the record, which is from `file`.

    The niches stay as they are if the record has no axes, or if a map lacks its values on them.
    """
    if "axes" not in record:
        return run
    height, width = run.grids.shape[1:]
    try:
        axes = resolve_axes(record["axes"], (height, width), None)
    except InputError:
        got = shorten(json.dumps(record["axes"]))
        raise InputError(file, "the axes of a run", got) from None
    values = []
    for _, _, road_map in run.maps:
        by_name = road_map.descriptor or {}
        values.append([by_name.get(axis.metric) for axis in axes])
    descriptor = np.array(values)
    # A missing value is None, and a map of a user may have fractions.
    if descriptor.dtype.kind != "i":
        return run
    descriptor = descriptor.astype(np.int32)
    # The page cannot measure other features, so it gets their values.
    features = {}
    for index, axis in enumerate(axes):
        if axis.metric not in FEATURES:
            features[axis.metric] = descriptor[:, index]
    niche = np.asarray(niche_index(descriptor, axes), np.int32)
    return run._replace(axes=axes, features=features, niche=niche)


def setting(run: ShownRun, name: str) -> Plain:
    """Returns a setting in the record of a run, None without one."""
    settings = run.record.get("settings")
    if not isinstance(settings, dict):
        return None
    return settings.get(name)

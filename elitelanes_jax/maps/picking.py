"""From archives of earlier searches to a folder of other maps, without another search."""

from collections.abc import Sequence
from dataclasses import replace
from hashlib import sha256
from itertools import chain
from pathlib import Path

import jax
import numpy as np

from elitelanes_jax._util.checks import check_named, check_unique, instance, path, paths
from elitelanes_jax._util.errors import InputError, pluralize
from elitelanes_jax._util.files import write_json
from elitelanes_jax._util.folders import output_folder
from elitelanes_jax._util.packages import installed_versions
from elitelanes_jax._util.progress import announce
from elitelanes_jax._util.types import AnyArray
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.maps.folder import ARCHIVE, RECORD, foreign_to_maps, write_maps
from elitelanes_jax.maps.generation import choose_maps, describe_source
from elitelanes_jax.maps.spec import PickSpec
from elitelanes_jax.network.codes import KINDS, ROAD_ALPHABET
from elitelanes_jax.network.records import Metrics
from elitelanes_jax.problem.descriptor import Axis, compute_descriptor, resolve_axes
from elitelanes_jax.problem.features import TOWN_FEATURES, columns_for
from elitelanes_jax.problem.kernels import with_town_features
from elitelanes_jax.problem.ranges import parse_ranges
from elitelanes_jax.search.elites import MeasuredElites
from elitelanes_jax.search.result import Result, load_with_seed
from elitelanes_jax.search.spec import SearchSpec
from elitelanes_jax.tiles.tileset import TileSet, load_tiles


def pick(
    spec: PickSpec,
    archives: str | Path | Result | Sequence[str | Path],
    out: str | Path,
    *,
    force: bool = False,
    force_archive: bool = False,
) -> list[RoadMap]:
    """Chooses maps among the elites of earlier searches, and writes them to a new folder, whole or not at all.

    From the archive of one search it chooses the same maps as `generate` with the same number of maps.

    Args:
      spec: of the choice.
      archives: one file or several, ``archive.npz`` of `generate` or of `Result.save`, of maps of one size; or a
        result, which is written to the folder as ``archive.npz``.
      out: the folder, new or empty.
      force: whether the folder is replaced, if an earlier run wrote all files in it, and it has no archive.
      force_archive: whether a folder with an archive is replaced too. `pick` does not write that archive again.

    Returns:
      The maps, as they were written.

    Raises:
      InputError: for a file that is not an archive, sizes that differ, ranges that no map is in, a bad tile set, or a
        folder that may not be replaced.
      NotEnoughMapsError: if there are fewer maps than requested; with `at_most`, if there is none.
      OSError: if the folder cannot be written.
    """
    spec, out = check_named("spec", instance(PickSpec), spec), Path(check_named("out", path, out))
    own = archives if isinstance(archives, Result) else None
    files: list[Path] = [out / ARCHIVE] if own else check_named("archives", paths, archives)
    check_unique("archives", "file", map(str, files))
    if folder := next(filter(Path.is_dir, files), None):
        raise InputError(f"{folder}: expected an archive, such as {folder / ARCHIVE}, got a folder")
    tiles = load_tiles(spec.tiles)
    found = [(own, None)] if own else [load_with_seed(file) for file in files]
    results = [_with_seeds(result) for result, _ in found]
    height, width = shape = results[0].elites.grids.shape[-2:]
    for file, result in zip(files, results, strict=True):
        if result.elites.grids.shape[-2:] != shape:
            sizes = ("{} x {}".format(*size) for size in (shape, result.elites.grids.shape[-2:]))
            raise InputError("{}: expected maps of {}, as in the first archive, got {}".format(file, *sizes))
    search = _search(spec, results[0].spec)
    alphabets = [result.spec.alphabet or ROAD_ALPHABET for result in results]
    search.replace(alphabet=sorted({*chain(*alphabets)})).check_maps((height, width))
    axes = results[0].axes if spec.axes is None else resolve_axes(spec.axes, (height, width), search.features)
    measured = _measured(search, axes, results)
    foreign, force = foreign_to_maps if force_archive or own else _foreign_or_archive, force or force_archive
    inputs = [*spec.inputs, *(own.spec.inputs if own else files)]
    with output_folder(out, {"command": "pick"}, inputs=inputs, foreign=foreign, force=force) as work:
        elites = _join(files, results, measured, axes, tiles)
        size, count = f"{height} x {width} tiles", pluralize(spec.maps, "map")
        announce(f"choosing {count} of {size} among {elites.valid.sum():,} elites")
        result = replace(results[0], elites=elites, spec=search, axes=axes)
        choice = choose_maps(
            result,
            spec.maps,
            spec.at_most,
            hint=None if own else "wider ranges or more archives" if search.where else "more archives",
            exclude=[np.array(grid, np.int8) for grid in spec.unlike],
        )
        runs = [
            None if seed is None else (seed, run)
            for (_, seed), one in zip(found, results, strict=True)
            for run in range(len(one.elites.grids))
        ]
        maps = [replace(road_map, seed=runs[(road_map.seed or (0, 0))[1]]) for road_map in choice.maps]
        title = f"{pluralize(len(maps), 'road map')} of {size}, chosen from {pluralize(len(results), 'archive')}"
        maps = write_maps(work.files, maps, title, tiles, tile_px=spec.tile_px, seed=spec.seed, furnish=spec.furnish)
        if own:
            own.save(work.files / ARCHIVE, state=False)
            files = [work.files / ARCHIVE]
        about = {
            "settings": spec.to_plain(),
            "archives": [
                {"file": ARCHIVE if own else str(file), "sha256": sha256(file.read_bytes()).hexdigest()}
                for file in files
            ],
            "search": search.to_plain(),
            **describe_source(tiles, result, choice),
            "versions": installed_versions(),
        }
        write_json(work.files / RECORD, about)
    return maps


def _foreign_or_archive(folder: Path) -> str | None:
    hint = f"{ARCHIVE}, which pick does not write again; force_archive=True replaces it too"
    return foreign_to_maps(folder) or (hint if (folder / ARCHIVE).exists() else None)


def _with_seeds(result: Result) -> Result:
    """Adds an axis of seeds to the elites of a single seed."""
    several = result.elites.valid.ndim > 1
    return result if several else replace(result, elites=jax.tree.map(lambda array: array[None], result.elites))


def _search(spec: PickSpec, search: SearchSpec) -> SearchSpec:
    """Returns the search with the ranges and rules of the choice. Axes of the choice also remove its targets."""
    asked = parse_ranges(map(str, spec.where), search.features)
    ranges = {item.name: item for item in (*search.where, *asked)}
    targets = search.targets if spec.axes is None else ()
    return search.replace(where=tuple(ranges.values()), rules=spec.rules or search.rules, targets=targets)


def _measured(search: SearchSpec, axes: Sequence[Axis], results: Sequence[Result]) -> list[str]:
    """Returns the maps' features beside metrics: those that the choice uses, and those that all archives have."""
    used = {*(axis.metric for axis in axes), *(item.name for item in search.where)}
    used |= {target.name for target in search.targets} | set(TOWN_FEATURES).intersection(search.measured)
    used |= {name for name in search.features if all(name in one.spec.features for one in results)}
    return [name for name in search.measured if name in used]


def _join(
    files: Sequence[Path],
    results: Sequence[Result],
    measured: Sequence[str],
    axes: tuple[Axis, ...],
    tiles: TileSet,
) -> MeasuredElites:
    """Joins the runs of all results, and pads results with fewer slots with vacant ones."""
    slots = max(one.elites.valid.shape[1] for one in results)

    def join(arrays: Sequence[AnyArray]) -> AnyArray:
        widths = ([(0, 0), (0, slots - array.shape[1]), *[(0, 0)] * (array.ndim - 2)] for array in arrays)
        return np.concatenate([np.pad(array, width) for array, width in zip(arrays, widths, strict=True)])

    elites = [one.elites for one in results]
    grids, fitness, valid = (join([getattr(one, name) for one in elites]) for name in ("grids", "fitness", "valid"))
    metrics = {name: join([getattr(one.metrics, name) for one in elites]) for name in Metrics._fields}
    allowed = (*tiles.alphabet, *KINDS["end"], *KINDS["empty"])
    metrics["off_alphabet"] = (~np.isin(grids, allowed)).sum(axis=(2, 3))
    columns = columns_for((axis.metric for axis in axes), measured)
    others = [name for name in columns if name not in metrics]
    named = zip(map(str, files), elites, strict=True)
    each = [with_town_features(one.features, others, one.grids, file) for file, one in named]
    features = {name: join([values[name] for values in each]) for name in others}
    stacked = np.stack([(metrics | features)[name] for name in columns], axis=-1).astype(np.int32)
    descriptor = compute_descriptor(stacked, columns, axes)
    return MeasuredElites(grids, fitness, descriptor, valid, Metrics(**metrics), features)

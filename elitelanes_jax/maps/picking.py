"""From archives of earlier searches to a folder of maps: more, others, or filtered ones, without another search."""

from collections.abc import Sequence
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import numpy as np

from elitelanes_jax._util.errors import InputError, NotEnoughMapsError, many
from elitelanes_jax._util.files import write_json
from elitelanes_jax._util.folders import output_folder
from elitelanes_jax._util.packages import installed_versions
from elitelanes_jax._util.progress import Progress, announce, detail
from elitelanes_jax._util.types import AnyArray
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.maps._parts import ARCHIVE
from elitelanes_jax.maps.folder import foreign_to_maps, write_maps
from elitelanes_jax.maps.spec import PickSpec
from elitelanes_jax.network.codes import KINDS
from elitelanes_jax.network.counts import Metrics
from elitelanes_jax.problem.constraints import parse_ranges
from elitelanes_jax.problem.descriptor import Axis, compute_descriptor, resolve_axes
from elitelanes_jax.problem.extras import measure_missing
from elitelanes_jax.problem.features import TOWN_FEATURES, extra_names, join_counts
from elitelanes_jax.search.elites import MeasuredElites
from elitelanes_jax.search.result import Result, load_with_seed
from elitelanes_jax.search.selection import describe_choice, describe_shortage
from elitelanes_jax.search.spec import SearchSpec
from elitelanes_jax.tiles.tileset import TileSet, load_tiles


def pick(
    spec: PickSpec, archives: Sequence[Path], out: Path, *, force: bool = False, force_archive: bool = False
) -> list[RoadMap]:
    """Chooses maps among all that earlier searches found, and writes them to a new folder, whole or not at all.

    The choice is that of `generate`. From the archive of one search, with its number of maps, it is the same.

    Args:
      spec: of the choice.
      archives: files ``archive.npz`` of `generate`, of maps of one size.
      out: the folder, new or empty.
      force: whether a folder that an earlier run wrote, and nobody else wrote to, is replaced, if it has no archive.
      force_archive: whether it is replaced with an archive in it too, of which `pick` writes none.

    Returns:
      The maps, as they were written.

    Raises:
      InputError: for a file that is no archive, sizes that differ, ranges that no map is in, a bad tile set, or a
        folder that is not new.
      NotEnoughMapsError: if there are fewer maps than asked for; with `at_most`, if there is none.
      OSError: if the folder cannot be written.
    """
    if not archives:
        raise InputError("archives: expected at least one, got none")
    tiles = load_tiles(spec.tiles, blend=spec.blend)
    found, seeds = zip(*map(_read, archives), strict=True)
    shape = found[0].elites.grids.shape[2:]
    for file, one in zip(archives, found, strict=True):
        if one.elites.grids.shape[2:] != shape:
            sizes = ("{} x {}".format(*size) for size in (shape, one.elites.grids.shape[2:]))
            raise InputError("{}: expected maps of {}, as in the first archive, got {}".format(file, *sizes))
    search = _search(spec, found[0].spec)
    search.check_maps(shape)
    axes = found[0].axes if spec.axes is None else resolve_axes(spec.axes, shape, search.features)
    wanted = _wanted(search, axes, found)
    foreign = foreign_to_maps if force_archive else _foreign_or_archive
    force = force or force_archive
    with output_folder(out, {"command": "pick"}, inputs=archives, foreign=foreign, force=force) as work:
        elites = _together(archives, found, wanted, axes, tiles)
        announce(
            f"choosing {many(spec.maps, 'map')} of {shape[0]} x {shape[1]} tiles among {elites.valid.sum():,} elites"
        )
        result = replace(found[0], elites=elites, spec=search, axes=axes)
        with Progress("choosing maps"):
            choice = result.choose(spec.maps, known=[np.array(grid, np.int8) for grid in spec.unlike])
        detail(describe_choice(choice, spec.maps))
        if len(choice.maps) < (1 if spec.at_most else spec.maps):
            raise NotEnoughMapsError(describe_shortage(choice, spec.maps, "wider ranges or more archives"))
        runs = [(seed, run) for seed, one in zip(seeds, found, strict=True) for run in range(len(one.elites.grids))]
        maps = [replace(road_map, seed=runs[(road_map.seed or (0, 0))[1]]) for road_map in choice.maps]
        title = (
            f"{many(len(maps), 'road map')} of {shape[0]} x {shape[1]} tiles, chosen from {many(len(found), 'archive')}"
        )
        maps = write_maps(work.files, maps, title, tiles, tile_px=spec.tile_px, seed=spec.seed)
        record = {
            "settings": spec.to_plain(),
            "archives": [{"file": str(file), "sha256": sha256(file.read_bytes()).hexdigest()} for file in archives],
            "search": search.to_plain(),
            "tile_set": {name: getattr(tiles, name) for name in ("name", "licence", "alphabet", "layers", "blend")},
            "axes": [axis._asdict() for axis in axes],
            "elites": {"found": choice.found, "rejected": choice.rejected, "alike": choice.alike},
            "versions": installed_versions(),
        }
        write_json(work.files / "run.json", record)
    return maps


def _foreign_or_archive(folder: Path) -> str | None:
    has = (folder / ARCHIVE).exists()
    kept = f"{ARCHIVE}, which pick does not write again; --force-archive replaces it too" if has else None
    return foreign_to_maps(folder) or kept


def _read(file: Path) -> tuple[Result, int]:
    """Reads an archive, of runs whose seeds are known."""
    result, seed = load_with_seed(file)
    if seed is None or result.elites.grids.ndim != 4:
        raise InputError(f"{file}: expected an archive.npz of generate, got a result without a seed")
    return result, seed


def _search(spec: PickSpec, search: SearchSpec) -> SearchSpec:
    """Returns the search whose maps are wanted: its ranges, but for those of features that are given.

    Over axes that are given the maps are spread, in place of the search's targets.
    """
    asked = parse_ranges(map(str, spec.where), search.features)
    ranges = {item.name: item for item in (*search.where, *asked)}
    targets = search.targets if spec.axes is None else ()
    return search.replace(where=tuple(ranges.values()), rules=spec.rules or search.rules, targets=targets)


def _wanted(search: SearchSpec, axes: Sequence[Axis], found: Sequence[Result]) -> list[str]:
    """Returns the extra features that maps are to have: those that are used, and those that all archives have."""
    used = {*(axis.metric for axis in axes), *(item.name for item in search.where)}
    used |= {target.name for target in search.targets}
    everywhere = (
        set(TOWN_FEATURES)
        .intersection(search.extras)
        .union(name for name in search.features if all(name in one.spec.features for one in found))
    )
    return [name for name in search.extras if name in used | everywhere]


def _together(
    archives: Sequence[Path], found: Sequence[Result], wanted: Sequence[str], axes: tuple[Axis, ...], tiles: TileSet
) -> MeasuredElites:
    """Puts the runs of all searches one behind the other; places that a search has fewer of are vacant.

    Features that are `wanted` beside the axes' are there too.
    """
    places = max(one.elites.valid.shape[1] for one in found)

    def join(arrays: Sequence[AnyArray]) -> AnyArray:
        padded = [
            np.pad(array, [(0, 0), (0, places - array.shape[1]), *[(0, 0)] * (array.ndim - 2)]) for array in arrays
        ]
        return np.concatenate(padded)

    grids, fitness, valid = (
        join([getattr(one.elites, name) for one in found]) for name in ("grids", "fitness", "valid")
    )
    metrics = {name: join([getattr(one.elites.metrics, name) for one in found]) for name in Metrics._fields}
    allowed = (*tiles.alphabet, *KINDS["end"], *KINDS["empty"])
    metrics["off_alphabet"] = (~np.isin(grids, allowed)).sum(axis=(2, 3))
    extras = extra_names((axis.metric for axis in axes), wanted)
    each = [
        measure_missing(one.elites.features, extras, one.elites.grids, str(file))
        for file, one in zip(archives, found, strict=True)
    ]
    features = {name: join([values[name] for values in each]) for name in extras}
    descriptor = compute_descriptor(join_counts(metrics | features, extras), axes)
    return MeasuredElites(grids, fitness, descriptor, valid, Metrics(**metrics), features)

"""From results of earlier searches to a folder of other maps, without another search."""

from collections.abc import Sequence
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

import numpy as np

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.cells import describe_size
from elitelanes_jax._util.checks import check_named, check_unique, is_folder, path, paths
from elitelanes_jax._util.errors import InputError, pluralize
from elitelanes_jax._util.files import write_json
from elitelanes_jax._util.folders import output_folder
from elitelanes_jax._util.packages import installed_versions
from elitelanes_jax._util.progress import announce
from elitelanes_jax._util.types import AnyArray, Untyped, UserValue
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.maps.folder import ARCHIVE, RECORD, Drawing, foreign_to_maps, write_maps
from elitelanes_jax.maps.spec import PickSpec
from elitelanes_jax.maps.writing import choose_enough, describe_source
from elitelanes_jax.network.codes import KINDS
from elitelanes_jax.network.records import Metrics
from elitelanes_jax.problem.descriptor import compute_descriptor, resolve_axes
from elitelanes_jax.problem.features import TOWN_FEATURES, columns_for
from elitelanes_jax.problem.kernels import with_town_features
from elitelanes_jax.problem.ranges import parse_ranges
from elitelanes_jax.search.records import MeasuredElites
from elitelanes_jax.search.resolve import Search, resolve_again
from elitelanes_jax.search.result import Result, load_with_seed
from elitelanes_jax.tiles.tileset import TileSet, load_tiles


class _Source(NamedTuple):
    """Where maps may come from.

    Attributes:
      name: the name in messages; the file, if there is one.
      result: the result, with an axis of seeds.
      seed: the seed that the keys of the search were made from, or None.
    """

    name: str
    result: Result
    seed: int | None


@name_wrong_arguments
def pick(
    spec: PickSpec,
    archives: str | Path | Sequence[str | Path],
    out: str | Path,
    *,
    force: bool = False,
    force_archive: bool = False,
) -> list[RoadMap]:
    """Chooses maps among the elites of earlier searches, and writes them to a new folder.

    The folder is written whole or not at all. From the archive of one search it chooses the same
    maps as `generate` with the same number of maps.

    Args:
      spec: the specification of the choice.
      archives: one file or several, ``archive.npz`` of `generate` or of `Result.save`, of maps of
        one size.
      out: the folder, new or empty.
      force: whether the folder is replaced, if an earlier run wrote all files in it, and it has no
        archive.
      force_archive: whether a folder with an archive is replaced too. `pick` does not write that
        archive again.

    Returns:
      The maps, as they were written.

    Raises:
      InputError: for a file that is not an archive, sizes that differ, ranges that no map is in, a
        bad tile set, or a folder that may not be replaced.
      NotEnoughMapsError: if there are fewer maps than requested; with `at_most`, if there is none.
      OSError: if the folder cannot be written.
    """
    out = Path(check_named("out", path, out))
    files = check_named("archives", paths, archives)
    check_unique("archives", "file", map(str, files))
    # A user may name the folder of a run instead of the archive in it.
    for file in files:
        if is_folder(file):
            raise InputError(file, f"an archive, such as {file / ARCHIVE}", "a folder")
    tiles = load_tiles(spec.tiles)
    sources = [_read_source(file) for file in files]
    search = _resolve_choice(spec, sources)
    # An archive is the result of a search and may have taken hours, so it has a switch of its own.
    if force_archive:
        foreign = foreign_to_maps
    else:
        foreign = _foreign_or_archive
    with output_folder(
        out,
        {"command": "pick"},
        inputs=[*spec.inputs, *files],
        foreign=foreign,
        force=force or force_archive,
    ) as work:
        hint = "wider ranges or more archives" if search.ranges else "more archives"
        return _write_choice(work.files, spec, sources, search, tiles, files, hint)


@name_wrong_arguments
def write_result(
    result: Result, out: str | Path, maps: int = 16, *, force: bool = False, **options: UserValue
) -> list[RoadMap]:
    """Writes the folder that `generate` writes.

    It has chosen maps with pictures and masks, a sheet, and the archive.

    Args:
      result: the result of `evolve`.
      out: the folder, new or empty.
      maps: the number of maps.
      force: whether the folder is replaced, if an earlier run wrote all files in it.
      **options: more fields of `PickSpec`, such as `where`, `at_most`, `tiles`, `tile_px` and
        `seed`.

    Returns:
      The maps, as they were written.

    Raises:
      InputError: for a bad option, or a folder with other files.
      NotEnoughMapsError: if there are fewer valid and different maps than requested.
      OSError: if the folder cannot be written.
    """
    spec, out = PickSpec().replace(maps=maps, **options), Path(check_named("out", path, out))
    tiles = load_tiles(spec.tiles)
    sources = [_Source("result", result.with_seed_axis(), None)]
    search = _resolve_choice(spec, sources)
    inputs = [*spec.inputs, *result.search.inputs]
    with output_folder(
        out, {"command": "pick"}, inputs=inputs, foreign=foreign_to_maps, force=force
    ) as work:
        # The record has the digest of the archive, so the archive is written first.
        archive = work.files / ARCHIVE
        result.save(archive, state=False)
        return _write_choice(work.files, spec, sources, search, tiles, [archive])


def _read_source(file: Path) -> _Source:
    result, seed = load_with_seed(file)
    return _Source(str(file), result.with_seed_axis(), seed)


def _foreign_or_archive(folder: Path) -> str | None:
    """Returns the first file in a folder that `generate` and `pick` did not write.

    If there is none, returns the folder's archive with a reason, or None without an archive.
    """
    foreign = foreign_to_maps(folder)
    if foreign is None and (folder / ARCHIVE).exists():
        return f"{ARCHIVE}, which pick does not write again; force_archive=True replaces it too"
    return foreign


def _resolve_choice(spec: PickSpec, sources: Sequence[_Source]) -> Search:
    """Resolves the search of the first source with the ranges, rules and axes of the choice.

    Raises:
      InputError: for sources of several sizes, or constraints that no map meets.
    """
    first = sources[0].result.search
    alphabet: set[int] = set()
    for source in sources:
        search = source.result.search
        if search.shape != first.shape:
            expected = f"maps of {describe_size(first.shape)}, as in the first archive"
            raise InputError(source.name, expected, describe_size(search.shape))
        # The elites of all archives together may have these codes.
        alphabet.update(search.alphabet)
    settings = first.settings
    # A range of the choice overrides the range of the search for the same feature.
    ranges = {item.name: item for item in settings.where}
    for item in parse_ranges(spec.where, settings.features):
        ranges[item.name] = item
    options: dict[str, UserValue] = {"where": tuple(ranges.values())}
    if spec.rules is not None:
        options["rules"] = spec.rules
    if spec.axes is not None:
        # With targets, example values decide the choice instead of niches. A user who names axes
        # wants niches, so they also remove the targets.
        axes = resolve_axes(spec.axes, first.shape, settings.features)
        options |= {"axes": axes, "targets": ()}
    return resolve_again(first, options, tuple(sorted(alphabet)))


def _measured(search: Search, sources: Sequence[_Source]) -> list[str]:
    """Returns the maps' features besides metrics.

    They are those that the choice uses, and those that all archives have.
    """
    # Features that the choice uses must be measured. Town features can be measured again from the
    # grids.
    used = {axis.metric for axis in search.axes}
    used.update(item.name for item in search.ranges)
    used.update(target.name for target in search.settings.targets)
    used.update(name for name in search.measured if name in TOWN_FEATURES)
    # A user's feature cannot be measured again here, so all archives must have it.
    for name in search.settings.features:
        if all(name in source.result.search.settings.features for source in sources):
            used.add(name)
    return [name for name in search.measured if name in used]


def _write_choice(
    folder: Path,
    spec: PickSpec,
    sources: Sequence[_Source],
    search: Search,
    tiles: TileSet,
    archives: Sequence[Path],
    hint: str | None = None,
) -> list[RoadMap]:
    """Chooses maps among all sources, and writes them and the record; returns the maps.

    The record lists the archives. One in the folder itself is named without its path.
    """
    elites = _join(sources, search, tiles)
    size = "{} x {} tiles".format(*search.shape)
    announce(
        f"choosing {pluralize(spec.maps, 'map')} of {size} among {elites.valid.sum():,} elites"
    )
    result = replace(sources[0].result, elites=elites, search=search)
    # Each search may have found its own examples. `choose_enough` leaves out those of the first.
    examples = [grid for source in sources[1:] for grid in source.result.search.settings.like]
    excluded = [np.array(grid, np.int8) for grid in (*spec.unlike, *examples)]
    choice = choose_enough(result, spec.maps, at_most=spec.at_most, exclude=excluded, hint=hint)
    # The joined elites count the runs of all sources. Each becomes the seed and the index in its
    # own source.
    runs: list[tuple[int, int] | None] = []
    for source in sources:
        for run in range(len(source.result.elites.grids)):
            runs.append(None if source.seed is None else (source.seed, run))
    maps = []
    for road_map in choice.maps:
        # `Result.choose` sets the seed of every map.
        assert road_map.seed is not None
        maps.append(replace(road_map, seed=runs[road_map.seed[1]]))
    origin = pluralize(len(sources), "archive")
    title = f"{pluralize(len(maps), 'road map')} of {size}, chosen from {origin}"
    drawing = Drawing(tiles, tile_px=spec.tile_px, seed=spec.seed, furnish=spec.furnish)
    written = write_maps(folder, maps, title, drawing)
    listed = []
    for file in archives:
        # The folder is still a hidden one here, so its path would be wrong later.
        name = file.name if file.parent == folder else str(file)
        listed.append({"file": name, "sha256": sha256(file.read_bytes()).hexdigest()})
    record = {
        "settings": spec.to_plain(),
        "archives": listed,
        "search": search.to_plain(),
        **describe_source(tiles, result, choice),
        "versions": installed_versions(),
    }
    write_json(folder / RECORD, record)
    return written


def _join(sources: Sequence[_Source], search: Search, tiles: TileSet) -> MeasuredElites:
    """Joins the runs of all sources, and pads results with fewer slots with vacant ones."""
    results = [source.result.elites for source in sources]
    grids = _stack([elites.grids for elites in results])
    metrics = {}
    for name in Metrics._fields:
        metrics[name] = _stack([getattr(elites.metrics, name) for elites in results])
    metrics["off_alphabet"] = _stack([_count_off_alphabet(source, tiles) for source in sources])
    # Metrics are stored for all elites. Other features are stored by some archives, and measured
    # for the rest.
    columns = columns_for((axis.metric for axis in search.axes), _measured(search, sources))
    others = [name for name in columns if name not in metrics]
    measured = []
    for source, elites in zip(sources, results, strict=True):
        measured.append(with_town_features(elites.features, others, elites.grids, source.name))
    features = {name: _stack([values[name] for values in measured]) for name in others}
    # The bins of the niches are computed again, because the axes may differ from those of a source.
    by_name = metrics | features
    stacked: Untyped = np.stack([by_name[name] for name in columns], axis=-1).astype(np.int32)
    return MeasuredElites(
        grids=grids,
        fitness=_stack([elites.fitness for elites in results]),
        descriptor=compute_descriptor(stacked, columns, search.axes),
        valid=_stack([elites.valid for elites in results]),
        metrics=Metrics(**metrics),
        features=features,
    )


def _count_off_alphabet(source: _Source, tiles: TileSet) -> Untyped:
    """Counts the tiles of each elite that its own search or the tile set has no code for."""
    both = set(tiles.alphabet) & set(source.result.search.alphabet)
    allowed = [*both, *KINDS["end"], *KINDS["empty"]]
    return (~np.isin(source.result.elites.grids, allowed)).sum(axis=(2, 3))


def _stack(arrays: Sequence[AnyArray]) -> Untyped:
    """Joins arrays ``[S, N, ...]`` along the seeds.

    Arrays are padded with zeros to the largest number of slots N.
    """
    slots = max(array.shape[1] for array in arrays)
    padded = []
    for array in arrays:
        width = [(0, 0)] * array.ndim
        # A slot of zeros is not valid, so nothing is chosen from it.
        width[1] = (0, slots - array.shape[1])
        padded.append(np.pad(array, width))
    return np.concatenate(padded)

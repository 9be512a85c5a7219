"""Collects the contents of the explorer: folders of runs, archives, maps, results in memory."""

import base64
import json
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.checks import check_named, instance, none_or, whole
from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax._util.files import read_json
from elitelanes_jax._util.folders import has_unfinished
from elitelanes_jax._util.packages import __version__
from elitelanes_jax._util.progress import announce
from elitelanes_jax._util.types import Plain, UserValue
from elitelanes_jax.benchmark.tasks import SIZES, find_task
from elitelanes_jax.explorer._payload import Blob, Payload
from elitelanes_jax.formats.duckietown import TILE_SIZE
from elitelanes_jax.formats.objects import OBJECT_KINDS, object_values
from elitelanes_jax.formats.plan import LONGEST_PLAN, REFERENCE, TAPE_WIDTHS, tapes_of
from elitelanes_jax.formats.rides import RecordedRide, read_rides
from elitelanes_jax.formats.road_map import RoadMap, as_maps, read_map, read_maps
from elitelanes_jax.formats.tags import SIGN_TAGS
from elitelanes_jax.network.codes import KINDS
from elitelanes_jax.network.fitness import fitness as weighted_sum
from elitelanes_jax.network.records import METRIC_NAMES, Weights
from elitelanes_jax.problem.archive import vacant_fitness
from elitelanes_jax.problem.descriptor import Axis, niche_index, tuned_axes
from elitelanes_jax.problem.ranges import range_limits, range_penalty
from elitelanes_jax.tiles.object_set import load_objects
from elitelanes_jax.tiles.rendering import COMPARED_PX, png_of, recall_choice, scale_tiles
from elitelanes_jax.tiles.tileset import TileSet, load_tiles

if TYPE_CHECKING:
    from elitelanes_jax.search.result import History, Result

_FORMAT = "elitelanes explorer, version 1"

# Steps of a history that are kept: the width of a chart in pixels.
_MOST_STEPS = 400

# The least number of random numbers that choose tile pictures, so that maps up to 64 x 64 look as `render` draws them.
_LEAST_LOTS = 4096

# The shown entries of a run's record.
_RECORDED = ("settings", "config", "archives", "tile_set", "elites", "versions", "device", "times")


class _Finds(NamedTuple):
    """Grids of one size, and their metadata."""

    name: str  # of the run
    grids: NDArray[np.int8]  # [E, H, W]
    fitness: NDArray[np.number] | None  # [E]; None if the page computes it from the weights
    seed: NDArray[np.int_]  # [E], the index of the run's seed that found each, from 0
    seeds: int  # the number of seeds
    axes: tuple[Axis, ...]  # of the niches
    weights: Mapping[str, int]  # of metrics and features in the fitness
    alphabet: tuple[int, ...] | None  # the codes that off_alphabet does not count; None for all
    features: Mapping[str, NDArray[np.int32]] = {}  # [E] by name, those measured beside the metrics
    niche: NDArray[np.int32] | None = None  # [E], see niche_index; None if the page computes it from metrics
    labels: tuple[str, ...] | None = None  # a name for each grid, or None
    # The chosen maps: the index of each among the grids, its name, and the map itself.
    maps: tuple[tuple[int, str, RoadMap], ...] = ()
    rides: tuple[tuple[int, RecordedRide], ...] = ()  # on maps, each with the index of its map
    history: "History | None" = None  # of the run
    usual_fitness: bool = True  # whether the fitness is the weighted sum of features plus the penalty of ranges
    # The proven minimum of the usual fitness by cyclomatic number, None if none is known.
    floors: Mapping[int, int] | None = None
    record: Mapping[str, Plain] = {}  # of the run, to be shown


def collect(
    what: UserValue,
    *,
    tiles: str | Path | TileSet | None = None,
    blend: bool | None = None,
    tile_px: int = 64,
    title: str | None = None,
) -> Payload:
    """Collects a result, maps, or files of runs and maps, to be shown.

    Args:
      what: a `Result`; a map or several, as `as_maps` takes them; or a path or several. A path is the folder of a run
        of `generate` or `pick`, a folder of such folders, an archive, a file of maps, or a file of rides of `drive`.
      tiles: a tile set or its folder; by default the first run's. If it is not found, the package's own
        is used, with a line on standard error. A relative path in a run's record is searched from here, then from each
        folder above the run.
      blend: whether to blend the tiles (see `tiles.blend`); by default as in the first run that records it, otherwise
        as the tile set says.
      tile_px: side of a tile's picture in pixels, 16 to 512.
      title: of the page.

    Raises:
      InputError: for anything else; for a file or folder that is missing, damaged, incomplete or of another kind, and
        for a bad tile set. The message names the file.
    """
    given: UserValue = what
    check_named("tile_px", whole(16, 512), tile_px)
    if hasattr(given, "elites") and hasattr(given, "axes"):
        name = title or "result"
        return _pack([_from_result(given, name)], _load_tiles(tiles, blend), tile_px, name)
    alone = isinstance(given, RoadMap | str | Path) or not isinstance(given, Iterable)
    listed = [given] if alone else list(given)
    if not listed:
        raise InputError("what: expected a Result, maps, or paths of runs and maps, got nothing")
    if all(isinstance(one, RoadMap) for one in listed):
        return _pack(_of_maps(listed, ""), _load_tiles(tiles, blend), tile_px, title or "")
    if all(isinstance(one, str | Path) for one in listed):
        return _collect_files([Path(one) for one in listed], tiles, blend, tile_px, title)
    if alone:
        raise InputError(f"what: expected a Result, maps, or paths of runs and maps, got {type(what).__name__}")
    maps = check_named("what", as_maps, listed)
    return _pack(_of_maps(maps, ""), _load_tiles(tiles, blend), tile_px, title or "")


def _load_tiles(tiles: str | Path | TileSet | None, blend: bool | None) -> TileSet:
    return tiles if isinstance(tiles, TileSet) else load_tiles(tiles, blend=blend)


def _collect_files(
    sources: Sequence[Path], tiles: str | Path | TileSet | None, blend: bool | None, tile_px: int, title: str | None
) -> Payload:
    runs: list[_Finds] = []
    maps: list[tuple[str, RoadMap]] = []
    driven: list[tuple[str, NDArray[np.int8], list[RecordedRide]]] = []
    own: Path | None = None
    for source in sources:
        if source.is_dir():
            for folder in _run_folders(source):
                runs.append(_read_run(folder))
                own = own or _find_tiles(folder, runs[-1])
        elif source.suffix == ".npz":
            runs.append(_read_archive(source, source.stem))
        elif (rides := read_rides(source)) is not None:
            driven.append((str(source), *rides))
        else:
            found = read_maps(source)
            names = [str(source)] if len(found) == 1 else [f"{source} {index}" for index in range(len(found))]
            maps += zip(names, found, strict=True)
    grids = [grid for run in runs for grid in run.grids] + [road_map.codes for _, road_map in maps]
    maps += [(name, RoadMap(grid)) for name, grid, _ in driven if not any(np.array_equal(grid, one) for one in grids)]
    names = _distinct_names([run.name for run in runs])
    runs = [run._replace(name=name) for run, name in zip(runs, names, strict=True)]
    blended = next((one for run in runs if isinstance(one := _setting(run, "blend"), bool)), None)
    if tiles is None and own is None and (lost := next(filter(None, (_setting(run, "tiles") for run in runs)), None)):
        announce(f"{lost}: expected the tile pictures of the run, got none; the package's own are shown; see --tiles")
    tile_set = _load_tiles(own if tiles is None else tiles, blended if blend is None else blend)
    heading = title or (runs[0].name if len(runs) == 1 and not maps else "")
    return _pack([_with_rides(run, driven) for run in (*runs, *_by_size(maps))], tile_set, tile_px, heading)


def collect_results(results: "Mapping[str, Result | Iterable[RoadMap]]", *, seeds: int | None = None) -> Payload:
    """Collects results of searches, and maps of other methods, by name; of each result the first `seeds` seeds."""
    runs: list[_Finds] = []
    check_named("seeds", none_or(whole(1)), seeds)
    for name, one in check_named("results", instance(Mapping), results).items():
        runs += _of_maps(one, name) if isinstance(one, Iterable) else [_from_result(one, name, seeds)]
    if not runs:
        raise InputError("results: expected at least one, got none")
    return _pack(runs, load_tiles(), 64, "")


def _of_maps(maps: Iterable[RoadMap], group: str) -> list[_Finds]:
    found = _by_size([(f"map {index}", road_map) for index, road_map in enumerate(maps)])
    names = [group if group and len(found) == 1 else ", ".join(filter(None, (group, run.name))) for run in found]
    return [run._replace(name=name) for run, name in zip(found, names, strict=True)]


def _run_folders(folder: Path) -> list[Path]:
    """Returns the folder of a run, or the folders of runs in a folder."""
    if (folder / "run.json").is_file() or (folder / "archive.npz").is_file():
        return [folder]
    found = sorted(file.parent for file in folder.glob("*/run.json"))
    if found:
        return found
    expected = f"{folder}: expected a folder that generate or pick wrote, or one of such folders"
    raise InputError(f"{expected}, got one without run.json")


def _read_run(folder: Path) -> _Finds:
    """Reads the folder of a run: its record, and its archive, its chosen maps or both."""
    file = folder / "run.json"
    record = _read_record(file)
    chosen = [(path.parent.name, read_map(path)) for path in sorted(folder.glob("maps/*/map.json"))]
    name = folder.resolve().name
    if (folder / "archive.npz").exists():
        run = _with_chosen(_read_archive(folder / "archive.npz", name), chosen)
    elif chosen:
        run, *others = _by_size(chosen)
        if others:
            raise InputError(f"{folder}: expected maps of one size, as a run writes them, got several")
        run = run._replace(name=name)
    else:
        raise InputError(f"{folder}: expected an archive.npz or maps beside run.json, got neither")
    run = run._replace(record={key: record[key] for key in _RECORDED if key in record})
    size = _setting(run, "size")
    if size is not None and size != list(run.grids.shape[1:]):
        got = "{} x {}".format(*run.grids.shape[1:])
        raise InputError(f"{folder}: expected maps of {shorten(json.dumps(size))}, as run.json says, got {got}")
    return run


def _read_record(file: Path) -> dict[str, Plain]:
    try:
        record = read_json(file)
    except OSError:
        unfinished = "; its search is unfinished, the same generate command resumes it" * has_unfinished(file.parent)
        raise InputError(f"{file.parent}: expected a folder with run.json, got one without{unfinished}") from None
    except (ValueError, RecursionError) as error:
        words = str(error).removeprefix(f"{file}: ")
        raise InputError(f"{file}: expected the JSON of a run, got: {shorten(words)}") from None
    if not isinstance(record, dict) or "versions" not in record:
        raise InputError(f"{file}: expected the record of a run of this package, got other JSON")
    return record


def _read_archive(file: Path, name: str) -> _Finds:
    from elitelanes_jax.search.result import Result

    return _from_result(Result.load(file), name)


def _from_result(result: "Result", name: str, seeds: int | None = None) -> _Finds:
    """Returns the elites and the history of a result, of all seeds or of the first `seeds`."""
    elites = result.elites
    single = elites.valid.ndim == 1
    some = slice(None if single else seeds)
    valid, fitness, grids, descriptor = (
        np.asarray(array)[None] if single else np.asarray(array)[some]
        for array in (elites.valid, elites.fitness, elites.grids, elites.descriptor)
    )
    if not valid.any():
        raise InputError(f"{name}: expected a result with at least one elite, got none")
    seed, _ = np.nonzero(valid)
    history = result.history
    if not single:
        seeded = ("best_fitness", "elite_count", "refused")
        history = history._replace(**{name: getattr(history, name)[:seeds] for name in seeded})
    alphabet, usual = result.spec.alphabet, has_usual_fitness(result)
    return _Finds(
        name,
        grids[valid],
        fitness[valid],
        seed,
        len(valid),
        result.axes,
        result.spec.all_weights._asdict() | dict(result.spec.weights),
        None if alphabet is None else (*alphabet, *KINDS["end"], *KINDS["empty"]),
        niche=np.asarray(niche_index(descriptor[valid], result.axes), np.int32),
        features={name: np.asarray(one)[some].reshape(valid.shape)[valid] for name, one in elites.features.items()},
        history=history,
        usual_fitness=usual,
        floors=_floors(result, (grids.shape[2], grids.shape[3])) if usual else None,
        record={"settings": {"search": result.spec.to_plain()}},
    )


def has_usual_fitness(result: "Result") -> bool:
    """Returns whether the fitness of a result is the weighted sum of features plus the penalty of ranges.

    A result does not say whether a user gave the fitness, so the function computes the sum and compares it.
    """
    elites, spec = result.elites, result.spec
    valid, shape, names = np.asarray(elites.valid), elites.grids.shape[-2:], (*METRIC_NAMES, *spec.measured)
    measured = elites.metrics._asdict() | dict(elites.features)
    features = np.stack([np.asarray(measured[name], np.int32) for name in names], axis=-1)
    usual = np.asarray(weighted_sum(elites.metrics, spec.all_weights))
    if spec.feature_weights is not None:
        usual = usual + features[..., len(METRIC_NAMES) :] @ np.array(spec.feature_weights, np.int32)
    usual = usual + range_penalty(features, names, range_limits(spec.where, names), (shape[0], shape[1]))
    return bool((np.asarray(elites.fitness) == usual)[valid].all())


def _floors(result: "Result", shape: tuple[int, int]) -> dict[int, int] | None:
    """Returns the certified optima of flawless networks by cyclomatic number, if they apply to a search."""
    spec = result.spec
    name = f"{shape[0]}x{shape[1]}{'A' if spec.repair_fills else 'B'}"
    if name not in SIZES or spec.all_weights != Weights() or spec.feature_weights or spec.rules is not None:
        return None
    task = find_task(f"{name}-10000")
    return dict(zip(task.cyclomatic.tolist(), task.optimum.tolist(), strict=True))


def _with_chosen(run: _Finds, chosen: Sequence[tuple[str, RoadMap]]) -> _Finds:
    index_of: dict[bytes, int] = {}
    for index, grid in enumerate(run.grids):
        index_of.setdefault(grid.tobytes(), index)
    maps = []
    for name, road_map in chosen:
        if road_map.codes.shape != run.grids.shape[1:]:
            expected, got = ("{} x {}".format(*shape) for shape in (run.grids.shape[1:], road_map.codes.shape))
            raise InputError(f"{run.name}/maps/{name}: expected a map of {expected}, as the archive's, got {got}")
        found = index_of.get(road_map.codes.tobytes())
        if found is not None:
            maps.append((found, name, road_map))
    return run._replace(maps=tuple(maps))


def _with_rides(run: _Finds, driven: Sequence[tuple[str, NDArray[np.int8], list[RecordedRide]]]) -> _Finds:
    found = [
        (int(index), ride)
        for _, grid, rides in driven
        if grid.shape == run.grids.shape[1:]
        for index in np.flatnonzero((run.grids == grid).all(axis=(1, 2)))
        for ride in rides
    ]
    return run._replace(rides=tuple(found))


def _by_size(maps: Sequence[tuple[str, RoadMap]]) -> list[_Finds]:
    sizes: dict[tuple[int, ...], list[tuple[str, RoadMap]]] = {}
    for name, road_map in maps:
        sizes.setdefault(road_map.codes.shape, []).append((name, road_map))
    finds = []
    for (height, width), listed in sizes.items():
        known = [road_map.fitness for _, road_map in listed if road_map.fitness is not None]
        whole = all(isinstance(value, int) for value in known)
        dtype = np.dtype(np.int32 if whole else np.float32)
        largest = 2**31 - 1 if whole else float(np.finfo(np.float32).max)
        fitness = np.array([min(max(value, -largest), largest) for value in known], dtype)
        finds.append(
            _Finds(
                name=f"maps of {height} x {width}" if len(sizes) > 1 else "maps",
                grids=np.stack([road_map.codes for _, road_map in listed]),
                fitness=fitness if len(known) == len(listed) else None,
                seed=np.zeros(len(listed), int),
                seeds=1,
                axes=tuned_axes((height, width)),
                weights=Weights()._asdict(),
                alphabet=None,
                usual_fitness=whole,
                labels=tuple(name for name, _ in listed),
                maps=tuple((index, name, road_map) for index, (name, road_map) in enumerate(listed)),
            )
        )
    return finds


def _distinct_names(names: Sequence[str]) -> list[str]:
    counts = [names[: index + 1].count(name) for index, name in enumerate(names)]
    return [name if count == 1 else f"{name} ({count})" for name, count in zip(names, counts, strict=True)]


def _find_tiles(folder: Path, run: _Finds) -> Path | None:
    """Returns the folder of a run's tile set, or None if no folder has a set of the recorded name; see `collect`."""
    tiles, recorded = _setting(run, "tiles"), run.record.get("tile_set")
    if not isinstance(tiles, str):
        return None
    name = recorded.get("name") if isinstance(recorded, dict) else None
    for parent in (Path(), *folder.absolute().parents):
        with suppress(InputError):  # another folder of this name
            if (parent / tiles).is_dir() and load_tiles(parent / tiles).name == name:
                return parent / tiles
    return None


def _setting(run: _Finds, name: str) -> Plain:
    settings = run.record.get("settings")
    return settings.get(name) if isinstance(settings, dict) else None


def _pack(runs: Sequence[_Finds], tiles: TileSet, tile_px: int, title: str) -> Payload:
    blob = Blob()
    cells = max(run.grids[0].size for run in runs)
    values = {
        "format": _FORMAT,
        "version": __version__,
        "title": title,
        "tiles": _tile_values(tiles, tile_px),
        "objects": _object_values(),
        "plan": plan_values(),
        # The first numbers that `choose_tiles` and `ObjectSet.choose` draw for seed 0.
        "lots": blob.add(np.random.default_rng(0).random(max(cells, _LEAST_LOTS)), "float64"),
        "runs": [_run_values(run, tiles, blob) for run in runs],
    }
    return Payload(values, blob.packed())


def _run_values(run: _Finds, tiles: TileSet, blob: Blob) -> dict[str, Plain]:
    return {
        "name": run.name,
        "shape": list(run.grids.shape[1:]),
        "seeds": run.seeds,
        "axes": [axis._asdict() for axis in run.axes],
        "weights": {name: int(weight) for name, weight in run.weights.items()},
        "alphabet": None if run.alphabet is None else sorted({int(code) for code in run.alphabet}),
        "grids": blob.add_codes(run.grids),
        "fitness": None if run.fitness is None else blob.add(run.fitness, run.fitness.dtype.name),
        "seed": blob.add(run.seed, "int32"),
        "niche": None if run.niche is None else blob.add(run.niche, "int32"),
        "features": {name: blob.add(values, "int32") for name, values in run.features.items()},
        "labels": run.labels,
        "maps": [_map_values(elite, name, road_map, tiles, blob) for elite, name, road_map in run.maps],
        "rides": [
            {"elite": elite, "goal": ride.goal, "success": ride.success, "poses": blob.add(ride.poses, "float32")}
            for elite, ride in run.rides
        ],
        "history": None if run.history is None else _history_values(run.history, blob),
        "usual_fitness": run.usual_fitness,
        "floors": None if run.floors is None else list(run.floors.items()),
        "record": run.record,
    }


def _map_values(elite: int, name: str, road_map: RoadMap, tiles: TileSet, blob: Blob) -> dict[str, Plain]:
    """Returns a chosen map: its elite, its objects, and its tile pictures as indices times 4 plus quarter turns."""
    chosen = recall_choice(road_map, tiles)
    pictures = None if chosen is None else (chosen[..., 0] * 4 + chosen[..., 1]).ravel().tolist()
    objects = road_map.objects and blob.add_json([object_values(thing) for thing in road_map.objects])
    return {"elite": elite, "name": name, "pictures": pictures, "objects": objects or None}


def _history_values(history: "History", blob: Blob) -> dict[str, Plain] | None:
    count = len(history.generation)
    if count == 0:
        return None
    steps = np.unique(np.linspace(0, count - 1, min(count, _MOST_STEPS)).round().astype(int))
    best, elites = (np.atleast_2d(values)[:, steps] for values in (history.best_fitness, history.elite_count))
    best = np.where(best == vacant_fitness(best.dtype), np.inf, best)
    return {
        "steps": len(steps),
        "evaluations": blob.add(history.evaluations[steps], "float64"),
        "best_fitness": blob.add(best, "float64"),
        "elite_count": blob.add(elites, "int32"),
    }


def _tile_values(tiles: TileSet, tile_px: int) -> dict[str, Plain]:
    """Returns each tile picture once, and whether the page blends them."""
    drawn, compared = _layers(tiles, tile_px), tiles.blend and tile_px != COMPARED_PX and _layers(tiles, COMPARED_PX)
    pictures: list[dict[str, Plain]] = [
        {"name": tile.name, "code": int(tile.code)} | drawn[index] | ({"compared": compared[index]} if compared else {})
        for index, tile in enumerate(tiles.pictures)
    ]
    rotations = {str(code): [4 * tile + turns for tile, turns in draws] for code, draws in tiles.rotations.items()}
    return {"name": tiles.name, "px": tile_px, "blend": tiles.blend, "pictures": pictures, "rotations": rotations}


def _layers(tiles: TileSet, tile_px: int) -> list[dict[str, Plain]]:
    """Returns each tile's picture as PNG, and its masks as bits of grey values, 1 road, 2 red, 4 yellow."""
    layers = scale_tiles(tiles, tile_px)
    found: list[dict[str, Plain]] = []
    for upright in range(0, 4 * len(tiles.pictures), 4):
        road, red, yellow = (layers[name][upright] > 0 for name in ("road", "red", "yellow"))
        masks = (road * 1 + red * 2 + yellow * 4).astype(np.uint8)
        found.append({"image": _data_url(layers["image"][upright]), "masks": _data_url(masks)})
    return found


def _object_values() -> dict[str, Plain]:
    """Returns the size of each kind of object, the tag numbers of signs, and the pictures of objects from above."""
    return {
        "kinds": dict(OBJECT_KINDS),
        "tags": dict(SIGN_TAGS),
        "pictures": {
            kind: [{"image": _data_url(one.top), "height": one.height, "footprint": one.footprint} for one in pictures]
            for kind, pictures in load_objects().kinds.items()
        },
    }


def plan_values() -> dict[str, Plain]:
    """Returns the tapes of each kind of tile, so that the page can write a plan."""
    kinds = {
        kind: {"code": code, "tapes": [[tape.colour, np.round(tape.points, 6).tolist()] for tape in tapes_of(kind, 0)]}
        for kind, code in REFERENCE.items()
    }
    return {"tile_size": TILE_SIZE, "longest": LONGEST_PLAN, "widths": dict(TAPE_WIDTHS), "kinds": kinds}


def _data_url(pixels: NDArray[np.uint8]) -> str:
    return "data:image/png;base64," + base64.b64encode(png_of(pixels)).decode()

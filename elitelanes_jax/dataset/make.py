"""From a specification to a dataset's folder, by several threads; killed at any moment, it continues."""

import json
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from pathlib import Path
from queue import SimpleQueue

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.atomic_io import write_atomic, write_json
from elitelanes_jax._util.checks import check_named, whole
from elitelanes_jax._util.cores import count_cores
from elitelanes_jax._util.errors import InputError, many
from elitelanes_jax._util.progress import Progress, announce
from elitelanes_jax._util.types import Plain
from elitelanes_jax._util.version import installed_versions
from elitelanes_jax.dataset._card import sample_sheet, write_card
from elitelanes_jax.dataset._formats import Format, find_format
from elitelanes_jax.dataset._given import GivenMaps, given
from elitelanes_jax.dataset._plan import Maps, evolve_maps, given_maps, split_maps
from elitelanes_jax.dataset._remove import place_for
from elitelanes_jax.dataset._samples import draw_sample, write_sample
from elitelanes_jax.dataset._tile_splits import check_given, digest, tiles_by_split
from elitelanes_jax.dataset._work import LAST, WORK, work_folder
from elitelanes_jax.dataset.spec import SPLITS, DatasetSpec, maps_by_shape
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.maps.cluster import run_on
from elitelanes_jax.maps.generation import drawable
from elitelanes_jax.tiles.rendering import LABEL_COLOURS, LABELS, png_of
from elitelanes_jax.tiles.tileset import TileSet, load_tiles

_ON_SHEET = 12

_PICTURES_A_JOB = 64


def make_dataset(
    spec: DatasetSpec,
    out: str | Path,
    *,
    workers: int | None = None,
    force: bool = False,
    maps: Sequence[RoadMap] | None = None,
    executor: Executor | None = None,
) -> dict[str, Plain]:
    """Evolves maps, draws them, and writes them as a dataset.

    A run that was killed continues where it was when it is started again; the same specification gives the same files,
    byte for byte, whatever the number of workers and however often it was killed.

    Args:
      spec: of the dataset.
      out: the folder: new, empty, or one that was begun with the same specification.
      workers: threads that draw; by default one for each core (see `use_cores`).
      force: whether another dataset in the folder is replaced once this one is complete, unless anything else is in it.
        Until then there has to be room for both.
      maps: to be drawn as they are in place of evolved ones: as many as the specification says, of its sizes.
      executor: whose workers search and draw in place of this process, such as `cluster.dask_executor`; they share the
        disk with it.

    Returns:
      The record in ``dataset.json``.

    Raises:
      InputError: for constraints that no map can meet, given maps beside those of the specification or that cannot be
        drawn, a bad tile set, or a folder that is anything else.
      NotEnoughMapsError: if the searches give too few maps.
      OSError: if a file cannot be written, or a worker fails; it names it. What was complete stays, and the next run
        continues.
    """
    out = Path(out)
    workers = count_cores() if workers is None else check_named("workers", whole(1), workers)
    layout = find_format(spec.format)
    tiles = load_tiles(spec.tiles, blend=spec.blend)
    if spec.maps_from is not None and maps is not None:
        raise InputError("maps: expected none beside the specification's maps_from")
    own = spec.maps_from if maps is None else given(maps)
    if own is not None:
        check_given(spec, own.maps, tiles)
    by_split = tiles_by_split(tiles, spec)
    search = drawable(spec.search, tiles)
    if own is None:
        spec.check_search()
        for shape, count in maps_by_shape(spec).items():
            search.count_maps(shape, count)
    identity = _identity(spec, tiles, own)
    with place_for(out, identity, force=force) as place:
        with work_folder(place, identity) as work:
            if work is not None:
                views = many(spec.views, "view")
                announce(f"making a dataset of {many(spec.maps, 'map')} of {_sizes(spec)} tiles, {views} each")
                if own is not None and own.repeated:
                    which = "that is another one" if own.repeated == 1 else "that are others"
                    announce(f"left out {many(own.repeated, 'map')} {which} rotated or mirrored")
                found = evolve_maps(spec, search, work, executor) if own is None else given_maps(own.maps, work)
                splits = np.repeat(split_maps(spec, found, by_split[2]), spec.views)
                if executor is not None:
                    _draw_on_workers(executor, place.absolute(), spec, found, splits)
                _draw_samples(place, work / "records", spec, found, splits, by_split, workers)
                _finish(place, work / "records", splits, layout, identity)
        about: dict[str, Plain] = json.loads((place / LAST).read_text(encoding="utf-8"))
    return about


def _sizes(spec: DatasetSpec) -> str:
    first, last = ("{} x {}".format(*shape) for shape in (spec.shapes[0], spec.shapes[-1]))
    return first if first == last else f"{first} to {last}"


def _identity(spec: DatasetSpec, tiles: TileSet, own: GivenMaps | None) -> dict[str, Plain]:
    """Returns all that the files depend on, plain values for JSON."""
    plain = spec.to_plain() | {"tile_px": spec.pixels}
    del plain["tiles"], plain["maps_from"]  # the pictures and the maps count, not their places
    about = {name: getattr(tiles, name) for name in ("name", "licence", "layers", "points", "blend")} | {
        "tiles": digest(tiles)
    }
    given_maps = None if own is None else own.digest
    identity = {"settings": plain, "given_maps": given_maps, "tile_set": about, "versions": installed_versions()}
    return json.loads(json.dumps(identity))


def _record_file(records: Path, number: int) -> Path:
    return records / f"{number // 1000:03d}" / f"{number:06d}.json"


def _draw_on_workers(executor: Executor, place: Path, spec: DatasetSpec, maps: Maps, splits: NDArray[np.int_]) -> None:
    """Draws the samples that have no record yet on an executor's workers."""
    records = place / WORK / "records"
    waiting = [number for number in range(len(splits)) if not _record_file(records, number).exists()]
    spec = spec.replace(tiles=spec.tiles and spec.tiles.absolute(), maps_from=None)
    rounds = [file.absolute() for file in maps.rounds]
    jobs = {
        f"pictures {share[0]} to {share[-1]}": (place, spec, rounds, {each: int(splits[each]) for each in share})
        for share in (waiting[first : first + _PICTURES_A_JOB] for first in range(0, len(waiting), _PICTURES_A_JOB))
    }
    with Progress("drawing", len(splits), "pictures", done=len(splits) - len(waiting)) as bar:
        run_on(executor, _draw_share, jobs, bar.count)


def _draw_share(place: Path, spec: DatasetSpec, rounds: Sequence[Path], splits: dict[int, int]) -> int:
    """Draws the samples of some numbers on a worker, each with its split; returns how many."""
    tiles = tiles_by_split(load_tiles(spec.tiles, blend=spec.blend), spec)
    maps = Maps(rounds)
    with _one_thread_each():
        for number, split in splits.items():
            _draw(place, place / WORK / "records", spec, maps, tiles[split], number, split)
    return len(splits)


def _draw_samples(
    place: Path,
    records: Path,
    spec: DatasetSpec,
    maps: Maps,
    splits: NDArray[np.int_],
    tiles: Sequence[TileSet],
    workers: int,
) -> None:
    """Draws and writes the samples that have no record yet."""

    def draw(number: int) -> None:
        split = int(splits[number])
        _draw(place, records, spec, maps, tiles[split], number, split)

    waiting = [number for number in range(len(splits)) if not _record_file(records, number).exists()]
    _draw_all(draw, waiting, len(splits), workers)


def _draw(place: Path, records: Path, spec: DatasetSpec, maps: Maps, tiles: TileSet, number: int, split: int) -> None:
    """Draws and writes one sample; its record is written last."""
    layout = find_format(spec.format)
    sample = draw_sample(
        maps[number // spec.views],
        tiles,
        number,
        seed=spec.seed,
        tile_px=spec.pixels,
        transforms=spec.transforms,
        camera=spec.camera,
        layers=layout.layers,
    )
    write_sample(sample, layout, split, place)
    note = layout.note(sample.layers["labels"])
    write_atomic(_record_file(records, number), json.dumps(sample.record | note).encode())


def _draw_all(draw: Callable[[int], None], waiting: Sequence[int], total: int, workers: int) -> None:
    """Draws the waiting samples in threads: they run side by side, as pictures are warped outside of Python.

    The main thread waits at a simple queue, which an interruption leaves intact. A lock written in Python, as those of
    `concurrent.futures` are, may stay locked when the interruption falls between taking and releasing it; the threads
    would wait for it for ever.
    """
    numbers: SimpleQueue[int | None] = SimpleQueue()
    outcomes: SimpleQueue[BaseException | None] = SimpleQueue()
    stopped = False

    def work() -> None:
        while (number := numbers.get()) is not None and not stopped:
            try:
                draw(number)
            except BaseException as error:
                outcomes.put(error)
            else:
                outcomes.put(None)

    threads = [threading.Thread(target=work, daemon=True) for _ in range(min(workers, len(waiting)))]
    with Progress("drawing", total, "pictures", done=total - len(waiting)) as bar, _one_thread_each():
        try:
            for thread in threads:
                thread.start()
            for number in waiting:  # not before all threads run: one whose start is interrupted may hang
                numbers.put(number)
            for _ in waiting:
                error = outcomes.get()
                if error is not None:
                    raise error
                bar.count()
        finally:
            stopped = True
            for _ in threads:
                numbers.put(None)
            for thread in threads:
                if thread.is_alive():  # one whose start was interrupted is not, and has nothing to draw
                    thread.join()


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Turns OpenCV's own threads off, which would slow the workers down."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def _finish(out: Path, records: Path, splits: NDArray[np.int_], layout: Format, identity: dict[str, Plain]) -> None:
    """Writes the files that describe the samples, the record of the whole last."""

    def read(number: int) -> dict[str, Plain]:
        return json.loads(_record_file(records, number).read_text(encoding="utf-8"))

    pixels = {name: np.zeros(len(LABELS), np.int64) for name in SPLITS}

    def count_pixels(split: int) -> Iterator[dict[str, Plain]]:
        for number in np.flatnonzero(splits == split).tolist():
            record = read(number)
            pixels[SPLITS[split]] += record["class_pixels"]
            yield record

    for split in np.unique(splits).tolist():
        layout.list_samples(out, split, count_pixels(split))
    about = identity | {
        "pictures": {name: int((splits == split).sum()) for split, name in enumerate(SPLITS)},
        "classes": [
            {"label": place, "name": name, "colour": colour}
            for place, (name, colour) in enumerate(zip(LABELS, LABEL_COLOURS, strict=True))
        ],
        "class_pixels": {name: counts.tolist() for name, counts in pixels.items()},
    }
    write_atomic(out / "README.md", write_card(about, layout.loading(int(splits.min()))).encode())
    count = min(_ON_SHEET, len(splits))
    shown = [read(place * len(splits) // count) for place in range(count)]
    title = f"{count} of {len(splits)} pictures"
    camera = identity["settings"]["camera"]
    shape = camera["rows"] / camera["columns"] if camera else 1
    sheet = sample_sheet(out, [_on_sheet(record, splits, layout) for record in shown], title, shape)
    write_atomic(out / "contact-sheet.png", png_of(sheet))
    write_json(out / LAST, about)


def _on_sheet(record: dict[str, Plain], splits: NDArray[np.int_], layout: Format) -> tuple[str, str, tuple[str, ...]]:
    number = record["number"]
    split = int(splits[number])
    height, width = record["size"]
    figures = record.get("metrics", {})
    return (
        layout.file(split, number, "image"),
        layout.file(split, number, "labels"),
        (
            f"{number:06d}, {SPLITS[split]}, {height} x {width} tiles",
            ", ".join(f"{name} {figures[name]}" for name in ("cyclomatic", "crossings", "bridges") if name in figures),
        ),
    )

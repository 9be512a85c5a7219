"""From settings to a dataset's folder, by several threads, at any moment ready to be killed and gone on with."""

import json
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.checks import check_count
from elitelanes_jax.dataset.card import card, contact_sheet
from elitelanes_jax.dataset.formats import SPLITS, Format, format_named
from elitelanes_jax.dataset.plan import evolve_maps, given_maps, split_maps
from elitelanes_jax.dataset.samples import draw_sample, write_sample
from elitelanes_jax.dataset.settings import Settings, check_given, checked, digest, tiles_by_split
from elitelanes_jax.dataset.work import LAST, work_folder
from elitelanes_jax.folders import write_whole
from elitelanes_jax.progress import counter
from elitelanes_jax.render import LABEL_COLOURS, LABELS, png_of
from elitelanes_jax.roadmap import RoadMap, to_json
from elitelanes_jax.tilesets import TileSet, load_tiles
from elitelanes_jax.versions import versions
from elitelanes_jax.wishes import read_wishes

__all__ = ["make_dataset"]

_ON_SHEET = 12


def make_dataset(
    settings: Settings, out: str | Path, *, workers: int | None = None, maps: Sequence[RoadMap] | None = None
) -> dict[str, Any]:
    """Evolves maps, draws them, and writes them as a dataset.

    A run that was killed goes on where it was when it is started again; the same settings give the same files, byte for
    byte, whatever the number of workers and however often it was killed.

    Args:
      settings: what to make.
      out: the folder: new, empty, or one that was begun with the same settings.
      workers: threads that draw; by default as many as there are processors.
      maps: to be drawn in place of evolved ones: as many as settings say, square, of sizes within theirs.

    Returns:
      The record in ``dataset.json``.

    Raises:
      InputError: for settings out of their range, a bad tile set, or a folder that is anything else.
      NotEnoughMapsError: if the searches give too few maps.
      OSError: if a file cannot be written; it names the file. What was complete stays, and is gone on from.
    """
    settings, out = checked(settings), Path(out)
    if workers is not None:
        check_count("make_dataset", "workers", workers)
    layout = format_named(settings.format)
    tiles = load_tiles(settings.tiles)
    if maps is not None:
        check_given(settings, maps, tiles)
    by_split = tiles_by_split(tiles, settings)
    for side in settings.size:
        read_wishes(settings.wishes, (side, side))
    identity = _identity(settings, tiles, maps)
    with work_folder(out, identity) as work:
        if work is not None:
            found = evolve_maps(settings, tiles, work) if maps is None else given_maps(maps, work)
            splits = np.repeat(split_maps(settings, found, by_split[2]), settings.views)
            records = work / "records"

            def draw(number: int) -> None:
                split = int(splits[number])
                sample = draw_sample(
                    found[number // settings.views],
                    by_split[split],
                    number,
                    seed=settings.seed,
                    tile_px=settings.tile_px,
                    transforms=settings.transforms,
                    layers=layout.layers,
                )
                write_sample(sample, layout, split, out)
                note = layout.note(sample.layers["labels"])
                write_whole(_record_file(records, number), json.dumps(sample.record | note).encode())

            waiting = [number for number in range(len(splits)) if not _record_file(records, number).exists()]
            _draw_all(draw, waiting, len(splits), workers or len(os.sched_getaffinity(0)))
            _finish(out, records, splits, layout, identity)
    about: dict[str, Any] = json.loads((out / LAST).read_text(encoding="utf-8"))
    return about


def _identity(settings: Settings, tiles: TileSet, maps: Sequence[RoadMap] | None) -> dict[str, Any]:
    """All that the files depend on, plain values for JSON."""
    wishes, views = settings.wishes._asdict(), settings.transforms._asdict()
    if settings.wishes.fix is not None:
        wishes["fix"] = json.loads(settings.wishes.fix.read_text(encoding="utf-8"))
    plain = settings._asdict() | {"transforms": views, "wishes": wishes}
    del plain["tiles"]  # what counts is not where they are, but what they show
    given = None if maps is None else sha256("".join(map(to_json, maps)).encode()).hexdigest()[:16]
    about = {name: getattr(tiles, name) for name in ("name", "licence", "layers", "points")} | {"tiles": digest(tiles)}
    identity = {"settings": plain, "given_maps": given, "tile_set": about, "versions": versions()}
    return json.loads(json.dumps(identity))


def _record_file(records: Path, number: int) -> Path:
    return records / f"{number // 1000:03d}" / f"{number:06d}.json"


def _draw_all(draw: Callable[[int], None], waiting: Sequence[int], total: int, workers: int) -> None:
    """Draws what is waiting. Pictures are warped and packed outside of Python, so that threads run side by side.

    The main thread waits at a simple queue alone, which an interruption leaves in order; condition variables, which
    `concurrent.futures` waits at, it may leave locked.
    """
    numbers: SimpleQueue[int | None] = SimpleQueue()
    outcomes: SimpleQueue[BaseException | None] = SimpleQueue()
    stopped = threading.Event()
    for number in (*waiting, *[None] * workers):
        numbers.put(number)

    def work() -> None:
        while (number := numbers.get()) is not None and not stopped.is_set():
            try:
                draw(number)
            except BaseException as error:
                outcomes.put(error)
            else:
                outcomes.put(None)

    threads = [threading.Thread(target=work, daemon=True) for _ in range(workers)]
    with counter("drawing", total, "pictures", done=total - len(waiting)) as bar, _one_thread_each():
        for thread in threads:
            thread.start()
        try:
            for _ in waiting:
                error = outcomes.get()
                if error is not None:
                    raise error
                bar.update(1)
        finally:
            stopped.set()
            for thread in threads:
                thread.join()


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """OpenCV's own threads would stand in the workers' way."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def _finish(out: Path, records: Path, splits: NDArray[np.int_], layout: Format, identity: dict[str, Any]) -> None:
    """Writes all that tells of the samples, the record of the whole last."""

    def read(number: int) -> dict[str, Any]:
        return json.loads(_record_file(records, number).read_text(encoding="utf-8"))

    pixels = {name: np.zeros(len(LABELS), np.int64) for name in SPLITS}

    def counted(split: int) -> Iterator[dict[str, Any]]:
        for number in np.flatnonzero(splits == split).tolist():
            record = read(number)
            pixels[SPLITS[split]] += record["class_pixels"]
            yield record

    for split in np.unique(splits).tolist():
        layout.list_samples(out, split, counted(split))
    about = identity | {
        "pictures": {name: int((splits == split).sum()) for split, name in enumerate(SPLITS)},
        "classes": [
            {"label": place, "name": name, "colour": colour}
            for place, (name, colour) in enumerate(zip(LABELS, LABEL_COLOURS, strict=True))
        ],
        "class_pixels": {name: counts.tolist() for name, counts in pixels.items()},
    }
    write_whole(out / "README.md", card(about, layout.loading(int(splits.min()))).encode())
    count = min(_ON_SHEET, len(splits))
    shown = [read(place * len(splits) // count) for place in range(count)]
    title = f"{count} of {len(splits)} pictures"
    sheet = contact_sheet(out, [_on_sheet(record, splits, layout) for record in shown], title)
    write_whole(out / "contact-sheet.png", png_of(sheet))
    write_whole(out / LAST, json.dumps(about, indent=2).encode() + b"\n")


def _on_sheet(record: dict[str, Any], splits: NDArray[np.int_], layout: Format) -> tuple[str, str, tuple[str, ...]]:
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

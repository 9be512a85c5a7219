"""Draws the samples of a dataset, and keeps what is drawn.

Samples are drawn in threads here or on the workers of an executor.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple, Self
from zlib import crc32

import cv2
import numpy as np

from elitelanes_jax._util.checks import check_named
from elitelanes_jax._util.engine import Pool, call_on_workers, part_with
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.files import new_file, write_atomic
from elitelanes_jax._util.folders import Unfinished, remove
from elitelanes_jax._util.progress import Progress
from elitelanes_jax._util.threads import count_cores, side_by_side
from elitelanes_jax.dataset._fields import Contents, add_metrics
from elitelanes_jax.dataset._layouts import Layout, find_layout, write_sample
from elitelanes_jax.dataset._records import Block, Samples, record_line
from elitelanes_jax.dataset._samples import Sample, SampleSettings
from elitelanes_jax.dataset._sampling import Drawer, make_drawer
from elitelanes_jax.dataset.planning import PlannedDataset
from elitelanes_jax.dataset.tables import SampleRecord
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.maps.furnishing.placing import furnish
from elitelanes_jax.maps.furnishing.spec import FurnishSpec
from elitelanes_jax.tiles.packed import Pictures

# The most pictures of a part for an executor. They are work of a second or more, and some megabytes
# that return.
_PICTURES_A_PART = 250


@dataclass(frozen=True)
class Drawing:
    """What samples are drawn from.

    Attributes:
      settings: what all samples have in common.
      views: the number of samples of each map.
      furnish: what is placed on the map of each sample; None to keep the maps' objects.
      format: the name of the layout.
      contents: what the samples have in their records.
      maps: the maps by their indices in the dataset.
      names: what messages call the maps, if they are given.
    """

    settings: SampleSettings
    views: int
    furnish: FurnishSpec | None
    format: str
    contents: Contents
    maps: Mapping[int, RoadMap]
    names: Sequence[str] = ()

    @classmethod
    def of_maps(cls, plan: PlannedDataset, maps: Sequence[RoadMap]) -> Self:
        """Returns what the samples of a planned dataset are drawn from."""
        spec = plan.spec
        settings = SampleSettings(
            Pictures(plan.tiles, plan.objects), spec.seed, spec.pixels, spec.ranges, spec.camera
        )
        metrics: dict[str, bool] = {}
        for road_map in maps:
            add_metrics(metrics, road_map.metrics)
        contents = Contents(metrics, spec.camera is not None, plan.objects is not None)
        numbered = dict(enumerate(maps))
        names = () if spec.maps_from is None else spec.maps_from.names
        return cls(settings, spec.views, spec.furnish, spec.format, contents, numbered, names)

    @property
    def layout(self) -> Layout:
        """The layout of the dataset."""
        return find_layout(self.format)

    def groups(self, indices: Sequence[int]) -> list[Sequence[int]]:
        """Divides samples into groups that are drawn together."""
        most = self._drawer.at_once
        return [indices[start : start + most] for start in range(0, len(indices), most)]

    def draw(self, indices: Sequence[int]) -> list[Sample]:
        """Draws the samples of a group."""
        return self._drawer.draw([self._map_of(index) for index in indices], indices)

    @cached_property
    def _drawer(self) -> Drawer:
        return make_drawer(self.settings, self.maps.values())

    def _map_of(self, index: int) -> RoadMap:
        """Returns the map of a sample, furnished for the sample."""
        number, settings = index // self.views, self.settings
        if self.furnish is None:
            return self.maps[number]
        # Each view of a map has objects of its own, from the seed of the dataset and the index of
        # the sample.
        seed = int(np.random.SeedSequence([settings.seed, index]).generate_state(1)[0])
        place = partial(
            furnish, spec=self.furnish, seed=seed, lane_offset=settings.tiles.lane_offset
        )
        name = self.names[number] if self.names else f"map {number}"
        return check_named(f"furnish: {name}", place, self.maps[number])


def draw_missing(
    drawing: Drawing, samples: Samples, work: Unfinished, workers: int, pool: Pool | None
) -> None:
    """Draws the samples that no earlier run has drawn, here or on the pool.

    Raises:
      InputError: if objects do not fit a map. Then all pictures are deleted.
    """
    samples.leave_out_damaged(drawing.layout)
    with Progress("drawing", samples.total, "pictures", done=samples.count_drawn()) as bar:
        try:
            if pool is None:
                for block in samples.blocks():
                    if indices := block.missing():
                        _draw_block(drawing, block, indices, samples.files, workers, bar.count)
            else:
                _draw_on(pool, drawing, samples, bar.count)
        except InputError:
            # The maps can be drawn with other objects.
            delete_pictures(work)
            raise


def delete_pictures(work: Unfinished) -> None:
    """Deletes the pictures so far, and keeps the maps.

    A picture with a record counts as drawn, so records go first.
    """
    for entry in (work.kept / "records", *work.files.iterdir(), work.kept / "pictures.json"):
        remove(entry)


def draw_again(
    drawing: Drawing, indices: Sequence[int], samples: Samples, layout: Layout, folder: Path
) -> None:
    """Draws samples of shards again as files of another layout."""
    for group in drawing.groups(indices):
        for index, sample in zip(group, drawing.draw(group), strict=True):
            write_sample(sample, layout, samples.split_of(index), folder)


Ended = Callable[[int], object]
"""Called with the number of samples that were drawn."""


def _draw_on(pool: Pool, drawing: Drawing, samples: Samples, ended: Ended) -> None:
    """Draws the missing samples on an executor's workers, and writes the files that return."""
    # Samples that are drawn already are no part of any task.
    tasks = _tasks(pool, drawing, samples)
    # Each task has the maps that it draws.
    common = replace(drawing, maps={})
    # Workers use the layout's package, so its version has to be the same there.
    needs = drawing.layout.needs
    packages = () if needs is None else (needs,)
    for number, (files, records) in call_on_workers(
        pool.executor, partial(_draw_task, common), tasks, packages
    ):
        # Records are written last, because a sample with a record counts as drawn.
        for name, content in files.items():
            write_atomic(samples.files / name, content)
        for portion, lines in zip(tasks[number].portions, records, strict=True):
            # The first records of a run come before their folder exists.
            portion.block.records.parent.mkdir(parents=True, exist_ok=True)
            with portion.block.records.open("ab") as stream:
                stream.write(lines)
            ended(len(portion.indices))


class _Portion(NamedTuple):
    """Some of the samples of a block.

    Attributes:
      block: the block that the samples belong to.
      indices: the indices of the samples in the dataset, in order.
    """

    block: Block
    indices: list[int]


class _Task(NamedTuple):
    """What one call on a worker draws.

    Attributes:
      maps: the maps of the samples, by their indices in the dataset.
      portions: the samples to draw, block by block.
    """

    maps: dict[int, RoadMap]
    portions: list[_Portion]


def _tasks(pool: Pool, drawing: Drawing, samples: Samples) -> list[_Task]:
    """Divides the samples evenly into parts.

    Returns the missing samples of each part that lacks any. A shard is of one part.
    """
    # There are at most as many parts as maps, because each part is sent its maps.
    count = pool.parts_for(-(-samples.total // _PICTURES_A_PART), len(samples.maps))
    has_shards = drawing.layout.open_shard is not None
    parts: list[list[_Portion]] = [[] for _ in range(count)]
    position = 0
    for block in samples.blocks():
        missing = set(block.missing())
        by_part: dict[int, list[int]] = {}
        for offset, index in enumerate(block.indices):
            if index in missing:
                # A shard goes to the part of its first sample, and other samples to their own part.
                part = part_with(
                    samples.total, position if has_shards else position + offset, count
                )
                by_part.setdefault(part, []).append(index)
        for part, indices in by_part.items():
            parts[part].append(_Portion(block, indices))
        # The position counts drawn samples too, so that a resumed run has the same parts.
        position += len(block.indices)
    tasks = []
    for portions in filter(None, parts):
        numbers = {index // drawing.views for portion in portions for index in portion.indices}
        maps = {number: drawing.maps[number] for number in sorted(numbers)}
        tasks.append(_Task(maps, portions))
    return tasks


def _draw_task(common: Drawing, task: _Task) -> tuple[dict[str, bytes], list[bytes]]:
    """Runs on a worker: draws samples in a temporary folder.

    Returns:
      The content of each file, by its path in the dataset, and the lines of the records of each
      portion.
    """
    drawing = replace(common, maps=task.maps)
    records = []
    with TemporaryDirectory() as folder:
        files = Path(folder, "files")
        for number, portion in enumerate(task.portions):
            # The records of the folder are on another machine. Those of the task get a file here.
            block = portion.block._replace(records=Path(folder, f"records-{number}"))
            _draw_block(drawing, block, portion.indices, files, count_cores(), lambda _: None)
            records.append(block.records.read_bytes())
        # The folder is temporary, so the files return with their contents.
        contents = {}
        for file in files.rglob("*"):
            if file.is_file():
                contents[file.relative_to(files).as_posix()] = file.read_bytes()
    return contents, records


def _draw_block(
    drawing: Drawing, block: Block, indices: list[int], files: Path, workers: int, ended: Ended
) -> None:
    """Draws samples of a block, in threads."""
    draw = _draw_pictures if drawing.layout.open_shard is None else _draw_shard
    with _one_thread_each():
        draw(drawing, block, indices, files, workers, ended)


def _draw_pictures(
    drawing: Drawing, block: Block, indices: list[int], files: Path, workers: int, ended: Ended
) -> None:
    """Draws samples as files, each of which is followed by its record."""
    layout = drawing.layout
    block.records.parent.mkdir(parents=True, exist_ok=True)

    def draw(group: Sequence[int]) -> list[bytes]:
        lines = []
        for index, sample in zip(group, drawing.draw(group), strict=True):
            checksum = write_sample(sample, layout, block.split, files)
            lines.append(record_line(index, sample.record | layout.note(sample), checksum))
        return lines

    with block.records.open("ab") as records:
        # Only the thread that writes the file calls this function, so lines do not mix.
        def complete(lines: list[bytes]) -> None:
            records.writelines(lines)
            ended(len(lines))

        side_by_side(
            (partial(draw, group) for group in drawing.groups(indices)),
            workers=workers,
            ended=complete,
        )


def _draw_shard(
    drawing: Drawing, block: Block, indices: list[int], files: Path, workers: int, ended: Ended
) -> None:
    """Draws a block as a shard, which is written whole or not at all.

    The records of its samples are written last.
    """
    layout, records = drawing.layout, []
    assert layout.open_shard is not None
    # Threads end in any order, but a shard has its samples in order. Samples that are drawn before
    # an earlier one wait here. They are of about as many groups as workers.
    waiting: dict[int, tuple[dict[str, bytes], SampleRecord]] = {}
    following = iter(indices)

    def draw(group: Sequence[int]) -> None:
        for index, sample in zip(group, drawing.draw(group), strict=True):
            waiting[index] = sample.pictures(), sample.record

    shard = files / layout.shard_file(block.split, block.number, block.total)
    with new_file(shard) as part:
        part.parent.mkdir(parents=True, exist_ok=True)
        with layout.open_shard(part, drawing.contents) as write:
            # This is the sample that the shard needs next.
            due = next(following)

            def complete(_: None) -> None:
                nonlocal due
                while due in waiting:
                    pictures, record = waiting.pop(due)
                    write(pictures, record)
                    records.append((due, record))
                    ended(1)
                    # No sample has the index -1, so nothing waits after the last one.
                    due = next(following, -1)

            side_by_side(
                (partial(draw, group) for group in drawing.groups(indices)),
                workers=workers,
                ended=complete,
            )
    checksum = crc32(shard.read_bytes())
    write_atomic(block.records, [record_line(*record, checksum) for record in records])


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Turns OpenCV's own threads off, because they slow the workers down."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)

"""The samples of a dataset on disk: their records, in blocks, and the files that belong to them."""

import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.files import write_atomic
from elitelanes_jax._util.sums import read_sealed_lines, sealed_line
from elitelanes_jax.dataset._layouts import Layout
from elitelanes_jax.dataset._samples import layer_names
from elitelanes_jax.dataset.tables import SampleRecord
from elitelanes_jax.maps.spec import SPLITS

# The most samples that are listed at once, and that share a file of records or a shard.
_BLOCK = 1000


class Block(NamedTuple):
    """At most `_BLOCK` samples of one split.

    Attributes:
      split: an index in `SPLITS`.
      number: the index of the block in its split, from 0.
      total: the number of blocks in the split.
      indices: the indices of the samples in the dataset, in order.
      records: the file with a line for each sample, see `record_line`. A sample is complete when
        its line is written. A run that is killed may leave a part of a line at the end.
    """

    split: int
    number: int
    total: int
    indices: list[int]
    records: Path

    def read_records(self) -> "dict[int, _Record]":
        """Reads the records so far, by the samples' indices."""
        if not self.records.exists():
            return {}
        records = {}
        for line in read_sealed_lines(self.records.read_bytes()):
            index, checksum, content = line.split(b"\t", 2)
            records[int(index)] = _Record(int(checksum, 16), content)
        return records

    def missing(self) -> list[int]:
        """Returns the indices of the samples that are not drawn yet."""
        drawn = self.read_records()
        return [index for index in self.indices if index not in drawn]

    def leave_out_damaged(self, layout: Layout, files: Path) -> None:
        """Removes the records of samples whose files are missing or damaged, and damaged lines.

        After a loss of power, a file whose record is written may still be empty.
        """
        if not self.records.exists():
            return
        if layout.open_shard is None:
            records = {
                index: record
                for index, record in self.read_records().items()
                if _checksum_of(self._pictures(index, record, layout, files)) == record.checksum
            }
        else:
            records = self.read_records()
            shard = _checksum_of([files / layout.shard_file(self.split, self.number, self.total)])
            is_complete = len(records) == len(self.indices)
            # A shard is drawn whole or not at all.
            if not is_complete or any(record.checksum != shard for record in records.values()):
                records = {}
        lines = [_line(index, *record) for index, record in records.items()]
        if b"".join(lines) != self.records.read_bytes():
            write_atomic(self.records, lines)

    def _pictures(
        self, index: int, record: "_Record", layout: Layout, files: Path
    ) -> Iterator[Path]:
        """Yields the pictures of a sample, in the order in which `write_sample` writes them."""
        has_objects = "objects" in json.loads(record.content)
        for layer in layer_names(has_objects=has_objects):
            yield files / layout.file(self.split, index, layer)


class _Record(NamedTuple):
    """The record of a sample that is drawn.

    Attributes:
      checksum: the checksum of the files that have the sample.
      content: the record as JSON.
    """

    checksum: int
    content: bytes


def _checksum_of(files: Iterable[Path]) -> int | None:
    """Returns the checksum of files in this order, or None if one is missing."""
    checksum = 0
    for file in files:
        try:
            checksum = crc32(file.read_bytes(), checksum)
        except FileNotFoundError:
            return None
    return checksum


class Samples(NamedTuple):
    """The samples of a dataset, or of a part of its maps, on disk.

    Attributes:
      views: the number of samples of each map.
      splits: int ``[maps]``, the split of each map of the dataset.
      maps: the indices of the maps whose samples these are.
      files: the folder for the pictures.
      records: the folder for the records.
    """

    views: int
    splits: NDArray[np.int_]
    maps: range
    files: Path
    records: Path

    @property
    def total(self) -> int:
        """The number of samples."""
        return len(self.maps) * self.views

    def blocks(self) -> Iterator[Block]:
        """Yields the samples, some at a time: a list of all may not fit into memory."""
        for split in range(len(SPLITS)):
            yield from self.blocks_of(split)

    def blocks_of(self, split: int) -> Iterator[Block]:
        """Yields the samples of a split, in order."""
        maps = self._maps_of(split)
        for number in range(self._count_blocks(maps)):
            yield self._block(split, maps, number)

    def _maps_of(self, split: int) -> NDArray[np.int_]:
        # The maps of a part are a range, and those of the split are among them.
        first = self.maps.start
        maps: NDArray[np.int_] = self.splits[first : self.maps.stop] == split
        return first + np.flatnonzero(maps)

    def _count_blocks(self, maps: NDArray[np.int_]) -> int:
        # The last block may have fewer samples.
        return -(-len(maps) * self.views // _BLOCK)

    def _block(self, split: int, maps: NDArray[np.int_], number: int) -> Block:
        """Returns a block of a split with these maps."""
        views = self.views
        start = number * _BLOCK
        positions = range(start, min(start + _BLOCK, len(maps) * views))
        # A map has its views at neighbouring indices, so the index follows from the map and the
        # view.
        indices = [
            int(maps[position // views]) * views + position % views for position in positions
        ]
        records = self.records / f"{SPLITS[split]}-{number}.jsonl"
        return Block(split, number, self._count_blocks(maps), indices, records)

    def split_of(self, index: int) -> int:
        """Returns the split of a sample."""
        return int(self.splits[index // self.views])

    def read_split(self, split: int) -> Iterator[SampleRecord]:
        """Reads the records of a split's samples, in order."""
        for block in self.blocks_of(split):
            records = block.read_records()
            for index in block.indices:
                yield json.loads(records[index].content)

    def write_split(self, split: int, records: Iterable[SampleRecord]) -> None:
        """Writes the records of a split's samples, which come in order."""
        # The records come in the order of the blocks, so each block takes as many as it has
        # samples.
        following = iter(records)
        for block in self.blocks_of(split):
            write_atomic(
                block.records, [record_line(index, next(following)) for index in block.indices]
            )

    def count_drawn(self) -> int:
        """Counts the samples that an earlier run has drawn."""
        # Each line is a sample. An incomplete last line has no line break.
        return sum(file.read_bytes().count(b"\n") for file in self.records.glob("*.jsonl"))

    def leave_out_damaged(self, layout: Layout) -> None:
        """Makes samples count as missing if an earlier run left damaged files of them."""
        # A dataset may have millions of blocks without a record.
        for records in self.records.glob("*.jsonl"):
            name, number = records.stem.rsplit("-", 1)
            split = SPLITS.index(name)
            block = self._block(split, self._maps_of(split), int(number))
            block.leave_out_damaged(layout, self.files)


def record_line(index: int, record: SampleRecord, checksum: int = 0) -> bytes:
    """Returns the line of a sample in the records of its block.

    It has a checksum of its own, the index, the checksum of the sample's files and the record. Only
    an unfinished dataset needs `checksum`.
    """
    return _line(index, checksum, json.dumps(record).encode())


def _line(index: int, checksum: int, content: bytes) -> bytes:
    return sealed_line(b"%d\t%08x\t%s" % (index, checksum, content))

"""Joins the parts of a dataset, which `make_dataset` made with `DatasetSpec(part=...)`."""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, path, paths
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.folders import output_folder
from elitelanes_jax._util.packages import installed_versions
from elitelanes_jax._util.progress import Progress
from elitelanes_jax._util.sums import SUMS, read_checked, read_sums
from elitelanes_jax.dataset._finishing import finish
from elitelanes_jax.dataset._layouts import PART, RECORD, Layout, find_layout, foreign_to_dataset
from elitelanes_jax.dataset._records import Samples
from elitelanes_jax.dataset._samples import layer_names
from elitelanes_jax.dataset.tables import (
    DatasetRecord,
    DatasetSettings,
    SampleRecord,
    read_dataset_record,
)
from elitelanes_jax.maps.parts import order_parts
from elitelanes_jax.maps.spec import SPLITS, parse_part


@name_wrong_arguments
def merge_dataset(
    parts: str | Path | Sequence[str | Path], out: str | Path, *, force: bool = False
) -> DatasetRecord:
    """Joins the parts of a dataset.

    Writes the folder that `make_dataset` writes without parts, byte for byte.

    Args:
      parts: folders, in any order. Their pictures are copied. Files that are not of a part are left
        out.
      out: the folder, new or empty.
      force: whether the folder is replaced, if an earlier run wrote all files in it.

    Returns:
      The record in ``dataset.json``.

    Raises:
      InputError: for a folder that is not a part, a part of another dataset, a part that comes
        twice or is missing, or a file of a part that is missing or damaged.
      OSError: that names the file, if a file cannot be written.
    """
    folders, out = check_named("parts", paths, parts), Path(check_named("out", path, out))
    # A folder that is no part is refused before anything is copied.
    numbers, identities = [], []
    for folder in folders:
        part, identity = _read_record(folder)
        numbers.append(part)
        identities.append(identity)
    # All parts must have the same settings, and the versions of this process.
    expected = identities[0] | {"versions": installed_versions()}
    ordered = order_parts(folders, numbers, identities, expected, "dataset")
    # Parts with the same damage would be of one dataset.
    for folder in ordered:
        read_checked(folder, RECORD, _read_sums(folder))
    # The layout's package may be missing, which is an error before anything is copied.
    layout = find_layout(expected["settings"]["format"])
    with output_folder(
        out, {"command": "merge"}, inputs=folders, foreign=foreign_to_dataset, force=force
    ) as work:
        # Each record of a part has the split of its sample.
        splits = _read_splits(ordered, expected["settings"])
        views = expected["settings"]["views"]
        # The samples of all parts become those of one folder, as if one run had drawn them.
        samples = Samples(views, splits, range(len(splits)), work.files, work.kept / "records")
        with Progress("joining", len(ordered), "parts") as bar:
            for folder in ordered:
                _copy_pictures(folder, work.files, layout)
                bar.count()
        # The records of a split come from all parts, in the order of the samples.
        for split in range(len(SPLITS)):
            samples.write_split(split, _records_of(ordered, split))
        # The files that describe a dataset are made from the records, as without parts.
        return finish(samples, expected)


def _read_record(folder: Path) -> tuple[tuple[int, int], DatasetRecord]:
    """Returns the number of a part, and the record of the dataset without it."""
    try:
        about = read_dataset_record(folder / RECORD)
        part = parse_part(about["part"])
        del about["part"]
        complete = "versions" in about and {"maps", "views"} <= set(about["settings"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        # An InputError is a ValueError.
        complete = False
    if not complete or not (folder / PART).is_file() or not (folder / SUMS).is_file():
        raise InputError(folder, "a part of a dataset, made by elitelanes dataset --part", "none")
    # The records are checked once here. Pictures are checked while they are copied.
    read_checked(folder, PART, _read_sums(folder))
    return part, about


def _read_sums(folder: Path) -> dict[str, str]:
    try:
        return read_sums(folder)
    except UnicodeDecodeError:
        raise InputError(folder / SUMS, "checksums", "a file that is not text") from None


def _copy_pictures(folder: Path, out: Path, layout: Layout) -> None:
    """Copies the pictures of a part's samples, each with its checksum checked."""
    sums = _read_sums(folder)
    # Only pictures of samples are copied. Other files in the folder are left out.
    for split, record in _read_parts([folder]):
        for layer in layer_names(has_objects="objects" in record):
            name = layout.file(split, record["number"], layer)
            copied = out / name
            copied.parent.mkdir(parents=True, exist_ok=True)
            copied.write_bytes(read_checked(folder, name, sums))


def _read_splits(folders: Sequence[Path], settings: DatasetSettings) -> NDArray[np.int_]:
    """Returns the split of each map."""
    splits = np.zeros(settings["maps"], np.int_)
    # All views of a map are in one split, so each of them sets the same number.
    for split, record in _read_parts(folders):
        splits[record["number"] // settings["views"]] = split
    return splits


def _records_of(folders: Sequence[Path], split: int) -> Iterator[SampleRecord]:
    """Yields the records of a split's samples, in order, as the parts are."""
    for other, record in _read_parts(folders):
        if other == split:
            yield record


def _read_parts(folders: Sequence[Path]) -> Iterator[tuple[int, SampleRecord]]:
    for folder in folders:
        with (folder / PART).open(encoding="utf-8") as lines:
            # Lines are read one by one, because the records may not fit into memory.
            for line in lines:
                split, record = json.loads(line)
                yield split, record

"""The tables of a dataset's JSON files: the record of the dataset, and the record of each sample.

Each class lists the fields that the package reads. A table may have further fields.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NotRequired, TypedDict, cast

from elitelanes_jax._util.files import read_json
from elitelanes_jax._util.types import Plain


class SeenObject(TypedDict):
    """An object that a sample shows. Boxes are x, y, width and height in pixels."""

    kind: str
    instance: int
    box: Sequence[int]
    whole: Sequence[float]
    visible: float
    distance: NotRequired[float]


class Outline(TypedDict):
    """The polygons around an object's pixels, and the number of the pixels."""

    segmentation: list[list[int]]
    area: int


class SampleNote(TypedDict, total=False):
    """The annotations that the layout coco adds to the record of a sample."""

    classes: list[dict[str, Plain]]
    outlines: list[Outline]


class SampleRecord(SampleNote):
    """The metadata of a sample. A field is missing if the sample's map has no such value."""

    number: int
    size: list[int]
    pixels: list[int]
    class_pixels: list[int]
    metrics: NotRequired[Mapping[str, float]]
    objects: NotRequired[list[SeenObject]]
    camera: NotRequired[dict[str, Plain]]
    nearest: NotRequired[dict[str, float]]


class _CameraSettings(TypedDict):
    rows: int
    columns: int


class DatasetSettings(TypedDict):
    """The settings of a dataset, see `DatasetSpec`."""

    format: str
    maps: int
    views: int
    size: Sequence[Sequence[int]]
    tile_px: int
    seed: int
    camera: _CameraSettings | None
    transforms: dict[str, float | list[float]]
    search: dict[str, Plain]


class _TileSet(TypedDict):
    name: str
    licence: str
    lane_offset: float
    lane_offset_spread: NotRequired[float]


class _ObjectSet(TypedDict):
    name: str
    pictures: str


class DatasetClass(TypedDict):
    """A class of pixels: its label, its name, and its colour in the sheet."""

    label: int
    name: str
    colour: Sequence[int]


class DatasetCounts(TypedDict, total=False):
    """The pictures of each split, the classes, and the pixels of each class in each split."""

    pictures: dict[str, int]
    classes: list[DatasetClass]
    class_pixels: dict[str, list[int]]


class DatasetRecord(DatasetCounts):
    """The record of a dataset or of a part of it, in ``dataset.json``.

    A part has no `class_pixels`, and only a dataset with objects has an `object_set`.
    """

    settings: DatasetSettings
    given_maps: str | None
    tile_set: _TileSet
    object_set: NotRequired[_ObjectSet]
    versions: dict[str, str]
    part: NotRequired[tuple[int, int] | None]


def read_dataset_record(file: Path) -> DatasetRecord:
    """Reads the record of a dataset; see `read_json` for the errors.

    The fields are not checked. One that is missing or wrong raises a `KeyError` or `TypeError`.
    """
    return cast("DatasetRecord", read_json(file))

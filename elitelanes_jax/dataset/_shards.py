"""Shards: files with many samples, for training that streams a dataset from a disk or a network.

The bytes of a shard depend on its samples alone, and for Parquet on the version of pyarrow.
"""

import json
import tarfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

from elitelanes_jax._util.types import Plain, Untyped
from elitelanes_jax.dataset._samples import Sample, layer_names
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.tiles.rendering import png_of

# The rows of a row group. A reader of Parquet has all of them in memory at once.
_ROWS = 100


class ShardSample(NamedTuple):
    """A sample whose pictures are encoded.

    Attributes:
      pictures: files of PNG, by layer.
      record: the metadata, plain values for JSON.
    """

    pictures: dict[str, bytes]
    record: dict[str, Plain]


def encode_sample(sample: Sample) -> ShardSample:
    """Encodes the pictures of a sample, as the other layouts do."""
    return ShardSample(
        {name: png_of(layer) for name, layer in sample.layers.items()}, sample.record
    )


class ShardFields(NamedTuple):
    """What the samples of a dataset have in their records.

    Attributes:
      metrics: the names of the maps' metrics, and whether each is a whole number on all maps.
      camera: whether they are views from a robot.
      objects: whether objects are drawn.
    """

    metrics: dict[str, bool]
    camera: bool
    objects: bool


def shard_fields(maps: Sequence[RoadMap], *, has_camera: bool, has_objects: bool) -> ShardFields:
    """Returns what the samples of a dataset have in their records."""
    metrics: dict[str, bool] = {}
    for road_map in maps:
        for name, value in (road_map.metrics or {}).items():
            # A column has one type. A metric that is a fraction on one map is a column of
            # fractions.
            metrics[name] = metrics.get(name, True) and isinstance(value, int)
    return ShardFields(metrics, has_camera, has_objects)


OpenShard = Callable[[Path, ShardFields], AbstractContextManager[Callable[[ShardSample], None]]]
"""(file, fields) -> a context that gives a function, which adds a sample to the file."""


@contextmanager
def open_tar(file: Path, _: ShardFields) -> Iterator[Callable[[ShardSample], None]]:
    """Writes a tar file as WebDataset reads it.

    The names of a sample's files have its number up to the first dot.
    """
    with tarfile.open(file, "w", format=tarfile.USTAR_FORMAT) as archive:

        def add(name: str, content: bytes) -> None:
            # Times, owners and permissions are the defaults of `TarInfo`, which are the same on all
            # machines.
            entry = tarfile.TarInfo(name)
            entry.size = len(content)
            archive.addfile(entry, BytesIO(content))

        def write(sample: ShardSample) -> None:
            # WebDataset groups the files of a sample by the part of their names before the first
            # dot.
            key = f"{sample.record['number']:06d}"
            for layer, picture in sample.pictures.items():
                add(f"{key}.{layer}.png", picture)
            # The metadata comes last, and all files of a sample are neighbours, as WebDataset
            # expects.
            add(f"{key}.json", json.dumps(sample.record).encode())

        yield write


@contextmanager
def open_parquet(file: Path, fields: ShardFields) -> Iterator[Callable[[ShardSample], None]]:
    """Writes a Parquet file with a row for each sample.

    Hugging Face's datasets decodes its pictures.
    """
    import pyarrow as pa
    from pyarrow import parquet

    schema = _schema(fields)
    rows: list[dict[str, Plain]] = []
    # Pictures are compressed already, and no two are equal.
    writer = parquet.ParquetWriter(file, schema, use_dictionary=False, compression="zstd")
    with writer:

        def write(sample: ShardSample) -> None:
            name = f"{sample.record['number']:06d}"
            # Hugging Face's datasets expects the bytes of a picture and a name for it.
            pictures = {
                layer: {"bytes": picture, "path": f"{name}.{layer}.png"}
                for layer, picture in sample.pictures.items()
            }
            rows.append(pictures | sample.record)
            # Rows in memory are limited, because pictures may be large.
            if len(rows) == _ROWS:
                flush()

        def flush() -> None:
            writer.write_table(pa.Table.from_pylist(rows, schema))
            rows.clear()

        # The last row group may have fewer rows.
        yield write
        if rows:
            flush()


def _schema(fields: ShardFields) -> Untyped:
    """Returns the columns of a Parquet file.

    A note for Hugging Face's datasets says which of the columns are pictures.
    """
    import pyarrow as pa

    whole, number, text = pa.int64(), pa.float64(), pa.string()
    # Hugging Face's datasets has files of pictures as records of bytes and a path.
    picture = pa.struct({"bytes": pa.binary(), "path": text})
    box = pa.list_(number)

    def numbers(*names: str) -> Untyped:
        return pa.struct(dict.fromkeys(names, number))

    # The columns come in the order of the metadata, as in the other layouts.
    layers = layer_names(has_objects=fields.objects)
    columns = dict.fromkeys(layers, picture) | {
        "number": whole,
        "size": pa.list_(whole),
        "pixels": pa.list_(whole),
        "codes": pa.list_(pa.list_(whole)),
    }
    # Parquet has no records without fields.
    if fields.metrics:
        columns["metrics"] = pa.struct(
            {name: whole if counts else number for name, counts in fields.metrics.items()}
        )
    columns |= {
        "fitness": number,
        "niche": pa.list_(whole),
        "map_seed": pa.list_(whole),
        "tiles": pa.list_(pa.list_(text)),
        "quarter_turns": pa.list_(pa.list_(whole)),
        "transform": pa.struct(
            {
                "matrix": pa.list_(pa.list_(number)),
                "gains": pa.list_(number),
                **dict.fromkeys(("offset", "blur", "noise"), number),
                "noise_seed": whole,
            }
        ),
    }
    # Only views from a robot have these columns.
    if fields.camera:
        camera = dict.fromkeys(("height", "forward", "pitch", "field_of_view", "lines"), number)
        camera |= {"sky": pa.list_(whole), "distortion": pa.list_(number)}
        columns |= dict.fromkeys(("d", "phi", "curvature"), number) | {
            "pose": numbers("x", "y", "theta"),
            "nearest": numbers("d", "phi", "curvature"),
            "movement": pa.struct(dict.fromkeys(("row", "column", "heading", "turn"), whole)),
            "camera": pa.struct(camera),
        }
    if fields.objects:
        # The entries of an object are those of `Sample.record`.
        thing = {"kind": text, "instance": whole, "box": box, "whole": box, "visible": number}
        columns["objects"] = pa.list_(
            pa.struct(thing | ({"distance": number} if fields.camera else {}))
        )
    columns["class_pixels"] = pa.list_(whole)
    # Without this note, the pictures would load as records of bytes and a path.
    features = {layer: {"_type": "Image"} for layer in layers}
    note = json.dumps({"info": {"features": features}})
    return pa.schema(columns, metadata={"huggingface": note})

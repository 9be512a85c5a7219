"""Shards: files with many samples, for training that streams a dataset from a disk or a network.

The bytes of a shard depend on its samples alone, and for Parquet on the version of pyarrow.
"""

import json
import tarfile
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from io import BytesIO
from pathlib import Path

from elitelanes_jax._util.types import Plain, Untyped
from elitelanes_jax.dataset._fields import NUMBER, TEXT, WHOLE, Contents, Field
from elitelanes_jax.dataset._samples import layer_names
from elitelanes_jax.dataset.tables import SampleRecord

# The rows of a row group. A reader of Parquet has all of them in memory at once.
_ROWS = 100


WriteSample = Callable[[dict[str, bytes], SampleRecord], None]
"""Adds a sample to a shard: its pictures, files of PNG by layer, and its metadata."""

OpenShard = Callable[[Path, Contents], AbstractContextManager[WriteSample]]
"""(file, contents) -> a context that gives a function, which adds samples to the file."""


@contextmanager
def open_tar(file: Path, _: Contents) -> Iterator[WriteSample]:
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

        def write(pictures: dict[str, bytes], record: SampleRecord) -> None:
            # WebDataset groups the files of a sample by the part of their names before the first
            # dot.
            key = f"{record['number']:06d}"
            for layer, picture in pictures.items():
                add(f"{key}.{layer}.png", picture)
            # The metadata comes last, and all files of a sample are neighbours, as WebDataset
            # expects.
            add(f"{key}.json", json.dumps(record).encode())

        yield write


@contextmanager
def open_parquet(file: Path, contents: Contents) -> Iterator[WriteSample]:
    """Writes a Parquet file with a row for each sample.

    Hugging Face's datasets decodes its pictures.
    """
    import pyarrow as pa
    from pyarrow import parquet

    schema = _schema(contents)
    rows: list[dict[str, Plain]] = []
    # Pictures are compressed already, and no two are equal.
    writer = parquet.ParquetWriter(file, schema, use_dictionary=False, compression="zstd")
    with writer:

        def write(pictures: dict[str, bytes], record: SampleRecord) -> None:
            name = f"{record['number']:06d}"
            # Hugging Face's datasets expects the bytes of a picture and a name for it.
            columns = {
                layer: {"bytes": picture, "path": f"{name}.{layer}.png"}
                for layer, picture in pictures.items()
            }
            rows.append({**columns, **record})
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


def _schema(contents: Contents) -> Untyped:
    """Returns the columns of a Parquet file.

    A note for Hugging Face's datasets says which of the columns are pictures.
    """
    import pyarrow as pa

    types = {WHOLE: pa.int64(), NUMBER: pa.float64(), TEXT: pa.string()}

    def type_of(field: Field) -> Untyped:
        if field.kind is None:
            column = pa.struct({part.name: type_of(part) for part in field.parts})
        else:
            column = types[field.kind]
        for _ in range(field.axes):
            column = pa.list_(column)
        return column

    # Hugging Face's datasets has files of pictures as records of bytes and a path.
    picture = pa.struct({"bytes": pa.binary(), "path": pa.string()})
    # The columns come in the order of the metadata, as in the other layouts.
    layers = layer_names(has_objects=contents.objects)
    columns = dict.fromkeys(layers, picture)
    for group in contents.groups():
        for field in group.fields:
            columns[field.name] = type_of(field)
    # Without this note, the pictures would load as records of bytes and a path.
    features = {layer: {"_type": "Image"} for layer in layers}
    note = json.dumps({"info": {"features": features}})
    return pa.schema(columns, metadata={"huggingface": note})

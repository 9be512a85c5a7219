"""The payload of the explorer: values for JSON, and one blob of arrays, compressed."""

import json
import zlib
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.types import AnyArray, Plain


class Payload(NamedTuple):
    """The contents of the explorer."""

    # For JSON. A table {"array": [dtype, start, count]} represents an array: its little-endian numbers start at
    # that byte of the blob.
    values: dict[str, Plain]
    blob: bytes  # the arrays, one after another, compressed by zlib


class Blob:
    """The bytes of arrays, one after another."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._size = 0

    def add(self, array: AnyArray, dtype: str) -> dict[str, Plain]:
        """Adds an array; returns the table that represents it."""
        content = np.ascontiguousarray(array, np.dtype(dtype).newbyteorder("<")).tobytes()
        start = self._size
        padding = -len(content) % 8  # so that every array is aligned
        self._parts += [content, bytes(padding)]
        self._size += len(content) + padding
        return {"array": [dtype, start, len(content) // np.dtype(dtype).itemsize]}

    def add_codes(self, grids: NDArray[np.int8]) -> dict[str, Plain]:
        """Adds tile codes, two per byte, the first in the lower half; returns the table that represents them."""
        flat = grids.reshape(-1).astype(np.uint8)
        flat = np.pad(flat, (0, flat.size % 2))
        return self.add(flat[::2] | flat[1::2] << 4, "uint8") | {"codes": grids.size}

    def add_json(self, values: Plain) -> dict[str, Plain]:
        """Adds values as the bytes of their JSON, which pack well; returns the table that represents them."""
        return self.add(np.frombuffer(json.dumps(values, separators=(",", ":")).encode(), np.uint8), "uint8")

    def packed(self) -> bytes:
        return zlib.compress(b"".join(self._parts), 9)

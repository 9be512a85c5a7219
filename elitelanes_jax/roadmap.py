"""A road map with its figures, and the JSON file that keeps it."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.grids import check_grid

__all__ = ["Drawn", "RoadMap", "read_map", "to_json"]

_FORMAT = "elitelanes map, version 1"


class Drawn(NamedTuple):
    """Which pictures a map is drawn with.

    tile_set: the name of the set.
    tiles: names ``[H][W]``.
    quarter_turns: ints ``[H][W]``, counter-clockwise.
    """

    tile_set: str
    tiles: list[list[str]]
    quarter_turns: list[list[int]]


class RoadMap(NamedTuple):
    """One map; what is not known of it is left out.

    codes: int8 ``[H, W]``.
    metrics: by name.
    fitness: of the run that found it; lower is better.
    descriptor: the values of the niche's axes, by metric.
    niche: the bins on the axes.
    seed: of the run, and which of the run's seeds found the map, from 0.
    drawn: its pictures.
    """

    codes: NDArray[np.int8]
    metrics: Mapping[str, float] | None = None
    fitness: int | None = None
    descriptor: Mapping[str, int] | None = None
    niche: list[int] | None = None
    seed: tuple[int, int] | None = None
    drawn: Drawn | None = None


def to_json(road_map: RoadMap) -> str:
    """The text of a map file: a key a line, tables a row a line."""
    values: dict[str, Any] = {
        "format": _FORMAT,
        "shape": list(road_map.codes.shape),
        "codes": road_map.codes.tolist(),
        "metrics": road_map.metrics,
        "fitness": road_map.fitness,
        "descriptor": road_map.descriptor,
        "niche": road_map.niche,
        "seed": road_map.seed,
        "drawn": road_map.drawn and road_map.drawn._asdict(),
    }
    return _lines({key: value for key, value in values.items() if value is not None}, "") + "\n"


def _lines(value: Any, indent: str) -> str:
    inner = indent + "  "
    if isinstance(value, Mapping):
        rows = [f"{inner}{json.dumps(key)}: {_lines(item, inner)}" for key, item in value.items()]
        return "{\n" + ",\n".join(rows) + f"\n{indent}}}"
    if isinstance(value, list) and value and isinstance(value[0], list):
        return "[\n" + ",\n".join(f"{inner}{json.dumps(row)}" for row in value) + f"\n{indent}]"
    return json.dumps(value)


def read_map(file: str | Path) -> RoadMap:
    """Reads a map file; ``{"codes": [[...], ...]}`` is enough of one.

    Raises:
      ValueError: if it cannot be read, or holds no grid of codes; the message names the file.
    """
    try:
        values = json.loads(Path(file).read_text())
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ValueError(f"{file}: expected a readable JSON file, got: {error}") from None
    if not isinstance(values, dict) or "codes" not in values:
        raise ValueError(f'{file}: expected a map, {{"codes": [[...], ...]}}, got no "codes"')
    try:
        codes = np.array(check_grid(_table(values["codes"])))
    except ValueError as error:
        raise ValueError(f"{file}: {error}") from None
    seed, drawn = values.get("seed"), values.get("drawn")
    if drawn is not None and not (isinstance(drawn, dict) and set(drawn) == set(Drawn._fields)):
        raise ValueError(f"{file}: drawn: expected {', '.join(Drawn._fields)}, got {drawn!r}")
    return RoadMap(
        codes,
        values.get("metrics"),
        values.get("fitness"),
        values.get("descriptor"),
        values.get("niche"),
        seed and tuple(seed),
        Drawn(**drawn) if drawn else None,
    )


def _table(rows: Any) -> NDArray[Any]:
    try:
        return np.array(rows)
    except ValueError:
        raise ValueError("grid: expected rows of one length, got rows of several") from None

"""A road map with its metrics, and its JSON file. Duckietown's map files are read too."""

import json
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, file_named, is_real, is_whole, path
from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax._util.files import MIB, parse_json, read_input, write_atomic
from elitelanes_jax._util.progress import announce_at_end
from elitelanes_jax._util.types import Plain, UserValue
from elitelanes_jax.formats.dt_layers import is_layers, read_layers
from elitelanes_jax.formats.duckietown import read_duckietown
from elitelanes_jax.formats.objects import MapObject, check_objects, object_values
from elitelanes_jax.formats.sketch import draw_svg
from elitelanes_jax.network.checks import check_grid, check_sides
from elitelanes_jax.network.plain_metrics import plain_measure, plain_town

_FORMAT = "elitelanes map, version 1"
_MOST_BYTES = 32 * MIB  # a drawn map of 1024 x 1024 tiles has 22 MB
_ROUNDED = 1e-3  # how far a stored share may be from the measured one
_MOST_LISTED = 64 * MIB  # a list of 40,000 maps of 12 x 12 tiles with their metrics


class Drawn(NamedTuple):
    """The tile pictures that a map is drawn with.

    Attributes:
      tile_set: the name of the set.
      tiles: names ``[H][W]``.
      quarter_turns: ints ``[H][W]``, counter-clockwise.
    """

    tile_set: str
    tiles: list[list[str]]
    quarter_turns: list[list[int]]


@dataclass(frozen=True, eq=False)
class RoadMap:
    """One map; unknown fields are None. All fields are checked at construction.

    Maps are equal if their files are. To change a map, make a new one from a copy of its codes.

    Attributes:
      codes: int8 ``[H, W]``, read-only.
      metrics: by name.
      fitness: in the search that found it; lower is better.
      descriptor: the values of the niche's axes, by metric.
      niche: the bins on the axes.
      seed: of the run, and the index of the run's seed that found the map, from 0.
      drawn: its tile pictures.
      objects: what stands on it, such as signs and trees.
      unsure: row and column of each cell whose code is unsure, in a map that was read from a
        photograph.
    """

    codes: NDArray[np.int8]
    metrics: Mapping[str, float] | None = None
    fitness: float | None = None
    descriptor: Mapping[str, int] | None = None
    niche: list[int] | None = None
    seed: tuple[int, int] | None = None
    drawn: Drawn | None = None
    objects: tuple[MapObject, ...] | None = None
    unsure: list[list[int]] | None = None

    def __post_init__(self) -> None:
        """Checks all fields; raises `InputError`."""
        codes = np.array(check_grid(self.codes))
        codes.flags.writeable = False  # a change would contradict the metrics
        for name, (fits, expected) in _FIELDS.items():
            value = _plain(getattr(self, name))
            if value is not None and not fits(value):
                raise InputError(f"{name}: expected {expected}, got {shorten(json.dumps(value, default=repr))}")
            object.__setattr__(self, name, value)
        object.__setattr__(self, "codes", codes)
        object.__setattr__(self, "seed", self.seed and tuple(self.seed))
        object.__setattr__(self, "drawn", self.drawn and Drawn(**self.drawn))  # type: ignore[arg-type]
        if self.drawn and any((len(table), *set(map(len, table))) != codes.shape for table in self.drawn[1:]):
            raise InputError(f"drawn: expected tables of {codes.shape[0]} x {codes.shape[1]}, like the codes")
        if self.objects is not None:
            object.__setattr__(self, "objects", check_objects(self.objects, *codes.shape))

    def save(self, file: str | Path) -> None:
        """Writes a map file for `read_map`. An existing file is replaced; after an error it is unchanged.

        Raises:
          InputError: if the name has the suffix of another format, such as .yaml.
          OSError: if the file cannot be written.
        """
        write_atomic(check_named("file", file_named(".json"), file), map_to_json(self).encode())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, RoadMap) and map_to_json(self) == map_to_json(other)

    def __hash__(self) -> int:
        return hash(map_to_json(self))

    def __repr__(self) -> str:
        """Returns the size and a few metrics in one line."""
        height, width = np.shape(self.codes)
        figures = {"fitness": self.fitness} | dict(self.metrics or {})
        shown = ("fitness", "cyclomatic", "crossings", "turns", "bridges")
        words = [f"{name} {figures[name]}" for name in shown if figures.get(name) is not None]
        return f"RoadMap({', '.join([f'{height} x {width}', *words])})"

    def _repr_svg_(self) -> str:
        return draw_svg(self.codes)


@name_wrong_arguments
def map_to_json(road_map: UserValue) -> str:
    """Returns the text of a map file: a line for each key, and for each row of a table.

    Takes one map in any form that `as_maps` takes; raises `InputError` for anything else.
    """
    road_map = as_map(road_map)
    codes, objects = road_map.codes, road_map.objects
    values: dict[str, Plain] = {
        "format": _FORMAT,
        "shape": list(codes.shape),
        "codes": codes.tolist(),
    }
    values |= {name: getattr(road_map, name) for name in _FIELDS}
    values["drawn"] = road_map.drawn and road_map.drawn._asdict()
    values["objects"] = None if objects is None else [object_values(item) for item in objects]
    return _lines({key: value for key, value in values.items() if value is not None}, "") + "\n"


def _lines(value: Plain, indent: str) -> str:
    inner = indent + "  "
    if isinstance(value, Mapping):
        rows = [f"{inner}{json.dumps(key)}: {_lines(item, inner)}" for key, item in value.items()]
        return "{\n" + ",\n".join(rows) + f"\n{indent}}}"
    if isinstance(value, list) and value and isinstance(value[0], list | dict):
        return "[\n" + ",\n".join(f"{inner}{json.dumps(row)}" for row in value) + f"\n{indent}]"
    return json.dumps(value)


@name_wrong_arguments
def read_map(file: str | Path) -> RoadMap:
    """Reads a map file; ``{"codes": [[...], ...]}`` is enough.

    Files ``.yaml`` and ``.yml`` are maps of Duckietown, and so are folders with ``tiles.yaml`` and
    ``frames.yaml``. If the file has other metrics than those of its codes, see `refresh`.

    Raises:
      InputError: if it cannot be read, has over 32 MiB or a bad entry; the message names the file.
    """
    (road_map,) = _read(file, _MOST_BYTES, _one_map_of)
    return road_map


@name_wrong_arguments
def read_maps(file: str | Path) -> list[RoadMap]:
    """Reads a file of one map, or a JSON list of maps, ``[{"codes": [[...], ...]}, ...]``.

    Raises:
      InputError: as `read_map`, here for over 64 MiB; the message names the file and the map's
        index, from 0.
    """
    return _read(file, _MOST_LISTED, _maps_of)


@name_wrong_arguments
def as_maps(sources: UserValue) -> list[RoadMap]:
    """Returns one map or several as a list.

    Args:
      sources: a `RoadMap`, a grid ``[H, W]`` of codes, an array or lists, or a file, see
        `read_maps`; or several of these. An array ``[N, H, W]`` is several.

    Raises:
      InputError: for a bad grid or file, or anything else.
    """
    is_single = isinstance(sources, str | Path) or _dimensions(sources) == 2
    if isinstance(sources, Mapping) or not (is_single or isinstance(sources, Iterable)):
        raise InputError(f"expected maps, grids or files of maps, got {shorten(repr(sources))}")
    maps: list[RoadMap] = []
    for index, source in enumerate([sources] if is_single else sources):
        if isinstance(source, str | Path):
            maps += read_maps(source)
        elif isinstance(source, RoadMap):
            maps.append(source)
        elif is_single:
            maps.append(RoadMap(source))
        else:
            maps.append(check_named(f"map {index}", RoadMap, source))
    return maps


def as_map(source: UserValue) -> RoadMap:
    """Returns one map in any form that `as_maps` takes.

    Raises:
      InputError: as `as_maps`, or for several maps or none.
    """
    if isinstance(source, str | Path):
        return read_map(source)
    maps = as_maps(source)
    if len(maps) != 1:
        raise InputError(f"map: expected one map, got {len(maps)}")
    return maps[0]


def _dimensions(value: UserValue) -> int:
    value = getattr(value, "codes", value)
    if isinstance(value, list | tuple):
        return 1 + (_dimensions(value[0]) if value else 0)
    return getattr(value, "ndim", 0)


def refresh(road_map: RoadMap, name: str) -> RoadMap:
    """Returns a map whose metrics are those of its codes. After a change by hand, stored metrics no longer are.

    Such a map is measured again, and loses what a search said of its former codes: its fitness, descriptor, niche, seed
    and drawn tiles. A command says so in a line that begins with `name`. A map without metrics does not change. Town
    features of blocks and streets are not compared, because measuring them needs JAX.
    """
    if road_map.metrics is None:
        return road_map
    measured = plain_measure(road_map.codes)
    compared = measured | {name: value / 1000 for name, value in plain_town(road_map.codes).items()}
    for metric, value in road_map.metrics.items():
        if metric in compared and metric != "off_alphabet" and abs(value - compared[metric]) > _ROUNDED:
            change = f"{metric} {compared[metric]:g} instead of {value:g}"
            announce_at_end(name, f"measured again, because its codes were changed: {change}")
            return RoadMap(road_map.codes, metrics=measured, objects=road_map.objects)
    return road_map


def _read(file: str | Path, most: int, parse: Callable[[Plain], list[RoadMap]]) -> list[RoadMap]:
    """Reads the maps of a file; of a map of Duckietown, its codes and objects."""
    maps = _parse(file, most, parse)
    names = [str(file)] if len(maps) == 1 else [f"{file}: map {index}" for index in range(len(maps))]
    return [refresh(road_map, name) for road_map, name in zip(maps, names, strict=True)]


def _parse(file: str | Path, most: int, parse: Callable[[Plain], list[RoadMap]]) -> list[RoadMap]:
    suffix = check_named("file", path, file).suffix.lower()
    if suffix == ".npz":
        raise InputError(f"{file}: expected a file of maps, got an archive of a search; pick chooses maps from it")
    if Path(file).is_dir():
        return parse(dict(zip(("codes", "objects"), _read_folder(Path(file)), strict=True)))
    is_yaml = suffix in (".yaml", ".yml")
    text = read_input(file, most, "YAML" if is_yaml else "JSON")
    try:
        return parse(dict(zip(("codes", "objects"), read_duckietown(text), strict=True)) if is_yaml else _json_of(text))
    except InputError as error:
        raise InputError(f"{file}: {error}") from None
    except RecursionError:
        raise InputError(f"{file}: expected a map, got JSON nested too deeply") from None


def _read_folder(folder: Path) -> tuple[NDArray[np.int8], tuple[MapObject, ...] | None]:
    """Reads the codes and objects of a folder of Duckietown's layers."""
    if not is_layers(folder):
        raise InputError(f"{folder}: expected a file of a map, or a folder with tiles.yaml, got a folder without")
    return read_layers(folder)


def _json_of(text: str) -> Plain:
    try:
        return parse_json(text)
    except InputError:
        raise
    except ValueError as error:  # of JSON, or of a number with too many digits
        raise InputError(f"expected a readable JSON file, got: {error}") from None


def _one_map_of(values: Plain) -> list[RoadMap]:
    return [_map_of(values)]


def _maps_of(values: Plain) -> list[RoadMap]:
    if not isinstance(values, list):
        return _one_map_of(values)
    return [check_named(f"map {index}", _map_of, item) for index, item in enumerate(values)]


def _map_of(values: Plain) -> RoadMap:
    if not isinstance(values, dict) or "codes" not in values:
        got = "a list; name a file with one map" if isinstance(values, list) else 'no "codes"'
        raise InputError(f'expected a map, {{"codes": [[...], ...]}}, got {got}')
    if values.get("format", _FORMAT) != _FORMAT:
        raise InputError(f"format: expected {_FORMAT!r}, got {shorten(repr(values['format']))}")
    codes = _grid(values["codes"])
    shape = values.get("shape", list(codes.shape))
    if shape != list(codes.shape):
        raise InputError(f"shape: expected {list(codes.shape)}, like the codes, got {shorten(json.dumps(shape))}")
    return RoadMap(codes, **{name: values[name] for name in (*_FIELDS, "objects") if name in values})


def _plain(value: UserValue) -> Plain:
    """Returns a field's value as JSON has it, with Python's numbers instead of NumPy's and lists instead of tuples."""
    if isinstance(value, Drawn):
        value = value._asdict()
    if isinstance(value, Mapping):
        return {name: _plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value.item() if isinstance(value, np.generic) else value


def _grid(rows: Plain) -> NDArray[np.int8]:
    """Reads the codes of a file. A wrong code is reported as written, before NumPy converts all cells to one type."""
    if isinstance(rows, list) and all(isinstance(row, list) for row in rows):
        check_sides(rows)
        for y, row in enumerate(rows):
            for x, code in enumerate(row):
                if not is_whole(code) or not 0 <= code <= 15:
                    got = shorten(json.dumps(code))
                    raise InputError(f"grid: expected tile codes 0 to 15, got {got} at row {y}, column {x}")
    return np.array(check_grid(rows))


def _all(fits: Callable[[Plain], bool], values: Plain) -> bool:
    return isinstance(values, list) and all(map(fits, values))


def _is_drawn(value: Plain) -> bool:
    return (
        isinstance(value, dict)
        and set(value) == set(Drawn._fields)
        and isinstance(value["tile_set"], str)
        and _all(lambda row: _all(lambda name: isinstance(name, str), row), value["tiles"])
        and _all(
            lambda row: _all(lambda turns: is_whole(turns) and 0 <= turns < 4, row),
            value["quarter_turns"],
        )
    )


def _are_cells(value: Plain) -> bool:
    return _all(lambda cell: _all(is_whole, cell) and len(cell) == 2 and min(cell) >= 0, value)


def _is_number(value: Plain) -> bool:
    return is_real(value) and abs(value) <= sys.float_info.max  # `isfinite` fails for whole numbers over that


def _numbers_by_name(value: Plain) -> bool:
    return isinstance(value, dict) and all(map(_is_number, value.values()))


# The fields of a map beside the codes: a test of the value, and what is expected, for messages.
_FIELDS: dict[str, tuple[Callable[[Plain], bool], str]] = {
    "metrics": (_numbers_by_name, "numbers by name"),
    "fitness": (_is_number, "a number"),
    "descriptor": (_numbers_by_name, "numbers by name"),
    "niche": (lambda value: _all(is_whole, value), "whole numbers"),
    "seed": (lambda value: _all(is_whole, value) and len(value) == 2, "two whole numbers"),
    "unsure": (_are_cells, "a list of cells, each a row and a column"),
    "drawn": (_is_drawn, f"a record of {', '.join(Drawn._fields)}, turns 0 to 3"),
}

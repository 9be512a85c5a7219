"""A road map with its metrics, and its JSON file. Duckietown's map files are read too."""

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.cells import describe_cell
from elitelanes_jax._util.checks import check_named, file_named, is_folder, is_whole, path
from elitelanes_jax._util.copies import frozen_copy
from elitelanes_jax._util.errors import InputError, quote, shorten
from elitelanes_jax._util.files import MIB, parse_json, read_input, write_atomic
from elitelanes_jax._util.progress import announce_at_end
from elitelanes_jax._util.types import OptionValue, Plain, Untyped, UserValue
from elitelanes_jax.formats._map_fields import (
    FIELDS,
    Drawn,
    has_shape,
    is_number,
    is_table,
    plain_value,
    show_value,
)
from elitelanes_jax.formats.dt_layers import is_layers, read_layers
from elitelanes_jax.formats.duckietown import read_duckietown
from elitelanes_jax.formats.objects import MapObject, check_objects, object_values
from elitelanes_jax.formats.sketch import draw_svg, draw_text
from elitelanes_jax.network.checks import check_sides, known_grid
from elitelanes_jax.network.plain_metrics import plain_measure, plain_town

T = TypeVar("T")

_FORMAT = "elitelanes map, version 1"

# The most bytes of a map file. A drawn map of 1024 x 1024 tiles has 22 MB.
_MOST_BYTES = 32 * MIB

# The difference up to which a stored metric is that of the codes. Files have shares with few
# digits.
_ROUNDED = 1e-3

# The most bytes of a list of maps. A list of 40,000 maps of 12 x 12 tiles with their metrics has
# this size.
_MOST_LISTED = 64 * MIB


@dataclass(frozen=True, eq=False)
class RoadMap:
    """One map; unknown fields are None. All fields are checked at construction.

    Maps are equal if their files are. To change a map, make a new one from a copy of its codes.

    Attributes:
      codes: int8 ``[H, W]``, read-only.
      metrics: the metrics by name.
      fitness: the fitness in the search that found it; lower is better.
      descriptor: the values of the niche's axes, by metric.
      niche: the bins on the axes.
      seed: the seed of the run, and the index of the run's seed that found the map, from 0.
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
        # A change of the codes would contradict the metrics.
        codes = frozen_copy(known_grid(self.codes))
        height, width = codes.shape
        fields: dict[str, OptionValue] = {"codes": codes}
        # Every field becomes a plain value, so a map made in Python equals the map that its file
        # gives.
        for name, (fits, expected) in FIELDS.items():
            value = plain_value(getattr(self, name))
            if value is not None and not fits(value):
                raise InputError(name, expected, shorten(show_value(value)))
            fields[name] = value
        if fields["seed"]:
            fields["seed"] = tuple(fields["seed"])
        if fields["drawn"]:
            drawn = Drawn(**fields["drawn"])
            if not has_shape(drawn.tiles, codes.shape) or not has_shape(
                drawn.quarter_turns, codes.shape
            ):
                raise InputError("drawn", f"tables of {height} x {width}, like the codes", "others")
            fields["drawn"] = drawn
        if self.objects is not None:
            fields["objects"] = check_objects(self.objects, height, width)
        for name, value in fields.items():
            # The dataclass is frozen, so fields are set past its own `__setattr__`.
            object.__setattr__(self, name, value)

    def __setstate__(self, fields: dict[str, UserValue]) -> None:
        """Sets the fields of a copy."""
        self.__dict__.update(fields)
        # NumPy makes a copied array writable, by `copy.deepcopy` and by pickle.
        self.codes.flags.writeable = False

    def save(self, file: str | Path) -> None:
        """Writes a map file for `read_map`.

        An existing file is replaced. After an error it is unchanged.

        Raises:
          InputError: if the name does not end in .json.
          OSError: if the file cannot be written.
        """
        write_atomic(check_named("file", file_named(".json"), file), map_to_json(self).encode())

    def to_json(self) -> str:
        """Returns the text that `save` writes: a line for each key, and for each row of a table."""
        return map_to_json(self)

    def to_text(self, *, ascii_only: bool = False) -> str:
        """Returns a drawing of the roads in characters, two per tile, a line for each row.

        A connection is a line to that side.

        Args:
          ascii_only: whether to draw with ``+``, ``-`` and ``|`` instead of box-drawing characters.
        """
        return draw_text(self.codes, ascii_only=ascii_only)

    def to_svg(self) -> str:
        """Returns a drawing of the roads as the text of an SVG file."""
        return draw_svg(self.codes)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, RoadMap) and map_to_json(self) == map_to_json(other)

    def __hash__(self) -> int:
        return hash(map_to_json(self))

    def __repr__(self) -> str:
        """Returns the size and a few metrics in one line."""
        height, width = np.shape(self.codes)
        figures = {"fitness": self.fitness} | dict(self.metrics or {})
        parts = [f"{height} x {width}"]
        for name in ("fitness", "cyclomatic", "crossings", "turns", "bridges"):
            if figures.get(name) is not None:
                parts.append(f"{name} {figures[name]}")
        return f"RoadMap({', '.join(parts)})"

    def _repr_svg_(self) -> str:
        return self.to_svg()


@name_wrong_arguments
def map_to_json(road_map: UserValue) -> str:
    """Returns the text of a map file, see `RoadMap.to_json`.

    Takes one map in any form that `as_maps` takes; raises `InputError` for anything else.
    """
    road_map = as_map(road_map)
    values: dict[str, Plain] = {
        "format": _FORMAT,
        "shape": list(road_map.codes.shape),
        "codes": road_map.codes.tolist(),
    }
    for name in FIELDS:
        value = getattr(road_map, name)
        if value is not None:
            values[name] = value
    if road_map.drawn:
        known = road_map.drawn._asdict().items()
        values["drawn"] = {name: value for name, value in known if value is not None}
    if road_map.objects is not None:
        values["objects"] = [object_values(item) for item in road_map.objects]
    return _json_lines(values, "") + "\n"


def _json_lines(value: Plain, indent: str) -> str:
    """Returns JSON with a line for each key of a mapping, and for each row of a table."""
    inner = indent + "  "
    if isinstance(value, Mapping):
        lines = [
            f"{inner}{json.dumps(key)}: {_json_lines(item, inner)}" for key, item in value.items()
        ]
        return "{\n" + ",\n".join(lines) + f"\n{indent}}}"
    # Only a list of lists or of objects is spread over lines. Its rows stay on one line each.
    if isinstance(value, list) and value and isinstance(value[0], list | dict):
        lines = [f"{inner}{json.dumps(row)}" for row in value]
        return "[\n" + ",\n".join(lines) + f"\n{indent}]"
    return json.dumps(value)


@name_wrong_arguments
def read_map(file: str | Path) -> RoadMap:
    """Reads a map file; ``{"codes": [[...], ...]}`` is enough. Keys of other programs are not read.

    Files ``.yaml`` and ``.yml`` are maps of Duckietown, and so are folders with ``tiles.yaml`` and
    ``frames.yaml``. If the metrics in the file are not those of its codes, they are computed again.
    The map then loses its fitness, descriptor, niche, seed and drawn tiles.

    Raises:
      InputError: if it cannot be read, has over 32 MiB or a bad entry; the message names the file.
    """
    return refresh(_read(file, _MOST_BYTES, _map_of), str(file))


@name_wrong_arguments
def read_maps(file: str | Path) -> list[RoadMap]:
    """Reads a file of one map, or a JSON list of maps, ``[{"codes": [[...], ...]}, ...]``.

    Of a folder that `generate` or `pick` wrote, reads all its maps.

    Raises:
      InputError: as `read_map`, here for over 64 MiB; the message names the file and the map's
        index, from 0.
    """
    if is_folder(check_named("file", path, file)) and not is_layers(Path(file)):
        files = sorted(Path(file).glob("maps/*/map.json"))
        if files:
            return [read_map(one) for one in files]
    maps = _read(file, _MOST_LISTED, _maps_of)
    if len(maps) == 1:
        return [refresh(maps[0], str(file))]
    return [refresh(road_map, f"{file}: map {index}") for index, road_map in enumerate(maps)]


@name_wrong_arguments
def as_maps(sources: Untyped) -> list[RoadMap]:
    """Returns one map or several as a list.

    Args:
      sources: a `RoadMap`, a grid ``[H, W]`` of codes, an array or lists, or a file; or several of
        these. An array ``[N, H, W]`` is several. A file has one map, as for `read_map`, or a JSON
        list of maps, ``[{"codes": [[...], ...]}, ...]``. A folder of `generate` has all its maps.

    Raises:
      InputError: for a bad grid, a bad file, a file of over 64 MiB, or anything else; the message
        names the file and the map's index in its list, from 0.
    """
    if isinstance(sources, str | Path):
        return read_maps(sources)
    if isinstance(sources, RoadMap):
        return [sources]
    if not _may_be_maps(sources):
        raise InputError("", "maps, grids or files of maps", quote(sources))
    # Rows alone are one grid. They would otherwise be read as a list of maps.
    if _dimensions(sources) == 2:
        return [RoadMap(sources)]
    maps: list[RoadMap] = []
    for index, source in enumerate(sources):
        if isinstance(source, str | Path):
            maps += read_maps(source)
        elif isinstance(source, RoadMap):
            maps.append(source)
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
    if not _may_be_maps(source):
        got = quote(source)
        raise InputError("map", "a map, a grid or a file of one", got)
    maps = as_maps(source)
    if len(maps) != 1:
        raise InputError("map", "one map", len(maps))
    return maps[0]


def _may_be_maps(value: UserValue) -> bool:
    """Returns whether a value may be a map, a grid, or an iterable of them."""
    if isinstance(value, Mapping):
        return False
    # An array without axes has the method of an iterable, and raises an error there.
    is_several = isinstance(value, Iterable) and getattr(value, "ndim", 1) > 0
    return is_several or _dimensions(value) == 2


def _dimensions(value: UserValue) -> int:
    # A list of `RoadMap` has the dimensions of its codes and one more.
    value = getattr(value, "codes", value)
    if not isinstance(value, list | tuple):
        return getattr(value, "ndim", 0)
    if not value:
        return 1
    return 1 + _dimensions(value[0])


def refresh(road_map: RoadMap, name: str) -> RoadMap:
    """Returns a map whose metrics are those of its codes.

    Stored metrics no longer fit a map if its codes were changed by hand.

    A changed map is measured again, and loses what a search said of its former codes: its fitness,
    descriptor, niche, seed and drawn tiles. It keeps its objects and its unsure cells. A command
    says so in a line that begins with `name`. A map without metrics does not change. Town features
    of blocks and streets are not compared, because measuring them needs JAX.
    """
    if road_map.metrics is None:
        return road_map
    metrics = plain_measure(road_map.codes)
    town_features = plain_town(road_map.codes)
    measured = metrics | {feature: value / 1000 for feature, value in town_features.items()}
    # Codes outside the alphabet are not compared, because the alphabet is that of the search.
    del measured["off_alphabet"]
    for metric, value in road_map.metrics.items():
        # The measured coverage is a float32, to which NumPy would convert the stored one.
        if metric in measured and abs(value - float(measured[metric])) > _ROUNDED:
            change = f"{metric} {measured[metric]:g} instead of {value:g}"
            announce_at_end(name, f"measured again, because its codes were changed: {change}")
            return RoadMap(
                road_map.codes, metrics=metrics, objects=road_map.objects, unsure=road_map.unsure
            )
    return road_map


def _read(file: str | Path, most: int, parse: Callable[[Plain], T]) -> T:
    """Reads the values of a file, at most `most` bytes, and makes maps of them by `parse`.

    The values of a map of Duckietown are its codes and objects.
    """
    suffix = check_named("file", path, file).suffix.lower()
    if suffix == ".npz":
        got = "an archive of a search; pick chooses maps from it"
        raise InputError(file, "a file of maps", got)
    if is_folder(Path(file)):
        return check_named(str(file), parse, _values_of_folder(Path(file)))
    is_yaml = suffix in (".yaml", ".yml")
    text = read_input(file, most, "YAML" if is_yaml else "JSON")
    try:
        if is_yaml:
            return parse(_values_of_yaml(text))
        return parse(_values_of_json(text, suffix))
    except InputError as error:
        raise error.within(file) from None
    # Python's JSON reader recurses into nested lists.
    except RecursionError:
        raise InputError(file, "a map", "JSON nested too deeply") from None


def _values_of_folder(folder: Path) -> Plain:
    """Reads the codes and objects of a folder of Duckietown's layers."""
    if not is_layers(folder):
        expected = "a file of a map, or a folder with tiles.yaml"
        raise InputError(folder, expected, f"a folder without{_map_in(folder)}")
    codes, objects = read_layers(folder)
    return {"codes": codes, "objects": objects}


def _map_in(folder: Path) -> str:
    """Returns the end of a message that names a map in a folder of `generate`, or nothing."""
    for pattern in ("maps/*/map.json", "*/map.json"):
        map_files = sorted(folder.glob(pattern))
        if map_files:
            return f"; a map in it is {map_files[0]}"
    return ""


def _values_of_yaml(text: str) -> Plain:
    """Reads the codes and objects of a Duckietown map."""
    codes, objects = read_duckietown(text)
    return {"codes": codes, "objects": objects}


def _values_of_json(text: str, suffix: str) -> Plain:
    """Reads the values of a JSON file. `suffix` is of its name, for messages."""
    try:
        return parse_json(text)
    except InputError:
        raise
    except ValueError as error:
        if suffix not in ("", ".json") and not text.lstrip().startswith(("{", "[")):
            expected = "a map, JSON or Duckietown's .yaml"
            raise InputError("", expected, f"{suffix} without JSON") from None
        # The error is that of JSON, or of a number with more digits than Python converts.
        raise InputError("", "a readable JSON file", error) from None


def _maps_of(values: Plain) -> list[RoadMap]:
    # Rows alone are no list of maps. `_map_of` says what to write instead.
    if not isinstance(values, list) or _are_rows(values):
        return [_map_of(values)]
    return [check_named(f"map {index}", _map_of, item) for index, item in enumerate(values)]


def _map_of(values: Plain) -> RoadMap:
    if not isinstance(values, dict) or "codes" not in values:
        got = 'no "codes"'
        if _are_rows(values):
            got = 'rows alone; write {"codes": ...} around them'
        elif isinstance(values, list):
            got = "a list; name a file with one map"
        raise InputError("", 'a map, {"codes": [[...], ...]}', got)
    if values.get("format", _FORMAT) != _FORMAT:
        raise InputError("format", repr(_FORMAT), quote(values["format"]))
    codes = _grid(values["codes"])
    shape = values.get("shape", list(codes.shape))
    if shape != list(codes.shape):
        expected = f"{list(codes.shape)}, like the codes"
        raise InputError("shape", expected, shorten(json.dumps(shape)))
    fields = {name: value for name, value in values.items() if name in FIELDS or name == "objects"}
    return RoadMap(codes, **fields)


def _grid(rows: Plain) -> NDArray[np.int8]:
    """Reads the codes of a file.

    A wrong code is reported as written, before NumPy converts all cells to one type.
    """
    if isinstance(rows, list) and all(isinstance(row, list) for row in rows):
        check_sides(rows)
        for y, row in enumerate(rows):
            for x, code in enumerate(row):
                if not is_whole(code) or not 0 <= code <= 15:
                    got = shorten(json.dumps(code))
                    raise InputError(
                        "grid", "tile codes 0 to 15", f"{got} at {describe_cell(y, x)}"
                    )
    return known_grid(rows)


def _are_rows(values: Plain) -> bool:
    """Returns whether a value is a grid by itself, as files of fixed cells have it."""
    return (
        isinstance(values, list)
        and len(values) > 0
        # None is a free cell.
        and is_table(values, lambda cell: cell is None or is_number(cell))
    )

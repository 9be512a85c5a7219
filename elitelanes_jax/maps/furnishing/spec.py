"""What a map is furnished with, without JAX."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from elitelanes_jax._util.checks import (
    check_named,
    check_unique,
    flag,
    one_of,
    path_exists,
    real,
    split_settings,
)
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.files import read_toml
from elitelanes_jax._util.records import Record, check_names, option
from elitelanes_jax._util.types import Plain, UserValue
from elitelanes_jax.formats.objects import MapObject, check_objects, object_values
from elitelanes_jax.formats.road_map import read_map
from elitelanes_jax.network.checks import LONGEST_SIDE

# The largest amount of an object, the words for amounts, and the suffixes of files with objects.
_LARGEST_AMOUNT = 100_000
_AMOUNTS = "a share below 1, or a whole number"
_FILES = (".toml", ".json", ".yaml")

AS_MANY_AS_FIT = "a share below 1 places as many as fit"
"""The hint of an error about a number of objects that a map has no room for."""

# The amounts of objects that stand on cells without road.
_BESIDE_ROADS = (
    "buildings", "houses", "buses", "trucks", "trees",
    "barriers", "robots", "cones", "duckies", "crossing_duckies",
)  # fmt: skip

# The options that words give in another form: objects are in files, and a bare word asks for unique
# tags.
_NO_SETTINGS = ("objects", "unique_tags")

# Each of these words is short for the setting of its name with this value.
_SHORT_WORDS: dict[str, UserValue] = {"signs": "all", "street_names": "all", "unique_tags": True}


def _amount(value: UserValue) -> float:
    number: float = real(0, _LARGEST_AMOUNT, unit=_AMOUNTS)(value)
    if number > 1 and number != int(number):
        raise InputError("", _AMOUNTS, quote(value, 40))
    return number


def _check_users_objects(values: UserValue) -> tuple[MapObject, ...]:
    """Checks objects without a map: their positions are checked again when they are placed."""
    # The size of the map is not known here, so positions are checked for the largest one.
    return check_objects(values, LONGEST_SIDE, LONGEST_SIDE)


@dataclass(frozen=True)
class FurnishSpec(Record):
    """The objects that a map gets.

    An amount below 1 is a share of the cells without road: as many objects are placed, or as many
    as fit. A whole number, from 1, is a number of objects; if they do not all fit, an error says
    so. Objects in lanes are on roads, and the street name of a turn is in the outer corner of the
    turn's tile. All other placed objects are on cells without road. No placed object overlaps
    another one. Objects of your own may overlap each other.

    Attributes:
      objects: objects of your own, which are placed first and as they are; see `MapObject`
      signs: none; all: at every crossing, and an error if a road is at its corner; or possible:
        where the corners are free
      lights: share of the crossings that have traffic lights instead of stop signs, 0 to 1
      street_names: none; all: at every road and turn, and an error if one has no room; or possible:
        where there is room
      unique_tags: refuse maps that need a tag number twice, instead of using it again far away
      buildings: amount of buildings
      houses: amount of houses
      buses: amount of parked buses
      trucks: amount of parked trucks
      trees: amount of trees
      barriers: amount of barriers beside roads
      robots: amount of parked robots
      cones: amount of cones beside roads
      duckies: amount of duckies beside roads
      crossing_duckies: amount of duckies that walk across a road, in simulators that move them; at
        first beside it
      lane_robots: amount of robots in lanes
      lane_duckies: amount of duckies in lanes
    """

    objects: tuple[MapObject, ...] = option((), _check_users_objects)
    signs: str = option("none", one_of("none", "possible", "all"), "WHICH")
    lights: float = option(0.0, real(0, 1, unit="a share of the crossings"), "SHARE")
    street_names: str = option("none", one_of("none", "possible", "all"), "WHICH")
    unique_tags: bool = option(False, flag)
    buildings: float = option(0.0, _amount, "AMOUNT")
    houses: float = option(0.0, _amount, "AMOUNT")
    buses: float = option(0.0, _amount, "AMOUNT")
    trucks: float = option(0.0, _amount, "AMOUNT")
    trees: float = option(0.0, _amount, "AMOUNT")
    barriers: float = option(0.0, _amount, "AMOUNT")
    robots: float = option(0.0, _amount, "AMOUNT")
    cones: float = option(0.0, _amount, "AMOUNT")
    duckies: float = option(0.0, _amount, "AMOUNT")
    crossing_duckies: float = option(0.0, _amount, "AMOUNT")
    lane_robots: float = option(0.0, _amount, "AMOUNT")
    lane_duckies: float = option(0.0, _amount, "AMOUNT")

    def settings(self) -> dict[str, Plain]:
        """Returns the settings by name, as JSON has them."""
        return self.values() | {"objects": [object_values(thing) for thing in self.objects]}

    @property
    def numbers_beside_roads(self) -> dict[str, float]:
        """The numbers of objects, by setting, that need cells without road.

        Shares are left out, because a share of no cells is no object.
        """
        amounts = {name: getattr(self, name) for name in _BESIDE_ROADS}
        return {name: amount for name, amount in amounts.items() if amount >= 1}


EVERYTHING = FurnishSpec(
    signs="possible",
    lights=0.2,
    buildings=0.05,
    houses=0.15,
    buses=0.03,
    trucks=0.03,
    trees=0.3,
    barriers=0.05,
    robots=0.05,
    cones=0.1,
    duckies=0.25,
    crossing_duckies=0.05,
)
"""What ``--furnish all`` asks for: no object in a lane."""


def parse_furnish(value: UserValue) -> FurnishSpec:
    """Reads what a map is furnished with, see `furnish`; raises `InputError`."""
    if isinstance(value, FurnishSpec):
        return value
    if isinstance(value, Mapping):
        check_names(value, FurnishSpec.options())
        return FurnishSpec().replace(**value)
    texts = [str(value)] if isinstance(value, str | Path) else value
    if not isinstance(texts, list | tuple) or not all(isinstance(text, str) for text in texts):
        expected = "a FurnishSpec, or words such as signs, all, duckies=6"
        raise InputError("", expected, quote(value, 40))
    # A text may be several words, as commands take them.
    words: list[str] = []
    for text in texts:
        for part in split_settings(text):
            words += _split_words(part)
    return _furnish_of(words)


def _furnish_of(words: Sequence[str]) -> FurnishSpec:
    """Returns what words and settings ask for. Settings override the words, in any order."""
    settings = [name for name in FurnishSpec.options() if name not in _NO_SETTINGS]
    spec = EVERYTHING if "all" in words else FurnishSpec()
    # Words and settings are kept apart until the end, so their order does not matter.
    asked_by_words: dict[str, UserValue] = {}
    asked_by_settings: dict[str, UserValue] = {}
    files: list[str] = []
    for word in words:
        name, _, value = word.partition("=")
        if value and name not in ("", "all"):
            check_names([name], settings)
            if name in asked_by_settings:
                raise InputError("", "each setting once", f"{name} twice")
            asked_by_settings[name] = value
        elif word in _SHORT_WORDS:
            asked_by_words[word] = _SHORT_WORDS[word]
        elif word.endswith(_FILES):
            files.append(word)
        elif word != "all":
            names = ", ".join(f"{name}=..." for name in settings)
            expected = (
                f"all, signs, street_names, unique_tags, {names}, or a file .toml, .json or .yaml"
            )
            raise InputError("", expected, quote(word, 40))
    # A file that is named twice would place each of its objects twice, in one place.
    check_unique("", "file", [str(Path(file).resolve()) for file in files])
    objects = tuple(thing for file in files for thing in _read_objects(file))
    return spec.replace(**(asked_by_words | asked_by_settings), objects=objects)


def _split_words(text: str) -> list[str]:
    """Returns the words of a text. The name of a file may have spaces."""
    if text.endswith(_FILES) and path_exists(Path(text)):
        return [text]
    return text.split()


def _read_objects(file: str) -> tuple[MapObject, ...]:
    """Reads the objects of a map file, or the list "objects" of a TOML file."""
    if not file.endswith(".toml"):
        objects = read_map(file).objects
        if not objects:
            # It may be meant as another map to furnish.
            raise InputError(
                file, "objects to place", "a map without any (a call furnishes one map)"
            )
        return objects
    values = read_toml(file, file)
    if "objects" not in values:
        raise InputError(file, 'a list of "objects"', "none")
    check_named(file, check_names, values, ["objects"])
    return check_named(file, _check_users_objects, values["objects"])

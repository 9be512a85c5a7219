"""Command-line options made from records of settings, and the types of all other arguments."""

import argparse
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import NoReturn, TypeAlias

from elitelanes_jax._util.checks import Check, path, switch, whole
from elitelanes_jax._util.errors import InputError, suggest
from elitelanes_jax._util.progress import Verbosity
from elitelanes_jax._util.records import Option, Record, descriptions
from elitelanes_jax._util.threads import use_cores
from elitelanes_jax._util.types import Untyped, UserValue

Commands: TypeAlias = "argparse._SubParsersAction[Parser]"
"""The commands of a parser; argparse has no public name for their type."""


COMPILING = """The first search of a size and method compiles for 5 to 20 seconds. Compiled
programs are kept in ~/.cache/elitelanes_jax (or in XDG_CACHE_HOME);
JAX_COMPILATION_CACHE_DIR names another folder."""
"""The end of the help of commands that search."""


class _Once(argparse.Action):
    """Stores the value of an option without a default, and refuses a second one."""

    def __call__(self, *given: Untyped) -> None:
        namespace, value = given[1:3]
        if hasattr(namespace, self.dest):
            raise argparse.ArgumentError(self, f"expected one, got {getattr(namespace, self.dest)} and {value}")
        setattr(namespace, self.dest, value)


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line, and exit code 2; of an unknown option it says which is probably meant."""

    def parse_known_args(self, *given: Untyped, **named: Untyped) -> Untyped:
        """Parses, and exits where anything is left over."""
        found, left = super().parse_known_args(*given, **named)
        if left:
            meant = suggest(left[0], self._option_string_actions) if left[0].startswith("--") else ""
            self.error(f"unrecognized arguments: {' '.join(left)}{meant}")
        return found, left

    def error(self, message: str) -> NoReturn:
        """Exits with the message."""
        self.exit(2, f"{self.prog}: {message}\n")


def checked_by(check: Check) -> Callable[[str], UserValue]:
    """Makes a type of argument of a check."""

    def parse(text: str) -> UserValue:
        try:
            return check(text)
        except InputError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return parse


def add_options(command: argparse.ArgumentParser, defaults: Record) -> None:
    """Adds an option for each field of a record that has a metavar, and of the records in its other fields.

    The option's help is the field's description in the record's docstring, with the default.

    Args:
      command: to add to.
      defaults: the record; its values are the defaults.
    """
    said = descriptions(type(defaults))
    for name, option in defaults.options().items():
        default = getattr(defaults, name)
        if option.metavar is None and isinstance(default, Record):
            add_options(command, default)
        elif option.metavar is not None:
            command.add_argument(
                _flag(name, option), **_kind(option, default), help=_help(said[name], default), dest=name
            )


def add_map(command: argparse.ArgumentParser) -> None:
    """Adds the file of a map to a command that draws one."""
    command.add_argument(
        "map", type=checked_by(path), help="a map.json, any JSON file with codes, or a Duckietown map, .yaml"
    )


def add_tile_pictures(command: argparse.ArgumentParser, tile_px: int = 64, usual: str = "the package's own") -> None:
    """Adds ``--tiles`` and ``--tile-px`` to a command that draws a map."""
    command.add_argument("--tiles", type=checked_by(path), metavar="DIR", help=f"tile pictures; by default {usual}")
    command.add_argument(
        "--tile-px",
        type=checked_by(whole(16, 512)),
        default=tile_px,
        metavar="N",
        help=f"side of a tile in pixels; by default {tile_px}",
    )


def add_blend(command: argparse.ArgumentParser) -> None:
    """Adds ``--blend`` to a command that draws maps whole."""
    command.add_argument(
        "--blend",
        type=checked_by(switch),
        metavar="on|off",
        help="bring the light of the tiles together and feather their seams; by default as the set says, photographs "
        "are",
    )


def add_force(command: argparse.ArgumentParser) -> None:
    """Adds ``--force`` to a command that writes a folder."""
    command.add_argument(
        "--force", action="store_true", help="replace the folder, if an earlier run wrote it and nothing else is in it"
    )


def add_verbosity(command: argparse.ArgumentParser) -> None:
    """Adds ``--quiet`` and ``--verbose`` to a command that works for long."""
    either = command.add_mutually_exclusive_group()
    for flag, level, words in (
        ("--quiet", Verbosity.QUIET, "print nothing but errors"),
        ("--verbose", Verbosity.VERBOSE, "tell each step and how long it took"),
    ):
        either.add_argument(
            flag, dest="verbosity", action="store_const", const=level, help=words, default=argparse.SUPPRESS
        )


def add_cores(command: argparse.ArgumentParser) -> None:
    """Adds ``--cores`` to a command that works on all of them."""
    command.add_argument(
        "--cores",
        action=_Cores,
        type=checked_by(whole(1, 1024)),
        default=argparse.SUPPRESS,
        metavar="N",
        help="work on at most so many of the processor's cores; by default on all. The results are the same",
    )


class _Cores(argparse.Action):
    def __call__(self, *given: Untyped) -> None:
        use_cores(given[2])


def add_scheduler(command: argparse.ArgumentParser) -> None:
    """Adds ``--scheduler`` to a command that a cluster can work for."""
    command.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="work on the workers of a Dask cluster, which share the disk: that of its scheduler, tcp://HOST:8786",
    )


def read_options(given: argparse.Namespace, defaults: Record) -> UserValue:
    """Returns the record with the values that were given on the command line.

    Raises:
      InputError: for a value that its field's check refuses; the message names the option.
    """
    values: dict[str, Untyped] = {}
    for name, option in defaults.options().items():
        default = getattr(defaults, name)
        if option.metavar is None and isinstance(default, Record):
            values[name] = read_options(given, default)
        elif hasattr(given, name):
            values[name] = getattr(given, name)
    with naming_options(defaults):
        return defaults.replace(**values)


@contextmanager
def naming_options(defaults: Record, *only: str, **more: str) -> Iterator[None]:
    """Lets errors in its block that start with the name of a field start with the option's name.

    Args:
      defaults: the record with the fields.
      *only: names of fields; by default of all. A file in a message may have the name of another.
      **more: options by other names that errors may start with.
    """
    try:
        yield
    except InputError as error:
        flags = {name: flag for name, flag in _flags(defaults).items() if not only or name in only}
        raise type(error)(_name_flag(str(error), flags | more)) from None


def _name_flag(message: str, flags: Mapping[str, str]) -> str:
    """Replaces the name of a field at the start of a message by its option."""
    name = re.match(r"\w+(?=[: ])", message)
    return flags[name[0]] + message[name.end() :] if name and name[0] in flags else message


def _flags(defaults: Record) -> dict[str, str]:
    """Returns the options for the fields of a record, and of the records in its fields, by name."""
    found: dict[str, str] = {}
    for name, option in defaults.options().items():
        default = getattr(defaults, name)
        if option.metavar is None and isinstance(default, Record):
            found |= _flags(default)
        elif option.metavar is not None:
            found[name] = _flag(name, option)
    return found


def _flag(name: str, option: Option) -> str:
    return f"--{(option.flag or name).replace('_', '-')}"


def _kind(option: Option, default: UserValue) -> dict[str, Untyped]:
    if isinstance(default, bool):
        return {"action": "store_true", "default": argparse.SUPPRESS}
    kind: dict[str, Untyped] = {"default": argparse.SUPPRESS, "metavar": option.metavar}
    if isinstance(option.metavar, tuple):
        return kind | {"nargs": len(option.metavar)}
    if option.many == "once":
        return kind | {"action": _Once}
    return kind | {"nargs": "*" if option.many == "*" else "+", "action": "extend"} if option.many else kind


def _help(description: str, default: UserValue) -> str:
    words = description.replace("`", "").replace("%", "%%")
    if default is None or default is False or default == () or "by default" in words:
        return words
    items = default if isinstance(default, tuple) else (default,)
    shown = ("..".join(map(str, item)) if isinstance(item, tuple) else str(item) for item in items)
    return f"{words}; by default {' '.join(shown)}"

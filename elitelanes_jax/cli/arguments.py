"""Command-line options made from records, and the types of all other arguments."""

import argparse
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn, TypeAlias, TypeVar, cast

from elitelanes_jax._util.checks import TILE_PX, folder, path, whole
from elitelanes_jax._util.errors import InputError, quote, suggest
from elitelanes_jax._util.records import Option, Record, descriptions
from elitelanes_jax._util.threads import use_cores
from elitelanes_jax._util.types import Untyped, UserValue
from elitelanes_jax.cli.program import fail
from elitelanes_jax.search.settings import OPTIONS, Settings
from elitelanes_jax.search.spec import SearchSpec

T = TypeVar("T")
R = TypeVar("R", bound=Record | SearchSpec)

Commands: TypeAlias = "argparse._SubParsersAction[Parser]"
"""The commands of a parser; argparse has no public name for their type."""


COMPILING = """The first search of a size and method compiles for 2 to 15 seconds. Compiled
programs are kept in ~/.cache/elitelanes_jax (or in XDG_CACHE_HOME);
JAX_COMPILATION_CACHE_DIR names another folder."""
"""The end of the help of commands that search."""


class Once(argparse.Action):
    """Stores the value of an option without a default, and refuses a second value."""

    def __call__(self, *arguments: Untyped) -> None:
        # argparse passes the parser, the namespace, the value and the option's name. Without a
        # default, the namespace has the attribute only if the option came already.
        namespace, value = arguments[1:3]
        if hasattr(namespace, self.dest):
            raise argparse.ArgumentError(
                self, f"expected one, got {getattr(namespace, self.dest)} and {value}"
            )
        setattr(namespace, self.dest, value)


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line with exit code 2.

    For an unknown option it suggests a known one.
    """

    # A command's own parser comes here too, therefore the suggestion is one of its options and not
    # of another command.
    def parse_known_args(self, *arguments: Untyped, **named: Untyped) -> Untyped:
        namespace, unknown = super().parse_known_args(*arguments, **named)
        if unknown:
            hint = ""
            if unknown[0].startswith("--"):
                hint = suggest(unknown[0], self._option_string_actions)
            self.error(
                "; ".join(filter(None, (f"unrecognized arguments: {' '.join(unknown)}", hint)))
            )
        return namespace, unknown

    def error(self, message: str) -> NoReturn:
        raise SystemExit(fail(self.prog, message, 2))


def checked_by(check: Callable[[str], T]) -> Callable[[str], T]:
    """Makes a type of argument from a check."""

    def parse(text: str) -> T:
        try:
            return check(text)
        except InputError as error:
            # argparse adds the name of the option, and prints the message as one line.
            raise argparse.ArgumentTypeError(str(error)) from None

    return parse


def file_ending(*suffixes: str) -> Callable[[str], UserValue]:
    """Makes a type of argument: the path of a file whose name ends in one of the suffixes."""
    # The last suffix follows "or", and the others are separated by commas.
    known = " or ".join(filter(None, [", ".join(suffixes[:-1]), suffixes[-1]]))

    def check(text: UserValue) -> Path:
        file: Path = path(text)
        if file.suffix.lower() not in suffixes:
            raise InputError("", f"a name that ends in {known}", quote(str(text), 40))
        return file

    return checked_by(check)


def add_command(
    commands: Commands,
    name: str,
    action: Callable[[argparse.Namespace], int],
    notes: str = "",
    **words: Untyped,
) -> Parser:
    """Adds a command that runs `action`.

    `notes` are shown after its help, line by line; `words` are for argparse.
    """
    if notes:
        # The default formatter would join the lines of the notes.
        words |= {"epilog": notes, "formatter_class": argparse.RawDescriptionHelpFormatter}
    command = commands.add_parser(name, **words)
    command.set_defaults(action=action)
    return command


def add_options(command: argparse.ArgumentParser, defaults: Record) -> None:
    """Adds an option for each field of a record that has a metavar, also in nested records.

    The option's help is the field's description in the record's docstring, with the default: the
    field's value.
    """
    for name, option, default, description in _listed(defaults):
        command.add_argument(
            _flag(name, option),
            **_kind(option, default),
            help=_help(description, default),
            dest=name,
        )


def _listed(defaults: Record | SearchSpec) -> Iterator[tuple[str, Option, UserValue, str]]:
    """Yields the name, option, default and description of each field that is an option.

    The fields of nested records are among them.
    """
    fields, record = _fields_of(defaults)
    description_of = descriptions(type(record))
    for name, option in fields.items():
        default = getattr(record, name)
        if option.metavar is not None:
            yield name, option, default, description_of[name]
        elif isinstance(default, Record | SearchSpec):
            # A field that is a record has the options of its own fields.
            yield from _listed(default)


def _fields_of(defaults: Record | SearchSpec) -> tuple[dict[str, Option], Record | Settings]:
    """Returns the `Option` of each field by name, and an object that has the defaults."""
    # A specification of a search keeps its options in a mapping, and is no `Record`.
    if isinstance(defaults, SearchSpec):
        return OPTIONS, Settings(**defaults.options)
    return defaults.options(), defaults


class _Cores(argparse.Action):
    def __call__(self, *arguments: Untyped) -> None:
        # The limit concerns the whole process, so no command needs to read it.
        use_cores(arguments[2])


# The arguments that several commands have, by name.
_SHARED: dict[str, dict[str, Untyped]] = {
    "map": {
        "type": checked_by(path),
        "help": "a map.json, any JSON file with codes, or a Duckietown map: .yaml, or a "
        "folder of layers",
    },
    "--out": {
        "type": checked_by(folder),
        "required": True,
        "metavar": "DIR",
        "help": "folder to write to, new or empty",
    },
    "--tiles": {
        "type": checked_by(path),
        "metavar": "DIR",
        "help": "tile pictures; by default the package's own",
    },
    "--tile-px": {
        "type": checked_by(TILE_PX),
        "default": 64,
        "metavar": "N",
        "help": "side of a tile in pixels; by default %(default)s",
    },
    "--force": {
        "action": "store_true",
        "help": "replace the folder, if an earlier run wrote all files in it",
    },
    "--quiet": {"action": "store_true", "help": "print nothing but errors"},
    "--cores": {
        "action": _Cores,
        "default": argparse.SUPPRESS,
        "type": checked_by(whole(1, 1024)),
        "metavar": "N",
        "help": "use at most N cores of the processor; by default all. The results are the same",
    },
}


def add_shared(command: argparse.ArgumentParser, *names: str, **changes: Untyped) -> None:
    """Adds arguments that several commands share.

    `changes` replace keyword arguments of `add_argument`.
    """
    for name in names:
        command.add_argument(name, **_SHARED[name] | changes)


@contextmanager
def naming(prefix: object) -> Iterator[None]:
    """Makes errors in its block start with the name of a file or option."""
    try:
        yield
    except InputError as error:
        raise error.within(prefix) from None


def read_options(options: argparse.Namespace, defaults: R) -> R:
    """Returns the record with the values from the command line; errors name the option."""
    fields, record = _fields_of(defaults)
    values: dict[str, Untyped] = {}
    for name, option in fields.items():
        default = getattr(record, name)
        # The options of a nested record are options of the same command.
        if option.metavar is None and isinstance(default, Record | SearchSpec):
            values[name] = read_options(options, default)
        elif hasattr(options, name):
            # An option that was not given keeps the value of `defaults`. A specification tells it
            # from one that was given with the same value, which overrides a style.
            values[name] = getattr(options, name)
    # The record checks its fields here, and its errors name them.
    with naming_options(defaults):
        return cast(R, defaults.replace(**values))


@contextmanager
def naming_options(defaults: Record | SearchSpec, *only: str) -> Iterator[None]:
    """Makes errors in its block name the option instead of the field.

    By default all fields are renamed. `only` limits this to some fields, because a file may have
    the name of another field.
    """
    try:
        yield
    except InputError as error:
        flags = {
            name: _flag(name, option)
            for name, option, *_ in _listed(defaults)
            if not only or name in only
        }
        raise _with_flags(error, flags) from None


def _with_flags(error: InputError, flags: Mapping[str, str]) -> InputError:
    """Returns the error with options instead of fields.

    The subject is a field, and perhaps a part of it: "where crossings". What was expected and the
    hint may name other fields as Python writes them: "none with method='ea'", or without quotes.
    """

    def name_setting(match: re.Match[str]) -> str:
        name, mark, value = match.groups()
        # Without quotes, another name may be that of a feature, such as trees=1.
        if not mark and name not in flags:
            return match[0]
        return f"{flags.get(name, name)} {value}"

    # A file may begin with the name of a field: size.json.
    field = re.match(r"\w+(?=[: ]|$)", error.subject)
    subject = error.subject
    if field is not None and field[0] in flags:
        subject = flags[field[0]] + subject[field.end() :]
    expected, hint = (
        re.sub(r"\b(\w+)=('?)(\w+)\2", name_setting, words)
        for words in (error.expected, error.hint)
    )
    return error.replace(subject=subject, expected=expected, hint=hint)


def _flag(name: str, option: Option) -> str:
    # Fields have underscores, and options have dashes.
    return f"--{(option.flag or name).replace('_', '-')}"


def _kind(option: Option, default: UserValue) -> dict[str, Untyped]:
    # A flag takes no value on the command line. To name it means True.
    if isinstance(default, bool):
        return {"action": "store_true", "default": argparse.SUPPRESS}
    # Without a default, argparse stores only options that were given, see `read_options`.
    kind: dict[str, Untyped] = {"default": argparse.SUPPRESS, "metavar": option.metavar}
    # Each name of a value in the help stands for one value.
    if isinstance(option.metavar, tuple):
        return kind | {"nargs": len(option.metavar)}
    if option.many == "once":
        return kind | {"action": Once}
    if option.many:
        # A repeated option adds values to the earlier ones.
        return kind | {"nargs": "*" if option.many == "*" else "+", "action": "extend"}
    return kind


def _help(description: str, default: UserValue) -> str:
    # argparse reads a single % as the start of a placeholder.
    words = description.replace("`", "").replace("%", "%%")
    # These defaults mean that nothing is asked for, or the description explains them.
    if default is None or default is False or default == () or "by default" in words:
        return words
    items = default if isinstance(default, tuple) else (default,)
    shown = ("..".join(map(str, item)) if isinstance(item, tuple) else str(item) for item in items)
    return "; ".join(filter(None, [words, f"by default {' '.join(shown)}"]))

"""Records of settings: each field is one line with its default, its check and its place on the command line.

A record is a frozen dataclass that inherits `Settings`; its docstring says what each field means. Making one checks all
fields, so that whoever has a record need not check it again. The command line makes its options from the same fields
(`elitelanes_jax.cli.arguments`).
"""

from collections.abc import Callable, Mapping
from dataclasses import field, fields, replace
from typing import NamedTuple, Self

from elitelanes_jax._util.checks import Check, check_named
from elitelanes_jax._util.errors import InputError, likely, short
from elitelanes_jax._util.types import UserValue


class Option(NamedTuple):
    """The properties of a field beside its name, default and description.

    Attributes:
      check: of its value.
      metavar: the words for its values in the command's help; None for no option on the command line.
      flag: the option's name, where it is not the field's.
      many: whether the option takes several values; "*" if it may also stand without any.
      replaces: the name of a field that may not be given beside this one.
      after: the name of a field declared before this one, whose value the check takes as a second argument.
    """

    check: Callable[..., UserValue]
    metavar: str | tuple[str, ...] | None = None
    flag: str | None = None
    many: bool | str = False
    replaces: str | None = None
    after: str | None = None


def option(
    default: UserValue, check: Callable[..., UserValue], metavar: str | tuple[str, ...] | None = None, **more: UserValue
) -> UserValue:
    """Declares a field of `Settings`: its default, and the arguments of `Option`."""
    return field(default=default, metadata={"option": Option(check, metavar, **more)})


class Settings:
    """A record whose fields are checked when it is made."""

    def __post_init__(self) -> None:
        """Checks every field, then the fields together.

        Raises:
          InputError: that starts with the field's name.
        """
        for name, one in self.options().items():
            beside = () if one.after is None else (getattr(self, one.after),)
            object.__setattr__(self, name, check_named(name, one.check, getattr(self, name), *beside))
        self.check_together()

    def check_together(self) -> None:
        """Checks what no field can tell alone; raises `InputError`."""

    @classmethod
    def options(cls) -> dict[str, Option]:
        """Returns the `Option` of each field, by name."""
        return {one.name: one.metadata["option"] for one in fields(cls)}  # type: ignore[arg-type]

    def but(self, given: Mapping[str, UserValue]) -> Self:
        """Returns the record with other values in some fields.

        Raises:
          InputError: for a name that is no field, a value that its check refuses, or two fields of which one replaces
            the other.
        """
        known = self.options()
        for name in given:
            if name not in known:
                raise InputError(f"{name}: expected one of {', '.join(known)}, got {name!r}{likely(name, known)}")
            other = known[name].replaces
            if other is not None and other in given and given[name] is not None:
                raise InputError(f"{name}: expected it or {other}, got both, {given[name]} and {given[other]}")
        return replace(self, **given) if given else self  # type: ignore[type-var]


def record(kind: type[Settings]) -> Check:
    """Makes a check: a record of a kind."""

    def check(value: UserValue) -> Settings:
        if not isinstance(value, kind):
            raise InputError(f"expected {kind.__name__}, got {short(repr(value))}")
        return value

    return check

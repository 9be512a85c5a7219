"""Words that set the fields of a record, such as ``standard noise=0``."""

from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType
from typing import TypeVar

from elitelanes_jax._util.checks import check_unique
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.records import Record
from elitelanes_jax._util.types import UserValue

R = TypeVar("R", bound=Record)


def parse_words(
    field: str,
    defaults: R,
    value: UserValue,
    kind: str,
    example: str,
    *,
    presets: Mapping[str, R] = MappingProxyType({}),
    names: Collection[str] | None = None,
) -> R:
    """Reads a record from words ``NAME=VALUE`` or from a mapping of its fields.

    A record is returned unchanged. The first word may be the name of a preset. A flag is a word
    without a value. Words may set the fields `names`, by default all. `field`, `kind` and `example`
    are for messages.
    """
    if isinstance(value, type(defaults)):
        return value
    # A mapping comes from Python and names the fields directly.
    if isinstance(value, Mapping):
        return defaults.replace(**{str(name): setting for name, setting in value.items()})
    words = [value] if isinstance(value, str) else value
    if not isinstance(words, Sequence) or not all(isinstance(word, str) for word in words):
        raise InputError(field, f"words such as {example}", quote(value))
    # A name that is given twice has no clear value.
    check_unique(field, kind, [word.partition("=")[0] for word in words])
    # A preset after other words would override them without notice.
    late_presets = [word for word in words[1:] if word in presets]
    if late_presets:
        expected = f"{late_presets[0]} alone or first, because it sets all {kind}s"
        raise InputError(field, expected, f"it after {words[0]}")
    # Fields that are False by default are flags, and all others take a number.
    names = defaults.options() if names is None else names
    flags = {name.replace("_", "-"): name for name in names if getattr(defaults, name) is False}
    numbers = [name for name in names if name not in flags.values()]
    record = defaults
    # A preset comes first, and the words after it change single fields.
    for word in words:
        name, equals, number = word.partition("=")
        if word in presets:
            record = presets[word]
        elif word in flags:
            record = record.replace(**{flags[word]: True})
        elif equals and number and name in numbers:
            record = record.replace(**{name: number})
        else:
            settings = [f"{known}=..." for known in numbers]
            expected = ", ".join([*presets, *flags, *settings])
            raise InputError(field, f"some of {expected}", quote(word))
    return record

"""Reads YAML as plain lists, tables and texts, safely for any file.

PyYAML's own loader crashes on deep nesting and follows aliases and merge keys without limit. Here
the nesting and the merged keys are limited, an alias is the value that it names, not a copy, and
scalars stay texts: no numbers, dates or objects.
"""

import re
from collections.abc import Iterable

import yaml

from elitelanes_jax._util.errors import InputError, brief, shorten, yaml_fault
from elitelanes_jax._util.types import Plain

_DEEPEST = 64
# The most values of a document: a map of 1024 x 1024 tiles has 2**20 values, and 260,000 are left
# for other things. They take 3 s.
_MOST_VALUES = 5 * 2**18
# The merge key of YAML 1.1. A table takes the entries of the tables under it, except for keys that
# the table has itself.
_MERGE = "<<"
# The most directives of a document. Libyaml compares each with all before it.
_MOST_DIRECTIVES = 16
# A directive begins a line. YAML 1.1 has more line breaks than `re.MULTILINE` knows.
_DIRECTIVE = re.compile(r"(?:^|[\r\n\x85\u2028\u2029])%TAG\b")


def yaml_tree(text: str) -> Plain:
    """Reads a YAML document.

    Returns:
      Lists, dictionaries and strings; None for an empty document. Tags have no meaning. A value may
      contain itself through an alias.

    Raises:
      InputError: if it is not YAML, has several documents, is nested deeper than 64 levels, has
        over 1.3 million values, an alias without its anchor, a repeated key, a key that is not a
        text, or a merge key without tables.
    """
    if len(_DIRECTIVE.findall(text)) >= _MOST_DIRECTIVES:
        raise InputError("", "readable YAML", f"{_MOST_DIRECTIVES} directives and more")
    try:
        return _build(yaml.parse(text, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader)))
    except InputError:
        raise
    # Without libyaml, an escape beyond Unicode is one of the last two errors.
    except (yaml.YAMLError, ValueError, OverflowError) as error:
        # From PyYAML 6.0.4 on, libyaml itself counts levels. It reads ahead, so its error may come
        # first.
        if "maximum nesting depth" in str(error):
            raise _too_deep() from None
        raise InputError("", "readable YAML", yaml_fault(error)) from None


def _build(events: Iterable[yaml.Event]) -> Plain:
    # This loop reads one event at a time, because PyYAML's own loader recurses and crashes on deep
    # nesting.
    documents: list[Plain] = []
    anchors: dict[str, Plain] = {}
    # Lists and tables that have not ended, each with its items. The first entry collects documents.
    opened: list[tuple[Plain, list[Plain]]] = [(None, documents)]
    values = 0
    for event in events:
        match event:
            case yaml.ScalarEvent():
                value = event.value
            case yaml.SequenceStartEvent():
                value = []
            case yaml.MappingStartEvent():
                value = {}
            case yaml.AliasEvent():
                if event.anchor not in anchors:
                    raise InputError(
                        "", "readable YAML", f"an alias of nothing, *{shorten(event.anchor)}"
                    )
                value = anchors[event.anchor]
            case yaml.MappingEndEvent():
                table, items = opened.pop()
                assert isinstance(table, dict)
                _fill(table, items)
                if _MERGE in table:
                    # A table gets its entries when it ends, so an outer table is still empty and
                    # cannot be merged.
                    unfilled = [outer for outer, _ in opened] + [table]
                    merged = _tables_of(table.pop(_MERGE), unfilled)
                    # Merged keys count too, because merge keys can copy a large table many times.
                    # They count before they are copied, because one merge key can have very many
                    # tables.
                    values += sum(map(len, merged))
                    if values > _MOST_VALUES:
                        raise _too_many()
                    # The table's own keys override merged ones. The place of the merge key does not
                    # matter.
                    for other in merged:
                        for key, entry in other.items():
                            table.setdefault(key, entry)
                continue
            case yaml.SequenceEndEvent():
                opened.pop()
                continue
            case _:
                continue
        # A value that belongs to no list or table is a document.
        if documents and len(opened) == 1:
            raise InputError("", "readable YAML of one document", "several")
        values += 1
        if values > _MOST_VALUES:
            raise _too_many()
        opened[-1][1].append(value)
        # An anchor is noted before its list or table is filled. A value may therefore contain
        # itself.
        if event.anchor is not None:
            anchors[event.anchor] = value
        if isinstance(event, yaml.CollectionStartEvent):
            # A list collects its own items. A table's items are keys and values, which become
            # entries later.
            opened.append((value, value if isinstance(value, list) else []))
            if len(opened) > _DEEPEST + 1:
                raise _too_deep()
    return documents[0] if documents else None


def _fill(table: dict[str, Plain], items: list[Plain]) -> None:
    """Adds keys and values to a table. They take turns in `items`."""
    for key, value in zip(items[::2], items[1::2], strict=True):
        if not isinstance(key, str):
            raise InputError(
                "", "readable YAML, its keys texts", f"a {type(key).__name__} for a key"
            )
        if key in table:
            raise InputError("YAML", "each key once", f"{shorten(key, 40)} twice")
        table[key] = value


def _tables_of(value: Plain, unfilled: list[Plain]) -> list[dict[str, Plain]]:
    """Returns the tables of a merge key, the first one first.

    If several tables have a key, the value of the first table counts.
    """
    tables: list[dict[str, Plain]] = []
    for table in value if isinstance(value, list) else [value]:
        if not isinstance(table, dict) or any(table is outer for outer in unfilled):
            raise InputError(
                "",
                f"readable YAML, for the key {_MERGE} a table or a list of tables",
                brief(value, 40),
            )
        tables.append(table)
    return tables


def _too_deep() -> InputError:
    return InputError("", f"YAML nested up to {_DEEPEST} levels deep", "more")


def _too_many() -> InputError:
    return InputError("", f"YAML of at most {_MOST_VALUES:,} values", "more")

"""The command ``elitelanes metrics``."""

import argparse
from itertools import zip_longest
from textwrap import wrap

from elitelanes_jax._util.checks import nonblank
from elitelanes_jax.cli.arguments import Commands, add_command, checked_by
from elitelanes_jax.cli.program import say

# The width of the text in characters. 30 of the 43 meanings fit on a line then; with a width of 100
# it is 25, and some meanings take four lines.
_WIDTH = 110
# The width of the column of values. The longest value has 18 characters.
_VALUES_WIDE = 19
# The width of the column of the first map, whose drawing has 23 characters.
_SKETCH_WIDE = 28


def add_metrics(commands: Commands) -> None:
    command = add_command(
        commands,
        "metrics",
        _metrics,
        help="list all metrics, or show one",
        description="Lists all metrics, shares and features of a town, with known ranges on maps of "
        "12 x 12 tiles; or shows one, with maps at both ends of its range. --where and --axes take "
        "all names, and --weights all but shares.",
    )
    command.add_argument(
        "name", nargs="?", type=checked_by(nonblank), metavar="NAME", help="what to show"
    )


def _metrics(options: argparse.Namespace) -> int:
    from elitelanes_jax.problem.extremes import describe_features
    from elitelanes_jax.problem.features import check_feature

    # The list and a single metric have the same texts.
    listed = describe_features()
    # An unknown name is an error with a suggestion.
    if options.name is not None:
        say(_show(check_feature("metrics", options.name), *listed[options.name]), asked=True)
        return 0
    say(_list(listed), asked=True)
    return 0


def _list(listed: dict[str, tuple[str, str]]) -> str:
    """Returns a table: name, values and meaning of each feature."""
    wide = max(map(len, listed))
    indent = wide + 2 + _VALUES_WIDE + 2
    lines = [f"{'':{wide}}  at 12 x 12"]
    for feature, (meaning, values) in listed.items():
        head = f"{feature:{wide}}  {values:{_VALUES_WIDE}}  "
        # A meaning of several lines continues below its first one.
        for part in wrap(meaning, _WIDTH - indent):
            lines.append(head + part)
            head = " " * indent
    lines += [
        "",
        f"--where NAME=LOW..HIGH sets a range; elitelanes metrics NAME shows one metric. {_NOTE}",
    ]
    return "\n".join(lines)


_NOTE = (
    "Searches\nfound maps with these ranges. With --rules cells may stay empty. Without, a town "
    "feature marked filled\nhas this value on all maps."
)
# The metrics that have one value on filled maps, and others where cells are empty.
_OF_EMPTY_CELLS = {"tiles", "empty_cells", "coverage"}
_IF_NONE_IS_EMPTY = (
    "all maps of generate without empty cells have this value. With --rules, --inventory or --style "
    "town\ncells may stay empty."
)
_MEASURED = "measured only in searches that name it, because it costs time"


def _show(feature: str, meaning: str, values: str) -> str:
    from elitelanes_jax.formats.sketch import draw_text
    from elitelanes_jax.problem.extremes import extreme_maps, feature_range, value_text
    from elitelanes_jax.problem.features import TOWN_FEATURES

    lines = wrap(f"{feature}: {meaning}", _WIDTH)
    lines.append("")
    # For features of towns, no maps at both ends of the range are known.
    if feature in TOWN_FEATURES:
        lines.append(f"{values}; {_MEASURED}")
        return "\n".join(lines)
    lines.append(f"{values} on maps of 12 x 12 tiles")
    low, high = feature_range(feature)
    # Two maps of one value would show nothing.
    if low == high:
        has_others = feature in _OF_EMPTY_CELLS
        lines.append(_IF_NONE_IS_EMPTY if has_others else "all maps of generate have this value")
        return "\n".join(lines)
    lines += ["", f"{value_text(low):{_SKETCH_WIDE}}{value_text(high)}"]
    least, most = extreme_maps(feature)
    # Both maps are side by side, the one with the least value on the left.
    rows = zip_longest(draw_text(least).splitlines(), draw_text(most).splitlines(), fillvalue="")
    lines += [f"{left:{_SKETCH_WIDE}}{right}" for left, right in rows]
    return "\n".join(lines)

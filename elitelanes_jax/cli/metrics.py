"""The command ``elitelanes metrics``."""

import argparse
from itertools import zip_longest
from textwrap import wrap

from elitelanes_jax._util.checks import name
from elitelanes_jax.cli.arguments import Commands, add_command, checked_by
from elitelanes_jax.cli.program import say

_WIDTH = 110


def add_metrics(commands: Commands) -> None:
    command = add_command(
        commands,
        "metrics",
        _metrics,
        help="list all metrics, or show one",
        description="Lists all metrics, shares and features of a town that --where, --axes and --weights name, with "
        "known ranges on maps of 12 x 12 tiles; or shows one, with maps at both ends of its range.",
    )
    command.add_argument("name", nargs="?", type=checked_by(name), metavar="NAME", help="what to show")


def _metrics(options: argparse.Namespace) -> int:
    from elitelanes_jax.problem.extremes import describe_features
    from elitelanes_jax.problem.features import check_feature

    listed = describe_features()
    if options.name is not None:
        say(_show(check_feature("metrics", options.name), *listed[options.name]), asked=True)
        return 0
    wide = max(map(len, listed))
    lines = [f"{'':{wide}}  at 12 x 12"]
    for feature, (meaning, values) in listed.items():
        first, *more = wrap(meaning, _WIDTH - wide - 23)
        lines.append(f"{feature:{wide}}  {values:19}  {first}")
        lines += [f"{'':{wide + 23}}{line}" for line in more]
    lines += ["", f"--where NAME=LOW..HIGH sets a range; elitelanes metrics NAME shows one metric. {_NOTE}"]
    say("\n".join(lines), asked=True)
    return 0


_NOTE = (
    "Searches\nfound maps with these ranges. With --rules cells may stay empty. Without, a town feature marked filled\n"
    "has this value on all maps."
)
_MEASURED = "measured only in searches that name it, because it costs time"


def _show(feature: str, meaning: str, values: str) -> str:
    from elitelanes_jax.formats.sketch import draw_text
    from elitelanes_jax.problem.extremes import extreme_maps, feature_range, value_text
    from elitelanes_jax.problem.features import TOWN_FEATURES

    if feature in TOWN_FEATURES:
        return "\n".join([*wrap(f"{feature}: {meaning}", _WIDTH), "", f"{values}; {_MEASURED}"])
    low, high = feature_range(feature)
    lines = [*wrap(f"{feature}: {meaning}", _WIDTH), "", f"{values} on maps of 12 x 12 tiles"]
    if low == high:
        return "\n".join([*lines, "all maps of generate have this value"])
    least, most = (draw_text(grid).splitlines() for grid in extreme_maps(feature))
    lines += ["", f"{value_text(low):28}{value_text(high)}"]
    return "\n".join([*lines, *(f"{one:28}{other}" for one, other in zip_longest(least, most))])

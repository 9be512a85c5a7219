"""The command ``elitelanes metrics``."""

import argparse
from itertools import zip_longest
from textwrap import wrap

from elitelanes_jax._util.checks import name
from elitelanes_jax.cli.arguments import Commands, checked_by, descriptions
from elitelanes_jax.cli.program import say

_WIDTH = 110


def add_metrics(commands: Commands) -> None:
    """Adds the command to a parser's."""
    command = commands.add_parser(
        "metrics",
        help="list what maps can be asked for, or show one metric",
        description="Lists all metrics and shares that --where, --axes and --weights name, with their ranges on maps "
        "of 12 x 12 tiles as generate writes them; or shows one, with maps that have the least and the most of it.",
    )
    command.add_argument("name", nargs="?", type=checked_by(name), metavar="NAME", help="the metric or share to show")
    command.set_defaults(action=_metrics)


def meanings() -> dict[str, str]:
    """Returns what each metric and each share means, by name: metrics from the docstring of their record."""
    from elitelanes_jax.network.metric_names import Metrics
    from elitelanes_jax.network.town_features import TownFeatures
    from elitelanes_jax.problem.features import FEATURES, SHARES, TOWN_FEATURES

    shares = {share: f"{part} / {' + '.join(whole)}" for share, (part, whole) in SHARES.items()}
    known = shares | descriptions(Metrics) | descriptions(TownFeatures)
    return {name: known[name] for name in (*FEATURES, *TOWN_FEATURES)}


def range_text(name: str) -> str:
    """Returns the range of a metric or share at 12 x 12 in words, with a limit that lies beyond it in parentheses.

    Of a feature of a town the unit, and the value that it has on all maps without empty cells.
    """
    from elitelanes_jax.problem.extremes import feature_bounds, feature_range
    from elitelanes_jax.problem.features import TOWN_FEATURES, feature_unit, is_share

    if name in TOWN_FEATURES:
        unit = "0..1" if is_share(name) else "a ratio" if feature_unit(name) > 1 else "a number"
        least, most = feature_bounds(name)
        return f"{unit}; filled {number(float(least))}" if least == most else unit
    low, high = feature_range(name)
    if low == high:
        return number(low)
    least, most = (number(type(low)(limit)) for limit in feature_bounds(name))
    below, above = (f"({least}) " if least != number(low) else ""), (f" ({most})" if most != number(high) else "")
    return f"{below}{number(low)}..{number(high)}{above}"


def number(value: float) -> str:
    """Returns a value of a metric or share in words."""
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _metrics(options: argparse.Namespace) -> int:
    from elitelanes_jax.problem.features import check_feature

    listed = meanings()
    if options.name is not None:
        say(_show(check_feature("metrics", options.name), listed[options.name]), asked=True)
        return 0
    wide = max(map(len, listed))
    lines = [f"{'':{wide}}  at 12 x 12"]
    for feature, meaning in listed.items():
        first, *more = wrap(meaning, _WIDTH - wide - 23)
        lines.append(f"{feature:{wide}}  {range_text(feature):19}  {first}")
        lines += [f"{'':{wide + 23}}{line}" for line in more]
    lines += ["", f"--where NAME=LOW..HIGH asks for a range; elitelanes metrics NAME shows one. {_NOTE}"]
    say("\n".join(lines), asked=True)
    return 0


_NOTE = (
    "Maps of these ranges were\nfound; none can go beyond, or beyond the number in parentheses. With --rules cells may "
    "stay empty;\nwithout, a feature of a town marked filled has this one value."
)
_MEASURED = "measured only in searches that name it, as it costs time"


def _show(feature: str, meaning: str) -> str:
    from elitelanes_jax.formats.text import draw_text
    from elitelanes_jax.problem.extremes import extreme_maps, feature_range
    from elitelanes_jax.problem.features import TOWN_FEATURES

    if feature in TOWN_FEATURES:
        return "\n".join([*wrap(f"{feature}: {meaning}", _WIDTH), "", f"{range_text(feature)}; {_MEASURED}"])
    low, high = feature_range(feature)
    lines = [*wrap(f"{feature}: {meaning}", _WIDTH), "", f"{range_text(feature)} on maps of 12 x 12 tiles"]
    if low == high:
        return "\n".join([*lines, "all maps that are written have this value"])
    least, most = (draw_text(grid).splitlines() for grid in extreme_maps(feature))
    lines += ["", f"{number(low):28}{number(high)}"]
    return "\n".join([*lines, *(f"{one:28}{other}" for one, other in zip_longest(least, most))])

"""Plots: a map as lines, an archive as a heat map, runs over seeds.

Each draws on `ax`, by default on a new figure, and returns the Axes. All need matplotlib, the extra
`plots`.
"""

from collections.abc import Sequence
from math import prod
from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, is_whole, items_of, unmasked
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.packages import import_optional
from elitelanes_jax._util.types import ArrayOrRows, Untyped, UserValue
from elitelanes_jax.formats.road_map import as_map
from elitelanes_jax.lanes.links import linked_codes
from elitelanes_jax.network.codes import CONNECTIONS, EAST, KINDS, SIDE_TOWARDS, SIDES, SOUTH

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from elitelanes_jax.problem.descriptor import Axis
    from elitelanes_jax.search.records import History
    from elitelanes_jax.search.result import Result

__all__ = ["archive_map", "history", "road_map", "seed_band"]

_GROUND, _KERB, _ROAD, _LANE, _END, _LOOP, _VACANT = (
    "#eef0ea",
    "#b9bdb4",
    "#4a4f5a",
    "#f5c842",
    "#d7263d",
    "#ff8c42",
    "#e9e9e6",
)

_HARD_SPACE = "\N{NO-BREAK SPACE}"

# The points of a line, [P, 2], x and y in tiles.
_Line = NDArray[np.float64]

# Widths as parts of the road's.
_KERB_WIDTH, _LANE_WIDTH, _LOOP_WIDTH = 1.2, 0.09, 0.4


@name_wrong_arguments
def road_map(
    source: UserValue,
    *,
    width: float = 0.5,
    lanes: bool = True,
    marked: UserValue = None,
    loop: ArrayOrRows = (),
    ax: "Axes | None" = None,
) -> "Axes":
    """Draws a map in lines: roads as ribbons, turns round, north at the top, one unit per tile.

    Each link is one ribbon from the middle of a tile to the middle of the next; an unmatched
    connection reaches the tile's side. A red bar marks where a road ends: in a tile with a single
    connection, or at such a side.

    Args:
      source: a `RoadMap`, a grid ``[H, W]`` of codes, repaired or not, or a file.
      width: the width of the roads, a part of a tile's side, over 0 and at most 0.8.
      lanes: whether to draw the line between the lanes. Small pictures are clearer without it.
      marked: bool ``[H, W]``, cells to colour, such as the dirty tiles of a move.
      loop: the tiles of a loop, as pairs or an array ``[N, 2]`` of row and column in the order of
        the loop, such as those of `network.gridlock_loop`. A line on the roads shows it.
      ax: the Axes to draw on; by default those of a new figure.

    Raises:
      InputError: for a bad map, a width out of its range, masked cells, or a mask of another shape
        or of texts. Also for a loop with a step that is no link of the map, or without matplotlib.
    """
    codes = np.asarray(as_map(source).codes)
    if not 0 < width <= 0.8:
        expected = "a part of a tile's side, over 0 and at most 0.8"
        raise InputError("width", expected, repr(width))
    rows, columns = codes.shape
    is_marked = np.zeros((rows, columns), bool)
    if marked is not None:
        is_marked = _check_mask(marked, (rows, columns))
    loop_codes = _codes_of_loop(loop, codes)

    # The arguments are checked before the figure is made, so that an error leaves no empty figure.
    ax = _axes(ax)
    # One unit is a tile. Rows count downwards, so the vertical axis is reversed.
    ax.set_aspect("equal")
    ax.set(xlim=(0, columns), ylim=(rows, 0), xticks=[], yticks=[], facecolor=_GROUND)
    ax.spines[:].set_visible(False)

    lines, ends = _links(codes)
    _draw_marked_cells(ax, is_marked)
    # The wider kerb is drawn first, so that the road covers its middle.
    _draw_ribbons(ax, lines, _KERB_WIDTH * width, _KERB, "kerb")
    _draw_ribbons(ax, lines, width, _ROAD, "road")
    if lanes:
        _draw_lane_lines(ax, lines, _LANE_WIDTH * width, (rows, columns))
    _draw_end_bars(ax, ends, width + 0.2)
    if loop_codes.any():
        _draw_ribbons(ax, _links(loop_codes)[0], _LOOP_WIDTH * width, _LOOP, "loop")
    return ax


def _codes_of_loop(loop: UserValue, codes: NDArray[np.int8]) -> NDArray[np.int8]:
    """Returns a grid that has the links of a loop alone."""
    tiles = []
    try:
        for tile in items_of(loop):
            row, column = items_of(tile)
            # A fraction or a flag would be another tile as a whole number.
            if not is_whole(row) or not is_whole(column):
                raise ValueError("no index of a tile")
            tiles.append((int(row), int(column)))
    except (TypeError, ValueError):
        raise InputError("loop", "pairs of row and column", quote(loop)) from None
    links = linked_codes(codes)
    loop_codes = np.zeros_like(codes)
    for place, following in zip(tiles, [*tiles[1:], *tiles[:1]], strict=True):
        step = (following[0] - place[0], following[1] - place[1])
        side = SIDE_TOWARDS.get(step)
        if side is None or place not in np.ndindex(codes.shape) or not links[place] & side.bit:
            expected = "tiles of a loop, each linked to the next one"
            raise InputError("loop", expected, f"{place} before {following}")
        loop_codes[place] |= side.bit
        loop_codes[following] |= side.opposite
    return loop_codes


def _check_mask(marked: UserValue, shape: tuple[int, int]) -> NDArray[np.bool_]:
    check_named("marked", unmasked, marked)
    expected = f"a mask of the grid's shape {shape}"
    try:
        mask = np.asarray(marked)
    except ValueError:
        # The rows have several lengths.
        raise InputError("marked", expected, quote(marked)) from None
    if mask.shape != shape:
        raise InputError("marked", expected, mask.shape)
    # NumPy takes every text for true, also "False".
    if mask.dtype.kind in "SU":
        raise InputError("marked", expected, quote(marked))
    return mask.astype(bool)


def _draw_marked_cells(ax: "Axes", is_marked: NDArray[np.bool_]) -> None:
    from matplotlib.collections import PolyCollection

    squares = []
    for y, x in np.argwhere(is_marked):
        squares.append([(x, y), (x + 1, y), (x + 1, y + 1), (x, y + 1)])
    ax.add_collection(PolyCollection(squares, facecolors="#ffdf9e", label="marked"))


def _draw_ribbons(
    ax: "Axes", lines: Sequence[_Line], width: float, colour: str, label: str
) -> None:
    """Draws each line as a ribbon of a width in tiles."""
    from matplotlib.collections import PolyCollection

    polygons = [_ribbon(line, width) for line in lines]
    # A hairline of the same colour closes the seams between smoothed edges.
    ribbons = PolyCollection(
        polygons,
        facecolors=colour,
        edgecolors=colour,
        linewidths=0.3,
        snap=False,
        label=label,
    )
    ax.add_collection(ribbons)


def _draw_lane_lines(
    ax: "Axes", lines: Sequence[_Line], width: float, shape: tuple[int, int]
) -> None:
    """Draws the dashed lines between the lanes.

    Matplotlib wants their width in points instead of tiles.
    """
    from matplotlib.collections import LineCollection

    rows, columns = shape
    box = ax.get_window_extent()
    # With equal scales on both axes, the tighter one decides the size of a tile.
    pixels_per_tile = min(box.width / columns, box.height / rows)
    points = width * 72 / ax.figure.dpi * pixels_per_tile
    dashes = (0, (2.2, 1.5))
    lane_lines = LineCollection(
        lines, colors=_LANE, linewidths=points, linestyles=dashes, label="lanes"
    )
    ax.add_collection(lane_lines)


def _draw_end_bars(ax: "Axes", ends: Sequence[_Line], width: float) -> None:
    from matplotlib.collections import PolyCollection

    bars = [_bar(line, width) for line in ends]
    ax.add_collection(PolyCollection(bars, facecolors=_END, label="ends"))


@name_wrong_arguments
def archive_map(
    fitness: "ArrayOrRows | Result",
    axes: "Sequence[Axis] | None" = None,
    *,
    across: str | None = None,
    down: Sequence[str] | str | None = None,
    label: str = "fitness",
    ax: "Axes | None" = None,
    **image: Untyped,
) -> "Axes":
    """Draws an archive as a heat map.

    One axis of the descriptor is across, and one or several others are down. Each cell shows the
    lowest fitness over the axes that are not named, and over all seeds. A cell without filled
    niches is hatched.

    Args:
      fitness: a `Result` or its elites; or numbers ``[..., N]``, lower is better, in the order of
        `Problem.niche`: the fitness of a `Population`, or of a QDax repertoire with its sign
        changed and one axis. The largest int32 and numbers that are not finite mean vacant.
      axes: the axes of the descriptor space, for anything but a `Result`, which has its own.
      across: the metric of an axis; by default the one with most bins among those that `down` does
        not name, the first of several.
      down: the metrics of one axis or of several, of which the last changes fastest from row to
        row; by default all others.
      label: the label of the colour bar.
      ax: the Axes to draw on; by default those of a new figure.
      image: further arguments of matplotlib's `imshow`, such as ``vmax`` if a few bad niches hide
        the differences of others.

    Raises:
      InputError: for another number of niches, for masked numbers, for a name that is not an axis'
        or occurs twice, or without matplotlib.
    """
    from elitelanes_jax.problem.descriptor import parse_axes

    source: Untyped = fitness
    if hasattr(source, "elites"):
        # The source is a result.
        fitness = source.elites.fitness
        own = source.search.axes
        if axes is not None and parse_axes(axes, features=None) != own:
            raise InputError("axes", "none with a Result, which has its own", quote(axes))
        axes = own
    elif hasattr(source, "fitness"):
        # The source is a result's elites.
        fitness = source.fitness
    if axes is None:
        raise InputError(
            "axes", "the axes of the niches, or a Result instead of its fitness", "none"
        )
    axes = parse_axes(axes, features=None)
    if not all(axis.width for axis in axes):
        raise InputError("axes", "ones with a width, such as result.search.axes", "one without")
    # The names say in which order the table has its axes.
    shown_names = _names_of(axes, across, down)
    axis_by_name = {axis.metric: axis for axis in axes}
    shown_axes = [axis_by_name[name] for name in shown_names]
    table = _niche_table(_check_fitness(fitness), axes, shown_names)

    ax = _axes(ax)
    style: dict[str, Untyped] = {
        "cmap": "viridis_r",
        "aspect": "auto",
        "interpolation": "nearest",
    }
    cells = ax.imshow(np.ma.masked_invalid(table), **(style | image))
    # Vacant cells are masked, so the background shows through them.
    ax.patch.set(facecolor=_VACANT, hatch="////", edgecolor="#cfcfca", linewidth=0)
    ax.figure.colorbar(cells, ax=ax, label=label)
    _label_columns(ax, shown_axes[-1])
    _label_rows(ax, shown_axes[:-1])
    return ax


def _check_fitness(fitness: UserValue) -> NDArray[np.float64]:
    check_named("fitness", unmasked, fitness)
    try:
        return np.asarray(fitness, float)
    except (TypeError, ValueError):
        # The values are texts, or rows of several lengths.
        raise InputError("fitness", "numbers", quote(fitness)) from None


def _names_of(
    axes: "Sequence[Axis]", across: str | None, down: Sequence[str] | str | None
) -> list[str]:
    """Returns the names of the shown axes: first the axes down, then the axis across."""
    names = [axis.metric for axis in axes]
    if down is None:
        names_down = []
    elif isinstance(down, str):
        names_down = [down]
    else:
        names_down = list(down)
    culprit = "across"
    if across is None:
        candidates = [axis for axis in axes if axis.metric not in names_down]
        # If `down` names all axes, the check below refuses it.
        culprit = "across" if candidates else "down"
        across = max(candidates or axes, key=lambda axis: axis.bins).metric
    if down is None:
        names_down = [name for name in names if name != across]
    # The axis across comes last, because its niches are neighbours in a row of the table.
    shown_names = [*names_down, across]
    for name in shown_names:
        if name not in names or shown_names.count(name) > 1:
            argument = culprit if name == across else "down"
            expected = f"each of {', '.join(names)} at most once"
            raise InputError(argument, expected, ", ".join(shown_names))
    return shown_names


def _niche_table(
    fitness: NDArray[np.float64], axes: "Sequence[Axis]", shown: Sequence[str]
) -> NDArray[np.float64]:
    """Returns the lowest fitness ``[rows, columns]`` over seeds and hidden axes.

    It is infinite where no niche is filled.
    """
    names = [axis.metric for axis in axes]
    bins = [axis.bins for axis in axes]
    if not fitness.size or fitness.shape[-1:] != (prod(bins),):
        raise InputError(
            "fitness", f"{prod(bins)} niches on the last axis", f"shape {fitness.shape}"
        )
    by_seed = np.where(_is_of_grid(fitness), fitness, np.inf).reshape(-1, *bins)
    lowest = by_seed.min(axis=0)
    # Each axis that is not shown is reduced to its best niche.
    hidden = tuple(index for index, name in enumerate(names) if name not in shown)
    lowest = lowest.min(axis=hidden)
    remaining = [name for name in names if name in shown]
    # The remaining axes are in the order of the descriptor. The picture has them in the order of
    # `shown`.
    order = [remaining.index(name) for name in shown]
    columns = bins[names.index(shown[-1])]
    return lowest.transpose(order).reshape(-1, columns)


def _is_of_grid(fitness: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Returns which numbers are the fitness of a grid, and not of a vacant slot."""
    # A vacant slot has infinity or the largest int32, which becomes 2**31 as a float32.
    return np.isfinite(fitness) & (fitness != 2**31 - 1) & (fitness != 2**31)


def _label_columns(ax: "Axes", axis: "Axis") -> None:
    """Labels the bins of the axis across, ten at most."""
    step = -(-axis.bins // 9)
    ticks = range(0, axis.bins, step)
    ax.set_xticks(ticks, [_bin_name(axis, index) for index in ticks])
    ax.set_xlabel(_in_words(axis.metric))


def _label_rows(ax: "Axes", axes: "Sequence[Axis]") -> None:
    """Labels the rows by their bins on the axes down.

    Lines separate the groups of bins on the last axis.
    """
    if not axes:
        # All axes are in the columns.
        ax.set_yticks([])
        return
    names = [axis.metric.replace("_", _HARD_SPACE) for axis in axes]
    ax.set_ylabel(fill(f"{_HARD_SPACE}· ".join(names), 44))
    labels = []
    bins = [axis.bins for axis in axes]
    for indices in np.ndindex(*bins):
        bin_names = [_bin_name(axis, index) for axis, index in zip(axes, indices, strict=True)]
        labels.append(" · ".join(bin_names))
    # Shows as many labels as are legible, and the same ones in each group.
    group = axes[-1].bins
    step = -(-len(labels) // 32)
    while group % step and step % group:
        step += 1
    ax.set_yticks(range(0, len(labels), step), labels[::step])
    if len(axes) > 1:
        for row in range(group, len(labels), group):
            ax.axhline(row - 0.5, color="white", linewidth=1.5)


@name_wrong_arguments
def history(
    record: "History | Result",
    name: str = "best_fitness",
    *,
    label: str | None = None,
    quantiles: tuple[float, float] = (0.25, 0.75),
    ax: "Axes | None" = None,
) -> "Axes":
    """Draws a run against the evaluations of a seed.

    The line is the median over the run's seeds. The band reaches from one quantile to another. The
    best fitness is drawn from the step on at which each seed has an elite.

    Args:
      record: a `Result`, or its `History`, of one seed or of many.
      name: ``best_fitness`` or ``elite_count``.
      label: the label of the line in the legend.
      quantiles: the limits of the band, 0 to 1.
      ax: the Axes to draw on, by default those of a new figure; several runs on one Axes have
        different colours.

    Raises:
      InputError: for a result without history, another name, bad quantiles, or without matplotlib.
    """
    if name not in ("best_fitness", "elite_count"):
        raise InputError("name", "best_fitness or elite_count", repr(name))
    result: Untyped = record
    run: History | None = getattr(result, "history", result)
    if run is None or not hasattr(run, name):
        raise InputError("record", "a result with a history", quote(record))
    values = np.asarray(getattr(run, name), float)
    if name == "best_fitness":
        # A seed without an elite has the fitness of a vacant slot.
        values = np.where(_is_of_grid(values), values, np.nan)
    ax = seed_band(run.evaluations, values, label=label, quantiles=quantiles, ax=ax)
    ax.set(xlabel="evaluations a seed", ylabel=_in_words(name))
    ax.locator_params(axis="x", nbins=6)
    return ax


@name_wrong_arguments
def seed_band(
    x: ArrayOrRows,
    values: ArrayOrRows,
    *,
    label: str | None = None,
    quantiles: tuple[float, float] = (0.25, 0.75),
    ax: "Axes | None" = None,
    **line: Untyped,
) -> "Axes":
    """Draws the median over seeds as a line, and a band from one quantile to another.

    Args:
      x: numbers ``[X]``.
      values: numbers ``[X]``, or ``[S, X]`` of S seeds.
      label: the label of the line in the legend.
      quantiles: the limits of the band, 0 to 1.
      ax: the Axes to draw on; by default those of a new figure.
      line: further arguments of matplotlib's `plot` for the line.

    Raises:
      InputError: for values of another shape or masked ones, bad quantiles, or without matplotlib.
    """
    x_values = np.asarray(x)
    check_named("values", unmasked, values)
    # Values of one seed become a table with one row.
    samples = np.atleast_2d(np.asarray(values, float))
    is_table = samples.ndim == 2 and len(samples) > 0
    if x_values.ndim != 1 or not is_table or samples.shape[1] != x_values.size:
        raise InputError("values", f"[S, {x_values.size}] like x", f"shape {np.shape(values)}")
    limits = np.asarray(quantiles)
    is_pair = limits.shape == (2,) and limits.dtype.kind in "fiu"
    if not is_pair or not 0 <= limits[0] <= limits[1] <= 1:
        expected = "two from 0 to 1, the lower first"
        raise InputError("quantiles", expected, repr(quantiles))
    low, high = limits
    ax = _axes(ax)
    # Quantiles are over the seeds, for each evaluation alone.
    bottom, middle, top = np.quantile(samples, [low, 0.5, high], axis=0)
    (median_line,) = ax.plot(x_values, middle, label=label, **line)
    # The band has the colour that matplotlib has chosen for the line.
    colour = median_line.get_color()
    ax.fill_between(x_values, bottom, top, color=colour, alpha=0.2, linewidth=0)
    ax.grid(alpha=0.3)
    return ax


def _axes(ax: "Axes | None") -> "Axes":
    """Returns the Axes to draw on, checked; by default those of a new figure."""
    if ax is None:
        pyplot = import_optional("matplotlib.pyplot", "plots need matplotlib", "matplotlib")
        _, ax = pyplot.subplots(layout="constrained")
        return ax
    if not hasattr(ax, "plot"):
        raise InputError("ax", "axes of matplotlib", quote(ax))
    return ax


def _in_words(name: str) -> str:
    return name.replace("_", " ")


def _bin_name(axis: "Axis", index: int) -> str:
    """Returns the values in a bin, shares in per cent."""
    from elitelanes_jax.problem.features import SHARE_UNIT, feature_unit, is_share

    unit, is_per_cent = feature_unit(axis.metric), is_share(axis.metric)

    def show(value: int) -> str:
        if unit == 1:
            return f"{value}"
        return f"{100 * value / SHARE_UNIT:g}%" if is_per_cent else f"{value / SHARE_UNIT:g}"

    first = axis.start + index * axis.width
    last = first + axis.width - 1
    # The first bin has all smaller values, and the last one all larger ones. Counts such as that of
    # components start at 1, because every map has one.
    if index == 0 and axis.start > 1:
        return f"≤{show(last)}" if unit == 1 else f"<{show(last + 1)}"
    if index == axis.bins - 1 and not (is_per_cent and last >= SHARE_UNIT - 1):
        return f"{show(first)}+"
    return f"{first}–{last}" if unit == 1 and first != last else show(first)


# The positions of a tile's sides relative to its middle, x to the east and y to the south.
_TO_SIDE = {side.bit: (side.right / 2, side.down / 2) for side in SIDES}


def _links(codes: NDArray[np.int8]) -> tuple[list[_Line], list[_Line]]:
    """Returns the lines of links and unmatched connections; and the lines from the roads' ends."""
    height, width = codes.shape
    lines = []
    ends = []
    for row, column in np.ndindex(height, width):
        code = int(codes[row, column])
        for side in SIDES:
            if not code & side.bit:
                continue
            half_line = _half_line(code, side.bit, (row, column))
            neighbour = row + side.down, column + side.right
            is_inside = 0 <= neighbour[0] < height and 0 <= neighbour[1] < width
            neighbour_code = int(codes[neighbour]) if is_inside else 0
            if not neighbour_code & side.opposite:
                lines.append(half_line)
                ends.append(half_line[::-1])
            elif side.bit in (EAST, SOUTH):
                # The tile to the west or north draws the link of both, and their common point once.
                other_half = _half_line(neighbour_code, side.opposite, neighbour)
                lines.append(np.concatenate([half_line, other_half[-2::-1]]))
            # A tile with a single connection is a dead end, which has a bar at its junction.
            if CONNECTIONS[code] == 1:
                ends.append(half_line)
    return lines, ends


def _half_line(code: int, side: int, tile: tuple[int, int]) -> _Line:
    """Returns the line from the junction of a tile's roads to one side.

    In a turn, the line starts at the middle of the arc.
    """
    middle = np.array(tile[::-1]) + 0.5
    to_side = np.array(_TO_SIDE[side])
    if code not in KINDS["turn"]:
        return middle + np.array([[0.0], [0.5], [1.0]]) * to_side
    # A turn has two connections, so the rest of its code is the other side.
    to_other_side = np.array(_TO_SIDE[code & ~side])
    # An arc around the corner between the two sides, whose middles are half a tile from it.
    corner = middle + to_side + to_other_side
    # The line is half of the quarter circle: from the middle of the arc to this side. The other
    # half belongs to the other side.
    angles = np.linspace(np.pi / 4, np.pi / 2, 7)[:, None]
    return corner - np.cos(angles) * to_side - np.sin(angles) * to_other_side


def _directions(line: _Line) -> NDArray[np.float64]:
    """Returns unit vectors along a line at each of its points.

    They are exact at the ends of the line, so that ribbons meet.
    """
    step = np.gradient(line, axis=0, edge_order=2)
    return step / np.linalg.norm(step, axis=1, keepdims=True)


def _ribbon(line: _Line, width: float) -> NDArray[np.float64]:
    """Returns the outline of a ribbon around a line."""
    aside = _directions(line)[:, ::-1] * (-width / 2, width / 2)
    return np.concatenate([line + aside, (line - aside)[::-1]])


def _bar(line: _Line, width: float) -> NDArray[np.float64]:
    """Returns the outline of a bar across the start of a line."""
    bar_line = line[0] + np.array([[0.0], [0.05], [0.1]]) * _directions(line)[0]
    return _ribbon(bar_line, width)

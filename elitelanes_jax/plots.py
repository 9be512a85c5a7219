"""Plots: a map as lines, an archive as a heat map, runs over seeds.

Each draws on `ax`, by default on a new figure, and returns the Axes. All need matplotlib, the extra `plots`.
"""

from collections.abc import Sequence
from math import prod
from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax._util.packages import import_optional
from elitelanes_jax._util.types import AnyArray, Untyped, UserValue
from elitelanes_jax.network.checks import check_grid
from elitelanes_jax.network.codes import CONNECTIONS, EAST, KINDS, SIDES, SOUTH

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from elitelanes_jax.problem.descriptor import Axis
    from elitelanes_jax.search.result import History, Result

_GROUND, _KERB, _ROAD, _LANE, _END, _VACANT = "#eef0ea", "#b9bdb4", "#4a4f5a", "#f5c842", "#d7263d", "#e9e9e6"

_HARD_SPACE = "\N{NO-BREAK SPACE}"

# Widths as parts of the road's.
_KERB_WIDTH, _LANE_WIDTH = 1.2, 0.09


@name_wrong_arguments
def road_map(
    grid: ArrayLike, *, width: float = 0.5, lanes: bool = True, marked: UserValue = None, ax: "Axes | None" = None
) -> "Axes":
    """Draws a map in lines: roads as ribbons, turns round, north at the top, one unit per tile.

    Each link is one ribbon from the middle of a tile to the middle of the next; an unmatched connection reaches the
    tile's side. A red bar marks where a road ends: in a tile with a single connection, or at such a side.

    Args:
      grid: integer codes ``[H, W]``, repaired or not.
      width: of the roads, a part of a tile's side, over 0 and at most 0.8.
      lanes: whether to draw the line between the lanes. Small pictures are clearer without it.
      marked: bool ``[H, W]``, cells to colour, such as the dirty tiles of a move.
      ax: to draw on.

    Raises:
      InputError: for a bad grid, a width out of its range, a mask of another shape, or without
        matplotlib.
    """
    codes = np.asarray(check_grid(grid))
    if not 0 < width <= 0.8:
        raise InputError(f"width: expected a part of a tile's side, over 0 and at most 0.8, got {width!r}")
    shown = np.zeros(codes.shape, bool) if marked is None else np.asarray(marked, bool)
    if shown.shape != codes.shape:
        raise InputError(f"marked: expected a mask of the grid's shape {codes.shape}, got {shown.shape}")
    ax = _axes(ax)
    from matplotlib.collections import LineCollection, PolyCollection

    rows, columns = codes.shape
    ax.set_aspect("equal")
    ax.set(xlim=(0, columns), ylim=(rows, 0), xticks=[], yticks=[], facecolor=_GROUND)
    ax.spines[:].set_visible(False)
    cells = [[(x, y), (x + 1, y), (x + 1, y + 1), (x, y + 1)] for y, x in np.argwhere(shown)]
    ax.add_collection(PolyCollection(cells, facecolors="#ffdf9e", label="marked"))
    lines, ends = _links(codes)
    for name, share, colour in (("kerb", _KERB_WIDTH * width, _KERB), ("road", width, _ROAD)):
        # A hairline of the same colour closes the seams between smoothed edges.
        ribbons = [_ribbon(line, share) for line in lines]
        ax.add_collection(
            PolyCollection(ribbons, facecolors=colour, edgecolors=colour, linewidths=0.3, snap=False, label=name)
        )
    if lanes:
        box = ax.get_window_extent()
        points = _LANE_WIDTH * width * 72 / ax.figure.dpi * min(box.width / columns, box.height / rows)
        ax.add_collection(
            LineCollection(lines, colors=_LANE, linewidths=points, linestyles=(0, (2.2, 1.5)), label="lanes")
        )
    bars = [_bar(line, width + 0.2) for line in ends]
    ax.add_collection(PolyCollection(bars, facecolors=_END, label="ends"))
    return ax


@name_wrong_arguments
def archive_map(
    fitness: "AnyArray | Result",
    axes: "Sequence[Axis] | None" = None,
    *,
    across: str | None = None,
    down: Sequence[str] | str | None = None,
    label: str = "fitness",
    ax: "Axes | None" = None,
    **image: Untyped,
) -> "Axes":
    """Draws an archive as a heat map: one axis of the descriptor across, one or several others down.

    Each cell shows the lowest fitness over the axes that are not named, and over all seeds. A cell without filled
    niches is hatched.

    Args:
      fitness: a `Result` or its elites; or numbers ``[..., N]``, lower is better, in the order of `niche_index`: the
        fitness of a `Population`, or of a QDax repertoire with its sign changed and one axis. The largest int32 and
        numbers that are not finite mean vacant.
      axes: of the descriptor space; by default those of the result.
      across: the metric of an axis, by default the first of those with most bins.
      down: the metrics of one axis or of several, of which the last changes fastest from row to row; by default all
        others.
      label: of the colour bar.
      ax: to draw on.
      image: further arguments of matplotlib's `imshow`, such as ``vmax`` if a few bad niches hide the differences of
        others.

    Raises:
      InputError: for another number of niches, for a name that is not an axis' or occurs twice, or without matplotlib.
    """
    from elitelanes_jax.problem.descriptor import parse_axes

    source: UserValue = fitness
    if hasattr(source, "elites"):  # a result
        fitness = source.elites.fitness
        axes = source.search.axes if axes is None else axes
    elif hasattr(source, "fitness"):  # elites
        fitness = source.fitness
    if axes is None:
        raise InputError("axes: expected the axes of the niches, or a Result instead of its fitness, got none")
    axes = parse_axes(axes, features=None)
    if not all(axis.width for axis in axes):
        raise InputError("axes: expected ones with a width, such as result.search.axes, got one without")
    *down, across = _names_of(axes, across, down)
    by_name = {axis.metric: axis for axis in axes}
    rows, columns = [by_name[name] for name in down], by_name[across]
    table = _niche_table(np.asarray(fitness, float), axes, [*down, across])

    ax = _axes(ax)
    style: dict[str, Untyped] = {"cmap": "viridis_r", "aspect": "auto", "interpolation": "nearest"} | image
    cells = ax.imshow(np.ma.masked_invalid(table), **style)
    ax.patch.set(facecolor=_VACANT, hatch="////", edgecolor="#cfcfca", linewidth=0)
    ax.figure.colorbar(cells, ax=ax, label=label)
    _label_columns(ax, columns)
    _label_rows(ax, rows)
    return ax


def _names_of(axes: "Sequence[Axis]", across: str | None, down: Sequence[str] | str | None) -> list[str]:
    """Returns the names of the axes that are shown: those down, then the one across."""
    names = [axis.metric for axis in axes]
    if across is None:
        across = names[int(np.argmax([axis.bins for axis in axes]))]
    if down is None:
        down = [name for name in names if name != across]
    shown = [*([down] if isinstance(down, str) else down), across]
    for name in shown:
        if name not in names or shown.count(name) > 1:
            argument = "across" if name == across else "down"
            raise InputError(f"{argument}: expected each of {', '.join(names)} at most once, got {', '.join(shown)}")
    return shown


def _niche_table(fitness: NDArray[np.float64], axes: "Sequence[Axis]", shown: Sequence[str]) -> NDArray[np.float64]:
    """Returns the lowest fitness ``[rows, columns]`` over seeds and hidden axes; infinite where no niche is filled."""
    names = [axis.metric for axis in axes]
    bins = [axis.bins for axis in axes]
    if not fitness.size or fitness.shape[-1] != prod(bins):
        raise InputError(f"fitness: expected {prod(bins)} niches on the last axis, got shape {fitness.shape}")
    is_filled = np.isfinite(fitness) & (fitness < np.iinfo(np.int32).max)
    lowest = np.where(is_filled, fitness, np.inf).reshape(-1, *bins).min(axis=0)
    hidden = tuple(index for index, name in enumerate(names) if name not in shown)
    remaining = [name for name in names if name in shown]
    order = [remaining.index(name) for name in shown]
    return lowest.min(axis=hidden).transpose(order).reshape(-1, bins[names.index(shown[-1])])


def _label_columns(ax: "Axes", axis: "Axis") -> None:
    """Labels the bins of the axis across, ten at most."""
    every = -(-axis.bins // 9)
    places = range(0, axis.bins, every)
    ax.set_xticks(places, [_bin_name(axis, index) for index in places])
    ax.set_xlabel(_in_words(axis.metric))


def _label_rows(ax: "Axes", axes: "Sequence[Axis]") -> None:
    """Labels the rows by their bins on the axes down, and draws lines between the groups of the last one."""
    if not axes:  # the descriptor has one axis
        ax.set_yticks([])
        return
    names = [axis.metric.replace("_", _HARD_SPACE) for axis in axes]
    ax.set_ylabel(fill(f"{_HARD_SPACE}· ".join(names), 44))
    heads = []
    for indices in np.ndindex(*(axis.bins for axis in axes)):
        heads.append(" · ".join(_bin_name(axis, index) for axis, index in zip(axes, indices, strict=True)))
    # As many labels as are legible, the same ones in each group.
    group = axes[-1].bins
    every = -(-len(heads) // 32)
    while group % every and every % group:
        every += 1
    ax.set_yticks(range(0, len(heads), every), heads[::every])
    if len(axes) > 1:
        for row in range(group, len(heads), group):
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
    """Draws a run against the evaluations of a seed: the median over its seeds, and a band around it.

    Args:
      record: a `Result`, or its `History`, of one seed or of many.
      name: ``best_fitness`` or ``elite_count``.
      label: of the line in the legend.
      quantiles: the limits of the band, 0 to 1.
      ax: to draw on; several runs on one Axes have different colours.

    Raises:
      InputError: for a result without history, another name, bad quantiles, or without matplotlib.
    """
    if name not in ("best_fitness", "elite_count"):
        raise InputError(f"name: expected best_fitness or elite_count, got {name!r}")
    result: UserValue = record
    run: History | None = getattr(result, "history", result)
    if run is None or not hasattr(run, name):
        raise InputError(f"record: expected a result with a history, got {shorten(repr(record))}")
    ax = seed_band(run.evaluations, getattr(run, name), label=label, quantiles=quantiles, ax=ax)
    ax.set(xlabel="evaluations a seed", ylabel=_in_words(name))
    ax.locator_params(axis="x", nbins=6)
    return ax


@name_wrong_arguments
def seed_band(
    x: AnyArray,
    values: AnyArray,
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
      label: of the line in the legend.
      quantiles: the limits of the band, 0 to 1.
      ax: to draw on.
      line: further arguments of matplotlib's `plot` for the line.

    Raises:
      InputError: for values of another shape, bad quantiles, or without matplotlib.
    """
    steps, samples = np.asarray(x), np.atleast_2d(np.asarray(values, float))
    if steps.ndim != 1 or samples.ndim != 2 or samples.shape[1] != steps.size or not len(samples):
        raise InputError(f"values: expected [S, {steps.size}] like x, got shape {np.shape(values)}")
    shares = np.asarray(quantiles)
    if shares.shape != (2,) or shares.dtype.kind not in "fiu" or not 0 <= shares[0] <= shares[1] <= 1:
        raise InputError(f"quantiles: expected two from 0 to 1, the lower first, got {quantiles!r}")
    low, high = shares
    ax = _axes(ax)
    bottom, middle, top = np.quantile(samples, [low, 0.5, high], axis=0)
    (drawn,) = ax.plot(steps, middle, label=label, **line)
    ax.fill_between(steps, bottom, top, color=drawn.get_color(), alpha=0.2, linewidth=0)
    ax.grid(alpha=0.3)
    return ax


def _axes(ax: "Axes | None") -> "Axes":
    if ax is not None:
        if not hasattr(ax, "plot"):
            raise InputError(f"ax: expected axes of matplotlib, got {shorten(repr(ax))}")
        return ax
    _, ax = import_optional("matplotlib.pyplot", "plots need matplotlib", "matplotlib").subplots(layout="constrained")
    return ax


def _in_words(name: str) -> str:
    return name.replace("_", " ")


def _bin_name(axis: "Axis", index: int) -> str:
    """Returns the values in a bin, shares in per cent."""
    from elitelanes_jax.problem.features import SHARE_UNIT, feature_unit, is_share

    first, last = axis.start + index * axis.width, axis.start + (index + 1) * axis.width - 1
    is_open = index == axis.bins - 1  # the last bin has all larger values
    if is_share(axis.metric):
        text = f"{100 * first / SHARE_UNIT:g}%"
        is_open &= last < SHARE_UNIT - 1
    elif feature_unit(axis.metric) != 1:
        text = f"{first / SHARE_UNIT:g}"
    elif is_open or first == last:
        text = f"{first}"
    else:
        text = f"{first}–{last}"
    return text + "+" if is_open else text


# The positions of a tile's sides relative to its middle, x to the east and y to the south.
_TO_SIDE = {side.bit: (side.right / 2, side.down / 2) for side in SIDES}


def _links(codes: NDArray[np.int8]) -> tuple[list[NDArray[np.float64]], list[NDArray[np.float64]]]:
    """Returns the lines ``[P, 2]``, x and y, of links and unmatched connections; and the lines from roads' ends."""
    height, width = codes.shape
    lines, ends = [], []
    for row, column in np.ndindex(height, width):
        code = int(codes[row, column])
        for side in SIDES:
            if not code & side.bit:
                continue
            here = _half(code, side.bit, (row, column))
            beyond = row + side.down, column + side.right
            inside = 0 <= beyond[0] < height and 0 <= beyond[1] < width
            other = int(codes[beyond]) if inside else 0
            if not other & side.opposite:
                lines.append(here)
                ends.append(here[::-1])
            elif side.bit in (EAST, SOUTH):
                there = _half(other, side.opposite, beyond)
                lines.append(np.concatenate([here, there[-2::-1]]))
            if CONNECTIONS[code] == 1:
                ends.append(here)
    return lines, ends


def _half(code: int, side: int, tile: tuple[int, int]) -> NDArray[np.float64]:
    """Returns the line from the junction of a tile's roads to one side; in a turn from the middle of its arc."""
    middle, to = np.array(tile[::-1]) + 0.5, np.array(_TO_SIDE[side])
    if code not in KINDS["turn"]:
        return middle + np.array([[0.0], [0.5], [1.0]]) * to
    other = np.array(_TO_SIDE[code & ~side])
    angles = np.linspace(np.pi / 4, np.pi / 2, 7)[:, None]
    # An arc around the corner between the two sides, whose middles are half a tile from it.
    return middle + to + other - np.cos(angles) * to - np.sin(angles) * other


def _directions(line: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns unit vectors along a line at each of its points, exact at its ends, so that ribbons meet."""
    step = np.gradient(line, axis=0, edge_order=2)
    return step / np.linalg.norm(step, axis=1, keepdims=True)


def _ribbon(line: NDArray[np.float64], width: float) -> NDArray[np.float64]:
    aside = _directions(line)[:, ::-1] * (-width / 2, width / 2)
    return np.concatenate([line + aside, (line - aside)[::-1]])


def _bar(line: NDArray[np.float64], width: float) -> NDArray[np.float64]:
    return _ribbon(line[0] + np.array([[0.0], [0.05], [0.1]]) * _directions(line)[0], width)

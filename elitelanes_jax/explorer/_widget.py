"""The explorer in a notebook: Jupyter, marimo, VS Code. It needs anywidget, the extra `widget`."""

from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Int8

from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.packages import import_optional
from elitelanes_jax._util.types import Untyped, UserValue
from elitelanes_jax.explorer._collect import collect
from elitelanes_jax.explorer._finds import has_usual_fitness
from elitelanes_jax.explorer._payload import Payload
from elitelanes_jax.explorer.page import static_text
from elitelanes_jax.formats.objects import MapObject, object_values

if TYPE_CHECKING:
    from elitelanes_jax.search.result import Result

_Grid = Int8[np.ndarray, "H W"]
_Continue = Callable[[_Grid, "Result"], "Result"]


def show(what: UserValue, *, tile_px: int = 64, on_continue: _Continue | None = None) -> Untyped:
    """Shows a result, maps, or folders of runs in a notebook.

    The widget has the page's views. Its ``grid`` is the drawn map, int8 ``[H, W]``, or None before a map is drawn; its
    ``objects`` is a tuple of that map's `MapObject`. ``observe`` reports changes of both. Its ``result`` is the shown
    result, None for anything else. For a result, a button of the editor continues the search from the drawn map; the
    widget then shows the new result.

    Args:
      what: a `Result`, a map or several, or a path or several, as `collect` takes them.
      tile_px: side of a tile's picture in pixels, 16 to 512.
      on_continue: takes the drawn grid and the shown result, and returns the next result; by default `continue_search`.

    Returns:
      The widget.

    Raises:
      InputError: for anything else, and as `collect`.
      MissingPackageError: without anywidget.
    """
    result = what if hasattr(what, "elites") and hasattr(what, "axes") else None
    return _widget_class()(collect(what, tile_px=tile_px), result, tile_px, on_continue or continue_search)


def continue_search(grid: _Grid, result: "Result") -> "Result":
    """Repeats the search of a result with seed 0, and with a drawn map among the initial maps.

    Args:
      grid: int8 ``[H, W]``.
      result: of the search to repeat.

    Raises:
      InputError: for a map of another size, or a result of a user's fitness, which results do not store.
    """
    from elitelanes_jax.search.evolution import evolve

    height, width = result.elites.grids.shape[-2:]
    if grid.shape != (height, width):
        raise InputError(f"grid: expected {height} x {width}, as the search's, got {grid.shape[0]} x {grid.shape[1]}")
    if not has_usual_fitness(result):
        raise InputError("fitness: expected the usual one, got a user's, which results do not store; pass on_continue")
    seeds = 1 if result.elites.valid.ndim == 1 else len(result.elites.valid)
    return evolve(0, (height, width), seeds=seeds, spec=result.spec, initial=[grid])


@cache
def _widget_class() -> Untyped:
    """Makes the widget's class, whose base needs anywidget."""
    anywidget = import_optional("anywidget", "the explorer in a notebook needs anywidget")
    traitlets = import_optional("traitlets", "the explorer in a notebook needs traitlets")

    class Explorer(anywidget.AnyWidget):  # type: ignore[name-defined]
        """The explorer of `show`."""

        _esm = static_text("explorer.js")
        _css = static_text("explorer.css")
        values = traitlets.Dict().tag(sync=True)
        blob = traitlets.Bytes().tag(sync=True)
        continues = traitlets.Bool(False).tag(sync=True)
        selected = traitlets.List(allow_none=True, default_value=None).tag(sync=True)
        grid = traitlets.Any(default_value=None, allow_none=True).tag(
            sync=True,
            to_json=lambda grid, _: None if grid is None else np.asarray(grid).tolist(),
            from_json=lambda rows, _: None if rows is None else np.array(rows, np.int8),
        )
        objects = traitlets.Any(default_value=()).tag(
            sync=True,
            to_json=lambda things, _: [object_values(thing) for thing in things],
            from_json=lambda values, _: tuple(MapObject(**value) for value in values),
        )

        def __init__(self, payload: Payload, result: Untyped, tile_px: int, on_continue: _Continue) -> None:
            super().__init__(values=payload.values, blob=payload.blob, continues=result is not None)
            self.result = result
            self._tile_px, self._continue = tile_px, on_continue
            self.on_msg(self._hear)

        def _hear(self, _: Untyped, content: Untyped, __: Untyped) -> None:
            if not (isinstance(content, dict) and "continue" in content and self.result is not None):
                return
            try:
                self.result = self._continue(np.array(content["continue"], np.int8), self.result)
                payload = collect(self.result, tile_px=self._tile_px)
            except Exception as error:  # otherwise only the notebook's log would show it
                self.send({"message": str(error)})
                raise
            with self.hold_sync():
                self.values, self.blob = payload.values, payload.blob

    return Explorer

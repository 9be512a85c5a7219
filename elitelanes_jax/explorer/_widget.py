"""The explorer in a notebook: Jupyter, marimo, VS Code. It needs anywidget, the extra `widget`."""

from functools import cache

import numpy as np

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.packages import import_optional
from elitelanes_jax._util.types import Untyped, UserValue
from elitelanes_jax.explorer._collect import collect
from elitelanes_jax.explorer.page import static_text
from elitelanes_jax.formats.objects import MapObject, object_values


@name_wrong_arguments
def show(what: UserValue, *, tile_px: int = 64) -> Untyped:
    """Shows a result, maps, or folders of runs in a notebook.

    The widget has the page's views. Its ``grid`` is the drawn map, int8 ``[H, W]``, or None before
    a map is drawn; its ``objects`` is a tuple of that map's `MapObject`. ``observe`` reports
    changes of both.

    Args:
      what: what to show, see `explore`.
      tile_px: side of a tile's picture in pixels, 16 to 512.

    Returns:
      The widget.

    Raises:
      InputError: as `explore`, or without anywidget.
    """
    # The widget receives what the page has in itself.
    payload = collect(what, tile_px=tile_px)
    return _widget_class()(values=payload.values, blob=payload.blob)


@cache
def _widget_class() -> Untyped:
    """Makes the widget's class, whose base needs anywidget."""
    anywidget = import_optional("anywidget", "the explorer in a notebook needs anywidget")
    traitlets = import_optional("traitlets", "the explorer in a notebook needs traitlets")

    class Explorer(anywidget.AnyWidget):  # type: ignore[name-defined]
        """The explorer of `show`."""

        # The widget runs the script of the page, so that both show the same.
        _esm = static_text("explorer.js")
        _css = static_text("explorer.css")
        # Python sends these two, and the browser only reads them.
        values = traitlets.Dict().tag(sync=True)
        blob = traitlets.Bytes().tag(sync=True)
        # The browser sends these two back. Arrays and records travel as lists and tables.
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

    return Explorer

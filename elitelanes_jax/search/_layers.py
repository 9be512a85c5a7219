"""Merges the layers of a search's options.

The layers are the options of the style, those that follow from example maps, and the user's.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import NamedTuple

from elitelanes_jax._util.checks import check_named
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.search.like import settings_like
from elitelanes_jax.search.settings import Settings
from elitelanes_jax.search.spec import NOT_OF_STYLES, SearchSpec, check_options

# Each of these options discards another option of the layers before it, which depends on it or
# would override it.
_DISCARDS = {"method": "preset", "axes": "targets"}

# Options with one value for each feature. They are merged feature by feature.
_BY_FEATURE = ("where", "weights")


class Merged(NamedTuple):
    """The merged options of a search.

    Attributes:
      small: the options for maps whose shorter side is under 12.
      large: the options for larger maps, or None if they are the same.
      origins: the origin of each option that the user did not give, such as "style 'town'", by the
        option's name. A range has an entry of its own, "where NAME".
    """

    small: Settings
    large: Settings | None
    origins: dict[str, str]


@contextmanager
def naming_origins(origins: Mapping[str, str]) -> Iterator[None]:
    """Puts the origin in front of an error about an option that the user did not give.

    The error is raised in the block of this context.
    """
    try:
        yield
    except InputError as error:
        origin = origins.get(error.subject or "")
        if origin is None:
            raise
        raise InputError(f"{origin}: {error}") from None


def merge_layers(spec: SearchSpec) -> Merged:
    """Merges the options of a specification, of its example maps and of its style.

    Options of the specification override those of the example maps, which override those of the
    style.

    Raises:
      InputError: for a wrong option of the style, or example maps without roads.
    """
    user_features = spec.options.get("features", ())
    # The user's layer is last, because later layers override earlier ones.
    layers: list[Mapping[str, UserValue]] = [spec.options]
    origins: dict[str, str] = {}
    if spec.options.get("like"):
        like = check_options(settings_like(spec.options["like"]), user_features)
        layers.insert(0, like)
        origins = dict.fromkeys(_names_in(like), "like")
    style = spec.options.get("style")
    if style is not None:
        origin = f"style {style.name!r}"
        options = check_named(origin, check_options, style.options, user_features, NOT_OF_STYLES)
        layers.insert(0, options)
        origins = dict.fromkeys(_names_in(options), origin) | origins
    # What the user gave as well is the user's.
    for name in _names_in(spec.options):
        origins.pop(name, None)

    named = {"style": None if style is None else style.name}
    small = [_without_large(layer) for layer in layers]
    large = None
    # Options for large maps override those of their own layer; later layers override them.
    last = max((index for index, layer in enumerate(layers) if "large" in layer), default=None)
    if last is not None and layers[last]["large"] is not None:
        order = [*small[: last + 1], layers[last]["large"], *small[last + 1 :]]
        large = Settings(**merge_options(order) | named)
    return Merged(Settings(**merge_options(small) | named), large, origins)


def merge_options(layers: Sequence[Mapping[str, UserValue]]) -> dict[str, UserValue]:
    """Merges layers of checked options; each layer overrides the layers before it.

    Ranges and weights are merged feature by feature. A method discards the preset of the layers
    before, and axes discard the targets.
    """
    merged: dict[str, UserValue] = {}
    for layer in layers:
        # This comes first, so that a layer with both options keeps its own.
        for name, other in _DISCARDS.items():
            if layer.get(name) is not None:
                merged.pop(other, None)
        for name, value in layer.items():
            merged[name] = (
                _merge_by_feature(merged.get(name, ()), value) if name in _BY_FEATURE else value
            )
    return merged


def _merge_by_feature(
    earlier: tuple[UserValue, ...], later: tuple[UserValue, ...]
) -> tuple[UserValue, ...]:
    """Merges items that start with a feature's name.

    Later items override earlier ones in their place.
    """
    names = {item[0] for item in later}
    if all(item[0] in names for item in earlier):
        # So a record that was saved and read again keeps its order.
        return later
    by_feature = {item[0]: item for item in (*earlier, *later)}
    return tuple(by_feature.values())


def _without_large(layer: Mapping[str, UserValue]) -> dict[str, UserValue]:
    return {name: value for name, value in layer.items() if name != "large"}


def _names_in(layer: Mapping[str, UserValue]) -> set[str]:
    """Returns the names of the options in a layer.

    Options for large maps are included, and "where NAME" for each range.
    """
    large = layer.get("large") or {}
    names = {*layer, *large}
    for options in (layer, large):
        names.update(f"where {item.name}" for item in options.get("where", ()))
    return names

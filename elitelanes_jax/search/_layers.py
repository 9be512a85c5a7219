"""Checks and merges the layers of a search's options.

The layers are the options of the style, those that follow from example maps, and the user's.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import NamedTuple, TypeVar

from elitelanes_jax._util.checks import check_named, none_or
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.records import check_names
from elitelanes_jax._util.types import OptionValue, UserValue
from elitelanes_jax.problem.ranges import Range
from elitelanes_jax.search.like import settings_like
from elitelanes_jax.search.settings import OPTIONS, Settings, check_option

BUDGET = ("generations", "evaluations")
"""The options that give a budget. A search has one of them."""

NOT_OF_STYLES = ("style", "like", "features", *BUDGET)
"""The options that a style cannot have."""

NOT_OF_LARGE = (*NOT_OF_STYLES, "large")
"""The options that cannot differ for large maps."""

# Each of these options discards another option of the layers before it, which depends on it or
# would override it.
_DISCARDS = {"method": "preset", "axes": "targets"}

# Options with one value for each feature. They are merged feature by feature.
_BY_FEATURE = ("where", "weights")

# A range, or the name of a feature and its weight.
_Item = TypeVar("_Item", bound=Range | tuple[str, int])


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
        # An option for large maps has the name "large" before it.
        origin = origins.get(error.subject.rpartition(": ")[2])
        if origin is None:
            raise
        raise error.within(origin) from None


def check_options(
    options: Mapping[str, UserValue], user_features: Collection[str], without: Collection[str] = ()
) -> dict[str, OptionValue]:
    """Checks options, each alone; returns the checked values by name.

    Args:
      options: values by name.
      user_features: the names of the user's features.
      without: the names that are not allowed here.

    Raises:
      InputError: for an unknown name or a wrong value; its subject starts with the name.
    """
    known = [name for name in (*OPTIONS, "large") if name not in without]
    check_names(options, known)
    checked = {}
    for name, value in options.items():
        if name == "large":
            checked[name] = check_named("large", none_or(_check_large), value, user_features)
        else:
            checked[name] = check_option(name, value, user_features)
    return checked


def _check_large(large: UserValue, user_features: Collection[str]) -> dict[str, OptionValue]:
    """Checks the options for large maps."""
    if not isinstance(large, Mapping):
        raise InputError("", "options by their names", quote(large))
    return check_options(large, user_features, without=NOT_OF_LARGE)


def merge_layers(user_options: Mapping[str, OptionValue]) -> Merged:
    """Merges a user's checked options with those of the example maps and of the style.

    The user's options override those of the example maps, which override those of the style.

    Raises:
      InputError: for a wrong option of the style, or example maps without roads.
    """
    user_features = user_options.get("features", ())
    # The user's layer is last, because later layers override earlier ones.
    layers: list[Mapping[str, OptionValue]] = [user_options]
    origins: dict[str, str] = {}
    if user_options.get("like"):
        like = check_options(settings_like(user_options["like"]), user_features)
        layers.insert(0, like)
        origins = dict.fromkeys(_names_in(like), "like")
    style = user_options.get("style")
    if style is not None:
        origin = f"style {style.name!r}"
        options = check_named(origin, check_options, style.options, user_features, NOT_OF_STYLES)
        layers.insert(0, options)
        origins = dict.fromkeys(_names_in(options), origin) | origins
    # What the user gave as well is the user's.
    for name in _names_in(user_options):
        origins.pop(name, None)

    named = {"style": None if style is None else style.name}
    small = [_without_large(layer) for layer in layers]
    large: list[Mapping[str, OptionValue]] = []
    # Options for large maps override those of their own layer; later layers override them.
    has_large = False
    for layer, plain in zip(layers, small, strict=True):
        large.append(plain)
        if "large" in layer:
            has_large = layer["large"] is not None
            large += [layer["large"]] if has_large else []
    return Merged(
        Settings(**merge_options(small) | named),
        Settings(**merge_options(large) | named) if has_large else None,
        origins,
    )


def merge_options(layers: Sequence[Mapping[str, OptionValue]]) -> dict[str, OptionValue]:
    """Merges layers of checked options; each layer overrides the layers before it.

    Ranges and weights are merged feature by feature. A method discards the preset of the layers
    before, and axes discard the targets.
    """
    merged: dict[str, OptionValue] = {}
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


def _merge_by_feature(earlier: tuple[_Item, ...], later: tuple[_Item, ...]) -> tuple[_Item, ...]:
    """Merges items that start with a feature's name.

    Later items override earlier ones in their place.
    """
    names = {item[0] for item in later}
    if all(item[0] in names for item in earlier):
        # So a record that was saved and read again keeps its order.
        return later
    by_feature = {item[0]: item for item in (*earlier, *later)}
    return tuple(by_feature.values())


def _without_large(layer: Mapping[str, OptionValue]) -> dict[str, OptionValue]:
    return {name: value for name, value in layer.items() if name != "large"}


def _names_in(layer: Mapping[str, OptionValue]) -> set[str]:
    """Returns the names of the options in a layer.

    Options for large maps are included, and "where NAME" for each range.
    """
    large = layer.get("large") or {}
    names = {*layer, *large}
    for options in (layer, large):
        names.update(f"where {item.name}" for item in options.get("where", ()))
    return names

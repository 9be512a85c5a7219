"""The meaning and the range of each metric, share and town feature, in words."""

from elitelanes_jax._util.records import descriptions
from elitelanes_jax.network.metric_names import Metrics
from elitelanes_jax.network.town_features import TownFeatures
from elitelanes_jax.problem.extremes import feature_bounds, feature_range
from elitelanes_jax.problem.features import FEATURES, SHARES, TOWN_FEATURES, feature_unit, is_share


def describe_features() -> dict[str, tuple[str, str]]:
    """Returns the meaning and the range of each metric, share and town feature, by name.

    The range is that of `feature_range`, followed by a proven bound in parentheses if it differs. For a town feature,
    the text is the kind of its values instead, and "filled" with its value if all maps without empty cells have the
    same.
    """
    shares = {share: f"{part} / {' + '.join(whole)}" for share, (part, whole) in SHARES.items()}
    meanings = shares | descriptions(Metrics) | descriptions(TownFeatures)
    return {name: (meanings[name], _range_text(name)) for name in (*FEATURES, *TOWN_FEATURES)}


def _range_text(name: str) -> str:
    if name in TOWN_FEATURES:
        kind = "0..1" if is_share(name) else "a ratio" if feature_unit(name) > 1 else "a number"
        smallest, largest = feature_bounds(name)
        return f"{kind}; filled {value_text(float(smallest))}" if smallest == largest else kind
    low, high = feature_range(name)
    if low == high:
        return value_text(low)
    least, most = (value_text(type(low)(bound)) for bound in feature_bounds(name))
    below = f"({least}) " if least != value_text(low) else ""
    above = f" ({most})" if most != value_text(high) else ""
    return f"{below}{value_text(low)}..{value_text(high)}{above}"


def value_text(value: float) -> str:
    """Returns the text of a metric's or share's value: whole numbers in full, others with three digits."""
    return f"{value:.3g}" if isinstance(value, float) else str(value)

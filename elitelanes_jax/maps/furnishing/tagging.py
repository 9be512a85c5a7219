"""The tag numbers of the signs of a map."""

from collections import defaultdict
from collections.abc import Sequence
from math import dist, inf

from elitelanes_jax._util.errors import InputError
from elitelanes_jax.formats.objects import MapObject
from elitelanes_jax.formats.tags import SIGN_TAGS, STREET_NAMES

Point = tuple[float, float]


class Tags:
    """The tag numbers that are used on a map, and where."""

    def __init__(self, *, unique: bool) -> None:
        """Starts without tags; `unique` refuses to use a number twice."""
        self._unique = unique
        self._used: dict[tuple[str, int], list[Point]] = defaultdict(list)

    def give(self, sign: MapObject, numbers: Sequence[int] | None = None) -> MapObject:
        """Returns a sign with the first tag number that is not in use, of `numbers` or of all of its kind.

        If all are in use, it gets the number whose nearest use is farthest away; of several, the first one. Raises
        `InputError` if a number must not be used twice.
        """
        numbers = numbers or SIGN_TAGS[sign.kind]
        tag = max(numbers, key=lambda number: self._distance(sign, [number]))
        if self._unique and self._used[sign.kind, tag]:
            what = STREET_NAMES.get(tag, sign.kind)
            raise InputError(f"unique_tags: expected at most {len(numbers)} of {what}, got more")
        self._used[sign.kind, tag].append((sign.x, sign.y))
        return sign._replace(tag=tag)

    def name_street(self, signs: Sequence[MapObject]) -> list[MapObject]:
        """Returns the signs of a road with tags of one street name; raises `InputError` as `give` does.

        The name is one whose nearest use is farthest away, and among unused names the one with the fewest tags that
        are enough.
        """

        def preference(numbers: Sequence[int]) -> tuple[float, int]:
            enough = len(numbers) >= len(signs)
            return self._distance(signs[0], numbers), (-len(numbers) if enough else len(numbers) - 1000)

        numbers = max(_STREETS, key=preference)
        return [self.give(sign, numbers) for sign in signs]

    def _distance(self, sign: MapObject, numbers: Sequence[int]) -> float:
        """Returns how far from a sign numbers of its kind are in use; infinity if none is."""
        uses = (place for number in numbers for place in self._used[sign.kind, number])
        return min((dist((sign.x, sign.y), place) for place in uses), default=inf)


_STREETS = [
    tuple(tag for tag, other in STREET_NAMES.items() if other == name) for name in dict.fromkeys(STREET_NAMES.values())
]

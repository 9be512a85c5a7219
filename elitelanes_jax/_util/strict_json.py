"""JSON as it is meant: what many parsers let pass is refused."""

import json
from collections.abc import Sequence
from typing import NoReturn

from elitelanes_jax._util.checks import check_unique
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.types import Plain


def parse_json(text: str) -> Plain:
    """Parses JSON.

    Raises:
      InputError: for a key that an object has twice, or a number that JSON has not: NaN and infinities.
      ValueError: for a text that is no JSON.
      RecursionError: for one that is nested too deeply.
    """
    return json.loads(text, object_pairs_hook=_object, parse_constant=_refuse)


def _object(pairs: Sequence[tuple[str, Plain]]) -> dict[str, Plain]:
    check_unique("JSON", "key", [key for key, _ in pairs])
    return dict(pairs)


def _refuse(number: str) -> NoReturn:
    raise InputError(f"JSON: expected numbers, got {number}")

"""Names in XML."""

import re

from elitelanes_jax._util.checks import name
from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax._util.types import UserValue


def xml_name(value: UserValue) -> str:
    """Checks for a text that is not blank, of characters that XML 1.0 allows (section 2.2)."""
    if re.search(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]", name(value)):
        raise InputError(f"expected a name without control characters, as in XML, got {shorten(repr(value))}")
    return str(value)

"""Errors as data: a test asks an error for its subject and for what came. Only the cases hold the words of messages."""

import re
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from elitelanes_jax import InputError


def is_text(pattern: object, text: str) -> bool:
    parts = map(re.escape, str(pattern).split("..."))
    return re.fullmatch(".*".join(parts), text, re.DOTALL) is not None


@contextmanager
def refused(
    subject: object, got: object = None, expected: str = "", hint: str = ""
) -> Iterator[pytest.ExceptionInfo[InputError]]:
    """Asserts that the block raises an `InputError` with this subject, and yields what `pytest.raises` yields.

    Args:
      subject: the whole subject. In `subject` and `got`, `...` means any text: for paths, and for long values.
      got: the whole of what came, or None if the test does not ask for it.
      expected: words of what was expected. Give them if the subject has several checks that refuse the same value.
      hint: words of the hint.
    """
    __tracebackhide__ = True
    with pytest.raises(InputError) as caught:
        yield caught
    error = caught.value
    for name, asked, agrees in (
        ("subject", subject, is_text(subject, error.subject)),
        ("got", got, got is None or is_text(got, error.got)),
        ("expected", expected, expected in error.expected),
        ("hint", hint, hint in error.hint),
    ):
        assert agrees, f"{name}: the test asks for {str(asked)!r}, the error has {getattr(error, name)!r}: {error}"

"""Tests that the helper of tests about wrong arguments fails when the error is another one."""

import pytest
from refusals import refused

from elitelanes_jax import InputError

ERROR = InputError("/tmp/map.yaml: tiles", "rows of one length", "rows of several", "is it grid?")


def test_the_parts_of_an_error_are_found():
    with refused("...map.yaml: tiles", "rows of...", expected="one length", hint="grid") as caught:
        raise ERROR
    assert caught.value is ERROR


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"subject": "tiles"}, "subject: the test asks for 'tiles', the error has '/tmp/map.yaml: tiles'"),
        ({"got": "several"}, "got: the test asks for 'several', the error has 'rows of several'"),
        ({"got": ""}, "got: the test asks for '', the error has 'rows of several'"),
        ({"expected": "columns"}, "expected: the test asks for 'columns', the error has 'rows of one length'"),
        ({"hint": "size"}, "hint: the test asks for 'size', the error has 'is it grid?'"),
    ],
)
def test_another_error_fails_and_both_are_shown(asked, words):
    with pytest.raises(AssertionError) as failure, refused(**{"subject": "...tiles", **asked}):
        raise ERROR
    assert str(failure.value).startswith(words)


@pytest.mark.parametrize("block", [lambda: None, lambda: int("x")], ids=["no error", "a plain ValueError"])
def test_no_error_and_a_plain_error_of_values_fail(block):
    with pytest.raises((pytest.fail.Exception, ValueError)) as failure, refused("..."):
        block()
    assert not isinstance(failure.value, InputError)

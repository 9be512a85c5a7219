"""The explorer's cases of signs are those that Python places."""

from sign_cases import CASES, sign_cases


def test_the_cases_are_fresh():
    assert CASES.read_text(encoding="utf-8") == sign_cases(), "run: python tests/sign_cases.py"

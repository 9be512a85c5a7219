"""Python reads the files of the table that the explorer reads, as the table says."""

from reading_cases import CASES, reading_cases


def test_the_cases_are_fresh():
    """Each case is read or refused as its entry in reading_cases.py says; otherwise `reading_cases` raises."""
    assert CASES.read_text(encoding="utf-8") == reading_cases(), "run: python tests/formats/reading_cases.py"

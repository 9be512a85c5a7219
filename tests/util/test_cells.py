"""The names of cells."""

from itertools import product
from string import ascii_uppercase

from elitelanes_jax._util.cells import cell_name, describe_cell


def test_columns_count_as_in_a_spreadsheet():
    # All words of one letter, then of two, then of three, each in the order of the alphabet.
    words = ["".join(word) for length in (1, 2, 3) for word in product(ascii_uppercase, repeat=length)]
    assert [cell_name(0, column) for column in range(2000)] == [f"{word}1" for word in words[:2000]]


def test_a_message_has_the_name_and_the_index():
    assert describe_cell(1, 2) == "C2 ([1, 2])"

"""Lines with checksums: a damaged line is left out, and no other line."""

import numpy as np

from elitelanes_jax._util.sums import read_sealed_lines, sealed_line

CONTENTS = [b"", b"a", b"tab\tand more", bytes(range(11, 256)), b"{}" * 500]


def test_whole_lines_are_read():
    text = b"".join(map(sealed_line, CONTENTS))
    assert list(read_sealed_lines(text)) == CONTENTS
    assert list(read_sealed_lines(b"")) == []


def test_damaged_lines_are_left_out():
    """Every cut, every zeroed stretch and every changed byte loses the lines that it touches."""
    lines = [*map(sealed_line, CONTENTS)]
    text, ends = b"".join(lines), np.cumsum([*map(len, lines)])
    for place in range(len(text)):
        assert list(read_sealed_lines(text[:place])) == CONTENTS[: np.searchsorted(ends, place, "right")]
        line = int(np.searchsorted(ends, place, "right"))
        # Without its line break, a line is joined to the next one.
        touched = {line, line + 1} if place == ends[line] - 1 else {line}
        damaged = text[:place] + bytes([text[place] ^ 1]) + text[place + 1 :]
        read = list(read_sealed_lines(damaged))
        assert read == [content for index, content in enumerate(CONTENTS) if index not in touched]

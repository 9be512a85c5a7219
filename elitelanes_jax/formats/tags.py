"""The AprilTags of signs.

These are the numbers of each kind of sign in Duckietown's database ``apriltagsDB.yaml``. All tags
are of the family 36h11. The database has several numbers for some street names.
"""

TAG_FAMILY = "36h11"
"""The family of all tags."""

TAG_SIZE = 0.065
"""The side of a tag's black square in metres."""

LARGEST_TAG = 586
"""The largest number of the family 36h11."""


def _read_numbers(text: str) -> tuple[int, ...]:
    """Reads numbers and ranges with both ends, such as ``1 20-38``."""
    numbers: list[int] = []
    for part in text.split():
        first, _, last = part.partition("-")
        numbers += range(int(first), int(last or first) + 1)
    return tuple(numbers)


SIGN_TAGS: dict[str, tuple[int, ...]] = {
    "sign_stop": _read_numbers("1 20-38 162-196"),
    "sign_4_way_intersect": _read_numbers("8 13-19 44-56 197-199 231-234 262-264"),
    "sign_right_T_intersect": _read_numbers("9 57-60 132-141 235 238 241 244 260 261"),
    "sign_left_T_intersect": _read_numbers("10 61-64 152-161 237 240 242 245 248 249"),
    "sign_T_intersect": _read_numbers("11 65-68 142-151 236 239 243 246 247"),
    "sign_t_light_ahead": _read_numbers("74-94 200-229"),
    "sign_street_name": _read_numbers("440-551"),
}
"""The tag numbers of each kind of sign."""

# The street name of each tag from 440 on, in the order of the tags. The number before a name says
# how many tags in a row have it.
_STREETS = """
2 HERR AVE, 2 DUBOWSKY ST, 2 ASADA AVE, 3 WILLIAMS ST, 3 ROY AVE, 3 HOSOI AVE, 3 CHEN AVE,
3 PERAIRE ST, 3 KAELBLING ST, 3 IAGNEMMA ST, 3 BREAZEAL ST, 3 TEDRAKE ST, 3 FRAZZOLI ST,
5 KARAMAN ST, 5 RUS AVE, 7 LEONARD ST, 7 HOW AVE, 1 FRAZZOLI ST, 1 TEDRAKE ST, 1 ASADA AVE,
1 BREAZEAL ST, 1 DUBOWSKY ST, 1 HERR AVE, 1 HOBURG ST, 1 HOGAN AVE, 1 IAGNEMMA ST, 1 KAELBLING ST,
1 LOZANO ST, 1 KIM AVE, 1 REIF AVE, 1 WALTZ AVE, 1 PERAIRE ST, 1 CHANDRA ST, 1 KASAN ST,
1 MICALI ST, 1 CHEN AVE, 1 HOSOI AVE, 1 RUS AVE, 1 HOW AVE, 1 ROY AVE, 1 SHAH AVE, 1 WILLIAMS ST,
1 LEONARD ST, 1 BROOKS ST, 1 KARAMAN ST, 1 MILFORD ST., 1 TIDOR ST., 1 BARFOOT ST., 1 DUDEK ST.,
1 FORBES AVE., 1 PINEAU AVE., 1 KELLY ST., 1 URTASUN RD., 1 FIDLER ST., 1 WASLANDER AVE.,
1 JENKIN AVE., 1 VAUGHAN ST., 1 BACHMAYER ST., 1 SHARF ST., 1 SHOELLIG ST., 1 SREBRO ST.,
1 CHUZHOY ST., 1 GIMPEL AVE., 1 LIVNAROVIC ST., 1 MCALLESTER ST., 1 TULSIANI ST.,
1 MAKARYCHEV ST., 1 BLUM ST., 1 FURUI ST.
"""


def _names_in_order() -> list[str]:
    """Returns the street name of each tag from 440 on."""
    names = []
    for item in _STREETS.split(","):
        count, _, name = item.strip().partition(" ")
        names += [name] * int(count)
    return names


STREET_NAMES: dict[int, str] = dict(
    zip(SIGN_TAGS["sign_street_name"], _names_in_order(), strict=True)
)
"""The street name of each tag of a street name sign. Several tags have the same name."""


def _tags_by_name() -> dict[str, list[int]]:
    tags: dict[str, list[int]] = {}
    for tag, name in STREET_NAMES.items():
        tags.setdefault(name, []).append(tag)
    return tags


STREETS = tuple(map(tuple, _tags_by_name().values()))
"""The tags of each street name."""

"""Files of maps and what both readers make of them: Python's `read_maps`, and the explorer's `readMap` in TypeScript.

`python tests/formats/reading_cases.py` writes reading_cases.json. A case that is refused has words that both messages
contain. Any other case has the rows and the objects of its first map, and the number of its maps.
"""

import base64
import json
import tempfile
from pathlib import Path

from elitelanes_jax import InputError
from elitelanes_jax.formats.objects import object_values
from elitelanes_jax.formats.road_map import read_maps

__all__ = ["CASES", "reading_cases"]

CASES = Path(__file__).with_name("reading_cases.json")

# A refused text comes with words of its message, a text that is read alone.
LOOP = '"codes": [[6, 3], [12, 9]]'
NOT_A_CODE, NOT_A_NUMBER = "expected tile codes 0 to 15, got", "expected numbers by name"


def code(text):
    return f'{{"codes": [[6, 3], [12, {text}]]}}'


def field(text):
    return f"{{{LOOP}, {text}}}"


def thing(text):
    return f'{{{LOOP}, "objects": [{{{text}}}]}}'


JSON_FILES = [
    # Whole numbers are those without a point and an exponent.
    *[code(text) for text in ("9", "0", "15", "-0", " 9 ", "9\t\r\n")],
    *[(code(text), NOT_A_CODE) for text in ("9.0", "9e0", "-0.0", "0.9e1", "16", "-1", '"9"', "true", "[9]", "{}")],
    *[(code(text), NOT_A_CODE) for text in ("9007199254740993", "1" + "0" * 400, "99999999999999999999")],
    (code("1" + "0" * 4300), "digits"),
    *[(code(text), "expected") for text in ("09", "+9", ".9", "9.", "0x9", "1_0", "٩", "nul", "９", "'9'", "")],
    *[(code(text), "expected numbers, got") for text in ("1e400", "-1e400")],
    *[(code(text), "expected") for text in ("NaN", "Infinity", "-Infinity")],
    # Keys, once each, in any spelling.
    '{"c\\u006fdes": [[6, 3], [12, 9]]}',
    ('{"codes": [[5]], "codes": [[5]]}', "expected each key once, got codes"),
    ('{"codes": [[5]], "c\\u006fdes": [[5]]}', "expected each key once, got codes"),
    ('{"codes": [[5]], "note": {"a": 1, "a": 1}}', "expected each key once, got a"),
    field('"10": 1, "2": 1, "__proto__": {"codes": 1}, "constructor": null, "": 0, "note": "\\ud800"'),
    ('{"Codes": [[5]]}', "codes"),
    # Only the spaces of JSON are spaces.
    f"\t\r\n {{{LOOP}}}\n\n",
    *[(f"{space}{{{LOOP}}}", "expected") for space in ("\u00a0", "\u2028", "\x0b", "\x85", "\ufeff\ufeff")],
    f"\ufeff{{{LOOP}}}",
    (f"{{{LOOP},}}", "expected"),
    (f"{{{LOOP}}} {{}}", "expected"),
    (f"{{{LOOP}}} // a loop", "expected"),
    ('{"codes": [[5]], "note": "a\tb"}', "expected"),
    ('{"codes": [[5]], "note": "\\x41"}', "expected"),
    ("", "expected"),
    ("null", "expected"),
    # The table of codes.
    ('{"codes": []}', "expected"),
    ('{"codes": [[]]}', "expected"),
    ('{"codes": [[5, 5], [5]]}', "expected rows of one length"),
    ('{"codes": [5, 5]}', "expected"),
    ('{"codes": "55"}', "expected"),
    ('{"codes": null}', "expected"),
    (json.dumps({"codes": [[0] * 1025]}), "1024"),
    json.dumps({"codes": [[5] * 40]}),
    # The fields beside the codes.
    field('"format": "elitelanes map, version 1"'),
    (field('"format": "elitelanes map, version 2"'), "format: expected"),
    (field('"format": null'), "format: expected"),
    *[field(f'"shape": {text}') for text in ("[2, 2]", "[2.0, 2]")],
    *[(field(f'"shape": {text}'), "shape: expected") for text in ("[2, 3]", "[2]", "2", "null", '"2 x 2"')],
    field('"metrics": {"tiles": 4, "mean_block": 1.5, "1": 1e300}, "fitness": -14.5, "descriptor": {"turns": 4}'),
    *[(field(f'"metrics": {text}'), NOT_A_NUMBER) for text in ("[1]", '{"a": "1"}', '{"a": true}', '{"a": null}')],
    (field('"metrics": {"a": 1' + "0" * 309 + "}"), NOT_A_NUMBER),
    field('"metrics": {"a": 1' + "0" * 308 + "}"),
    (field('"fitness": "low"'), "fitness: expected a number"),
    (field('"fitness": false'), "fitness: expected a number"),
    field('"niche": [1, 0, 99999999999999999999], "seed": [0, 3], "fitness": null, "metrics": null'),
    (field('"niche": [1.0]'), "niche: expected whole numbers"),
    (field('"seed": [1, 2, 3]'), "seed: expected two whole numbers"),
    *[field(f'"unsure": {text}') for text in ("[]", "null", "[[0, 1], [1, 0]]", "[[99999999999999999999, 0]]")],
    *[
        (field(f'"unsure": {text}'), "unsure: expected a list of cells")
        for text in ("5", "{}", "[0, 1]", "[[0]]", "[[0, 1, 2]]", "[[0, 1.0]]", "[[0, -1]]", "[[0, true]]")
    ],
    field('"drawn": {"tile_set": "a", "tiles": [["a", "b"], ["c", "d"]], "quarter_turns": [[0, 1], [2, 3]]}'),
    (
        field('"drawn": {"tile_set": "a", "tiles": [["a", "b"]], "quarter_turns": [[0, 1], [2, 3]]}'),
        "drawn: expected",
    ),
    (
        field('"drawn": {"tile_set": "a", "tiles": [["a", "b"], ["c", "d"]], "quarter_turns": [[0, 1], [2, 4]]}'),
        "drawn: expected",
    ),
    (field('"drawn": {"tile_set": "a"}'), "drawn: expected"),
    # Objects.
    thing('"kind": "duckie", "x": 1, "y": 0.5'),
    thing('"kind": "sign_stop", "x": -1, "y": 3, "angle": 7, "height": 10, "tag": 586, "static": false'),
    thing('"kind": "other:my.Crane-2_é日本²", "x": 1e0, "y": 0'),
    thing('"kind": "other", "x": 1, "y": 0'),
    thing('"kind": "floor_tag", "x": 1, "y": 0, "height": 0'),
    (thing('"kind": "floor_tag", "x": 1, "y": 0, "height": 0.1'), "height: expected"),
    *[(thing(f'"kind": {text}, "x": 1, "y": 0'), "kind: expected") for text in ('"unicorn"', "null", "1", '"other:"')],
    *[
        (thing(f'"kind": "{text}", "x": 1, "y": 0'), "kind: expected")
        for text in ("other:a b", "other:😀", "Duckie", "other:duckie", "other:other", "other:Null")
    ],
    thing('"kind": "other:Duckie", "x": 1, "y": 0'),
    (thing('"kind": "other:' + "a" * 65 + '", "x": 1, "y": 0'), "kind: expected"),
    thing('"kind": "other:' + "a" * 64 + '", "x": 1, "y": 0'),
    # A position may be a little farther outside than one tile, as rounded positions of other formats are.
    *[thing(f'"kind": "duckie", "x": {text}, "y": {text}') for text in ("-1.0000000000000002", "3.00009", "-1.00009")],
    *[(thing(f'"kind": "duckie", "x": {text}, "y": 0'), "x: expected") for text in ("3.0002", "-1.0002")],
    *[(thing(f'"kind": "duckie", "x": {text}, "y": 0'), "x: expected") for text in ("3.1", '"1"', "true", "null")],
    (thing('"kind": "duckie", "x": 1' + "0" * 400 + ', "y": 0'), "x: expected"),
    (thing('"kind": "duckie", "x": 1'), "y: expected"),
    (thing('"kind": "duckie", "x": 1, "y": 0, "angle": 7.1'), "angle: expected"),
    (thing('"kind": "duckie", "x": 1, "y": 0, "height": null'), "height: expected"),
    *[
        (thing(f'"kind": "duckie", "x": 1, "y": 0, "tag": {text}'), "tag: expected")
        for text in ("587", "-1", "3.0", '"3"')
    ],
    thing('"kind": "duckie", "x": 1, "y": 0, "tag": null'),
    *[(thing(f'"kind": "duckie", "x": 1, "y": 0, "static": {text}'), "static: expected") for text in ("null", "1")],
    (thing('"kind": "duckie", "x": 1, "y": 0, "hat": 1'), "expected"),
    (thing('"kind": "duckie", "x": 1, "y": 0, "__proto__": 1'), "expected"),
    (field('"objects": {}'), "objects: expected"),
    (field('"objects": [5]'), "object 0: "),
    field('"objects": null'),
    # Lists of maps.
    f'[{{{LOOP}}}, {{"codes": [[15]]}}]',
    (f"[{{{LOOP}}}, {{}}]", "map 1: "),
    (f"[{{{LOOP}}}, 5]", "map 1: "),
]

OBJECT = "tiles: [[grass, straight/N], [4way, curve_left]]\nobjects:\n  a: {kind: duckie, "


def tiles(text):
    return f"tiles: [[{text}]]\n"


def posed(text):
    return f"{OBJECT}pos: [{text}, 1]}}\n"


def still(text):
    return f"{OBJECT}pos: [1, 1], static: {text}}}\n"


UNKNOWN_TILE = "tiles: expected one of"
YAML_FILES = [
    # Kinds of tiles, with the spaces that Python strips and no others.
    *[tiles(text) for text in ("4way", "4way/N", "curve_left/W", '"curve_left / W"', "curve_left /W", "straight")],
    *[
        tiles(f'"{text}"')
        for text in (" grass ", "\\u00a0grass", "straight\u00a0/\u2003N\u3000", "\\tfloor\\n", "4way\x85")
    ],
    *[(tiles(f'"{text}"'), UNKNOWN_TILE) for text in ("\\ufeffgrass", "\\u200bgrass", "\\u180egrass", "4 way", "")],
    *[(tiles(text), UNKNOWN_TILE) for text in ("4WAY", "4way/", "4way/n", "4way/N/", "/", "~", "[4way]", "{4way: N}")],
    *[(tiles(text), UNKNOWN_TILE) for text in ("null", "true", "1", "3way", "curve_left\\W")],
    # Numbers are what Python's float reads, without underscores.
    *[posed(text) for text in ("1", "+1", "1.", ".5", "-.5e-1", "1e0", "1E0", "01", "00.50", '"1"', "' 1 '", "-0")],
    *[
        posed(f'"{text}"')
        for text in ("\\u00a01", "1\\u2003", "\\u0661", "\u0967", "\uff11.\uff15", "0\u0661", "\\t1\\n")
    ],
    *[(posed(text), "expected a number") for text in ("0x1", "0X1", "0o1", "0b1", "1_0", "1__0", "1:30", "1m")],
    *[(posed(text), "expected a number") for text in ("inf", "nan", ".inf", ".nan", "Infinity", "1e400", "1e", "e1")],
    *[
        (posed(text), "expected a number")
        for text in ("~", "null", '""', "true", "--1", "1 2", "1d0", "[1]", "2001-01-01")
    ],
    *[
        (posed(f'"{text}"'), "expected a number")
        for text in ("\\x1c1", "\\ufeff1", "\u2212" + "1", "1\u066b5", "\u00b2")
    ],
    *[f"tile_size: {text}\n{posed('1')}" for text in ("0.61", "1e-1", "100", "' 0.6 '", "+.5")],
    *[
        (f"tile_size: {text}\n{posed('1')}", "tile_size: expected")
        for text in ("0x1", "0.009", "101", "٠.٦", "~", "[1]")
    ],
    f"tile_size: none\n{tiles('4way')}",
    # What YAML 1.1 reads as false, and nothing else.
    *[still(text) for text in ("false", "False", "FALSE", "no", "No", "NO", "off", "Off", "OFF", '"false"')],
    *[still(text) for text in ("fAlse", "nO", "oFF", "n", "N", "0", "~", '" false"', "true", "[false]")],
    # Names of objects keep their order, also names like numbers.
    tiles("4way")
    + "objects: {10: {kind: cone, pos: [0, 0]}, 2: {kind: tree, pos: [1, 0]}, b: {kind: bus, pos: [0, 1]}, "
    + "-1: {kind: truck, pos: [1, 1]}, 1: {kind: house, pos: [0, 0]}}\n",
    tiles("4way") + "objects:\n- {kind: cone, pos: [0, 0]}\n- {kind: tree, pos: [1, 0]}\n",
    tiles("4way") + "objects: {__proto__: {kind: cone, pos: [0, 0]}, constructor: {kind: tree, pos: [1, 0]}}\n",
    *[tiles("4way") + f"objects: {text}\n" for text in ("", "[]", "{}", "''", "~", "null", "Null", "NULL")],
    *[(tiles("4way") + f"objects: {text}\n", "objects: expected") for text in ("5", "none")],
    (tiles("4way") + "objects: {a: 5}\n", "objects: a: "),
    (tiles("4way") + "objects: {a: {pos: [0, 0]}}\n", "objects: a: "),
    (tiles("4way") + "objects: {a: {kind: [cone], pos: [0, 0]}}\n", "objects: a: "),
    # The four ways to say where an object is, and which of them comes first.
    f"{OBJECT}pos: [1, 0.5], rotate: 90, pose: none}}\n",
    f"{OBJECT}pose: {{~SE2Transform: {{p: [0.3, 0.9], theta_deg: 200}}}}, rotate: 10}}\n",
    f"{OBJECT}pose: {{~SE2Transform: {{theta: 1.5}}}}, place: none}}\n",
    f"{OBJECT}place: {{tile: [1, 0], relative: {{~SE2Transform: {{p: [0.1, 0.2, 0], theta: -4}}}}}}}}\n",
    f"{OBJECT}attach: {{tile: [1, 1], slot: 6}}, pose: {{~SE2Transform: {{theta_deg: -270}}}}, pos: none}}\n",
    f"{OBJECT}attach: {{tile: [1, 1], slot: 6}}, pose: {{~SE2Transform: {{theta: 1.5}}}}}}\n",
    f"{OBJECT}pose: {{~SE2Transform: {{p: [0.3, 0.4], theta: 1.5, theta_deg: 10}}}}}}\n",
    f"{OBJECT}attach: {{tile: [1, 1], slot: 0.0}}, rotate: 45}}\n",
    *[(f"{OBJECT}attach: {{tile: [1, 1], slot: {text}}}}}\n", "slot: expected") for text in ("8", "-1", "0.5", "a")],
    (f"{OBJECT}pos: [1, 1], rotate: east}}\n", "rotate: expected"),
    (f"{OBJECT}pos: [1]}}\n", "pos: expected two numbers"),
    (f"{OBJECT}pos: [1, 1, 1, 1]}}\n", "pos: expected two numbers"),
    (f"{OBJECT}pos: 1}}\n", "pos: expected two numbers"),
    f"{OBJECT}pos: [1, 1, high]}}\n",
    (f"{OBJECT}pose: {{}}}}\n", "~SE2Transform: expected"),
    (f"{OBJECT}place: {{tile: [0, 0]}}}}\n", "~SE2Transform: expected"),
    (f"{OBJECT}height: 0.1}}\n", "expected a pose, pos, place or attach"),
    (f"{OBJECT}pos: [9, 9]}}\n", "x: expected"),
    # Kinds, heights, tags.
    tiles("4way") + "objects: [{kind: sign_1_way_left, pos: [0, 0], height: 0.2}, {kind: my.crane, pos: [0, 0]}]\n",
    tiles("4way") + "objects: [{kind: floor_tag, pos: [0, 0], height: much, tag: {~TagInstance: {tag_id: 301}}}]\n",
    tiles("4way") + "objects: [{kind: sign_blank, pos: [0, 0], tag: {~TagInstance: {tag_id: 440.0}}}]\n",
    tiles("4way") + "objects: [{kind: sign_blank, pos: [0, 0], tag: {~TagInstance: {tag_id: 552}}}]\n",
    tiles("4way") + "objects: [{kind: trafficlight, pos: [0.5, 0.5], rotate: 400, height: 0.3}]\n",
    (tiles("4way") + "objects: [{kind: cone, pos: [0, 0], tag: {~TagInstance: {tag_id: 1.5}}}]\n", "tag_id: expected"),
    (tiles("4way") + "objects: [{kind: cone, pos: [0, 0], tag: 5}]\n", "~TagInstance: expected"),
    (tiles("4way") + "objects: [{kind: cone, pos: [0, 0], height: 0x1}]\n", "height: expected"),
    (tiles("4way") + "objects: [{kind: cone, pos: [0, 0], height: 11}]\n", "height: expected"),
    # A scale is one of a mesh of gym-duckietown, whose size is not in the file.
    (tiles("4way") + "objects: [{kind: cone, pos: [0, 0], scale: 0.5}]\n", "scale: expected a height"),
    tiles("4way") + "objects: [{kind: cone, pos: [0, 0], scale: 0.5, height: 0.1}]\n",
    tiles("4way") + "objects: [{kind: floor_tag, pos: [0, 0], scale: 0.5}]\n",
    *[
        (tiles("4way") + f"objects: [{{kind: {text}, pos: [0, 0]}}]\n", "kind: expected")
        for text in ("'my crane'", "null")
    ],
    (tiles("4way") + "objects: [{kind: 'other:crane', pos: [0, 0]}]\n", "kind: expected"),
    # YAML as people write it.
    "tiles: [\n[straight/N,\t4way],# a row\n[grass, floor] ,\n]\n",
    "tiles:\n- [straight/N, 4way,\n4way]\n- - grass\n  - 'floor'\n  - \"asphalt\"\n",
    "# a map\r\ntiles: # the tiles\r\n- [4way] # a row\r\n",
    "tiles:\r- [4way]\r",
    "---\ntiles: [[4way]]\n...\n",
    "%YAML 1.1\n---\ntiles: [[4way]]\n",
    '{"tiles": [["4way", "grass"]], "tile_size": 0.6}',
    "? tiles\n: - - 4way\n",
    "rows: &rows [4way, grass]\ntiles: [*rows, *rows]\n",
    "tiles: !table [!!seq [!kind 4way], [!!str grass]]\n",
    "base: &base {kind: cone, pos: [1, 1]}\ntiles: [[4way]]\nobjects: [{<<: *base, kind: tree, pos: [0, 0]}]\n",
    # A table has the keys of merged tables, unless it has its own or an earlier one of them has.
    "base: &base {kind: cone, pos: [1, 1], rotate: 90, height: 0.3}\n"
    "tiles: [[4way]]\nobjects: [{pos: [0, 0], <<: *base}, {<<: *base, kind: tree}]\n",
    "a: &a {kind: cone, pos: [1, 1]}\nb: &b {kind: tree, rotate: 90}\ntiles: [[4way]]\nobjects: [{<<: [*a, *b]}]\n",
    "a: &a {kind: cone}\nb: &b {<<: *a, pos: [1, 1]}\ntiles: [[4way]]\nobjects: [{<<: *b}]\n",
    "base: &base {tiles: [[4way]], tile_size: 0.6}\n<<: *base\n",
    *[(f"{text}tiles: [[4way]]\n", "for the key <<") for text in ("<<: 1\n", "<<: [[]]\n", "a: &a [b]\n<<: *a\n")],
    *[(f"tiles: [[4way]]\nobjects: {text}\n", "for the key <<") for text in ("[&a {<<: *a}]", "&a {b: {<<: *a}}")],
    "\ufefftiles: [[4way]]\n",
    "tiles: [[4way]]\nnote: |\n  [ {\n  \"\nmore: >-\n  it's: #1\n",
    'tiles: [[4way]]\nnote: it\'s "so" [or] {not}, a # comment\nmore: \'a\n\nb\'\nlast: "a \\\n  b"\n',
    ("tiles: [[4way]]\ntiles: [[4way]]\n", "expected each key once, got tiles"),
    ("tiles: [[4way]]\nobjects: {a: {kind: cone, pos: [0, 0], kind: cone}}\n", "expected each key once, got kind"),
    ("tiles: [[4way]]\n[a, b]: c\n", "its keys texts"),
    ("tiles: [[4way]]\n---\ntiles: [[4way]]\n", "one document"),
    ("tiles: [*rows]\n", "expected readable YAML"),
    ("tiles: [[4way]\n", "expected readable YAML"),
    ("tiles: [[4way]]\n\t\n", "expected readable YAML"),
    ("tiles:\n-\t[4way]\nname:\n\ta: b\n", "expected readable YAML"),
    ("tiles: [[4way]]\nname: @me\n", "expected readable YAML"),
    ("tiles: [[4way]]\nname: a: b\n", "expected readable YAML"),
    ('tiles: [[4way]]\nname: "\\ud800"\n', "expected readable YAML"),
    ("tiles: [[4way]]\nname: \x07\n", "expected readable YAML"),
    ("tiles: [[4way]]\nname: " + "[" * 70 + "]" * 70 + "\n", "levels deep"),
    ("tiles: [[4way, grass], [4way]]\n", "expected rows of one length"),
    ("tiles: []\n", "expected"),
    ("tiles: [[]]\n", "expected"),
    ("tiles: 4way\n", "tiles: expected"),
    ("tiles: [4way]\n", "tiles: expected"),
    ("tiles:\n", "tiles: expected"),
    ("tile_size: 0.585\n", 'got no "tiles"'),
    ("- tiles\n", 'got no "tiles"'),
    ("4way\n", 'got no "tiles"'),
    ("# nothing\n", 'got no "tiles"'),
]

BYTES = [
    ("map.json", b'{"codes": [[5]], "note": "\xff"}', "expected"),
    ("map.json", b'{"codes": [[5]], "note": "\xed\xa0\x80"}', "expected"),
    ("map.json", '{"codes": [[5]]}'.encode("utf-16"), "expected"),
    ("map.yaml", b"tiles: [[4way]] # caf\xe9\n", "expected"),
    ("MAP.YML", b"tiles: [[4way]]\n", None),
    ("map.yaml.json", b'{"codes": [[5]]}', None),
    (".yaml", b'{"codes": [[5]]}', None),
    ("map", b'{"codes": [[5]]}', None),
]


def reading_cases():
    """Returns the text of the file, a case a line; raises `ValueError` for a case that Python reads otherwise."""
    cases = []
    for name, entries in (("map.json", JSON_FILES), ("map.yaml", YAML_FILES)):
        for entry in entries:
            text, words = entry if isinstance(entry, tuple) else (entry, None)
            cases.append({"file": name, "text": text} | _expected(name, text.encode(), words))
    for name, content, words in BYTES:
        cases.append({"file": name, "base64": base64.b64encode(content).decode()} | _expected(name, content, words))
    return "[\n" + ",\n".join(json.dumps(case) for case in cases) + "\n]\n"


def _expected(name, content, words):
    """Returns what Python makes of a file, or the words that its message has to contain."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / name
        file.write_bytes(content)
        maps, message = _read(file)
    is_expected = maps if words is None else words in message
    if not is_expected:
        raise ValueError(f"{content!r}: expected {words or 'maps'}, got {message or maps}")
    if not maps:
        return {"refused": words}
    rows = "/".join("".join(f"{code:x}" for code in row) for row in maps[0].codes.tolist())
    objects = [object_values(thing) for thing in maps[0].objects or ()]
    return {"rows": rows, "objects": objects, "maps": len(maps)}


def _read(file):
    """Returns the maps of a file, or why it is refused."""
    try:
        return read_maps(file), ""
    except InputError as error:
        return [], str(error)


if __name__ == "__main__":
    CASES.write_text(reading_cases(), encoding="utf-8")

"""Names of files that mean something to a program that reads them."""

ODD_NAMES = {
    "spaces": "my  town",
    "a space first": " town",
    "a space last": "town ",
    "another space": "my\u3000town",
    "quotes": 'it\'s "a" town',
    "comma": "a,b",
    "code of a character": "a%41b",
    "per cent": "100%",
    "home": "~",
    "home of a user": "~root",
    "backslash": "a\\b",
    "line break": "a\nb",
    "carriage return": "a\rb",
    "tab": "a\tb",
    "XML": "<a>&amp;<b>",
    "variable": "$HOME",
    "variable in braces": "${HOME}",
    "port": "a:1",
    "dash first": "-c",
    "nothing": "null",
    "number": "1e3",
    "truth": "yes",
    "long": "n" * 200,
    "dots": "..a.b.c",
    "emoji": "\U0001f697",
    "accent of its own": "e\u0301",
    "right to left": "\u05d0\u05d1\u202e",
    "tag of YAML": "!include",
    "no UTF-8": "a\udcff",
    "control character": "a\x01",
}
"""Each name by what is odd about it."""

REFUSED = {
    "sumo": {
        *("comma", "backslash", "variable in braces", "port"),
        *("no UTF-8", "control character"),
    },
    "opendrive": {"no UTF-8", "control character"},
    "mujoco": {"backslash", "no UTF-8", "control character"},
    "usd": {"backslash", "line break", "carriage return", "tab", "XML", "no UTF-8", "control character"},
    "movingai": {
        *("spaces", "a space first", "a space last", "another space", "quotes", "line break", "carriage return", "tab"),
        "no UTF-8",
    },
    "csv": {"no UTF-8"},
}
"""What each format refuses in a name. All other formats hold no names of files."""

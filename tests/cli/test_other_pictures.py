"""Commands that draw maps say so if the set of a map's name has other pictures than the map was drawn with."""

import json
from pathlib import Path

import pytest

from elitelanes_jax.cli.main import main

SAYS = "has other pictures now; they are chosen anew"


@pytest.fixture(scope="module")
def drawn_map(tmp_path_factory) -> Path:
    """A map whose record has another digest for one of its pictures."""
    folder = tmp_path_factory.mktemp("drawn")
    options = ["--size", "5", "5", "--maps", "1", "--evaluations", "500", "--tile-px", "16", "--quiet"]
    assert main(["generate", *options, "--out", str(folder / "run")]) == 0
    file = next((folder / "run" / "maps").glob("*/map.json"))
    record = json.loads(file.read_text())
    digests = record["drawn"]["digests"]
    digests[min(digests)] = "0" * len(digests[min(digests)])
    other = folder / "other.json"
    other.write_text(json.dumps(record))
    return other


@pytest.mark.parametrize(
    "command",
    [
        ["render", "--tile-px", "16", "--out", "out"],
        ["drive", "--tile-px", "16", "--rides", "1", "--seconds", "0.5", "--out", "out.png"],
        ["export", "--to", "gltf", "--tile-px", "16", "--out", "out.glb"],
        ["pack", "--to", "gltf", "--split", "1", "0", "0", "--tile-px", "16", "--out", "pack"],
    ],
    ids=lambda command: command[0],
)
def test_commands_say_that_a_set_has_other_pictures(command, drawn_map, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    name, *options = command
    assert main([name, str(drawn_map), *options]) == 0
    assert SAYS in capsys.readouterr().err

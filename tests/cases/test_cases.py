"""Command lines and what each prints and writes. The lines are data: a file ``*.cases`` for each command.

A case is a line that starts with ``$``, followed by what a user types after ``elitelanes``, and lines that say what it
does:

    err TEXT         standard error contains the text; the exit status is then 2, unless another is named
    out TEXT         standard output contains the text
    file PATTERN     files that it writes; ``*`` also matches folders
    changed PATTERN  existing files that it changes
    exit STATUS      the exit status; 0 by default
    # TEXT           a comment

Each line runs in a folder of its own, with the files that it names: from ``inputs/``, or one of `things`. These rules
hold for every line. A line that fails prints one line, which begins with the program's name (`tiles check` prints one
for each fault), nothing else, and writes nothing. An interrupted line prints at most that. A line that succeeds prints
nothing on standard error. All files that it writes are named, and all other files stay as they are.

A line that starts with ``%`` runs in a shell, in which ``elitelanes`` is the program: a process of its own.
"""

import os
import shlex
import shutil
import subprocess
import sys
from fnmatch import fnmatch
from pathlib import Path
from typing import NamedTuple

import cv2
import pytest
from folders import files
from photographed import draw_photographs

from elitelanes_jax.cli.main import main
from elitelanes_jax.tiles.tileset import default_tiles

HERE = Path(__file__).parent


class Case(NamedTuple):
    line: str
    given: tuple[tuple[str, str], ...]

    def all(self, key):
        return [text for name, text in self.given if name == key]

    @property
    def exit(self):
        return int((self.all("exit") or ["2" if self.all("err") else "0"])[0])


def read_cases(file):
    cases = []
    for line in file.read_text(encoding="utf-8").splitlines():
        key, _, text = line.partition(" ")
        if key in ("$", "%"):
            cases.append(Case(line, ()))
        elif key in ("err", "out", "file", "changed", "exit"):
            cases[-1] = cases[-1]._replace(given=(*cases[-1].given, (key, text)))
        else:
            assert key in ("", "#"), f"{file.name}: {line!r} is no line of a case"
    return cases


CASES = {file.stem: read_cases(file) for file in sorted(HERE.glob("*.cases"))}


@pytest.fixture(scope="session")
def things(tmp_path_factory):
    """A folder with all that lines may name: the inputs; small tiles; photographs; a folder of generated maps."""
    folder = tmp_path_factory.mktemp("things")
    shutil.copytree(HERE / "inputs", folder, dirs_exist_ok=True)
    for kind in ("turn_1", "straight_1", "crossing3_1", "crossing4_1"):
        (folder / "tiles" / kind).mkdir(parents=True)
        for file in (default_tiles() / kind).iterdir():
            small = cv2.resize(cv2.imread(str(file), cv2.IMREAD_UNCHANGED), (48, 48), interpolation=cv2.INTER_NEAREST)
            cv2.imwrite(str(folder / "tiles" / kind / file.name), small)
    for name, tile, target, source in (
        ("inverted", "straight_1", "yellow", lambda masks: 255 - masks["yellow"]),
        ("swapped", "crossing3_1", "red", lambda masks: masks["yellow"]),
        ("unstopped", "crossing4_1", "red", lambda masks: 0 * masks["red"]),
    ):
        shutil.copytree(folder / "tiles", folder / name)
        place = folder / name / tile
        masks = {mask: cv2.imread(str(place / f"{mask}.png"), cv2.IMREAD_UNCHANGED) for mask in ("red", "yellow")}
        cv2.imwrite(str(place / f"{target}.png"), source(masks))
    draw_photographs(folder)
    program = folder / "bin" / "elitelanes"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} -m elitelanes_jax "$@"\n')
    program.chmod(0o755)
    line = "generate --size 5 6 --seeds 3 --maps 3 --generations 5 --method ea --preset paper --tile-px 16 --out"
    assert main([*line.split(), str(folder / "maps")]) == 0
    return folder


def run(line, capfd, things):
    """Runs a line; returns its exit status, and what it said on standard output and standard error."""
    kind, text = line[0], line[2:]
    if kind == "%":
        path = {"PATH": f"{things / 'bin'}{os.pathsep}{os.environ['PATH']}"}
        command = ["bash", "-o", "pipefail", "-c", text]
        ran = subprocess.run(command, env=os.environ | path, capture_output=True, text=True, check=False, timeout=60)
        return ran.returncode, ran.stdout, ran.stderr
    capfd.readouterr()
    try:
        status = main(shlex.split(text))
    except SystemExit as stop:
        status = stop.code
    return status, *capfd.readouterr()


@pytest.mark.parametrize("case", [case for cases in CASES.values() for case in cases], ids=lambda case: case.line[:120])
def test_case(case, things, tmp_path, monkeypatch, capfd):
    if case.line[0] == "%" and sys.platform == "win32":
        pytest.skip("no such shell")
    monkeypatch.chdir(tmp_path)
    for name in {
        Path(word).parts[0] for word in shlex.split(case.line[2:], comments=True) if word.strip("/.") and word[0] != "/"
    }:
        if (things / name).is_dir():
            shutil.copytree(things / name, tmp_path / name)
        elif (things / name).exists():
            shutil.copy(things / name, tmp_path / name)
    before = files(tmp_path)
    status, out, err = run(case.line, capfd, things)
    after = files(tmp_path)
    said = f"{case.line}\nexit {status}\n{out}{err}"
    assert status == case.exit, said
    for text, pieces in ((out, case.all("out")), (err, case.all("err"))):
        for piece in pieces:
            assert piece in text, said
    if status:
        assert out == "" and "Traceback" not in err, said
        assert (
            "tiles check" in case.line
            or "2>" in case.line
            or (err.startswith("elitelanes") and err.count("\n") == 1)
            or (status == 130 and not err)
        ), said
    elif not case.all("err"):
        assert err == "", said
    same_names = [name for name in before if name in after]
    check_names(case.all("file"), set(after) - set(before), said)
    check_names(case.all("changed"), {name for name in same_names if after[name] != before[name]}, said)
    assert len(same_names) == len(before), said


def check_names(patterns, names, said):
    """Each pattern is that of a name, and each name has a pattern."""
    for pattern in patterns:
        assert any(fnmatch(name, pattern) for name in names), (said, pattern, names)
    assert not [name for name in names if not any(fnmatch(name, pattern) for pattern in patterns)], (said, names)


def test_there_are_many_cases_and_no_line_twice():
    lines = [case.line for cases in CASES.values() for case in cases]
    assert len(lines) == len(set(lines)) >= 300

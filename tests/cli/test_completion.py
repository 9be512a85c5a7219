"""Scripts for shells, in the shells themselves where they are installed."""

import shutil
import subprocess
from contextlib import redirect_stdout

import pytest

from elitelanes_jax.cli.main import main, make_parser
from elitelanes_jax.network.records import Weights
from elitelanes_jax.problem.features import FEATURES, TOWN_FEATURES
from elitelanes_jax.search.spec import METHODS

COMMANDS = set(next(action.choices for action in make_parser()._actions if action.choices))

COMPLETED = {
    "": COMMANDS,
    "ge": {"generate"},
    "tiles ": {"check", "masks"},
    "tiles masks --over": {"--overwrite"},
    "generate --at": {"--at-most"},
    "generate --method ": set(METHODS),
    "generate --quiet --method m": {"map-elites"},
    "generate --where cyc": {"cyclomatic="},
    "pick --axes ": {f"{name}:" for name in (*FEATURES, *TOWN_FEATURES)},
    "dataset --weights ": {f"{name}=" for name in (*Weights._fields, *TOWN_FEATURES)},
    "generate --inventory cross": {"crossing3=", "crossing4="},
    "metrics ": {*FEATURES, *TOWN_FEATURES},
    "completion ": {"bash", "zsh", "fish", "tcsh", "powershell"},
    "export --to j": {"json"},
}


@pytest.fixture(scope="module")
def script(tmp_path_factory):
    """A function from a shell to the path of its script."""

    def write(shell):
        file = tmp_path_factory.mktemp("completion") / shell
        with file.open("w") as stream, redirect_stdout(stream):
            assert main(["completion", shell]) == 0
        return file

    return write


def run(shell, program):
    if shutil.which(shell) is None:
        pytest.skip(f"{shell} is not installed")
    ran = subprocess.run([shell, "-c", program], capture_output=True, text=True, check=True)
    assert ran.stderr == ""
    return ran.stdout


def test_bash_completes_commands_options_and_values(script):
    asked = "\n".join(
        f"COMP_WORDS=(elitelanes {line}{' ' + repr('') if not line or line.endswith(' ') else ''}); "
        "COMP_CWORD=$((${#COMP_WORDS[@]} - 1)); COMPREPLY=(); _elitelanes; echo ${COMPREPLY[*]}"
        for line in COMPLETED
    )
    said = run("bash", f"source {script('bash')}\n{asked}").split("\n")
    assert {line: set(words.split()) for line, words in zip(COMPLETED, said, strict=False)} == COMPLETED


def test_bash_completes_other_words_as_files(script, tmp_path):
    (tmp_path / "map.json").touch()
    asked = f"cd {tmp_path}; COMP_WORDS=(elitelanes show m); COMP_CWORD=2; _elitelanes; echo $COMPREPLY"
    assert run("bash", f"source {script('bash')}\n{asked}") == "map.json\n"


def test_fish_completes_commands_options_and_values(script):
    asked = "\n".join(f"complete -C 'elitelanes {line}' | cut -f 1; echo end" for line in COMPLETED)
    said = run("fish", f"source {script('fish')}\n{asked}").split("end\n")
    for (line, words), found in zip(COMPLETED.items(), said, strict=False):
        assert words == {word for word in found.splitlines() if not word.endswith("/")}, line


def test_zsh_reads_the_script(script):
    load = f'autoload -Uz compinit && compinit -u -D; eval "$(cat {script("zsh")})"'
    assert run("zsh", f"{load}; print ${{_comps[elitelanes]}}") == "_shtab_elitelanes\n"

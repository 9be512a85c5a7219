"""Helpers for tests of written pages."""

import json
import re
import shlex
from pathlib import Path

__all__ = ["READERS", "blocks", "commands", "programs", "run_program"]

ROOT = Path(__file__).parents[1]
# What readers copy from: only public names are used there.
READERS = [
    *ROOT.glob("*.md"),
    *(file for room in ("docs", "notebooks", "experiments") for file in (ROOT / room).rglob("*.*")),
]


def programs(file):
    """Returns the Python in a file: a module, the cells of a notebook, or the blocks of a page."""
    if file.suffix == ".py":
        return [file.read_text(encoding="utf-8")]
    if file.suffix == ".ipynb":
        cells = json.loads(file.read_text(encoding="utf-8"))["cells"]
        sources = [cell["source"] for cell in cells if cell["cell_type"] == "code"]
        return ["".join(line for line in source if not line.startswith(("%", "!"))) for source in sources]
    return [text for _, text in blocks(file.read_text(encoding="utf-8"), "python")] if file.suffix == ".md" else []


def blocks(text, *languages):
    """Returns the blocks of code on a page: language and text, in order."""
    return re.findall(rf"```({'|'.join(languages)})\n(.*?)```", text, re.DOTALL)


def commands(text):
    """Returns the arguments of each `elitelanes` command in the shell blocks of a page."""
    lines = [line for _, block in blocks(text, "sh") for line in block.splitlines()]
    return [shlex.split(line)[1:] for line in lines if line.startswith("elitelanes ")]


def run_program(program, name, capsys):
    """Runs a program and compares what it prints with the comments behind its prints."""
    exec(compile(program, name, "exec"), {})
    printed = capsys.readouterr().out.splitlines()
    said = re.findall(r"^print\(.*\)  # (.*)$", program, re.MULTILINE)
    assert len(said) <= len(printed)
    for line, words in zip(printed[: len(said)], said, strict=True):
        assert words.split(": ")[0] == line or words == line

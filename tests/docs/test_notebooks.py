"""The notebooks: they run, and their outputs are kept with them."""

import re
from copy import deepcopy

import nbformat
import pytest
from execute import NOTEBOOKS, execute, normalised

# What a notebook imports that not every environment has.
EXTRAS = {"09_roadqd_pyribs": "ribs"}

each_notebook = pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda file: file.stem)


def outputs(notebook):
    return [output for cell in notebook.cells for output in cell.get("outputs", ())]


def text_of(output):
    """Returns the text of an output, without its pictures."""
    data = {kind: text for kind, text in output.get("data", {}).items() if not kind.startswith("image/")}
    return "".join([output.get("text", ""), *map(str, data.values())])


@each_notebook
def test_kept_outputs_are_of_a_full_run_of_these_sources(file):
    notebook = nbformat.read(file, as_version=4)
    nbformat.validate(notebook)
    assert notebook == normalised(deepcopy(notebook)), "not as execute.py leaves it; run: python notebooks/execute.py"
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
    kept = outputs(notebook)
    assert sum("image/png" in output.get("data", {}) for output in kept) >= 2
    assert not [output for output in kept if output.output_type == "error" or output.get("name") == "stderr"]
    assert not re.search(r"pip install|\bat 0x|/(home|root|tmp|usr|var)\b|\x1b", "".join(map(text_of, kept)))
    assert file.stat().st_size < 600_000


@each_notebook
def test_links_lead_somewhere(file):
    for cell in nbformat.read(file, as_version=4).cells:
        for link in re.findall(r"\]\((?!https?:)([^)]+)\)", cell.source) if cell.cell_type == "markdown" else ():
            assert (file.parent / link).exists(), link


@pytest.mark.slow
@each_notebook
def test_runs(file, tmp_path, monkeypatch):
    if file.stem in EXTRAS:
        pytest.importorskip(EXTRAS[file.stem])
    if any(word in file.stem for word in ("perception", "curricula")):
        # These train: their programs run for longer than they take to compile.
        monkeypatch.delenv("XLA_FLAGS", raising=False)
    shown = outputs(execute(file, tmp_path, quick=True))
    assert not re.search("warn", "".join(text_of(output) for output in shown if output.get("name") == "stderr"), re.I)

"""Executes notebooks in full and writes them with what they show, all that differs between machines taken off.

python notebooks/execute.py                      # all of them; needs what [dev,experiments,sumo] brings
python notebooks/execute.py 02_fitness_kernel    # or some, by their names
"""

import base64
import hashlib
import io
import os
import sys
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import jax
import nbformat
import numpy as np
from nbclient import NotebookClient
from nbformat import NotebookNode
from PIL import Image
from traitlets.config import Config

from elitelanes_jax import evolve

__all__ = ["NOTEBOOKS", "execute", "normalised"]

NOTEBOOKS = sorted(Path(__file__).parent.glob("*.ipynb"))

_METADATA = {
    "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
    "language_info": {"name": "python"},
}


def main(names: list[str]) -> None:
    chosen = [file for file in NOTEBOOKS if not names or file.stem in names]
    for file in chosen:
        with TemporaryDirectory() as folder:
            notebook = execute(file, Path(folder))
        for cell in notebook.cells:
            for output in cell.get("outputs", ()):
                pictures = output.get("data", {})
                if "image/png" in pictures:
                    pictures["image/png"] = _smaller(pictures["image/png"])
        nbformat.write(normalised(notebook), file)
        print(f"{file.name}: {file.stat().st_size // 1000} kB")


def execute(file: Path, folder: Path, *, quick: bool = False) -> NotebookNode:
    """The notebook after a run of all its cells in a fresh process.

    Args:
      file: of the notebook; it stays as it is.
      folder: where the notebook's own files go.
      quick: whether with few steps.

    Raises:
      CellExecutionError: if a cell fails.
    """
    notebook = nbformat.read(file, as_version=4)
    # Sockets in the folder: a port might be taken, by another kernel that is just starting.
    own = Config(KernelManager={"transport": "ipc", "ip": str(folder / "kernel")})
    client = NotebookClient(notebook, timeout=600, kernel_name="python3", record_timing=False, config=own)
    environment = {**os.environ, "PYDEVD_DISABLE_FILE_VALIDATION": "1"}  # no debugger, no word about it
    environment.pop("ELITELANES_QUICK", None)
    client.resources["metadata"] = {"path": str(folder)}
    return client.execute(env=environment | ({"ELITELANES_QUICK": "1"} if quick else {}))


def normalised(notebook: NotebookNode) -> NotebookNode:
    """The notebook as it is kept: no progress bars, no metadata of a machine.

    The id of a cell is a digest of its source and all before it. Who changes a source and does not execute leaves ids
    that do not fit, which the tests see; who changes what searches find, and does not, leaves another digest of that.
    """
    digest = hashlib.sha256()
    for cell in notebook.cells:
        digest.update(f"{cell.cell_type}\n{cell.source}\n".encode())
        cell.id, cell.metadata = digest.hexdigest()[:8], NotebookNode()
        if cell.cell_type == "code":
            cell.outputs = [output for output in cell.outputs if not _is_bar(output)]
    notebook.metadata = nbformat.from_dict(_METADATA | {"searches": _searches()})
    notebook.nbformat, notebook.nbformat_minor = 4, 5
    return notebook


@cache
def _searches() -> str:
    """A digest of what small searches find: all that notebooks show depends on what this does."""
    digest = hashlib.sha256()
    for method, preset in (("map-elites", "tuned"), ("map-elites", "paper"), ("ea", "tuned")):
        result = evolve(jax.random.key(0), (6, 6), method=method, preset=preset, evaluations=2000, progress=False)
        digest.update(np.asarray(result.elites.grids).tobytes())
    return digest.hexdigest()[:8]


def _is_bar(output: NotebookNode) -> bool:
    """Whether an output is a progress bar, or the end of its line."""
    return output.get("name") == "stderr" and ("\r" in output.text or not output.text.strip())


def _smaller(png: str) -> str:
    """A picture in 256 colours: photographs take a third of the place, and look the same at this size."""
    picture, small = Image.open(io.BytesIO(base64.b64decode(png))).convert("RGB"), io.BytesIO()
    picture.quantize(256, dither=Image.Dither.NONE).save(small, "PNG", optimize=True)
    return base64.b64encode(small.getvalue()).decode()


if __name__ == "__main__":
    main(sys.argv[1:])

"""Executes notebooks in full and writes them with their outputs, without anything that differs between machines.

python notebooks/execute.py                      # all of them; needs the extras [dev,experiments,interop,sumo]
python notebooks/execute.py 02_fitness_kernel    # some, by their names
"""

import base64
import hashlib
import io
import os
import sys
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory

import jax
import nbformat
import numpy as np
from nbclient import NotebookClient
from nbformat import NotebookNode
from PIL import Image
from traitlets.config import Config

from elitelanes_jax import road_problem, run
from elitelanes_jax.optimizers import PRESETS, make_optimizer, seed_keys

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
                # Pictures of Pillow come as PNG and again as JPEG.
                pictures.pop("image/jpeg", None)
                if "image/png" in pictures:
                    pictures["image/png"] = _smaller(pictures["image/png"])
        nbformat.write(normalised(notebook), file)
        print(f"{file.name}: {file.stat().st_size // 1000} kB")


def execute(file: Path, folder: Path, *, quick: bool = False) -> NotebookNode:
    """Runs all cells of a notebook in a fresh process, and returns it with their outputs.

    Args:
      file: of the notebook, which is not changed.
      folder: for the files that the notebook writes.
      quick: whether to take few steps.

    Raises:
      CellExecutionError: if a cell fails.
    """
    notebook = nbformat.read(file, as_version=4)
    # Sockets in the folder: another kernel that starts at the same time might take a port.
    own = Config(KernelManager={"transport": "ipc", "ip": str(folder / "kernel")})
    client = NotebookClient(notebook, timeout=600, kernel_name="python3", record_timing=False, config=own)
    environment = {**os.environ, "PYDEVD_DISABLE_FILE_VALIDATION": "1"}  # no warning about a debugger
    environment.pop("ELITELANES_QUICK", None)
    client.resources["metadata"] = {"path": str(folder)}
    return client.execute(env=environment | ({"ELITELANES_QUICK": "1"} if quick else {}))


def normalised(notebook: NotebookNode) -> NotebookNode:
    """Returns the notebook without lines of progress and without metadata of a machine, as the repository keeps it.

    The id of a cell is a digest of its source and of all sources before it. So tests see a changed source that was not
    executed. They see changed searches by the digest of what these find.
    """
    digest = hashlib.sha256()
    for cell in notebook.cells:
        digest.update(f"{cell.cell_type}\n{cell.source}\n".encode())
        cell.id, cell.metadata = digest.hexdigest()[:8], NotebookNode()
        if cell.cell_type == "code":
            cell.outputs = [output for output in cell.outputs if not _is_progress(output)]
    notebook.metadata = nbformat.from_dict(_METADATA | {"searches": _searches()})
    notebook.nbformat, notebook.nbformat_minor = 4, 5
    return notebook


@cache
def _searches() -> str:
    """Returns a digest of the grids that small searches find; when it changes, so may the outputs of notebooks."""
    digest = hashlib.sha256()
    keys = seed_keys(0, 1)
    for method in ("map-elites", "ea"):
        optimizer = make_optimizer(road_problem((6, 6)), PRESETS[method, "tuned"])
        # Results do not depend on how well a program is compiled.
        search = jax.jit(
            partial(run, optimizer, generations=60), compiler_options={"xla_backend_optimization_level": 0}
        )
        states, _ = search(keys)
        digest.update(np.asarray(jax.vmap(optimizer.elites)(states).grids).tobytes())
    return digest.hexdigest()[:8]


def _is_progress(output: NotebookNode) -> bool:
    """Whether an output is a line of progress, or its end."""
    return output.get("name") == "stderr" and ("\r" in output.text or not output.text.strip())


def _smaller(png: str) -> str:
    """Reduces a picture to 256 colours: photographs take a third of the space, and look the same at this size."""
    picture, small = Image.open(io.BytesIO(base64.b64decode(png))).convert("RGB"), io.BytesIO()
    picture.quantize(256, dither=Image.Dither.NONE).save(small, "PNG", optimize=True)
    return base64.b64encode(small.getvalue()).decode()


if __name__ == "__main__":
    main(sys.argv[1:])

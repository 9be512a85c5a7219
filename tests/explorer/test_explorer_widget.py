"""The widget: what it shows, what comes back from its drawing, and the whole of it in JupyterLab."""

import json
import os
import shutil
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from explored import big_result

from elitelanes_jax._util.errors import InputError
from elitelanes_jax.explorer.widget import continue_search, show
from elitelanes_jax.formats.road_map import RoadMap

pytest.importorskip("anywidget")

HERE = Path(__file__).parent
PACKAGES = HERE.parents[1] / "explorer" / "node_modules"
CHROMIUM = os.environ.get("CHROMIUM", "/usr/bin/chromium")
LOOP = np.array([[6, 3], [12, 9]], np.int8)

CELLS = [
    "from elitelanes_jax import evolve\n"
    "from elitelanes_jax.explorer import show\n"
    'search = dict(method="ea", preset="paper", generations=5)\n'
    "explorer = show(evolve(0, (5, 6), seeds=2, progress=False, **search))\n"
    "explorer",
    "print(explorer.grid.dtype, explorer.grid.tolist())",
    "print(explorer.result.spec.initial)",
]


def test_a_drawing_comes_back_as_a_grid_and_continues_the_search():
    result = big_result()
    asked = []

    def continued(grid, before):
        asked.append((grid, before))
        return result

    explorer = show(result, on_continue=continued)
    assert explorer.continues and explorer.grid is None and len(explorer.blob) > 100_000
    explorer.set_state({"grid": LOOP.tolist()})
    assert explorer.grid.dtype == np.int8
    np.testing.assert_array_equal(explorer.grid, LOOP)
    explorer._handle_custom_msg({"continue": LOOP.tolist()}, [])
    np.testing.assert_array_equal(asked[0][0], LOOP)
    assert asked[0][1] is result
    with pytest.raises(InputError, match="grid: expected 12 x 12, as the search's, got 2 x 2"):
        continue_search(LOOP, result)


def test_maps_and_paths_are_shown_and_other_things_refused(tmp_path):
    explorer = show([RoadMap(LOOP), RoadMap(LOOP)])
    assert not explorer.continues and explorer.values["runs"][0]["labels"] == ("map 0", "map 1")
    with pytest.raises(InputError, match="what: expected a Result, maps, or paths of runs and maps, got int"):
        show(3)
    with pytest.raises(InputError, match="nowhere"):
        show(tmp_path / "nowhere")


def free_port():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


@pytest.mark.skipif(
    not (PACKAGES / "playwright-core").is_dir() or not Path(CHROMIUM).exists() or shutil.which("node") is None,
    reason="the browser's tests need make explorer and chromium",
)
def test_the_widget_in_jupyterlab(tmp_path):
    pytest.importorskip("jupyterlab")
    import nbformat

    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in CELLS])
    notebook.metadata.kernelspec = {"name": "python3", "display_name": "Python 3", "language": "python"}
    nbformat.write(notebook, tmp_path / "explorer.ipynb")
    port = free_port()
    command = [sys.executable, "-m", "jupyterlab", f"--port={port}", "--ServerApp.port_retries=0", "--no-browser"]
    command += ["--allow-root", "--ServerApp.token=", "--ServerApp.password=", f"--ServerApp.root_dir={tmp_path}"]
    home = {name: str(tmp_path / name.lower()) for name in ("JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "IPYTHONDIR")}
    paths = os.pathsep.join([str(HERE.parents[1]), os.environ.get("PYTHONPATH", "")])
    with (tmp_path / "server.log").open("w") as log:
        server = subprocess.Popen(
            command, env=os.environ | home | {"PYTHONPATH": paths}, stdout=log, stderr=log, cwd=tmp_path
        )
    try:
        for _ in range(300):
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", port)) == 0:
                    break
            time.sleep(0.2)
        address = f"http://127.0.0.1:{port}/lab/tree/explorer.ipynb?reset"
        browser = ["node", HERE / "jupyter.mjs", address, os.environ.get("SHOT", "")]
        ran = subprocess.run(browser, capture_output=True, text=True, check=False, timeout=400)
    finally:
        server.terminate()
        server.wait(20)
    assert ran.returncode == 0, ran.stderr
    seen = json.loads(ran.stdout)
    assert seen["errors"] == []
    assert seen["map"].startswith("niche ")
    drawn = [[0, 0, 0, 0, 0, 0], [0, 4, 5, 1, 0, 0], *[[0] * 6] * 3]
    assert seen["grid"] == f"int8 {drawn}"
    assert seen["result"] == str((tuple(map(tuple, drawn)),))

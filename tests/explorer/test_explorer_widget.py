"""The widget: what it shows, what comes back from its drawing, and the whole of it in JupyterLab and marimo."""

import json
import os
import re
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from explored import IN_BROWSER
from refusals import refused

from elitelanes_jax import RoadMap
from elitelanes_jax.explorer import show
from elitelanes_jax.explorer.page import static_text
from elitelanes_jax.formats import MapObject
from elitelanes_jax.formats.objects import object_values

pytest.importorskip("anywidget")

HERE = Path(__file__).parent
LOOP = np.array([[6, 3], [12, 9]], np.int8)

CELLS = [
    "from elitelanes_jax import evolve\n"
    "from elitelanes_jax.explorer import show\n"
    'search = dict(method="ea", preset="paper", generations=5)\n'
    "explorer = show(evolve(0, (5, 6), seeds=2, progress=False, **search))\n"
    "explorer",
    "print(explorer.grid.dtype, explorer.grid.tolist())",
]


MARIMO = """
import marimo

app = marimo.App()


@app.cell
def _():
    import marimo as mo
    from elitelanes_jax.search.evolution import evolve
    from elitelanes_jax.explorer._widget import show

    search = dict(method="ea", preset="paper", generations=5)
    explorer = mo.ui.anywidget(show(evolve(0, (5, 6), seeds=2, progress=False, **search)))
    explorer
    return explorer, mo


@app.cell
def _(explorer, mo):
    mo.plain_text("not drawn" if explorer.grid is None else f"drawn {explorer.grid.dtype} {explorer.grid.tolist()}")
    return


if __name__ == "__main__":
    app.run()
"""


def test_a_drawing_comes_back_as_a_grid_with_objects():
    explorer = show([RoadMap(LOOP), RoadMap(LOOP)])
    assert explorer.values["runs"][0]["labels"] == ("map 0", "map 1") and explorer.grid is None and explorer.blob
    duckie = MapObject("duckie", 1.0, 1.5, 0.0, 0.08, static=False)
    explorer.set_state({"grid": LOOP.tolist(), "objects": [object_values(duckie)]})
    assert explorer.grid.dtype == np.int8
    np.testing.assert_array_equal(explorer.grid, LOOP)
    assert explorer.objects == (duckie,)


def test_other_things_than_results_maps_and_paths_are_refused(tmp_path):
    with refused("what", "int"):
        show(3)
    with refused(tmp_path / "nowhere", "no such file or directory"):
        show(tmp_path / "nowhere")


def free_port():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def seen_in(program, address, folder, command):
    """What a program for Node saw at the address of a notebook's server, which runs meanwhile."""
    port = free_port()
    home = {name: str(folder / name.lower()) for name in ("JUPYTER_CONFIG_DIR", "JUPYTER_DATA_DIR", "IPYTHONDIR")}
    paths = os.pathsep.join([str(HERE.parents[1]), os.environ.get("PYTHONPATH", "")])
    with (folder / "server.log").open("w") as log:
        env = os.environ | home | {"PYTHONPATH": paths}
        server = subprocess.Popen([*command, f"--port={port}"], env=env, stdout=log, stderr=log, cwd=folder)
    try:
        for _ in range(300):
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", port)) == 0:
                    break
            time.sleep(0.2)
        browser = ["node", HERE / program, f"http://127.0.0.1:{port}{address}", os.environ.get("SHOT", "")]
        ran = subprocess.run(browser, capture_output=True, text=True, check=False, timeout=400)
    finally:
        server.terminate()
        server.wait(20)
    assert ran.returncode == 0, ran.stderr
    return json.loads(ran.stdout)


DRAWN = [[0, 0, 0, 0, 0, 0], [0, 4, 5, 1, 0, 0], *[[0] * 6] * 3]


@IN_BROWSER
def test_the_widget_in_jupyterlab(tmp_path):
    pytest.importorskip("jupyterlab")
    import nbformat

    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in CELLS])
    notebook.metadata.kernelspec = {"name": "python3", "display_name": "Python 3", "language": "python"}
    nbformat.write(notebook, tmp_path / "explorer.ipynb")
    slow = tmp_path / "ipythondir" / "profile_default" / "startup" / "slow.py"
    slow.parent.mkdir(parents=True)
    slow.write_text("import time; time.sleep(12)")  # a kernel that is not ready when the notebook is there
    command = [sys.executable, "-m", "jupyterlab", "--ServerApp.port_retries=0", "--no-browser", "--allow-root"]
    command += [
        "--expose-app-in-browser",
        "--ServerApp.token=",
        "--ServerApp.password=",
        f"--ServerApp.root_dir={tmp_path}",
    ]
    seen = seen_in("jupyter.mjs", "/lab/tree/explorer.ipynb?reset", tmp_path, command)
    assert seen["errors"] == []
    assert seen["map"].startswith("niche ")
    assert seen["grid"] == f"int8 {DRAWN}"


@IN_BROWSER
@pytest.mark.slow
@pytest.mark.parametrize("command", ["run", "edit"])
def test_the_widget_in_marimo(tmp_path, command):
    pytest.importorskip("marimo")
    (tmp_path / "explored.py").write_text(MARIMO)
    marimo = [sys.executable, "-m", "marimo", "--quiet", command, "explored.py", "--headless", "--no-token"]
    seen = seen_in("marimo.mjs", "", tmp_path, marimo)
    assert seen["errors"] == []
    assert seen["map"].startswith("niche ")
    assert seen["theme"] == ["elx light", "elx dark"]
    assert seen["grid"] == f"drawn int8 {DRAWN}"
    assert seen["heading"] == "700"


def test_the_module_keeps_to_anywidget_s_contract():
    """VS Code, marimo and JupyterLab give a module a model and an element; its styles stay within that element."""
    module, style = static_text("explorer.js"), static_text("explorer.css")
    assert re.search(r"export\{\w+ as default,\w+ as kernel\};?\s*$", module)
    words = ("require(", "import(", "requirejs", "Jupyter", "@jupyter", "acquireVsCodeApi", "eval(", "new Function")
    assert not [word for word in (*words, "fetch(") if word in module]
    own = (".elx", "#elitelanes-explorer")
    own += ("html:has(>body>#elitelanes-explorer)", "body:has(>#elitelanes-explorer)")
    for selectors in re.findall(r"(?:^|[{}])([^{}@]+)\{", style):
        for selector in re.split(r",(?![^(]*\))", selectors):
            assert selector.strip().startswith(own), selector

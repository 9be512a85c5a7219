"""gym-duckietown from our side: starts the bridge in its environment, and asks it."""

import subprocess
import tempfile
import tomllib
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from elitelanes_jax import InputError, SearchSpec, evolve
from elitelanes_jax.drive import random_pose
from elitelanes_jax.formats import read_map
from elitelanes_jax.maps import export
from elitelanes_jax.optimizers import seed_keys
from experiments.common import Untyped
from experiments.perception.gym_duckietown.bridge import receive, send

__all__ = ["HERE", "PYTHON", "DuckietownMap", "World", "data_folder", "our_towns", "random_poses", "read_maps"]

HERE = Path(__file__).parent
PYTHON = HERE.parents[2] / ".venv-gym-duckietown" / "bin" / "python"
"""The interpreter that `make gym-duckietown` installs."""


class DuckietownMap(NamedTuple):
    """A map for both sides.

    Attributes:
      name: its name in tables.
      text: of its file, for gym-duckietown.
      codes: int8 ``[H, W]``, for us.
    """

    name: str
    text: str
    codes: NDArray[np.int8]


class World:
    """A running bridge; use it in a `with` block. The methods of the bridge's `World` are asked by `ask`."""

    def __init__(self, python: Path = PYTHON, *, rows: int = 480, columns: int = 640) -> None:
        if not python.exists():
            raise InputError(python, "the environment of make gym-duckietown", "no file")
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115, closed with the process
        command = [str(python), str(HERE / "bridge.py"), str(rows), str(columns)]
        pipe = subprocess.PIPE
        self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=self._errors)

    def __enter__(self) -> "World":
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate()
        self._errors.close()

    def ask(self, what: str, **values: object) -> dict[str, Untyped]:
        """Asks the bridge to do something.

        Raises:
          InputError: one line, if gym-duckietown cannot do it.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            send(self._process.stdin, do=what, **values)
            answer = receive(self._process.stdout)
        except BrokenPipeError:
            answer = None
        if answer is None:
            self._errors.seek(0)
            last = self._errors.read().decode(errors="replace").strip().splitlines()[-1:]
            raise InputError("gym-duckietown", "an answer", f"the end of the program: {' '.join(last)}")
        if "error" in answer:
            raise InputError("gym-duckietown", f"to {what}", answer["error"])
        return answer

    def load(self, place: DuckietownMap, **options: object) -> dict[str, Untyped]:
        """Loads a map; errors name it."""
        try:
            return self.ask("load", text=place.text, **options)
        except InputError as error:
            raise error.within(place.name) from None


def data_folder() -> Path:
    """Returns the folder of duckietown-world's maps and textures in the environment.

    Raises:
      InputError: if there is none.
    """
    folders = list(PYTHON.parents[1].glob("lib*/python3*/site-packages/duckietown_world/data/gd1"))
    if not folders:
        raise InputError(PYTHON, "an environment with duckietown-world's maps", "none")
    return folders[0]


def read_maps(part: str, only: str | None = None) -> list[DuckietownMap]:
    """Reads the maps of a part of maps.toml, "development" or "test": people's from the environment, then our towns.

    `only` is "people" or "towns". The search for our towns takes a minute.
    """
    listed = tomllib.loads((HERE / "maps.toml").read_text(encoding="utf-8"))[part]
    files = [data_folder() / "maps" / f"{name}.yaml" for name in listed["people"]]
    found = [DuckietownMap(file.stem, file.read_text(encoding="utf-8"), read_map(file).codes) for file in files]
    ours = our_towns(**listed["towns"]) if only != "people" else []
    towns = []
    for index, codes in enumerate(ours):
        text = export(codes, "duckietown")["map.yaml"].decode()
        towns.append(DuckietownMap(f"town {index}", text, codes))
    return (found if only != "towns" else []) + towns


def our_towns(size: int, count: int, seed: int, evaluations: int = 50_000) -> list[NDArray[np.int8]]:
    """Evolves different maps, as ``generate --style town --where crossings=0..`` does."""
    spec = SearchSpec(style="town", where="crossings=0..", evaluations=evaluations)
    found = evolve(seed_keys(seed, max(2, count // 4)), (size, size), spec=spec, progress=False)
    return [road_map.codes for road_map in found.choose(count, seed).maps]


def random_poses(codes: NDArray[np.int8], count: int, seed: int) -> Float[NDArray, "N 3"]:
    """Draws poses on the lanes of a map, as ``dataset --camera`` does by default."""
    poses = jax.vmap(partial(random_pose, grid=codes))(jax.random.split(jax.random.key(seed), count))
    return np.stack(poses, axis=1).astype(float)

"""Road networks as problems of the PCG Benchmark (Khalifa et al., 2025).

The package of the PCG Benchmark is imported when the problems are registered.
"""

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
from jaxtyping import UInt8
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.packages import import_optional
from elitelanes_jax._util.types import AnyArray, Untyped
from elitelanes_jax.benchmark.measuring import count_flaws
from elitelanes_jax.benchmark.tasks import find_task
from elitelanes_jax.network.checks import known_grid
from elitelanes_jax.network.codes import EAST, NORTH, SOUTH, WEST
from elitelanes_jax.network.plain_metrics import cut_to_roads, plain_measure
from elitelanes_jax.network.records import Metrics
from elitelanes_jax.network.symmetry import images_of

VARIANTS = {"roads-v0": "7x7B", "roads-filled-v0": "7x7A", "roads-large-v0": "12x12A"}
"""The names of the problems, and the sizes of the benchmark that they have."""

DIVERSITY = 0.4
"""The share of the cells by which two networks differ if they count as different."""

# The side of a tile in a picture, in pixels.
_PIXELS = 16
_GRASS, _ASPHALT = (96, 128, 72), (64, 64, 64)

_Info = Mapping[str, Any]
"""What is known of a network: its metrics by name, ``flaws``, and its eight ``images``."""


@name_wrong_arguments
def register_pcg_problems() -> list[str]:
    """Registers road networks as problems of the package ``pcg_benchmark``; returns their names.

    Content is a grid of tile codes. `pcg_benchmark.make` then makes the problems by name.

    - Quality is 1 / (1 + flaws), see `Measured.flaws`. A flawless network passes.
    - Diversity compares two networks at the same place, in the rotation or reflection that is most
      alike. They pass if `DIVERSITY` of the cells differ.
    - The control is a cyclomatic number for which a flawless network exists, which is proven. A
      network passes if it has this number.

    Raises:
      InputError: without pcg_benchmark.
    """
    repository = "git+https://github.com/amidos2006/pcg_benchmark"
    benchmark = import_optional(
        "pcg_benchmark", "problems of the PCG Benchmark need pcg_benchmark", repository
    )
    # A second call registers nothing.
    for name in VARIANTS.keys() - set(benchmark.list()):
        benchmark.register(name, _problem_class(), {"size": VARIANTS[name]})
    return list(VARIANTS)


@cache
def _problem_class() -> type:
    """Makes the class that the PCG Benchmark expects.

    It is a subclass of the PCG Benchmark's `Problem`, with its spaces.
    """
    from pcg_benchmark.probs import Problem
    from pcg_benchmark.spaces import ArraySpace, DictionarySpace, IntegerSpace

    class RoadProblem(RoadNetworks, Problem):
        def __init__(self, **options: str) -> None:
            Problem.__init__(self)
            RoadNetworks.__init__(self, options["size"])
            low, high = self.cyclomatic
            self._content_space = ArraySpace(self.shape, IntegerSpace(16))
            self._control_space = DictionarySpace({"cyclomatic": IntegerSpace(low, high + 1)})

    return RoadProblem


class RoadNetworks:
    """The evaluation of road networks in the PCG Benchmark.

    The methods have the names that the PCG Benchmark expects; see `register_pcg_problems`.

    Args:
      size: a size of the benchmark, such as ``7x7B``.
    """

    def __init__(self, size: str) -> None:
        task = find_task(f"{size}-10000")
        self.shape, self.fill = task.shape, task.fill
        self.cyclomatic = int(task.cyclomatic.min()), int(task.cyclomatic.max())

    def info(self, content: AnyArray) -> _Info:
        """Measures a network: rows of tile codes ``[H, W]``.

        Raises `InputError` for other codes than 0 to 15, or another shape.
        """
        codes = known_grid(content)
        if codes.shape != self.shape:
            height, width = self.shape
            raise InputError("content", f"{height} x {width} tile codes", list(codes.shape))
        metrics = Metrics(**plain_measure(codes))
        cut = cut_to_roads(codes)
        side = max(codes.shape)
        # An image of a network that is not square has its rows and columns swapped. Squares can be
        # compared.
        images = [
            np.pad(image, [(0, side - length) for length in image.shape])
            for image in images_of(cut)
        ]
        return metrics._asdict() | {
            "flaws": int(count_flaws(metrics, self.fill)),
            "images": np.stack(images),
        }

    def quality(self, info: _Info) -> float:
        """Returns 1 for a flawless network, and less the more flaws there are."""
        return 1 / (1 + info["flaws"])

    def diversity(self, info1: _Info, info2: _Info) -> float:
        """Returns how much two networks differ, at most 1."""
        # The first image is the network itself.
        differing = (info1["images"] != info2["images"][0]).sum(axis=(1, 2)).min()
        return min(float(differing) / (DIVERSITY * self.shape[0] * self.shape[1]), 1.0)

    def controlability(self, info: _Info, control: Mapping[str, int]) -> float:
        """Returns how close a network comes to the wanted cyclomatic number.

        The result is 1 for this number, and less the farther the network's number is from it.
        """
        low, high = self.cyclomatic
        return max(1 - abs(info["cyclomatic"] - int(control["cyclomatic"])) / (high - low + 1), 0.0)

    def render(self, content: AnyArray) -> Untyped:
        """Draws a network as a `PIL.Image`, with dead ends and mismatches as they are."""
        from PIL import Image

        return Image.fromarray(draw_roads(np.asarray(content, np.int8)))


def draw_roads(codes: NDArray[np.int8]) -> UInt8[np.ndarray, "h w 3"]:
    """Draws any codes ``[H, W]`` as roads, 16 pixels a tile.

    The roads lead from the middle of each tile to its open sides.
    """
    # An arm is the middle third of the tile, from one side to the end of the middle square.
    third = slice(_PIXELS // 3, -(_PIXELS // 3))
    first, last = slice(_PIXELS - _PIXELS // 3), slice(_PIXELS // 3, None)
    arms = {NORTH: (first, third), EAST: (third, last), SOUTH: (last, third), WEST: (third, first)}
    road = np.zeros((*codes.shape, _PIXELS, _PIXELS), bool)
    for side, (rows, columns) in arms.items():
        road[..., rows, columns] |= (codes & side > 0)[..., None, None]
    height, width = codes.shape
    picture = road.swapaxes(1, 2).reshape(height * _PIXELS, width * _PIXELS)
    return np.where(picture[..., None], _ASPHALT, _GRASS).astype(np.uint8)

"""Road networks as problems of the PCG Benchmark (Khalifa et al., 2025).

The package of the PCG Benchmark is imported when the problems are registered.
"""

from collections.abc import Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Int8, UInt8
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.cells import describe_cell
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.packages import import_optional
from elitelanes_jax._util.types import ArrayOrRows, Untyped
from elitelanes_jax.benchmark.measuring import count_flaws
from elitelanes_jax.benchmark.tasks import find_task
from elitelanes_jax.network.checks import known_grid
from elitelanes_jax.network.codes import EAST, NORTH, SOUTH, WEST
from elitelanes_jax.network.plain_metrics import cut_to_roads, plain_measure
from elitelanes_jax.network.records import Metrics
from elitelanes_jax.network.symmetry import images_of


class Variant(NamedTuple):
    """A problem of the PCG Benchmark.

    Attributes:
      size: a size of the benchmark, such as ``7x7B``; in A every cell is filled.
      has_links: whether content is links; otherwise it is tile codes.
    """

    size: str
    has_links: bool = False


VARIANTS = {
    "roads-links-5x5-v0": Variant("5x5B", has_links=True),
    "roads-links-6x6-v0": Variant("6x6B", has_links=True),
    "roads-links-7x7-v0": Variant("7x7B", has_links=True),
    "roads-filled-links-5x5-v0": Variant("5x5A", has_links=True),
    "roads-filled-links-6x6-v0": Variant("6x6A", has_links=True),
    "roads-filled-links-7x7-v0": Variant("7x7A", has_links=True),
    "roads-v0": Variant("7x7B"),
    "roads-filled-v0": Variant("7x7A"),
    "roads-large-v0": Variant("12x12A"),
}
"""The problems by name, from the easiest to the hardest of each kind."""

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

    `pcg_benchmark.make` then makes the problems by name. Content is rows of whole numbers: of tile
    codes, 0 to 15, or of links, see `read_links`.

    - Quality is 1 / (1 + flaws per cell), see `Measured.flaws`, and 0 without roads. A flawless
      network passes.
    - Diversity compares two networks after both are moved to the north-west corner, in the rotation
      or reflection that is most alike. They pass if `DIVERSITY` of the cells differ.
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
        benchmark.register(name, _problem_class(), VARIANTS[name]._asdict())
    return list(VARIANTS)


@cache
def _problem_class() -> type:
    """Makes the class that the PCG Benchmark expects.

    It is a subclass of the PCG Benchmark's `Problem`, with its spaces.
    """
    from pcg_benchmark.probs import Problem
    from pcg_benchmark.spaces import ArraySpace, DictionarySpace, IntegerSpace

    class RoadProblem(RoadNetworks, Problem):
        def __init__(self, **options: Any) -> None:
            Problem.__init__(self)
            RoadNetworks.__init__(self, Variant(**options))
            low, high = self.cyclomatic
            self._content_space = ArraySpace(self.shape, IntegerSpace(4 if self.has_links else 16))
            self._control_space = DictionarySpace({"cyclomatic": IntegerSpace(low, high + 1)})

    return RoadProblem


class RoadNetworks:
    """The evaluation of road networks in the PCG Benchmark.

    The methods have the names that the PCG Benchmark expects; see `register_pcg_problems`.

    Args:
      variant: one of `VARIANTS`.
    """

    def __init__(self, variant: Variant) -> None:
        task = find_task(f"{variant.size}-10000")
        self.shape, self.fill, self.has_links = task.shape, task.fill, variant.has_links
        self.cyclomatic = int(task.cyclomatic.min()), int(task.cyclomatic.max())

    def info(self, content: ArrayOrRows) -> _Info:
        """Returns what is known of a network: rows of tile codes or links ``[H, W]``.

        Raises `InputError` for other numbers than 0 to 15 or 0 to 3, or another shape.
        """
        codes = self.read(content)
        cut = cut_to_roads(codes)
        side = max(codes.shape)
        # An image of a network that is not square has its rows and columns swapped. Squares can be
        # compared.
        images = np.zeros((8, side, side), np.int8)
        for square, image in zip(images, images_of(cut), strict=True):
            height, width = image.shape
            square[:height, :width] = image
        return {**self.measure(codes), "images": images}

    def measure(self, codes: Int8[np.ndarray, "H W"]) -> dict[str, int]:
        """Returns the metrics of tile codes ``[H, W]`` by name, and their number of ``flaws``."""
        metrics = Metrics(**plain_measure(codes))
        return {**metrics._asdict(), "flaws": int(count_flaws(metrics, self.fill))}

    def read(self, content: ArrayOrRows) -> Int8[np.ndarray, "H W"]:
        """Returns the tile codes ``[H, W]`` of content; raises `InputError` as `info` does."""
        grid = known_grid(content)
        if grid.shape != self.shape:
            height, width = self.shape
            kind = "links" if self.has_links else "tile codes"
            raise InputError("content", f"{height} x {width} {kind}", list(grid.shape))
        return read_links(grid) if self.has_links else grid

    def quality(self, info: _Info) -> float:
        """Returns 1 for a flawless network, and less the more flaws there are per cell.

        Content without roads has quality 0.
        """
        # Its one flaw is the missing component, so that searches would remove all roads.
        if info["components"] == 0:
            return 0.0
        height, width = self.shape
        return 1 / (1 + info["flaws"] / (height * width))

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

    def render(self, content: ArrayOrRows) -> Untyped:
        """Draws a network as a `PIL.Image`, with dead ends and mismatches as they are."""
        from PIL import Image

        return Image.fromarray(draw_roads(self.read(content)))


def read_links(links: Int8[np.ndarray, "H W"]) -> Int8[np.ndarray, "H W"]:
    """Returns the tile codes of the network that links describe.

    Links that lead beyond the grid are ignored. A tile code then agrees with its neighbours, so
    that these networks have no mismatch and no boundary violation.

    Args:
      links: of each cell: 2 if a road leads to the cell on the right, plus 1 if a road leads to the
        cell below.

    Raises:
      InputError: for other numbers than 0 to 3.
    """
    if links.min() < 0 or links.max() > 3:
        row, column = np.argwhere((links < 0) | (links > 3))[0]
        got = f"{links[row, column]} at {describe_cell(row, column)}"
        raise InputError("content", "links 0 to 3", got)
    right, down = links >> 1, links & 1
    codes = np.zeros_like(links)
    codes[:, :-1] |= EAST * right[:, :-1]
    codes[:, 1:] |= WEST * right[:, :-1]
    codes[:-1] |= SOUTH * down[:-1]
    codes[1:] |= NORTH * down[:-1]
    return codes


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

"""Cuts tiles out of photographs, each a square picture seen from above."""

from collections.abc import Iterable, Sequence
from itertools import count
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, check_unique, path
from elitelanes_jax._util.copies import keeps_copies
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.files import write_atomic
from elitelanes_jax.network.checks import check_grid
from elitelanes_jax.network.codes import CONNECTIONS, KIND_OF, KINDS
from elitelanes_jax.network.plain_metrics import road_box
from elitelanes_jax.photographs._judging import SURE
from elitelanes_jax.photographs._repeats import turns_to_first
from elitelanes_jax.photographs._views import flatten, places_of
from elitelanes_jax.photographs.proposals import Proposal
from elitelanes_jax.photographs.reading import Photograph
from elitelanes_jax.tiles.files import Tile, check_picture
from elitelanes_jax.tiles.light import ground_of
from elitelanes_jax.tiles.masking import MaskedTile, propose_masks
from elitelanes_jax.tiles.rendering import write_png
from elitelanes_jax.tiles.sides import measure_lanes
from elitelanes_jax.tiles.strips import without_strips
from elitelanes_jax.tiles.tileset import MASKS

# The least and the largest side of a cut picture in pixels. Between them, the side is that in the
# photograph.
_SIZES = (128, 512)
# The side of a tile, in pixels, at which pictures are compared.
_COMPARED_PX = 96
# The least number of pixels of bare ground by which pictures are compared.
_LEAST_COMPARED = 100
# The correlation of the ground above which two pictures show the same tile.
_COPY = 0.2


@keeps_copies
class Cut(NamedTuple):
    """A tile cut out of a photograph. It has a read-only copy of its image.

    Attributes:
      name: the name of its folder in a tile set, ``<kind>_<number>``.
      code: the sides that it opens, as a tile code.
      image: uint8 ``[S, S, 3]``, RGB.
      photo: the name of the photograph.
      row: the row of the tile in the photograph, from 0.
      column: the column of the tile in the photograph, from 0.
      copy_of: the name of an earlier tile that looks nearly the same, empty if there is none.
    """

    name: str
    code: int
    image: NDArray[np.uint8]
    photo: str
    row: int
    column: int
    copy_of: str = ""


@name_wrong_arguments
def cut_tiles(photograph: Photograph, proposal: Proposal, earlier: Sequence[Cut] = ()) -> list[Cut]:
    """Cuts the tiles of a proposal whose kind is sure.

    Args:
      photograph: the photograph that the proposal was made for.
      proposal: the proposal, which says where the tiles are. Its score is not checked.
      earlier: tiles of other photographs. Their names are not used again.

    Returns:
      The new tiles, by row and column.

    Raises:
      InputError: for a photograph that is not uint8 ``[H, W, 3]``, or a proposal for a photograph
        of another size.
    """
    check_named("photograph: image", check_picture, photograph.image)
    codes, sure = _read_cells(photograph, proposal)
    rows, columns = road_box(codes)
    middle = np.array([columns.start + columns.stop, rows.start + rows.stop]) / 2
    seen = proposal.view.tile_pixels(middle)
    # The side is a multiple of 32 pixels.
    tile_px = int(np.clip(round(seen / 32) * 32, *_SIZES))
    cuts: list[Cut] = []
    for row, column in np.argwhere((codes > 0) & (sure >= SURE)).tolist():
        # Each pixel is the mean of four samples.
        places = places_of(1, 1, 2 * tile_px, 0) + np.array([column, row])
        large = flatten(photograph.image, proposal.view, places, 2 * tile_px)
        image = np.asarray(
            cv2.resize(large, (tile_px, tile_px), interpolation=cv2.INTER_AREA), np.uint8
        )
        code = int(codes[row, column])
        image = without_strips(image, code)
        of_kind = [cut for cut in (*earlier, *cuts) if KIND_OF[cut.code] == KIND_OF[code]]
        name = _next_name(KIND_OF[code], of_kind)
        original = _find_original(of_kind, code, image)
        cuts.append(Cut(name, code, image, photograph.name, row, column, copy_of=original))
    return cuts


def _read_cells(
    photograph: Photograph, proposal: Proposal
) -> tuple[NDArray[np.int8], NDArray[np.float64]]:
    """Returns the codes of a proposal's cells and how sure they are, ``[H, W]`` each.

    A proposal may come from a page or a file, so its shapes are checked.
    """
    codes = np.asarray(check_named("proposal: codes", check_grid, proposal.codes))
    if np.shape(proposal.homography) != (3, 3):
        raise InputError("proposal: homography", "[3, 3]", list(np.shape(proposal.homography)))
    if np.shape(proposal.sure) != codes.shape:
        expected = f"{list(codes.shape)} like codes"
        raise InputError("proposal: sure", expected, list(np.shape(proposal.sure)))
    # The name is not compared: a file may be renamed, or named from another folder.
    height, width = photograph.image.shape[:2]
    if (proposal.height, proposal.width) != (height, width):
        got = f"one for {proposal.width} x {proposal.height}"
        raise InputError(photograph.name, f"a proposal for {width} x {height} pixels", got)
    return codes, np.array(proposal.sure)


def _next_name(kind: str, of_kind: Sequence[Cut]) -> str:
    """Returns the name of the next tile of a kind."""
    # If the user left out some of the earlier tiles, the next number may be that of another one.
    taken = {cut.name for cut in of_kind}
    names = (f"{kind}_{number}" for number in count(len(of_kind) + 1))
    return next(name for name in names if name not in taken)


def _find_original(of_kind: Sequence[Cut], code: int, image: NDArray[np.uint8]) -> str:
    """Returns the name of the first tile of a kind that looks like an image.

    Copies of other tiles do not count. Returns an empty text if no tile looks like the image.
    """
    for cut in of_kind:
        if not cut.copy_of and likeness(cut, code, image) > _COPY:
            return cut.name
    return ""


def likeness(cut: Cut, code: int, image: NDArray[np.uint8]) -> float:
    """Returns the correlation of the grounds of two tiles of a kind.

    The rotation in which they agree most counts.
    """
    ground, bare = _texture(cut.code, cut.image)
    other, other_bare = _texture(code, image)
    best = 0.0
    # Kinds with symmetries have several rotations that agree with a code.
    for turns in turns_to_first(KINDS[KIND_OF[code]][0]):
        both = bare & np.rot90(other_bare, turns)
        if both.sum() > _LEAST_COMPARED:
            correlation = np.corrcoef(ground[both], np.rot90(other, turns)[both])[0, 1]
            best = max(best, float(correlation))
    return best


def _texture(code: int, image: NDArray[np.uint8]) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Returns the fine brightness of a tile, and where there is no tape near.

    The tile is turned to the first code of its kind.
    """
    turned = np.rot90(image, turns_to_first(code)[0])
    small = np.asarray(
        cv2.resize(turned, (_COMPARED_PX,) * 2, interpolation=cv2.INTER_AREA), np.uint8
    )
    value = np.log(small.max(axis=2).astype(np.float32) + 4)
    # Tape and pixels near it differ between kinds, and not between tiles of a kind.
    tape = value > np.log(ground_of(small, _COMPARED_PX)) + 0.3
    bare = cv2.erode((~tape).astype(np.float32), np.ones((9, 9)), borderValue=0)
    # The local mean of bare ground is its light. What is left is the texture of the asphalt.
    mean = cv2.GaussianBlur(value * bare, (0, 0), 3) / np.maximum(
        cv2.GaussianBlur(bare, (0, 0), 3), 1e-3
    )
    return np.asarray((value - mean) * bare, np.float32), bare > 0


def mask_cut(cut: Cut) -> dict[str, NDArray[np.bool_]]:
    """Proposes the masks of a tile. Stop lines are on crossings alone."""
    masks = propose_masks(cut.image)
    if CONNECTIONS[cut.code] < 3:
        masks["red"] = np.zeros_like(masks["red"])
    return masks


@name_wrong_arguments
def write_cuts(folder: str | Path, cuts: Sequence[Cut]) -> list[MaskedTile]:
    """Writes a tile set: the picture of each tile, proposed masks, and where lanes run.

    Files of the same names are replaced, except tileset.toml.

    Returns:
      What was written of each tile: its `folder`, its `image`, and its `masks` by name.

    Raises:
      InputError: if two tiles have the same name; `cut_tiles` with `earlier` gives them other ones.
      OSError: if a file cannot be written.
    """
    folder, written = Path(check_named("folder", path, folder)), []
    check_unique("cuts", "name", [cut.name for cut in cuts])
    for cut in cuts:
        tile = MaskedTile(folder / cut.name, cut.image, mask_cut(cut), MASKS)
        write_png(tile.folder / "image.png", tile.image)
        tile.write_masks()
        written.append(tile)
    write_lane_offset(folder, map(_tile_of, cuts, written))
    return written


def _tile_of(cut: Cut, tile: MaskedTile) -> Tile:
    road, red, yellow = (tile.masks[name] for name in MASKS)
    return Tile(cut.name, cut.code, cut.image, road, red, yellow)


def write_lane_offset(folder: Path, tiles: Iterable[Tile]) -> None:
    """Writes tileset.toml with the measured offset of the lanes, unless there is such a file.

    An offset that the tiles do not agree on is not written.
    """
    file = folder / "tileset.toml"
    lanes = measure_lanes(tiles)
    if lanes.is_trusted and not file.exists():
        lines = [
            f"# Measured at {lanes.sides} sides of the tiles: the mean, and the standard deviation.",
            f"lane_offset = {lanes.offset:.4f}",
            f"lane_offset_spread = {lanes.spread:.4f}",
        ]
        write_atomic(file, "\n".join([*lines, ""]).encode())

"""Proposes masks by colour for tiles that have only a photograph, to be corrected by hand.

The picture is brought to daylight first, in which the colour of asphalt is known. Tape is found by
its hue, asphalt by its darkness. The road is the largest dark piece, with the tape on it, within
the white tape along its edges.
"""

import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, is_whole, one_of, path
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.network.codes import SIDES
from elitelanes_jax.tiles.contact_sheet import contact_sheet
from elitelanes_jax.tiles.files import Layer, check_picture, read_image, read_mask, size_of
from elitelanes_jax.tiles.light import even_light
from elitelanes_jax.tiles.rendering import write_png
from elitelanes_jax.tiles.tileset import MASKS, edge_pixels, tile_folders

# The least width of tape in tiles. Thinner pieces are no tape, and narrower gaps are wear.
_CLEAN = 1 / 96
# The least width of a bridge between parts of a road, in tiles. What a narrower one joins to the
# road is beyond a worn edge.
_CUT = 1 / 48
# The outermost part of a tile that does not count, in tiles. One of four photographs has a white
# line of 0.0025 along a side that its road leaves by.
_RIM = 0.004
# The width of the floor around a tile that a cut may show, in tiles: a cut is off by less.
_SLIVER = 0.02
# The least part of a tile's area in a piece of tape, a tenth of a line or dash. Smaller pieces are
# specks.
_LEAST = {"red": 0.003, "yellow": 0.0004}
# The largest hue, saturation and value, as OpenCV counts them.
_TOP = (179, 255, 255)
# The side of a tile on the sheet, in pixels.
_SHEET_PX = 240
# The colours of the masks on the sheet, RGB, in the order of painting: lines cover the road.
_SHEET_COLOURS = {"road": (90, 150, 200), "red": (255, 0, 60), "yellow": (255, 225, 0)}


class Colour(NamedTuple):
    """A range of colours, limits included, in OpenCV's units: hues 0 to 179, the others 0 to 255.

    Attributes:
      hue: the first and the last hue; a range beyond 179, such as (170, 10), continues at 0.
      saturation: the least and the greatest saturation.
      value: the least and the greatest brightness.
    """

    hue: tuple[int, int]
    saturation: tuple[int, int]
    value: tuple[int, int]

    def __str__(self) -> str:
        """Returns the text that `parse_colour` reads."""
        return ",".join(f"{low}..{high}" for low, high in self)


COLOURS: Mapping[str, Colour] = {
    "road": Colour((0, 179), (0, 255), (0, 130)),
    "red": Colour((165, 10), (100, 255), (90, 255)),
    "yellow": Colour((18, 38), (70, 255), (130, 255)),
}
"""The ranges of Duckietown's asphalt and tapes, in a picture that was brought to daylight."""


def parse_colour(text: str) -> Colour:
    """Reads a range of colours from text such as ``165..10,100..255,90..255``.

    The three ranges are of hue, saturation and value.

    Raises:
      InputError: for anything else.
    """
    match = re.fullmatch(r"\s*,\s*".join([r"(\d{1,3})\.\.(\d{1,3})"] * 3), text.strip(), re.ASCII)
    limits = [int(number) for number in match.groups()] if match else []
    pairs = list(zip(limits[::2], limits[1::2], strict=True))
    if not _is_colour(pairs):
        raise InputError(
            "",
            (
                "H..H,S..S,V..V with hues 0 to 179, saturations and values 0 to 255, such as "
                f"{COLOURS['red']}"
            ),
            repr(text[:40]),
        )
    return Colour(*pairs)


def _is_colour(ranges: UserValue) -> bool:
    """Returns whether a value is three ranges of whole numbers, of hue, saturation and value."""
    if not isinstance(ranges, tuple | list) or len(ranges) != len(_TOP):
        return False
    for limits, top in zip(ranges, _TOP, strict=True):
        if not isinstance(limits, tuple | list) or len(limits) != 2:
            return False
        if not all(is_whole(limit) and 0 <= limit <= top for limit in limits):
            return False
    # Only a range of hues may wrap around.
    return all(low <= high for low, high in ranges[1:])


@name_wrong_arguments
def propose_masks(
    image: NDArray[np.uint8], colours: Mapping[str, Colour] = COLOURS
) -> dict[str, NDArray[np.bool_]]:
    """Proposes masks for a photograph of a tile.

    Args:
      image: uint8 ``[S, S, 3]``, RGB.
      colours: the ranges of colours of ``road``, ``red`` and ``yellow``, by these names.

    Returns:
      bool ``[S, S]`` for each of these names. Lines are on the road, and do not overlap.

    Raises:
      InputError: for a picture that is not square or not RGB, or without a range for each name.
    """
    image = check_named("image", check_picture, image)
    if image.shape[0] != image.shape[1]:
        raise InputError("image", "a square picture", f"{size_of(image)} pixels")
    is_mapping = isinstance(colours, Mapping)
    if not is_mapping or not all(_is_colour(colours.get(name)) for name in COLOURS):
        expected = f"three ranges, of hue, saturation and value, for {', '.join(COLOURS)}"
        raise InputError("colours", expected, quote(colours))
    size = image.shape[0]
    fine = _disc(size * _CLEAN)
    # In one light, a colour has one range on all photographs. The median removes noise and keeps
    # edges.
    smooth = cv2.medianBlur(even_light(image), 3)
    hsv = np.asarray(cv2.cvtColor(smooth, cv2.COLOR_RGB2HSV), np.uint8)
    lines = {}
    for name in ("red", "yellow"):
        in_range = _in_range(hsv, colours[name])
        lines[name] = _pieces(_clean(in_range, fine, fine), _LEAST[name] * size * size)
    # Where both colours match, the line is red.
    lines["yellow"] &= ~lines["red"]
    tape = lines["red"] | lines["yellow"]
    # Tape is too bright for asphalt. It becomes road here, because it is on the road.
    dark = np.where(tape, np.uint8(255), _in_range(hsv, colours["road"]))
    # The road is the largest piece. A piece that only a narrow bridge joins to it is floor around
    # the tile, and so is a sliver between the tape along a side and the tile's border.
    road = _largest(_without_slivers(_clean(dark, fine, _disc(size * _CUT)), round(size * _SLIVER)))
    return {"road": road, "red": lines["red"] & road, "yellow": lines["yellow"] & road}


def propose_layer_masks(
    image: Layer, colours: Mapping[str, Colour] = COLOURS
) -> dict[str, NDArray[np.bool_]]:
    """Proposes masks as `propose_masks` does, for a picture with transparent pixels.

    The transparent pixels are on no mask.
    """
    # White is neither asphalt nor a line.
    on_white = np.where(image.opaque[..., None], image.pixels, np.uint8(255))
    return {name: mask & image.opaque for name, mask in propose_masks(on_white, colours).items()}


class MaskedTile(NamedTuple):
    """A tile with its masks.

    Attributes:
      folder: the folder of the tile.
      image: uint8 ``[S, S, 3]``, RGB.
      masks: bool ``[S, S]``, by the names in `MASKS`: existing masks of the folder, or proposed
        ones.
      proposed: the names of the proposed masks.
    """

    folder: Path
    image: NDArray[np.uint8]
    masks: dict[str, NDArray[np.bool_]]
    proposed: tuple[str, ...]

    def mask_files(self, names: Sequence[str] = MASKS) -> dict[Path, NDArray[np.uint8]]:
        """Returns masks as pictures of 0 and 255, by the path of each mask's file."""
        return {
            self.folder / f"{name}.png": self.masks[name].astype(np.uint8) * 255 for name in names
        }

    def write_masks(self) -> None:
        """Writes a PNG file of each mask into the folder."""
        for file, picture in self.mask_files().items():
            write_png(file, picture)


@name_wrong_arguments
def mask_folder(
    folder: str | Path, colours: Mapping[str, Colour] = COLOURS, overwrite: Collection[str] = ()
) -> list[MaskedTile]:
    """Proposes the masks that the tiles of a set lack; writes nothing.

    Args:
      folder: the folder of a tile set, as `load_tiles` takes it, in which masks may be missing.
      colours: see `propose_masks`.
      overwrite: names of masks to propose even if they exist.

    Raises:
      InputError: if there are no tiles, for another name in `overwrite`, for a bad file, or for a
        grey picture that needs a mask; the message names it.
    """
    folder = Path(check_named("folder", path, folder))
    for name in overwrite:
        check_named("overwrite", one_of(*MASKS), name)
    problems: list[str] = []
    proposals = []
    folders = tile_folders(folder, problems)
    if not folders and not problems:
        problems.append(f"{folder}: expected folders such as turn_1 with an image.png, got none")
    for tile_folder in folders:
        file = tile_folder / "image.png"
        if not file.is_file():
            problems.append(
                f"{tile_folder}: expected a photograph of the tile, image.png, got none"
            )
            continue
        image = read_image(file, problems)
        if image is None:
            continue
        # Tape is recognised by its hue. A grey picture has no hue, so its masks are made by hand.
        is_grey = (image.pixels[image.opaque] == image.pixels[image.opaque][:, :1]).all()
        if is_grey and _names_to_propose(tile_folder, overwrite):
            problems.append(
                f"{file}: expected a picture in colours, to propose masks, got a grey one"
            )
            continue
        proposals.append(_propose(tile_folder, image, colours, overwrite, problems))
    if problems:
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise InputError("", "", problems[0] + more)
    return proposals


def _propose(
    folder: Path,
    image: Layer,
    colours: Mapping[str, Colour],
    overwrite: Collection[str],
    problems: list[str],
) -> MaskedTile:
    """Proposes the masks that a tile lacks.

    `problems` gets a line for each error of an existing mask.
    """
    proposed = propose_layer_masks(image, colours)
    masks = {}
    for name in MASKS:
        file = folder / f"{name}.png"
        existing = None if name in overwrite else read_mask(file, image, problems)
        masks[name] = (proposed[name] if existing is None else existing.pixels) & image.opaque
    return MaskedTile(folder, image.pixels, masks, _names_to_propose(folder, overwrite))


def _names_to_propose(folder: Path, overwrite: Collection[str]) -> tuple[str, ...]:
    """Returns the names of the masks that a tile lacks, or that are to be replaced."""
    return tuple(
        name for name in MASKS if name in overwrite or not (folder / f"{name}.png").exists()
    )


def proposal_sheet(title: str, proposals: Sequence[MaskedTile]) -> NDArray[np.uint8]:
    """Draws every photograph with its masks to the right, uint8 ``[., ., 3]``, RGB."""
    pictures, captions = [], []
    for proposal in proposals:
        painted = proposal.image.copy()
        for name, colour in _SHEET_COLOURS.items():
            painted[proposal.masks[name]] = colour
        # The photograph and its painted copy are scaled as one picture.
        pair, size = np.hstack([proposal.image, painted]), (2 * _SHEET_PX, _SHEET_PX)
        pictures.append(np.asarray(cv2.resize(pair, size, interpolation=cv2.INTER_AREA), np.uint8))
        shares = ", ".join(
            f"{name} {100 * mask.mean():.1f} %" for name, mask in proposal.masks.items()
        )
        road = proposal.masks["road"]
        reached = (
            ", ".join(side.letter for side in SIDES if edge_pixels(road, side).any()) or "no side"
        )
        proposed = ", ".join(proposal.proposed) or "nothing"
        captions.append(
            (f"{proposal.folder.name}: {shares}", f"road reaches {reached}; proposed: {proposed}")
        )
    return contact_sheet(title, pictures, captions)


def _in_range(hsv: NDArray[np.uint8], colour: Colour) -> NDArray[np.uint8]:
    """Finds a colour in a picture of hue, saturation and value."""
    (first, last), *rest = colour
    # A range that wraps around is two ranges.
    hues = [(first, last)] if first <= last else [(first, _TOP[0]), (0, last)]
    masks = [
        cv2.inRange(
            hsv,
            np.array([low, *(pair[0] for pair in rest)]),
            np.array([high, *(pair[1] for pair in rest)]),
        )
        for low, high in hues
    ]
    return np.asarray(np.bitwise_or.reduce(masks), np.uint8)


def _clean(
    mask: NDArray[np.uint8], close: NDArray[np.uint8], cut: NDArray[np.uint8]
) -> NDArray[np.uint8]:
    """Closes the gaps of a mask, then removes bridges and specks, all narrower than a disc.

    The outermost pixels do not count: they may show a little of what is beyond the tile. Outwards
    from there the mask repeats the pixels next to them, so that a narrow rest of tape at the border
    stays a line.
    """
    # In a picture of two pixels a side, all pixels are outermost, and count.
    rim = max(1, round(len(mask) * _RIM)) if len(mask) > 2 else 0
    around = rim + max(len(close), len(cut))
    inner = slice(rim, len(mask) - rim)
    wide = cv2.copyMakeBorder(
        mask[inner, inner], around, around, around, around, cv2.BORDER_REPLICATE
    )
    closed = cv2.morphologyEx(wide, cv2.MORPH_CLOSE, close)
    opened = cv2.morphologyEx(closed, cv2.MORPH_OPEN, cut)
    beyond = around - rim
    return np.asarray(opened[beyond:-beyond, beyond:-beyond], np.uint8)


def _without_slivers(mask: NDArray[np.uint8], margin: int) -> NDArray[np.uint8]:
    """Removes what the tape along a side separates from the middle of a tile.

    This is a sliver of the floor around the tile, which is dark too.
    """
    kept = mask.copy()
    for turns in range(4):
        side = np.rot90(kept, turns)[: margin + 1]
        # From the margin outwards, all pixels after the first one off the road are off the road.
        side[:] = np.minimum.accumulate(side[::-1], axis=0)[::-1]
    return kept


def _disc(width: float) -> NDArray[np.uint8]:
    odd = 2 * max(1, round(width / 2)) + 1
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (odd, odd)), np.uint8)


def _pieces(mask: NDArray[np.uint8], least: float) -> NDArray[np.bool_]:
    """Keeps the connected pieces of at least `least` pixels."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask)
    large = stats[:, cv2.CC_STAT_AREA] >= least
    # Label 0 is the background.
    large[0] = False
    return np.asarray(large[labels], np.bool_)


def _largest(mask: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Keeps the largest connected piece and fills its holes."""
    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    filled = np.zeros_like(mask)
    if outlines:
        cv2.drawContours(filled, [max(outlines, key=cv2.contourArea)], -1, 255, cv2.FILLED)
    return filled > 0

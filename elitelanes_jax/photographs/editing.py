"""Corrects a tile set by hand.

The corrections are the places of tiles in photographs, the kinds of tiles, and their masks. A page
asks for fits, cuts and masks, and keeps the corrections. `HandWork` computes fits, cuts and masks
as `elitelanes tiles cut` and `elitelanes tiles masks` do, and writes the set. Values of the page
are plain, as in JSON.
"""

import os
import re
import shutil
import zipfile
from base64 import b64decode, b64encode
from collections.abc import Mapping, Sequence
from hashlib import sha256
from io import BytesIO
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Lock
from typing import NamedTuple, TypedDict

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.checks import floor_shape
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.files import free_name, write_atomic
from elitelanes_jax._util.folders import check_renamable, output_folder
from elitelanes_jax._util.types import OptionValue, Plain
from elitelanes_jax.network.codes import KINDS
from elitelanes_jax.photographs.cutting import cut_tiles, mask_cut, write_lane_offset
from elitelanes_jax.photographs.proposals import Proposal, propose_tiles
from elitelanes_jax.photographs.reading import Photograph
from elitelanes_jax.tiles.files import Layer, read_image
from elitelanes_jax.tiles.masking import (
    COLOURS,
    MaskedTile,
    mask_folder,
    parse_colour,
    proposal_sheet,
    propose_layer_masks,
)
from elitelanes_jax.tiles.rendering import png_of, write_png
from elitelanes_jax.tiles.tileset import MASKS, inspect_tiles, tile_folders

# The longest side of a photograph on the page, in pixels.
_SHOWN = 1600
# A save does not copy these sheets, because they show the masks before the corrections.
_SHEETS = ("sheet.png", "masks.png")


class _Picture(NamedTuple):
    """The picture of a tile.

    Attributes:
      layer: the pixels of the picture, on the ground where it is transparent.
      file: the content of the PNG file, which is written unchanged.
    """

    layer: Layer
    file: bytes


class FitRequest(TypedDict):
    """What the page posts to find tiles: a photograph, its shape in tiles, and corners if known."""

    photo: int
    rows: int
    columns: int
    corners: list[list[float]] | None
    exact: bool


class CutRequest(TypedDict):
    """What the page posts to cut tiles: the index of a photograph, and a `Proposal` for it."""

    photo: int
    proposal: dict[str, OptionValue]


class MaskRequest(TypedDict):
    """What the page posts to propose a mask of a tile: the ranges of colours by mask."""

    id: str
    mask: str
    colours: dict[str, list[tuple[float, float]]]


class SentTile(TypedDict):
    """A tile that the page posts. Masks are in bits as `_pack` has them."""

    id: str
    name: str
    kind: str
    masks: dict[str, str]


class HandWork:
    """The tiles and photographs that a page shows, and the folder that it saves to.

    Attributes:
      folder: the folder of the tile set, new or existing.
      photographs: the photographs that tiles are cut from.
      saved: whether the set was written, and the earlier one is kept.
    """

    def __init__(
        self, folder: Path, photographs: Sequence[Photograph], shapes: Sequence[tuple[int, int]]
    ) -> None:
        """Reads the set, if there is one, and finds the tiles in the photographs.

        `shapes` are the rows and columns of tiles in each photograph.

        Raises:
          InputError: for a folder that is neither new nor a tile set, or the current folder.
        """
        self.folder, self.photographs = folder, list(photographs)
        self._pictures: dict[str, _Picture] = {}
        self.saved = False
        # A copy of the set that the first save replaces.
        self._earlier_set: Path | None = None
        self._saving = Lock()
        check_renamable(folder)
        is_new = not folder.exists() or (folder.is_dir() and not any(folder.iterdir()))
        if is_new and not photographs:
            raise InputError(
                folder, "a tile set", "no files", "--photos cuts tiles out of photographs"
            )
        tiles = [] if is_new else mask_folder(folder)
        self._tiles = [
            self._add(tile.folder.name, _read(tile.folder), tile.masks) for tile in tiles
        ]
        self._starts = list(map(self._start, photographs, shapes))
        # The stamp tells each save whether another program has changed the folder.
        self._stamp = _stamp_of(folder)

    def state(self) -> dict[str, Plain]:
        """Returns what the page begins with."""
        colours = {name: [list(pair) for pair in colour] for name, colour in COLOURS.items()}
        problems = inspect_tiles(self.folder, lines=True)[1] if self._tiles else []
        return {
            "folder": str(self.folder),
            "colours": colours,
            "tiles": self._tiles,
            "photographs": self._starts,
            "problems": problems,
        }

    def photograph(self, index: int) -> bytes:
        """Returns a photograph as a JPEG file, as large as the page shows it."""
        image = self.photographs[index].image
        scale = min(1.0, _SHOWN / max(image.shape[:2]))
        small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        return cv2.imencode(".jpg", small[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 90])[1].tobytes()

    def picture(self, identifier: str) -> bytes:
        """Returns the picture of a tile as a PNG file."""
        return png_of(self._pictures[identifier].layer.pixels)

    def fit(self, values: FitRequest) -> dict[str, Plain]:
        """Proposes where the tiles of a photograph are.

        The tiles are near the corners in `values`, or exactly at them if `values` says so. Without
        corners they are searched for.
        """
        corners = (
            None if values["corners"] is None else np.array(values["corners"], float).reshape(4, 2)
        )
        shape = floor_shape((values["rows"], values["columns"]))
        fits = corners is None or not values["exact"]
        photograph = self.photographs[values["photo"]]
        return propose_tiles(photograph, shape=shape, corners=corners, fit=fits)._asdict()

    def cut(self, values: CutRequest) -> list[dict[str, Plain]]:
        """Cuts the tiles of a proposal whose kind is sure.

        Returns the values of these tiles for the page, with their proposed masks.
        """
        photograph = self.photographs[values["photo"]]
        cuts = cut_tiles(photograph, Proposal(**values["proposal"]))
        if not cuts:
            raise InputError(photograph.name, "tiles of a sure kind", "none", "set the kinds")
        return [self._add(cut.name, _picture_of(cut.image), mask_cut(cut)) for cut in cuts]

    def mask(self, values: MaskRequest) -> str:
        """Proposes one mask of a tile by colours, in bits as `_pack` has them."""
        colours = {
            name: parse_colour(",".join(f"{low}..{high}" for low, high in values["colours"][name]))
            for name in MASKS
        }
        layer = self._pictures[values["id"]].layer
        return _pack(propose_layer_masks(layer, colours)[values["mask"]])

    def save(self, values: Sequence[SentTile]) -> dict[str, Plain]:
        """Writes the set, whole or not at all.

        The first save copies the earlier set to a new name next to it.

        Returns:
          The names of the tiles, where the earlier set is, and the problems that
          `elitelanes tiles check` finds.

        Raises:
          InputError: without tiles, or if another program changed the folder.
        """
        tiles = _named(values)
        with self._saving:
            # Another save of this page may have been at work until now.
            if _stamp_of(self.folder) != self._stamp:
                hint = "nothing was saved. Start the command again"
                raise InputError(self.folder, "", "another program changed it", hint)
            is_first = not self.saved
            has_earlier_set = self.folder.exists() and any(self.folder.iterdir())
            # An earlier save that failed may have copied the set already.
            if is_first and has_earlier_set and self._earlier_set is None:
                self._earlier_set = _copy_aside(self.folder)
            with output_folder(
                self.folder, {"command": "tiles edit"}, foreign=lambda _: None, force=True
            ) as work:
                self._write(work.files, tiles)
            self.saved = True
            self._stamp = _stamp_of(self.folder)
            # A page that is loaded again begins with what was saved.
            self._tiles = [
                self._add(name, self._pictures[tile["id"]], self._masks_of(tile))
                for name, tile in tiles.items()
            ]
        kept = None
        if is_first and self._earlier_set is not None:
            kept = str(self._earlier_set)
        problems = inspect_tiles(self.folder, lines=True)[1]
        return {"names": list(tiles), "kept": kept, "problems": problems}

    def zip(self, values: Sequence[SentTile]) -> bytes:
        """Returns the set as a zip file with one folder. The folder of the set does not change.

        Raises:
          InputError: without tiles.
        """
        tiles = _named(values)
        with TemporaryDirectory() as work:
            folder = Path(work, self.folder.resolve().name)
            self._write(folder, tiles)
            return _zip_of(folder)

    def stop_saving(self) -> None:
        """Waits for a save that has begun, and prevents further ones.

        Then the process can end.
        """
        self._saving.acquire()

    def _start(self, photograph: Photograph, shape: tuple[int, int]) -> dict[str, Plain]:
        height, width = photograph.image.shape[:2]
        start = {
            "name": photograph.name,
            "width": width,
            "height": height,
            "rows": shape[0],
            "columns": shape[1],
        }
        try:
            return start | {
                "proposal": propose_tiles(photograph, shape=shape)._asdict(),
                "advice": "",
            }
        except InputError as error:
            return start | {"proposal": None, "advice": str(error)}

    def _add(
        self, name: str, picture: _Picture, masks: Mapping[str, NDArray[np.bool_]]
    ) -> dict[str, Plain]:
        """Keeps a tile's picture; returns its values for the page.

        `by_colours` says of each mask whether it is the one that the default colours propose. The
        page's sliders begin at these colours, so that they would replace any other mask.
        """
        identifier = sha256(name.encode() + picture.file).hexdigest()[:16]
        self._pictures[identifier] = picture
        proposed = propose_layer_masks(picture.layer)
        packed: dict[str, Plain] = {mask: _pack(pixels) for mask, pixels in masks.items()}
        by_colours: dict[str, Plain] = {
            mask: np.array_equal(masks[mask], proposed[mask]) for mask in masks
        }
        kind, side = name.rpartition("_")[0], len(picture.layer.pixels)
        return {
            "id": identifier,
            "name": name,
            "kind": kind,
            "side": side,
            "masks": packed,
            "by_colours": by_colours,
        }

    def _masks_of(self, tile: SentTile) -> dict[str, NDArray[np.bool_]]:
        """Returns the masks in the values of a tile that the page sends."""
        side = len(self._pictures[tile["id"]].layer.pixels)
        return {mask: _unpack(tile["masks"][mask], side) for mask in MASKS}

    def _write(self, target: Path, tiles: Mapping[str, SentTile]) -> None:
        """Writes the tiles by name, and copies the other files of the set.

        Other files are those that are not in a tile's folder.
        """
        if self.folder.exists():
            _copy_other_files(self.folder, target)
        written = []
        for name, tile in tiles.items():
            picture = self._pictures[tile["id"]]
            write_atomic(target / name / "image.png", picture.file)
            masked = MaskedTile(target / name, picture.layer.pixels, self._masks_of(tile), ())
            masked.write_masks()
            written.append(masked)
        write_png(target / "masks.png", proposal_sheet("Masks corrected by hand", written))
        tile_set, _ = inspect_tiles(target)
        if tile_set is not None:
            write_lane_offset(target, tile_set.tiles)


def _copy_other_files(folder: Path, target: Path) -> None:
    """Copies a tile set without its tiles and its sheets."""
    left_out = {tile_folder.name for tile_folder in tile_folders(folder, [])} | set(_SHEETS)

    def ignored(parent: str, names: list[str]) -> set[str]:
        # Folders inside the set's folder are copied whole, even if a file in them has one of these
        # names.
        return left_out & set(names) if Path(parent) == folder else set()

    shutil.copytree(folder, target, symlinks=True, dirs_exist_ok=True, ignore=ignored)


def _read(folder: Path) -> _Picture:
    """Reads the picture of a tile, which `mask_folder` has checked."""
    file = folder / "image.png"
    layer = read_image(file, [])
    assert layer is not None
    return _Picture(layer, file.read_bytes())


def _picture_of(image: NDArray[np.uint8]) -> _Picture:
    return _Picture(Layer(image, np.ones(image.shape[:2], bool), 0.0), png_of(image))


def _named(tiles: Sequence[SentTile]) -> dict[str, SentTile]:
    """Returns the tiles by the names of their folders.

    A tile keeps its name if its kind is the same. Otherwise it gets the next free name of its kind.

    Raises:
      InputError: without tiles, or for another kind.
    """
    if not tiles:
        raise InputError("", "at least one tile", "none")
    for tile in tiles:
        if tile["kind"] not in KINDS or tile["kind"] == "empty":
            raise InputError(tile["name"], "a kind of tile", repr(tile["kind"]))
    fits = [re.fullmatch(rf"{tile['kind']}_\d+", tile["name"]) is not None for tile in tiles]
    fitting = {tile["name"] for tile, is_fit in zip(tiles, fits, strict=True) if is_fit}
    named: dict[str, SentTile] = {}
    for tile, is_fit in zip(tiles, fits, strict=True):
        name = tile["name"]
        if not is_fit or name in named:
            # A new name is none that another tile keeps, even if that tile comes later.
            free = (f"{tile['kind']}_{number}" for number in count(1))
            name = next(name for name in free if name not in fitting and name not in named)
        named[name] = tile
    return named


def _zip_of(folder: Path) -> bytes:
    """Returns a zip file of a folder, whose names begin with the folder's."""
    stream = BytesIO()
    # A zip file cannot hold times before 1980. Without strict timestamps they become 1980 instead
    # of an error.
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, strict_timestamps=False) as archive:
        for file in sorted(folder.rglob("*")):
            if file.is_file():
                archive.write(file, file.relative_to(folder.parent))
    return stream.getvalue()


def _copy_aside(folder: Path) -> Path:
    """Copies a folder to a new name next to it, so that nothing in it is lost."""
    copy = free_name(folder.resolve(), f"{folder.name}.before")
    with output_folder(copy, {"command": "tiles edit"}) as work:
        shutil.copytree(folder, work.files, symlinks=True, dirs_exist_ok=True)
    return copy


def _stamp_of(folder: Path) -> list[tuple[str, int, int]]:
    """Returns the name, the size and the time of every file in a folder.

    If a program changes a file, the result changes.
    """
    stamps = []
    for parent, _, files in os.walk(folder):
        for file in files:
            status = Path(parent, file).lstat()
            stamps.append((str(Path(parent, file)), status.st_size, status.st_mtime_ns))
    return sorted(stamps)


def _pack(mask: NDArray[np.bool_]) -> str:
    """Returns the bits of a mask in base 64.

    The bits are row by row, eight to a byte, the first in the highest bit.
    """
    return b64encode(np.packbits(mask).tobytes()).decode()


def _unpack(text: str, side: int) -> NDArray[np.bool_]:
    packed = np.frombuffer(b64decode(text, validate=True), np.uint8)
    if packed.size != -(-side * side // 8):
        raise InputError("", f"a mask of {side} x {side} pixels", f"{packed.size} bytes")
    return np.unpackbits(packed, count=side * side).reshape(side, side).astype(np.bool_)

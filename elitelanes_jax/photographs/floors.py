"""Photographed floors: what a user says of each, what is found in it, and the set that is cut."""

from collections.abc import Sequence
from contextlib import suppress
from hashlib import file_digest
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.files import free_name
from elitelanes_jax._util.folders import output_folder
from elitelanes_jax.photographs.cutting import Cut, cut_tiles, write_cuts
from elitelanes_jax.photographs.lenses import Lens
from elitelanes_jax.photographs.proposals import Proposal, propose_plan, propose_tiles
from elitelanes_jax.photographs.reading import Photograph
from elitelanes_jax.photographs.sheet import draw_proposal, draw_sheet
from elitelanes_jax.tiles.masking import proposal_sheet
from elitelanes_jax.tiles.rendering import write_png
from elitelanes_jax.tiles.tileset import TileSet


class Floor(NamedTuple):
    """What a user says of the tiles in a photograph.

    Attributes:
      file: the file of the photograph.
      shape: the rows and columns of tiles, without the empty border of a map; (1, 1) for a single
        tile.
      codes: the codes of the map that is laid ``[H, W]``, None if it is not known.
      corners: the corners of the tiles in pixels of the file ``[4, 2]``, clockwise, roughly; None
        if they are to be found.
      exact: whether the corners are taken as they are.
    """

    file: Path
    shape: tuple[int, int] = (1, 1)
    codes: NDArray[np.int8] | None = None
    corners: NDArray[np.float64] | None = None
    exact: bool = False


def find_floor(
    floor: Floor, lens: Lens | None, tiles: TileSet | None = None, *, trusts_map: bool = True
) -> tuple[Photograph, Proposal]:
    """Reads a photograph, and finds its tiles.

    Args:
      floor: the photograph, and what is known of its tiles.
      lens: the lens of the camera, if it is known.
      tiles: pictures that kinds are read with; by default the package's own.
      trusts_map: whether the floor's codes tell the kinds. Otherwise the codes only tell where
        tiles may be, and the kinds are read. The proposal then lacks the map's empty border.

    Raises:
      InputError: if the photograph cannot be read, or nothing like tiles is found.
    """
    photograph = Photograph.read(floor.file, lens)
    corners = None if floor.corners is None else photograph.pixels_of(floor.corners)
    fit = not floor.exact
    if floor.codes is None or trusts_map:
        proposal = propose_tiles(
            photograph,
            shape=floor.shape,
            corners=corners,
            codes=floor.codes,
            tiles=tiles,
            fit=fit,
        )
    else:
        proposal = propose_plan(photograph, floor.codes, corners=corners, tiles=tiles, fit=fit)
    return photograph, proposal


class CutFloors(NamedTuple):
    """What was cut out of photographs.

    Attributes:
      cuts: the tiles.
      refused: a line for each photograph whose tiles were not found.
      proposals: for the sheet, where the tiles may be in each photograph that has an outline.
      pictures: for the sheet, these photographs with the outlines of their tiles.
    """

    cuts: list[Cut]
    refused: list[str]
    proposals: list[Proposal]
    pictures: list[NDArray[np.uint8]]

    @property
    def used(self) -> list[Proposal]:
        """The proposals of the photographs whose tiles were cut."""
        return [proposal for proposal in self.proposals if proposal.is_sure]


def cut_floors(floors: Sequence[Floor], lens: Lens | None) -> CutFloors:
    """Cuts tiles out of the photographs in which they are found.

    Only one photograph is in memory at a time.

    Raises:
      InputError: if a floor is given twice, because the set would have all its tiles twice.
    """
    _check_distinct(floors)
    result = CutFloors([], [], [], [])
    for floor in floors:
        try:
            photograph, proposal = find_floor(floor, lens)
        except InputError as error:
            # The tiles of the other photographs are still written, because finding them may have
            # taken minutes.
            result.refused.append(str(error))
            continue
        # A photograph that is refused stays on the sheet, where its outlines show what went wrong.
        result.proposals.append(proposal)
        result.pictures.append(draw_proposal(photograph, proposal))
        if proposal.is_sure:
            result.cuts.extend(cut_tiles(photograph, proposal, result.cuts))
        else:
            result.refused.append(proposal.refusal)
    return result


def _check_distinct(floors: Sequence[Floor]) -> None:
    """Checks that no floor is given twice, also in a copy of a photograph.

    One photograph may show several floors, which differ in their corners, size or map.
    """
    files: dict[tuple[object, ...], Path] = {}
    for floor in floors:
        # A pipe can be read only once.
        if not floor.file.is_file():
            continue
        with suppress(OSError), floor.file.open("rb") as stream:
            digest = file_digest(stream, "sha256").hexdigest()
            arrays = [
                part if part is None else part.tobytes() for part in (floor.codes, floor.corners)
            ]
            key = (digest, floor.shape, *arrays)
            if key in files:
                hint = "several floors on a photograph need --corners"
                raise InputError(floor.file, "each photograph once", f"{files[key]} again", hint)
            files[key] = floor.file


def write_set(out: Path, floors: CutFloors) -> Path | None:
    """Writes the tiles with proposed masks, and the sheet.

    Returns where the earlier files of the folder are kept, None if it had none. After an error they
    are back in their place.
    """
    earlier_set = None
    if out.is_dir() and any(out.iterdir()):
        # Renamed, so that nothing in it is lost.
        earlier_set = out.rename(free_name(out, f"{out.name}.before"))
    try:
        # The folder appears complete or not at all.
        with output_folder(out, {"command": "tiles cut"}) as work:
            masked = write_cuts(work.files, floors.cuts)
            tiles = proposal_sheet("Tiles and their masks", masked)
            title = f"Tiles cut into {out.name}"
            sheet = draw_sheet(title, floors.pictures, floors.proposals, tiles)
            write_png(work.files / "sheet.png", sheet)
    except BaseException:
        if earlier_set is not None and not out.exists():
            earlier_set.rename(out)
        raise
    return earlier_set

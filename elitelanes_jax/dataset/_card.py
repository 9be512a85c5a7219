"""The card of a dataset for readers, and a sheet of some of its samples."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from elitelanes_jax._util.errors import pluralize
from elitelanes_jax.dataset._fields import OBJECTS, Contents
from elitelanes_jax.dataset._samples import layer_names
from elitelanes_jax.dataset.spec import describe_sides
from elitelanes_jax.dataset.tables import DatasetRecord, SeenObject
from elitelanes_jax.maps.spec import SPLITS
from elitelanes_jax.network.likeness import ALIKE
from elitelanes_jax.tiles.contact_sheet import contact_sheet, write_text
from elitelanes_jax.tiles.rendering import LABEL_COLOURS, LABELS

# The side of a picture on the sheet in pixels, and the grey level of the sheet around it.
_SHEET_PX, _GROUND = 240, 236
# The longer side of a picture with boxes is about this many pixels. The colour of the boxes, RGB.
_BOXES_PX, _BOX_COLOUR = 960, (255, 0, 200)
# The height of a line of text, and the width of its widest letter, in pixels.
_LINE, _LETTER = 16, 8

TITLE = "Road maps of a miniature city, with labels"

TAGS = ("road-networks", "duckietown", "synthetic")

LICENCES = {
    "apache-2.0",
    "mit",
    "cc0-1.0",
    "cc-by-4.0",
    "cc-by-sa-4.0",
    "cc-by-nc-4.0",
    "bsd-3-clause",
    "gpl-3.0",
}
"""The licences that Hugging Face knows, by its names, which are SPDX's in lower case."""

# Hugging Face's categories of size. The number of pictures is less than the limit of its category.
_SIZES = ((1e3, "n<1K"), (1e4, "1K<n<10K"), (1e5, "10K<n<100K"))

_POSES = """
On a crossing, several movements pass the same position, and no picture shows which one was drawn. `nearest` depends on
the pose alone. Train on `nearest`, unless the network also receives the turn. `transform.matrix` maps points behind the
camera to a third coordinate of 0 or less, and points in front of it to where a camera without distortion sees them."""

_FILES = "the files of the sample, in the layout imagefolder alone"


def write_card(
    about: DatasetRecord,
    contents: Contents,
    loading: str,
    arrays: str,
    guide: str,
    data_files: Mapping[str, str],
) -> str:
    """Returns the README of a dataset, Markdown with the front matter that Hugging Face reads.

    Args:
      about: the record in ``dataset.json``.
      contents: the fields of the samples' metadata.
      loading: a program that loads it.
      arrays: a program that loads it as NumPy arrays.
      guide: text about the files of its layout.
      data_files: a pattern of each split's shards, by the split's name; empty without shards.
    """
    # The front matter has to be first, because Hugging Face reads it only there.
    lines = _front_matter(about, data_files)
    lines += ["", f"# {TITLE}", ""]
    lines += introduce(about)
    lines += ["", "![Some of them](contact-sheet.png)", ""]
    lines += _table_of_classes(about)
    lines += [
        "",
        "Lines cover the road. Pixels beyond a map, and above the horizon, are background.",
    ]
    lines += ["", "## Loading it", "", "Replace `DIR` in the programs by the path of this folder."]
    lines += ["", "```python", loading, "```"]
    lines += ["", "As NumPy arrays:", "", "```python", arrays, "```", ""]
    # Poses and objects are explained only if the samples have them.
    lines += _table_of_fields(contents)
    if contents.camera:
        lines.append(_POSES)
    if contents.objects:
        lines += ["", OBJECTS]
    if guide:
        lines.append(guide)
    lines += ["", "## How it was made", ""]
    lines += _origin(about)
    lines.append("")
    return "\n".join(lines)


def _front_matter(about: DatasetRecord, data_files: Mapping[str, str]) -> list[str]:
    """Returns the lines that Hugging Face reads."""
    # Hugging Face's names of licences are in lower case.
    licence = about["tile_set"]["licence"].lower()
    lines = [
        "---",
        f"task_categories: [{', '.join(tasks_of(about))}]",
        f"license: {licence if licence in LICENCES else 'other'}",
    ]
    total = sum(about["pictures"].values())
    # The first limit above the number of pictures is that of its category.
    for limit, category in _SIZES:
        if total < limit:
            lines.append(f"size_categories: [{category}]")
            break
    lines.append(f"tags: [{', '.join(TAGS)}]")
    if data_files:
        lines += ["configs:", "- config_name: default", "  data_files:"]
    for split, pattern in data_files.items():
        lines.append(f"  - {{split: {split}, path: {pattern!r}}}")
    lines.append("---")
    return lines


def tasks_of(about: DatasetRecord) -> list[str]:
    """Returns what a dataset is for, by the names of Hugging Face."""
    tasks = ["image-segmentation"]
    return [*tasks, "object-detection"] if "object_set" in about else tasks


def _table_of_fields(contents: Contents) -> list[str]:
    """Returns a table of the metadata."""
    layers = layer_names(has_objects=contents.objects)
    lines = [
        "The metadata of each sample have these fields. A field is missing if a given map has no "
        "such value.",
        "",
        "| field | value |",
        "|---|---|",
        f"| {', '.join(f'`{layer}_file_name`' for layer in layers)} | {_FILES} |",
    ]
    for fields, words in contents.groups():
        # The objects are explained below the table.
        if words != OBJECTS:
            lines.append(f"| {', '.join(f'`{field.name}`' for field in fields)} | {words} |")
    return lines


def introduce(about: DatasetRecord) -> list[str]:
    """Returns what the pictures show, and how the maps differ."""
    counts = about["pictures"]
    settings = about["settings"]
    camera = settings["camera"]
    # With a camera, the pixels of a tile say how fine the map is, and not how large the picture is.
    if camera is not None:
        views = f"views from a robot on the lanes, {camera['rows']} x {camera['columns']} pixels"
        views += f", of maps drawn with {settings['tile_px']} pixels a tile"
    else:
        views = f"views from above, {settings['tile_px']} pixels a tile"
    pictures = pluralize(sum(counts.values()), "picture")
    # A part has fewer maps than the settings say.
    networks = pluralize(sum(counts.values()) // settings["views"], "road network")
    # Given maps may have several parts. Evolved ones are valid, and therefore connected.
    maps = "They were given, not evolved." if about["given_maps"] else "Each is connected."
    maps += " No two have the same roads, even if these are moved, rotated or mirrored."
    splits = [split for split, count in counts.items() if count > 0]
    # A dataset of one split has nothing to compare.
    if len(splits) > 1:
        maps += (
            f" Maps of different splits differ in at least {100 * ALIKE:g} % "
            "of their tiles in the same sense."
        )
        if about["given_maps"]:
            maps += " Empty rows and columns around the roads do not count as tiles."
    version = about["versions"]["elitelanes_jax"]
    return [
        f"{pictures} of {networks}, {describe_sides(settings['size'])} tiles: {views}.",
        f"{maps} Each pixel has a label. Made by Elite Lanes JAX {version}.",
    ]


def _table_of_classes(about: DatasetRecord) -> list[str]:
    """Returns a table of the classes.

    It has the colour of each class, and the share of its pixels in each split.
    """
    heads = " | ".join(f"{split}, pixels" for split in SPLITS)
    lines = [f"| label | class | colour in the sheet | {heads} |", "|---|---|---|---|---|---|"]
    for label, name in enumerate(LABELS):
        shares = " | ".join(_share(about["class_pixels"][split], label) for split in SPLITS)
        lines.append(f"| {label} | {name} | rgb{tuple(LABEL_COLOURS[label])} | {shares} |")
    counts = " | ".join(f"{about['pictures'][split]:,}" for split in SPLITS)
    # The last row has no label and no colour.
    lines.append(f"| | pictures | | {counts} |")
    return lines


def _origin(about: DatasetRecord) -> list[str]:
    """Returns the list of settings that a reader asks for first."""
    tile_set, settings = about["tile_set"], about["settings"]
    search = settings["search"]
    lines = [f"- tile set: {tile_set['name']}, licence: {tile_set['licence'] or 'not stated'}"]
    if settings["camera"] is not None:
        spread = tile_set.get("lane_offset_spread")
        measured = "" if spread is None else f", with a standard deviation of {spread:g}"
        lines.append(
            f"- lanes: {tile_set['lane_offset']:g} tiles beside the road's middle{measured}"
        )
    if "object_set" in about:
        lines.append(f"- object set: {about['object_set']['name']}")
    # Given maps were not searched for, so no method is named.
    method = "" if about["given_maps"] else f", {search['method']}, preset {search['preset']}"
    lines.append(f"- seed {settings['seed']}{method}")
    # Only transforms that change something are listed.
    changes = []
    for name, value in settings["transforms"].items():
        if value not in (0, False, [1.0, 1.0]):
            changes.append(f"{name} {_plain(value)}")
    lines.append(f"- views: {', '.join(changes) or 'plain'}")
    # A constraint that the search did not have is left out.
    constraints = {
        "where": "ranges that every map meets",
        "rules": "rules that every map keeps",
        "weights": "weights of the fitness",
        "axes": "axes of the niches",
        "fix": "tile codes that every map keeps",
        "inventory": "tiles that every map needs at most",
    }
    for name, words in constraints.items():
        if search[name]:
            lines.append(f"- {words}: {search[name]}")
    lines.append("- all settings and versions: `dataset.json`")
    return lines


def sample_sheet(
    out: Path, samples: Sequence[tuple[str, str, Sequence[str]]], title: str, shape: float = 1
) -> UInt8[np.ndarray, "_ _ 3"]:
    """Draws pictures of samples next to their labels in colour, uint8 ``[., ., 3]``, RGB.

    Each of `samples` has the files of its image and its labels in the folder of the dataset, and
    lines of text. `shape` is the height of a cell of the sheet divided by its width. Pictures keep
    their proportions.
    """
    height = max(1, round(_SHEET_PX * shape))
    pictures, texts = [], []
    for image, labels, lines in samples:
        # Labels are scaled to the nearest pixel, because a mean of labels would be another class.
        colours = np.array(LABEL_COLOURS, np.uint8)[_fit(out / labels, shape, cv2.INTER_NEAREST)]
        shown = _fit(out / image, shape, cv2.INTER_AREA)
        high, wide = shown.shape[:2]
        # A picture of other proportions is in the middle of its cell.
        top, left = (height - high) // 2, (_SHEET_PX - wide) // 2
        # The picture and its labels are side by side, with a gap of 4 pixels.
        pair = np.full((height, 2 * _SHEET_PX + 4, 3), _GROUND, np.uint8)
        pair[top : top + high, left : left + wide] = shown
        pair[top : top + high, -_SHEET_PX:][:, left : left + wide] = colours
        pictures.append(pair)
        texts.append(lines)
    return contact_sheet(title, pictures, texts)


def draw_boxes(file: Path, objects: Sequence[SeenObject]) -> UInt8[np.ndarray, "_ _ 3"]:
    """Draws the boxes and the kinds of the objects in a picture of the dataset.

    The largest boxes get their kinds first. A kind that would overprint another one is left out.
    Returns uint8 ``[., ., 3]``, RGB.
    """
    picture = _read(file)
    # Small pictures are enlarged by a whole number, so that boxes stay on the edges of pixels.
    larger = max(1, round(_BOXES_PX / max(picture.shape[:2])))
    drawn = np.ascontiguousarray(picture.repeat(larger, axis=0).repeat(larger, axis=1))
    boxes = []
    for thing in objects:
        x, y, wide, high = [larger * part for part in thing["box"]]
        # A box has its last pixel inside, so that it is as wide as the object.
        cv2.rectangle(drawn, (x, y), (x + wide - 1, y + high - 1), _BOX_COLOUR, 1)
        boxes.append((wide * high, x, y, high, thing["kind"]))
    taken = np.zeros(drawn.shape[:2], bool)
    for _, x, y, high, kind in sorted(boxes, reverse=True):
        wide = _LETTER * len(kind)
        left = max(0, min(x, drawn.shape[1] - wide))
        # A kind is above its box, below it, or inside it.
        for top in (y - _LINE, y + high, y):
            place = taken[top : top + _LINE, left : left + wide] if top >= 0 else taken[:0]
            if len(place) == _LINE and not place.any():
                place[:] = True
                # Letters are read on a dark plate.
                drawn[top : top + _LINE, left : left + wide] //= 4
                write_text(drawn, kind, (left, top + _LINE - 4), 0.5, _BOX_COLOUR)
                break
    return drawn


def _fit(file: Path, shape: float, interpolation: int) -> UInt8[np.ndarray, "..."]:
    """Reads a picture of the dataset, RGB or grey, and scales it for the sheet.

    The picture gets the largest size that a cell of the sheet holds.
    """
    picture = _read(file)
    height, width = picture.shape[:2]
    # No side is rounded up to more than the cell's.
    wide = _SHEET_PX * min(1, shape * width / height)
    high = _SHEET_PX * shape * min(1, height / (shape * width))
    size = max(1, round(wide)), max(1, round(high))
    return np.asarray(cv2.resize(picture, size, interpolation=interpolation), np.uint8)


def _read(file: Path) -> UInt8[np.ndarray, "..."]:
    # NumPy reads the file, because OpenCV cannot open all names of files on Windows.
    picture = cv2.imdecode(np.fromfile(file, np.uint8), cv2.IMREAD_UNCHANGED)
    if picture is None:
        raise OSError(0, "cannot be read as a picture", str(file))
    if picture.ndim == 3:
        # OpenCV has blue first.
        picture = picture[..., ::-1]
    return np.asarray(picture, np.uint8)


def _share(pixels: Sequence[int], label: int) -> str:
    total = sum(pixels)
    # A split without pictures has no share.
    if total == 0:
        return "-"
    return f"{100 * pixels[label] / total:.2f} %"


def _plain(value: float | list[float]) -> str:
    if isinstance(value, list):
        return f"{value[0]:g}..{value[1]:g}"
    if value is True:
        return "yes"
    return f"{value:g}"

"""Do photographs of a lab's tiles teach a network for this lab? The lab is gym-duckietown.

    python -m experiments.perception.gym_duckietown.lab [--rows NAME...] [--seeds N] [--rides NAME...]
        [--drives NAME...] [--out DIR]

A tile set is built from gym-duckietown's textures, and its masks are not corrected by hand. Networks are trained on
views of it, and tested in gym-duckietown's pictures. No training uses a picture of gym-duckietown's camera, except that
of the row `limit`. The licence of the textures forbids to publish them and pictures of them: both stay in DIR.

After an interruption, the same command continues. `results.json` keeps each finished run, and the table is written from
it.
"""

import argparse
import json
import shutil
import subprocess
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from elitelanes_jax import InputError, load_tiles
from elitelanes_jax.drive import make_scenes
from elitelanes_jax.tiles import LABELS, inspect_tiles
from experiments.common import Parser, leave, run, table, whole, write
from experiments.perception.gym_duckietown import pictures, rides
from experiments.perception.gym_duckietown.evaluate import errors_of, score_labels
from experiments.perception.gym_duckietown.nets import find_labels, find_poses, read_weights
from experiments.perception.gym_duckietown.pictures import KINDS, Pictures, read_pictures
from experiments.perception.gym_duckietown.stream import LINES, TILE_PX, stream
from experiments.perception.gym_duckietown.train import read_views, shares_of, train, train_on, write_trained
from experiments.perception.gym_duckietown.world import HERE, data_folder
from experiments.perception.story import FLOOR
from experiments.perception.synthetic_photographs import photograph

__all__ = ["DRIVES", "ROWS", "Drive", "Row", "build_set", "cut_floor", "main", "report"]


class Row(NamedTuple):
    """A row of the table.

    Attributes:
      words: in the table.
      tiles: a tile set, see `_make_set`; None for the package's own.
      source: "stream", "files", "limit" for gym-duckietown's own pictures, or "committed" for no training.
      steps: of training.
      maps: towns of files.
      lines: largest shift of white lines in tiles; None for no shift.
      task: "pose" or "labels".
      tile_px: the side of a tile's picture in the files, in pixels. The stream has `stream.TILE_PX`.
      views: files of each town.
    """

    words: str
    tiles: str | None
    source: str
    steps: int = 0
    maps: int = 0
    lines: float | None = None
    task: str = "pose"
    tile_px: int = 96
    views: int = 500


ROWS = {
    "committed": Row("drawings, 30,000 files: the committed network", None, "committed"),
    "photographs-stream": Row("five photographs, stream", "photographs", "stream", 6000),
    "photographs-files": Row("five photographs, 12,000 files", "photographs", "files", 3000, 24),
    "cut-files": Row("cut from one oblique photograph, 12,000 files", "cut", "files", 3000, 24),
    "drawings-files": Row("drawings, 12,000 files", None, "files", 3000, 24, LINES),
    "drawings-stream": Row("drawings, stream", None, "stream", 6000, lines=LINES),
    "photographs-lines": Row("five photographs, `lines=0.07`, 12,000 files", "photographs", "files", 3000, 24, LINES),
    "photographs-30000": Row("five photographs, 30,000 files", "photographs", "files", 3000, 60),
    "photographs-longer": Row("five photographs, 30,000 files, 6,000 steps", "photographs", "files", 6000, 60),
    "photographs-256": Row(
        "five photographs, 30,000 files, tiles of 256 px", "photographs", "files", 3000, 60, tile_px=256
    ),
    "photographs-60000": Row(
        "five photographs, 60,000 files, 6,000 steps", "photographs", "files", 6000, 60, views=1000
    ),
    "cut-stream": Row("cut from one oblique photograph, stream", "cut", "stream", 6000),
    "one-stream": Row("one photograph of each kind, stream", "one", "stream", 6000),
    "more-stream": Row("all photographs that pass the check, stream", "more", "stream", 6000),
    "mixed-stream": Row("five photographs and drawings, stream", "mixed", "stream", 6000),
    "limit": Row("gym-duckietown's own pictures, 12,480 files", None, "limit", 6000),
    "limit-12000": Row("gym-duckietown's own pictures, 12,480 files, 12,000 steps", None, "limit", 12000),
    "stream-12000": Row("five photographs, stream, 12,000 steps", "photographs", "stream", 12000),
    "stream-24000": Row("five photographs, stream, 24,000 steps", "photographs", "stream", 24000),
    "committed-labels": Row("drawings: the committed network", None, "committed", task="labels"),
    "photographs-labels": Row("five photographs, stream", "photographs", "stream", 1800, task="labels"),
}
"""The rows by name, in the order of their runs."""


class Drive(NamedTuple):
    """A kind of rides.

    Attributes:
      words: in the table.
      options: of `rides`.
      prefix: of its figures in `results.json`.
    """

    words: str
    options: tuple[str, ...]
    prefix: str


DRIVES = {
    "random-20": Drive("20 s in random light", ("--domain-rand", "--seconds", "20"), ""),
    "random-60": Drive("60 s in random light", ("--domain-rand", "--seconds", "60"), "random-60 "),
    "usual-60": Drive("60 s in usual light", ("--seconds", "60"), "usual-60 "),
}
"""The kinds of rides by name."""

_REPOSITORY = Path(__file__).parents[3]
_MAPS = 60  # towns of the stream

_TEXTURES = {  # the pictures that gym-duckietown shows, then others in its package
    "straight_1": "tiles-processed/photos/straight/texture.jpg",
    "turn_1": "tiles-processed/photos/curve_left/texture.jpg",
    "turn_2": "tiles-processed/photos/curve_right/texture.jpg",
    "crossing3_1": "tiles-processed/photos/3way_left/texture.jpg",
    "crossing3_2": "tiles-processed/photos/3way_right/texture.jpg",
    "crossing4_1": "tiles-processed/photos/4way/texture.jpg",
}
_MORE_TEXTURES = {
    "straight_2": "tiles/photos/straight_1.jpg",
    "turn_3": "tiles/photos/curve_left_1_gymd.jpg",
    "turn_4": "tiles/photos/curve_left_2_gymd.jpg",
    "turn_5": "tiles/photos/curve_left_3_gymd.jpg",
    "crossing3_3": "tiles/photos/3way_left_1.jpg",
    "crossing3_4": "tiles/photos/3way_left_2.jpg",
    "crossing4_2": "tiles/photos/4way_1_gymd.jpg",
}
_SECOND = ("turn_2",)  # what the set `one` lacks
_TILT = 30  # degrees from straight down, at least

Results = dict[str, dict[str, dict[str, float]]]
"""The figures of a run, by row and seed."""


def build_set(folder: Path, textures: dict[str, Path]) -> None:
    """Makes a tile set of pictures, with proposed masks. A picture that fails the check is left out.

    Raises:
      InputError: if the others fail the check too.
    """
    part = folder.with_name(f".{folder.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    for name, file in textures.items():
        image = cv2.imread(str(file))
        if image is None:
            raise InputError(file, "a picture of a tile", "none")
        (part / name).mkdir(parents=True)
        cv2.imwrite(str(part / name / "image.png"), image)
    _elitelanes("tiles", "masks", str(part))
    (part / "masks.png").unlink(missing_ok=True)
    problems = inspect_tiles(part, lines=True)[1]
    for name in textures:
        reasons = [line for line in problems if f"/{name}/" in line.replace("\\", "/")]
        if reasons:
            print(f"left out: {reasons[0]}", flush=True)
            shutil.rmtree(part / name)
    remaining = inspect_tiles(part)[1]
    if remaining:
        raise InputError(folder, "", remaining[0])
    part.replace(folder)


def _make_set(name: str, sets: Path) -> Path:
    """Makes a tile set if it is not there; returns its folder.

    The sets are `photographs`, those that gym-duckietown shows; `one`, one of each kind; `more`, with others of the
    package; `mixed`, with drawings; and `cut`, cut from one oblique photograph of a laid floor.
    """
    folder = sets / name
    if folder.is_dir():
        return folder
    textures = {tile: data_folder() / "textures" / file for tile, file in _TEXTURES.items()}
    if name == "one":
        textures = {tile: file for tile, file in textures.items() if tile not in _SECOND}
    if name == "more":
        textures |= {tile: data_folder() / "textures" / file for tile, file in _MORE_TEXTURES.items()}
    if name == "cut":
        cut_floor(folder, _make_set("photographs", sets))
    elif name == "mixed":
        part = folder.with_name(f".{name}.part")
        shutil.rmtree(part, ignore_errors=True)
        shutil.copytree(_make_set("photographs", sets), part)
        for picture in sorted((_REPOSITORY / "tiles").glob("*/image.png")):
            drawing = picture.parent
            kind, number = drawing.name.split("_")
            shutil.copytree(drawing, part / f"{kind}_{int(number) + len(textures)}")
        part.replace(folder)
    else:
        build_set(folder, textures)
    return folder


def cut_floor(folder: Path, photographs: Path) -> None:
    """Lays a floor of photographed tiles, takes one oblique photograph of it, and cuts it into a tile set."""
    rng, tiles = np.random.default_rng(0), load_tiles(photographs)
    while True:
        seen = photograph(rng, FLOOR, tiles, "wood", fill=(0.65, 1.0))
        if seen.tilt >= _TILT:
            break
    file = folder.with_name("floor.png")
    file.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(file), seen.image[..., ::-1])
    _elitelanes("tiles", "cut", str(file), "--size", *map(str, FLOOR.shape), "--out", str(folder))
    # In gym-duckietown's curves, lanes run 0.20 tiles beside the road's middle, whatever the lines say.
    (folder / "tileset.toml").write_text("lane_offset = 0.2\n", encoding="utf-8")


def _elitelanes(*arguments: str) -> None:
    """Runs a command of the package.

    Raises:
      InputError: if it fails. It has printed why.
    """
    command = [sys.executable, "-m", "elitelanes_jax", *arguments]
    if subprocess.run(command, check=False).returncode:
        raise InputError(f"elitelanes {' '.join(arguments)}", "it to succeed", "an error")


def _make_views(row: Row, tiles: Path | None, folder: Path) -> Path:
    """Draws the files of a row if they are not there; returns their folder."""
    if not folder.is_dir():
        camera = ["rows=120", "columns=160"] + ([] if row.lines is None else [f"lines={row.lines}"])
        sets = [] if tiles is None else ["--tiles", str(tiles)]
        towns = ["--style", "town", "--where", "crossings=0..", "--evaluations", "2000"]
        counts = ["--maps", str(row.maps), "--views", str(row.views), "--size", "7", "--split", "1", "0", "0"]
        looks = ["--tile-px", str(row.tile_px), "--camera", *camera, "--transform", "varied", "blur=0.5"]
        _elitelanes("dataset", "--out", str(folder), *sets, *towns, *counts, *looks)
    return folder


def _make_towns(folder: Path) -> list[Path]:
    """Makes the towns of the stream if they are not there; returns their files."""
    if not folder.is_dir():
        towns = [
            "--style",
            "town",
            "--where",
            "crossings=0..",
            "--evaluations",
            "5000",
            "--size",
            "7",
            "7",
            "--maps",
            str(_MAPS),
            "--seeds",
            "16",
        ]
        _elitelanes("generate", *towns, "--tile-px", "16", "--out", str(folder))
    return sorted(folder.glob("maps/*/map.json"))


def _train(name: str, seed: int, out: Path) -> Path:
    """Trains the network of a row if it is not there; returns its file."""
    row = ROWS[name]
    if row.source == "committed":
        return HERE / "weights" / f"{row.task}.npz"
    weights = out / f"{name}-{seed}.npz"
    if weights.exists():
        return weights
    tiles = None if row.tiles is None else _make_set(row.tiles, out / "sets")
    if row.source == "stream":
        scenes = make_scenes(_make_towns(out / "towns"), load_tiles(tiles), tile_px=TILE_PX)
        batches = partial(stream, row.task, scenes, seed, row.lines)
        shares = shares_of(next(batches(0)).labels)
        write_trained(weights, partial(train_on, row.task, batches, shares, row.steps, seed))
        return weights
    if row.source == "limit":
        views = out / "own.npz"
        # Without --only, the pictures are of people's maps and of our towns.
        _take_pictures("development", 960, views, "--no-labels")
    else:
        views = _make_views(row, tiles, out / "views" / name)
    write_trained(weights, partial(train, row.task, read_views(views), row.steps, seed))
    return weights


def _take_pictures(part: str, poses: int, file: Path, *options: str) -> None:
    """Takes pictures in gym-duckietown if they are not there. `options` are those of `pictures`."""
    command = [part, "--poses", str(poses), "--out", str(file), *options]
    if not file.exists() and pictures.main(command):
        raise InputError(file, "pictures of gym-duckietown", "an error")


def _measure(row: Row, weights: Path, test: Pictures) -> dict[str, float]:
    """Returns the figures of a network in the test pictures: medians in centimetres and radians, or IoUs."""
    parameters = read_weights(weights, row.task)
    if row.task == "labels":
        without = ~test.objects
        found = find_labels(parameters, test.images[without])
        scores = score_labels(test.fitting[without], test.fitting_white[without], found)
        return dict(zip(LABELS, map(float, scores.classes), strict=True)) | {"paved": scores.paved}
    found = np.asarray(find_poses(parameters, test.images), float)
    errors = errors_of(test, found)
    offset, angle = np.median(errors, axis=0)
    offset_90, angle_90 = np.percentile(errors, 90, axis=0)
    figures = {"offset": offset, "angle": angle, "offset_90": offset_90, "angle_90": angle_90}
    # In turns, gym-duckietown's lanes are Bézier curves up to 3.5 cm beside our arcs.
    arc_errors = errors_of(test._replace(lanes=test.ours), found)
    figures["arc offset"] = np.median(arc_errors[:, 0])
    for index, kind in enumerate(KINDS):
        figures[kind] = np.median(errors[test.kinds == index, 0])
        figures[f"arc {kind}"] = np.median(arc_errors[test.kinds == index, 0])
    return {name: float(figure) for name, figure in figures.items()}


def _ride(weights: Path, drive: Drive, file: Path) -> dict[str, float]:
    """Drives on each test map, and counts the rides."""
    if rides.main([str(weights), *drive.options, "--only", "people", "--out", str(file)]):
        raise InputError(file, "rides", "an error")
    maps = json.loads(file.read_text(encoding="utf-8"))
    driven = [maps[name]["rides"][0] for name in maps if name != "settings"]
    stay = [bool(ride["on_road"]) for ride in driven]
    own_lane = [bool(ride["on_road"]) and ride["oncoming"] == 0 for ride in driven]
    counts = {"rides": len(driven), "stay": sum(stay), "own_lane": sum(own_lane)}
    return {drive.prefix + name: float(count) for name, count in counts.items()}


def _median(runs: dict[str, dict[str, float]], name: str, digits: int) -> str:
    """Returns the median of the seeds' figures, with their range if there are several."""
    figures = [run[name] for run in runs.values()]
    text = f"{np.median(figures):.{digits}f}"
    if len(figures) > 1:
        text += f" ({min(figures):.{digits}f} to {max(figures):.{digits}f})"
    return text


def _counts(runs: dict[str, dict[str, float]], drive: Drive) -> str:
    """Returns the rides that stay, and those never in the oncoming lane, of each seed that drove."""
    counts = []
    for figures in runs.values():
        if f"{drive.prefix}rides" in figures:
            stay, own_lane, count = (figures[drive.prefix + name] for name in ("stay", "own_lane", "rides"))
            counts.append(f"{stay:.0f} and {own_lane:.0f} of {count:.0f}")
    return ", ".join(counts)


def report(results: Results) -> str:
    """Returns the tables of poses and of labels: the medians of all seeds, and their range.

    A second table of poses has the errors against our lane pose, whose turns are arcs.
    """
    poses, arcs, labels = [], [], []
    driven = {figure for runs in results.values() for figures in runs.values() for figure in figures}
    drives = [drive for drive in DRIVES.values() if f"{drive.prefix}rides" in driven]
    for name, row in ROWS.items():
        runs = results.get(name, {})
        if not runs:
            continue
        if row.task == "labels":
            labels.append([row.words, str(len(runs)), *(_median(runs, label, 3) for label in (*LABELS, "paved"))])
            continue
        figures = [_median(runs, figure, 3) for figure in ("offset", "offset_90", "angle", *KINDS)]
        poses.append([row.words, str(len(runs)), *figures, *(_counts(runs, drive) for drive in drives)])
        measured = {seed: run for seed, run in runs.items() if "arc offset" in run}
        if measured:
            figures = [_median(measured, f"arc {part}", 3) for part in ("offset", *KINDS)]
            arcs.append([row.words, str(len(measured)), *figures])
    head = ["trained on", "seeds", "offset, cm: median", "90 %", "angle, rad: median", *KINDS]
    text = table([*head, *(f"rides of {drive.words}: stay, and never oncoming" for drive in drives)], poses)
    if arcs:
        text += "\n" + table(["against our arcs: trained on", "seeds", "offset, cm: median", *KINDS], arcs)
    if labels:
        text += "\n" + table(["trained on", "seeds", *LABELS, "paved"], labels)
    return text


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("lab", __doc__)
    add_rows = partial(parser.add_argument, choices=ROWS, metavar="ROW", nargs="*")
    add_rows("--rows", default=list(ROWS), help=f"default all: {', '.join(ROWS)}")
    add_rows("--rides", default=[], help="rows whose first seed also drives; default none")
    parser.add_argument(
        "--drives",
        choices=DRIVES,
        metavar="DRIVE",
        nargs="+",
        default=["random-20"],
        help=f"kinds of these rides: {', '.join(DRIVES)}; default random-20",
    )
    parser.add_argument("--seeds", type=whole(1, 100), default=1, metavar="N", help="of each row; default 1")
    out = Path("results/photographs-lab")
    parser.add_argument("--out", type=Path, default=out, metavar="DIR", help=f"default {out}")
    options = parser.parse_args(arguments)
    return run("lab", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    out, file = options.out, options.out / "results.json"
    _take_pictures("test", 12, out / "test.npz", "--only", "people")
    test = read_pictures(out / "test.npz")
    results: Results = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    for name in options.rows:
        row = ROWS[name]
        seeds = 1 if row.source == "committed" else options.seeds
        for seed in range(seeds):
            runs = results.setdefault(name, {})
            figures = runs.setdefault(str(seed), {})
            drives_due = [
                drive
                for drive in options.drives
                if seed == 0 and name in options.rides and f"{DRIVES[drive].prefix}rides" not in figures
            ]
            if figures and not drives_due:
                continue
            weights = _train(name, seed, out)
            if not figures:
                figures |= _measure(row, weights, test)
            for drive in drives_due:
                figures |= _ride(weights, DRIVES[drive], out / f"{name}-rides-{drive}.json")
            print(name, seed, figures, flush=True)
            write(file, json.dumps(results, indent=1) + "\n")
    text = report(results)
    print(text)
    write(out / "photographs-lab.md", text)


if __name__ == "__main__":
    leave(main())

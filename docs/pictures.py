"""Draws the pictures of the README, of docs/styles.md, docs/render.md, docs/furnish.md, docs/drive.md and docs/plan.md.

python docs/pictures.py
"""

import json
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import jax
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax import evolve, render
from elitelanes_jax.dataset import DatasetSpec, make_dataset
from elitelanes_jax.drive import make_rides, trails
from elitelanes_jax.formats import RoadMap, make_plan, read_map
from elitelanes_jax.maps import furnish
from elitelanes_jax.tiles import LABEL_COLOURS, Picture, load_tiles

FOLDER = Path(__file__).parent


def main() -> None:
    styles()
    village()
    map_and_labels()
    furnished()
    drive_trails()
    make_plan(furnish(read_map(FOLDER / "examples" / "town.json"), "signs duckies=3")).save(FOLDER / "plan.png")


def styles() -> None:
    """Draws a sheet of maps of each style."""
    sheets = {"towns.jpg": ("town", ()), "paper-style.jpg": ("paper", ())}
    for name, (style, where) in sheets.items():
        chosen = evolve(0, (7, 7), style=style, evaluations=100_000).maps(24, where=where)
        sheet(name, chosen, tile_px=24, columns=8)
    large = evolve(0, (24, 24), seeds=2, style="town", evaluations=50_000).maps(8)
    sheet("large-towns.jpg", large, tile_px=28, columns=4, scale=0.5)


def sheet(name: str, maps: Sequence[RoadMap], *, tile_px: int, columns: int, scale: float = 1) -> None:
    drawn = [render(road_map, tile_px=tile_px, seed=number).image for number, road_map in enumerate(maps)]
    framed = [np.pad(image, [(5, 5), (5, 5), (0, 0)], constant_values=255) for image in drawn]
    rows = [np.hstack(framed[first : first + columns]) for first in range(0, len(framed), columns)]
    write(name, np.vstack(rows), scale)


def village() -> None:
    write("village.jpg", beside_labels(render(FOLDER / "examples" / "village.json", tile_px=128, seed=2), gap=0))


def map_and_labels() -> None:
    result = evolve(jax.random.split(jax.random.key(0), 16), evaluations=200_000)
    maps = sorted(result.choose(200).maps, key=lambda road_map: road_map.fitness or 0)
    best = next(road_map for road_map in maps if (road_map.metrics or {})["cyclomatic"] == 12)
    write("map-and-labels.jpg", beside_labels(render(best.codes, tile_px=64, seed=1), gap=24), scale=0.75)


def furnished() -> None:
    """Draws eight towns, and what a robot sees of one, with boxes, above its labels and instances."""
    towns = evolve(0, (7, 7), style="town", evaluations=50_000).maps(8, where={"crossings": (2, 9)})
    words = "all signs street_names lights=0.3 duckies=12 lane_robots=2"
    towns = [furnish(town, words, seed=seed) for seed, town in enumerate(towns)]
    sheet("furnished-towns.jpg", towns, tile_px=80, columns=4, scale=0.5)
    columns = []
    with TemporaryDirectory() as folder:
        out = Path(folder) / "dataset"
        spec = DatasetSpec().replace(
            maps_from=FOLDER / "examples" / "town.json",
            furnish="all street_names duckies=8 lane_duckies=5 lane_robots=2",
            camera=("rows=240", "columns=320"),
            views=12,
            split=(1, 0, 0),
            transforms="none",
        )
        make_dataset(spec, out)
        rows = [json.loads(line) for line in (out / "train" / "metadata.jsonl").read_text().splitlines()]
        seen = sorted(rows, key=lambda row: -len(set(row["objects"]["category"])))[:4]
        for row in seen:
            image, labels, instances = (
                np.asarray(cv2.imread(str(out / "train" / row[f"{name}_file_name"]), cv2.IMREAD_UNCHANGED))
                for name in ("image", "labels", "instances")
            )
            colours = np.array(LABEL_COLOURS, np.uint8)[labels]
            bright = np.random.default_rng(0).integers(70, 256, (int(instances.max()) + 1, 3)).astype(np.uint8)
            colours[instances > 0] = bright[instances[instances > 0]]
            for x, y, wide, high in row["objects"]["bbox"]:
                cv2.rectangle(image, (x, y), (x + wide - 1, y + high - 1), (255, 0, 255), 1)
            columns.append(np.vstack([image[..., ::-1], colours]))
    write("furnished.jpg", np.hstack(columns))


def drive_trails() -> None:
    town = read_map(FOLDER / "examples" / "town.json").codes
    picture = trails(town, load_tiles(), make_rides(town, 6))
    cv2.imwrite(str(FOLDER / "drive-trails.png"), picture[..., ::-1])


def beside_labels(picture: Picture, gap: int) -> NDArray[np.uint8]:
    space = np.full((picture.image.shape[0], gap, 3), 255, np.uint8)
    return np.hstack([picture.image, space, picture.overlay(opacity=0.85)])


def write(name: str, pixels: NDArray[np.uint8], scale: float = 1) -> None:
    scaled = cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(FOLDER / name), scaled[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])


if __name__ == "__main__":
    main()

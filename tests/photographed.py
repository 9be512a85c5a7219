"""Small photographs of tiles, as a camera sees them obliquely, for tests."""

from pathlib import Path

import cv2
import numpy as np

from elitelanes_jax.tiles import TileSet, load_tiles, render

TOWN = np.array([[6, 7, 3], [10, 10, 10], [12, 13, 9]], np.int8)
WIDTH, HEIGHT = 800, 640
LINO, ASPHALT = (205, 200, 190), (75, 72, 66)


def corners_of(rows, columns, tilt=30, turn=8, away=2.1):
    """The corners in pixels of a floor of this size below a camera that looks at its middle, tilted by degrees."""
    longest = max(rows, columns)
    flat = np.array([[-columns, -rows], [columns, -rows], [columns, rows], [-columns, rows]]) / 2 / longest
    spin = np.radians(turn)
    x, y = np.array([[np.cos(spin), -np.sin(spin)], [np.sin(spin), np.cos(spin)]]) @ flat.T
    depth = away - y * np.sin(np.radians(tilt))
    middle = np.array([WIDTH - 1, HEIGHT - 1]) / 2
    return np.float32(np.stack([x, y * np.cos(np.radians(tilt))], axis=1) / depth[:, None] * 1.2 * WIDTH + middle)


def worn_tiles(radius, white, bare=("turn_2", "turn_3")):
    """Drawn tiles whose turns differ: separators of another radius, and the white tape of the `bare` ones worn off.

    `white` is the contrast of white tape on the other turns, 1 as drawn.
    """
    tiles = []
    for tile in load_tiles().tiles:
        if tile.name.startswith("turn"):
            image, side = tile.image.copy(), len(tile.image)
            y, x = np.mgrid[:side, :side] / side
            down, right = np.abs(y - (0 if tile.code & 8 else 1)), np.abs(x - (1 if tile.code & 4 else 0))
            is_white = image.min(axis=2) > 110
            image[cv2.dilate(np.asarray(tile.yellow, np.uint8), np.ones((5, 5))) > 0] = ASPHALT
            contrast = 0 if tile.name in bare else white
            image[is_white] = contrast * image[is_white] + (1 - contrast) * np.array(ASPHALT)
            is_line = np.abs(np.hypot(right, down) - radius) < 0.02
            image[is_line & (np.arctan2(down, right) * 7 % 1 < 0.6)] = (230, 190, 50)
            tile = tile._replace(image=image)
        tiles.append(tile)
    return TileSet("worn", "", tuple(tiles))


def photograph(codes, corners=None, ground=LINO, seed=0, size=(WIDTH, HEIGHT), tiles=None):
    """A photograph, RGB, of a floor with its corners at the given pixels; light from the left, noise."""
    px, rng = 96, np.random.default_rng(seed)
    tiles = load_tiles() if tiles is None else tiles
    laid = np.asarray(render(codes, tiles, tile_px=px, seed=seed).image)
    square = np.float32([[0, 0], [laid.shape[1], 0], [laid.shape[1], laid.shape[0]], [0, laid.shape[0]]]) - 0.5
    corners = corners_of(*np.shape(codes)) if corners is None else corners
    there = cv2.getPerspectiveTransform(square, np.float32(corners))
    cover = np.kron(np.asarray(codes) > 0, np.ones((px, px))).astype(np.float32)
    cover = cv2.warpPerspective(cover, there, size)[..., None]
    seen = cv2.warpPerspective(laid, there, size, borderMode=cv2.BORDER_REPLICATE)
    picture = (1 - cover) * np.array(ground) + cover * seen
    picture = picture * np.linspace(1.1, 0.8, size[0])[None, :, None] + rng.normal(0, 2, picture.shape)
    return np.clip(picture, 0, 255).astype(np.uint8)


def with_border(codes):
    """A map of these codes with an empty column to the west, and an empty row to the south."""
    return np.pad(codes, ((0, 1), (1, 0)))


def write(file, picture, *flags):
    assert cv2.imwrite(str(file), picture[..., ::-1], list(flags))


def draw_photographs(folder: Path):
    """Writes what the lines of `tiles.cases` name."""
    write(folder / "floor.jpg", photograph(TOWN), cv2.IMWRITE_JPEG_QUALITY, 90)
    for name, code in (("turn", 6), ("straight", 5), ("crossing", 15)):
        write(folder / f"{name}.jpg", photograph(np.array([[code]], np.int8)), cv2.IMWRITE_JPEG_QUALITY, 90)
    write(folder / "cropped.png", load_tiles().tiles[0].image)
    write(folder / "wall.png", np.full((300, 400, 3), 128, np.uint8))
    write(folder / "dot.png", np.zeros((1, 1, 3), np.uint8))
    (folder / "phone.heic").write_bytes(b"\0\0\0\x18ftypheic" + bytes(64))
    large = cv2.imencode(".png", np.zeros((1, 1), np.uint8))[1].tobytes()
    (folder / "large.png").write_bytes(large[:16] + (10_000).to_bytes(4) * 2 + large[24:])
    (folder / "plan.json").write_text(f'{{"codes": {TOWN.tolist()}}}')
    other = TOWN.copy()
    other[0, 0], other[1, 1] = 3, 5
    (folder / "other.json").write_text(f'{{"codes": {other.tolist()}}}')
    for name, codes in (("bordered", TOWN), ("other-bordered", other)):
        (folder / f"{name}.json").write_text(f'{{"codes": {with_border(codes).tolist()}}}')
    (folder / "large.json").write_text(f'{{"codes": {np.full((3, 41), 5).tolist()}}}')
    (folder / "bare.json").write_text('{"codes": [[0, 0], [0, 0]]}')
    (folder / "tile.json").write_text('{"codes": [[6]]}')

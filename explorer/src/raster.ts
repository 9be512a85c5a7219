/** Draws large maps, whose tiles have few pixels, pixel by pixel: drawing a million paths would take a minute. */
import { GROUND, END, mapShapes, paint, ROAD } from "./drawing";
import { SIDES, type Grid } from "./network/codes";
import { isReturned } from "./network/links";

/** The least number of screen pixels of a tile that is drawn as paths. */
const LEAST_PIXELS = 3;
/** The least number of screen pixels of a tile with lane lines. */
const LEAST_WITH_LANES = 14;
/** Pixels of a tile along each side: its middle, and an arm to each side. */
const CELL = 3;

/** Draws the roads of a map on a canvas. A tile is `scale` pixels wide. */
export function paintMap(context: CanvasRenderingContext2D, grid: Grid, scale: number): void {
  if (scale >= LEAST_PIXELS) {
    paint(context, { shapes: mapShapes(grid, { lanes: scale > LEAST_WITH_LANES }), texts: [] }, scale);
    return;
  }
  context.imageSmoothingEnabled = true;
  context.imageSmoothingQuality = "high";
  context.drawImage(rasterOf(grid), 0, 0, grid.width * scale, grid.height * scale);
}

/** Returns a picture with few pixels a tile. Roads that no neighbour returns end red, as in `mapShapes`. */
function rasterOf(grid: Grid): HTMLCanvasElement {
  const { height, width, codes } = grid;
  const canvas = document.createElement("canvas");
  canvas.width = CELL * width;
  canvas.height = CELL * height;
  const context = canvas.getContext("2d")!;
  const picture = context.createImageData(canvas.width, canvas.height);
  const pixels = new Uint32Array(picture.data.buffer);
  const [ground, road, end] = [GROUND, ROAD, END].map(pixelOf);
  pixels.fill(ground);
  codes.forEach((code, cell) => {
    if (!code) return;
    const [row, column] = [Math.floor(cell / width), cell % width];
    const middle = (CELL * row + 1) * canvas.width + CELL * column + 1;
    pixels[middle] = road;
    for (const side of SIDES) {
      if (!(code & side.bit)) continue;
      pixels[middle + side.down * canvas.width + side.right] = isReturned(grid, cell, side) ? road : end;
    }
  });
  context.putImageData(picture, 0, 0);
  return canvas;
}

/** Returns the pixel of a colour such as #e4e9dd, as a number of four bytes: red first, opacity last. */
function pixelOf(colour: string): number {
  const [red, green, blue] = [1, 3, 5].map((start) => parseInt(colour.slice(start, start + 2), 16));
  return new Uint32Array(Uint8Array.of(red, green, blue, 255).buffer)[0];
}

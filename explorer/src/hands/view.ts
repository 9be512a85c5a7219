/** Where the tiles are in a photograph: a homography and the bend of the lens, as `View` of photographs/_views.py. */

export type Point = readonly [x: number, y: number];

export interface View {
  readonly homography: readonly (readonly number[])[];
  readonly radial: number;
  readonly width: number;
  readonly height: number;
}

/** Returns the pixel at which a place, in tiles, is seen. */
export function pixelOf({ homography, radial, width, height }: View, [x, y]: Point): Point {
  const [across, down, depth] = homography.map((row) => row[0] * x + row[1] * y + row[2]);
  const half = Math.hypot(width, height) / 2;
  const centre = [(width - 1) / 2, (height - 1) / 2];
  const away = [(across / depth - centre[0]) / half, (down / depth - centre[1]) / half];
  const bend = 1 + radial * (away[0] ** 2 + away[1] ** 2);
  return [away[0] * bend * half + centre[0], away[1] * bend * half + centre[1]];
}

/** Returns the view, without a bend, in which the corners of a floor are at four pixels, clockwise. */
export function viewOf(corners: readonly Point[], rows: number, columns: number, width: number, height: number): View {
  const [[x0, y0], [x1, y1], [x2, y2], [x3, y3]] = corners;
  // The unit square to a quadrangle: Heckbert 1989, Fundamentals of Texture Mapping and Image Warping, section 2.2.3.
  const [dx1, dx2, dx3] = [x1 - x2, x3 - x2, x0 - x1 + x2 - x3];
  const [dy1, dy2, dy3] = [y1 - y2, y3 - y2, y0 - y1 + y2 - y3];
  const area = dx1 * dy2 - dx2 * dy1;
  const g = (dx3 * dy2 - dx2 * dy3) / area;
  const h = (dx1 * dy3 - dx3 * dy1) / area;
  const unit = [
    [x1 - x0 + g * x1, x3 - x0 + h * x3, x0],
    [y1 - y0 + g * y1, y3 - y0 + h * y3, y0],
    [g, h, 1],
  ];
  return { homography: unit.map(([a, b, c]) => [a / columns, b / rows, c]), radial: 0, width, height };
}

/** Returns whether four corners go clockwise around a convex area. */
export function areConvex(corners: readonly Point[]): boolean {
  return corners.every(([x, y], index) => {
    const [nextX, nextY] = corners[(index + 1) % 4];
    const [lastX, lastY] = corners[(index + 2) % 4];
    return (nextX - x) * (lastY - nextY) - (nextY - y) * (lastX - nextX) > 0;
  });
}

/** Returns the outline of a cell in pixels. The bend of a lens makes its sides curves. */
export function outlineOf(view: View, row: number, column: number): Point[] {
  const steps = Array.from({ length: 9 }, (_, step) => step / 8);
  const places = [
    ...steps.map((step): Point => [column + step, row]),
    ...steps.map((step): Point => [column + 1, row + step]),
    ...steps.map((step): Point => [column + 1 - step, row + 1]),
    ...steps.map((step): Point => [column, row + 1 - step]),
  ];
  return places.map((place) => pixelOf(view, place));
}

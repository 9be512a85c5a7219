/** Matches the light of photographed tiles: a gain and an offset for each tile, and feathered seams. */
import { EAST, NORTH, SOUTH, WEST, type Grid } from "./network/codes";
import { rint } from "./network/numbers";

/** One tile's picture of size x size pixels, row by row: R, G, B levels, and labels. */
export interface Pixels {
  readonly size: number;
  readonly levels: Uint8ClampedArray;
  readonly labels: Uint8Array;
}

/** Returns the pixels of a picture. Its number is 4 times its index plus its quarter turns counter-clockwise. */
export type PixelsOf = (picture: number) => Pixels;

/** The costs of (255 · (gain - 1))² and of offset², relative to a squared difference of grey levels. */
const GAIN = 1;
const OFFSET = 0.01;
const STRIP = 1 / 2;
const FEATHER = 0.02;
const CLOSE = 1e-9;
const MOST_ROUNDS = 2000;

export function turnedPixels({ size, levels, labels }: Pixels, quarterTurns: number): Pixels {
  const turned = { size, levels: new Uint8ClampedArray(levels.length), labels: new Uint8Array(labels.length) };
  for (let row = 0, to = 0; row < size; row++) {
    for (let column = 0; column < size; column++, to++) {
      let [y, x] = [row, column];
      for (let turn = 0; turn < quarterTurns; turn++) [y, x] = [x, size - 1 - y];
      const from = y * size + x;
      turned.labels[to] = labels[from];
      for (let channel = 0; channel < 3; channel++) turned.levels[3 * to + channel] = levels[3 * from + channel];
    }
  }
  return turned;
}

/** Calls `each` for each pair of linked neighbours, with `south` if the second cell lies to the south. */
function meetings({ height, width, codes }: Grid, each: (one: number, other: number, south: boolean) => void): void {
  codes.forEach((code, cell) => {
    if (cell % width < width - 1 && code & EAST && codes[cell + 1] & WEST) each(cell, cell + 1, false);
    if (cell < (height - 1) * width && code & SOUTH && codes[cell + width] & NORTH) each(cell, cell + width, true);
  });
}

interface Equations {
  /** For each channel, a 4 x 4 matrix and a right side of 4. */
  readonly products: Float64Array;
  readonly sides: Float64Array;
}

/** Returns the equations of a seam, from the strips on both sides. The second picture lies east or south. */
function equationsOf(one: Pixels, other: Pixels, south: boolean): Equations {
  const { size } = one;
  const depth = Math.max(1, Math.round(STRIP * size));
  const products = new Float64Array(48);
  const sides = new Float64Array(12);
  let count = 0;
  for (let along = 0; along < size; along++) {
    for (let away = 0; away < depth; away++) {
      const near = south ? (size - 1 - away) * size + along : along * size + size - 1 - away;
      const far = south ? away * size + along : along * size + away;
      if (!one.labels[near] || one.labels[near] !== other.labels[far]) continue;
      count++;
      for (let channel = 0; channel < 3; channel++) {
        const here = one.levels[3 * near + channel];
        const there = other.levels[3 * far + channel];
        const row = [here / 255, 1, -there / 255, -1];
        for (let y = 0; y < 4; y++) {
          for (let x = 0; x < 4; x++) products[16 * channel + 4 * y + x] += row[y] * row[x];
          sides[4 * channel + y] += row[y] * (there - here);
        }
      }
    }
  }
  const part = 1 / Math.max(count, 1);
  return { products: products.map((value) => value * part), sides: sides.map((value) => value * part) };
}

/**
 * Returns the gain and the offset of each cell and channel, by conjugate gradients.
 *
 * @param pictures the picture of each cell, -1 for none
 * @returns for each channel, gain and offset, cell by cell
 */
export function solveTones(grid: Grid, pictures: ArrayLike<number>, pixelsOf: PixelsOf): Float64Array[] {
  const known = new Map<string, Equations>();
  const seams: { readonly one: number; readonly other: number; readonly equations: Equations }[] = [];
  meetings(grid, (one, other, south) => {
    if (pictures[one] < 0 || pictures[other] < 0) return;
    const key = `${pictures[one]} ${pictures[other]} ${south}`;
    if (!known.has(key)) known.set(key, equationsOf(pixelsOf(pictures[one]), pixelsOf(pictures[other]), south));
    seams.push({ one, other, equations: known.get(key)! });
  });
  return [0, 1, 2].map((channel) => {
    const size = 2 * grid.codes.length;
    const times = (vector: Float64Array): Float64Array => {
      const product = vector.map((value, index) => value * (index % 2 ? OFFSET : GAIN));
      for (const { one, other, equations } of seams) {
        const indices = [2 * one, 2 * one + 1, 2 * other, 2 * other + 1];
        for (let y = 0; y < 4; y++) {
          for (let x = 0; x < 4; x++)
            product[indices[y]] += equations.products[16 * channel + 4 * y + x] * vector[indices[x]];
        }
      }
      return product;
    };
    const rest = new Float64Array(size);
    const scale = Float64Array.from({ length: size }, (_, index) => (index % 2 ? OFFSET : GAIN));
    for (const { one, other, equations } of seams) {
      [2 * one, 2 * one + 1, 2 * other, 2 * other + 1].forEach((index, y) => {
        rest[index] += equations.sides[4 * channel + y];
        scale[index] += equations.products[16 * channel + 5 * y];
      });
    }
    const dot = (a: Float64Array, b: Float64Array): number =>
      a.reduce((sum, value, index) => sum + value * b[index], 0);
    const found = new Float64Array(size);
    let way = rest.map((value, index) => value / scale[index]);
    let product = dot(rest, way);
    const enough = CLOSE * CLOSE * product;
    for (let round = 0; round < MOST_ROUNDS && product > enough; round++) {
      const changed = times(way);
      const step = product / dot(way, changed);
      for (let index = 0; index < size; index++) {
        found[index] += step * way[index];
        rest[index] -= step * changed[index];
      }
      const scaled = rest.map((value, index) => value / scale[index]);
      const next = dot(rest, scaled);
      const more = next / product;
      way = way.map((value, index) => scaled[index] + more * value);
      product = next;
    }
    return found.map((value, index) => (index % 2 ? value : 1 + value / 255));
  });
}

/** Draws a map with matched tiles into `target`, which has R, G, B and opacity. Cells without a picture keep theirs. */
export function paintBlended(
  grid: Grid,
  pictures: ArrayLike<number>,
  compared: PixelsOf,
  pixelsOf: PixelsOf,
  target: Uint8ClampedArray,
): void {
  const { width } = grid;
  const tones = solveTones(grid, pictures, compared);
  const size = pixelsOf(Array.from(pictures).find((picture) => picture >= 0) ?? 0).size;
  const stride = width * size;
  const start = (cell: number): number => Math.floor(cell / width) * size * stride + (cell % width) * size;
  grid.codes.forEach((_, cell) => {
    if (pictures[cell] < 0) return;
    const { levels } = pixelsOf(pictures[cell]);
    const tables = tones.map((values) =>
      Uint8ClampedArray.from({ length: 256 }, (_, level) => rint(level * values[2 * cell] + values[2 * cell + 1])),
    );
    for (let row = 0, from = 0; row < size; row++) {
      for (let to = 4 * (start(cell) + row * stride), end = to + 4 * size; to < end; to += 4) {
        for (let channel = 0; channel < 3; channel++) target[to + channel] = tables[channel][levels[from++]];
      }
    }
  });
  const reach = Math.max(FEATHER * size, 2);
  const shares = Array.from(
    { length: Math.ceil(reach - 0.5) },
    (_, away) => (1 + Math.cos((Math.PI * (away + 0.5)) / reach)) / 4,
  );
  const changes = new Map<number, number>(); // by index in `target`: a pixel near a corner has two
  meetings(grid, (one, other, south) => {
    if (pictures[one] < 0 || pictures[other] < 0) return;
    const [first, second] = [pixelsOf(pictures[one]), pixelsOf(pictures[other])];
    shares.forEach((share, away) => {
      for (let along = 0; along < size; along++) {
        const [y, x, y2, x2] = south ? [size - 1 - away, along, away, along] : [along, size - 1 - away, along, away];
        if (first.labels[y * size + x] !== second.labels[y2 * size + x2]) continue;
        for (let channel = 0; channel < 3; channel++) {
          const left = 4 * (start(one) + y * stride + x) + channel;
          const right = 4 * (start(other) + y2 * stride + x2) + channel;
          const step = share * (target[right] - target[left]);
          changes.set(left, (changes.get(left) ?? 0) + step);
          changes.set(right, (changes.get(right) ?? 0) - step);
        }
      }
    });
  });
  for (const [index, change] of changes) target[index] = rint(target[index] + change);
}

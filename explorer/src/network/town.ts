/** The features of a town. Shares and ratios are in thousandths. */
import { CONNECTIONS, IS_TURN, type Grid } from "./codes";
import { findFaces } from "./faces";
import { neighboursOf } from "./links";
import { gridlockLoop } from "./loops";

/** The names, in the order of Python's `TOWN_FEATURES`. */
export const TOWN_FEATURES = [
  "crossings3",
  "crossings4",
  "largest_block",
  "smallest_block",
  "mean_block",
  "block_spread",
  "small_blocks",
  "loops_per_tile",
  "longest_street",
  "shortest_street",
  "mean_street",
  "border_share",
  "box_fill",
  "box_share",
  "box_length",
  "symmetry",
  "repetition",
  "adjacent_turns_per_tile",
  "signable",
  "gridlock_number",
  "mean_detour",
] as const;
export type TownFeature = (typeof TOWN_FEATURES)[number];

/** The features that are shares, and the features that are ratios. */
export const TOWN_PARTS: readonly string[] = [
  "small_blocks",
  "border_share",
  "box_fill",
  "box_share",
  "symmetry",
  "repetition",
  "signable",
];
export const TOWN_RATIOS: readonly string[] = [
  "mean_block",
  "block_spread",
  "loops_per_tile",
  "mean_street",
  "box_length",
  "adjacent_turns_per_tile",
  "mean_detour",
];

/** The longest sides that Python measures, without and with the mean detour. */
const LONGEST = 128;
const LONGEST_DETOUR = 32;

const sum = (numbers: readonly number[]): number => numbers.reduce((total, one) => total + one, 0);
const least = (numbers: readonly number[]): number => (numbers.length ? Math.min(...numbers) : 0);
const thousandths = (part: number, whole: number): number => Math.floor((1000 * part) / Math.max(whole, 1));

/** Returns the features of a town, without features that are not defined for its size. */
export function measureTown(grid: Grid): Partial<Record<TownFeature, number>> {
  const { height, width, codes } = grid;
  if (Math.max(height, width) > LONGEST) return {};
  const areas = blockAreas(grid);
  const area = sum(areas);
  const blocks = areas.length;
  const streets = streetLengths(grid);
  const tiles = codes.reduce((count, code) => count + +(code > 0), 0);
  const rows = range(height, (row) => codes.subarray(row * width, (row + 1) * width).some((code) => code > 0));
  const columns = range(width, (column) => range(height, (row) => codes[row * width + column] > 0).includes(true));
  const north = rows.indexOf(true);
  const south = rows.lastIndexOf(true);
  const west = columns.indexOf(true);
  const east = columns.lastIndexOf(true);
  const high = tiles ? south - north + 1 : 0;
  const wide = tiles ? east - west + 1 : 0;
  let border = 0;
  let turnPairs = 0;
  const alike = [0, 0, 0];
  codes.forEach((code, cell) => {
    const row = Math.floor(cell / width);
    const column = cell % width;
    if (code && (row === north || row === south || column === west || column === east)) border++;
    if (IS_TURN[code])
      turnPairs +=
        +(column + 1 < width && IS_TURN[codes[cell + 1]]) + +(row + 1 < height && IS_TURN[codes[cell + width]]);
    if (row < north || row > south || column < west || column > east) return;
    const back = north + south - row;
    const across = west + east - column;
    [back * width + column, row * width + across, back * width + across].forEach((image, kind) => {
      if (!codes[image] === !code) alike[kind]++;
    });
  });
  return {
    crossings3: codes.filter((code) => CONNECTIONS[code] === 3).length,
    crossings4: codes.filter((code) => CONNECTIONS[code] === 4).length,
    largest_block: Math.max(0, ...areas),
    smallest_block: least(areas),
    mean_block: thousandths(area, blocks),
    block_spread: thousandths(sum(areas.map((one) => Math.abs(one * blocks - area))), blocks * area),
    small_blocks: thousandths(areas.filter((one) => one <= 4).length, blocks),
    loops_per_tile: thousandths(blocks, tiles),
    longest_street: Math.max(0, ...streets),
    shortest_street: least(streets),
    mean_street: thousandths(sum(streets), streets.length),
    border_share: thousandths(border, tiles),
    box_fill: thousandths(tiles, high * wide),
    box_share: thousandths(high * wide, codes.length),
    box_length: thousandths(Math.max(high, wide), Math.min(high, wide)),
    symmetry: tiles ? thousandths(Math.max(...alike), high * wide) : 0,
    repetition: thousandths(repeated(grid), tiles),
    adjacent_turns_per_tile: thousandths(turnPairs, tiles),
    signable: signable(grid),
    gridlock_number: Math.max(gridlockLoop(grid).length - 1, 0),
    ...(Math.max(height, width) <= LONGEST_DETOUR && { mean_detour: meanDetour(grid) }),
  };
}

function range<T>(count: number, make: (index: number) => T): T[] {
  return Array.from({ length: count }, (_, index) => make(index));
}

/** Returns the part of the crossings without a road at a corner. */
function signable(grid: Grid): number {
  const { height, width, codes } = grid;
  const crossings = neighboursOf(grid).flatMap((linked, cell) => (linked.length > 2 ? [cell] : []));
  const free = crossings.filter((cell) => {
    const row = Math.floor(cell / width);
    const column = cell % width;
    return [row - 1, row + 1].every((r) =>
      [column - 1, column + 1].every((c) => r < 0 || c < 0 || r >= height || c >= width || !codes[r * width + c]),
    );
  });
  return crossings.length ? thousandths(free.length, crossings.length) : 1000;
}

/** Returns the number of times that each label occurs. Negative labels do not count. */
function sizes(labels: Iterable<number>): number[] {
  const counts = new Map<number, number>();
  for (const label of labels) if (label >= 0) counts.set(label, (counts.get(label) ?? 0) + 1);
  return [...counts.values()];
}

/** Returns the area of each inner face: its number of corners. */
function blockAreas(grid: Grid): number[] {
  return sizes(findFaces(grid).root.map((face) => face || -1));
}

/** Returns the number of links of each street. A street ends at a crossing or a dead end. */
function streetLengths(grid: Grid): number[] {
  const neighbours = neighboursOf(grid);
  const seen = new Set<number>();
  const key = (one: number, other: number): number => Math.min(one, other) * grid.codes.length + Math.max(one, other);
  const lengths: number[] = [];
  neighbours.forEach((others, start) =>
    others.forEach((first) => {
      if (seen.has(key(start, first))) return;
      let length = 0;
      const waiting: [number, number][] = [[start, first]];
      while (waiting.length) {
        const [one, other] = waiting.pop()!;
        if (seen.has(key(one, other))) continue;
        seen.add(key(one, other));
        length++;
        for (const end of [one, other])
          if (neighbours[end].length === 2)
            waiting.push(...neighbours[end].map((next) => [end, next] as [number, number]));
      }
      lengths.push(length);
    }),
  );
  return lengths;
}

/** Counts the tiles whose 3 x 3 cells equal another tile's. Cells outside the grid are empty. */
function repeated({ height, width, codes }: Grid): number {
  const keys: number[] = [];
  codes.forEach((code, cell) => {
    if (!code) return;
    const row = Math.floor(cell / width);
    const column = cell % width;
    let key = 0;
    for (let y = row - 1; y <= row + 1; y++) {
      for (let x = column - 1; x <= column + 1; x++)
        key = key * 16 + (y >= 0 && y < height && x >= 0 && x < width ? codes[y * width + x] : 0);
    }
    keys.push(key);
  });
  return sum(sizes(keys).filter((count) => count > 1));
}

/** Divides the lengths of all shortest ways by their lengths on a full grid of streets. */
function meanDetour(grid: Grid): number {
  const { width, codes } = grid;
  const neighbours = neighboursOf(grid);
  const length = new Int32Array(codes.length);
  const queue = new Int32Array(codes.length);
  let ways = 0;
  let straight = 0;
  for (let start = 0; start < codes.length; start++) {
    length.fill(-1);
    length[start] = 0;
    queue[0] = start;
    for (let head = 0, tail = 1; head < tail; head++) {
      const cell = queue[head];
      ways += length[cell];
      straight +=
        Math.abs(Math.floor(cell / width) - Math.floor(start / width)) + Math.abs((cell % width) - (start % width));
      for (const next of neighbours[cell]) {
        if (length[next] >= 0) continue;
        length[next] = length[cell] + 1;
        queue[tail++] = next;
      }
    }
  }
  return thousandths(ways, straight);
}

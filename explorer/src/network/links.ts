/** The links of tiles, and the roads that they make. */
import { CONNECTIONS, EAST, NORTH, SIDES, SOUTH, WEST, type Grid } from "./codes";

/** For each cell, the sides by which its tile is linked, as indices of `SIDES`: clockwise from north. */
export type Links = readonly (readonly number[])[];

/** Returns whether the neighbour on one side of a cell has a connection to the cell. */
export function isReturned({ height, width, codes }: Grid, cell: number, side: (typeof SIDES)[number]): boolean {
  const row = Math.floor(cell / width) + side.down;
  const column = (cell % width) + side.right;
  const isInside = row >= 0 && row < height && column >= 0 && column < width;
  return isInside && (codes[row * width + column] & side.opposite) > 0;
}

export function linksOf(grid: Grid): Links {
  const isLinked = (code: number, cell: number, side: number): boolean =>
    (code & SIDES[side].bit) > 0 && isReturned(grid, cell, SIDES[side]);
  return Array.from(grid.codes, (code, cell) => [0, 1, 2, 3].filter((side) => isLinked(code, cell, side)));
}

/** Returns the linked neighbours of each cell. */
export function neighboursOf({ height, width, codes }: Grid): number[][] {
  const found: number[][] = Array.from(codes, () => []);
  codes.forEach((code, cell) => {
    const pairs = [
      [cell % width < width - 1 && code & EAST && codes[cell + 1] & WEST, cell + 1],
      [cell < (height - 1) * width && code & SOUTH && codes[cell + width] & NORTH, cell + width],
    ] as const;
    for (const [linked, other] of pairs) {
      if (!linked) continue;
      found[cell].push(other);
      found[other].push(cell);
    }
  });
  return found;
}

/** Returns the cells where roads end: they have one connection, or one that no neighbour returns. */
export function roadEnds(grid: Grid): number[] {
  return [...grid.codes.keys()].filter((cell) => {
    const code = grid.codes[cell];
    return CONNECTIONS[code] === 1 || SIDES.some((side) => code & side.bit && !isReturned(grid, cell, side));
  });
}

/**
 * Lists the cells of each road from end to end, with both; each road once. A road ends where a tile has other than two
 * links. Rings come last. The order is that of Python's `walk_roads`.
 */
export function roadsOf(links: Links, { width, codes }: Grid): number[][] {
  const roads: number[][] = [];
  const walked = new Set<number>(); // the last steps of roads: they are first steps from the other end
  const passed = new Set<number>();
  const next = (cell: number, side: number): number => cell + SIDES[side].down * width + SIDES[side].right;
  const stepOf = (cell: number, side: number): number => 4 * cell + side;
  const isEnd = (cell: number): boolean => links[cell].length !== 2;

  const walk = (start: number, ends: (cell: number) => boolean): void => {
    for (const first of links[start]) {
      if (walked.has(stepOf(start, first))) continue;
      const road = [start];
      let side = first;
      for (;;) {
        const cell = next(road[road.length - 1], side);
        const back = (side + 2) % 4;
        road.push(cell);
        passed.add(cell);
        if (ends(cell)) {
          walked.add(stepOf(cell, back));
          break;
        }
        side = links[cell].find((other) => other !== back)!;
      }
      roads.push(road);
    }
  };

  const cells = [...codes.keys()].filter((cell) => codes[cell] > 0);
  for (const cell of cells.filter(isEnd)) walk(cell, isEnd);
  for (const cell of cells.filter((one) => !isEnd(one))) if (!passed.has(cell)) walk(cell, (other) => other === cell);
  return roads;
}

/** Tile codes: the sum of 8 (north), 4 (east), 2 (south) and 1 (west) for the sides that a tile connects to. */

export const NORTH = 8;
export const EAST = 4;
export const SOUTH = 2;
export const WEST = 1;

/** A grid of codes, row by row, north first. */
export interface Grid {
  readonly height: number;
  readonly width: number;
  readonly codes: Uint8Array;
}

/** The sides clockwise: the bit, the step to the neighbour, and the bit of the neighbour's side that faces it. */
export const SIDES = [
  { bit: NORTH, down: -1, right: 0, opposite: SOUTH, name: "north" },
  { bit: EAST, down: 0, right: 1, opposite: WEST, name: "east" },
  { bit: SOUTH, down: 1, right: 0, opposite: NORTH, name: "south" },
  { bit: WEST, down: 0, right: -1, opposite: EAST, name: "west" },
] as const;

/** The number of connections of each code. */
export const CONNECTIONS = Uint8Array.from(
  { length: 16 },
  (_, code) => [8, 4, 2, 1].filter((bit) => code & bit).length,
);

/** 1 for each code that is a turn: two connections on neighbouring sides. */
export const IS_TURN = Uint8Array.from({ length: 16 }, (_, code) => +[3, 6, 9, 12].includes(code));

export const KIND_OF = Array.from({ length: 16 }, (_, code) => {
  const connections = CONNECTIONS[code];
  if (connections === 2) return IS_TURN[code] ? "turn" : "straight";
  return ["empty", "dead end", "", "three-way crossing", "four-way crossing"][connections];
});

/** Rotates a code counter-clockwise by quarter turns: N becomes W. */
export function rotateCode(code: number, quarterTurns: number): number {
  for (let turn = 0; turn < quarterTurns % 4; turn++) code = ((code << 1) & 15) | (code >> 3);
  return code;
}

export function emptyGrid(height: number, width: number): Grid {
  return { height, width, codes: new Uint8Array(height * width) };
}

export function gridOf(rows: readonly (readonly number[])[]): Grid {
  return { height: rows.length, width: rows[0].length, codes: Uint8Array.from(rows.flat()) };
}

export function rowsOf(grid: Grid): number[][] {
  return Array.from({ length: grid.height }, (_, row) =>
    Array.from(grid.codes.subarray(row * grid.width, (row + 1) * grid.width)),
  );
}

export function sameGrid(one: Grid, other: Grid): boolean {
  return (
    one.height === other.height &&
    one.width === other.width &&
    one.codes.every((code, cell) => code === other.codes[cell])
  );
}

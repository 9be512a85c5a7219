/**
 * The planar dual of a grid: the corners between tiles. Two corners belong to one face if no link separates them.
 *
 * Inner corner (r, c) lies south-east of tile (r, c). Its index is 1 + r·(W - 1) + c. All corners on the border have
 * index 0, the outer face. The cyclomatic number is the number of inner faces. A link is a bridge if the same face lies
 * on both of its sides.
 */
import { EAST, NORTH, SOUTH, WEST, type Grid } from "./codes";

export interface Faces {
  /** For each corner, the first corner of its face. */
  readonly root: Int32Array;
  /** The number of inner faces. */
  readonly count: number;
}

let labels = new Int32Array(0);

/** Joins the faces of two corners; returns 1 if they were different. The smaller label remains. */
function join(parents: Int32Array, one: number, other: number): number {
  while (parents[one] !== one) one = parents[one] = parents[parents[one]];
  while (parents[other] !== other) other = parents[other] = parents[parents[other]];
  if (one < other) parents[other] = one;
  else parents[one] = other;
  return one === other ? 0 : 1;
}

/** Labels each corner with the first corner of its face. The next call overwrites the array. */
function label({ height, width, codes }: Grid): [labels: Int32Array, faces: number] {
  const stride = width - 1;
  const inner = (height - 1) * stride;
  if (labels.length <= inner) labels = new Int32Array(inner + 1);
  const parents = labels;
  for (let corner = 0; corner <= inner; corner++) parents[corner] = corner;
  let faces = inner;
  for (let row = 0, cell = 0; row < height; row++) {
    const above = 1 + (row - 1) * stride;
    for (let column = 0; column < width; column++, cell++) {
      const corner = above + stride + column; // south-east of the tile; only inner corners have one
      if (column < stride && !(codes[cell] & EAST && codes[cell + 1] & WEST)) {
        faces -= join(parents, row > 0 ? corner - stride : 0, row < height - 1 ? corner : 0);
      }
      if (row < height - 1 && !(codes[cell] & SOUTH && codes[cell + width] & NORTH)) {
        faces -= join(parents, column > 0 ? corner - 1 : 0, column < stride ? corner : 0);
      }
    }
  }
  for (let corner = 1; corner <= inner; corner++) parents[corner] = parents[parents[corner]]; // a parent comes first
  return [parents, faces];
}

/** Finds the faces of a grid. */
export function findFaces(grid: Grid): Faces {
  const [root, count] = label(grid);
  return { root: root.slice(0, (grid.height - 1) * (grid.width - 1) + 1), count };
}

/** Counts inner faces and bridges. Calls `each` with the cell and the side of each bridge. */
export function countFaces(grid: Grid, each?: (cell: number, side: number) => void): [faces: number, bridges: number] {
  const { height, width, codes } = grid;
  const [face, faces] = label(grid);
  const stride = width - 1;
  let bridges = 0;
  for (let row = 0, cell = 0; row < height; row++) {
    for (let column = 0; column < width; column++, cell++) {
      const corner = 1 + row * stride + column;
      if (column < stride && codes[cell] & EAST && codes[cell + 1] & WEST) {
        if ((row > 0 ? face[corner - stride] : 0) === (row < height - 1 ? face[corner] : 0)) {
          bridges++;
          each?.(cell, EAST);
        }
      }
      if (row < height - 1 && codes[cell] & SOUTH && codes[cell + width] & NORTH) {
        if ((column > 0 ? face[corner - 1] : 0) === (column < stride ? face[corner] : 0)) {
          bridges++;
          each?.(cell, SOUTH);
        }
      }
    }
  }
  return [faces, bridges];
}

/**
 * The planar dual of a grid: the corner points between tiles, joined where no link lies between them.
 *
 * Inner corner (r, c) lies south-east of tile (r, c) and has the number 1 + r·(W - 1) + c; all corners on the border are
 * the outer face, number 0. The cyclomatic number is the number of inner faces, and a link is a bridge if the same face
 * lies on both its sides.
 */
import { EAST, NORTH, SOUTH, WEST, type Grid } from "./codes";

export interface Faces {
  /** Of each corner, a corner that all of its face have in common. */
  readonly root: Int32Array;
  /** The number of inner faces. */
  readonly count: number;
}

let labels = new Int32Array(0);

/** Joins two corners, the larger label to the smaller; tells whether they were apart. */
function join(parents: Int32Array, one: number, other: number): number {
  while (parents[one] !== one) one = parents[one] = parents[parents[one]];
  while (parents[other] !== other) other = parents[other] = parents[parents[other]];
  if (one < other) parents[other] = one;
  else parents[one] = other;
  return one === other ? 0 : 1;
}

/** Labels the corners of a grid with the least of their face, in a vector that the next call writes to again. */
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
      const corner = above + stride + column; // south-east of the tile, if it is an inner one
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

/** Counts the inner faces and the bridges of a grid; calls `each` with the cell and the side of each bridge. */
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

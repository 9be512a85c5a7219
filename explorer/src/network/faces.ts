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

let parents = new Int32Array(0);

function find(corner: number): number {
  while (parents[corner] !== corner) {
    parents[corner] = parents[parents[corner]];
    corner = parents[corner];
  }
  return corner;
}

/** Joins the corners of a grid; the result lies in a vector that the next call writes to again. */
function join(grid: Grid): number {
  const { height, width, codes } = grid;
  const inner = (height - 1) * (width - 1);
  if (parents.length <= inner) parents = new Int32Array(inner + 1);
  for (let corner = 0; corner <= inner; corner++) parents[corner] = corner;
  let faces = inner;
  const stride = width - 1;
  const connect = (one: number, other: number) => {
    const first = find(one);
    const second = find(other);
    if (first !== second) {
      faces--;
      if (first < second) parents[second] = first;
      else parents[first] = second;
    }
  };
  for (let row = 0; row < height; row++) {
    for (let column = 0; column < width; column++) {
      const place = row * width + column;
      if (column < stride && !(codes[place] & EAST && codes[place + 1] & WEST)) {
        const above = row > 0 ? 1 + (row - 1) * stride + column : 0;
        const below = row < height - 1 ? 1 + row * stride + column : 0;
        if (above !== below) connect(above, below);
      }
      if (row < height - 1 && !(codes[place] & SOUTH && codes[place + width] & NORTH)) {
        const left = column > 0 ? row * stride + column : 0;
        const right = column < stride ? 1 + row * stride + column : 0;
        if (left !== right) connect(left, right);
      }
    }
  }
  return faces;
}

/** Finds the faces of a grid. */
export function findFaces(grid: Grid): Faces {
  const count = join(grid);
  const inner = (grid.height - 1) * (grid.width - 1);
  return { root: Int32Array.from({ length: inner + 1 }, (_, corner) => find(corner)), count };
}

/** Counts the inner faces and the bridges of a grid; calls `each` with the place and the side of each bridge. */
export function countFaces(grid: Grid, each?: (place: number, side: number) => void): [faces: number, bridges: number] {
  const faces = join(grid);
  const { height, width, codes } = grid;
  const stride = width - 1;
  let bridges = 0;
  for (let row = 0; row < height; row++) {
    for (let column = 0; column < width; column++) {
      const place = row * width + column;
      if (column < stride && codes[place] & EAST && codes[place + 1] & WEST) {
        const above = row > 0 ? find(1 + (row - 1) * stride + column) : 0;
        const below = row < height - 1 ? find(1 + row * stride + column) : 0;
        if (above === below) {
          bridges++;
          each?.(place, EAST);
        }
      }
      if (row < height - 1 && codes[place] & SOUTH && codes[place + width] & NORTH) {
        const left = column > 0 ? find(row * stride + column) : 0;
        const right = column < stride ? find(1 + row * stride + column) : 0;
        if (left === right) {
          bridges++;
          each?.(place, SOUTH);
        }
      }
    }
  }
  return [faces, bridges];
}

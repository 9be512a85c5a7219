/** The repair of a grid: neighbours agree on their links, and no road crosses the border. */
import { CONNECTIONS, EAST, NORTH, SOUTH, WEST, type Grid } from "./codes";

type Bytes = Uint8Array<ArrayBuffer>;

export interface RepairOptions {
  /** The tiles that win where neighbours disagree, by default none. */
  readonly dirty?: ArrayLike<number | boolean>;
  /** The tiles that must not change. */
  readonly fixed?: ArrayLike<number | boolean>;
  /** Whether tiles with fewer than two connections get more. */
  readonly fill?: boolean;
}

/** Returns a repaired grid. A grid that is one tile wide is never filled. */
export function repair(grid: Grid, { dirty, fixed, fill = false }: RepairOptions = {}): Grid {
  const { height, width, codes } = grid;
  const cells = height * width;
  let links = new Uint8Array(cells);
  const room = new Uint8Array(cells);
  for (let cell = 0; cell < cells; cell++) {
    for (const [bit, opposite, step, inside] of [
      [EAST, WEST, 1, cell % width < width - 1],
      [SOUTH, NORTH, width, cell < cells - width],
    ] as const) {
      if (!inside) continue;
      const other = cell + step;
      const here = fixed ? !!fixed[cell] : false;
      const there = fixed ? !!fixed[other] : false;
      const free = !here && !there;
      const mine = dirty ? !!dirty[cell] : false;
      const theirs = dirty ? !!dirty[other] : false;
      const wins = (here && !there) || (free && mine && !theirs);
      const loses = (there && !here) || (free && theirs && !mine);
      if ((codes[cell] & bit && !loses) || (codes[other] & opposite && !wins)) links[cell] |= bit;
      if (free) room[cell] |= bit;
    }
  }
  if (fill && Math.min(height, width) > 1) links = filled(links, room, width);
  return { height, width, codes: bothEnds(links, width) };
}

/** Returns the codes of tiles whose links to the east and south are given. */
function bothEnds(links: Bytes, width: number): Bytes {
  return links.map(
    (link, cell) =>
      link |
      (cell % width > 0 && links[cell - 1] & EAST ? WEST : 0) |
      (cell >= width && links[cell - width] & SOUTH ? NORTH : 0),
  );
}

/** Adds links to tiles with fewer than two: first straight ahead, then east, south, west and north. */
function filled(links: Bytes, room: Bytes, width: number): Bytes {
  for (let stage = 0; stage < 5; stage++) {
    const codes = bothEnds(links, width);
    const needy = codes.map((code) => +(CONNECTIONS[code] < 2));
    links = links.map((link, cell) => {
      let added = 0;
      const after = cell + 1 < links.length ? cell + 1 : -1;
      const below = cell + width < links.length ? cell + width : -1;
      if (stage === 0) {
        if (needy[cell]) added |= (codes[cell] & WEST ? EAST : 0) | (codes[cell] & NORTH ? SOUTH : 0);
        if (after >= 0 && needy[after]) added |= codes[after] & EAST;
        if (below >= 0 && needy[below]) added |= codes[below] & SOUTH;
      } else if (stage === 1) added = needy[cell] ? EAST : 0;
      else if (stage === 2) added = needy[cell] ? SOUTH : 0;
      else if (stage === 3) added = after >= 0 && needy[after] ? EAST : 0;
      else added = below >= 0 && needy[below] ? SOUTH : 0;
      return link | (added & room[cell]);
    });
  }
  return links;
}

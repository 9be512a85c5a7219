/** The repair of a grid, equal to the Python package's `repair`: every connection returned, none across the border. */
import { CONNECTIONS, EAST, NORTH, SOUTH, WEST, type Grid } from "./codes";

type Bytes = Uint8Array<ArrayBuffer>;

export interface RepairOptions {
  /** The tiles that decide about links on which neighbours disagree; none by default. */
  readonly dirty?: ArrayLike<number | boolean>;
  /** Tiles that stay as they are. */
  readonly fixed?: ArrayLike<number | boolean>;
  /** Whether tiles with fewer than two connections get more. */
  readonly fill?: boolean;
}

/** Repairs a grid; one that is one tile wide cannot be filled and is only matched. */
export function repair(grid: Grid, { dirty, fixed, fill = false }: RepairOptions = {}): Grid {
  const { height, width, codes } = grid;
  const cells = height * width;
  let links = new Uint8Array(cells);
  const room = new Uint8Array(cells);
  for (let place = 0; place < cells; place++) {
    for (const [bit, opposite, step, inside] of [
      [EAST, WEST, 1, place % width < width - 1],
      [SOUTH, NORTH, width, place < cells - width],
    ] as const) {
      if (!inside) continue;
      const other = place + step;
      const here = fixed ? !!fixed[place] : false;
      const there = fixed ? !!fixed[other] : false;
      const free = !here && !there;
      const mine = dirty ? !!dirty[place] : false;
      const theirs = dirty ? !!dirty[other] : false;
      const wins = (here && !there) || (free && mine && !theirs);
      const loses = (there && !here) || (free && theirs && !mine);
      if ((codes[place] & bit && !loses) || (codes[other] & opposite && !wins)) links[place] |= bit;
      if (free) room[place] |= bit;
    }
  }
  if (fill && Math.min(height, width) > 1) links = filled(links, room, width);
  return { height, width, codes: bothEnds(links, width) };
}

/** Returns the codes of tiles with links to the east and south. */
function bothEnds(links: Bytes, width: number): Bytes {
  return links.map(
    (link, place) =>
      link |
      (place % width > 0 && links[place - 1] & EAST ? WEST : 0) |
      (place >= width && links[place - width] & SOUTH ? NORTH : 0),
  );
}

/** Adds links to tiles with fewer than two: stubs are continued straight ahead, then one direction after another. */
function filled(links: Bytes, room: Bytes, width: number): Bytes {
  for (let stage = 0; stage < 5; stage++) {
    const codes = bothEnds(links, width);
    const needy = codes.map((code) => +(CONNECTIONS[code] < 2));
    links = links.map((link, place) => {
      let added = 0;
      const after = place + 1 < links.length ? place + 1 : -1;
      const below = place + width < links.length ? place + width : -1;
      if (stage === 0) {
        if (needy[place]) added |= (codes[place] & WEST ? EAST : 0) | (codes[place] & NORTH ? SOUTH : 0);
        if (after >= 0 && needy[after]) added |= codes[after] & EAST;
        if (below >= 0 && needy[below]) added |= codes[below] & SOUTH;
      } else if (stage === 1) added = needy[place] ? EAST : 0;
      else if (stage === 2) added = needy[place] ? SOUTH : 0;
      else if (stage === 3) added = after >= 0 && needy[after] ? EAST : 0;
      else added = below >= 0 && needy[below] ? SOUTH : 0;
      return link | (added & room[place]);
    });
  }
  return links;
}

/** A shelf: the number of tiles of each kind that a lab has, as `--inventory` takes it. */
import { CONNECTIONS, IS_TURN, type Grid } from "./codes";

/** The kinds of tiles in the order of Python's `COUNTED`: the name of one and of several, and a code. */
export const TILE_KINDS = [
  { kind: "straight", name: "straight", names: "straights", code: 10 },
  { kind: "turn", name: "turn", names: "turns", code: 3 },
  { kind: "crossing3", name: "three-way crossing", names: "three-way crossings", code: 11 },
  { kind: "crossing4", name: "four-way crossing", names: "four-way crossings", code: 15 },
] as const;

/** A number for each of `TILE_KINDS`. */
export type Shelf = readonly number[];

/** Returns the number of tiles of each kind on a map. Dead ends are of no kind. */
export function usedTiles({ codes }: Grid): Shelf {
  const counts = TILE_KINDS.map(() => 0);
  for (const code of codes) {
    const connections = CONNECTIONS[code];
    if (connections === 2) counts[IS_TURN[code]]++;
    else if (connections > 2) counts[connections - 1]++;
  }
  return counts;
}

/** Writes a shelf as `--inventory` takes it. */
export const inventoryText = (shelf: Shelf): string =>
  TILE_KINDS.map(({ kind }, index) => `${kind}=${shelf[index]}`).join(" ");

/** Reads a shelf from numbers by kind, as the record of a run has them; returns null for anything else. */
export function shelfFrom(inventory: unknown): Shelf | null {
  if (!inventory || typeof inventory !== "object") return null;
  const counts = inventory as Readonly<Record<string, unknown>>;
  return TILE_KINDS.map(({ kind }) => (typeof counts[kind] === "number" ? counts[kind] : 0));
}

/** The tiles and the tape that it takes to build a map. */
import { describeCell } from "./cells";
import { rotateCode, type Grid } from "./codes";
import { check, FileError } from "./errors";
import { roadEnds } from "./links";
import { roundTo } from "./numbers";

/** A strip of tape on a tile: its colour, its middle line and its length. */
export type TapeValues = readonly [
  colour: string,
  points: readonly (readonly [x: number, y: number])[],
  metres: number,
];

/** What Python says of Duckietown's tiles. Lengths are in metres. */
export interface PlanValues {
  readonly tile_size: number;
  /** The longest side of maps that have a plan, in tiles. */
  readonly longest: number;
  /** The width of tape by colour. */
  readonly widths: Readonly<Record<string, number>>;
  /** The kinds of tiles: each has its code and tapes without a rotation. */
  readonly kinds: Readonly<
    Record<
      string,
      {
        readonly code: number;
        readonly tapes: readonly TapeValues[];
      }
    >
  >;
}

export interface PlacedTile {
  readonly row: number;
  readonly column: number;
  readonly kind: string;
  /** Counter-clockwise. */
  readonly quarterTurns: number;
}

export interface Plan {
  readonly placed: readonly PlacedTile[];
  /** The number of tiles by kind. */
  readonly tiles: Readonly<Record<string, number>>;
  /** Metres by colour, rounded to millimetres as those of `make_plan`. */
  readonly tape: Readonly<Record<string, number>>;
}

/** Lists the tiles and the tape of a map. */
export function planOf({ height, width, codes }: Grid, { kinds, widths, longest }: PlanValues): Plan {
  check(codes.some(Boolean), "A plan needs a map with roads");
  check(Math.max(height, width) <= longest, `A plan has at most ${longest} × ${longest} tiles`);
  const [end] = roadEnds({ height, width, codes });
  if (end !== undefined) {
    const cell = describeCell(Math.floor(end / width), end % width);
    throw new FileError(`Duckietown has no tile for the dead end at ${cell}; mend the map first`);
  }
  const placed: PlacedTile[] = [];
  codes.forEach((code, cell) => {
    if (code) placed.push({ row: Math.floor(cell / width), column: cell % width, ...tileOf(code, kinds) });
  });
  const tiles: Record<string, number> = Object.fromEntries(Object.keys(kinds).map((kind) => [kind, 0]));
  const tape: Record<string, number> = Object.fromEntries(Object.keys(widths).map((colour) => [colour, 0]));
  for (const { kind } of placed) tiles[kind]++;
  for (const [kind, { tapes }] of Object.entries(kinds)) {
    for (const [colour, , metres] of tapes) tape[colour] += tiles[kind] * metres;
  }
  for (const colour of Object.keys(tape)) tape[colour] = roundTo(tape[colour], 3);
  return { placed, tiles, tape };
}

/** Returns the kind of a tile without dead ends, and the fewest turns that give its code. */
function tileOf(code: number, kinds: PlanValues["kinds"]): Pick<PlacedTile, "kind" | "quarterTurns"> {
  const tiles = Object.entries(kinds).map(([kind, { code: upright }]) => ({
    kind,
    quarterTurns: [0, 1, 2, 3].findIndex((turns) => rotateCode(upright, turns) === code),
  }));
  return tiles.find(({ quarterTurns }) => quarterTurns >= 0)!;
}

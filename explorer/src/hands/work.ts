/** What the page corrects, and the requests to the command that serves it. */
import { KIND_OF } from "../network/codes";
import { pack, painted, unpack, type Colour, type Colours, type Mask, type MaskName, type Strokes } from "./masks";
import type { Point, View } from "./view";

/** The values of `Proposal` in photographs/proposals.py that the page reads. */
export interface Proposal extends View {
  readonly corners: readonly Point[];
  readonly codes: readonly (readonly number[])[];
  readonly sure: readonly (readonly number[])[];
  readonly score: number;
  readonly advice: string;
}

export interface Photograph {
  readonly name: string;
  readonly width: number;
  readonly height: number;
  readonly rows: number;
  readonly columns: number;
  readonly proposal: Proposal | null;
  /** Why there is no proposal. */
  readonly advice: string;
  /** The codes that the user has set, by row and column. A new fit keeps them. */
  readonly corrected?: readonly (readonly [row: number, column: number, code: number])[];
}

export interface Tile {
  readonly id: string;
  readonly name: string;
  readonly kind: string;
  readonly side: number;
  readonly base: Readonly<Record<MaskName, Mask>>;
  readonly strokes: Readonly<Record<MaskName, Strokes | null>>;
  readonly colours: Colours;
  /** Whether `base` is what `colours` propose. A mask that was read from a file is usually another one. */
  readonly byColours: Readonly<Record<MaskName, boolean>>;
  /** The photograph that the tile was cut from, or null. */
  readonly photograph: number | null;
  readonly leftOut: boolean;
}

export interface Work {
  readonly tiles: readonly Tile[];
  readonly photographs: readonly Photograph[];
}

export interface Saved {
  readonly names: readonly string[];
  readonly kept: string | null;
  readonly problems: readonly string[];
}

/** A tile as the server gives it. */
interface ServedTile extends Pick<Tile, "id" | "name" | "kind" | "side"> {
  readonly masks: Readonly<Record<MaskName, string>>;
  readonly by_colours: Readonly<Record<MaskName, boolean>>;
}

export interface Served {
  readonly folder: string;
  readonly colours: Colours;
  readonly tiles: readonly ServedTile[];
  readonly photographs: readonly Photograph[];
  readonly problems: readonly string[];
}

/** The least score of a proposal or a cell that is sure, as in photographs/_judging.py. */
export const SURE = 0.5;

/** The kinds by the names of their folders, and the codes of each, turned counter-clockwise from one to the next. */
export const KINDS: Readonly<Record<string, readonly number[]>> = {
  straight: [10, 5],
  turn: [6, 12, 9, 3],
  crossing3: [7, 14, 13, 11],
  crossing4: [15],
  end: [2, 4, 8, 1],
};
export const kindOfCode = (code: number): string =>
  Object.keys(KINDS).find((kind) => KINDS[kind].includes(code)) ?? "empty";
export const kindWord = (kind: string): string => (kind in KINDS ? KIND_OF[KINDS[kind][0]] : "no tile");

const byMask = <T>(make: (mask: MaskName) => T): Record<MaskName, T> => ({
  road: make("road"),
  red: make("red"),
  yellow: make("yellow"),
});

export function tileOf(served: ServedTile, colours: Colours, photograph: number | null): Tile {
  const { masks, by_colours: byColours, ...tile } = served;
  const base = byMask((mask) => unpack(masks[mask], tile.side));
  return { ...tile, base, strokes: byMask(() => null), colours, byColours, photograph, leftOut: false };
}

/** Returns the tile with the mask that other colours propose. */
export function coloured(tile: Tile, mask: MaskName, colour: Colour, bits: string): Tile {
  return {
    ...tile,
    base: { ...tile.base, [mask]: unpack(bits, tile.side) },
    colours: { ...tile.colours, [mask]: colour },
    byColours: { ...tile.byColours, [mask]: true },
  };
}

/** Returns the tiles with the masks that one colour proposes. `bits` has the masks by the ids of the tiles. */
export const allColoured = (
  tiles: readonly Tile[],
  mask: MaskName,
  colour: Colour,
  bits: ReadonlyMap<string, string>,
): readonly Tile[] =>
  tiles.map((tile) => (bits.has(tile.id) ? coloured(tile, mask, colour, bits.get(tile.id)!) : tile));

/** Returns the tiles and new ones. New tiles whose names are taken get the next name of their kind. */
export function joined(tiles: readonly Tile[], fresh: readonly Tile[]): readonly Tile[] {
  const names = new Set(tiles.map(({ name }) => name));
  const renamed = fresh.map((tile) => {
    let name = tile.name;
    for (let number = 1; names.has(name); number++) name = `${tile.kind}_${number}`;
    names.add(name);
    return { ...tile, name };
  });
  return [...tiles, ...renamed];
}

/** Returns the masks of a tile with what the brush has changed. */
export const masksOf = (tile: Tile) => byMask((mask) => painted(tile.base[mask], tile.strokes[mask]));

/** Returns the tiles as the server saves them. */
export const toSave = (tiles: readonly Tile[]) =>
  tiles
    .filter((tile) => !tile.leftOut)
    .map((tile) => {
      const masks = masksOf(tile);
      return { id: tile.id, name: tile.name, kind: tile.kind, masks: byMask((mask) => pack(masks[mask])) };
    });

/** Returns the proposal with another code in one cell, which is sure then. */
export function withCode(proposal: Proposal, row: number, column: number, code: number): Proposal {
  const changed = (rows: readonly (readonly number[])[], value: number) =>
    rows.map((cells, y) => (y === row ? cells.map((cell, x) => (x === column ? value : cell)) : cells));
  return { ...proposal, codes: changed(proposal.codes, code), sure: changed(proposal.sure, 1) };
}

/** Returns the photograph with the code that the user sets in one cell. */
export function corrected(photograph: Photograph, row: number, column: number, code: number): Photograph {
  const { proposal, corrected: earlier = [] } = photograph;
  if (!proposal) return photograph;
  return {
    ...photograph,
    proposal: withCode(proposal, row, column, code),
    corrected: [...earlier, [row, column, code]],
  };
}

/** Returns the photograph with a new fit. The codes that the user has set stay if the size is the same. */
export function refitted(photograph: Photograph, rows: number, columns: number, fit: Proposal): Photograph {
  const isSameSize = rows === photograph.rows && columns === photograph.columns;
  const kept = (isSameSize && photograph.corrected) || [];
  const proposal = kept.reduce((now, cell) => withCode(now, ...cell), fit);
  return { ...photograph, rows, columns, proposal, advice: "", corrected: kept };
}

/** Returns the cells that are cut: tiles of a sure kind. */
export const sureCells = ({ codes, sure }: Proposal): number =>
  codes.flat().filter((code, cell) => code && sure.flat()[cell] >= SURE).length;

/** Asks the command. Its refusal is an error with the words for the user. */
async function answered(action: string, values?: unknown): Promise<Response> {
  let answer: Response;
  try {
    answer = await fetch(
      action,
      values === undefined
        ? {}
        : { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(values) },
    );
  } catch {
    throw new Error("The command that serves this page has ended. Nothing more can be saved.");
  }
  if (!answer.ok) throw new Error(((await answer.json()) as { readonly error: string }).error);
  return answer;
}

export const ask = async <T>(action: string, values?: unknown): Promise<T> =>
  (await (await answered(action, values)).json()) as T;

export const askFile = async (action: string, values: unknown): Promise<Blob> =>
  await (await answered(action, values)).blob();

/** The package's own files: `map.json`, lists of maps, and rows for `--fix`. */
import { describeCell } from "./cells";
import { gridOf, rowsOf, type Grid } from "./codes";
import { check } from "./errors";
import { isList, isReal, isTable, isWhole, parseJson, plain, Real, type Json, type JsonTable } from "./json";
import { checkObjects, NO_OBJECTS, type MapObject, type ObjectKinds } from "./objects";

const FORMAT = "elitelanes map, version 1";
const LONGEST_SIDE = 1024;
const LARGEST_CODE = 15;

/** A map, and the number of maps in its file. */
export interface MapContent {
  readonly grid: Grid;
  /** For each cell, 1 if its row has a code and 0 if it has null; null without such cells. */
  readonly fixed: Uint8Array | null;
  readonly objects: readonly MapObject[];
  readonly maps: number;
}

/** Reads the first map of a JSON file: one map, a list of maps, or rows of codes and nulls. */
export function mapFromJson(text: string, kinds: ObjectKinds): MapContent {
  const content = parseJson(text);
  if (isTable(content) && hasFreeCells(content.get("codes"))) return fixedCellsIn(content.get("codes")!);
  if (isTable(content)) return mapIn(content, kinds);
  check(isList(content) && content.length > 0, 'expected a map, {"codes": [[...], ...]}, or rows of tile codes');
  const items = content as readonly Json[];
  if (!items.some(isTable)) return fixedCellsIn(content);
  const maps = items.map((item, index) => {
    check(isTable(item), `map ${index}: expected a map, {"codes": [[...], ...]}`);
    return mapIn(item as JsonTable, kinds, `map ${index}: `);
  });
  return { ...maps[0], maps: maps.length };
}

/** Checks the numbers of rows and columns of a table. The message begins with `name`. */
export function checkSides(rows: readonly (readonly unknown[])[], name: string): void {
  const width = rows[0]?.length ?? 0;
  check(width > 0 && rows.every((row) => row.length === width), `${name}expected rows of one length`);
  check(Math.max(rows.length, width) <= LONGEST_SIDE, `${name}expected at most ${LONGEST_SIDE} tiles a side`);
}

const isCode = (value: Json): boolean => typeof value === "number" && value >= 0 && value <= LARGEST_CODE;
const hasFreeCells = (rows: Json | undefined): boolean =>
  isList(rows) && rows.some((row) => isList(row) && row.includes(null));

function codesIn(rows: Json, name: string, mayBe: (cell: Json) => boolean): readonly (readonly Json[])[] {
  check(isList(rows) && rows.every(isList), `${name}expected rows of tile codes`);
  const listed = rows as readonly (readonly Json[])[];
  checkSides(listed, name);
  listed.forEach((row, y) =>
    row.forEach((cell, x) => {
      const got = () => `${wordsFor(cell)} at ${describeCell(y, x)}`;
      if (!mayBe(cell)) check(false, `${name}expected tile codes 0 to ${LARGEST_CODE}, got ${got()}`);
    }),
  );
  return listed;
}

/** Reads fixed cells. The editor also opens cells that `--fix` refuses, so that they can be mended. */
function fixedCellsIn(rows: Json): MapContent {
  const listed = codesIn(rows, "", (cell) => cell === null || isCode(cell));
  const cells = listed.flat();
  const fixed = Uint8Array.from(cells, (cell) => +(cell !== null));
  const grid = gridOf(listed.map((row) => row.map((cell) => (cell ?? 0) as number)));
  return { grid, fixed: cells.includes(null) ? fixed : null, objects: NO_OBJECTS, maps: 1 };
}

function mapIn(values: JsonTable, kinds: ObjectKinds, name = ""): MapContent {
  const rows = values.get("codes");
  check(rows !== undefined, `${name}expected rows of tile codes, got no "codes"`);
  const format = values.has("format") ? values.get("format")! : FORMAT;
  check(format === FORMAT, `${name}format: expected "${FORMAT}", got ${wordsFor(format)}`);
  const grid = gridOf(codesIn(rows!, name, isCode) as number[][]);
  const shape = values.has("shape") ? plain(values.get("shape")!) : [grid.height, grid.width];
  const isShape = Array.isArray(shape) && shape.length === 2 && sameNumbers(shape, [grid.height, grid.width]);
  check(isShape, `${name}shape: expected [${grid.height}, ${grid.width}], like the codes`);
  for (const [field, [fits, expected]] of Object.entries(FIELDS)) {
    const value = values.get(field) ?? null;
    check(value === null || fits(value), `${name}${field}: expected ${expected}, got ${wordsFor(value)}`);
  }
  const drawn = values.get("drawn");
  const tables = isTable(drawn) ? [drawn.get("tiles"), drawn.get("quarter_turns")] : [];
  const expected = `${name}drawn: expected tables of ${grid.height} x ${grid.width}, like the codes`;
  check(
    tables.every((table) => hasShape(table as Json[][], grid)),
    expected,
  );
  const objects = values.get("objects") ?? null;
  const listed = objects === null ? NO_OBJECTS : plainObjects(objects);
  return { grid, fixed: null, objects: checkObjects(listed, kinds, grid, name), maps: 1 };
}

/** Compares as Python does, for which true is 1. */
const sameNumbers = (values: readonly unknown[], others: readonly number[]): boolean =>
  values.every((value, index) => (typeof value === "boolean" ? +value : value) === others[index]);

const hasShape = (table: readonly (readonly Json[])[], { height, width }: Grid): boolean =>
  table.length === height && table.every((row) => row.length === width);

/** Returns objects as JavaScript has them. A tag that is written with a point stays a `Real`, which is no tag. */
function plainObjects(objects: Json): unknown {
  if (!isList(objects)) return plain(objects);
  return objects.map((fields) => {
    if (!isTable(fields)) return plain(fields);
    const pairs = [...fields].map(([name, value]) => [name, name === "tag" ? value : plain(value)]);
    return Object.fromEntries(pairs) as object;
  });
}

const listOf =
  (fits: (item: Json) => boolean) =>
  (value: Json): boolean =>
    isList(value) && value.every(fits);
const isText = (value: Json): boolean => typeof value === "string";
const isNumbersByName = (value: Json): boolean => isTable(value) && [...value.values()].every(isReal);
const isCell = (value: Json): boolean =>
  isList(value) && value.length === 2 && value.every((index) => isWhole(index) && index >= 0);
const isTurns = (value: Json): boolean => typeof value === "number" && value >= 0 && value < 4;

function isDrawn(value: Json): boolean {
  if (!isTable(value) || !value.has("tile_set") || value.size !== (value.has("digests") ? 4 : 3)) return false;
  const digests = value.get("digests") ?? null;
  if (digests !== null && !(isTable(digests) && [...digests.values()].every(isText))) return false;
  const [tiles, turns] = [value.get("tiles") ?? null, value.get("quarter_turns") ?? null];
  return isText(value.get("tile_set")!) && listOf(listOf(isText))(tiles) && listOf(listOf(isTurns))(turns);
}

/** The fields beside the codes and the objects: a test of the value, and what is expected. The page measures anew. */
const FIELDS: Readonly<Record<string, readonly [fits: (value: Json) => boolean, expected: string]>> = {
  metrics: [isNumbersByName, "numbers by name"],
  fitness: [isReal, "a number"],
  descriptor: [isNumbersByName, "numbers by name"],
  niche: [listOf(isWhole), "whole numbers"],
  seed: [(value) => listOf(isWhole)(value) && (value as readonly Json[]).length === 2, "two whole numbers"],
  unsure: [listOf(isCell), "a list of cells, each a row and a column"],
  drawn: [isDrawn, "a record of tile_set, tiles, quarter_turns, turns 0 to 3"],
};

function wordsFor(value: Json): string {
  const text = JSON.stringify(value instanceof Real ? value.value : plain(value)) ?? "none";
  const isWrittenWhole = value instanceof Real && Number.isInteger(value.value);
  return `${text}${isWrittenWhole ? ".0" : ""}`.slice(0, 40);
}

/** Writes rows or objects as JSON, one per line. */
function table(rows: readonly unknown[], indent: string): string {
  const line = (row: unknown) =>
    Array.isArray(row) ? `[${row.map((cell) => JSON.stringify(cell)).join(", ")}]` : JSON.stringify(row);
  return `[\n${rows.map((row) => `${indent}  ${line(row)}`).join(",\n")}\n${indent}]`;
}

/** Writes a map file that the package reads. `more` has the fields beside the codes. */
export function toMapJson(grid: Grid, more: Readonly<Record<string, unknown>> = {}): string {
  const lines = [
    `"format": "${FORMAT}"`,
    `"shape": [${grid.height}, ${grid.width}]`,
    `"codes": ${table(rowsOf(grid), "  ")}`,
    ...Object.entries(more).map(([key, value]) => {
      const rows = Array.isArray(value) && typeof value[0] === "object" ? table(value, "  ") : JSON.stringify(value);
      return `${JSON.stringify(key)}: ${rows}`;
    }),
  ];
  return `{\n  ${lines.join(",\n  ")}\n}\n`;
}

/** Writes rows for `--fix`: the code of each fixed cell, null for all others. */
export function toFix(grid: Grid, fixed: ArrayLike<number>): string {
  return `${table(
    rowsOf(grid).map((row, y) => row.map((code, x) => (fixed[y * grid.width + x] ? code : null))),
    "",
  )}\n`;
}

/** Map files: `map.json`, rows for `--fix`, and Duckietown's YAML. */
import { FAILSAFE_SCHEMA, load, type YAMLException } from "js-yaml";
import { CONNECTIONS, gridOf, rotateCode, rowsOf, type Grid } from "./codes";
import { check, FileError } from "./errors";
import { baseKind, checkObjects, NO_OBJECTS, TILE_SIZE, type MapObject, type ObjectKinds } from "./objects";

const ROADS: Readonly<Record<string, number>> = {
  straight: 10,
  curve_left: 12,
  curve_right: 9,
  "3way_left": 14,
  "3way_right": 11,
  "4way": 15,
};
const TURNS: Readonly<Record<string, number>> = { S: 0, E: 1, N: 2, W: 3 };
const STAND = 0.27 / 0.4; // of a traffic light, from the middle of its mesh, by its height
// Metres east and north from a tile's south-west corner.
const SLOTS = [
  ...[0.09, 0.035, 0.035, 0.09, -0.035, 0.09, -0.09, 0.035],
  ...[-0.09, -0.035, -0.035, -0.09, 0.035, -0.09, 0.09, -0.035],
];
const [FIRST_STREET, LAST_STREET] = [440, 551]; // the tags of street names
const GROUNDS = ["grass", "floor", "asphalt", "empty", "calibration_tile"];

const CODE = new Map<string, number>();
for (const [kind, code] of Object.entries(ROADS)) {
  for (const [side, turns] of Object.entries(TURNS)) CODE.set(`${kind}/${side}`, rotateCode(code, turns));
  CODE.set(kind, rotateCode(code, TURNS.E));
}
for (const kind of GROUNDS) for (const side of ["", "/S", "/E", "/N", "/W"]) CODE.set(kind + side, 0);

const TILE = new Map<number, string>();
for (const tile of ["straight/N", "straight/E", "4way"]) TILE.set(CODE.get(tile)!, tile);
for (const kind of ["curve_left", "3way_left"]) {
  for (const side of Object.keys(TURNS)) TILE.set(CODE.get(`${kind}/${side}`)!, `${kind}/${side}`);
}

/** Counts the tiles with one connection, for which Duckietown has no kind. */
export function stubs(grid: Grid): number {
  return grid.codes.reduce((count, code) => count + +(CONNECTIONS[code] === 1), 0);
}

/** Writes a map as Duckietown's YAML, as `elitelanes export --to duckietown` does. */
export function toDuckietown(grid: Grid, objects: readonly MapObject[] = []): string {
  if (stubs(grid)) throw new FileError("Duckietown has no tile for a dead end; mend the map first");
  const kinds = rowsOf(grid).map((row) => row.map((code) => TILE.get(code) ?? "grass"));
  const width = Math.max(...kinds.flat().map((kind) => kind.length)) + 1;
  const rows = kinds.map((row) =>
    row
      .map((kind) => `${kind},`.padEnd(width + 1))
      .join("")
      .replace(/[, ]+$/, ""),
  );
  const lines = [`tile_size: ${TILE_SIZE}`, "tiles:", ...rows.map((row) => `- [${row}]`)];
  return `${[...lines, ...objectLines(objects, grid.height)].join("\n")}\n`;
}

/** Returns an angle, at most half a turn to either side. */
function withinHalfTurn(angle: number): number {
  const turns = angle / (2 * Math.PI);
  const whole = Math.abs(turns % 1) === 0.5 ? 2 * Math.round(turns / 2) : Math.round(turns);
  return angle - 2 * Math.PI * whole;
}

function objectLines(objects: readonly MapObject[], rows: number): string[] {
  const text = (value: number) => `${+value.toFixed(6) + 0}`;
  const lines = objects.map((thing, index) => {
    const { kind, height, tag } = thing;
    // gym-duckietown has no picture of street names.
    const name = kind === "sign_street_name" ? "sign_blank" : kind.replace("other:", "");
    let [x, y, angle] = [thing.x * TILE_SIZE, (rows - thing.y) * TILE_SIZE, thing.angle];
    if (kind === "trafficlight") {
      // Duckietown's position is the middle of the mesh; ours is the stand, a quarter turn to the right.
      x += STAND * height * Math.cos(angle);
      y += STAND * height * Math.sin(angle);
      angle += Math.PI / 2;
    }
    const degrees = withinHalfTurn(angle) * (180 / Math.PI);
    return [
      `  ${name}_${index}:`,
      `    kind: ${name}`,
      `    pose: {~SE2Transform: {p: [${text(x)}, ${text(y)}], theta_deg: ${text(degrees)}}}`,
      ...(height ? [`    height: ${text(height)}`] : []),
      ...(tag !== undefined && (kind === "floor_tag" || kind.startsWith("sign_"))
        ? [`    tag: {~TagInstance: {family: 36h11, size: 0.065, tag_id: ${tag}}}`]
        : []),
      ...(thing.static === false ? ["    static: false"] : []),
    ];
  });
  return lines.length ? ["objects:", ...lines.flat()] : [];
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
    `"format": "elitelanes map, version 1"`,
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

export interface MapContent {
  readonly grid: Grid;
  /** For each cell, 1 if its row has a code and 0 if it has null; null without such cells. */
  readonly fixed: Uint8Array | null;
  readonly objects: readonly MapObject[];
}

/** Reads a map from a file's text: JSON with codes, rows of codes and nulls, or Duckietown's YAML. */
export function readMap(text: string, name: string, kinds: ObjectKinds): MapContent {
  if (/\.ya?ml$/i.test(name)) {
    const [file, values] = [`${name}: `, yamlFields(text, `${name}: `)];
    const grid = gridIn(values, file);
    const objects = checkObjects(objectsIn(values, grid.height, kinds, file), kinds, grid, file);
    return { grid, fixed: null, objects };
  }
  let values: unknown;
  try {
    values = JSON.parse(text);
  } catch {
    throw new FileError(`${name}: expected a map as JSON or Duckietown's YAML`);
  }
  const fields = (Array.isArray(values) ? { codes: values } : values) as { codes?: unknown; objects?: unknown } | null;
  const rows = fields?.codes;
  check(Array.isArray(rows) && rows.length > 0 && rows.every(Array.isArray), `${name}: expected rows of tile codes`);
  const listed = rows as unknown[][];
  checkSides(listed, name);
  for (const cell of listed.flat()) {
    check(
      cell === null || (Number.isInteger(cell) && (cell as number) >= 0 && (cell as number) <= 15),
      `${name}: expected tile codes 0 to 15, got ${JSON.stringify(cell).slice(0, 40)}`,
    );
  }
  const fixed = listed.flat().some((cell) => cell === null)
    ? Uint8Array.from(listed.flat(), (cell) => +(cell !== null))
    : null;
  const grid = gridOf(listed.map((row) => row.map((cell) => (cell ?? 0) as number)));
  return { grid, fixed, objects: checkObjects(fields!.objects ?? NO_OBJECTS, kinds, grid, `${name}: `) };
}

/** Reads the tiles of Duckietown's YAML. */
export const fromDuckietown = (text: string): Grid => gridIn(yamlFields(text, ""), "");

/** What a table of YAML has: lists, tables and texts. */
type Fields = Readonly<Record<string, unknown>>;

const fieldsOf = (value: unknown, none: Fields = {}): Fields =>
  value && typeof value === "object" && !Array.isArray(value) ? (value as Fields) : none;
const textIn = (fields: Fields, name: string): string => (typeof fields[name] === "string" ? fields[name] : "");

/** Returns the number of a field, NaN if it is something else. */
const numberIn = (fields: Fields, name: string, usual = NaN): number =>
  name in fields ? Number(textIn(fields, name) || NaN) : usual;

function pairIn(fields: Fields, name: string): [number, number] {
  const [first, second] = Array.isArray(fields[name]) ? (fields[name] as unknown[]) : [];
  return [numberIn({ first }, "first"), numberIn({ second }, "second")];
}

function yamlFields(text: string, file: string): Fields {
  try {
    return fieldsOf(load(text, { schema: FAILSAFE_SCHEMA }));
  } catch (error) {
    throw new FileError(`${file}expected readable YAML, got: ${(error as YAMLException).reason}`);
  }
}

function gridIn({ tiles: rows }: Fields, file: string): Grid {
  check(rows !== undefined, `${file}expected a Duckietown map, got no "tiles"`);
  const isTable = Array.isArray(rows) && rows.length > 0 && rows.every(Array.isArray);
  check(isTable, `${file}tiles: expected rows of kinds of tiles`);
  const listed = rows as unknown[][];
  checkSides(listed, `${file}tiles`);
  const codeOf = (kind: unknown, x: number, y: number): number => {
    const text = typeof kind === "string" ? kind : "no text";
    const code = CODE.get(text.replace(/\s*\/\s*/, "/"));
    const got = `${text.slice(0, 40)} at row ${y}, column ${x}`;
    check(code !== undefined, `${file}tiles: expected one of Duckietown's kinds, got ${got}`);
    return code!;
  };
  return gridOf(listed.map((row, y) => row.map((kind, x) => codeOf(kind, x, y))));
}

function objectsIn(values: Fields, rows: number, kinds: ObjectKinds, file: string): unknown[] {
  const tileSize = numberIn(values, "tile_size", TILE_SIZE);
  check(
    !values.objects || (tileSize >= 0.01 && tileSize <= 100),
    `${file}tile_size: expected metres, a number from 0.01 to 100`,
  );
  return Object.values(values.objects || {}).map((value) => objectIn(fieldsOf(value), rows, tileSize, kinds));
}

/** Reads an object, by Python's rules. A number that is not there becomes NaN, which `checkObject` refuses. */
function objectIn(fields: Fields, rows: number, tileSize: number, kinds: ObjectKinds): object {
  const given = textIn(fields, "kind").replace(/^sign_1_way_(left|right)$/, "sign_oneway_$1");
  let kind = Object.hasOwn(kinds, given) ? given : `other:${given}`;
  const [usual] = kinds[baseKind(kind)];
  const height = usual && numberIn(fields, "height", usual);
  let [x, y, angle] = poseIn(fields, rows, tileSize);
  if (kind === "trafficlight") {
    angle -= Math.PI / 2;
    x -= ((STAND * height) / tileSize) * Math.cos(angle);
    y += ((STAND * height) / tileSize) * Math.sin(angle);
  }
  const tag = "tag" in fields ? numberIn(fieldsOf(fieldsOf(fields.tag)["~TagInstance"]), "tag_id") : undefined;
  if (kind === "sign_blank" && tag! >= FIRST_STREET && tag! <= LAST_STREET) kind = "sign_street_name";
  const isStatic = !/^(false|no|off)$/i.test(textIn(fields, "static"));
  return { kind, x, y, angle: withinHalfTurn(angle), height, ...(tag !== undefined && { tag }), static: isStatic };
}

/** Returns the position of an object in tiles, and its angle. */
function poseIn(fields: Fields, rows: number, tileSize: number): [x: number, y: number, angle: number] {
  const radians = (degrees: number) => degrees * (Math.PI / 180);
  const transform = (value: unknown) => {
    const inner = fieldsOf(fieldsOf(value)["~SE2Transform"], { p: null, theta: null });
    const [east, north] = "p" in inner ? pairIn(inner, "p") : [0, 0];
    return [east, north, "theta" in inner ? numberIn(inner, "theta") : radians(numberIn(inner, "theta_deg", 0))];
  };
  const fromSouthWest = ([column, row]: number[], [east, north, angle]: number[]): [number, number, number] => [
    column + east / tileSize,
    rows - row - north / tileSize,
    angle,
  ];
  const { attach, pos, pose, place } = fields;
  const rotate = radians(numberIn(fields, "rotate", 0));
  if (attach) {
    const slot = 2 * numberIn(fieldsOf(attach), "slot");
    const angle = pose ? transform(pose)[2] : rotate;
    return fromSouthWest(pairIn(fieldsOf(attach), "tile"), [SLOTS[slot], SLOTS[slot + 1], angle]);
  }
  if (pos) return [...pairIn(fields, "pos"), rotate];
  if (pose || !place) return fromSouthWest([0, 0], transform(pose));
  const [column, row] = pairIn(fieldsOf(place), "tile");
  return fromSouthWest([column + 0.5, row + 0.5], transform(fieldsOf(place).relative));
}

function checkSides(rows: readonly (readonly unknown[])[], name: string): void {
  const width = rows[0].length;
  check(width > 0 && rows.every((row) => row.length === width), `${name}: expected rows of one length`);
  check(Math.max(rows.length, width) <= 1024, `${name}: expected at most 1024 tiles a side`);
}

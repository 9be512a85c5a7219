/** Duckietown's map files: the tiles, and the objects in all four ways to say where one is. */
import { describeCell } from "./cells";
import { CONNECTIONS, gridOf, rotateCode, rowsOf, type Grid } from "./codes";
import { check, FileError } from "./errors";
import { checkSides } from "./mapFile";
import { degreesIn, floatOf, isAscii, remainder, sixDecimals, strip } from "./numbers";
import { baseKind, checkObjects, NO_OBJECTS, TILE_SIZE, type MapObject, type ObjectKinds } from "./objects";
import { isList, isTable, yamlTree, type Table, type Tree } from "./yaml";

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
  [0.09, 0.035],
  [0.035, 0.09],
  [-0.035, 0.09],
  [-0.09, 0.035],
  [-0.09, -0.035],
  [-0.035, -0.09],
  [0.035, -0.09],
  [0.09, -0.035],
] as const;
const [FIRST_STREET, LAST_STREET] = [440, 551]; // the tags of street names
const GROUNDS = ["grass", "floor", "asphalt", "empty", "calibration_tile"];
/** What YAML 1.1 reads as false. */
const FALSE = ["false", "no", "off"].flatMap((word) => [
  word,
  word[0].toUpperCase() + word.slice(1),
  word.toUpperCase(),
]);

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
  const width = kinds.flat().reduce((most, kind) => Math.max(most, kind.length), 0) + 1;
  const rows = kinds.map((row) =>
    row
      .map((kind) => `${kind},`.padEnd(width + 1))
      .join("")
      .replace(/[, ]+$/, ""),
  );
  const lines = [`tile_size: ${TILE_SIZE}`, "tiles:", ...rows.map((row) => `- [${row}]`)];
  return `${[...lines, ...objectLines(objects, grid.height)].join("\n")}\n`;
}

const radiansIn = (degrees: number): number => degrees * (Math.PI / 180);
const withinHalfTurn = (angle: number): number => remainder(angle, 2 * Math.PI);

/** The texts that YAML reads as null. */
const NOTHING = ["~", "null", "Null", "NULL"];

/** What readers of YAML take for a truth value or for nothing. */
const YAML_WORDS = ["null", "true", "false", "yes", "no", "on", "off", "y", "n"];

/** Returns a text of letters, digits, dots and dashes as YAML has it, in quotes if it could be something else. */
const yamlText = (text: string): string =>
  /^\p{N}/u.test(text) || YAML_WORDS.includes(text.toLowerCase()) ? `'${text}'` : text;

function objectLines(objects: readonly MapObject[], rows: number): string[] {
  const text = (value: number) => `${sixDecimals(value) + 0}`;
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
    return [
      `  ${yamlText(`${name}_${index}`)}:`,
      `    kind: ${yamlText(name)}`,
      `    pose: {~SE2Transform: {p: [${text(x)}, ${text(y)}], theta_deg: ${text(degreesIn(withinHalfTurn(angle)))}}}`,
      ...(height ? [`    height: ${text(height)}`] : []),
      ...(tag !== undefined && (kind === "floor_tag" || kind.startsWith("sign_"))
        ? [`    tag: {~TagInstance: {family: 36h11, size: 0.065, tag_id: ${tag}}}`]
        : []),
      ...(thing.static === false ? ["    static: false"] : []),
    ];
  });
  return lines.length ? ["objects:", ...lines.flat()] : [];
}

/** Reads the tiles and the objects of Duckietown's YAML. */
export function mapFromDuckietown(text: string, kinds: ObjectKinds): { grid: Grid; objects: readonly MapObject[] } {
  const content = yamlTree(text) ?? undefined;
  const values = isTable(content) ? content : NO_FIELDS;
  const grid = gridIn(values);
  const listed = values.get("objects");
  const isEmpty =
    !listed ||
    NOTHING.includes(listed as string) ||
    (isList(listed) && !listed.length) ||
    (isTable(listed) && !listed.size);
  const objects = isEmpty ? NO_OBJECTS : checkObjects(objectsIn(values, grid.height, kinds), kinds, grid, "");
  return { grid, objects };
}

/** Reads the tiles of Duckietown's YAML. */
export function fromDuckietown(text: string): Grid {
  const content = yamlTree(text) ?? undefined;
  return gridIn(isTable(content) ? content : NO_FIELDS);
}

const NO_FIELDS: Table = new Map();

function gridIn(values: Table): Grid {
  const rows = values.get("tiles");
  check(rows !== undefined, 'expected a Duckietown map, got no "tiles"');
  check(isList(rows) && rows.every(isList), `tiles: expected rows of kinds of tiles, got ${wordsFor(rows)}`);
  const listed = rows as readonly (readonly Tree[])[];
  checkSides(listed, "tiles: ");
  return gridOf(listed.map((row, y) => row.map((tile, x) => codeOf(tile, x, y))));
}

function codeOf(tile: Tree, x: number, y: number): number {
  const kind =
    typeof tile === "string"
      ? tile
          .split("/")
          .map((part) => strip(part))
          .join("/")
      : "";
  const code = CODE.get(kind);
  if (code === undefined) {
    const got = `${wordsFor(tile)} at ${describeCell(y, x)}`;
    throw new FileError(`tiles: expected one of Duckietown's kinds, got ${got}`);
  }
  return code;
}

function objectsIn(values: Table, rows: number, kinds: ObjectKinds): unknown[] {
  const listed = values.get("objects")!;
  check(isList(listed) || isTable(listed), `objects: expected a list or a table, got ${wordsFor(listed)}`);
  const tileSize = tileSizeIn(values);
  const named = isTable(listed) ? [...listed] : [...(listed as readonly Tree[]).entries()];
  return named.map(([name, value]) => {
    try {
      return objectIn(value, rows, tileSize, kinds);
    } catch (error) {
      if (!(error instanceof FileError)) throw error;
      throw new FileError(`objects: ${`${name}`.slice(0, 40)}: ${error.message}`);
    }
  });
}

function tileSizeIn(values: Table): number {
  const size = values.get("tile_size");
  if (size === undefined) return TILE_SIZE;
  const metres = typeof size === "string" && isAscii(size) ? floatOf(size) : NaN;
  const expected = "tile_size: expected metres, a number from 0.01 to 100";
  check(metres >= 0.01 && metres <= 100, `${expected}, got ${wordsFor(size)}`);
  return metres;
}

/** Reads an object, by Python's rules. */
function objectIn(value: Tree, rows: number, tileSize: number, kinds: ObjectKinds): object {
  const given = isTable(value) ? value.get("kind") : undefined;
  check(typeof given === "string", `expected {"kind": ...}, got ${wordsFor(value)}`);
  const fields = value as Table;
  const name = (given as string).replace(/^sign_1_way_(left|right)$/, "sign_oneway_$1");
  let kind = Object.hasOwn(kinds, name) ? name : `other:${name}`;
  let [x, y, angle] = poseIn(fields, rows, tileSize);
  const [usual] = kinds[baseKind(kind)];
  const isScaled = usual > 0 && fields.has("scale") && !fields.has("height");
  check(!isScaled, "scale: expected a height in metres instead, got a scale");
  const height = usual ? realIn(fields, "height", usual) : 0;
  if (kind === "trafficlight") {
    angle -= Math.PI / 2;
    const offset = (STAND * height) / tileSize;
    x -= offset * Math.cos(angle);
    y += offset * Math.sin(angle);
  }
  const tag = fields.has("tag") ? wholeIn(tableIn(fields.get("tag"), "~TagInstance"), "tag_id") : undefined;
  if (kind === "sign_blank" && tag! >= FIRST_STREET && tag! <= LAST_STREET) kind = "sign_street_name";
  const still = fields.get("static");
  const isStatic = !(typeof still === "string" && FALSE.includes(still));
  return { kind, x, y, angle: withinHalfTurn(angle), height, ...(tag !== undefined && { tag }), static: isStatic };
}

/** Returns the position of an object in tiles, and its angle. */
function poseIn(fields: Table, rows: number, tileSize: number): [x: number, y: number, angle: number] {
  let rotate = radiansIn(realIn(fields, "rotate", 0));
  let [column, row] = [0, 0];
  let east: number;
  let north: number;
  if (fields.has("attach")) {
    // Before the pose, whose position it replaces.
    const attach = tableIn(fields, "attach");
    [column, row] = pairIn(attach, "tile");
    const slot = wholeIn(attach, "slot");
    check(slot >= 0 && slot < SLOTS.length, `slot: expected a whole number, 0 to ${SLOTS.length - 1}, got ${slot}`);
    [east, north] = SLOTS[slot];
    if (fields.has("pose")) rotate = angleIn(tableIn(fields.get("pose"), "~SE2Transform"));
  } else if (fields.has("pos")) {
    return [...pairIn(fields, "pos"), rotate];
  } else if (fields.has("pose")) {
    [east, north, rotate] = transformIn(fields.get("pose"));
  } else {
    check(fields.has("place"), "expected a pose, pos, place or attach, got none");
    const place = tableIn(fields, "place");
    [column, row] = pairIn(place, "tile").map((index) => index + 0.5);
    [east, north, rotate] = transformIn(place.get("relative"));
  }
  return [column + east / tileSize, rows - row - north / tileSize, rotate];
}

function transformIn(value: Tree | undefined): [east: number, north: number, angle: number] {
  const transform = tableIn(value, "~SE2Transform");
  return [...pairIn(transform, "p", [0, 0]), angleIn(transform)];
}

/** Returns the angle of a transform in radians. */
function angleIn(transform: Table): number {
  if (transform.has("theta")) return realIn(transform, "theta");
  return radiansIn(realIn(transform, "theta_deg", 0));
}

function tableIn(value: Tree | undefined, name: string): Table {
  const inner = isTable(value) ? value.get(name) : undefined;
  check(isTable(inner), `${name}: expected a table, got ${wordsFor(inner)}`);
  return inner as Table;
}

function pairIn(fields: Table, name: string, usual?: readonly [number, number]): [number, number] {
  const listed = fields.get(name);
  if (listed === undefined && usual) return [...usual];
  const isPair = isList(listed) && (listed.length === 2 || listed.length === 3);
  check(isPair, `${name}: expected two numbers, got ${wordsFor(listed)}`);
  const [first, second] = listed as readonly Tree[];
  return [realOf(first, name), realOf(second, name)];
}

const realIn = (fields: Table, name: string, usual?: number): number =>
  fields.has(name) || usual === undefined ? realOf(fields.get(name), name) : usual;

function realOf(value: Tree | undefined, name: string): number {
  const number = typeof value === "string" ? floatOf(value) : NaN;
  check(Number.isFinite(number), `${name}: expected a number, got ${wordsFor(value)}`);
  return number;
}

function wholeIn(fields: Table, name: string): number {
  const number = realIn(fields, name);
  check(Number.isInteger(number), `${name}: expected a whole number, got ${number}`);
  return number;
}

function wordsFor(value: Tree | undefined): string {
  if (typeof value === "string") return value.slice(0, 40);
  if (value === undefined) return "none";
  return isList(value) ? "a list" : "a table";
}

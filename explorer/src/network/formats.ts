/** Map files: `map.json`, rows for `--fix`, and Duckietown's YAML. */
import { CONNECTIONS, gridOf, rotateCode, rowsOf, type Grid } from "./codes";
import { check, FileError } from "./errors";
import { checkObjects, NO_OBJECTS, TILE_SIZE, type MapObject, type ObjectKinds } from "./objects";

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
    const turns = angle / (2 * Math.PI);
    const whole = Math.abs(turns % 1) === 0.5 ? 2 * Math.round(turns / 2) : Math.round(turns);
    const degrees = (angle - 2 * Math.PI * whole) * (180 / Math.PI);
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
  /** Whether the file has objects that were not read. */
  readonly unread: boolean;
}

/** Reads a map from a file's text: JSON with codes, rows of codes and nulls, or Duckietown's YAML without its objects. */
export function readMap(text: string, name: string, kinds: ObjectKinds): MapContent {
  if (/\.ya?ml$/i.test(name)) {
    const grid = fromDuckietown(text, `${name}: `);
    return { grid, fixed: null, objects: NO_OBJECTS, unread: /^objects\s*:\s*\n\s+\S/m.test(text) };
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
  return { grid, fixed, objects: checkObjects(fields!.objects ?? NO_OBJECTS, kinds, grid, `${name}: `), unread: false };
}

/** Reads the tiles of Duckietown's YAML, in brackets or as nested lists. Messages begin with `file`. */
export function fromDuckietown(text: string, file = ""): Grid {
  const lines = text.split(/\r?\n/).map((line) => line.replace(/(^|\s)#.*$/, ""));
  const start = lines.findIndex((line) => /^tiles\s*:/.test(line));
  check(start >= 0, `${file}expected a Duckietown map, got no "tiles"`);
  const body = [lines[start].replace(/^tiles\s*:/, "")];
  for (const line of lines.slice(start + 1)) {
    if (/^[^\s-]/.test(line) && !line.startsWith("]")) break;
    body.push(line);
  }
  const joined = body.join("\n");
  const rows = joined.includes("[")
    ? [...joined.replace(/^\s*\[(?=\s*\[)/, "").matchAll(/\[([^[\]]*)\]/g)].map((found) =>
        found[1]
          .split(",")
          .map((kind) => kind.trim())
          .filter(Boolean),
      )
    : blockRows(body);
  check(rows.length > 0 && rows[0].length > 0, `${file}tiles: expected rows of kinds of tiles`);
  checkSides(rows, `${file}tiles`);
  return gridOf(
    rows.map((row, y) =>
      row.map((kind, x) => {
        const plain = kind.replace(/^(["'])(.*)\1$/, "$2").replace(/\s*\/\s*/, "/");
        const code = CODE.get(plain);
        if (code === undefined)
          throw new FileError(
            `${file}tiles: expected one of Duckietown's kinds, got ${kind.slice(0, 40)} at row ${y}, column ${x}`,
          );
        return code;
      }),
    ),
  );
}

function blockRows(lines: readonly string[]): string[][] {
  const rows: string[][] = [];
  for (const line of lines) {
    const first = /^\s*-\s+-\s*(.*?)\s*$/.exec(line);
    const next = /^\s+-\s*(.*?)\s*$/.exec(line);
    if (first) rows.push([first[1]]);
    else if (next && rows.length) rows[rows.length - 1].push(next[1]);
  }
  return rows;
}

function checkSides(rows: readonly (readonly unknown[])[], name: string): void {
  const width = rows[0].length;
  check(width > 0 && rows.every((row) => row.length === width), `${name}: expected rows of one length`);
  check(Math.max(rows.length, width) <= 1024, `${name}: expected at most 1024 tiles a side`);
}

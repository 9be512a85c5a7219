/** A plan to build a map from, as an SVG file. Its unit is a millimetre. */
import { objectShapes, pathOf } from "./drawing";
import { cellName, columnName } from "./network/cells";
import type { Grid } from "./network/codes";
import { gridlockLoop } from "./network/loops";
import { degreesIn, rint, roundTo } from "./network/numbers";
import { baseKind, byKind, edgeOf, type MapObject, type ObjectKinds } from "./network/objects";
import { planOf, type PlanValues } from "./network/plan";
import { objectName } from "./words";

const MARGIN = 14;
const LINE = 4.5;
const SAMPLE = 22; // side of the tiles of the legend
const [A4_WIDTH, A4_HEIGHT] = [210, 297];
const COLUMN = 62; // its width
const ROWS = 56; // lines of a column of the check-list
const WAYS: Readonly<Record<number, string>> = { 0: "east", 90: "north", 180: "west", 270: "south" };
/** The most characters of a line of the bill. */
const LINE_LENGTH = 36;
const LOOP = "#7a3fe0";
const INKS: Readonly<Record<string, string>> = { red: "#d9202c", yellow: "#f5c71a", white: "#fff" };

const at = (value: number): string => `${+value.toFixed(3)}`;

const tileName = (kind: string, quarterTurns?: number): string => {
  const name = { crossing3: "3-way", crossing4: "4-way" }[kind] ?? kind;
  return quarterTurns === undefined || kind === "crossing4" ? name : `${name} ${90 * quarterTurns}°`;
};

const words = (x: number, y: number, text: string, more = ""): string =>
  `<text x="${at(x)}" y="${at(y)}" ${more}>${text}</text>`;

/** Writes the plan of a map: its tiles and objects, its measures, the bill of materials, and sheets of A4 with a check-list. */
export function planSvg(grid: Grid, objects: readonly MapObject[], kinds: ObjectKinds, values: PlanValues): string {
  const plan = planOf(grid, values);
  const loop = gridlockLoop(grid);
  const { tile_size: size } = values;
  const { height: rows, width: columns } = grid;
  const things = [...objects].sort(
    (one, other) => one.y - other.y || one.x - other.x || +(one.kind > other.kind) - +(one.kind < other.kind),
  );
  const edge = edgeOf(things, grid);
  const tile = Math.min(Math.max((A4_WIDTH - 2 * MARGIN - 24) / (columns + 2 * edge), 14), 40);
  const width = Math.max(A4_WIDTH, (columns + 2 * edge) * tile + 2 * MARGIN + 24);
  const [left, top] = [(width - columns * tile) / 2, MARGIN + 20 + edge * tile];
  const [right, bottom] = [left + columns * tile, top + rows * tile];
  const bill = billOf(plan, grid, things, values);
  const billTop = bottom + edge * tile + 20;
  const legendTop = billTop + LINE * (Math.max(...bill.map((lines) => lines.length)) + 0.5);
  const listTop = Math.max(A4_HEIGHT, legendTop + SAMPLE + 10 + MARGIN);
  const list = checkListOf(plan, things, kinds, size);
  const height = listTop + A4_HEIGHT * Math.ceil(list.length / ROWS / 3);
  const [beside, below] = [right + edge * tile + 7, bottom + edge * tile + 7];
  const metres = (tiles: number) => `${+(tiles * size).toFixed(3)} m`;
  const middle = `text-anchor="middle"`;
  const lines = [
    words(MARGIN, MARGIN + 4, "Plan", `font-size="6" font-weight="700"`),
    words(
      MARGIN + 18,
      MARGIN + 4,
      `${rows} rows and ${columns} columns of ${size} m, ${metres(columns)} × ${metres(rows)}`,
      `fill="#5c636d"`,
    ),
    words(
      MARGIN + 18,
      MARGIN + 4 + LINE,
      `up to ${loop.length - 1} robots can never block each other; beyond that, the dashed loop fills first`,
      `fill="${LOOP}"`,
    ),
    ...Array.from({ length: rows }, (_, row) =>
      words(left - edge * tile - 5, top + (row + 0.5) * tile + 1, `${row + 1}`, middle),
    ),
    ...Array.from({ length: columns }, (_, column) =>
      words(left + (column + 0.5) * tile, top - edge * tile - 4, columnName(column), middle),
    ),
    `<g transform="translate(${at(left)} ${at(top)}) scale(${at(tile)})" font-size="0.11">`,
    `<path d="M0 0H${columns}V${rows}H0Z" fill="#f3f5ee" stroke="#6d737d" stroke-width="0.01"/>`,
    ...plan.placed.map(
      ({ row, column, kind, quarterTurns }) =>
        `<use href="#${kind}" transform="translate(${column} ${row}) rotate(${-90 * quarterTurns} 0.5 0.5)"/>`,
    ),
    `<path d="M${loop.map((cell) => `${(cell % columns) + 0.5} ${Math.floor(cell / columns) + 0.5}`).join("L")}Z" fill="none" stroke="${LOOP}" stroke-width="0.04" stroke-dasharray="0.12 0.06"/>`,
    ...plan.placed.map(({ row, column, kind, quarterTurns }) =>
      [cellName(row, column), tileName(kind, quarterTurns)]
        .map((text, line) => words(column + 0.5, row + 0.48 + 0.12 * line, text, `class="label"`))
        .join(""),
    ),
    ...objectShapes(things, kinds).map(pathOf),
    ...things.map(({ x, y }, index) => words(x, y + 0.03, `${index + 1}`, `class="number"`)),
    "</g>",
    `<path class="line" d="M${at(left)} ${at(below)}H${at(right)}m0 -1.5v3M${at(left)} ${at(below - 1.5)}v3"/>`,
    words((left + right) / 2, below + 4.5, metres(columns), middle),
    `<path class="line" d="M${at(beside)} ${at(top)}V${at(bottom)}m-1.5 0h3M${at(beside - 1.5)} ${at(top)}h3"/>`,
    words(beside + 2, (top + bottom) / 2, metres(rows)),
    words(beside - 1.2, top - 4, "N ↑"),
    ...bill.flatMap((column, index) =>
      column.map((text, line) =>
        words(MARGIN + index * COLUMN, billTop + line * LINE, text, line ? "" : `font-weight="700"`),
      ),
    ),
    ...Object.keys(values.kinds).map(
      (kind, index) =>
        `<use href="#${kind}" transform="translate(${MARGIN + index * (SAMPLE + 8)} ${at(legendTop)}) scale(${SAMPLE})"/>` +
        words(MARGIN + index * (SAMPLE + 8) + SAMPLE / 2, legendTop + SAMPLE + 5, tileName(kind, 0), middle),
    ),
    words(MARGIN + 4 * (SAMPLE + 8), legendTop + SAMPLE / 2, "Angles are counter-clockwise."),
    words(MARGIN + 4 * (SAMPLE + 8), legendTop + SAMPLE / 2 + LINE, "Files call A1 row 0, column 0."),
    words(MARGIN, listTop + MARGIN + 4, "Check-list", `font-size="6" font-weight="700"`),
    ...list.map((text, index) => {
      const column = Math.floor(index / ROWS);
      const sheet = listTop + Math.floor(column / 3) * A4_HEIGHT;
      return words(MARGIN + (column % 3) * COLUMN, sheet + MARGIN + 12 + (index % ROWS) * LINE, text);
    }),
  ];
  return (
    `<svg xmlns="http://www.w3.org/2000/svg" width="${at(width)}mm" height="${at(height)}mm" viewBox="0 0 ${at(width)} ${at(height)}" font-family="sans-serif" font-size="3.2" fill="#1d2026">\n` +
    `<style>.label{text-anchor:middle;paint-order:stroke;stroke:#fff;stroke-width:.04px}.number{text-anchor:middle;font-size:.08px;font-weight:700;fill:#fff}.line{fill:none;stroke:#1d2026;stroke-width:.3px}</style>\n` +
    `<defs>${Object.keys(values.kinds)
      .map((kind) => tileOf(kind, values))
      .join("\n")}</defs>\n` +
    `<path d="M0 0H${at(width)}V${at(height)}H0Z" fill="#fff"/>\n${lines.join("\n")}\n</svg>\n`
  );
}

/** Draws a tile with its tapes, as wide as 1. */
function tileOf(kind: string, { kinds, widths, tile_size: size }: PlanValues): string {
  const strips = kinds[kind].tapes.map(([colour, points]) => {
    const d = points.map(([x, y], index) => `${index ? "L" : "M"}${at(x / size)} ${at(y / size)}`).join("");
    const width = widths[colour] / size;
    const dash = colour === "yellow" ? ` stroke-dasharray="${at(0.05 / size)} ${at(0.025 / size)}"` : "";
    // White tape on white paper needs an outline.
    const outline = colour === "white" ? `<path d="${d}" stroke="#6d737d" stroke-width="${at(width + 0.01)}"/>` : "";
    return `${outline}<path d="${d}" stroke="${INKS[colour]}" stroke-width="${at(width)}"${dash}/>`;
  });
  return `<g id="${kind}" fill="none"><path d="M0 0H1V1H0Z" fill="#c4c8ce" stroke="#6d737d" stroke-width="0.005"/>${strips.join("")}</g>`;
}

/** Returns the lines of the check-list: objects, of two lines each, and tiles. */
function checkListOf(
  { placed }: ReturnType<typeof planOf>,
  things: readonly MapObject[],
  kinds: ObjectKinds,
  size: number,
): string[] {
  const objects = things.flatMap(({ kind, x, y, angle, tag }, index) => {
    const [east, south] = [roundTo(x * size, 2), roundTo(y * size, 2)];
    const across = `${Math.abs(east).toFixed(2)} ${east < 0 ? "west" : "east"}`;
    const down = `${Math.abs(south).toFixed(2)} ${south < 0 ? "north" : "south"}`;
    const degrees = (rint(degreesIn(angle)) + 720) % 360;
    const faces = kinds[baseKind(kind)][3] ? "" : `, faces ${WAYS[degrees] ?? `${degrees}°`}`;
    const name = `${objectName(kind)}${tag === undefined ? "" : `, tag ${tag}`}`;
    return [`\u2610 ${index + 1} ${name}`, `\u2003${across}, ${down}${faces}`];
  });
  return [
    ...(objects.length ? ["Signs and objects", "(metres from the north-west corner)", ...objects] : []),
    "Tiles",
    ...placed.map(
      ({ row, column, kind, quarterTurns }) => `\u2610 ${cellName(row, column)} ${tileName(kind, quarterTurns)}`,
    ),
  ];
}

/** Returns the columns of the bill of materials: tiles, tape, and objects if there are any. */
function billOf(
  { placed, tiles, tape }: ReturnType<typeof planOf>,
  { codes }: Grid,
  things: readonly MapObject[],
  { widths }: PlanValues,
): string[][] {
  const listed = byKind(things).flatMap(([kind, some]) => {
    const tags = some.flatMap(({ tag }) => tag ?? []).sort((one, other) => one - other);
    const text = `${some.length} × ${objectName(kind)}${tags.length ? `, tag ${tags.join(", ")}` : ""}`;
    return wrapped(text, LINE_LENGTH).map((line, index) => (index ? `\u2003${line}` : line));
  });
  return [
    [
      "Tiles",
      ...Object.entries(tiles).map(([kind, count]) => `${count} × ${tileName(kind)}`),
      `${placed.length} with road`,
      `${codes.length - placed.length} empty: bare or none`,
    ],
    [
      "Tape",
      ...Object.entries(tape).map(
        ([name, metres]) => `${roundTo(metres, 2).toFixed(2)} m ${name}, ${+(100 * widths[name]).toFixed(1)} cm wide`,
      ),
      "(yellow: laid whole, then cut to",
      "5 cm of tape and 2.5 cm of gap)",
    ],
    listed.length ? ["Signs and objects", ...listed] : [],
  ];
}

/** Returns the lines of a text. A word that is longer than a line is broken, so that no letter is lost. */
function wrapped(text: string, length: number): string[] {
  const line = new RegExp(`.{1,${length}}(?: |$)|.{${length}}`, "gu");
  return text.match(line) ?? [];
}

/** Maps as vectors for a canvas or an SVG file. The unit is a tile, x points east, y points south. */
import { CONNECTIONS, IS_TURN, SIDES, EAST, SOUTH, type Grid } from "./network/codes";
import { countFaces, findFaces } from "./network/faces";
import { isReturned, roadEnds } from "./network/links";
import { gridlockLoop } from "./network/loops";
import { baseKind, footprint, edgeOf, type MapObject, type ObjectKinds } from "./network/objects";
import { DISTINCT, objectColour } from "./colours";

export interface Shape {
  readonly d: string;
  readonly stroke?: string;
  readonly fill?: string;
  /** The width of the stroke. */
  readonly width?: number;
  readonly dash?: readonly number[];
  readonly cap?: "butt" | "round";
  readonly opacity?: number;
}

export interface Text {
  readonly text: string;
  readonly x: number;
  readonly y: number;
  readonly size: number;
  readonly colour: string;
}

export interface Scene {
  readonly height: number;
  readonly width: number;
  /** The tiles around the map that are drawn, too. */
  readonly edge: number;
  readonly shapes: readonly Shape[];
  readonly texts: readonly Text[];
}

/** The overlays of a map. */
export const OVERLAYS = [
  "bridges",
  "adjacent_crossings",
  "adjacent_turns",
  "dead_ends",
  "shortest_loop",
  "faces",
] as const;
export type Overlay = (typeof OVERLAYS)[number];

/** The colour of each overlay. Overlays differ in shape, too. */
export const OVERLAY_COLOURS: Readonly<Record<Overlay, string>> = {
  bridges: "#e8308c",
  adjacent_crossings: "#ff8c1a",
  adjacent_turns: "#2ea6ff",
  dead_ends: "#e02f2f",
  shortest_loop: "#8a4fff",
  faces: "#56b4e9",
};

export const GROUND = "#e4e9dd";
const KERB = "#aab2a5";
export const ROAD = "#474d59";
const LANE = "#f7c945";
export const END = "#d7263d";
const ROAD_WIDTH = 0.56;
const KERB_WIDTH = 0.68;
const LANE_WIDTH = 0.045;

const at = (position: number): string => `${Math.round(1000 * position) / 1000}`;
const line = (x: number, y: number, x2: number, y2: number): string => `M${at(x)} ${at(y)}L${at(x2)} ${at(y2)}`;

/** Returns the path along the middle of a tile's roads. */
function tilePath(code: number, x: number, y: number, from = 0): string {
  const sides = SIDES.filter((side) => code & side.bit);
  if (IS_TURN[code]) {
    const [one, other] = sides;
    const [x1, y1, x2, y2] = [x + one.right / 2, y + one.down / 2, x + other.right / 2, y + other.down / 2];
    const sweep = one.right * other.down - one.down * other.right > 0 ? 0 : 1;
    return `M${at(x1)} ${at(y1)}A0.5 0.5 0 0 ${sweep} ${at(x2)} ${at(y2)}`;
  }
  if (code === 5 || code === 10) {
    const [one, other] = sides;
    return line(x + one.right / 2, y + one.down / 2, x + other.right / 2, y + other.down / 2);
  }
  return sides
    .map((side) => line(x + side.right * from, y + side.down * from, x + side.right / 2, y + side.down / 2))
    .join("");
}

/** Draws the roads of a map. */
export function mapShapes(grid: Grid, { ground = true, lanes = true } = {}): Shape[] {
  const { height, width, codes } = grid;
  let roads = "";
  let stubs = "";
  let middles = "";
  let ends = "";
  codes.forEach((code, cell) => {
    if (!code) return;
    const row = Math.floor(cell / width);
    const column = cell % width;
    const x = column + 0.5;
    const y = row + 0.5;
    const connections = CONNECTIONS[code];
    if (connections === 1) stubs += tilePath(code, x, y);
    else roads += tilePath(code, x, y);
    middles += tilePath(code, x, y, connections > 2 ? 0.3 : 0);
    for (const side of SIDES) {
      if (!(code & side.bit)) continue;
      if (!isReturned(grid, cell, side)) ends += bar(x + side.right * 0.47, y + side.down * 0.47, side.right === 0);
      if (connections === 1) ends += bar(x - side.right * 0.12, y - side.down * 0.12, side.right === 0);
    }
  });
  return [
    ...(ground ? [{ d: `M0 0H${width}V${height}H0Z`, fill: GROUND }] : []),
    { d: roads, stroke: KERB, width: KERB_WIDTH },
    { d: stubs, stroke: KERB, width: KERB_WIDTH, cap: "round" as const },
    { d: roads, stroke: ROAD, width: ROAD_WIDTH },
    { d: stubs, stroke: ROAD, width: ROAD_WIDTH, cap: "round" as const },
    ...(lanes ? [{ d: middles, stroke: LANE, width: LANE_WIDTH, dash: [0.125, 0.125] }] : []),
    { d: ends, stroke: END, width: 0.08 },
  ].filter((shape) => shape.d);
}

const bar = (x: number, y: number, flat: boolean): string =>
  flat ? line(x - 0.3, y, x + 0.3, y) : line(x, y - 0.3, x, y + 0.3);

/** Draws overlays: the roads and tiles that a metric counts. */
export function overlayShapes(grid: Grid, shown: ReadonlySet<Overlay>): { shapes: Shape[]; texts: Text[] } {
  const shapes: Shape[] = [];
  const texts: Text[] = [];
  if (shown.has("faces")) {
    const faces = faceShapes(grid);
    shapes.push(...faces.shapes);
    texts.push(...faces.texts);
  }
  const { height, width, codes } = grid;
  const middle = (cell: number): [number, number] => [(cell % width) + 0.5, Math.floor(cell / width) + 0.5];
  const pair = (cell: number, side: number): string => {
    const [x, y] = middle(cell);
    return side === EAST ? line(x, y, x + 1, y) : line(x, y, x, y + 1);
  };
  if (shown.has("bridges")) {
    let d = "";
    countFaces(grid, (cell, side) => (d += pair(cell, side)));
    shapes.push({ d, stroke: "#fff", width: 0.3, cap: "round", opacity: 0.85 });
    shapes.push({ d, stroke: OVERLAY_COLOURS.bridges, width: 0.18, cap: "round" });
  }
  const pairs = (belongs: (one: number, other: number, linked: boolean) => boolean): string => {
    let d = "";
    codes.forEach((code, cell) => {
      if (cell % width < width - 1 && belongs(code, codes[cell + 1], !!(code & 4 && codes[cell + 1] & 1)))
        d += pair(cell, EAST);
      if (cell < (height - 1) * width && belongs(code, codes[cell + width], !!(code & 2 && codes[cell + width] & 8)))
        d += pair(cell, SOUTH);
    });
    return d;
  };
  const rings = (d: string, radius: number): string => {
    const ends = new Set([...d.matchAll(/[ML]([^ML]+)/g)].map((found) => found[1]));
    return [...ends]
      .map((end) => {
        const [x, y] = end.split(" ").map(Number);
        return circle(x, y, radius);
      })
      .join("");
  };
  if (shown.has("adjacent_crossings")) {
    const d = pairs((one, other, linked) => linked && CONNECTIONS[one] >= 3 && CONNECTIONS[other] >= 3);
    shapes.push({ d, stroke: OVERLAY_COLOURS.adjacent_crossings, width: 0.12 });
    shapes.push({ d: rings(d, 0.2), stroke: OVERLAY_COLOURS.adjacent_crossings, fill: "#fff", width: 0.09 });
  }
  if (shown.has("adjacent_turns")) {
    const d = pairs((one, other) => IS_TURN[one] === 1 && IS_TURN[other] === 1);
    shapes.push({ d, stroke: OVERLAY_COLOURS.adjacent_turns, width: 0.12, dash: [0.16, 0.1] });
    shapes.push({ d: squares(rings(d, 0.2)), stroke: OVERLAY_COLOURS.adjacent_turns, fill: "#fff", width: 0.09 });
  }
  if (shown.has("shortest_loop")) {
    const corners = gridlockLoop(grid).map((cell) => middle(cell).join(" "));
    const d = corners.length ? `M${corners.join("L")}Z` : "";
    shapes.push({ d, stroke: "#fff", width: 0.24 }, { d, stroke: OVERLAY_COLOURS.shortest_loop, width: 0.15 });
  }
  if (shown.has("dead_ends")) {
    let d = "";
    for (const cell of roadEnds(grid)) {
      const [x, y] = middle(cell);
      d += line(x - 0.24, y - 0.24, x + 0.24, y + 0.24) + line(x - 0.24, y + 0.24, x + 0.24, y - 0.24);
    }
    shapes.push({ d, stroke: "#fff", width: 0.24, cap: "round" });
    shapes.push({ d, stroke: OVERLAY_COLOURS.dead_ends, width: 0.13, cap: "round" });
  }
  return { shapes: shapes.filter((shape) => shape.d), texts };
}

const ARROW = 0.12; // how far an object's arrow is ahead of it, in tiles

/** Draws the footprints of objects, lower ones first. All except discs have an arrow in the direction of their front. */
export function objectShapes(objects: readonly MapObject[], kinds: ObjectKinds): Shape[] {
  return [...objects]
    .sort((one, other) => one.height - other.height)
    .map((thing) => {
      const [length, width] = footprint(thing, kinds).map((side) => side / 2);
      const [cosine, sine] = [Math.cos(thing.angle), Math.sin(thing.angle)];
      const corner = (ahead: number, left: number): string =>
        `${at(thing.x + ahead * cosine - left * sine)} ${at(thing.y - ahead * sine - left * cosine)}`;
      const half = Math.min(width, ARROW / 2);
      const d = kinds[baseKind(thing.kind)][3]
        ? circle(thing.x, thing.y, length)
        : `M${corner(-length, width)}L${corner(-length, -width)}L${corner(length, -width)}L${corner(length, -half)}` +
          `L${corner(length + ARROW, 0)}L${corner(length, half)}L${corner(length, width)}Z`;
      return { d, fill: objectColour(thing.kind), stroke: "#fff", width: 0.02 };
    });
}

/** Draws a ring around an object. */
export function ringShapes(thing: MapObject, kinds: ObjectKinds): Shape[] {
  const d = circle(thing.x, thing.y, +at(Math.hypot(...footprint(thing, kinds)) / 2 + 0.06));
  return [
    { d, stroke: "#fff", width: 0.07 },
    { d, stroke: "#0a63c9", width: 0.04 },
  ];
}

const circle = (x: number, y: number, radius: number): string =>
  `M${at(x - radius)} ${at(y)}a${at(radius)} ${at(radius)} 0 1 0 ${at(2 * radius)} 0a${at(radius)} ${at(radius)} 0 1 0 ${at(-2 * radius)} 0`;

/** Replaces the circles of a path by diamonds. */
function squares(circles: string): string {
  return circles.replace(
    /a([\d.]+) [^M]*/g,
    (_, radius: string) => `l${radius} -${radius}l${radius} ${radius}l-${radius} ${radius}Z`,
  );
}

/** Fills and numbers the inner faces. Neighbouring faces have different colours. */
function faceShapes(grid: Grid): { shapes: Shape[]; texts: Text[] } {
  const { height, width } = grid;
  const { root } = findFaces(grid);
  const stride = width - 1;
  const corner = (row: number, column: number): number =>
    row < 0 || column < 0 || row >= height - 1 || column >= stride ? 0 : root[1 + row * stride + column];
  const cornersOf = new Map<number, [number, number][]>();
  const neighbours = new Map<number, Set<number>>();
  for (let row = 0; row < height - 1; row++) {
    for (let column = 0; column < stride; column++) {
      const own = corner(row, column);
      if (!own) continue;
      if (!cornersOf.has(own)) {
        cornersOf.set(own, []);
        neighbours.set(own, new Set());
      }
      cornersOf.get(own)!.push([row, column]);
      for (const [r, c] of [
        [row - 1, column],
        [row + 1, column],
        [row, column - 1],
        [row, column + 1],
      ]) {
        const other = corner(r, c);
        if (other && other !== own) neighbours.get(own)!.add(other);
      }
    }
  }
  const colours = new Map<number, number>();
  const shapes: Shape[] = [];
  const texts: Text[] = [];
  let face = 0;
  for (const [own, corners] of cornersOf) {
    const taken = new Set([...neighbours.get(own)!].map((other) => colours.get(other)));
    let colour = face % 5;
    for (let tries = 0; taken.has(colour) && tries < 6; tries++) colour = (colour + 1) % 6;
    colours.set(own, colour);
    const d = corners.map(([row, column]) => `M${column + 0.5} ${row + 0.5}h1v1h-1Z`).join("");
    shapes.push({ d, fill: DISTINCT[colour], opacity: 0.5 });
    const [row, column] = corners[Math.floor(corners.length / 2)];
    texts.push({ text: `${++face}`, x: column + 1, y: row + 1, size: 0.5, colour: "#14181f" });
  }
  return { shapes, texts };
}

export function sceneOf(
  grid: Grid,
  objects: readonly MapObject[],
  kinds: ObjectKinds,
  shown: ReadonlySet<Overlay> = new Set(),
): Scene {
  const { height, width } = grid;
  const { shapes, texts } = overlayShapes(grid, shown);
  const all = [...mapShapes(grid), ...objectShapes(objects, kinds), ...shapes];
  return { height, width, edge: edgeOf(objects, grid), shapes: all, texts };
}

/** Draws shapes on a canvas. A tile is `scale` pixels wide. */
export function paint(
  context: CanvasRenderingContext2D,
  { shapes, texts }: Pick<Scene, "shapes" | "texts">,
  scale: number,
): void {
  context.save();
  context.scale(scale, scale);
  for (const shape of shapes) {
    const path = new Path2D(shape.d);
    context.globalAlpha = shape.opacity ?? 1;
    if (shape.fill) {
      context.fillStyle = shape.fill;
      context.fill(path);
    }
    if (shape.stroke) {
      context.strokeStyle = shape.stroke;
      context.lineWidth = shape.width ?? 0.05;
      context.lineCap = shape.cap ?? "butt";
      context.setLineDash(shape.dash ? [...shape.dash] : []);
      context.stroke(path);
    }
  }
  context.globalAlpha = 1;
  context.textAlign = "center";
  context.textBaseline = "middle";
  for (const text of texts) {
    context.font = `600 ${text.size}px system-ui, sans-serif`;
    context.lineWidth = 0.12;
    context.strokeStyle = "#fff";
    context.lineJoin = "round";
    context.setLineDash([]);
    context.strokeText(text.text, text.x, text.y);
    context.fillStyle = text.colour;
    context.fillText(text.text, text.x, text.y);
  }
  context.restore();
}

/** Writes a shape as an element of SVG. */
export function pathOf(shape: Shape): string {
  const attributes: Record<string, string | number | undefined> = {
    d: shape.d,
    fill: shape.fill ?? "none",
    stroke: shape.stroke,
    "stroke-width": shape.stroke && shape.width,
    "stroke-linecap": shape.cap,
    "stroke-dasharray": shape.dash?.join(" "),
    opacity: shape.opacity,
  };
  const listed = Object.entries(attributes).filter(([, value]) => value !== undefined);
  return `<path ${listed.map(([name, value]) => `${name}="${value}"`).join(" ")}/>`;
}

/** Writes a scene as an SVG file. A tile is `tile` units wide. */
export function toSvg({ height, width, edge, shapes, texts }: Scene, tile = 48): string {
  const words = texts.map(
    (text) =>
      `<text x="${text.x}" y="${text.y}" font-size="${text.size}" fill="${text.colour}" text-anchor="middle" dominant-baseline="central" font-family="sans-serif" font-weight="600">${text.text}</text>`,
  );
  const sides = [width + 2 * edge, height + 2 * edge].map((side) => +at(side));
  const [across, down] = sides.map((side) => +at(side * tile));
  return (
    `<svg xmlns="http://www.w3.org/2000/svg" width="${across}" height="${down}" viewBox="${at(-edge)} ${at(-edge)} ${sides.join(" ")}">\n` +
    `${[...shapes.map(pathOf), ...words].join("\n")}\n</svg>\n`
  );
}

/** The state of the editor: the map, the fixed cells, the objects, and earlier states for undo. */
import { emptyGrid, rowsOf, SIDES, sameGrid, type Grid } from "./network/codes";
import { isWithin, NO_OBJECTS, type MapObject } from "./network/objects";
import { repair } from "./network/repair";

export const TOOLS = ["road", "cut", "erase", "tile", "fixed", "forbidden", "objects"] as const;
export type Tool = (typeof TOOLS)[number];

export interface Drawing {
  readonly grid: Grid;
  /** For each cell, 1 if `--fix` keeps it. */
  readonly fixed: Uint8Array;
  readonly objects: readonly MapObject[];
}

export interface Editor extends Drawing {
  readonly past: readonly Drawing[];
  readonly future: readonly Drawing[];
  /** The map before the first stroke. */
  readonly start: Grid;
}

export interface Mending {
  readonly repair: boolean;
  readonly fill: boolean;
}

const MOST_STEPS = 200;
/** The most cells that earlier states keep together. */
const MOST_CELLS = 2 ** 25;

export function editorOf(
  grid: Grid,
  objects: readonly MapObject[] = NO_OBJECTS,
  fixed: Uint8Array = new Uint8Array(grid.codes.length),
): Editor {
  return { grid, fixed, objects, past: [], future: [], start: grid };
}

const drawingOf = ({ grid, fixed, objects }: Drawing): Drawing => ({ grid, fixed, objects });

const sameDrawing = (one: Drawing, other: Drawing): boolean =>
  sameGrid(one.grid, other.grid) &&
  one.fixed.every((fixed, cell) => fixed === other.fixed[cell]) &&
  one.objects === other.objects;

/** Returns the editor with a new drawing, as a step that can be undone. */
export function done(editor: Editor, drawing: Drawing): Editor {
  if (sameDrawing(editor, drawing)) return editor;
  const steps = Math.min(MOST_STEPS, Math.ceil(MOST_CELLS / editor.grid.codes.length));
  const past = [...editor.past, drawingOf(editor)].slice(-steps);
  return { ...editor, ...drawing, past, future: [] };
}

/** Returns the editor without roads, fixed cells and objects. */
export function cleared(editor: Editor): Editor {
  const { height, width } = editor.grid;
  return done(editor, drawingOf(editorOf(emptyGrid(height, width))));
}

export function undo(editor: Editor): Editor {
  const last = editor.past.at(-1);
  return last
    ? { ...editor, ...last, past: editor.past.slice(0, -1), future: [drawingOf(editor), ...editor.future] }
    : editor;
}

export function redo(editor: Editor): Editor {
  const [next, ...future] = editor.future;
  return next ? { ...editor, ...next, past: [...editor.past, drawingOf(editor)], future } : editor;
}

/** A stroke: the tool, the tile that it sets, and the cells that it touched, in order. */
export interface Stroke {
  readonly tool: Exclude<Tool, "objects">;
  readonly tile: number;
  readonly cells: readonly number[];
}

/** Returns neighbouring cells that lead from one cell to another, without the first. */
export function between(width: number, from: number, to: number): number[] {
  let row = Math.floor(from / width);
  let column = from % width;
  const down = Math.floor(to / width);
  const right = to % width;
  const cells: number[] = [];
  while (row !== down || column !== right) {
    if (Math.abs(right - column) > Math.abs(down - row)) column += Math.sign(right - column);
    else row += Math.sign(down - row);
    cells.push(row * width + column);
  }
  return cells;
}

/** Returns a drawing after a stroke, repaired if `mending` says so. */
export function stroked(drawing: Drawing, { tool, tile, cells }: Stroke, mending: Mending): Drawing {
  const { height, width } = drawing.grid;
  const codes = drawing.grid.codes.slice();
  const fixed = drawing.fixed.slice();
  if (tool === "fixed") {
    const on = 1 - fixed[cells[0]];
    for (const cell of cells) fixed[cell] = on;
    return { ...drawing, fixed };
  }
  const dirty = new Uint8Array(codes.length);
  for (const cell of cells) dirty[cell] = 1;
  if (tool === "road" || tool === "cut") {
    cells.slice(1).forEach((cell, index) => {
      const side = SIDES.find(({ down, right }) => cells[index] + down * width + right === cell)!;
      if (tool === "road") {
        codes[cells[index]] |= side.bit;
        codes[cell] |= side.opposite;
      } else {
        codes[cells[index]] &= ~side.bit;
        codes[cell] &= ~side.opposite;
      }
    });
  } else {
    for (const cell of cells) {
      codes[cell] = tool === "tile" ? tile : 0;
      if (tool === "forbidden") fixed[cell] = 1;
    }
  }
  const plain = { height, width, codes };
  const held = fixed.map((one, cell) => +(one === 1 && !dirty[cell]));
  const grid = mending.repair ? repair(plain, { dirty, fixed: held, fill: mending.fill }) : plain;
  return { ...drawing, grid, fixed };
}

/** Returns a drawing of another size, cut or filled up with empty cells. Objects outside the new size are removed. */
export function resized({ grid, fixed, objects }: Drawing, height: number, width: number): Drawing {
  const codes = new Uint8Array(height * width);
  const marks = new Uint8Array(height * width);
  rowsOf(grid)
    .slice(0, height)
    .forEach((row, y) =>
      row.slice(0, width).forEach((code, x) => {
        codes[y * width + x] = code;
        marks[y * width + x] = fixed[y * grid.width + x];
      }),
    );
  const left = objects.filter(({ x, y }) => isWithin(x, y, { height, width }));
  return { grid: { height, width, codes }, fixed: marks, objects: left.length < objects.length ? left : objects };
}

/** The canvas on which a map is drawn and its objects are moved, by pointer or by keys. */
import { useEffect, useLayoutEffect, useRef, useState } from "preact/hooks";
import { useShared } from "../context";
import { objectShapes, overlayShapes, paint, ringShapes } from "../drawing";
import { between, done, redo, stroked, undo, type Editor, type Stroke, type Tool } from "../editor";
import type { ObjectTool } from "../hooks/useObjectTool";
import { cellName, columnName } from "../network/cells";
import { KIND_OF, type Grid } from "../network/codes";
import { edgeOf } from "../network/objects";
import { paintMap } from "../raster";
import { fittedStyle, useFittedCanvas } from "./canvas";
import { stepOf } from "./Controls";

export const TILE_KEYS = "Arrow keys move, with Shift they draw, Enter sets a tile, Delete empties it.";
export const OBJECT_KEYS =
  "Arrow keys select an object, with Shift they move it, R turns it, Delete removes it, Enter adds one.";
/** The least number of screen pixels between lines of the lattice. */
const LEAST_LATTICE = 3;
/** The least side of a tile, in pixels of the page, at which rows and columns have names. */
const LEAST_NAMED = 18;

interface CanvasProps {
  readonly editor: Editor;
  readonly onEdit: (editor: Editor) => void;
  readonly tool: Tool;
  readonly objectTool: ObjectTool;
  readonly tile: number;
  readonly mends: boolean;
  readonly fills: boolean;
}

export function EditorCanvas({ editor, onEdit, tool, objectTool, tile, mends, fills }: CanvasProps) {
  const { data, view, say } = useShared();
  const { canvas, width, clear } = useFittedCanvas();
  const [cursor, setCursor] = useState(0);
  const [keyed, setKeyed] = useState(false);
  const stroke = useRef<{ before: Editor; cells: number[] } | null>(null);
  const began = useRef(0);
  const { grid, fixed, objects } = editor;
  const { kinds } = data.objects;
  const selected = tool === "objects" ? objectTool.selected : undefined;
  // Signs are also outside the map. A drag does not change the scale.
  const edge = Math.max(edgeOf((objectTool.before ?? editor).objects, grid), tool === "objects" ? 0.3 : 0);
  const mending = { repair: mends, fill: fills && mends };
  useLayoutEffect(() => {
    if (!width) return;
    const { context, scale, ratio } = clear(grid, edge);
    paintMap(context, grid, scale);
    if (scale > LEAST_LATTICE) paintLattice(context, grid, scale);
    if (scale > LEAST_NAMED * ratio) paintNames(context, grid, scale, ratio);
    paintFixed(context, grid, fixed, scale);
    const rings = selected ? ringShapes(selected, kinds) : [];
    paint(context, { shapes: [...objectShapes(objects, kinds), ...rings], texts: [] }, scale);
    paint(context, overlayShapes(grid, new Set(view.overlays)), scale);
    if (keyed && tool !== "objects") {
      context.lineWidth = 2.5 * ratio;
      context.strokeStyle = "#0a63c9";
      context.strokeRect(
        (cursor % grid.width) * scale + 2,
        Math.floor(cursor / grid.width) * scale + 2,
        scale - 4,
        scale - 4,
      );
    }
    if (began.current) {
      performance.measure("elitelanes-stroke", { start: began.current, end: performance.now() });
      began.current = 0;
    }
  }, [grid, fixed, objects, kinds, selected, edge, width, view.overlays, cursor, keyed, tool, clear]);

  /** Returns the position under the pointer, in tiles. */
  const under = (event: PointerEvent): [x: number, y: number] => {
    const box = canvas.current!.getBoundingClientRect();
    const scale = (grid.width + 2 * edge) / box.width;
    return [(event.clientX - box.left) * scale - edge, (event.clientY - box.top) * scale - edge];
  };
  const cellUnder = (event: PointerEvent): number => {
    const [column, row] = under(event).map(Math.floor);
    return Math.min(Math.max(row, 0), grid.height - 1) * grid.width + Math.min(Math.max(column, 0), grid.width - 1);
  };
  const apply = (before: Editor, cells: readonly number[]) => {
    if (tool === "objects") return;
    began.current = performance.now();
    const next: Stroke = { tool, tile, cells };
    onEdit(done(before, stroked(before, next, mending)));
  };
  const down = (event: PointerEvent) => {
    if (event.button) return;
    canvas.current!.setPointerCapture(event.pointerId);
    setKeyed(false);
    if (tool === "objects") return objectTool.down(under(event));
    const cell = cellUnder(event);
    stroke.current = { before: editor, cells: [cell] };
    setCursor(cell);
    if (tool !== "road" && tool !== "cut") apply(editor, [cell]);
  };
  const move = (event: PointerEvent) => {
    objectTool.move(under(event));
    if (!stroke.current) return;
    const { before, cells } = stroke.current;
    if (before.grid.height !== grid.height || before.grid.width !== grid.width) return;
    const way = between(grid.width, cells[cells.length - 1], cellUnder(event));
    if (!way.length) return;
    cells.push(...way);
    apply(before, cells);
  };
  const release = () => {
    stroke.current = null;
    objectTool.up();
  };
  const keys = (event: KeyboardEvent) => {
    if ((event.ctrlKey || event.metaKey) && ["z", "y"].includes(event.key.toLowerCase())) {
      event.preventDefault();
      onEdit(event.key.toLowerCase() === "y" || event.shiftKey ? redo(editor) : undo(editor));
      return;
    }
    const step = stepOf(event);
    if (tool === "objects") objectTool.press(event, step);
    else if (step) {
      event.preventDefault();
      const row = Math.min(Math.max(Math.floor(cursor / grid.width) + step[1], 0), grid.height - 1);
      const column = Math.min(Math.max((cursor % grid.width) + step[0], 0), grid.width - 1);
      const next = row * grid.width + column;
      if (event.shiftKey && next !== cursor) apply(editor, tool === "road" || tool === "cut" ? [cursor, next] : [next]);
      setCursor(next);
      setKeyed(true);
      say(`${cellName(row, column)}: ${KIND_OF[grid.codes[next]]}`, true);
    } else if (event.key === "Enter" || event.key === " ") {
      event.preventDefault();
      if (tool !== "road" && tool !== "cut") apply(editor, [cursor]);
    } else if (event.key === "Delete" || event.key === "Backspace") {
      event.preventDefault();
      began.current = performance.now();
      onEdit(done(editor, stroked(editor, { tool: "erase", tile: 0, cells: [cursor] }, mending)));
    }
  };
  useEffect(() => setCursor((cell) => Math.min(cell, grid.codes.length - 1)), [grid]);
  return (
    <canvas
      ref={canvas}
      class="map editor"
      style={fittedStyle(grid, edge, 76)}
      tabIndex={0}
      role="application"
      aria-roledescription="map editor"
      aria-label={`Map of ${grid.height} by ${grid.width} tiles. ${tool === "objects" ? OBJECT_KEYS : TILE_KEYS}`}
      onPointerDown={down}
      onPointerMove={move}
      onPointerUp={release}
      onPointerCancel={release}
      onKeyDown={keys}
    />
  );
}

function paintLattice(context: CanvasRenderingContext2D, { height, width }: Grid, scale: number): void {
  context.strokeStyle = "rgba(30,40,30,0.16)";
  context.lineWidth = 1;
  context.beginPath();
  for (let row = 1; row < height; row++) {
    context.moveTo(0, Math.round(row * scale) + 0.5);
    context.lineTo(width * scale, Math.round(row * scale) + 0.5);
  }
  for (let column = 1; column < width; column++) {
    context.moveTo(Math.round(column * scale) + 0.5, 0);
    context.lineTo(Math.round(column * scale) + 0.5, height * scale);
  }
  context.stroke();
}

/** Writes letters along the northern border and numbers along the western one, as on a spreadsheet. */
function paintNames(context: CanvasRenderingContext2D, grid: Grid, scale: number, ratio: number): void {
  const write = (name: string, x: number, y: number) => {
    context.strokeText(name, x, y);
    context.fillText(name, x, y);
  };
  context.font = `${10 * ratio}px sans-serif`;
  context.fillStyle = "#1d2026";
  // A light outline keeps the names readable on roads.
  context.strokeStyle = "rgba(255,255,255,0.8)";
  context.lineWidth = 2.5 * ratio;
  context.lineJoin = "round";
  [context.textAlign, context.textBaseline] = ["center", "top"];
  for (let column = 0; column < grid.width; column++) {
    write(columnName(column), (column + 0.5) * scale, 3 * ratio);
  }
  [context.textAlign, context.textBaseline] = ["left", "middle"];
  for (let row = 0; row < grid.height; row++) write(`${row + 1}`, 3 * ratio, (row + 0.5) * scale);
}

/** Frames fixed cells, and crosses out fixed cells without a road. */
function paintFixed(context: CanvasRenderingContext2D, { width, codes }: Grid, fixed: Uint8Array, scale: number): void {
  fixed.forEach((one, cell) => {
    if (!one) return;
    const x = (cell % width) * scale;
    const y = Math.floor(cell / width) * scale;
    context.fillStyle = codes[cell] ? "rgba(10,99,201,0.16)" : "rgba(160,40,40,0.16)";
    context.fillRect(x, y, scale, scale);
    context.strokeStyle = codes[cell] ? "#0a63c9" : "#a02828";
    context.lineWidth = Math.max(1.5, scale * 0.05);
    context.strokeRect(x + scale * 0.06, y + scale * 0.06, scale * 0.88, scale * 0.88);
    if (!codes[cell]) {
      context.beginPath();
      context.moveTo(x + scale * 0.06, y + scale * 0.06);
      context.lineTo(x + scale * 0.94, y + scale * 0.94);
      context.stroke();
    }
  });
}

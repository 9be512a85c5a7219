/** The canvas on which a map is drawn, by pointer or by keys. */
import { useEffect, useLayoutEffect, useRef, useState } from "preact/hooks";
import { useShared } from "../context";
import { mapShapes, overlayShapes, paint } from "../drawing";
import { between, done, redo, stroked, undo, type Editor, type Stroke, type Tool } from "../editor";
import { KIND_OF, type Grid } from "../network/codes";
import { useFittedCanvas } from "./canvas";

interface CanvasProps {
  readonly editor: Editor;
  readonly onEdit: (editor: Editor) => void;
  readonly tool: Tool;
  readonly tile: number;
  readonly mends: boolean;
  readonly fills: boolean;
}

export function EditorCanvas({ editor, onEdit, tool, tile, mends, fills }: CanvasProps) {
  const { view, say } = useShared();
  const { canvas, width, clear } = useFittedCanvas();
  const [cursor, setCursor] = useState(0);
  const [keyed, setKeyed] = useState(false);
  const stroke = useRef<{ before: Editor; cells: number[] } | null>(null);
  const began = useRef(0);
  const { grid, fixed } = editor;
  const mending = { repair: mends, fill: fills && mends };
  useLayoutEffect(() => {
    if (!width) return;
    const { context, scale, ratio } = clear(grid);
    paint(context, { shapes: mapShapes(grid, { lanes: scale > 14 }), texts: [] }, scale);
    paintLattice(context, grid, scale);
    paintFixed(context, grid, fixed, scale);
    paint(context, overlayShapes(grid, new Set(view.overlays)), scale);
    if (keyed) {
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
  }, [grid, fixed, width, view.overlays, cursor, keyed, clear]);

  const cellUnder = (event: PointerEvent): number => {
    const box = canvas.current!.getBoundingClientRect();
    const column = Math.min(
      Math.max(Math.floor(((event.clientX - box.left) / box.width) * grid.width), 0),
      grid.width - 1,
    );
    const row = Math.min(
      Math.max(Math.floor(((event.clientY - box.top) / box.height) * grid.height), 0),
      grid.height - 1,
    );
    return row * grid.width + column;
  };
  const apply = (before: Editor, cells: readonly number[]) => {
    began.current = performance.now();
    const next: Stroke = { tool, tile, cells };
    onEdit(done(before, stroked(before, next, mending)));
  };
  const down = (event: PointerEvent) => {
    if (event.button) return;
    canvas.current!.setPointerCapture(event.pointerId);
    setKeyed(false);
    const cell = cellUnder(event);
    stroke.current = { before: editor, cells: [cell] };
    setCursor(cell);
    if (tool !== "road" && tool !== "cut") apply(editor, [cell]);
  };
  const move = (event: PointerEvent) => {
    if (!stroke.current) return;
    const { before, cells } = stroke.current;
    if (before.grid.height !== grid.height || before.grid.width !== grid.width) return;
    const way = between(grid.width, cells[cells.length - 1], cellUnder(event));
    if (!way.length) return;
    cells.push(...way);
    apply(before, cells);
  };
  const keys = (event: KeyboardEvent) => {
    if ((event.ctrlKey || event.metaKey) && ["z", "y"].includes(event.key.toLowerCase())) {
      event.preventDefault();
      onEdit(event.key.toLowerCase() === "y" || event.shiftKey ? redo(editor) : undo(editor));
      return;
    }
    const step = { ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowUp: [-1, 0], ArrowDown: [1, 0] }[event.key];
    if (step) {
      event.preventDefault();
      const row = Math.min(Math.max(Math.floor(cursor / grid.width) + step[0], 0), grid.height - 1);
      const column = Math.min(Math.max((cursor % grid.width) + step[1], 0), grid.width - 1);
      const next = row * grid.width + column;
      if (event.shiftKey && next !== cursor) apply(editor, tool === "road" || tool === "cut" ? [cursor, next] : [next]);
      setCursor(next);
      setKeyed(true);
      say(`row ${row + 1}, column ${column + 1}: ${KIND_OF[grid.codes[next]]}`, true);
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
      style={{
        aspectRatio: `${grid.width} / ${grid.height}`,
        maxWidth: `min(100%, ${(76 * grid.width) / grid.height}vh)`,
      }}
      tabIndex={0}
      role="application"
      aria-roledescription="map editor"
      aria-label={`Map of ${grid.height} by ${grid.width} tiles. Arrow keys move, with Shift they draw, Enter sets a tile, Delete empties it.`}
      onPointerDown={down}
      onPointerMove={move}
      onPointerUp={() => (stroke.current = null)}
      onPointerCancel={() => (stroke.current = null)}
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

/** The editor of maps: roads by dragging, with or without repair; metrics and fitness change as one draws. */
import { useEffect, useLayoutEffect, useMemo, useRef, useState } from "preact/hooks";
import { useShared } from "../context";
import { mapShapes, overlayShapes, paint, sceneOf, toSvg } from "../drawing";
import { between, done, redo, resized, stroked, undo, type Editor, type Stroke, type Tool } from "../editor";
import { save, savePng } from "../files";
import { emptyGrid, KIND_OF, type Grid } from "../network/codes";
import { FileError, toDuckietown, toFix, toMapJson } from "../network/formats";
import { COUNT_NAMES, fitness, measure, type Weights } from "../network/measure";
import { feature, FEATURES, isOurs, isShare } from "../network/features";
import { measureTown } from "../network/town";
import { useFittedCanvas } from "../parts/canvas";
import { OverlaySwitches } from "../parts/Detail";
import { Metrics } from "../parts/Metrics";
import { Switch } from "../parts/Controls";
import { paintTiles } from "../tiles";
import { nameOf, number } from "../words";

const TOOL_WORDS: Readonly<Record<Tool, readonly [name: string, what: string]>> = {
  road: ["Road", "drag from tile to tile to link them"],
  cut: ["Cut", "drag from tile to tile to cut their link"],
  erase: ["Erase", "drag over tiles to empty them"],
  tile: ["Tile", "click to set the tile that is chosen below"],
  given: ["Given", "mark cells that a search keeps as they are"],
  forbidden: ["No road", "mark cells in which a search may build no road"],
};

interface Props {
  readonly editor: Editor;
  readonly onEdit: (editor: Editor) => void;
  readonly weights: Weights;
  readonly onWeights: (weights: Weights | null) => void;
  readonly onFiles: (files: ArrayLike<File>) => void;
  /** Asks a notebook to continue its search from the map. */
  readonly onContinue: (() => void) | null;
  /** Whether the notebook is at it. */
  readonly searches: boolean;
}

export function Draw({ editor, onEdit, weights, onWeights, onFiles, onContinue, searches }: Props) {
  const { data, run, view, tiles, say } = useShared();
  const [tool, setTool] = useState<Tool>("road");
  const [tile, setTile] = useState(15);
  const [mends, setMends] = useState(true);
  const [fills, setFills] = useState(false);
  const picker = useRef<HTMLInputElement>(null);
  const { grid, given } = editor;
  const counts = useMemo(() => measure(grid, run.alphabet), [grid, run]);
  const before = useMemo(() => measure(editor.start, run.alphabet), [editor.start, run]);
  const others = [...new Set([...run.extras.keys(), ...Object.keys(weights)])].filter((name) => !FEATURES.includes(name) && name !== "constant");
  const town = useMemo(() => (others.some(isOurs) ? measureTown(grid) : {}), [grid, others.join()]);
  const townBefore = useMemo(() => (others.some(isOurs) ? measureTown(editor.start) : {}), [editor.start, others.join()]);
  const extras = Object.fromEntries([...run.extras.keys()].map((name) => [name, town[name as keyof typeof town] ?? NaN]));
  const unknown = others.filter((name) => !(name in town));
  const total = fitness(counts, weights, town);
  const change = total - fitness(before, weights, townBefore);

  const resize = (side: "height" | "width", input: HTMLInputElement) => {
    const length = Number(input.value);
    if (Number.isInteger(length) && length >= 2 && length <= 1024) {
      return onEdit(done(editor, side === "height" ? resized(editor, length, grid.width) : resized(editor, grid.height, length)));
    }
    say(`Expected a whole number from 2 to 1024, got ${input.value || "none"}`);
    input.value = `${grid[side]}`;
  };
  const saveYaml = () => {
    try {
      save("drawn.yaml", toDuckietown(grid));
    } catch (error) {
      if (!(error instanceof FileError)) throw error;
      say(error.message);
    }
  };
  const metricsOfGrid = () => ({
    metrics: {
      ...Object.fromEntries(FEATURES.filter((name) => !isShare(name)).map((name) => [name, feature(name, counts)])),
      coverage: Math.fround(feature("tiles", counts) / grid.codes.length),
    },
    fitness: total,
  });
  return (
    <div class="split">
      <section class="panel" aria-label="Editor">
        <div class="bar">
          <div class="segments" role="group" aria-label="Tool">
            {Object.entries(TOOL_WORDS).map(([name, [word, what]]) => (
              <button key={name} type="button" aria-pressed={tool === name} title={what} onClick={() => setTool(name as Tool)}>{word}</button>
            ))}
          </div>
          <div class="buttons">
            <button type="button" disabled={!editor.past.length} onClick={() => onEdit(undo(editor))}>Undo</button>
            <button type="button" disabled={!editor.future.length} onClick={() => onEdit(redo(editor))}>Redo</button>
          </div>
        </div>
        {tool === "tile" && <TilePalette tile={tile} onTile={setTile} />}
        <Canvas editor={editor} onEdit={onEdit} tool={tool} tile={tile} mends={mends} fills={fills} />
        <div class="bar">
          <Switch on={mends} onChange={setMends} title="neighbours of what is drawn agree with it; no road leaves the grid">Repair</Switch>
          <Switch on={fills && mends} onChange={(on) => (setFills(on), on && setMends(true))} title="repair also gives every tile two connections or more">Fill</Switch>
          <label class="size">Rows <input type="number" min="2" max="1024" value={grid.height} onChange={(event) => resize("height", event.currentTarget)} /></label>
          <label class="size">Columns <input type="number" min="2" max="1024" value={grid.width} onChange={(event) => resize("width", event.currentTarget)} /></label>
          <button type="button" onClick={() => onEdit(done(editor, { grid: emptyGrid(grid.height, grid.width), given: new Uint8Array(grid.codes.length) }))}>Clear</button>
          <button type="button" onClick={() => picker.current!.click()}>Open a file</button>
          <input ref={picker} type="file" accept=".json,.yaml,.yml" hidden aria-label="Map file" onChange={(event) => {
            onFiles(event.currentTarget.files ?? []);
            event.currentTarget.value = ""; // the same file may be opened again
          }} />
        </div>
        <p class="note">{TOOL_WORDS[tool][1][0].toUpperCase() + TOOL_WORDS[tool][1].slice(1)}. Or drop a map.json or a Duckietown map here. With keys: arrows move, with Shift they draw, Enter sets a tile, Ctrl+Z takes back.</p>
        <OverlaySwitches counts={counts} />
        <div class="buttons">
          <span class="saves" role="group" aria-label="Save">
            <span aria-hidden="true">Save</span>
            <button type="button" onClick={() => save("drawn.json", toMapJson(grid, metricsOfGrid()), "application/json")}>map.json</button>
            <button type="button" onClick={saveYaml}>YAML</button>
            <button type="button" onClick={() => save("drawn.svg", toSvg(sceneOf(grid, new Set(view.overlays))), "image/svg+xml")}>SVG</button>
            <button type="button" disabled={!tiles} onClick={() => void savePng("drawn.png", paintTiles(grid, data, tiles!, null, { image: 1 }))}>PNG</button>
            <button type="button" disabled={!given.includes(1)} title="the given cells, as generate --fix takes them" onClick={() => save("fix.json", toFix(grid, given), "application/json")}>fix.json</button>
          </span>
          {onContinue && <button type="button" class="main" disabled={searches} onClick={onContinue}>{searches ? "Searching…" : "Continue the search from here"}</button>}
        </div>
      </section>
      <section class="panel side" aria-label="What it measures">
        <div class="total" aria-live="polite">
          <span>Fitness</span>
          <b>{number(total)}</b>
          {change !== 0 && <em class={change < 0 ? "better" : "worse"}>{change < 0 ? "▼" : "▲"} {number(Math.abs(change))} {change < 0 ? "better" : "worse"} than at first</em>}
        </div>
        {unknown.length > 0 && (
          <p class="note">
            {unknown.map(nameOf).join(", ")}: a search alone can measure {unknown.length > 1 ? "them" : "it"}
            {unknown.some((name) => weights[name]) && "; the fitness here leaves it out"}.
          </p>
        )}
        <WeightSliders weights={weights} counts={counts} town={town} usual={run.weights} onWeights={onWeights} />
        <Metrics run={run} grid={grid} counts={counts} fitness={total} extras={extras} />
      </section>
    </div>
  );
}

function TilePalette({ tile, onTile }: { readonly tile: number; readonly onTile: (tile: number) => void }) {
  return (
    <div class="palette" role="group" aria-label="Tile to set">
      {Array.from({ length: 16 }, (_, code) => (
        <button key={code} type="button" aria-pressed={code === tile} aria-label={`code ${code}, ${KIND_OF[code]}`} title={`code ${code}, ${KIND_OF[code]}`} onClick={() => onTile(code)}>
          <svg viewBox="0 0 1 1" aria-hidden="true">
            {mapShapes({ height: 1, width: 1, codes: Uint8Array.of(code) }, { lanes: false }).slice(0, -1).concat(code ? [] : mapShapes(emptyGrid(1, 1))).map((shape, place) => (
              <path key={place} d={shape.d} fill={shape.fill ?? "none"} stroke={shape.stroke} stroke-width={shape.width} />
            ))}
          </svg>
        </button>
      ))}
    </div>
  );
}

interface CanvasProps {
  readonly editor: Editor;
  readonly onEdit: (editor: Editor) => void;
  readonly tool: Tool;
  readonly tile: number;
  readonly mends: boolean;
  readonly fills: boolean;
}

function Canvas({ editor, onEdit, tool, tile, mends, fills }: CanvasProps) {
  const { view, say } = useShared();
  const { canvas, width, clear } = useFittedCanvas();
  const [cursor, setCursor] = useState(0);
  const [keyed, setKeyed] = useState(false);
  const stroke = useRef<{ before: Editor; cells: number[] } | null>(null);
  const began = useRef(0);
  const { grid, given } = editor;
  const mending = { repair: mends, fill: fills && mends };
  useLayoutEffect(() => {
    if (!width) return;
    const { context, scale, ratio } = clear(grid);
    paint(context, { shapes: mapShapes(grid, { lanes: scale > 14 }), texts: [] }, scale);
    paintLattice(context, grid, scale);
    paintGiven(context, grid, given, scale);
    paint(context, overlayShapes(grid, new Set(view.overlays)), scale);
    if (keyed) {
      context.lineWidth = 2.5 * ratio;
      context.strokeStyle = "#0a63c9";
      context.strokeRect((cursor % grid.width) * scale + 2, Math.floor(cursor / grid.width) * scale + 2, scale - 4, scale - 4);
    }
    if (began.current) {
      performance.measure("elitelanes-stroke", { start: began.current, end: performance.now() });
      began.current = 0;
    }
  }, [editor, width, view.overlays.join(), cursor, keyed]);

  const cellUnder = (event: PointerEvent): number => {
    const box = canvas.current!.getBoundingClientRect();
    const column = Math.min(Math.max(Math.floor(((event.clientX - box.left) / box.width) * grid.width), 0), grid.width - 1);
    const row = Math.min(Math.max(Math.floor(((event.clientY - box.top) / box.height) * grid.height), 0), grid.height - 1);
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
  useEffect(() => setCursor((place) => Math.min(place, grid.codes.length - 1)), [grid]);
  return (
    <canvas
      ref={canvas}
      class="map editor"
      style={{ aspectRatio: `${grid.width} / ${grid.height}`, maxWidth: `min(100%, ${(76 * grid.width) / grid.height}vh)` }}
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
  for (let row = 1; row < height; row++) context.moveTo(0, Math.round(row * scale) + 0.5), context.lineTo(width * scale, Math.round(row * scale) + 0.5);
  for (let column = 1; column < width; column++) context.moveTo(Math.round(column * scale) + 0.5, 0), context.lineTo(Math.round(column * scale) + 0.5, height * scale);
  context.stroke();
}

/** Frames given cells; those without a road are crossed out. */
function paintGiven(context: CanvasRenderingContext2D, { width, codes }: Grid, given: Uint8Array, scale: number): void {
  given.forEach((one, place) => {
    if (!one) return;
    const x = (place % width) * scale, y = Math.floor(place / width) * scale;
    context.fillStyle = codes[place] ? "rgba(10,99,201,0.16)" : "rgba(160,40,40,0.16)";
    context.fillRect(x, y, scale, scale);
    context.strokeStyle = codes[place] ? "#0a63c9" : "#a02828";
    context.lineWidth = Math.max(1.5, scale * 0.05);
    context.strokeRect(x + scale * 0.06, y + scale * 0.06, scale * 0.88, scale * 0.88);
    if (!codes[place]) {
      context.beginPath();
      context.moveTo(x + scale * 0.06, y + scale * 0.06);
      context.lineTo(x + scale * 0.94, y + scale * 0.94);
      context.stroke();
    }
  });
}

interface WeightProps {
  readonly weights: Weights;
  readonly usual: Weights;
  readonly counts: ArrayLike<number>;
  /** Features beside the metrics that have a weight or may have one. */
  readonly town: Readonly<Record<string, number>>;
  readonly onWeights: (weights: Weights | null) => void;
}

/** The weights of the fitness as sliders, with what each adds. */
function WeightSliders({ weights, usual, counts, town, onWeights }: WeightProps) {
  const names = [...COUNT_NAMES, ...Object.keys(usual).filter((name) => name in town)].sort((one, other) => +(usual[other] !== 0) - +(usual[one] !== 0));
  const used = names.filter((name) => usual[name] || weights[name]);
  const others = names.filter((name) => !used.includes(name));
  const changed = names.filter((name) => weights[name] !== usual[name]);
  const sliders = (list: readonly string[]) => list.map((name) => {
    const units = name in town ? town[name] : name === "components" ? Math.max(feature(name, counts) - 1, 0) : feature(name, counts);
    return (
      <label key={name} class="weight">
        <span>{nameOf(name)}</span>
        <input type="range" min="-100" max="1000" step="1" value={weights[name]} onInput={(event) => onWeights({ ...weights, [name]: Number(event.currentTarget.value) })} />
        <output>{number(weights[name])} × {number(units)}</output>
      </label>
    );
  });
  return (
    <details class="weights">
      <summary>Weights{changed.length > 0 && `, ${changed.length} changed`}</summary>
      {sliders(used)}
      <details>
        <summary>Weights of 0</summary>
        {sliders(others)}
      </details>
      {changed.length > 0 && (
        <div class="bar">
          <code class="where">--weights {changed.map((name) => `${name}=${weights[name]}`).join(" ")}</code>
          <button type="button" onClick={() => onWeights(null)}>Reset</button>
        </div>
      )}
    </details>
  );
}

/** The editor of maps: roads are drawn by dragging, with or without repair; metrics and fitness follow each stroke. */
import { useMemo, useRef, useState } from "preact/hooks";
import { useShared } from "../context";
import { cleared, done, redo, resized, undo, type Editor, type Tool } from "../editor";
import { save } from "../files";
import { useObjectTool } from "../hooks/useObjectTool";
import { FEATURES, isOurs } from "../network/features";
import { toFix } from "../network/formats";
import { fitness, measure, type Weights } from "../network/measure";
import { measureTown } from "../network/town";
import { Switch, WholeNumber } from "../parts/Controls";
import { EditorCanvas, OBJECT_KEYS, TILE_KEYS } from "../parts/EditorCanvas";
import { OverlaySwitches } from "../parts/Looks";
import { Metrics } from "../parts/Metrics";
import { ObjectFields } from "../parts/ObjectFields";
import { Objects } from "../parts/Objects";
import { SaveButtons } from "../parts/SaveButtons";
import { ShelfTable } from "../parts/ShelfTable";
import { SignNote } from "../parts/SignNote";
import { TilePalette } from "../parts/TilePalette";
import { WeightSliders } from "../parts/WeightSliders";
import { metricFields } from "../record";
import { nameOf, number } from "../words";

const TOOL_WORDS: Readonly<Record<Tool, readonly [name: string, what: string]>> = {
  road: ["Road", "drag from tile to tile to link them"],
  cut: ["Cut", "drag from tile to tile to cut their link"],
  erase: ["Erase", "drag over tiles to empty them"],
  tile: ["Tile", "click to set the tile that is chosen below"],
  fixed: ["Fixed", "mark cells that a search keeps as they are"],
  forbidden: ["No road", "mark cells in which a search may build no road"],
  objects: ["Objects", "drag objects to move them, click on a free place to add one"],
};

interface Props {
  readonly editor: Editor;
  readonly onEdit: (editor: Editor) => void;
  readonly weights: Weights;
  readonly onWeights: (weights: Weights | null) => void;
  readonly onFiles: (files: ArrayLike<File>) => void;
}

export function Draw({ editor, onEdit, weights, onWeights, onFiles }: Props) {
  const { data, run, say } = useShared();
  const [tool, setTool] = useState<Tool>("road");
  const [tile, setTile] = useState(15);
  const [mends, setMends] = useState(true);
  const [fills, setFills] = useState(false);
  const objectTool = useObjectTool(editor, onEdit);
  const picker = useRef<HTMLInputElement>(null);
  const { grid, fixed, objects } = editor;
  const metrics = useMemo(() => measure(grid, run.alphabet), [grid, run]);
  const before = useMemo(() => measure(editor.start, run.alphabet), [editor.start, run]);
  const others = [...new Set([...run.features.keys(), ...Object.keys(weights)])].filter(
    (name) => !FEATURES.includes(name) && name !== "constant",
  );
  const needsTown = others.some(isOurs);
  const town = useMemo(() => (needsTown ? measureTown(grid) : {}), [grid, needsTown]);
  const townBefore = useMemo(() => (needsTown ? measureTown(editor.start) : {}), [editor.start, needsTown]);
  const features = Object.fromEntries(
    [...run.features.keys()].map((name) => [name, town[name as keyof typeof town] ?? NaN]),
  );
  const unknown = others.filter((name) => !(name in town));
  const isWhole = !unknown.some((name) => weights[name]);
  // A sum that leaves features out is not the fitness.
  const isFitness = run.usualFitness && isWhole;
  const total = fitness(metrics, weights, town);
  const change = total - fitness(before, weights, townBefore);
  return (
    <div class="split">
      <section class="panel" aria-label="Editor">
        <div class="bar">
          <div class="segments" role="group" aria-label="Tool">
            {Object.entries(TOOL_WORDS).map(([name, [word, what]]) => (
              <button
                key={name}
                type="button"
                aria-pressed={tool === name}
                title={what}
                onClick={() => setTool(name as Tool)}
              >
                {word}
              </button>
            ))}
          </div>
          <div class="buttons">
            <button type="button" disabled={!editor.past.length} onClick={() => onEdit(undo(editor))}>
              Undo
            </button>
            <button type="button" disabled={!editor.future.length} onClick={() => onEdit(redo(editor))}>
              Redo
            </button>
          </div>
        </div>
        {tool === "tile" && <TilePalette tile={tile} onTile={setTile} />}
        {tool === "objects" && <ObjectFields tool={objectTool} />}
        <EditorCanvas
          editor={editor}
          onEdit={onEdit}
          tool={tool}
          objectTool={objectTool}
          tile={tile}
          mends={mends}
          fills={fills}
        />
        <div class="bar">
          <Switch
            on={mends}
            onChange={setMends}
            title="neighbours of a stroke agree with it, and no road leaves the grid"
          >
            Repair
          </Switch>
          <Switch
            on={fills && mends}
            onChange={(on) => (setFills(on), on && setMends(true))}
            title="repair also gives every tile two connections or more"
          >
            Fill
          </Switch>
          <WholeNumber
            label="Rows"
            value={grid.height}
            least={2}
            most={1024}
            onChange={(height) => onEdit(done(editor, resized(editor, height, grid.width)))}
            say={say}
          />
          <WholeNumber
            label="Columns"
            value={grid.width}
            least={2}
            most={1024}
            onChange={(width) => onEdit(done(editor, resized(editor, grid.height, width)))}
            say={say}
          />
          <button type="button" onClick={() => onEdit(cleared(editor))}>
            Clear
          </button>
          <button type="button" onClick={() => picker.current!.click()}>
            Open a file
          </button>
          <input
            ref={picker}
            type="file"
            accept=".json,.yaml,.yml"
            hidden
            aria-label="Map file"
            onChange={(event) => {
              onFiles(event.currentTarget.files ?? []);
              event.currentTarget.value = ""; // the same file may be opened again
            }}
          />
        </div>
        <p class="note">
          {TOOL_WORDS[tool][1][0].toUpperCase() + TOOL_WORDS[tool][1].slice(1)}. Or drop a map.json or a Duckietown map
          here. {tool === "objects" ? OBJECT_KEYS : TILE_KEYS} Ctrl+Z undoes.
        </p>
        <SignNote
          grid={grid}
          objects={objects}
          onObjects={(placed) => onEdit(done(editor, { ...editor, objects: placed }))}
        />
        <Objects objects={objects} />
        <OverlaySwitches metrics={metrics} />
        <div class="buttons">
          <SaveButtons
            name="drawn"
            grid={grid}
            objects={objects}
            fields={() => ({
              metrics: metricFields(metrics, grid.codes.length),
              ...(isFitness && { fitness: total }),
            })}
          >
            <button
              type="button"
              disabled={!fixed.includes(1)}
              title="the fixed cells, as generate --fix takes them"
              onClick={() => save("fix.json", toFix(grid, fixed), "application/json")}
            >
              fix.json
            </button>
          </SaveButtons>
        </div>
      </section>
      <section class="panel side" aria-label="What it measures">
        <div class="total" aria-live="polite">
          <span>{isFitness ? "Fitness" : "Weighted sum"}</span>
          <b>{number(total)}</b>
          {change !== 0 && (
            <em class={change < 0 ? "better" : "worse"}>
              {change < 0 ? "▼" : "▲"} {number(Math.abs(change))} {change < 0 ? "better" : "worse"} than at first
            </em>
          )}
        </div>
        {!run.usualFitness && (
          <p class="note">
            The recorded fitness adds a penalty of ranges, has other weights, or is a user's function. Only a search can
            compute it.
          </p>
        )}
        {unknown.length > 0 && (
          <p class="note">
            {unknown.map(nameOf).join(", ")}: only a search can measure {unknown.length > 1 ? "them" : "it"}
            {!isWhole && "; the sum here leaves it out"}.
          </p>
        )}
        <ShelfTable grid={grid} />
        <WeightSliders
          weights={weights}
          usual={run.weights}
          defaults={data.defaultWeights}
          metrics={metrics}
          town={town}
          onWeights={onWeights}
        />
        <Metrics run={run} grid={grid} metrics={metrics} fitness={isFitness ? total : NaN} features={features} />
      </section>
    </div>
  );
}

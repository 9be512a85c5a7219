/** A photograph: corners to drag, and the kind and direction of each cell. */
import { useRef, useState } from "preact/hooks";
import { cellName, columnName } from "../network/cells";
import { KIND_OF, SIDES } from "../network/codes";
import { Choice, stepOf, Switch, WholeNumber } from "../parts/Controls";
import { areConvex, outlineOf, pixelOf, viewOf, type Point, type View } from "./view";
import {
  ask,
  corrected,
  kindOfCode,
  KINDS,
  kindWord,
  refitted,
  sureCells,
  SURE,
  type Photograph,
  type Proposal,
} from "./work";

const CORNER_NAMES = ["first", "second", "third", "fourth"];
/** How far inside the floor the names of its columns and rows are, in tiles. */
const BORDER = 0.12;
/** Milliseconds after the last key until a moved corner is fitted. */
const PAUSE = 900;
/** The most rows and columns of tiles on a photograph. */
const MOST_TILES = 40;

interface Props {
  readonly photograph: Photograph;
  readonly index: number;
  /** Changes the latest photograph, not the one that is drawn. */
  readonly onChange: (make: (photograph: Photograph) => Photograph) => void;
  readonly onCut: (proposal: Proposal) => void;
  readonly say: (text: string) => void;
}

const cornersOf = ({ proposal, width, height }: Photograph): readonly Point[] =>
  proposal?.corners ?? [
    [width * 0.2, height * 0.2],
    [width * 0.8, height * 0.2],
    [width * 0.8, height * 0.8],
    [width * 0.2, height * 0.8],
  ];

export function PhotographView({ photograph, index, onChange, onCut, say }: Props) {
  const { width, height, rows, columns, proposal } = photograph;
  const [snaps, setSnaps] = useState(true);
  const [busy, setBusy] = useState(false);
  const [dragged, setDragged] = useState<readonly Point[] | null>(null);
  const [cell, setCell] = useState<readonly [number, number]>([0, 0]);
  // Fewer rows or columns may lack the selected cell.
  const [row, column] = [Math.min(cell[0], rows - 1), Math.min(cell[1], columns - 1)];
  const picture = useRef<SVGSVGElement>(null);
  const grabbed = useRef(-1);
  const timer = useRef(0);
  const corners = dragged ?? cornersOf(photograph);
  const view: View = dragged || !proposal ? viewOf(corners, rows, columns, width, height) : proposal;

  /** Asks for a fit near corners, or without any. */
  const fit = async (near: readonly Point[] | null, size: readonly [number, number] = [rows, columns]) => {
    // A corner that was moved just before would be fitted to the earlier size.
    clearTimeout(timer.current);
    setBusy(true);
    try {
      const values = { photo: index, corners: near, rows: size[0], columns: size[1], exact: !snaps };
      const fitted = await ask<Proposal>("fit", values);
      onChange((now) => refitted(now, ...size, fitted));
      if (fitted.advice) say(fitted.advice);
    } catch (error) {
      const advice = (error as Error).message;
      if (size[0] !== rows || size[1] !== columns) {
        onChange((now) => ({ ...now, rows: size[0], columns: size[1], proposal: null, advice }));
      }
      say(advice);
    }
    setDragged(null);
    setBusy(false);
  };
  const release = (moved: readonly Point[]) => {
    if (areConvex(moved)) return void fit(moved);
    say("The corners must go clockwise around the tiles, and their lines must not cross");
    setDragged(null);
  };
  const place = (event: PointerEvent): Point => {
    const box = picture.current!.getBoundingClientRect();
    const scale = width / box.width;
    return [(event.clientX - box.left) * scale - 0.5, (event.clientY - box.top) * scale - 0.5];
  };
  const within = ([x, y]: Point): Point => [Math.min(Math.max(x, 0), width - 1), Math.min(Math.max(y, 0), height - 1)];
  const replaced = (corner: number, point: Point) =>
    corners.map((old, other) => (other === corner ? within(point) : old));
  const down = (event: PointerEvent, corner: number) => {
    if (busy) return;
    (event.currentTarget as Element).setPointerCapture(event.pointerId);
    grabbed.current = corner;
  };
  const move = (event: PointerEvent) => {
    if (grabbed.current >= 0) setDragged(replaced(grabbed.current, place(event)));
  };
  const up = () => {
    grabbed.current = -1;
    if (dragged) release(dragged);
  };
  const cornerKeys = (event: KeyboardEvent, corner: number) => {
    const step = stepOf(event);
    if (!step || busy) return;
    event.preventDefault();
    const reach = (event.shiftKey ? 10 : 1) * Math.max(1, width / 1600);
    const moved = replaced(corner, [corners[corner][0] + step[0] * reach, corners[corner][1] + step[1] * reach]);
    setDragged(moved);
    clearTimeout(timer.current);
    timer.current = window.setTimeout(() => release(moved), PAUSE);
  };
  const setCode = (code: number) => {
    if (proposal) onChange((now) => corrected(now, row, column, code));
  };
  const code = proposal?.codes[row]?.[column] ?? 0;
  const turn = () => {
    const codes = KINDS[kindOfCode(code)] ?? [0];
    setCode(codes[(codes.indexOf(code) + codes.length - 1) % codes.length]);
  };
  const cellKeys = (event: KeyboardEvent) => {
    const step = stepOf(event);
    if (event.key.toLowerCase() === "r") return turn();
    if (!step) return;
    event.preventDefault();
    const next = [row + step[1], column + step[0]] as const;
    if (next[0] < 0 || next[0] >= rows || next[1] < 0 || next[1] >= columns) return;
    setCell(next);
    picture.current!.querySelector<SVGElement>(`[data-cell="${next.join()}"]`)!.focus();
  };
  const cells = Array.from(
    { length: rows * columns },
    (_, cell) => [Math.floor(cell / columns), cell % columns] as const,
  );
  const unit = width / 100;
  const named = (name: string, place: Point) => {
    const [x, y] = pixelOf(view, place);
    return (
      <text
        key={name}
        class="cell-name"
        aria-hidden="true"
        x={x}
        y={y}
        style={{ fontSize: `${unit * 2.8}px` }}
        stroke-width={unit * 0.6}
      >
        {name}
      </text>
    );
  };
  const sides = SIDES.filter(({ bit }) => code & bit).map(({ name }) => name);
  const cuts = proposal ? sureCells(proposal) : 0;
  return (
    <div class="split">
      <section class="panel" aria-label="Photograph">
        <svg
          ref={picture}
          class="photograph"
          viewBox={`-0.5 -0.5 ${width} ${height}`}
          aria-busy={busy}
          onPointerMove={move}
          role="group"
          aria-label={photograph.name}
        >
          <image href={`photographs/${index}`} x="-0.5" y="-0.5" width={width} height={height} />
          {cells.map(([y, x]) => {
            const value = proposal?.codes[y]?.[x] ?? 0;
            const isSure = (proposal?.sure[y]?.[x] ?? 0) >= SURE;
            const centre = pixelOf(view, [x + 0.5, y + 0.5]);
            const ways = SIDES.filter(({ bit }) => value & bit).map(({ right, down: below }) =>
              pixelOf(view, [x + 0.5 + right * 0.42, y + 0.5 + below * 0.42]),
            );
            const isSelected = y === row && x === column;
            const name = `${cellName(y, x)}: ${value ? KIND_OF[value] : "no tile"}${isSure ? "" : ", unsure"}`;
            return (
              <g
                key={`${y},${x}`}
                data-cell={`${y},${x}`}
                class={`cell${isSure ? "" : " unsure"}${isSelected ? " selected" : ""}`}
                role="button"
                aria-pressed={isSelected}
                aria-label={name}
                tabindex={isSelected ? 0 : -1}
                onClick={() => setCell([y, x])}
                onFocus={() => setCell([y, x])}
                onKeyDown={cellKeys}
              >
                <polygon points={outlineOf(view, y, x).join(" ")} />
                <path d={ways.map((way) => `M${centre.join()}L${way.join()}`).join("")} stroke-width={unit * 0.5} />
              </g>
            );
          })}
          {Array.from({ length: columns }, (_, x) => named(columnName(x), [x + 0.5, BORDER]))}
          {Array.from({ length: rows }, (_, y) => named(`${y + 1}`, [BORDER, y + 0.5]))}
          {corners.map(([x, y], corner) => (
            <g
              key={corner}
              class="corner"
              role="button"
              tabindex={0}
              aria-label={`${CORNER_NAMES[corner]} corner, ${Math.round(x)}, ${Math.round(y)}. Arrow keys move it`}
              onPointerDown={(event) => down(event, corner)}
              onPointerUp={up}
              onPointerCancel={up}
              onKeyDown={(event) => cornerKeys(event, corner)}
            >
              <circle cx={x} cy={y} r={unit * 4} class="reach" />
              <circle cx={x} cy={y} r={unit * 2.6} class="grip" />
              <circle cx={x} cy={y} r={unit * 0.35} class="point" />
            </g>
          ))}
        </svg>
        <p class="note">
          Drag the four corners of the tiles, or move them with the arrow keys.{" "}
          {snaps ? "They snap to what fits the photograph." : "They stay where you put them."} Click a tile to correct
          its kind; R turns it. Orange tiles are unsure, and are not cut.
        </p>
      </section>
      <section class="panel side" aria-label="Corrections">
        <div class="bar">
          <WholeNumber
            label="Rows"
            value={rows}
            least={1}
            most={MOST_TILES}
            onChange={(height) => void fit(null, [height, columns])}
            say={say}
          />
          <WholeNumber
            label="Columns"
            value={columns}
            least={1}
            most={MOST_TILES}
            onChange={(width) => void fit(null, [rows, width])}
            say={say}
          />
          <button type="button" disabled={busy} onClick={() => void fit(null)}>
            Find the tiles
          </button>
          <Switch on={snaps} onChange={setSnaps} title="corners move to where they fit the photograph best">
            Snap
          </Switch>
        </div>
        <p class={proposal && !proposal.advice ? "fits" : "warning"} aria-live="polite">
          {busy
            ? "Fitting …"
            : proposal
              ? proposal.advice || `The corners fit, with a score of ${proposal.score.toFixed(2)}.`
              : photograph.advice}
        </p>
        {proposal && (
          <div class="bar">
            <Choice
              label={`Kind of ${cellName(row, column)}`}
              value={kindOfCode(code)}
              options={[...Object.keys(KINDS), "empty"].map((kind) => [kind, kindWord(kind)] as const)}
              onChange={(kind) => setCode(KINDS[kind]?.[0] ?? 0)}
            />
            <button type="button" onClick={turn} disabled={(KINDS[kindOfCode(code)] ?? []).length < 2}>
              Turn
            </button>
            {proposal.sure[row][column] < SURE && code > 0 && (
              <button type="button" onClick={() => setCode(code)}>
                It is right
              </button>
            )}
            <span class="note">{sides.length ? `opens ${sides.join(", ")} on the photograph` : "is not cut"}</span>
          </div>
        )}
        <div class="buttons">
          <button
            type="button"
            class="main"
            disabled={busy || !cuts}
            onClick={() => proposal && onCut(proposal)}
            title="earlier tiles of this photograph are replaced"
          >
            Cut {cuts} {cuts === 1 ? "tile" : "tiles"}
          </button>
        </div>
      </section>
    </div>
  );
}

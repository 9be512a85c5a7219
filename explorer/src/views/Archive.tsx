/** The archive: niches as cells, one axis of the descriptor across, the others as labelled bands down. */
import { useEffect, useMemo, useRef, useState } from "preact/hooks";
import { css, viridis } from "../colours";
import { useShared } from "../context";
import { bisect, type Run, type Seed } from "../data";
import { binName, binsOf, nicheAt, type Axis } from "../network/features";
import { Choice, quantityOptions, reveal, Segments } from "../parts/Controls";
import { Detail } from "../parts/Detail";
import { useShown, useWidth } from "../parts/canvas";
import { Gallery } from "../parts/Gallery";
import { flagWords, nameOf, number, valueText } from "../words";

/** Where each axis lies: places in the run's list of axes. */
interface Layout {
  readonly across: number;
  readonly down: readonly number[];
  readonly columns: number;
  readonly rows: number;
}

function layoutOf(run: Run, across: string | null): Layout {
  const wished = run.axes.findIndex((axis) => axis.metric === across);
  const most = Math.max(...run.axes.map((axis) => axis.bins));
  const place = wished >= 0 ? wished : run.axes.findIndex((axis) => axis.bins === most);
  const down = run.axes.map((_, axis) => axis).filter((axis) => axis !== place);
  return { across: place, down, columns: run.axes[place].bins, rows: down.reduce((rows, axis) => rows * run.axes[axis].bins, 1) };
}

function nicheIn(run: Run, layout: Layout, row: number, column: number): number {
  const bins = run.axes.map(() => column);
  for (const axis of [...layout.down].reverse()) {
    bins[axis] = row % run.axes[axis].bins;
    row = Math.floor(row / run.axes[axis].bins);
  }
  return nicheAt(run.axes, bins);
}

function cellOf(run: Run, layout: Layout, niche: number): [row: number, column: number] {
  const bins = binsOf(run.axes, niche);
  return [layout.down.reduce((row, axis) => row * run.axes[axis].bins + bins[axis], 0), bins[layout.across]];
}

/** What the cells show: of each niche a number, or none where it is vacant. */
function valuesOf(run: Run, seed: Seed, colour: string): Float64Array {
  if (seed === "count") return Float64Array.from(run.filled(), (count) => count || NaN);
  const column = run.column(run.quantities.includes(colour) ? colour : "fitness");
  return Float64Array.from(run.elites(seed), (elite) => (elite < 0 ? NaN : column[elite]));
}

/** Whether low numbers are the good ones, and get the bright end of the scale. */
const lowIsGood = (quantity: string): boolean =>
  ["fitness", "above_floor", "components", "dead_ends", "boundary_violations", "bridges", "adjacent_crossings", "adjacent_crossing_score",
    "adjacent_turns", "crowded_crossings", "unlinked_neighbours", "mismatches", "off_alphabet"].includes(quantity);

export function Archive() {
  const { run, view, show } = useShared();
  const detail = useRef<HTMLDivElement>(null);
  const layout = useMemo(() => layoutOf(run, view.across), [run, view.across]);
  const quantity = view.seed === "count" ? "filled" : run.quantities.includes(view.colour) ? view.colour : "fitness";
  const values = useMemo(() => valuesOf(run, view.seed, quantity), [run, view.seed, quantity]);
  const elites = run.elites(view.seed === "count" ? "best" : view.seed);
  const niche = selectedNiche(run, view.niche, view.map, elites);
  const elite = view.map !== null && view.map < run.count ? view.map : elites[niche];
  const filled = elites.reduce((count, one) => count + +(one >= 0), 0);
  return (
    <div class="split">
      <section class="panel" aria-label="The archive">
        <p class="lead">
          Each cell is a niche, a kind of map: its place says what kind, its colour{" "}
          {quantity === "filled" ? "how many seeds found one" : `the ${nameOf(quantity).toLowerCase()} of the fittest one found`}. Click a
          niche to open its map, or walk with the arrow keys.
        </p>
        <div class="bar">
          {run.seeds > 1 && (
            <Choice
              label="Elites of"
              value={`${view.seed}`}
              options={[
                ["best", "the best of all seeds"],
                ["count", "how many seeds fill it"],
                ...Array.from({ length: run.seeds }, (_, seed) => [`${seed}`, `seed ${seed}`] as const),
              ]}
              onChange={(seed) => show({ seed: seed === "best" || seed === "count" ? seed : Number(seed), map: null })}
            />
          )}
          <Choice
            label="Colour"
            value={view.seed === "count" ? "fitness" : quantity}
            options={quantityOptions(run.quantities)}
            onChange={(colour) => show({ colour, ...(view.seed === "count" && { seed: "best" }) })}
          />
          {run.axes.length > 1 && (
            <Choice
              label="Across"
              value={run.axes[layout.across].metric}
              options={quantityOptions(run.axes.map((axis) => axis.metric))}
              onChange={(across) => show({ across })}
            />
          )}
          <Segments
            label="Colour scale"
            titled
            value={view.scale}
            options={[["rank", "By rank"], ["linear", "Even"]] as const}
            onChange={(scale) => show({ scale })}
          />
        </div>
        <HeatMap run={run} layout={layout} values={values} quantity={quantity} selected={niche} elites={elites} />
        <p class="note">
          {number(filled)} of {number(run.niches)} niches have a map
          {view.seed === "best" && run.seeds > 1 && `, in any of ${run.seeds} seeds`}
          {typeof view.seed === "number" && `, of seed ${view.seed}`}.
        </p>
      </section>
      <div class="panel side" ref={detail}>
        {elite >= 0 ? <Detail elite={elite} /> : <Vacant run={run} niche={niche} />}
      </div>
      <Others run={run} niche={niche} open={elite} onOpen={(map) => (show({ map, niche: null }), reveal(detail))} />
    </div>
  );
}

const MOST_OTHERS = 40;

/** All maps in a niche, the fittest first: those of other seeds, or of a population. */
function Others({ run, niche, open, onOpen }: { readonly run: Run; readonly niche: number; readonly open: number; readonly onOpen: (elite: number) => void }) {
  const shown = useShown();
  const all = useMemo(() => {
    const found: number[] = [];
    run.niche.forEach((place, elite) => place === niche && found.push(elite));
    return found.sort((one, other) => run.fitness[one] - run.fitness[other] || one - other);
  }, [run, niche]);
  if (all.length < 2 || !shown) return null;
  return (
    <section class="panel others" aria-label="Maps in this niche">
      <h2>
        {number(all.length)} maps in this niche{run.seeds > 1 && `, of ${new Set(all.map((elite) => run.seed[elite])).size} seeds`}
        {all.length > MOST_OTHERS && `; the ${MOST_OTHERS} fittest`}
      </h2>
      <Gallery
        elites={all.slice(0, MOST_OTHERS)}
        open={open}
        onOpen={onOpen}
        caption={(elite) => `${run.seeds > 1 ? `seed ${run.seed[elite]}: ` : ""}${number(run.fitness[elite])}`}
      />
    </section>
  );
}

function Vacant({ run, niche }: { readonly run: Run; readonly niche: number }) {
  const bins = binsOf(run.axes, niche);
  return (
    <section class="detail" aria-label="The map">
      <header>
        <h2>niche {run.nicheName(niche)}</h2>
        <p>vacant: no map was found with</p>
      </header>
      <ul>
        {run.axes.map((axis, place) => (
          <li key={axis.metric}>
            {nameOf(axis.metric).toLowerCase()} {binName(axis, bins[place])}
          </li>
        ))}
      </ul>
    </section>
  );
}

/** Returns the niche that is open: the address's, that of its map, or of the fittest elite. */
export function selectedNiche(run: Run, name: string | null, map: number | null, elites: Int32Array): number {
  if (map !== null && map < run.count) return run.niche[map];
  const bins = name?.split("-").map(Number);
  if (bins?.length === run.axes.length && bins.every((bin, place) => bin < run.axes[place].bins)) return nicheAt(run.axes, bins);
  let best = -1;
  for (const elite of elites) if (elite >= 0 && (best < 0 || run.fitness[elite] < run.fitness[best])) best = elite;
  return best < 0 ? 0 : run.niche[best];
}

interface HeatMapProps {
  readonly run: Run;
  readonly layout: Layout;
  readonly values: Float64Array;
  readonly quantity: string;
  readonly selected: number;
  readonly elites: Int32Array;
}

const FOOT = 38; // pixels below the cells, for the axis
const MOST_HIGH = 12_000; // pixels that the cells may take

function HeatMap({ run, layout, values, quantity, selected, elites }: HeatMapProps) {
  const { show, view, dark, say } = useShared();
  const frame = useRef<HTMLDivElement>(null);
  const canvas = useRef<HTMLCanvasElement>(null);
  const width = useWidth(frame);
  const [hover, setHover] = useState<{ niche: number; x: number; y: number } | null>(null);
  const narrow = width < 560;
  const letters = Math.max(0, ...layout.down.flatMap((place) => Array.from({ length: run.axes[place].bins }, (_, bin) => binName(run.axes[place], bin).length)));
  const band = layout.down.length === 0 ? 0 : narrow ? Math.max(34, 6.6 * letters + 10) : 76;
  const gutter = layout.down.length * band;
  const longest = Math.max(0, ...layout.down.map((axis) => nameOf(run.axes[axis].metric).length));
  const head = !layout.down.length ? 4 : narrow ? 12 + 6 * longest : 34; // pixels above the cells, for the names of the bands
  const cellWidth = Math.max(3, (width - gutter - 2) / layout.columns);
  const cellHeight = Math.min(
    layout.rows > 60 ? Math.max(6, Math.min(14, 900 / layout.rows)) : Math.max(14, Math.min(28, 460 / layout.rows, narrow ? 22 : 28)),
    MOST_HIGH / layout.rows,
  );
  const whole = Math.max(width, gutter + cellWidth * layout.columns);
  const high = cellHeight * layout.rows;
  const scale = useMemo(() => scaleOf(values, quantity, view.scale), [values, quantity, view.scale]);

  useEffect(() => {
    if (!width) return;
    const ratio = window.devicePixelRatio || 1;
    const element = canvas.current!;
    element.width = Math.round(cellWidth * layout.columns * ratio);
    element.height = Math.round(high * ratio);
    const context = element.getContext("2d")!;
    context.scale(ratio, ratio);
    const style = getComputedStyle(element);
    const gap = cellWidth > 8 ? 1 : 0;
    const hatch = hatchOf(context, style.getPropertyValue("--vacant"), style.getPropertyValue("--hatch"));
    const unknown = style.getPropertyValue("--unknown");
    for (let row = 0; row < layout.rows; row++) {
      for (let column = 0; column < layout.columns; column++) {
        const niche = nicheIn(run, layout, row, column);
        const value = values[niche];
        context.fillStyle = !Number.isNaN(value) ? css(viridis(scale.place(value))) : elites[niche] >= 0 ? unknown : hatch;
        const x = Math.round(column * cellWidth), y = Math.round(row * cellHeight);
        context.fillRect(x, y, Math.round((column + 1) * cellWidth) - x - gap, Math.round((row + 1) * cellHeight) - y - gap);
      }
    }
  }, [run, layout, values, scale, width, high, dark]);

  const [selectedRow, selectedColumn] = cellOf(run, layout, selected);
  const open = (niche: number) => show({ niche: run.nicheName(niche), map: null });
  const nicheUnder = (event: MouseEvent): number => {
    const box = canvas.current!.getBoundingClientRect();
    const column = Math.min(Math.max(Math.floor((event.clientX - box.left) / cellWidth), 0), layout.columns - 1);
    const row = Math.min(Math.max(Math.floor((event.clientY - box.top) / cellHeight), 0), layout.rows - 1);
    return nicheIn(run, layout, row, column);
  };
  const move = (event: KeyboardEvent) => {
    const step: Readonly<Record<string, readonly [number, number]>> = {
      ArrowLeft: [0, -1], ArrowRight: [0, 1], ArrowUp: [-1, 0], ArrowDown: [1, 0], Home: [0, -selectedColumn], End: [0, layout.columns - 1 - selectedColumn],
    };
    const by = step[event.key];
    if (!by) return;
    event.preventDefault();
    const row = Math.min(Math.max(selectedRow + by[0], 0), layout.rows - 1);
    const column = Math.min(Math.max(selectedColumn + by[1], 0), layout.columns - 1);
    const niche = nicheIn(run, layout, row, column);
    open(niche);
    say(describe(run, niche, quantity, values[niche]), true);
  };
  const targeted = Object.keys(run.record).length ? targetRows(run, layout) : null;
  return (
    <>
      <Legend
        quantity={quantity}
        empty={elites.every((elite) => elite < 0)}
        unknown={elites.some((elite, place) => elite >= 0 && Number.isNaN(values[place]))}
        scale={scale}
      />
      <div class="heat" ref={frame} style={{ height: `${high + head + FOOT}px` }}>
        <svg class="axes" width={whole} height={high + head + FOOT} aria-hidden="true">
          <Bands run={run} layout={layout} band={band} cellHeight={cellHeight} head={head} narrow={narrow} />
          <g transform={`translate(${gutter} ${head + high})`}>
            <Ticks axis={run.axes[layout.across]} cellWidth={cellWidth} />
            <text class="title" x={(cellWidth * layout.columns) / 2} y={34} text-anchor="middle">
              {nameOf(run.axes[layout.across].metric)}
            </text>
          </g>
        </svg>
        <canvas
          ref={canvas}
          class="cells"
          style={{ left: `${gutter}px`, top: `${head}px`, width: `${cellWidth * layout.columns}px`, height: `${high}px` }}
          tabIndex={0}
          role="application"
          aria-roledescription="heat map"
          aria-label={`Archive, ${nameOf(quantity)} in ${layout.rows} rows of ${layout.columns} niches. ${describe(run, selected, quantity, values[selected])}`}
          onClick={(event) => open(nicheUnder(event))}
          onKeyDown={move}
          onMouseMove={(event) => {
            const box = frame.current!.getBoundingClientRect();
            setHover({ niche: nicheUnder(event), x: event.clientX - box.left, y: event.clientY - box.top });
          }}
          onMouseLeave={() => setHover(null)}
        />
        <svg class="marks" width={whole} height={high + head + FOOT} aria-hidden="true">
          <g transform={`translate(${gutter} ${head})`}>
            {targeted && (
              <rect class="target" x={-1} y={targeted[0] * cellHeight - 1.5} width={cellWidth * layout.columns + 1} height={(targeted[1] - targeted[0]) * cellHeight + 2} />
            )}
            <rect class="open" x={Math.round(selectedColumn * cellWidth) - 1.5} y={Math.round(selectedRow * cellHeight) - 1.5} width={cellWidth + 1.5} height={cellHeight + 1.5} />
          </g>
        </svg>
        {hover && (
          <div class="tip" style={{ left: `${Math.min(hover.x + 14, width - 190)}px`, top: `${hover.y + 16}px` }}>
            <b>{Number.isNaN(values[hover.niche]) ? (elites[hover.niche] >= 0 ? "not known here" : "vacant") : `${nameOf(quantity)} ${valueText(quantity, values[hover.niche])}`}</b>
            {run.axes.map((axis, place) => (
              <span key={axis.metric}>
                {nameOf(axis.metric)} {binName(axis, binsOf(run.axes, hover.niche)[place])}
              </span>
            ))}
            {elites[hover.niche] >= 0 && quantity !== "fitness" && <span>Fitness {number(run.fitness[elites[hover.niche]])}</span>}
          </div>
        )}
      </div>
      {targeted && <p class="note">The frame holds the niches that the search was asked for; all others are stepping stones.</p>}
    </>
  );
}

function describe(run: Run, niche: number, quantity: string, value: number): string {
  const bins = binsOf(run.axes, niche);
  const where = run.axes.map((axis, place) => `${nameOf(axis.metric)} ${flagWords(axis, bins[place]) ?? binName(axis, bins[place])}`).join(", ");
  return `${Number.isNaN(value) ? "Vacant" : `${nameOf(quantity)} ${valueText(quantity, value)}`}: ${where}`;
}

/** Returns the first row and the row after the last of the niches that were asked for, if only some were. */
function targetRows(run: Run, layout: Layout): [number, number] | null {
  const down = layout.down.map((axis) => run.axes[axis]);
  if (!down.length || run.axes[layout.across].target !== null || down.some((axis) => axis.target === null)) return null;
  const row = down.reduce((place, axis) => place * axis.bins + axis.target!, 0);
  return [row, row + 1];
}

interface Scale {
  readonly low: number;
  readonly high: number;
  /** Returns the place of a number on the scale of colours. */
  readonly place: (value: number) => number;
  /** Returns the number at a part of the way from the lowest to the highest. */
  readonly at: (part: number) => number;
}

/** Makes the function from a number to a place on the colour scale: even, or by rank among all cells. */
function scaleOf(values: Float64Array, quantity: string, kind: "linear" | "rank"): Scale {
  const sorted = values.filter((value) => !Number.isNaN(value)).sort();
  const low = sorted[0] ?? 0, high = sorted[sorted.length - 1] ?? 0;
  const turn = (place: number) => (lowIsGood(quantity) ? 1 - place : place);
  if (high === low) return { low, high, place: () => turn(lowIsGood(quantity) ? 0 : 1), at: () => low };
  if (kind === "linear") return { low, high, place: (value) => turn((value - low) / (high - low)), at: (part) => low + (high - low) * part };
  const distinct = sorted.filter((value, place) => place === 0 || value !== sorted[place - 1]);
  const last = distinct.length - 1;
  return { low, high, place: (value) => turn(bisect(distinct, value) / last), at: (part) => distinct[Math.round(part * last)] };
}

function hatchOf(context: CanvasRenderingContext2D, ground: string, line: string): CanvasPattern {
  const tile = document.createElement("canvas");
  tile.width = tile.height = 6;
  const pattern = tile.getContext("2d")!;
  pattern.fillStyle = ground;
  pattern.fillRect(0, 0, 6, 6);
  pattern.strokeStyle = line;
  pattern.beginPath();
  for (const start of [-6, 0, 6]) pattern.moveTo(start, 6), pattern.lineTo(start + 6, 0);
  pattern.stroke();
  return context.createPattern(tile, "repeat")!;
}

interface LegendProps {
  readonly quantity: string;
  readonly empty: boolean;
  readonly unknown: boolean;
  readonly scale: Scale;
}

function Legend({ quantity, empty, unknown, scale }: LegendProps) {
  if (empty) return <p class="note">All niches are vacant.</p>;
  const { low, high, place, at } = scale;
  const stops = Array.from({ length: 17 }, (_, stop) => css(viridis(place(low) + ((place(high) - place(low)) * stop) / 16)));
  const marks = [...new Set([0, 0.25, 0.5, 0.75, 1].map((part) => Math.round(at(part))))];
  return (
    <div class="legend" role="img" aria-label={`${nameOf(quantity)} from ${valueText(quantity, low)} to ${valueText(quantity, high)}; hatched niches are vacant`}>
      <b>{nameOf(quantity)}</b>
      <div class="ramp">
        <i style={{ background: high > low ? `linear-gradient(to right, ${stops.join(",")})` : stops[0] }} />
        <div>
          {marks.map((mark) => (
            <span key={mark}>{valueText(quantity, mark)}</span>
          ))}
        </div>
      </div>
      {lowIsGood(quantity) && <em>lower is better</em>}
      <span class="vacant"><i />vacant</span>
      {unknown && <span class="vacant unknown"><i />not known</span>}
    </div>
  );
}

interface BandsProps {
  readonly run: Run;
  readonly layout: Layout;
  readonly band: number;
  readonly cellHeight: number;
  readonly head: number;
  readonly narrow: boolean;
}

/** Draws the axes that go down: of each a column of bands, the first outermost. */
function Bands({ run, layout, band, cellHeight, head, narrow }: BandsProps) {
  let repeats = 1;
  let rows = layout.rows;
  return (
    <>
      {layout.down.map((place, level) => {
        const axis = run.axes[place];
        rows /= axis.bins;
        const height = rows * cellHeight;
        const groups = repeats;
        repeats *= axis.bins;
        const every = Math.max(1, Math.ceil(12 / height));
        const words = narrow ? [nameOf(axis.metric)] : lines(nameOf(axis.metric));
        return (
          <g key={axis.metric} transform={`translate(${level * band} 0)`}>
            <text
              class="head"
              y={narrow ? head - 6 : words.length > 1 ? 11 : 24}
              text-anchor={narrow ? "start" : "middle"}
              transform={narrow ? `rotate(-90 ${band / 2 + 2} ${head - 6})` : undefined}
            >
              {words.map((word, part) => (
                <tspan key={word} x={narrow ? band / 2 + 2 : band / 2 - 2} dy={part ? 13 : 0}>{word}</tspan>
              ))}
            </text>
            {Array.from({ length: groups * axis.bins }, (_, group) => {
              const bin = group % axis.bins;
              const y = head + group * height;
              const text = (!narrow && flagWords(axis, bin)) || binName(axis, bin);
              return (
                <g key={group}>
                  <rect class={`band ${bin % 2 ? "odd" : "even"}`} x={0} y={y} width={band - 3} height={Math.max(height - 1, 1)} rx={2} />
                  {bin % every === 0 && (
                    <text class="bin" x={band / 2 - 2} y={y + height / 2} dy="0.35em" text-anchor="middle">{text}</text>
                  )}
                </g>
              );
            })}
          </g>
        );
      })}
    </>
  );
}

/** Breaks a name into two lines. */
function lines(name: string): string[] {
  const words = name.split(" ");
  return words.length > 1 ? [words[0], words.slice(1).join(" ")] : words;
}

function Ticks({ axis, cellWidth }: { readonly axis: Axis; readonly cellWidth: number }) {
  const widest = Math.max(...Array.from({ length: axis.bins }, (_, bin) => binName(axis, bin).length));
  const every = Math.max(1, Math.ceil((widest * 6.5 + 6) / cellWidth));
  return (
    <>
      {Array.from({ length: axis.bins }, (_, bin) => bin)
        .filter((bin) => bin % every === 0)
        .map((bin) => (
          <text key={bin} class="bin" x={bin === axis.bins - 1 && cellWidth < 18 ? axis.bins * cellWidth : (bin + 0.5) * cellWidth} y={14} text-anchor={bin === axis.bins - 1 && cellWidth < 18 ? "end" : "middle"}>{binName(axis, bin)}</text>
        ))}
    </>
  );
}

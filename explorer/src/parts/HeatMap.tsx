/** The niches as cells, with their axes. */
import { useEffect, useMemo, useRef, useState } from "preact/hooks";
import { css, viridis } from "../colours";
import { useShared } from "../context";
import type { Run } from "../data";
import { cellOf, nicheIn, targetRowOf, type Layout } from "../layout";
import { binName, binsOf, type Axis } from "../network/features";
import { flagWords, nameOf, number, valueText } from "../words";
import { useWidth } from "./canvas";
import { Legend, scaleOf } from "./Legend";

interface HeatMapProps {
  readonly run: Run;
  readonly layout: Layout;
  readonly values: Float64Array;
  readonly quantity: string;
  readonly selected: number;
  readonly elites: Int32Array;
  /** Called when a click has opened a niche. */
  readonly onClick: () => void;
}

const FOOT = 38; // pixels below the cells, for the axis
const MOST_HIGH = 12_000; // pixels that the cells may take

export function HeatMap({ run, layout, values, quantity, selected, elites, onClick }: HeatMapProps) {
  const { show, view, dark, say } = useShared();
  const frame = useRef<HTMLDivElement>(null);
  const canvas = useRef<HTMLCanvasElement>(null);
  const width = useWidth(frame);
  const [hover, setHover] = useState<{ niche: number; x: number; y: number } | null>(null);
  const narrow = width < 560;
  const letters = Math.max(
    0,
    ...layout.down.flatMap((index) =>
      Array.from({ length: run.axes[index].bins }, (_, bin) => binName(run.axes[index], bin).length),
    ),
  );
  const band = layout.down.length === 0 ? 0 : narrow ? Math.max(34, 6.6 * letters + 10) : 76;
  const gutter = layout.down.length * band;
  const longest = Math.max(0, ...layout.down.map((axis) => nameOf(run.axes[axis].metric).length));
  const head = !layout.down.length ? 4 : narrow ? 12 + 6 * longest : 34; // for the names of the bands
  const cellWidth = Math.max(3, (width - gutter - 2) / layout.columns);
  const cellHeight = Math.min(
    layout.rows > 60
      ? Math.max(6, Math.min(14, 900 / layout.rows))
      : Math.max(14, Math.min(28, 460 / layout.rows, narrow ? 22 : 28)),
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
        context.fillStyle = !Number.isNaN(value)
          ? css(viridis(scale.position(value)))
          : elites[niche] >= 0
            ? unknown
            : hatch;
        const x = Math.round(column * cellWidth);
        const y = Math.round(row * cellHeight);
        context.fillRect(
          x,
          y,
          Math.round((column + 1) * cellWidth) - x - gap,
          Math.round((row + 1) * cellHeight) - y - gap,
        );
      }
    }
  }, [run, layout, values, elites, scale, width, cellWidth, cellHeight, high, dark]);

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
      ArrowLeft: [0, -1],
      ArrowRight: [0, 1],
      ArrowUp: [-1, 0],
      ArrowDown: [1, 0],
      Home: [0, -selectedColumn],
      End: [0, layout.columns - 1 - selectedColumn],
    };
    const by = step[event.key];
    if (!by) return;
    event.preventDefault();
    const row = Math.min(Math.max(selectedRow + by[0], 0), layout.rows - 1);
    const column = Math.min(Math.max(selectedColumn + by[1], 0), layout.columns - 1);
    const niche = nicheIn(run, layout, row, column);
    open(niche);
    say(describe(run, niche, quantity, values[niche], elites[niche]), true);
  };
  const targetRow = Object.keys(run.record).length ? targetRowOf(run, layout) : null;
  return (
    <>
      <Legend
        quantity={quantity}
        empty={elites.every((elite) => elite < 0)}
        unknown={elites.some((elite, index) => elite >= 0 && Number.isNaN(values[index]))}
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
          style={{
            left: `${gutter}px`,
            top: `${head}px`,
            width: `${cellWidth * layout.columns}px`,
            height: `${high}px`,
          }}
          tabIndex={0}
          role="application"
          aria-roledescription="heat map"
          aria-label={`Archive, ${nameOf(quantity)} in ${layout.rows} rows of ${layout.columns} niches. ${describe(run, selected, quantity, values[selected], elites[selected])}`}
          onClick={(event) => {
            open(nicheUnder(event));
            onClick();
          }}
          onKeyDown={move}
          onMouseMove={(event) => {
            const box = frame.current!.getBoundingClientRect();
            setHover({ niche: nicheUnder(event), x: event.clientX - box.left, y: event.clientY - box.top });
          }}
          onMouseLeave={() => setHover(null)}
        />
        <svg class="marks" width={whole} height={high + head + FOOT} aria-hidden="true">
          <g transform={`translate(${gutter} ${head})`}>
            {targetRow !== null && (
              <rect
                class="target"
                x={-1}
                y={targetRow * cellHeight - 1.5}
                width={cellWidth * layout.columns + 1}
                height={cellHeight + 2}
              />
            )}
            <rect
              class="open"
              x={Math.round(selectedColumn * cellWidth) - 1.5}
              y={Math.round(selectedRow * cellHeight) - 1.5}
              width={cellWidth + 1.5}
              height={cellHeight + 1.5}
            />
          </g>
        </svg>
        {hover && (
          <div class="tip" style={{ left: `${Math.min(hover.x + 14, width - 190)}px`, top: `${hover.y + 16}px` }}>
            <b>{cellText(quantity, values[hover.niche], elites[hover.niche])}</b>
            {run.axes.map((axis, index) => (
              <span key={axis.metric}>
                {nameOf(axis.metric)} {binName(axis, binsOf(run.axes, hover.niche)[index])}
              </span>
            ))}
            {elites[hover.niche] >= 0 && quantity !== "fitness" && (
              <span>Fitness {number(run.fitness[elites[hover.niche]])}</span>
            )}
          </div>
        )}
      </div>
      {targetRow !== null && (
        <p class="note">The frame marks the target niches of the search. All others are stepping stones.</p>
      )}
    </>
  );
}

/** Returns the words for a value of a niche. Without one, they say whether the niche has an elite. */
function cellText(quantity: string, value: number, elite: number): string {
  if (Number.isNaN(value)) return elite >= 0 ? "Not known here" : "Vacant";
  return `${nameOf(quantity)} ${valueText(quantity, value)}`;
}

/** Describes a niche for screen readers. */
export function describe(run: Run, niche: number, quantity: string, value: number, elite: number): string {
  const bins = binsOf(run.axes, niche);
  const where = run.axes
    .map((axis, index) => `${nameOf(axis.metric)} ${flagWords(axis, bins[index]) ?? binName(axis, bins[index])}`)
    .join(", ");
  return `${cellText(quantity, value, elite)}: ${where}`;
}

function hatchOf(context: CanvasRenderingContext2D, ground: string, line: string): CanvasPattern {
  const tile = document.createElement("canvas");
  tile.width = tile.height = 6;
  const pattern = tile.getContext("2d")!;
  pattern.fillStyle = ground;
  pattern.fillRect(0, 0, 6, 6);
  pattern.strokeStyle = line;
  pattern.beginPath();
  for (const start of [-6, 0, 6]) {
    pattern.moveTo(start, 6);
    pattern.lineTo(start + 6, 0);
  }
  pattern.stroke();
  return context.createPattern(tile, "repeat")!;
}

interface BandsProps {
  readonly run: Run;
  readonly layout: Layout;
  readonly band: number;
  readonly cellHeight: number;
  readonly head: number;
  readonly narrow: boolean;
}

/** Draws the axes that go down: a column of bands for each, from the outermost to the innermost. */
function Bands({ run, layout, band, cellHeight, head, narrow }: BandsProps) {
  let repeats = 1;
  let rows = layout.rows;
  return (
    <>
      {layout.down.map((index, level) => {
        const axis = run.axes[index];
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
                <tspan key={word} x={narrow ? band / 2 + 2 : band / 2 - 2} dy={part ? 13 : 0}>
                  {word}
                </tspan>
              ))}
            </text>
            {Array.from({ length: groups * axis.bins }, (_, group) => {
              const bin = group % axis.bins;
              const y = head + group * height;
              const text = (!narrow && flagWords(axis, bin)) || binName(axis, bin);
              return (
                <g key={group}>
                  <rect
                    class={`band ${bin % 2 ? "odd" : "even"}`}
                    x={0}
                    y={y}
                    width={band - 3}
                    height={Math.max(height - 1, 1)}
                    rx={2}
                  />
                  {bin % every === 0 && (
                    <text class="bin" x={band / 2 - 2} y={y + height / 2} dy="0.35em" text-anchor="middle">
                      {text}
                    </text>
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
          <text
            key={bin}
            class="bin"
            x={bin === axis.bins - 1 && cellWidth < 18 ? axis.bins * cellWidth : (bin + 0.5) * cellWidth}
            y={14}
            text-anchor={bin === axis.bins - 1 && cellWidth < 18 ? "end" : "middle"}
          >
            {binName(axis, bin)}
          </text>
        ))}
    </>
  );
}

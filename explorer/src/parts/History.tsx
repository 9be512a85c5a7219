/** The history of runs, drawn by uPlot: quantiles over the seeds against evaluations. */
import { useCallback, useEffect, useMemo, useRef, useState } from "preact/hooks";
import uPlot from "uplot";
import { distinct } from "../colours";
import { useShared } from "../context";
import { quantile, type Run } from "../data";
import { number } from "../words";
import { useWidth } from "./canvas";

export type Series = "best_fitness" | "elite_count";

const SHARES = [0, 0.25, 0.5, 0.75, 1] as const;
const MEDIAN = 2;
const HIGH = 300;

/** Returns the quantiles over the seeds, one row per share. Null means that a seed has no elite yet. */
function quantilesOf(seeds: readonly (Int32Array | Float64Array)[], steps: number): (number | null)[][] {
  const rows: (number | null)[][] = SHARES.map(() => []);
  for (let step = 0; step < steps; step++) {
    const sorted = Float64Array.from(seeds, (values) => values[step]).sort();
    SHARES.forEach((share, row) => {
      const value = quantile(sorted, share);
      rows[row].push(Number.isFinite(value) ? value : null);
    });
  }
  return rows;
}

interface Props {
  /** The runs that have a history. */
  readonly runs: readonly Run[];
  readonly all: readonly Run[];
  readonly series: Series;
}

export function History({ runs, all, series }: Props) {
  const { dark, say } = useShared();
  const frame = useRef<HTMLDivElement>(null);
  const chart = useRef<uPlot | null>(null);
  const width = useWidth(frame);
  const [at, setAt] = useState<number | null>(null);
  const tables = useMemo(
    () =>
      runs.map(
        ({ history }) =>
          [Array.from(history!.evaluations), ...quantilesOf(history![series], history!.evaluations.length)] as [
            number[],
            ...(number | null)[][],
          ],
      ),
    [runs, series],
  );
  const data = useMemo(() => uPlot.join(tables), [tables]);
  const colour = useCallback((run: Run) => distinct(all.indexOf(run), dark), [all, dark]);
  // Fitness falls steeply at first, so the scale ignores the first twentieth of the steps.
  const usual = useMemo(() => {
    const seen = tables.flatMap(([steps, ...rows]) =>
      rows.flatMap((row) => row.slice(Math.floor(steps.length / 20)).filter((value) => value != null)),
    );
    return seen.length ? [Math.min(...seen), Math.max(...seen)] : [0, 1];
  }, [tables]);

  useEffect(() => {
    if (!width) return;
    const style = getComputedStyle(frame.current!);
    const [soft, line] = ["--soft", "--line"].map((name) => style.getPropertyValue(name));
    const axis: uPlot.Axis = {
      stroke: soft,
      font: `12px ${style.fontFamily}`,
      grid: { stroke: line, width: 1 },
      ticks: { show: false },
      values: (_, marks) => marks.map(number),
    };
    const first = data[0][0];
    const end = data[0][data[0].length - 1];
    const made = new uPlot(
      {
        width,
        height: HIGH,
        legend: { show: false },
        cursor: { y: false, points: { show: false }, drag: { x: true, y: false, setScale: true } },
        scales: {
          x: { time: false, range: (_, least, most) => [least === first ? 0 : least, most] },
          y: {
            range: (plot, least, most) => {
              const { min, max } = plot.scales.x;
              const zoomed = min != null && max != null && (min > first || max < end);
              const [low, high] = zoomed ? [least, most] : usual;
              const edge = 0.04 * (high - low || 1);
              return [low - edge, high + edge];
            },
          },
        },
        axes: [
          {
            ...axis,
            label: "Evaluations of a seed",
            labelFont: axis.font!,
            labelSize: 18,
            labelGap: 0,
            size: 30,
            grid: { show: false },
          },
          { ...axis, size: 58 },
        ],
        series: [
          {},
          ...runs.flatMap((run) =>
            SHARES.map((_, row) => ({
              stroke: row === MEDIAN ? colour(run) : "transparent",
              width: 2,
              points: { show: false },
              spanGaps: true,
            })),
          ),
        ],
        bands: runs.flatMap((run, index) => {
          const row = 1 + index * SHARES.length;
          return [
            { series: [row + 4, row] as [number, number], fill: `${colour(run)}22` },
            { series: [row + 3, row + 1] as [number, number], fill: `${colour(run)}55` },
          ];
        }),
        hooks: { setCursor: [(plot) => setAt(plot.cursor.idx ?? null)] },
      },
      data,
      frame.current!,
    );
    chart.current = made;
    return () => {
      chart.current = null;
      made.destroy();
    };
  }, [data, width, dark, runs, usual, colour]);

  /** Returns the latest quantiles of a run at a step. */
  const valuesAt = (index: number, step: number): readonly (number | null)[] => {
    const rows = data.slice(1 + index * SHARES.length, 1 + (index + 1) * SHARES.length);
    while (step > 0 && rows[MEDIAN][step] == null) step--;
    return rows.map((row) => row[step] ?? null);
  };
  const last = data[0].length - 1;
  const step = Math.min(at ?? last, last);
  const parts = (index: number, step: number): readonly [median: string, half: string] => {
    const [, low, middle, high] = valuesAt(index, step);
    const half =
      runs[index].seeds > 1 && low !== null && high !== null
        ? `, half of the seeds ${number(low)} to ${number(high)}`
        : "";
    return middle === null ? ["none", ""] : [number(middle), half];
  };
  const words = (index: number, step: number): string => parts(index, step).join("");
  const keys = (event: KeyboardEvent) => {
    const by = Math.max(1, Math.round(last / 50));
    const next = { ArrowLeft: step - by, ArrowRight: step + by, Home: 0, End: last }[event.key];
    if (next === undefined || !chart.current) return;
    event.preventDefault();
    const to = Math.min(Math.max(next, 0), last);
    chart.current.setCursor({ left: chart.current.valToPos(data[0][to], "x"), top: 0 }, false);
    setAt(to);
    say(
      `After ${number(data[0][to])} evaluations: ${runs.map((run, index) => `${run.name} ${words(index, to)}`).join("; ")}`,
      true,
    );
  };
  const what = series === "best_fitness" ? "Best fitness" : "Number of elites";
  return (
    <div class="chart">
      <div
        ref={frame}
        tabIndex={0}
        role="application"
        aria-roledescription="chart"
        aria-label={`${what} against evaluations; arrow keys read it. At the end: ${runs.map((run, index) => `${run.name} ${words(index, last)}`).join("; ")}`}
        style={{ minHeight: `${HIGH}px` }}
        onKeyDown={keys}
      />
      <ul class="key">
        {runs.map((run, index) => (
          <li key={run.name}>
            <i style={{ background: colour(run) }} />
            {run.name}: <b>{parts(index, step)[0]}</b>
            <span>{parts(index, step)[1]}</span>
          </li>
        ))}
        <li>
          <span>{at === null ? "at the end" : `after ${number(data[0][step])} evaluations`}</span>
        </li>
      </ul>
    </div>
  );
}

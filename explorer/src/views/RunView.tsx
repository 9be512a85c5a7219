/** The runs: histories, box plots of a quantity, settings, versions and times. */
import { useMemo, useRef, useState } from "preact/hooks";
import { distinct } from "../colours";
import { useShared } from "../context";
import { quantile, type Run } from "../data";
import { Choice, quantityOptions, Segments } from "../parts/Controls";
import { useWidth } from "../parts/canvas";
import { History, type Series } from "../parts/History";
import { openRun } from "../state";
import { markText, nameOf, number, valueText } from "../words";

export function RunView() {
  const { data, run, view, show } = useShared();
  const [series, setSeries] = useState<Series>("best_fitness");
  const [boxed, setBoxed] = useState("fitness");
  const withHistory = useMemo(() => data.runs.filter((one) => one.history), [data]);
  const quantities = data.runs.reduce(
    (common, one) => common.filter((name) => one.quantities.includes(name)),
    run.quantities,
  );
  return (
    <div class="stack">
      {withHistory.length > 0 && (
        <section class="panel" aria-label="History">
          <div class="bar">
            <h2>History</h2>
            <Segments
              label="What the history shows"
              value={series}
              options={
                [
                  ["best_fitness", "Best fitness"],
                  ["elite_count", "Elites"],
                ] as const
              }
              onChange={setSeries}
            />
          </div>
          <History runs={withHistory} all={data.runs} series={series} />
          <p class="note">
            The line is the median over the seeds; the band spans the middle half, the pale one all seeds. Drag to zoom
            in, double-click to zoom out.
          </p>
        </section>
      )}
      <section class="panel" aria-label="Box plots">
        <div class="bar">
          <h2>{data.runs.length > 1 ? "The runs side by side" : "Spread over the maps"}</h2>
          <Choice label="Metric" value={boxed} options={quantityOptions(quantities)} onChange={setBoxed} />
        </div>
        <Boxes runs={data.runs} quantity={boxed} />
        <p class="note">Boxes span the middle half of the maps, whiskers 90 %; the line is the median.</p>
      </section>
      <section class="panel" aria-label="Settings">
        <div class="bar">
          <h2>Settings</h2>
          {data.runs.length > 1 && (
            <Choice
              label="Run"
              value={`${view.run}`}
              options={data.runs.map((one, index) => [`${index}`, one.name] as const)}
              onChange={(index) => show(openRun(view, Number(index)))}
            />
          )}
        </div>
        <Settings run={run} />
      </section>
    </div>
  );
}

function Settings({ run }: { readonly run: Run }) {
  const groups = new Map<string, [string, string][]>([
    [
      "Found",
      [
        ["tiles", `${run.height} × ${run.width}`],
        ["seeds", `${run.seeds}`],
        ["maps", number(run.count)],
      ],
    ],
  ]);
  for (const [key, value] of Object.entries(run.record)) {
    const settings = value as { search?: unknown };
    if (key === "settings" && typeof settings?.search === "object") {
      const { search, ...others } = settings;
      const parts = Object.entries(search!);
      const table = (value: unknown) => typeof value === "object" && value !== null && !Array.isArray(value);
      groups.set(
        "Search",
        parts.filter(([, value]) => !table(value)).flatMap(([name, value]) => flat(name, value)),
      );
      for (const [name, value] of parts) if (table(value)) groups.set(GROUPS[name] ?? nameOf(name), flat("", value));
      groups.set("Settings", flat("", others));
    } else groups.set(GROUPS[key] ?? key, flat("", value));
  }
  return (
    <div class="settings">
      {[...groups]
        .filter(([, rows]) => rows.length)
        .map(([name, rows]) => (
          <div key={name} class="group">
            <h3>{name}</h3>
            <dl>
              {rows.map(([key, value], index) => (
                <div key={index}>
                  <dt>{key || name}</dt>
                  <dd>{value}</dd>
                </div>
              ))}
            </dl>
          </div>
        ))}
    </div>
  );
}

const GROUPS: Readonly<Record<string, string>> = {
  settings: "Settings",
  config: "Method",
  weights: "Weights",
  axes: "Axes",
  archives: "Archives",
  tile_set: "Tile set",
  elites: "Elites",
  versions: "Versions",
  device: "Device",
  times: "Times",
};

/** Lists the values of nested tables by their innermost names, without values that are not set. */
function flat(key: string, value: unknown, unit = ""): [string, string][] {
  if (value === null || (typeof value === "object" && !Object.keys(value).length)) return [];
  if (typeof value === "object" && !Array.isArray(value))
    return Object.entries(value).flatMap(([name, inner]) => flat(name, inner, key === "seconds" ? " s" : unit));
  const text =
    typeof value === "string"
      ? value
      : typeof value === "number"
        ? value.toLocaleString("en")
        : JSON.stringify(value).replaceAll(",", ", ");
  return [[key.replaceAll("_", " "), text.length > 300 ? `${text.slice(0, 299)}…` : text + unit]];
}

function ticks(low: number, high: number, wanted: number): number[] {
  const raw = (high - low || 1) / wanted;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((times) => times * power).find((one) => one >= raw)!;
  const marks: number[] = [];
  for (let mark = Math.ceil(low / step) * step; mark <= high + step / 1e6; mark += step) marks.push(mark);
  return marks;
}

function Boxes({ runs, quantity }: { readonly runs: readonly Run[]; readonly quantity: string }) {
  const { dark } = useShared();
  const frame = useRef<HTMLDivElement>(null);
  const width = useWidth(frame);
  const samples = runs.map((run) => run.sorted(quantity));
  const known = samples.filter((sorted) => sorted.length);
  const low = Math.min(...known.map((sorted) => quantile(sorted, 0.05)));
  const high = Math.max(...known.map((sorted) => quantile(sorted, 0.95)));
  const above = width < 560; // then names are above their boxes
  const left = above ? 8 : 170;
  const row = above ? 46 : 34;
  const right = 34;
  const x = (value: number) => left + ((width - left - right) * (value - low)) / (high - low || 1);
  const height = runs.length * row + 30;
  return (
    <div class="chart" ref={frame}>
      {!known.length && <p class="note">No map has this quantity.</p>}
      {width > 0 && known.length > 0 && (
        <svg
          width={width}
          height={height}
          role="img"
          aria-label={`${nameOf(quantity)}: ${runs.map((run, index) => `${run.name} median ${samples[index].length ? valueText(quantity, quantile(samples[index], 0.5)) : "none"}`).join("; ")}`}
        >
          {ticks(low, high, above ? 4 : 6).map((mark) => (
            <g key={mark}>
              <path class="grid" d={`M${x(mark)} 4V${height - 24}`} />
              <text x={x(mark)} y={height - 8} text-anchor="middle">
                {markText(quantity, mark)}
              </text>
            </g>
          ))}
          {runs.map((run, index) => {
            const sorted = samples[index];
            const colour = distinct(index, dark);
            const middle = (index + 1) * row - (above ? 11 : 13);
            const name = run.name.length > 24 ? `${run.name.slice(0, 23)}…` : run.name;
            const words = above ? (
              <text x={left} y={middle - 16}>
                {name}
              </text>
            ) : (
              <text x={left - 12} y={middle} dy="0.35em" text-anchor="end">
                {name}
              </text>
            );
            if (!sorted.length) return <g key={run.name}>{words}</g>;
            const [least, quarter, half, three, most] = [0.05, 0.25, 0.5, 0.75, 0.95].map((share) =>
              x(quantile(sorted, share)),
            );
            return (
              <g key={run.name}>
                {words}
                <path
                  d={`M${least} ${middle}H${most}M${least} ${middle - 5}v10M${most} ${middle - 5}v10`}
                  stroke={colour}
                  stroke-width={1.5}
                />
                <rect
                  x={quarter}
                  y={middle - 9}
                  width={Math.max(three - quarter, 2)}
                  height={18}
                  rx={2}
                  fill={colour}
                />
                <path class="median" d={`M${half} ${middle - 9}v18`} />
              </g>
            );
          })}
        </svg>
      )}
    </div>
  );
}

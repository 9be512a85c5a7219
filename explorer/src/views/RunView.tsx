/** The runs: their histories over seeds, box plots of any quantity, settings, versions, times. */
import { useId, useMemo, useState } from "preact/hooks";
import { DISTINCT } from "../colours";
import { useShared } from "../context";
import { quantile, type Run } from "../data";
import { Choice, quantityOptions, Segments } from "../parts/Controls";
import { nameOf, number, valueText } from "../words";

type Series = "best_fitness" | "elite_count";

export function RunView() {
  const { data, run, view, show } = useShared();
  const [series, setSeries] = useState<Series>("best_fitness");
  const [boxed, setBoxed] = useState("fitness");
  const withHistory = data.runs.filter((one) => one.history);
  const quantities = data.runs.reduce((common, one) => common.filter((name) => one.quantities.includes(name)), run.quantities);
  return (
    <div class="stack">
      {withHistory.length > 0 && (
        <section class="panel" aria-label="History">
          <div class="bar">
            <h2>History</h2>
            <Segments label="What the history shows" value={series} options={[["best_fitness", "Best fitness"], ["elite_count", "Elites"]] as const} onChange={setSeries} />
          </div>
          <Chart runs={withHistory} all={data.runs} series={series} />
          <p class="note">Median over the seeds against evaluations of one seed; the band spans the middle half, the pale one all seeds.</p>
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
            <Choice label="Run" value={`${view.run}`} options={data.runs.map((one, place) => [`${place}`, one.name] as const)} onChange={(place) => show({ run: Number(place), niche: null, map: null })} />
          )}
        </div>
        <Settings run={run} />
      </section>
    </div>
  );
}

function Settings({ run }: { readonly run: Run }) {
  const groups = new Map<string, [string, string][]>([
    ["Found", [["tiles", `${run.height} × ${run.width}`], ["seeds", `${run.seeds}`], ["maps", number(run.count)]]],
  ]);
  for (const [key, value] of Object.entries(run.record)) {
    const settings = value as { search?: unknown };
    if (key === "settings" && typeof settings?.search === "object") {
      const { search, ...others } = settings;
      groups.set("Search", flat("", search));
      groups.set("Settings", flat("", others));
    } else groups.set(GROUPS[key] ?? key, flat("", value));
  }
  return (
    <div class="settings">
      {[...groups].filter(([, rows]) => rows.length).map(([name, rows]) => (
        <div key={name} class="group">
          <h3>{name}</h3>
          <dl>
            {rows.map(([key, value], place) => (
              <div key={place}>
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
  settings: "Settings", config: "Method", archives: "Archives", tile_set: "Tile set", elites: "Elites", versions: "Versions", device: "Device", times: "Times",
};

/** Lists the values of tables within tables, by the innermost names; what is not set is left out. */
function flat(key: string, value: unknown): [string, string][] {
  if (value === null || (typeof value === "object" && !Object.keys(value).length)) return [];
  if (typeof value === "object" && !Array.isArray(value)) return Object.entries(value).flatMap(([name, inner]) => flat(name, inner));
  const text = typeof value === "string" ? value : typeof value === "number" ? value.toLocaleString("en") : JSON.stringify(value);
  return [[key.replaceAll("_", " "), text.length > 300 ? `${text.slice(0, 299)}…` : text]];
}

const WIDE = 720, HIGH = 300, LEFT = 64, BOTTOM = 36, TOP = 12, RIGHT = 26;

function ticks(low: number, high: number, wanted: number): number[] {
  const raw = (high - low || 1) / wanted;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((times) => times * power).find((one) => one >= raw)!;
  const marks: number[] = [];
  for (let mark = Math.ceil(low / step) * step; mark <= high + step / 1e6; mark += step) marks.push(mark);
  return marks;
}

function Chart({ runs, all, series }: { readonly runs: readonly Run[]; readonly all: readonly Run[]; readonly series: Series }) {
  const [at, setAt] = useState<number | null>(null);
  const plot = useId();
  const lines = useMemo(
    () =>
      runs.map((run) => {
        const { evaluations } = run.history!;
        const seeds = run.history![series];
        const bands = Array.from(evaluations, (_, step) => {
          const sorted = Float64Array.from(seeds, (values) => values[step]).sort();
          return [0, 0.25, 0.5, 0.75, 1].map((share) => quantile(sorted, share));
        });
        return { run, evaluations, bands };
      }),
    [runs, series],
  );
  const most = Math.max(...lines.map(({ evaluations }) => evaluations[evaluations.length - 1]));
  // The first steps are far off where fitness falls steeply: the scale starts where a twentieth of the steps are done.
  const seen = lines.flatMap(({ bands }) => bands.slice(Math.floor(bands.length / 20)).flatMap((band) => band.filter((value) => Math.abs(value) < 2 ** 31 - 1)));
  const low = Math.min(...seen), high = Math.max(...seen);
  const x = (evaluations: number) => LEFT + ((WIDE - LEFT - RIGHT) * evaluations) / most;
  const y = (value: number) => Math.max(TOP - 400, TOP + ((HIGH - TOP - BOTTOM) * (high - value)) / (high - low || 1));
  const path = (points: readonly (readonly [number, number])[]) => points.map(([px, py], place) => `${place ? "L" : "M"}${px.toFixed(1)} ${py.toFixed(1)}`).join("");
  const readout = at === null ? null : lines.map(({ run, evaluations, bands }) => {
    let step = 0;
    while (step < evaluations.length - 1 && evaluations[step] < at) step++;
    return { run, evaluations: evaluations[step], band: bands[step] };
  });
  return (
    <div class="chart">
      <svg
        viewBox={`0 0 ${WIDE} ${HIGH}`}
        role="img"
        aria-label={`${series === "best_fitness" ? "Best fitness" : "Number of elites"} against evaluations: ${lines.map(({ run, bands }) => `${run.name} ends at a median of ${number(bands[bands.length - 1][2])}`).join("; ")}`}
        onMouseMove={(event) => {
          const box = event.currentTarget.getBoundingClientRect();
          const place = ((event.clientX - box.left) / box.width) * WIDE;
          setAt(Math.min(Math.max(((place - LEFT) / (WIDE - LEFT - RIGHT)) * most, 0), most));
        }}
        onMouseLeave={() => setAt(null)}
      >
        <clipPath id={plot}><rect x={LEFT} y={TOP - 4} width={WIDE - LEFT - RIGHT + 2} height={HIGH - TOP - BOTTOM + 8} /></clipPath>
        {ticks(low, high, 5).map((mark) => (
          <g key={mark}>
            <path class="grid" d={`M${LEFT} ${y(mark)}H${WIDE - RIGHT}`} />
            <text class="bin" x={LEFT - 8} y={y(mark)} dy="0.35em" text-anchor="end">{number(mark)}</text>
          </g>
        ))}
        {ticks(0, most, 6).map((mark) => (
          <text key={mark} class="bin" x={x(mark)} y={HIGH - 20} text-anchor="middle">{number(mark)}</text>
        ))}
        <text class="title" x={(LEFT + WIDE - RIGHT) / 2} y={HIGH - 3} text-anchor="middle">Evaluations of a seed</text>
        <g clip-path={`url(#${plot})`}>
          {lines.map(({ run, evaluations, bands }) => {
            const colour = DISTINCT[all.indexOf(run) % DISTINCT.length];
            const band = (from: number, to: number) =>
              path([...bands.map((values, step) => [x(evaluations[step]), y(values[to])] as const), ...bands.map((values, step) => [x(evaluations[step]), y(values[from])] as const).reverse()]) + "Z";
            return (
              <g key={run.name}>
                <path d={band(0, 4)} fill={colour} opacity={0.12} />
                <path d={band(1, 3)} fill={colour} opacity={0.28} />
                <path d={path(bands.map((values, step) => [x(evaluations[step]), y(values[2])]))} fill="none" stroke={colour} stroke-width={2} stroke-linejoin="round" />
              </g>
            );
          })}
          {at !== null && <path class="cursor" d={`M${x(at)} ${TOP}V${HIGH - BOTTOM}`} />}
        </g>
      </svg>
      <ul class="key">
        {lines.map(({ run, bands }, place) => (
          <li key={run.name}>
            <i style={{ background: DISTINCT[all.indexOf(run) % DISTINCT.length] }} />
            {run.name}: <b>{number((readout?.[place].band ?? bands[bands.length - 1])[2])}</b>{" "}
            <span>{readout ? `after ${number(readout[place].evaluations)}` : "at the end"}</span>
          </li>
        ))}
      </ul>
    </div>
  );
}

function Boxes({ runs, quantity }: { readonly runs: readonly Run[]; readonly quantity: string }) {
  const samples = runs.map((run) => run.sorted(quantity));
  const known = samples.filter((sorted) => sorted.length);
  if (!known.length) return <p class="note">No map has it.</p>;
  const low = Math.min(...known.map((sorted) => quantile(sorted, 0.05))), high = Math.max(...known.map((sorted) => quantile(sorted, 0.95)));
  const names = 150, row = 34;
  const x = (value: number) => names + ((WIDE - names - RIGHT - 20) * (value - low)) / (high - low || 1);
  const height = runs.length * row + 30;
  return (
    <div class="chart">
      <svg viewBox={`0 0 ${WIDE} ${height}`} role="img" aria-label={`${nameOf(quantity)}: ${runs.map((run, place) => `${run.name} median ${samples[place].length ? valueText(quantity, quantile(samples[place], 0.5)) : "none"}`).join("; ")}`}>
        {ticks(low, high, 6).map((mark) => (
          <g key={mark}>
            <path class="grid" d={`M${x(mark)} 4V${height - 24}`} />
            <text class="bin" x={x(mark)} y={height - 8} text-anchor="middle">{valueText(quantity, mark)}</text>
          </g>
        ))}
        {runs.map((run, place) => {
          const sorted = samples[place];
          const colour = DISTINCT[place % DISTINCT.length];
          const middle = place * row + row / 2 + 4;
          const words = <text class="bin" x={names - 12} y={middle} dy="0.35em" text-anchor="end">{run.name.slice(0, 22)}</text>;
          if (!sorted.length) return <g key={run.name}>{words}</g>;
          const [least, quarter, half, three, most] = [0.05, 0.25, 0.5, 0.75, 0.95].map((share) => x(quantile(sorted, share)));
          return (
            <g key={run.name}>
              {words}
              <path d={`M${least} ${middle}H${most}M${least} ${middle - 5}v10M${most} ${middle - 5}v10`} stroke={colour} stroke-width={1.5} />
              <rect x={quarter} y={middle - 9} width={Math.max(three - quarter, 2)} height={18} rx={2} fill={colour} />
              <path class="median" d={`M${half} ${middle - 9}v18`} />
            </g>
          );
        })}
      </svg>
    </div>
  );
}

/** All maps of a run: filtered by ranges of any quantity, sorted, opened, saved as a selection. */
import { useMemo, useState } from "preact/hooks";
import { useShared } from "../context";
import type { Run } from "../data";
import { save } from "../files";
import { isOurs, unitOf } from "../network/features";
import { Choice, quantityOptions, Switch } from "../parts/Controls";
import { Detail } from "../parts/Detail";
import { MapPicture } from "../parts/MapPicture";
import { listOf } from "../record";
import { whereText, type Ranges } from "../state";
import { nameOf, number, valueText } from "../words";

const FIRST = ["cyclomatic", "crossings", "bridges", "adjacent_crossings", "adjacent_turns", "dead_ends", "components", "straight_share"];
const PAGE = 48;
const BARS = 32;

/** Returns the elites whose quantities are all in their ranges. */
export function within(run: Run, ranges: Ranges): Int32Array {
  const columns = Object.entries(ranges)
    .filter(([name]) => run.quantities.includes(name))
    .map(([name, range]) => [run.column(name), ...range] as const);
  const kept: number[] = [];
  for (let elite = 0; elite < run.count; elite++) {
    if (columns.every(([column, low, high]) => column[elite] >= low && column[elite] <= high)) kept.push(elite);
  }
  return Int32Array.from(kept);
}

export function Maps() {
  const { run, view, show, say } = useShared();
  const [shown, setShown] = useState(PAGE);
  const [chosen, setChosen] = useState(false);
  const among = useMemo(() => within(run, view.where), [run, view.where]);
  const kept = useMemo(() => {
    const column = run.column(run.quantities.includes(view.sort) ? view.sort : "fitness");
    const written = new Set(run.maps.map((map) => map.place));
    const sign = view.descending ? -1 : 1;
    const value = (elite: number) => (Number.isNaN(column[elite]) ? Infinity : sign * column[elite]);
    return [...among].filter((elite) => !chosen || written.has(elite)).sort((one, other) => value(one) - value(other) || one - other);
  }, [run, among, chosen, view.sort, view.descending]);
  const open = view.map !== null && view.map < run.count ? view.map : (kept[0] ?? -1);
  const first = [...new Set([...run.axes.map((axis) => axis.metric), ...run.extras.keys(), ...FIRST])];
  const rest = run.quantities.filter((name) => !first.includes(name));
  const where = whereText(
    Object.fromEntries(Object.entries(view.where).filter(([name]) => isOurs(name))),
    unitOf,
  );
  const unsaid = Object.keys(view.where).filter((name) => run.quantities.includes(name) && !isOurs(name));
  const copy = async () => {
    try {
      await navigator.clipboard.writeText(`--where ${where}`);
      say("Copied");
    } catch {
      save("where.txt", `--where ${where}\n`);
    }
  };
  const range = (name: string) => (
    <Range key={name} run={run} name={name} among={among} value={view.where[name]} onChange={(value) => {
      const { [name]: _, ...others } = view.where;
      show({ where: value ? { ...others, [name]: value } : others });
      setShown(PAGE);
    }} />
  );
  return (
    <div class="split three">
      <section class="panel filters" aria-label="Ranges">
        <h2>Ranges</h2>
        {first.map(range)}
        <details class="filters" open={rest.some((name) => name in view.where)}>
          <summary>More metrics</summary>
          {rest.map(range)}
        </details>
      </section>
      <section class="panel" aria-label="Maps">
        <div class="bar">
          <p class="count" aria-live="polite"><b>{number(kept.length)}</b> of {number(run.count)} maps</p>
          <Choice label="Sort by" value={view.sort} options={quantityOptions(run.quantities)} onChange={(sort) => show({ sort })} />
          <Switch on={view.descending} onChange={(descending) => show({ descending })}>Descending</Switch>
          {run.maps.length > 0 && run.maps.length < run.count && (
            <Switch on={chosen} count={run.maps.length} onChange={setChosen} title="the maps that the run chose and wrote">Chosen</Switch>
          )}
        </div>
        <div class="bar">
          <code class="where">{where ? `--where ${where}` : "no ranges: all maps"}</code>
          <button type="button" disabled={!where} onClick={() => void copy()}>Copy</button>
          <button type="button" disabled={!Object.keys(view.where).length} onClick={() => show({ where: {} })}>Clear</button>
          <button type="button" disabled={!kept.length} onClick={() => save("selection.json", listOf(run, kept), "application/json")}>Save the list</button>
        </div>
        {unsaid.length > 0 && <p class="note">{unsaid.map(nameOf).join(", ")}: not in the text, as --where does not take {unsaid.length > 1 ? "them" : "it"}.</p>}
        <ul class="gallery">
          {kept.slice(0, shown).map((elite) => (
            <li key={elite}>
              <button type="button" aria-pressed={elite === open} onClick={() => show({ map: elite, niche: null })}>
                <MapPicture grid={run.grid(elite)} label={run.label(elite)} />
                <span>{run.labels?.[elite].split("/").slice(-2).join("/") ?? `${nameOf(view.sort)} ${valueText(view.sort, run.column(view.sort)[elite])}`}</span>
              </button>
            </li>
          ))}
        </ul>
        {kept.length > shown && <button type="button" onClick={() => setShown(shown + 2 * PAGE)}>Show more</button>}
        {!kept.length && <p class="note">No map is in all ranges.</p>}
      </section>
      {open >= 0 && <div class="panel side"><Detail elite={open} /></div>}
    </div>
  );
}

interface RangeProps {
  readonly run: Run;
  readonly name: string;
  readonly among: Int32Array;
  readonly value: readonly [number, number] | undefined;
  readonly onChange: (value: readonly [number, number] | null) => void;
}

/** A slider with two handles below the counts of all maps and of those in all ranges. */
function Range({ run, name, among, value, onChange }: RangeProps) {
  const sorted = run.sorted(name);
  const least = sorted[0] ?? 0, most = sorted[sorted.length - 1] ?? 0;
  const bars = useMemo(() => histogram(sorted, least, most), [run, name]);
  const kept = useMemo(() => {
    const column = run.column(name);
    return histogram(Float64Array.from(among, (elite) => column[elite]), least, most);
  }, [run, name, among]);
  const low = Math.max(value?.[0] ?? least, least), high = Math.min(value?.[1] ?? most, most);
  const tallest = Math.max(...bars);
  const set = (from: number, to: number) => onChange(from <= least && to >= most ? null : [from <= least ? -Infinity : from, to >= most ? Infinity : to]);
  const single = least === most;
  return (
    <div class="range">
      <div class="words">
        <span>{nameOf(name)}</span>
        <b>{single ? valueText(name, least) : `${valueText(name, low)} – ${valueText(name, high)}`}</b>
      </div>
      {!single && (
        <>
          <svg viewBox={`0 0 ${BARS} 10`} preserveAspectRatio="none" aria-hidden="true">
            {bars.map((bar, place) => bar > 0 && <rect key={place} class="all" x={place + 0.08} width={0.84} y={10 - barHeight(bar, tallest)} height={barHeight(bar, tallest)} />)}
            {kept.map((bar, place) => bar > 0 && <rect key={place} class="kept" x={place + 0.08} width={0.84} y={10 - barHeight(bar, tallest)} height={barHeight(bar, tallest)} />)}
          </svg>
          <div class="two" style={{ "--low": `${(100 * (low - least)) / (most - least)}%`, "--high": `${(100 * (high - least)) / (most - least)}%` }}>
            <input type="range" min={least} max={most} value={low} aria-label={`least ${nameOf(name)}`} onInput={(event) => set(Math.min(Number(event.currentTarget.value), high), high)} />
            <input type="range" min={least} max={most} value={high} aria-label={`most ${nameOf(name)}`} onInput={(event) => set(low, Math.max(Number(event.currentTarget.value), low))} />
          </div>
        </>
      )}
    </div>
  );
}

/** Few maps remain to be seen beside many. */
const barHeight = (bar: number, tallest: number): number => 10 * Math.sqrt(bar / tallest);

function histogram(values: Float64Array, least: number, most: number): number[] {
  const bars = Array<number>(BARS).fill(0);
  for (const value of values) {
    if (!Number.isNaN(value)) bars[Math.min(BARS - 1, Math.floor((BARS * (value - least)) / Math.max(most - least, 1)))]++;
  }
  return bars;
}


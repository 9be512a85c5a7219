/** All maps of a run, filtered by ranges and sorted. */
import { useMemo, useRef, useState } from "preact/hooks";
import { useShared } from "../context";
import type { Run } from "../data";
import { save } from "../files";
import { isOurs, unitOf } from "../network/features";
import { Choice, quantityOptions, reveal, Switch } from "../parts/Controls";
import { Detail } from "../parts/Detail";
import { Gallery } from "../parts/Gallery";
import { listOf } from "../record";
import { whereText, type Ranges } from "../state";
import { nameOf, number, valueText } from "../words";

const FIRST = [
  "cyclomatic",
  "crossings",
  "bridges",
  "adjacent_crossings",
  "adjacent_turns",
  "dead_ends",
  "components",
  "straight_share",
];
const PAGE = 48;
const BARS = 32;

/** Returns the elites that are in all ranges. */
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

/** Writes the ranges that filter a run's maps as `--where` takes them. */
export function filterText(run: Run, ranges: Ranges): string {
  const filters = Object.entries(ranges).filter(([name]) => isOurs(name) && run.quantities.includes(name));
  return whereText(Object.fromEntries(filters), unitOf);
}

export function Maps() {
  const { run, view, show, say } = useShared();
  const [shown, setShown] = useState(PAGE);
  const [wantsChosen, setWantsChosen] = useState(false);
  const hasOthers = run.maps.length > 0 && run.maps.length < run.count;
  const chosen = wantsChosen && hasOthers;
  const detail = useRef<HTMLDivElement>(null);
  const sort = run.quantities.includes(view.sort) ? view.sort : "fitness";
  const among = useMemo(() => within(run, view.where), [run, view.where]);
  const kept = useMemo(() => {
    const column = run.column(sort);
    const written = new Set(run.maps.map((map) => map.elite));
    const sign = view.descending ? -1 : 1;
    const value = (elite: number) => (Number.isNaN(column[elite]) ? Infinity : sign * column[elite]);
    return [...among]
      .filter((elite) => !chosen || written.has(elite))
      .sort((one, other) => value(one) - value(other) || one - other);
  }, [run, among, chosen, sort, view.descending]);
  const open = view.map !== null && view.map < run.count ? view.map : (kept[0] ?? -1);
  const first = [...new Set([...run.axes.map((axis) => axis.metric), ...run.features.keys(), ...FIRST])];
  const rest = run.quantities.filter((name) => !first.includes(name));
  const where = filterText(run, view.where);
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
    <Range
      key={name}
      run={run}
      name={name}
      among={among}
      value={view.where[name]}
      onChange={(value) => {
        const others = Object.entries(view.where).filter(([other]) => other !== name);
        show({ where: Object.fromEntries(value ? [...others, [name, value]] : others) });
        setShown(PAGE);
      }}
    />
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
          <p class="count" aria-live="polite">
            <b>{number(kept.length)}</b> of {number(run.count)} maps
          </p>
          <Choice
            label="Sort by"
            value={sort}
            options={quantityOptions(run.quantities)}
            onChange={(sort) => show({ sort })}
          />
          <Switch on={view.descending} onChange={(descending) => show({ descending })}>
            Descending
          </Switch>
          {hasOthers && (
            <Switch
              on={chosen}
              count={run.maps.length}
              onChange={setWantsChosen}
              title="only maps that the run wrote to its folder"
            >
              Chosen
            </Switch>
          )}
        </div>
        <div class="bar">
          <code class="where">{where ? `--where ${where}` : "no ranges: all maps"}</code>
          <button type="button" disabled={!where} onClick={() => void copy()}>
            Copy
          </button>
          <button type="button" disabled={!Object.keys(view.where).length} onClick={() => show({ where: {} })}>
            Clear
          </button>
          <button
            type="button"
            disabled={!kept.length}
            onClick={() => save("selection.json", listOf(run, kept), "application/json")}
          >
            Save the list
          </button>
        </div>
        {unsaid.length > 0 && (
          <p class="note">
            {unsaid.map(nameOf).join(", ")}: not in the text, as --where does not take{" "}
            {unsaid.length > 1 ? "them" : "it"}.
          </p>
        )}
        <Gallery
          elites={kept.slice(0, shown)}
          open={open}
          onOpen={(map) => (show({ map, niche: null }), reveal(detail))}
          caption={(elite) =>
            run.labels?.[elite].split("/").slice(-2).join("/") ??
            `${nameOf(sort)} ${valueText(sort, run.column(sort)[elite])}`
          }
        />
        {kept.length > shown && (
          <button type="button" onClick={() => setShown(shown + 2 * PAGE)}>
            Show more
          </button>
        )}
        {!kept.length && <p class="note">No map is in all ranges.</p>}
      </section>
      {open >= 0 && (
        <div class="panel side" ref={detail}>
          <Detail elite={open} />
        </div>
      )}
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

/** A slider with two handles. Bars above it count all maps, and the maps in all ranges. */
function Range({ run, name, among, value, onChange }: RangeProps) {
  const sorted = run.sorted(name);
  const least = sorted[0] ?? 0;
  const most = sorted[sorted.length - 1] ?? 0;
  const whole = useMemo(() => sorted.every(Number.isInteger), [sorted]);
  // Each bar covers the same number of values: otherwise a wider bar would be higher.
  const step = whole ? Math.ceil((most - least + 1) / BARS) : (most - least) / BARS;
  const wide = Math.min(step, (most - least) / 12);
  const bars = useMemo(() => histogram(sorted, least, most, step), [sorted, least, most, step]);
  const kept = useMemo(() => {
    const column = run.column(name);
    return histogram(
      Float64Array.from(among, (elite) => column[elite]),
      least,
      most,
      step,
    );
  }, [run, name, among, least, most, step]);
  const low = Math.max(value?.[0] ?? least, least);
  const high = Math.min(value?.[1] ?? most, most);
  const tallest = Math.max(...bars);
  const set = (from: number, to: number) =>
    onChange(from <= least && to >= most ? null : [from <= least ? -Infinity : from, to >= most ? Infinity : to]);
  const single = least === most;
  const columns = (kind: string, counts: readonly number[]) =>
    counts.map((count, bar) => {
      const high = 10 * Math.sqrt(count / tallest); // a bar of few maps stays visible
      const middle = Math.min(bar * step + (whole ? step - 1 : step) / 2, most - least);
      return (
        count > 0 && (
          <rect key={bar} class={kind} x={middle - 0.42 * wide} width={0.84 * wide} y={10 - high} height={high} />
        )
      );
    });
  return (
    <div class="range">
      <div class="words">
        <span>{nameOf(name)}</span>
        <b>{single ? valueText(name, least) : `${valueText(name, low)} – ${valueText(name, high)}`}</b>
      </div>
      {!single && (
        <>
          <svg viewBox={`0 0 ${most - least} 10`} preserveAspectRatio="none" aria-hidden="true">
            {columns("all", bars)}
            {columns("kept", kept)}
          </svg>
          <div
            class="two"
            style={{
              "--low": `${(100 * (low - least)) / (most - least)}%`,
              "--high": `${(100 * (high - least)) / (most - least)}%`,
            }}
          >
            <input
              type="range"
              class={low > (least + most) / 2 ? "front" : ""}
              min={least}
              max={most}
              step={whole ? 1 : "any"}
              value={low}
              aria-label={`least ${nameOf(name)}`}
              onInput={(event) => set(Math.min(Number(event.currentTarget.value), high), high)}
            />
            <input
              type="range"
              min={least}
              max={most}
              step={whole ? 1 : "any"}
              value={high}
              aria-label={`most ${nameOf(name)}`}
              onInput={(event) => set(low, Math.max(Number(event.currentTarget.value), low))}
            />
          </div>
        </>
      )}
    </div>
  );
}

/** Returns the number of values in each bar. A single value has no bars. */
export function histogram(values: Float64Array, least: number, most: number, step: number): number[] {
  if (least === most) return [];
  const bars = Array<number>(Math.floor((most - least) / step) + 1).fill(0);
  for (const value of values) if (!Number.isNaN(value)) bars[Math.floor((value - least) / step)]++;
  return bars;
}

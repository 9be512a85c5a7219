/** The archive: its niches as cells, the map in the open niche, and all other maps in that niche. */
import { useMemo, useRef } from "preact/hooks";
import { useShared } from "../context";
import type { Run, Seed } from "../data";
import { layoutOf } from "../layout";
import { binName, binsOf } from "../network/features";
import { useShown } from "../parts/canvas";
import { Choice, quantityOptions, reveal, Segments } from "../parts/Controls";
import { Detail } from "../parts/Detail";
import { Gallery } from "../parts/Gallery";
import { HeatMap } from "../parts/HeatMap";
import { openElite, openNiche, shownElites } from "../selection";
import { nameOf, number } from "../words";

/** Returns the number that each cell shows, NaN for a vacant niche. */
function valuesOf(run: Run, seed: Seed, colour: string): Float64Array {
  if (seed === "count") return Float64Array.from(run.filled(), (count) => count || NaN);
  const column = run.column(run.quantities.includes(colour) ? colour : "fitness");
  return Float64Array.from(run.elites(seed), (elite) => (elite < 0 ? NaN : column[elite]));
}

export function Archive() {
  const { run, view, show } = useShared();
  const detail = useRef<HTMLDivElement>(null);
  const layout = useMemo(() => layoutOf(run, view.across), [run, view.across]);
  const quantity = view.seed === "count" ? "filled" : run.quantities.includes(view.colour) ? view.colour : "fitness";
  const values = useMemo(() => valuesOf(run, view.seed, quantity), [run, view.seed, quantity]);
  const elites = shownElites(run, view.seed);
  const niche = openNiche(run, view);
  const elite = openElite(run, view);
  const filled = elites.reduce((count, one) => count + +(one >= 0), 0);
  return (
    <div class="split">
      <section class="panel" aria-label="The archive">
        <p class="lead">
          Each cell is a niche. Its position says which kind of map belongs there, its colour{" "}
          {quantity === "filled"
            ? "how many seeds found one"
            : `the ${nameOf(quantity).toLowerCase()} of the fittest one`}
          . A click or the arrow keys open a niche.
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
            options={
              [
                ["rank", "By rank"],
                ["linear", "Even"],
              ] as const
            }
            onChange={(scale) => show({ scale })}
          />
        </div>
        <HeatMap
          run={run}
          layout={layout}
          values={values}
          quantity={quantity}
          selected={niche}
          elites={elites}
          onClick={() => reveal(detail)}
        />
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

/** All maps in a niche, from all seeds, the fittest first. */
function Others({
  run,
  niche,
  open,
  onOpen,
}: {
  readonly run: Run;
  readonly niche: number;
  readonly open: number;
  readonly onOpen: (elite: number) => void;
}) {
  const shown = useShown();
  const all = useMemo(() => {
    const found: number[] = [];
    run.niche.forEach((one, elite) => one === niche && found.push(elite));
    return found.sort((one, other) => run.fitness[one] - run.fitness[other] || one - other);
  }, [run, niche]);
  if (all.length < 2 || !shown) return null;
  return (
    <section class="panel others" aria-label="Maps in this niche">
      <h2>
        {number(all.length)} maps in this niche
        {run.seeds > 1 && `, of ${new Set(all.map((elite) => run.seed[elite])).size} seeds`}
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
        {run.axes.map((axis, index) => (
          <li key={axis.metric}>
            {nameOf(axis.metric).toLowerCase()} {binName(axis, bins[index])}
          </li>
        ))}
      </ul>
    </section>
  );
}

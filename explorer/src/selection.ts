/** The run, the niche and the elite that a view selects. */
import type { Data, Run, Seed } from "./data";
import { nicheAt } from "./network/features";
import type { View } from "./state";

/** Returns a view whose run, seed and pins exist in the data. */
export function validView(view: View, data: Data): View {
  const index = Math.min(view.run, data.runs.length - 1);
  const run = data.runs[index];
  const one = run.seeds === 1 || (typeof view.seed === "number" && view.seed >= run.seeds);
  const pins = view.pins.filter(([pinned, elite]) => elite < (data.runs[pinned]?.count ?? 0));
  return { ...view, run: index, seed: one ? "best" : view.seed, pins };
}

/** Returns the elites that the archive shows. If it counts seeds, these are the best of all seeds. */
export const shownElites = (run: Run, seed: Seed): Int32Array => run.elites(seed === "count" ? "best" : seed);

/** Returns the open niche: of the open map, or of the address, or of the fittest elite. */
export function openNiche(run: Run, view: View): number {
  if (view.map !== null && view.map < run.count) return run.niche[view.map];
  const bins = view.niche?.split("-").map(Number);
  if (bins?.length === run.axes.length && bins.every((bin, axis) => bin < run.axes[axis].bins))
    return nicheAt(run.axes, bins);
  let best = -1;
  for (const elite of shownElites(run, view.seed)) {
    if (elite >= 0 && (best < 0 || run.fitness[elite] < run.fitness[best])) best = elite;
  }
  return best < 0 ? 0 : run.niche[best];
}

/** Returns the elite that is open, or -1 where the open niche is vacant. */
export function openElite(run: Run, view: View): number {
  if (view.map !== null && view.map < run.count) return view.map;
  return shownElites(run, view.seed)[openNiche(run, view)];
}

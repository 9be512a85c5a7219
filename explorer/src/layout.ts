/** The rows and columns of the niches: one axis is horizontal, all others are vertical. */
import type { Run } from "./data";
import { binsOf, nicheAt } from "./network/features";

/** The indices of the horizontal axis and of the vertical axes. */
export interface Layout {
  readonly across: number;
  readonly down: readonly number[];
  readonly columns: number;
  readonly rows: number;
}

export function layoutOf(run: Run, across: string | null): Layout {
  const wished = run.axes.findIndex((axis) => axis.metric === across);
  const most = Math.max(...run.axes.map((axis) => axis.bins));
  const chosen = wished >= 0 ? wished : run.axes.findIndex((axis) => axis.bins === most);
  const down = run.axes.map((_, axis) => axis).filter((axis) => axis !== chosen);
  return {
    across: chosen,
    down,
    columns: run.axes[chosen].bins,
    rows: down.reduce((rows, axis) => rows * run.axes[axis].bins, 1),
  };
}

export function nicheIn(run: Run, layout: Layout, row: number, column: number): number {
  const bins = run.axes.map(() => column);
  for (const axis of [...layout.down].reverse()) {
    bins[axis] = row % run.axes[axis].bins;
    row = Math.floor(row / run.axes[axis].bins);
  }
  return nicheAt(run.axes, bins);
}

export function cellOf(run: Run, layout: Layout, niche: number): [row: number, column: number] {
  const bins = binsOf(run.axes, niche);
  return [layout.down.reduce((row, axis) => row * run.axes[axis].bins + bins[axis], 0), bins[layout.across]];
}

/** Returns the row of the target niches, or null without targets. */
export function targetRowOf(run: Run, layout: Layout): number | null {
  const down = layout.down.map((axis) => run.axes[axis]);
  if (!down.length || run.axes[layout.across].target !== null || down.some((axis) => axis.target === null)) return null;
  return down.reduce((row, axis) => row * axis.bins + axis.target!, 0);
}

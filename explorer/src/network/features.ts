/** Features of a grid, and the niches that they select. Shares are in thousandths. */
import { METRIC_NAMES, type MetricName } from "./measure";
import { TOWN_FEATURES, TOWN_PARTS, TOWN_RATIOS } from "./town";

export const SHARE_UNIT = 1000;

/** For each share, the metric above the line and the metrics whose sum is below it. */
const SHARES: Readonly<Record<string, readonly [MetricName, readonly MetricName[]]>> = {
  straight_share: ["straights", ["tiles"]],
  turn_share: ["turns", ["tiles"]],
  crossing_share: ["crossings", ["tiles"]],
  coverage: ["tiles", ["tiles", "empty_cells"]],
};

export const FEATURES: readonly string[] = [...METRIC_NAMES, ...Object.keys(SHARES)];

/** Returns whether a feature is a share, from 0 to 1, in thousandths. */
export const isShare = (name: string): boolean => Object.hasOwn(SHARES, name) || TOWN_PARTS.includes(name);

/** Returns 1000 for a feature in thousandths, and 1 for all others. */
export const unitOf = (name: string): number => (isShare(name) || TOWN_RATIOS.includes(name) ? SHARE_UNIT : 1);

/** Returns whether the package has a feature. All other features are kernels of a user. */
export const isOurs = (name: string): boolean =>
  FEATURES.includes(name) || (TOWN_FEATURES as readonly string[]).includes(name);

const METRIC_INDEX = Object.fromEntries(METRIC_NAMES.map((name, index) => [name, index])) as Record<MetricName, number>;

/** Returns a feature as a whole number, computed from the metrics that begin at index `start`. */
export function feature(name: string, metrics: ArrayLike<number>, start = 0): number {
  const share = SHARES[name];
  if (!share) return metrics[start + METRIC_INDEX[name as MetricName]];
  const total = share[1].reduce((sum, part) => sum + metrics[start + METRIC_INDEX[part]], 0);
  return Math.floor((SHARE_UNIT * metrics[start + METRIC_INDEX[share[0]]]) / Math.max(total, 1));
}

/** One axis of the descriptor space: bins of equal width, of which the first and the last are open. */
export interface Axis {
  readonly metric: string;
  readonly bins: number;
  readonly width: number;
  readonly start: number;
  readonly target: number | null;
}

export function binOf(axis: Axis, value: number): number {
  return Math.min(Math.max(Math.floor((value - axis.start) / axis.width), 0), axis.bins - 1);
}

/** Returns the index of the niche that features select. The last axis runs fastest. */
export function nicheOf(axes: readonly Axis[], value: (name: string) => number): number {
  return axes.reduce((niche, axis) => niche * axis.bins + binOf(axis, value(axis.metric)), 0);
}

/** Returns a niche's bin on each axis. */
export function binsOf(axes: readonly Axis[], niche: number): number[] {
  const bins = axes.map(() => 0);
  for (let index = axes.length - 1; index >= 0; index--) {
    bins[index] = niche % axes[index].bins;
    niche = Math.floor(niche / axes[index].bins);
  }
  return bins;
}

export function nicheAt(axes: readonly Axis[], bins: readonly number[]): number {
  return axes.reduce((niche, axis, index) => niche * axis.bins + bins[index], 0);
}

/** Writes the values in a bin. Shares are in per cent. */
export function binName(axis: Axis, bin: number): string {
  const isWhole = unitOf(axis.metric) === 1;
  const isPerCent = isShare(axis.metric);
  const show = (value: number): string => {
    if (isPerCent) return `${+((100 * value) / SHARE_UNIT).toFixed(1)}%`;
    return isWhole ? `${value}` : `${+(value / SHARE_UNIT).toFixed(2)}`;
  };
  const first = axis.start + bin * axis.width;
  const last = first + axis.width - 1;
  // The first bin has all smaller values, and the last one all larger ones. Counts such as that of components start
  // at 1, because every map has one.
  if (bin === 0 && axis.start > 1) return isWhole ? `≤${last}` : `<${show(last + 1)}`;
  if (bin === axis.bins - 1 && !(isPerCent && last >= SHARE_UNIT - 1)) return `${show(first)}+`;
  return isWhole && first !== last ? `${first}–${last}` : show(first);
}

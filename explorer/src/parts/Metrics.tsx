/** The metrics of a map, each next to the quantiles of its run. */
import { quantile, quantileOf, type Run } from "../data";
import { useMemo, useState } from "preact/hooks";
import type { Grid } from "../network/codes";
import { useShown } from "./canvas";
import { feature, FEATURES } from "../network/features";
import { measureTown, TOWN_FEATURES } from "../network/town";
import { nameOf, valueText, WORDS } from "../words";

/** The metrics that are not folded away. */
const FIRST = [
  "cyclomatic",
  "components",
  "dead_ends",
  "bridges",
  "crossings",
  "adjacent_crossings",
  "adjacent_turns",
  "straight_score",
  "coverage",
];

const NONE = new Float64Array(0);

interface Props {
  readonly run: Run;
  readonly grid: Grid;
  readonly metrics: ArrayLike<number>;
  readonly fitness: number;
  readonly above?: number;
  /** Features beside the metrics, NaN if the page cannot measure one. */
  readonly features?: Readonly<Record<string, number>>;
}

export function Metrics({ run, grid, metrics, fitness, above, features = {} }: Props) {
  const value = (name: string): number =>
    name === "fitness" ? fitness : name === "above_floor" ? (above ?? NaN) : (features[name] ?? feature(name, metrics));
  const first = ["fitness", ...(above === undefined ? [] : ["above_floor"]), ...FIRST, ...Object.keys(features)];
  const rest = FEATURES.filter((name) => !FIRST.includes(name));
  const shown = useShown();
  const rows = (names: readonly string[]) =>
    names.map((name) => <Row key={name} run={run} name={name} value={value(name)} beside={shown} />);
  return (
    <div class="metrics">
      {run.count > 1 && (
        <p class="note">
          Each bar spans 90 % of the {run.count.toLocaleString("en")} maps of this run. Its dark part spans the middle
          half. The dot is this map.
        </p>
      )}
      <table>
        <tbody>{rows(first)}</tbody>
      </table>
      <details>
        <summary>All metrics</summary>
        <table>
          <tbody>{rows(rest)}</tbody>
        </table>
      </details>
      <Town run={run} grid={grid} shown={Object.keys(features)} />
    </div>
  );
}

/** The features of a town that are not shown above. They are measured when they are opened. */
function Town({ run, grid, shown }: { readonly run: Run; readonly grid: Grid; readonly shown: readonly string[] }) {
  const [open, setOpen] = useState(false);
  const town = useMemo(() => (open ? measureTown(grid) : {}), [grid, open]);
  const names = TOWN_FEATURES.filter((name) => !shown.includes(name));
  if (!names.length) return null;
  return (
    <details onToggle={(event) => setOpen(event.currentTarget.open)}>
      <summary>As a town</summary>
      {open && (
        <table>
          <tbody>
            {names.map((name) => (
              <Row key={name} run={run} name={name} value={town[name] ?? NaN} beside />
            ))}
          </tbody>
        </table>
      )}
    </details>
  );
}

interface RowProps {
  readonly run: Run;
  readonly name: string;
  readonly value: number;
  /** Whether the run's quantiles are shown. */
  readonly beside: boolean;
}

function Row({ run, name, value, beside }: RowProps) {
  const sorted = beside && run.quantities.includes(name) && !Number.isNaN(value) ? run.sorted(name) : NONE;
  const share = Math.round(100 * quantileOf(sorted, value));
  return (
    <tr title={WORDS[name]?.meaning}>
      <th scope="row">{nameOf(name)}</th>
      <td class="value">{valueText(name, value)}</td>
      <td class="strip">
        {sorted.length > 1 && <Strip sorted={sorted} value={value} label={`more than ${share} % of the maps`} />}
      </td>
    </tr>
  );
}

/** A strip from the lowest to the highest value, with quantiles and a dot for one value. */
function Strip({
  sorted,
  value,
  label,
}: {
  readonly sorted: Float64Array;
  readonly value: number;
  readonly label: string;
}) {
  const low = Math.min(sorted[0], value);
  const high = Math.max(sorted[sorted.length - 1], value);
  const x = (number: number) => 4 + (high > low ? (92 * (number - low)) / (high - low) : 46);
  const [least, quarter, middle, three, most] = [0.05, 0.25, 0.5, 0.75, 0.95].map((part) => x(quantile(sorted, part)));
  return (
    <svg viewBox="0 0 100 12" preserveAspectRatio="none" role="img" aria-label={label}>
      <path class="whole" d="M4 6H96" />
      <path class="most" d={`M${least} 6H${Math.max(most, least + 0.5)}`} />
      <path class="half" d={`M${quarter} 6H${Math.max(three, quarter + 0.5)}`} />
      <path class="middle" d={`M${middle} 2V10`} />
      {!Number.isNaN(value) && <path class="dot" d={`M${x(value)} 6h0.001`} />}
    </svg>
  );
}

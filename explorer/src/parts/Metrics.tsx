/** The metrics of a map beside the quantiles of a run. */
import { quantile, quantileOf, type Run } from "../data";
import { feature, FEATURES } from "../network/features";
import { nameOf, valueText, WORDS } from "../words";

/** The metrics that are shown at first; the rest is folded away. */
const FIRST = [
  "cyclomatic", "components", "dead_ends", "bridges", "crossings", "adjacent_crossings", "adjacent_turns",
  "straight_score", "coverage",
];

interface Props {
  readonly run: Run;
  readonly counts: ArrayLike<number>;
  readonly fitness: number;
  readonly above?: number;
  /** Features that a search measured beside the metrics. */
  readonly extras?: Readonly<Record<string, number>>;
}

export function Metrics({ run, counts, fitness, above, extras = {} }: Props) {
  const value = (name: string): number =>
    name === "fitness" ? fitness : name === "above_floor" ? (above ?? NaN) : (extras[name] ?? feature(name, counts));
  const first = ["fitness", ...(above === undefined ? [] : ["above_floor"]), ...FIRST, ...Object.keys(extras)];
  const rest = FEATURES.filter((name) => !FIRST.includes(name));
  const rows = (names: readonly string[]) => names.map((name) => <Row key={name} run={run} name={name} value={value(name)} />);
  return (
    <div class="metrics">
      <p class="note">
        Each bar spans 90 % of the {run.count.toLocaleString("en")} maps of this run, its dark part the middle half; the dot is this map.
      </p>
      <table>
        <tbody>{rows(first)}</tbody>
      </table>
      <details>
        <summary>All metrics</summary>
        <table>
          <tbody>{rows(rest)}</tbody>
        </table>
      </details>
    </div>
  );
}

function Row({ run, name, value }: { readonly run: Run; readonly name: string; readonly value: number }) {
  const sorted = run.sorted(name);
  const share = Math.round(100 * quantileOf(sorted, value));
  return (
    <tr title={WORDS[name]?.meaning}>
      <th scope="row">{nameOf(name)}</th>
      <td class="value">{valueText(name, value)}</td>
      <td class="strip">{sorted.length > 1 && <Strip sorted={sorted} value={value} label={`more than ${share} % of the maps`} />}</td>
    </tr>
  );
}

/** A strip from the least to the most, with quantiles and the value's dot. */
function Strip({ sorted, value, label }: { readonly sorted: Float64Array; readonly value: number; readonly label: string }) {
  const low = Math.min(sorted[0], value), high = Math.max(sorted[sorted.length - 1], value);
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

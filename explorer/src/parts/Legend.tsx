/** The scale of colours of the archive, and its legend. */
import { css, viridis } from "../colours";
import { bisect } from "../data";
import { nameOf, valueText } from "../words";

/** Returns whether low values are good. Good values are bright. */
const lowIsGood = (quantity: string): boolean =>
  [
    "fitness",
    "above_floor",
    "components",
    "dead_ends",
    "boundary_violations",
    "bridges",
    "adjacent_crossings",
    "adjacent_crossing_score",
    "adjacent_turns",
    "crowded_crossings",
    "unlinked_neighbours",
    "mismatches",
    "off_alphabet",
  ].includes(quantity);

export interface Scale {
  readonly low: number;
  readonly high: number;
  /** Returns the position, from 0 to 1, of a number on the scale of colours. */
  readonly position: (value: number) => number;
  /** Returns the number at a share of the way from the lowest to the highest. */
  readonly at: (part: number) => number;
}

/** Returns the colour scale of values: linear, or by rank among all cells. */
export function scaleOf(values: Float64Array, quantity: string, kind: "linear" | "rank"): Scale {
  const sorted = values.filter((value) => !Number.isNaN(value)).sort();
  const low = sorted[0] ?? 0;
  const high = sorted[sorted.length - 1] ?? 0;
  const rounded = sorted.every(Number.isInteger) ? Math.round : (value: number) => value;
  const turn = (position: number) => (lowIsGood(quantity) ? 1 - position : position);
  if (high === low) return { low, high, position: () => turn(lowIsGood(quantity) ? 0 : 1), at: () => low };
  if (kind === "linear")
    return {
      low,
      high,
      position: (value) => turn((value - low) / (high - low)),
      at: (part) => rounded(low + (high - low) * part),
    };
  const distinct = sorted.filter((value, index) => index === 0 || value !== sorted[index - 1]);
  const last = distinct.length - 1;
  return {
    low,
    high,
    position: (value) => turn(bisect(distinct, value) / last),
    at: (part) => distinct[Math.round(part * last)],
  };
}

interface LegendProps {
  readonly quantity: string;
  readonly empty: boolean;
  readonly unknown: boolean;
  readonly scale: Scale;
}

export function Legend({ quantity, empty, unknown, scale }: LegendProps) {
  if (empty) return <p class="note">All niches are vacant.</p>;
  const { low, high, position, at } = scale;
  const stops = Array.from({ length: 17 }, (_, stop) =>
    css(viridis(position(low) + ((position(high) - position(low)) * stop) / 16)),
  );
  const marks = [...new Set([0, 0.25, 0.5, 0.75, 1].map((part) => valueText(quantity, at(part))))];
  return (
    <div
      class="legend"
      role="img"
      aria-label={`${nameOf(quantity)} from ${valueText(quantity, low)} to ${valueText(quantity, high)}; hatched niches are vacant`}
    >
      <b>{nameOf(quantity)}</b>
      <div class="ramp">
        <i style={{ background: high > low ? `linear-gradient(to right, ${stops.join(",")})` : stops[0] }} />
        <div>
          {marks.map((mark) => (
            <span key={mark}>{mark}</span>
          ))}
        </div>
      </div>
      {lowIsGood(quantity) && <em>lower is better</em>}
      <span class="vacant">
        <i />
        vacant
      </span>
      {unknown && (
        <span class="vacant unknown">
          <i />
          not known
        </span>
      )}
    </div>
  );
}

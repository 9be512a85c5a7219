import { feature } from "../network/features";
import { METRIC_NAMES, type Weights } from "../network/measure";
import { nameOf, number } from "../words";

interface WeightProps {
  readonly weights: Weights;
  /** The weights of the run. */
  readonly usual: Weights;
  /** The weights of a search without `--weights`. */
  readonly defaults: Weights;
  readonly metrics: ArrayLike<number>;
  /** Features beside the metrics that have a weight or may have one. */
  readonly town: Readonly<Record<string, number>>;
  readonly onWeights: (weights: Weights | null) => void;
}

/** Writes the weights as `--weights` takes them: the changed ones, and those of the run that are not the defaults. */
export const weightsText = (names: readonly string[], weights: Weights, usual: Weights, defaults: Weights): string =>
  names
    .filter((name) => weights[name] !== usual[name] || weights[name] !== (defaults[name] ?? 0))
    .map((name) => `${name}=${weights[name]}`)
    .join(" ");

/** The weights of the fitness as sliders, with what each adds. */
export function WeightSliders({ weights, usual, defaults, metrics, town, onWeights }: WeightProps) {
  const names = [...METRIC_NAMES, ...Object.keys(usual).filter((name) => name in town)].sort(
    (one, other) => +(usual[other] !== 0) - +(usual[one] !== 0),
  );
  const used = names.filter((name) => usual[name] || weights[name]);
  const others = names.filter((name) => !used.includes(name));
  const changed = names.filter((name) => weights[name] !== usual[name]);
  const sliders = (list: readonly string[]) =>
    list.map((name) => {
      const units =
        name in town
          ? town[name]
          : name === "components"
            ? Math.max(feature(name, metrics) - 1, 0)
            : feature(name, metrics);
      return (
        <label key={name} class="weight">
          <span>{nameOf(name)}</span>
          <input
            type="range"
            min="-100"
            max="1000"
            step="1"
            value={weights[name]}
            onInput={(event) => onWeights({ ...weights, [name]: Number(event.currentTarget.value) })}
          />
          <output>
            {number(weights[name])} × {number(units)}
          </output>
        </label>
      );
    });
  return (
    <details class="weights">
      <summary>Weights{changed.length > 0 && `, ${changed.length} changed`}</summary>
      {sliders(used)}
      <details>
        <summary>Weights of 0</summary>
        {sliders(others)}
      </details>
      {changed.length > 0 && (
        <div class="bar">
          <code class="where">--weights {weightsText(names, weights, usual, defaults)}</code>
          <button type="button" onClick={() => onWeights(null)}>
            Reset
          </button>
        </div>
      )}
    </details>
  );
}

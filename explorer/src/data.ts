/** The runs on the page, unpacked from Python's values and its compressed arrays. */
import type { Grid } from "./network/codes";
import { binsOf, feature, FEATURES, nicheOf, type Axis } from "./network/features";
import { NO_OBJECTS, type MapObject, type ObjectKinds } from "./network/objects";
import type { PlanValues } from "./network/plan";
import type { SignTags } from "./network/tags";
import { alphabetMask, METRIC_NAMES, fitness, measure, type Weights } from "./network/measure";

interface ArrayRef {
  readonly array: readonly [type: string, start: number, count: number];
  readonly codes?: number;
}

interface Layers {
  readonly image: string;
  readonly masks: string;
}

interface PictureValues extends Layers {
  readonly name: string;
  readonly code: number;
  /** A digest of the picture; the ground of empty cells has none. */
  readonly digest?: string;
  /** The picture as light is compared, if it differs in size. */
  readonly compared?: Layers;
}

export interface TileValues {
  readonly name: string;
  readonly px: number;
  /** Whether the light of the tiles is matched and their seams are feathered. */
  readonly blend: boolean;
  readonly pictures: readonly PictureValues[];
  readonly rotations: Readonly<Record<string, readonly number[]>>;
}

export interface ObjectValues {
  readonly kinds: ObjectKinds;
  /** The tag numbers of each kind of sign that has some. */
  readonly tags: SignTags;
  /** The tag numbers of each street name. */
  readonly streets: readonly (readonly number[])[];
  /** The pictures from above by kind. The front is on the right. Lengths are in metres. */
  readonly pictures: Readonly<
    Record<
      string,
      readonly {
        readonly image: string;
        readonly height: number;
        readonly footprint: readonly [length: number, width: number];
      }[]
    >
  >;
}

interface RunValues {
  readonly name: string;
  readonly shape: readonly [number, number];
  readonly seeds: number;
  readonly axes: readonly Axis[];
  readonly weights: Weights;
  readonly alphabet: readonly number[] | null;
  readonly grids: ArrayRef;
  readonly fitness: ArrayRef | null;
  readonly seed: ArrayRef;
  readonly niche: ArrayRef | null;
  readonly features: Readonly<Record<string, ArrayRef>>;
  readonly labels: readonly string[] | null;
  readonly maps: readonly (Omit<ChosenMap, "objects"> & { readonly objects: ArrayRef | null })[];
  readonly history: {
    readonly steps: number;
    readonly evaluations: ArrayRef;
    readonly best_fitness: ArrayRef;
    readonly elite_count: ArrayRef;
  } | null;
  readonly usual_fitness: boolean;
  readonly floors: readonly (readonly [number, number])[] | null;
  readonly record: Readonly<Record<string, unknown>>;
}

export interface Values {
  readonly format: string;
  readonly version: string;
  readonly title: string;
  readonly tiles: TileValues;
  readonly objects: ObjectValues;
  readonly plan: PlanValues;
  readonly default_weights: Weights;
  readonly lots: ArrayRef;
  readonly runs: readonly RunValues[];
}

export interface ChosenMap {
  readonly elite: number;
  readonly name: string;
  readonly pictures: readonly number[] | null;
  readonly objects: readonly MapObject[];
}

export interface History {
  readonly evaluations: Float64Array;
  /** One row per seed. The best fitness is infinite before a seed has an elite. */
  readonly best_fitness: readonly Float64Array[];
  readonly elite_count: readonly Int32Array[];
}

export interface Data {
  readonly title: string;
  readonly version: string;
  readonly tiles: TileValues;
  readonly objects: ObjectValues;
  readonly plan: PlanValues;
  readonly defaultWeights: Weights;
  readonly lots: Float64Array;
  readonly runs: readonly Run[];
}

const TYPES = { uint8: Uint8Array, int32: Int32Array, float32: Float32Array, float64: Float64Array } as const;
type Typed<T extends keyof typeof TYPES> = InstanceType<(typeof TYPES)[T]>;

/** Unpacks the data that Python packed. */
export async function unpack(values: Values, packed: Uint8Array<ArrayBuffer>): Promise<Data> {
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = await new Response(stream).arrayBuffer();
  function read<T extends keyof typeof TYPES>(type: T, ref: ArrayRef): Typed<T> {
    const [stored, start, count] = ref.array;
    if (stored !== type) throw new TypeError(`expected ${type}, got ${stored}`);
    return new TYPES[type](bytes, start, count) as Typed<T>;
  }
  const runs = values.runs.map((run) => {
    const halves = read("uint8", run.grids);
    const codes = new Uint8Array(run.grids.codes!);
    for (let cell = 0; cell < codes.length; cell++) codes[cell] = (halves[cell >> 1] >> (cell & 1 ? 4 : 0)) & 15;
    const history = run.history && {
      evaluations: read("float64", run.history.evaluations),
      best_fitness: rows(read("float64", run.history.best_fitness), run.history.steps),
      elite_count: rows(read("int32", run.history.elite_count), run.history.steps),
    };
    const features = new Map(Object.entries(run.features).map(([name, ref]) => [name, read("int32", ref)]));
    const maps = run.maps.map(({ objects, ...map }) => ({
      ...map,
      objects: objects ? (JSON.parse(new TextDecoder().decode(read("uint8", objects))) as MapObject[]) : NO_OBJECTS,
    }));
    const fit = run.fitness && read(run.fitness.array[0] === "float32" ? "float32" : "int32", run.fitness);
    const niche = run.niche && read("int32", run.niche);
    return new Run(run, codes, fit, niche, read("int32", run.seed), features, maps, history);
  });
  return {
    title: values.title,
    version: values.version,
    tiles: values.tiles,
    objects: values.objects,
    plan: values.plan,
    defaultWeights: values.default_weights,
    lots: read("float64", values.lots),
    runs,
  };
}

function rows<T extends Int32Array | Float64Array>(values: T, length: number): T[] {
  return Array.from(
    { length: values.length / length },
    (_, row) => values.subarray(row * length, (row + 1) * length) as T,
  );
}

/** The elites that the archive shows: of one seed, the best of all seeds, or the number of seeds with one. */
export type Seed = number | "best" | "count";

/** The elites of a run, with their metrics. */
export class Run {
  readonly name: string;
  readonly height: number;
  readonly width: number;
  readonly seeds: number;
  readonly axes: readonly Axis[];
  readonly weights: Weights;
  readonly alphabet: number;
  readonly labels: readonly string[] | null;
  readonly record: Readonly<Record<string, unknown>>;
  /** Whether the fitness is the weighted sum of metrics and features, without a penalty of ranges. */
  readonly usualFitness: boolean;
  /** The proven minimum of the weighted sum by cyclomatic number, null if none is known. */
  readonly floors: ReadonlyMap<number, number> | null;
  /** The number of elites. */
  readonly count: number;
  /** For each elite, its fitness, its niche and its seed. */
  readonly fitness: Int32Array | Float32Array;
  readonly niche: Int32Array;
  private readonly metrics: Int32Array;
  private readonly measured: Uint8Array;
  private readonly columns = new Map<string, Float64Array>();
  private readonly sortedColumns = new Map<string, Float64Array>();
  private readonly tables = new Map<Seed, Int32Array<ArrayBuffer>>();

  constructor(
    values: RunValues,
    private readonly codes: Uint8Array,
    fit: Int32Array | Float32Array | null,
    niche: Int32Array | null,
    readonly seed: Int32Array,
    /** Features that the search measured beside the metrics. */
    readonly features: ReadonlyMap<string, Int32Array>,
    readonly maps: readonly ChosenMap[],
    readonly history: History | null,
  ) {
    [this.height, this.width] = values.shape;
    ({ name: this.name, seeds: this.seeds, axes: this.axes, weights: this.weights } = values);
    ({ labels: this.labels, record: this.record } = values);
    this.alphabet = alphabetMask(values.alphabet);
    this.usualFitness = values.usual_fitness;
    this.floors = values.floors && new Map(values.floors);
    this.count = seed.length;
    const size = METRIC_NAMES.length;
    this.metrics = new Int32Array(this.count * size);
    this.measured = new Uint8Array(this.count);
    this.niche =
      niche ??
      Int32Array.from({ length: this.count }, (_, elite) => nicheOf(this.axes, (name) => this.feature(name, elite)));
    this.fitness =
      fit ?? Int32Array.from({ length: this.count }, (_, elite) => fitness(this.metricsOf(elite), this.weights));
  }

  grid(elite: number): Grid {
    const cells = this.height * this.width;
    return { height: this.height, width: this.width, codes: this.codes.subarray(elite * cells, (elite + 1) * cells) };
  }

  /** Returns the metrics of an elite, measured at the first call. */
  metricsOf(elite: number): Int32Array {
    if (!this.measured[elite]) {
      measure(this.grid(elite), this.alphabet, this.metrics, elite * METRIC_NAMES.length);
      this.measured[elite] = 1;
    }
    return this.metrics.subarray(elite * METRIC_NAMES.length, (elite + 1) * METRIC_NAMES.length);
  }

  get niches(): number {
    return this.axes.reduce((product, axis) => product * axis.bins, 1);
  }

  /** The quantities of an elite: fitness, features, and the difference to the proven minimum if one is known. */
  get quantities(): readonly string[] {
    return ["fitness", ...(this.floors ? ["above_floor"] : []), ...FEATURES, ...this.features.keys()];
  }

  feature(name: string, elite: number): number {
    return this.features.get(name)?.[elite] ?? feature(name, this.metricsOf(elite));
  }

  /** Returns a quantity of all elites, NaN where it is not defined. */
  column(name: string): Float64Array {
    let column = this.columns.get(name);
    if (!column) {
      column = Float64Array.from({ length: this.count }, (_, elite) => this.value(name, elite));
      this.columns.set(name, column);
    }
    return column;
  }

  /** Returns the values of a quantity, sorted, without NaN. */
  sorted(name: string): Float64Array {
    let sorted = this.sortedColumns.get(name);
    if (!sorted) {
      sorted = this.column(name)
        .filter((value) => !Number.isNaN(value))
        .sort();
      this.sortedColumns.set(name, sorted);
    }
    return sorted;
  }

  private value(name: string, elite: number): number {
    if (name === "fitness") return this.fitness[elite];
    if (name === "above_floor") return this.fitness[elite] - (this.floor(elite) ?? NaN);
    return this.feature(name, elite);
  }

  /** Returns the proven minimum of the fitness in a flawless elite's niche, if one is known. */
  floor(elite: number): number | undefined {
    const flawless =
      this.feature("components", elite) === 1 &&
      ["dead_ends", "boundary_violations", "mismatches", "adjacent_crossings", "adjacent_turns"].every(
        (name) => this.feature(name, elite) === 0,
      );
    return flawless ? this.floors?.get(this.feature("cyclomatic", elite)) : undefined;
  }

  /** Returns the fittest elite in each niche, -1 for a vacant niche. The first of equal elites wins. */
  elites(seed: Seed): Int32Array {
    let table = this.tables.get(seed);
    if (!table) {
      table = new Int32Array(this.niches).fill(-1);
      for (let elite = 0; elite < this.count; elite++) {
        if (typeof seed === "number" && this.seed[elite] !== seed) continue;
        const there = table[this.niche[elite]];
        if (there < 0 || this.fitness[elite] < this.fitness[there]) table[this.niche[elite]] = elite;
      }
      this.tables.set(seed, table);
    }
    return table;
  }

  /** Returns how many seeds have an elite in each niche. */
  filled(): Int32Array {
    const counts = new Int32Array(this.niches);
    const seen = new Set<number>();
    for (let elite = 0; elite < this.count; elite++) {
      const key = this.niche[elite] * this.seeds + this.seed[elite];
      if (!seen.has(key)) {
        seen.add(key);
        counts[this.niche[elite]]++;
      }
    }
    return counts;
  }

  /** Returns the name that a niche has in the page's address. */
  nicheName(niche: number): string {
    return binsOf(this.axes, niche).join("-");
  }

  /** Returns a name for a map. */
  label(elite: number): string {
    const chosen = this.maps.find((map) => map.elite === elite);
    if (this.labels) return this.labels[elite];
    const seed = this.seeds > 1 ? `, seed ${this.seed[elite]}` : "";
    return chosen ? `map ${chosen.name}${seed}` : `niche ${this.nicheName(this.niche[elite])}${seed}`;
  }
}

/** Returns a number from 0 to 1 that chooses the picture of a cell or an object. */
export const lotOf = ({ lots }: Data, index: number): number => lots[index % lots.length];

/** Returns the picture of each cell: the known ones, or pictures drawn by lot. -1 means that the set has none. */
export function choosePictures(grid: Grid, data: Data, known: readonly number[] | null): Int32Array {
  if (known) return Int32Array.from(known);
  return Int32Array.from(grid.codes, (code, cell) => {
    const draws = data.tiles.rotations[code];
    return draws ? draws[Math.floor(lotOf(data, cell) * draws.length)] : -1;
  });
}

/** Returns the share of sorted values below a value, plus half of the share that equals it. */
export function quantileOf(sorted: Float64Array, value: number): number {
  return (bisect(sorted, value) + bisect(sorted, value, true)) / 2 / Math.max(sorted.length, 1);
}

export function quantile(sorted: Float64Array, share: number): number {
  const position = share * (sorted.length - 1);
  const low = Math.floor(position);
  const high = Math.min(low + 1, sorted.length - 1);
  return sorted[low] + (sorted[high] - sorted[low]) * (position - low);
}

/** Returns the number of sorted values below a value, or at most equal to it. */
export function bisect(sorted: ArrayLike<number>, value: number, orEqual = false): number {
  let low = 0;
  let high = sorted.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (sorted[middle] < value || (orEqual && sorted[middle] === value)) low = middle + 1;
    else high = middle;
  }
  return low;
}

/** The fields of map files. */
import type { Data, Run } from "./data";
import { rowsOf } from "./network/codes";
import { binsOf, feature, FEATURES, isShare, unitOf } from "./network/features";
import { NO_OBJECTS, type MapObject } from "./network/objects";
import { shelfFrom, type Shelf } from "./network/shelf";

/** Returns the tile pictures that a map of a run was drawn with, if they are known. */
export const picturesOf = (run: Run, elite: number): readonly number[] | null =>
  run.maps.find((map) => map.elite === elite)?.pictures ?? null;

/** Returns the objects of a map of a run. */
export const objectsOf = (run: Run, elite: number): readonly MapObject[] =>
  run.maps.find((map) => map.elite === elite)?.objects ?? NO_OBJECTS;

/** Returns the metrics as a map file has them, for a grid of so many cells. */
export function metricFields(metrics: ArrayLike<number>, cells: number): Record<string, number> {
  const whole = FEATURES.filter((name) => !isShare(name)).map((name) => [name, feature(name, metrics)] as const);
  return { ...Object.fromEntries(whole), coverage: Math.fround(feature("tiles", metrics) / cells) };
}

/** Returns what is known of an elite, as its map file has it. */
function known(run: Run, elite: number): Record<string, unknown> {
  const metrics = metricFields(run.metricsOf(elite), run.height * run.width);
  for (const name of run.features.keys()) metrics[name] = run.feature(name, elite) / unitOf(name);
  return {
    metrics,
    fitness: run.fitness[elite],
    descriptor: Object.fromEntries(run.axes.map((axis) => [axis.metric, run.feature(axis.metric, elite)])),
    niche: binsOf(run.axes, run.niche[elite]),
  };
}

/** Returns the digests of the pictures of a map by their names, sorted. */
function digestsOf(pictures: readonly number[], data: Data): Record<string, string> {
  const used = [...new Set(pictures.map((picture) => data.tiles.pictures[picture >> 2]))];
  const named = used.flatMap(({ name, digest }) => (digest === undefined ? [] : [[name, digest] as const]));
  return Object.fromEntries(named.sort(([a], [b]) => (a < b ? -1 : 1)));
}

/** Returns the fields of an elite's map file beside its codes. */
export function mapFields(run: Run, elite: number, data: Data): Record<string, unknown> {
  const pictures = picturesOf(run, elite);
  const table = (cell: (picture: number) => unknown) =>
    Array.from({ length: run.height }, (_, row) => pictures!.slice(row * run.width, (row + 1) * run.width).map(cell));
  return {
    ...known(run, elite),
    ...(pictures && {
      drawn: {
        tile_set: data.tiles.name,
        tiles: table((picture) => data.tiles.pictures[picture >> 2].name),
        quarter_turns: table((picture) => picture & 3),
        digests: digestsOf(pictures, data),
      },
    }),
  };
}

/** Writes a list of maps, a map a line, as `elitelanes dataset --maps-from` takes it. */
export function listOf(run: Run, elites: readonly number[]): string {
  const lines = elites.map((elite) => {
    const objects = objectsOf(run, elite);
    const fields = { codes: rowsOf(run.grid(elite)), ...known(run, elite), ...(objects.length && { objects }) };
    return JSON.stringify(fields);
  });
  return `[\n${lines.join(",\n")}\n]\n`;
}

/** Returns the shelf that a run's maps had to fit, or null. */
export function inventoryOf(run: Run): Shelf | null {
  const settings = run.record.settings as { readonly search?: { readonly inventory?: unknown } | null } | undefined;
  return shelfFrom(settings?.search?.inventory);
}

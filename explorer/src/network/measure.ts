/** The metrics and the fitness of one grid. */
import { CONNECTIONS, EAST, IS_TURN, NORTH, SOUTH, WEST, type Grid } from "./codes";
import { countFaces } from "./faces";

/** The metrics that are whole numbers, in the order of Python's `METRIC_NAMES`. */
export const METRIC_NAMES = [
  "components",
  "cyclomatic",
  "dead_ends",
  "boundary_violations",
  "bridges",
  "crossings",
  "adjacent_crossings",
  "adjacent_crossing_score",
  "adjacent_turns",
  "straight_score",
  "straights",
  "turns",
  "crowded_crossings",
  "unlinked_neighbours",
  "tiles",
  "empty_cells",
  "edges",
  "mismatches",
  "off_alphabet",
] as const;
export type MetricName = (typeof METRIC_NAMES)[number];

/** The mask of all codes. */
export const ANY_CODE = 0xffff;

/** Returns the mask of an alphabet: a bit for each code. */
export function alphabetMask(codes: readonly number[] | null): number {
  return codes === null ? ANY_CODE : codes.reduce((mask, code) => mask | (1 << code), 0);
}

/** For each column, the length of the run of vertical straights that ends in the current row. */
let upright = new Int32Array(64);

/**
 * Returns the metrics of one grid.
 *
 * @param alphabet the mask of the codes that `off_alphabet` does not count
 * @param into the array to write to
 * @param start the index of the first metric
 */
export function measure(
  grid: Grid,
  alphabet = ANY_CODE,
  into: Int32Array = new Int32Array(METRIC_NAMES.length),
  start = 0,
): Int32Array {
  const { height, width, codes } = grid;
  let tiles = 0;
  let edges = 0;
  let deadEnds = 0;
  let violations = 0;
  let crossings = 0;
  let crossingPairs = 0;
  let crossingScore = 0;
  let turnPairs = 0;
  let crowded = 0;
  let neighbours = 0;
  let straights = 0;
  let turns = 0;
  let mismatches = 0;
  let offAlphabet = 0;
  let score = 0;
  if (upright.length < width) upright = new Int32Array(width);
  upright.fill(0, 0, width);
  for (let row = 0, cell = 0; row < height; row++) {
    let along = 0;
    for (let column = 0; column < width; column++, cell++) {
      const code = codes[cell];
      const own = CONNECTIONS[code];
      const east = column < width - 1 ? codes[cell + 1] : -1;
      const south = row < height - 1 ? codes[cell + width] : -1;
      offAlphabet += ~(alphabet >> code) & 1;
      let returned = 0;
      let outward = 0;
      if (code & NORTH) {
        if (row === 0) outward++;
        else if (codes[cell - width] & SOUTH) returned++;
      }
      if (code & WEST) {
        if (column === 0) outward++;
        else if (codes[cell - 1] & EAST) returned++;
      }
      const crossing = own >= 3;
      const turn = IS_TURN[code] === 1;
      if (code & EAST) {
        if (east < 0) outward++;
        else if (east & WEST) {
          returned++;
          edges++;
          if (crossing && CONNECTIONS[east] >= 3) {
            crossingPairs++;
            crossingScore += own + CONNECTIONS[east];
          }
        }
      }
      if (code & SOUTH) {
        if (south < 0) outward++;
        else if (south & NORTH) {
          returned++;
          edges++;
          if (crossing && CONNECTIONS[south] >= 3) {
            crossingPairs++;
            crossingScore += own + CONNECTIONS[south];
          }
        }
      }
      if (code) tiles++;
      if (crossing) crossings++;
      if (turn) turns++;
      if (own === 1 || own !== returned) deadEnds++;
      if (outward) violations++;
      mismatches += own - returned - outward;
      for (let pair = 0; pair < 2; pair++) {
        const other = pair ? south : east;
        if (other <= 0 || !code) continue;
        neighbours++;
        const theirCrossing = CONNECTIONS[other] >= 3;
        if (turn && IS_TURN[other]) turnPairs++;
        else if ((crossing || turn) && (theirCrossing || IS_TURN[other])) crowded++;
      }
      if (code === (EAST | WEST)) {
        straights++;
        score += 2 * along++ + 1; // 1, 3, 5, ... add up to the square of the run's length
      } else {
        along = 0;
        if (code === (NORTH | SOUTH)) {
          straights++;
          score += 2 * upright[column]++ + 1;
          continue;
        }
      }
      upright[column] = 0;
    }
  }
  const [faces, bridges] = countFaces(grid);
  into[start] = tiles - edges + faces;
  into[start + 1] = faces;
  into[start + 2] = deadEnds;
  into[start + 3] = violations;
  into[start + 4] = bridges;
  into[start + 5] = crossings;
  into[start + 6] = 2 * crossingPairs;
  into[start + 7] = crossingScore;
  into[start + 8] = turnPairs;
  into[start + 9] = score;
  into[start + 10] = straights;
  into[start + 11] = turns;
  into[start + 12] = crowded;
  into[start + 13] = neighbours - edges;
  into[start + 14] = tiles;
  into[start + 15] = height * width - tiles;
  into[start + 16] = edges;
  into[start + 17] = mismatches;
  into[start + 18] = offAlphabet;
  return into;
}

/** The amount that one unit of each metric adds to the fitness. The first component adds nothing. */
export type Weights = Readonly<Record<string, number>>;

/** Returns the weighted sum of metrics and features. Lower is better. */
export function fitness(
  metrics: ArrayLike<number>,
  weights: Weights,
  features: Readonly<Record<string, number>> = {},
): number {
  let sum = weights.constant ?? 0;
  METRIC_NAMES.forEach((name, index) => {
    const units = name === "components" ? Math.max(metrics[index] - 1, 0) : metrics[index];
    sum += (weights[name] ?? 0) * units;
  });
  for (const [name, value] of Object.entries(features)) sum += (weights[name] ?? 0) * value;
  return sum;
}

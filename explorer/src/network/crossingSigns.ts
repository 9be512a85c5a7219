/**
 * Signs and traffic lights at crossings, by the rules of `elitelanes_jax/maps/furnishing/signs.py`, and which of them fit.
 *
 * Each stop line has two signs on the far side of its crossing: the topology on the right, and on the left the control,
 * which is a stop sign or announces a traffic light. A crossing with a road at one of its corners has no room for them.
 */
import { SIDES, type Grid } from "./codes";
import { linksOf } from "./links";
import { rint } from "./numbers";
import { signAt, type MapObject, type ObjectKinds } from "./objects";

interface Crossing {
  readonly row: number;
  readonly column: number;
  /** The linked sides, as indices of `SIDES`. */
  readonly sides: readonly number[];
  /** Whether no road is at one of its four corners. */
  readonly isFree: boolean;
}

// From the corner of the crossing, in tiles along both sides of the cell next to it.
const NEAR = 0.08;
const SECOND = 0.2;
/** Tiles from a crossing, where signs no longer belong to it. */
const FAR = 1.5;
/** By the way that is closed, in quarter turns clockwise from straight on. */
const TOPOLOGY = ["sign_T_intersect", "sign_left_T_intersect", "", "sign_right_T_intersect"];
const FOUR_WAYS = "sign_4_way_intersect";
const TOPOLOGIES = [FOUR_WAYS, "sign_T_intersect", "sign_left_T_intersect", "sign_right_T_intersect"];
const LIGHT = "trafficlight";
const LIGHT_AHEAD = "sign_t_light_ahead";
const STOP = "sign_stop";
const CONTROLS = [STOP, LIGHT_AHEAD];
/** The classes of signs. A stop line needs one sign of each class that the map has. */
const CLASSES = [TOPOLOGIES, CONTROLS];
const SIGNS = CLASSES.flat();

/** Returns whether an object is a sign of a crossing. */
export const isCrossingSign = ({ kind }: MapObject): boolean => SIGNS.includes(kind);
/** Returns whether an object is a traffic light. A map may have lights without signs. */
export const isLight = ({ kind }: MapObject): boolean => kind === LIGHT;

const hasRoad = ({ height, width, codes }: Grid, row: number, column: number): boolean =>
  row >= 0 && row < height && column >= 0 && column < width && codes[row * width + column] > 0;

function crossingsOf(grid: Grid): Crossing[] {
  const { width } = grid;
  return linksOf(grid).flatMap((sides, cell) => {
    if (sides.length < 3) return [];
    const [row, column] = [Math.floor(cell / width), cell % width];
    const corners = [-1, 1].flatMap((down) => [-1, 1].map((right) => hasRoad(grid, row + down, column + right)));
    return [{ row, column, sides, isFree: !corners.includes(true) }];
  });
}

/** Returns the sign that a driver with a heading, an index of `SIDES`, meets at a crossing. */
function topologyFor({ sides }: Crossing, heading: number): string {
  const closed = [0, 1, 2, 3].find((side) => !sides.includes(side));
  return closed === undefined ? FOUR_WAYS : TOPOLOGY[(closed - heading + 4) % 4];
}

/** Returns the heading of the driver who reads a sign: its printed side faces the driver. */
const headingOf = ({ angle }: MapObject): number => ((rint(-1 - angle / (Math.PI / 2)) % 4) + 4) % 4;

/** Returns the distance in tiles of a light from a crossing; of a sign from the far side as its reader sees it. */
function distance(thing: MapObject, { row, column }: Crossing): number {
  const [ahead, share] = [SIDES[headingOf(thing)], isLight(thing) ? 0 : 0.5];
  return Math.hypot(column + 0.5 + share * ahead.right - thing.x, row + 0.5 + share * ahead.down - thing.y);
}

/** Returns the crossing that a sign or a light belongs to, if one is near. */
function crossingOf(thing: MapObject, crossings: readonly Crossing[]): Crossing | null {
  let nearest: Crossing | null = null;
  let least = FAR;
  for (const crossing of crossings) {
    const away = distance(thing, crossing);
    if (away < least) [nearest, least] = [crossing, away];
  }
  return nearest;
}

/** Returns whether a driver reads a sign at the end of an arm of its crossing, and it shows that crossing. */
function fits(thing: MapObject, crossing: Crossing): boolean {
  if (isLight(thing)) return true;
  const heading = headingOf(thing);
  const isAtArm = crossing.sides.includes((heading + 2) % 4);
  return isAtArm && (!TOPOLOGIES.includes(thing.kind) || thing.kind === topologyFor(crossing, heading));
}

/** How the signs and lights at crossings differ from what the crossings need. */
export interface CrossingFaults {
  /** The number of crossings that have room for signs, and lack one at a stop line. */
  readonly lacking: number;
  /** The number of crossings that lack signs, and have no room for them. */
  readonly withoutRoom: number;
  /** The number of signs and lights that fit no crossing, or are on a road. */
  readonly wrong: number;
}

/** Counts the signs and lights that fit no crossing, and the crossings without signs. A map without signs needs none. */
export function crossingFaults(grid: Grid, objects: readonly MapObject[]): CrossingFaults {
  const things = objects.filter((thing) => isCrossingSign(thing) || isLight(thing));
  if (!things.length) return { lacking: 0, withoutRoom: 0, wrong: 0 };
  const crossings = crossingsOf(grid);
  const isWrong = (thing: MapObject, crossing: Crossing | null): boolean =>
    !crossing || hasRoad(grid, Math.floor(thing.y), Math.floor(thing.x)) || !fits(thing, crossing);
  const signsOf = new Map(crossings.map((crossing) => [crossing, [] as MapObject[]]));
  let wrong = 0;
  for (const thing of things) {
    const crossing = crossingOf(thing, crossings);
    if (isWrong(thing, crossing)) wrong++;
    else signsOf.get(crossing!)!.push(thing);
  }
  const classes = CLASSES.filter((kinds) => things.some(({ kind }) => kinds.includes(kind)));
  const needy = crossings.filter((crossing) =>
    crossing.sides.some((side) => {
      const signs = signsOf.get(crossing)!.filter((sign) => (headingOf(sign) + 2) % 4 === side);
      return !classes.every((kinds) => signs.some(({ kind }) => kinds.includes(kind)));
    }),
  );
  const lacking = needy.filter(({ isFree }) => isFree).length;
  return { lacking, withoutRoom: needy.length - lacking, wrong };
}

/**
 * Returns the signs of all crossings that have room, without tags, and the traffic lights among `objects` that stand at
 * such a crossing. A map without signs gets none. `withoutRoom` is the number of the other crossings.
 */
export function crossingSigns(
  grid: Grid,
  objects: readonly MapObject[],
  kinds: ObjectKinds,
): { signs: MapObject[]; lights: MapObject[]; withoutRoom: number } {
  const crossings = crossingsOf(grid);
  const free = crossings.filter(({ isFree }) => isFree);
  const lights = objects.filter(isLight);
  const crossingsOfLights = lights.map((light) => crossingOf(light, crossings));
  const lightsAt = free.map((crossing) => lights.filter((_, index) => crossingsOfLights[index] === crossing));
  const hasSigns = objects.some(isCrossingSign);
  const needy = hasSigns ? free : [];
  const signs = needy.flatMap((crossing, index) => {
    const control = lightsAt[index].length ? LIGHT_AHEAD : STOP;
    return crossing.sides.flatMap((side) => signsFor(crossing, (side + 2) % 4, control, kinds));
  });
  return { signs, lights: lightsAt.flat(), withoutRoom: hasSigns ? crossings.length - free.length : 0 };
}

/** Returns the two signs that a driver reads who enters a crossing with a heading. */
function signsFor(crossing: Crossing, heading: number, control: string, kinds: ObjectKinds): MapObject[] {
  const [ahead, right] = [SIDES[heading], SIDES[(heading + 1) % 4]];
  const angle = Math.atan2(ahead.down, -ahead.right); // back towards the driver; y points south
  const sign = (kind: string, toRight: number): MapObject => {
    const x = crossing.column + 0.5 + (0.5 + NEAR) * ahead.right + toRight * right.right;
    const y = crossing.row + 0.5 + (0.5 + NEAR) * ahead.down + toRight * right.down;
    return signAt(kind, x, y, angle, kinds);
  };
  return [sign(topologyFor(crossing, heading), 0.5 + NEAR), sign(control, -0.5 - SECOND)];
}

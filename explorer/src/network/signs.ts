/** Whether the signs of a map fit its roads, and signs that do. */
import type { Grid } from "./codes";
import { crossingFaults, crossingSigns, isCrossingSign, isLight } from "./crossingSigns";
import type { MapObject, ObjectKinds } from "./objects";
import { objectsInTheWay } from "./outline";
import { isStreetName, streetFaults, streetNames } from "./streetNames";
import { UsedTags, type SignTags } from "./tags";

/** What signs need beside a map: the kinds of objects, the tags of kinds of signs, and the tags of each street name. */
export interface SignRules {
  readonly kinds: ObjectKinds;
  readonly tags: SignTags;
  readonly streets: readonly (readonly number[])[];
}

/** How the signs of a map differ from what its roads need. */
export interface SignFaults {
  /** The number of crossings that have room for signs, and lack one at a stop line. */
  readonly crossings: number;
  /** The number of crossings that lack signs, and have no room for them. */
  readonly withoutRoom: number;
  /** The number of roads and turns with room for a street name and without one. */
  readonly streets: number;
  /** The number of signs and traffic lights that no crossing and no road needs. */
  readonly wrong: number;
}

/** Returns the faults of the signs on a map, or null if they fit its roads. */
export function signFaults(grid: Grid, objects: readonly MapObject[], { kinds }: SignRules): SignFaults | null {
  const { lacking, withoutRoom, wrong } = crossingFaults(grid, objects);
  const ofStreets = streetFaults(grid, objects, kinds);
  const faults = { crossings: lacking, withoutRoom, streets: ofStreets.missing, wrong: wrong + ofStreets.wrong };
  return Object.values(faults).some(Boolean) ? faults : null;
}

/**
 * Returns the objects of a map with new signs: at crossings if it has signs there, and of streets if it has names.
 *
 * Traffic lights stay at crossings that have room for signs. All other objects stay. `inTheWay` is the number of other
 * objects that a new sign overlaps. `withoutRoom` is the number of crossings that get no signs, because a road is at one
 * of their corners.
 */
export function placeSigns(
  grid: Grid,
  objects: readonly MapObject[],
  { kinds, tags, streets }: SignRules,
): { objects: MapObject[]; inTheWay: number; withoutRoom: number } {
  const others = objects.filter((thing) => !isCrossingSign(thing) && !isLight(thing) && !isStreetName(thing));
  const used = new UsedTags(others);
  const { signs, lights, withoutRoom } = crossingSigns(grid, objects, kinds);
  const placed = [...signs.map((sign) => used.give(sign, tags[sign.kind])), ...lights];
  if (objects.some(isStreetName)) placed.push(...streetNames(grid, [...placed, ...others], kinds, streets, used));
  const inTheWay = new Set(placed.flatMap((sign) => objectsInTheWay(sign, others, kinds))).size;
  return { objects: [...placed, ...others], inTheWay, withoutRoom };
}

/**
 * Street name signs, by the rule of `elitelanes_jax/maps/furnishing/street_names.py`.
 *
 * Each turn has a sign in the outer corner of its tile. Each other road between crossings has one beside a straight tile,
 * as near to the road's middle as there is room. All signs of a road have the same name.
 */
import { IS_TURN, SIDES, type Grid } from "./codes";
import { linksOf, roadsOf } from "./links";
import { signAt, type MapObject, type ObjectKinds } from "./objects";
import { objectsInTheWay } from "./outline";
import type { UsedTags } from "./tags";

const STREET_NAME = "sign_street_name";
const CORNER = 0.28; // tiles from the middle of a turn, along both sides
const BESIDE = 0.58; // tiles from the middle of a straight tile
/** How far from its place a sign may be moved by hand, in tiles. */
const REACH = 0.3;

export const isStreetName = ({ kind }: MapObject): boolean => kind === STREET_NAME;

/** The places of one sign, the best first. */
type Places = readonly MapObject[];

/** Returns for each road the places of each of its signs. */
function placesOf(grid: Grid, kinds: ObjectKinds): Places[][] {
  const links = linksOf(grid);
  return roadsOf(links, grid).flatMap((cells) => {
    const road = [...new Set(cells)].filter((cell) => links[cell].length === 2);
    if (!road.length) return [];
    const turns = road.filter((cell) => IS_TURN[grid.codes[cell]]);
    if (turns.length) return [turns.map((cell) => [inTheCorner(grid, cell, kinds)])];
    const middle = (road.length - 1) / 2;
    const distance = (cell: number): number => Math.abs(road.indexOf(cell) - middle);
    const nearest = [...road].sort((one, other) => distance(one) - distance(other));
    return [[nearest.flatMap((cell) => beside(grid, cell, kinds))]];
  });
}

/** Returns the sign of a turn, in the outer corner of its tile. */
function inTheCorner({ width, codes }: Grid, cell: number, kinds: ObjectKinds): MapObject {
  const sides = SIDES.filter(({ bit }) => codes[cell] & bit);
  const right = sides.reduce((sum, side) => sum + side.right, 0);
  const down = sides.reduce((sum, side) => sum + side.down, 0);
  const [x, y] = [(cell % width) + 0.5 - CORNER * right, Math.floor(cell / width) + 0.5 - CORNER * down];
  return signAt(STREET_NAME, x, y, Math.atan2(-down, right), kinds);
}

/** Returns signs on the cells beside a straight tile that have no road or are outside the map. */
function beside({ height, width, codes }: Grid, cell: number, kinds: ObjectKinds): MapObject[] {
  const code = codes[cell];
  if (code !== 5 && code !== 10) return [];
  const [row, column] = [Math.floor(cell / width), cell % width];
  return SIDES.filter(({ bit }) => code & bit).flatMap((side) => {
    const [down, right] = [side.right, side.down];
    const [r, c] = [row + down, column + right];
    if (r >= 0 && r < height && c >= 0 && c < width && codes[r * width + c]) return [];
    const [x, y] = [column + 0.5 + BESIDE * right, row + 0.5 + BESIDE * down];
    return [signAt(STREET_NAME, x, y, Math.atan2(down, -right), kinds)];
  });
}

const isAt = (sign: MapObject, place: MapObject): boolean =>
  Math.hypot(sign.x - place.x, sign.y - place.y) <= REACH && Math.cos(sign.angle - place.angle) > 0.5;

/**
 * Returns the number of roads and turns that have room for a street name and none, and of the names at no road. A map
 * without street names needs none.
 */
export function streetFaults(
  grid: Grid,
  objects: readonly MapObject[],
  kinds: ObjectKinds,
): { missing: number; wrong: number } {
  const signs = objects.filter(isStreetName);
  if (!signs.length) return { missing: 0, wrong: 0 };
  const places = placesOf(grid, kinds).flat();
  const isClear = (place: MapObject): boolean => !objectsInTheWay(place, objects, kinds).length;
  const isMissing = (listed: Places): boolean =>
    !signs.some((sign) => listed.some((place) => isAt(sign, place))) && listed.some(isClear);
  const isWrong = (sign: MapObject): boolean => !places.some((listed) => listed.some((place) => isAt(sign, place)));
  return { missing: places.filter(isMissing).length, wrong: signs.filter(isWrong).length };
}

/** Returns the street name signs that have room on a map that has other objects. */
export function streetNames(
  grid: Grid,
  objects: readonly MapObject[],
  kinds: ObjectKinds,
  streets: readonly (readonly number[])[],
  tags: UsedTags,
): MapObject[] {
  const signs: MapObject[] = [];
  for (const road of placesOf(grid, kinds)) {
    const others = [...objects, ...signs];
    const isClear = (place: MapObject): boolean => !objectsInTheWay(place, others, kinds).length;
    const places = road.flatMap((listed) => listed.find(isClear) ?? []);
    if (!places.length) continue;
    const numbers = nameFor(places, streets, tags);
    signs.push(...places.map((place) => tags.give(place, numbers)));
  }
  return signs;
}

/**
 * Returns the tags of the name whose nearest use is farthest away; among unused names, of the one with the fewest tags
 * that are enough.
 */
function nameFor(
  places: readonly MapObject[],
  streets: readonly (readonly number[])[],
  tags: UsedTags,
): readonly number[] {
  const preference = (numbers: readonly number[]): [distance: number, fit: number] => {
    const isEnough = numbers.length >= places.length;
    return [tags.distance(places[0], numbers), isEnough ? -numbers.length : numbers.length - 1000];
  };
  return streets.reduce((best, numbers) => {
    const [distance, fit] = preference(numbers);
    const [farthest, bestFit] = preference(best);
    return distance > farthest || (distance === farthest && fit > bestFit) ? numbers : best;
  });
}

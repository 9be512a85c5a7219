/** Objects of a map. Positions are in tiles, x to the east and y to the south; angles are counter-clockwise from east. */
import type { Grid } from "./codes";
import { check } from "./errors";

/** The side of a tile in metres. */
export const TILE_SIZE = 0.585;

/** An object as a map file has it. */
export interface MapObject {
  readonly kind: string;
  readonly x: number;
  readonly y: number;
  readonly angle: number;
  /** In metres. */
  readonly height: number;
  readonly tag?: number;
  readonly static?: boolean;
}

/** By name: the usual height, the length and the width at that height in metres, and whether the footprint is a disc. */
export type ObjectKinds = Readonly<
  Record<string, readonly [height: number, length: number, width: number, isRound: boolean]>
>;

const BEYOND = 1; // tiles that objects may be outside the map
const LARGEST_TAG = 586;
const MOST_OBJECTS = 2 ** 18;

/** The objects of maps without objects. It is always the same list, so that their pictures are not drawn again. */
export const NO_OBJECTS: readonly MapObject[] = [];

type Size = Pick<Grid, "height" | "width">;

/** Returns whether an object may be at a position. */
export const isWithin = (x: number, y: number, { height, width }: Size): boolean =>
  x >= -BEYOND && x <= width + BEYOND && y >= -BEYOND && y <= height + BEYOND;

/** Returns the length and the width of an object's footprint, in tiles. */
export function footprint({ kind, height }: MapObject, kinds: ObjectKinds): [length: number, width: number] {
  const [usual, length, width] = kinds[kind];
  const scale = (usual ? height / usual : 1) / TILE_SIZE;
  return [length * scale, width * scale];
}

/** Returns the objects of a map file, checked. Messages begin with `file`. */
export function checkObjects(
  values: unknown,
  kinds: ObjectKinds,
  { height, width }: Size,
  file: string,
): readonly MapObject[] {
  const expected = `${file}objects: expected a list of at most ${MOST_OBJECTS}`;
  check(Array.isArray(values) && values.length <= MOST_OBJECTS, expected);
  return (values as unknown[]).map((value, index) => {
    const fields = (value ?? {}) as Record<string, unknown>;
    const expect = (name: string, holds: boolean, expected: string) =>
      check(holds, `${file}objects: object ${index}: ${name}: expected ${expected}, got ${textOf(fields[name])}`);
    const number = (name: string, low: number, high: number, usual?: number): number => {
      const one = name in fields ? fields[name] : usual;
      expect(name, typeof one === "number" && one >= low && one <= high, `a number from ${low} to ${high}`);
      return one as number;
    };
    const { kind, tag, static: still, ...others } = fields;
    expect("kind", typeof kind === "string" && Object.hasOwn(kinds, kind), "a kind of object that Duckietown has");
    const [usual] = kinds[kind as string];
    for (const name of Object.keys(others))
      expect(name, ["x", "y", "angle", "height"].includes(name), "only fields of an object");
    const isTag = Number.isInteger(tag) && (tag as number) >= 0 && (tag as number) <= LARGEST_TAG;
    expect("tag", tag == null || isTag, `a whole number from 0 to ${LARGEST_TAG}`);
    expect("static", still === undefined || typeof still === "boolean", "true or false");
    return {
      kind: kind as string,
      x: number("x", -BEYOND, width + BEYOND),
      y: number("y", -BEYOND, height + BEYOND),
      angle: number("angle", -7, 7, 0),
      height: number("height", usual ? 0.001 : 0, usual ? 10 : 0, usual),
      ...(tag != null && { tag: tag as number }),
      ...(still === false && { static: false }),
    };
  });
}

const textOf = (value: unknown): string => (value === undefined ? "none" : JSON.stringify(value).slice(0, 40));

/** Returns objects of which one was moved, in steps of a hundredth of a tile. Refuses positions outside the map. */
export function moveObject(
  objects: readonly MapObject[],
  index: number,
  [x, y]: readonly [x: number, y: number],
  grid: Size,
): readonly MapObject[] {
  const rounded = (place: number) => Math.round(100 * place) / 100;
  const expected = `Expected a position on the map or at most ${BEYOND} tile outside it`;
  check(isWithin(x, y, grid), `${expected}, got x ${rounded(x)}, y ${rounded(y)}`);
  return objects.map((thing, one) => (one === index ? { ...thing, x: rounded(x), y: rounded(y) } : thing));
}

/** Returns the index of the object nearest to a position among those that it touches, or -1. */
export function objectAt(objects: readonly MapObject[], kinds: ObjectKinds, x: number, y: number): number {
  const reach = 0.08; // tiles beside small objects
  let nearest = -1;
  let least = Infinity;
  objects.forEach((thing, index) => {
    const distance = Math.hypot(thing.x - x, thing.y - y);
    if (distance >= least || distance > Math.hypot(...footprint(thing, kinds)) / 2 + reach) return;
    [nearest, least] = [index, distance];
  });
  return nearest;
}

/** Returns the index of the next object in reading order, or the one before; from none the first or the last. */
export function nextObject(objects: readonly MapObject[], index: number, step: 1 | -1): number {
  const order = objects.map((_, one) => one).sort((a, b) => objects[a].y - objects[b].y || objects[a].x - objects[b].x);
  const now = order.indexOf(index);
  return order.at(now < 0 ? (step > 0 ? 0 : -1) : (now + step) % order.length) ?? -1;
}

/** Returns the objects of each kind, by name. */
export function byKind(objects: readonly MapObject[]): [kind: string, objects: readonly MapObject[]][] {
  const kinds = [...new Set(objects.map(({ kind }) => kind))].sort();
  return kinds.map((kind) => [kind, objects.filter((thing) => thing.kind === kind)]);
}

/** Returns by how many tiles a picture is larger than the map on each side, so that objects outside it are visible. */
export function edgeOf(objects: readonly MapObject[], { height, width }: Size): number {
  const farthest = objects.reduce((most, { x, y }) => Math.max(most, -x, x - width, -y, y - height), 0);
  return farthest > 0 ? farthest + 0.2 : 0;
}

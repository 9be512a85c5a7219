/** Objects of a map. Positions are in tiles, x to the east and y to the south; angles are counter-clockwise from east. */
import type { Grid } from "./codes";
import { check, FileError } from "./errors";
import { degreesIn, sixDecimals } from "./numbers";

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
/** By how much more: other formats have metres of six decimals, and tiles of 0.01 m and larger. */
const ROUNDED = 1e-4;
const LARGEST_TAG = 586;
const OTHER = /^other:[\p{L}\p{N}_][\p{L}\p{N}_.-]{0,63}$/u; // kinds that only an imported map has
const MOST_OBJECTS = 2 ** 18;

/** The objects of maps without objects. It is always the same list, so that their pictures are not drawn again. */
export const NO_OBJECTS: readonly MapObject[] = [];

type Size = Pick<Grid, "height" | "width">;

/** In tiles. */
export type Position = readonly [x: number, y: number];

/** Returns whether an object of a file may be at a position. */
export function isWithin(x: number, y: number, { height, width }: Size): boolean {
  const reach = BEYOND + ROUNDED;
  return x >= -reach && x <= width + reach && y >= -reach && y <= height + reach;
}

/** Returns a number rounded to hundredths. */
export const hundredths = (value: number): number => Math.round(100 * value) / 100;

/** Returns an angle in degrees, rounded to hundredths. */
export const degreesOf = (radians: number): number => hundredths(degreesIn(radians));

/** Returns an angle in radians, at most half a turn, from one in degrees. */
export const radiansOf = (degrees: number): number => (Math.PI / 180) * (degrees - 360 * Math.round(degrees / 360));

/** Returns whether a kind is of an imported map: Duckietown's files have the name alone, which no known kind may have. */
function isOther(kind: string, kinds: ObjectKinds): boolean {
  const name = kind.replace("other:", "");
  return OTHER.test(kind) && !Object.hasOwn(kinds, name) && name.toLowerCase() !== "null";
}

/** Returns the known kind of a kind: "other" of "other:helicopter". */
export const baseKind = (kind: string): string => kind.split(":")[0];

/** Returns the length and the width of an object's footprint, in tiles. */
export function footprint({ kind, height }: MapObject, kinds: ObjectKinds): [length: number, width: number] {
  const [usual, length, width] = kinds[baseKind(kind)];
  const scale = (usual ? height / usual : 1) / TILE_SIZE;
  return [length * scale, width * scale];
}

/** Returns an object's fields, checked. Messages begin with the field. */
export function checkObject(value: unknown, kinds: ObjectKinds, { height, width }: Size): MapObject {
  const fields = (value ?? {}) as Record<string, unknown>;
  const expect = (name: string, holds: boolean, expected: string) =>
    check(holds, `${name}: expected ${expected}, got ${textOf(fields[name])}`);
  const number = (name: string, low: number, high: number, usual?: number, slack = 0): number => {
    const one = name in fields ? fields[name] : usual;
    const isWithin = typeof one === "number" && one >= low - slack && one <= high + slack;
    expect(name, isWithin, `a number from ${low} to ${high}`);
    return one as number;
  };
  const { kind, tag, static: still, ...others } = fields;
  const isKind = typeof kind === "string" && (Object.hasOwn(kinds, kind) || isOther(kind, kinds));
  expect("kind", isKind, "a kind of object that Duckietown has, or other:NAME");
  const [usual] = kinds[baseKind(kind as string)];
  for (const name of Object.keys(others))
    expect(name, ["x", "y", "angle", "height"].includes(name), "only fields of an object");
  const isTag = Number.isInteger(tag) && (tag as number) >= 0 && (tag as number) <= LARGEST_TAG;
  expect("tag", tag == null || isTag, `a whole number from 0 to ${LARGEST_TAG}`);
  expect("static", still === undefined || typeof still === "boolean", "true or false");
  return {
    kind: kind as string,
    x: number("x", -BEYOND, width + BEYOND, undefined, ROUNDED),
    y: number("y", -BEYOND, height + BEYOND, undefined, ROUNDED),
    angle: number("angle", -7, 7, 0),
    height: number("height", usual ? 0.001 : 0, usual ? 10 : 0, usual),
    ...(tag != null && { tag: tag as number }),
    ...(still === false && { static: false }),
  };
}

/** Returns the objects of a map file, checked. Messages begin with `file`. */
export function checkObjects(values: unknown, kinds: ObjectKinds, size: Size, file: string): readonly MapObject[] {
  const expected = `${file}objects: expected a list of at most ${MOST_OBJECTS}`;
  check(Array.isArray(values) && values.length <= MOST_OBJECTS, expected);
  return (values as unknown[]).map((value, index) => {
    try {
      return checkObject(value, kinds, size);
    } catch (error) {
      throw new FileError(`${file}objects: object ${index}: ${(error as Error).message}`);
    }
  });
}

const textOf = (value: unknown): string => (value === undefined ? "none" : JSON.stringify(value).slice(0, 40));

/** Returns a new object of the usual height. A sign has the first tag number of its kind that no other object has. */
export function newObject(
  kind: string,
  [x, y]: Position,
  objects: readonly MapObject[],
  kinds: ObjectKinds,
  tags: Readonly<Record<string, readonly number[]>>,
): MapObject {
  const numbers = tags[kind] ?? [];
  const tag = numbers.find((one) => objects.every((thing) => thing.tag !== one)) ?? numbers[0];
  return { kind, x, y, angle: 0, height: kinds[kind][0], ...(tag !== undefined && { tag }) };
}

/** Returns a sign of the usual height, without a tag. */
export function signAt(kind: string, x: number, y: number, angle: number, kinds: ObjectKinds): MapObject {
  return { kind, x: sixDecimals(x), y: sixDecimals(y), angle, height: kinds[kind][0] };
}

/** Returns the object nearest to a position among the objects that it touches. */
export function objectAt(objects: readonly MapObject[], kinds: ObjectKinds, [x, y]: Position): MapObject | undefined {
  const reach = 0.08; // tiles beside small objects
  const distance = (thing: MapObject) => Math.hypot(thing.x - x, thing.y - y);
  return objects
    .filter((thing) => distance(thing) <= Math.hypot(...footprint(thing, kinds)) / 2 + reach)
    .sort((one, other) => distance(one) - distance(other))[0];
}

/** Returns the next object in reading order, or the one before. Without a selected object: the first or the last. */
export function nextObject(
  objects: readonly MapObject[],
  selected: MapObject | undefined,
  step: 1 | -1,
): MapObject | undefined {
  const order = [...objects].sort((one, other) => one.y - other.y || one.x - other.x);
  const now = selected ? order.indexOf(selected) : -1;
  return order.at(now < 0 ? (step > 0 ? 0 : -1) : (now + step) % order.length);
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

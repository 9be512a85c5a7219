/** Signs are placed as Python places them. tests/sign_cases.json has maps, and the objects that `furnish` gives. */
import { readFileSync } from "node:fs";
import { describe, expect, test } from "vitest";
import type { Grid } from "../src/network/codes";
import type { MapObject, ObjectKinds } from "../src/network/objects";
import { isCrossingSign } from "../src/network/crossingSigns";
import { placeSigns, signFaults, type SignFaults, type SignRules } from "../src/network/signs";
import { gridOfText } from "./grids";

type Fields = readonly [
  kind: string,
  x: number,
  y: number,
  angle: number,
  height: number,
  tag: number | null,
  isStatic: boolean,
];

interface Case {
  readonly rows: string;
  /** Whether roads or objects were changed after the objects were placed. */
  readonly changed: boolean;
  readonly objects: readonly Fields[];
  readonly faults: SignFaults;
  readonly placed: readonly Fields[];
}

const read = (url: string): unknown => JSON.parse(readFileSync(new URL(url, import.meta.url), "utf8"));
const { tags, streets, cases } = read("../../tests/sign_cases.json") as SignRules & { cases: Case[] };
const { kinds } = read("cases.json") as { kinds: ObjectKinds };
const rules: SignRules = { kinds, tags, streets };

const none: SignFaults = { crossings: 0, withoutRoom: 0, streets: 0, wrong: 0 };

const objectOf = ([kind, x, y, angle, height, tag, isStatic]: Fields): MapObject => ({
  kind,
  x,
  y,
  angle,
  height,
  ...(tag !== null && { tag }),
  ...(!isStatic && { static: false }),
});

test.each(cases)("signs are placed again on $rows, changed: $changed", ({ rows, changed, objects, faults, placed }) => {
  const grid = gridOfText(rows);
  const before = objects.map(objectOf);
  expect(signFaults(grid, before, rules) ?? none).toEqual(faults);
  const { objects: after, withoutRoom } = placeSigns(grid, before, rules);
  expect(after).toEqual(placed.map(objectOf));
  // A map without signs needs none, even if a road took the room of all that it had.
  const hasSigns = after.some(isCrossingSign);
  expect(signFaults(grid, after, rules) ?? none).toEqual({ ...none, withoutRoom: hasSigns ? withoutRoom : 0 });
  if (!changed) {
    expect(after).toEqual(before);
    expect(signFaults(grid, before, rules)).toBeNull();
  }
});

describe("faults", () => {
  //  A road from west to east, and one to the south.
  const crossing: Grid = gridOfText("000/575/0a0");
  const signs = placeSigns(crossing, [{ kind: "sign_stop", x: 9, y: 9, angle: 0, height: 0.18 }], rules).objects;
  const light: MapObject = { kind: "trafficlight", x: 0.75, y: 0.75, angle: 0, height: 0.4 };
  const duckie: MapObject = { kind: "duckie", x: 0.5, y: 0.5, angle: 0, height: 0.08 };

  test("a map without signs has none", () => {
    expect(signFaults(crossing, [], rules)).toBeNull();
    expect(signFaults(crossing, [duckie], rules)).toBeNull();
    expect(signFaults(crossing, [light], rules)).toBeNull();
  });

  test("signs at a crossing that is gone are out of place, and a light", () => {
    const straight = gridOfText("000/555/000");
    expect(signFaults(crossing, signs, rules)).toBeNull();
    expect(signFaults(straight, [...signs, light], rules)).toEqual({ ...none, wrong: 7 });
    expect(placeSigns(straight, [...signs, light, duckie], rules).objects).toEqual([duckie]);
  });

  test("signs of a crossing that has other sides are out of place", () => {
    const turned = gridOfText("0a0/5d5/000");
    expect(signFaults(turned, signs, rules)!.wrong).toBe(4);
    expect(signFaults(gridOfText("0a0/5f5/0a0"), signs, rules)!.wrong).toBe(3);
  });

  test("a new crossing has none", () => {
    const two = gridOfText("00000/57575/0a0a0");
    expect(signFaults(two, signs, rules)).toEqual({ ...none, crossings: 1 });
  });

  test("a new arm and a stop line whose sign was deleted have none", () => {
    expect(signFaults(gridOfText("0a0/5f5/0a0"), signs, rules)!.crossings).toBe(1);
    for (const sign of signs) {
      const others = signs.filter((other) => other !== sign);
      expect(signFaults(crossing, others, rules)).toEqual({ ...none, crossings: 1 });
      expect(placeSigns(crossing, others, rules).objects).toHaveLength(6);
    }
  });

  test("a crossing with a road at a corner has no room for signs", () => {
    const atCorner = gridOfText("50000/57575/0a0a0");
    // Two of the six signs are on the road.
    expect(signFaults(atCorner, signs, rules)).toEqual({ crossings: 1, withoutRoom: 1, streets: 0, wrong: 2 });
    const { objects, withoutRoom } = placeSigns(atCorner, signs, rules);
    expect([objects.length, withoutRoom]).toEqual([6, 1]);
    expect(signFaults(atCorner, objects, rules)).toEqual({ ...none, withoutRoom: 1 });
    expect(signFaults(gridOfText("00000/57575/0a0a5"), signs, rules)).toEqual({ ...none, withoutRoom: 1 });
  });

  test("a road without a street name, and a name without a road", () => {
    const street = gridOfText("000/555/000");
    const name: MapObject = { kind: "sign_street_name", x: 1.5, y: 5, angle: 0, height: 0.18, tag: 440 };
    expect(signFaults(street, [name], rules)).toEqual({ ...none, streets: 1, wrong: 1 });
    const { objects } = placeSigns(street, [name], rules);
    expect(objects).toMatchObject([{ kind: "sign_street_name", x: 1.5, y: 2.08 }]);
  });

  test("objects in the way of signs are counted and stay", () => {
    const house: MapObject = { kind: "house", x: 0.8, y: 0.8, angle: 0, height: 0.2 };
    const placed = placeSigns(crossing, [...signs, house], rules);
    expect(placed).toEqual({ objects: [...signs, house], inTheWay: 1, withoutRoom: 0 });
  });
});

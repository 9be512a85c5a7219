/** The kernel gives what Python gives: cases.json is written by tests/explorer/kernel_cases.py. */
import { readFileSync } from "node:fs";
import { describe, expect, test } from "vitest";
import { gridOf, rowsOf, type Grid } from "../src/network/codes";
import { binOf, binsOf, feature, nicheAt, nicheOf, type Axis } from "../src/network/features";
import { FileError } from "../src/network/errors";
import { readMap, toDuckietown, toFix, toMapJson } from "../src/network/formats";
import { alphabetMask, METRIC_NAMES, fitness, measure, type MetricName, type Weights } from "../src/network/measure";
import { roadEnds } from "../src/network/links";
import {
  byKind,
  degreesOf,
  edgeOf,
  newObject,
  nextObject,
  objectAt,
  radiansOf,
  type MapObject,
  type ObjectKinds,
} from "../src/network/objects";
import { planOf, type PlanValues } from "../src/network/plan";
import { repair } from "../src/network/repair";
import { measureTown } from "../src/network/town";

interface Read {
  readonly rows: number[][];
  readonly objects: MapObject[];
}

interface Case {
  readonly rows: number[][];
  readonly dirty: number[];
  readonly fixed: number[];
  /** The codes after repair, and after a repair that fills. */
  readonly repaired: number[][];
  readonly metrics: number[];
  readonly fitness: number;
  readonly shares: Record<string, number>;
  readonly axes: Axis[];
  readonly bins: number[];
  readonly town: Record<string, number>;
  readonly objects: MapObject[];
  readonly duckietown: string | null;
  readonly read: Read | null;
  readonly plan: {
    readonly quarterTurns: number[];
    readonly tiles: Record<string, number>;
    readonly tape: Record<string, number>;
  } | null;
}

const { alphabet, weights, kinds, plan, by_hand, odd, cases } = JSON.parse(
  readFileSync(new URL("cases.json", import.meta.url), "utf8"),
) as {
  alphabet: number[];
  weights: Weights;
  kinds: ObjectKinds;
  plan: PlanValues;
  by_hand: Read & { duckietown: string };
  odd: { objects: MapObject[]; duckietown: string };
  cases: Case[];
};

describe.each(cases)("a grid $rows", (one) => {
  const grid: Grid = gridOf(one.rows);
  const metrics = measure(grid, alphabetMask(alphabet));

  test("metrics and fitness", () => {
    expect([...metrics]).toEqual(one.metrics);
    expect(fitness(metrics, weights)).toBe(one.fitness);
  });

  test("features", () => {
    for (const [name, share] of Object.entries(one.shares)) expect(feature(name, metrics)).toBe(share);
    expect(measureTown(grid)).toEqual(one.town);
  });

  test("niche", () => {
    const value = (name: string) => metrics[METRIC_NAMES.indexOf(name as MetricName)];
    expect(one.axes.map((axis) => binOf(axis, value(axis.metric)))).toEqual(one.bins);
    const niche = nicheOf(one.axes, value);
    expect(niche).toBe(nicheAt(one.axes, one.bins));
    expect(binsOf(one.axes, niche)).toEqual(one.bins);
  });

  test("repair", () => {
    one.repaired.forEach((codes, index) => {
      const repaired = repair(grid, { dirty: one.dirty, fixed: one.fixed, fill: index === 1 });
      expect([...repaired.codes]).toEqual(codes);
    });
  });

  test("files", () => {
    const { objects } = one;
    if (one.duckietown === null) expect(() => toDuckietown(grid, objects)).toThrow(FileError);
    else {
      expect(toDuckietown(grid, objects)).toBe(one.duckietown);
      expectRead(one.duckietown, one.read!);
    }
    const read = readMap(toMapJson(grid, { objects }), "map.json", kinds);
    expect([rowsOf(read.grid), read.objects]).toEqual([one.rows, objects]);
    const fixed = Uint8Array.from(grid.codes, (_, cell) => +(cell % 2 === 0));
    expect(readMap(toFix(grid, fixed), "fix.json", kinds).fixed).toEqual(fixed.includes(0) ? fixed : null);
  });

  test("plan", () => {
    if (roadEnds(grid).length) expect(() => planOf(grid, plan)).toThrow("Duckietown has no tile for the dead end at");
    const repaired: Grid = { ...grid, codes: Uint8Array.from(one.repaired.at(-1)!) };
    if (!one.plan) return expect(() => planOf(repaired, plan)).toThrow(FileError);
    const { placed, tiles, tape } = planOf(repaired, plan);
    expect(placed.map(({ quarterTurns }) => quarterTurns)).toEqual(one.plan.quarterTurns);
    expect({ ...tiles, empty: grid.codes.length - placed.length }).toEqual(one.plan.tiles);
    for (const [colour, metres] of Object.entries(one.plan.tape)) expect(tape[colour]).toBe(metres);
  });
});

function expectRead(yaml: string, { rows, objects }: Read): void {
  const read = readMap(yaml, "town.yaml", kinds);
  expect(rowsOf(read.grid)).toEqual(rows);
  expect(read.objects).toHaveLength(objects.length);
  for (const [index, { x, y, angle, ...others }] of objects.entries()) {
    expect(read.objects[index]).toMatchObject(others);
    expect(Math.hypot(read.objects[index].x - x, read.objects[index].y - y)).toBeLessThan(1e-9);
    expect(read.objects[index].angle).toBeCloseTo(angle, 9);
  }
}

const withObject = (fields: object) => JSON.stringify({ codes: [[6, 3]], objects: [fields] });

test.each([
  ["map.json", withObject({ kind: "unicorn", x: 1, y: 1 }), "object 0: kind: expected a kind of object that"],
  ["map.json", withObject({ kind: "duckie", x: 3.1, y: 1 }), "object 0: x: expected a number from -1 to 3, got 3.1"],
  ["map.json", withObject({ kind: "duckie", x: 1 }), "object 0: y: expected a number from -1 to 2, got none"],
  ["map.json", withObject({ kind: "duckie", x: 1, y: 1, tag: 587 }), "tag: expected a whole number from 0 to 586"],
  ["map.json", withObject({ kind: "duckie", x: 1, y: 1, hat: 1 }), "hat: expected only fields of an object, got 1"],
  ["map.json", '{"codes": [[6, 3]], "objects": 5}', "map.json: objects: expected a list"],
  ["map.json", "{", "map.json: expected a map as JSON or Duckietown's YAML"],
  ["map.json", "{}", "map.json: expected rows of tile codes"],
  ["map.json", "[[1, 2], [3]]", "map.json: expected rows of one length"],
  ["map.json", "[[16]]", "map.json: expected tile codes 0 to 15, got 16"],
  ["map.json", JSON.stringify([Array(1025).fill(0)]), "map.json: expected at most 1024 tiles a side"],
  ["town.yaml", "tile_size: 0.585", 'town.yaml: expected a Duckietown map, got no "tiles"'],
  ["town.yaml", "tiles: [[4way", "town.yaml: expected readable YAML, got unexpected end"],
  ["town.yaml", "tiles: [[4way]]\nobjects: [{kind: duckie}]", "town.yaml: objects: 0: expected a pose, pos, place"],
  ["town.yml", "tiles:\n- [moat]", "town.yml: tiles: expected one of Duckietown's kinds, got moat at A1 ([0, 0])"],
])("a bad %s is refused: %s", (name, text, message) => {
  expect(() => readMap(text, name, kinds)).toThrow(message);
});

test("YAML is read as Python reads it", () => expectRead(by_hand.duckietown, by_hand));

test("odd names and heights are written as Python writes them", () => {
  const loop = gridOf([
    [6, 3],
    [12, 9],
  ]);
  expect(toDuckietown(loop, odd.objects)).toBe(odd.duckietown);
});

describe("objects", () => {
  const grid = { height: 2, width: 3 };
  const things = [
    { kind: "house", x: 2, y: 1, angle: 0, height: 0.2 },
    { kind: "duckie", x: 2.2, y: 1, angle: 0, height: 0.08 },
    { kind: "sign_stop", x: 0.5, y: -0.08, angle: 0, height: 0.18, tag: 3 },
  ];

  test("are added with the first free tag of their kind", () => {
    const tags = { sign_stop: [3, 5] };
    expect(newObject("sign_stop", [1, 2], things, kinds, tags)).toMatchObject({ x: 1, y: 2, height: 0.18, tag: 5 });
    expect(newObject("sign_stop", [1, 2], [{ ...things[2], tag: 5 }, things[2]], kinds, tags).tag).toBe(3);
    expect(newObject("duckie", [1, 2], things, kinds, tags)).not.toHaveProperty("tag");
  });

  test("have angles of at most half a turn", () => {
    expect([90, 195, -195, 720, 359.5].map((degrees) => degreesOf(radiansOf(degrees)))).toEqual([
      90, -165, 165, 0, -0.5,
    ]);
  });

  test("are found where they are, the nearest first", () => {
    expect([objectAt(things, kinds, [2.02, 1]), objectAt(things, kinds, [2.15, 1])]).toEqual([things[0], things[1]]);
    expect([objectAt(things, kinds, [0.5, 0.05]), objectAt(things, kinds, [0.5, 0.5])]).toEqual([things[2], undefined]);
  });

  test("are walked through in reading order, all of them", () => {
    const [house, duckie, sign] = things;
    expect([nextObject(things, undefined, 1), nextObject(things, undefined, -1)]).toEqual([sign, duckie]);
    expect(nextObject([], undefined, 1)).toBeUndefined();
    expect([sign, house, duckie].map((thing) => nextObject(things, thing, 1))).toEqual([house, duckie, sign]);
    expect([sign, house, duckie].map((thing) => nextObject(things, thing, -1))).toEqual([duckie, sign, house]);
  });

  test("are listed by kind, and have room at the border", () => {
    expect(byKind(things).map(([kind, some]) => [kind, some.length])).toEqual([
      ["duckie", 1],
      ["house", 1],
      ["sign_stop", 1],
    ]);
    expect(edgeOf(things, grid)).toBeCloseTo(0.28);
    expect(edgeOf(things.slice(0, 2), grid)).toBe(0);
  });
});

/** The kernel gives what Python gives: cases.json is written by tests/explorer/kernel_cases.py. */
import { readFileSync } from "node:fs";
import { describe, expect, test } from "vitest";
import { gridOf, rowsOf, type Grid } from "../src/network/codes";
import { binOf, binsOf, feature, nicheAt, nicheOf, type Axis } from "../src/network/features";
import { FileError, fromDuckietown, readMap, toDuckietown, toFix, toMapJson } from "../src/network/formats";
import { alphabetMask, METRIC_NAMES, fitness, measure, type MetricName, type Weights } from "../src/network/measure";
import { repair } from "../src/network/repair";
import { measureTown } from "../src/network/town";

interface Case {
  readonly rows: number[][];
  readonly dirty: number[];
  readonly fixed: number[];
  readonly repaired: number[][];
  readonly metrics: number[];
  readonly fitness: number;
  readonly shares: Record<string, number>;
  readonly axes: Axis[];
  readonly bins: number[];
  readonly town: Record<string, number>;
  readonly duckietown: string | null;
}

const { alphabet, weights, cases } = JSON.parse(readFileSync(new URL("cases.json", import.meta.url), "utf8")) as {
  alphabet: number[];
  weights: Weights;
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
    if (one.duckietown === null) expect(() => toDuckietown(grid)).toThrow(FileError);
    else {
      expect(toDuckietown(grid)).toBe(one.duckietown);
      expect(rowsOf(fromDuckietown(one.duckietown))).toEqual(one.rows);
    }
    expect(rowsOf(readMap(toMapJson(grid), "map.json").grid)).toEqual(one.rows);
    const fixed = Uint8Array.from(grid.codes, (_, cell) => +(cell % 2 === 0));
    expect(readMap(toFix(grid, fixed), "fix.json").fixed).toEqual(fixed.includes(0) ? fixed : null);
  });
});

test.each([
  ["map.json", "{", "map.json: expected a map as JSON or Duckietown's YAML"],
  ["map.json", "{}", "map.json: expected rows of tile codes"],
  ["map.json", "[[1, 2], [3]]", "map.json: expected rows of one length"],
  ["map.json", "[[16]]", "map.json: expected tile codes 0 to 15, got 16"],
  ["map.json", JSON.stringify([Array(1025).fill(0)]), "map.json: expected at most 1024 tiles a side"],
  ["town.yaml", "tile_size: 0.585", 'town.yaml: expected a Duckietown map, got no "tiles"'],
  ["town.yml", "tiles:\n- [moat]", "town.yml: tiles: expected one of Duckietown's kinds, got moat at row 0, column 0"],
])("a bad %s is refused: %s", (name, text, message) => {
  expect(() => readMap(text, name)).toThrow(message);
});

/** The metrics are those of the oracle: tests/measure_cases.json has its cases, which Python's tests read, too. */
import { readFileSync } from "node:fs";
import { expect, test } from "vitest";
import { alphabetMask, measure, METRIC_NAMES } from "../src/network/measure";
import { metricFields } from "../src/record";
import { gridOfText } from "./grids";

const { alphabet, names, cases } = JSON.parse(
  readFileSync(new URL("../../tests/measure_cases.json", import.meta.url), "utf8"),
) as { alphabet: number[]; names: string[]; cases: [rows: string, metrics: number[]][] };

test("the oracle has the same metrics in the same order", () => {
  expect(names).toEqual([...METRIC_NAMES, "coverage"]);
});

test.each(cases)("%s", (rows, expected) => {
  const grid = gridOfText(rows);
  const metrics = measure(grid, alphabetMask(alphabet));
  const { coverage } = metricFields(metrics, grid.codes.length);
  expect([...metrics, coverage]).toEqual(expected);
});

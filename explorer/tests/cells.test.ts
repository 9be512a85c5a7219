/** Cells have the names that tests/util/test_cells.py has. */
import { expect, test } from "vitest";
import { cellName, columnName, describeCell } from "../src/network/cells";

test("columns have letters as in a spreadsheet", () => {
  expect([0, 2, 25, 26, 51, 52, 701, 702, 1023].map(columnName)).toEqual([
    "A",
    "C",
    "Z",
    "AA",
    "AZ",
    "BA",
    "ZZ",
    "AAA",
    "AMJ",
  ]);
  const names = Array.from({ length: 1024 }, (_, column) => columnName(column));
  expect(new Set(names).size).toBe(1024);
});

test("messages have the index too", () => {
  expect([cellName(1, 2), describeCell(1, 2), describeCell(9, 27)]).toEqual(["C2", "C2 ([1, 2])", "AB10 ([9, 27])"]);
});

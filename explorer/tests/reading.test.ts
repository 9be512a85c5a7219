/** Files are read as Python reads them. tests/formats/reading_cases.json has the files, and what Python makes of them. */
import { readFileSync } from "node:fs";
import { expect, test } from "vitest";
import { textOf } from "../src/files";
import { rowsOf } from "../src/network/codes";
import { FileError } from "../src/network/errors";
import { readMap, type MapContent } from "../src/network/formats";
import type { MapObject, ObjectKinds } from "../src/network/objects";

interface Case {
  readonly file: string;
  readonly text?: string;
  readonly base64?: string;
  /** The words of Python's message if the file is refused. */
  readonly refused?: string;
  readonly rows?: string;
  readonly objects?: MapObject[];
  readonly maps?: number;
}

const read = (url: string): unknown => JSON.parse(readFileSync(new URL(url, import.meta.url), "utf8"));
const cases = read("../../tests/formats/reading_cases.json") as Case[];
const { kinds } = read("cases.json") as { kinds: ObjectKinds };

function open({ file, text, base64 }: Case): MapContent {
  const bytes = text === undefined ? Buffer.from(base64!, "base64") : new TextEncoder().encode(text);
  return readMap(textOf(new Uint8Array(bytes), file), file, kinds);
}

/** Cosines may differ in the last digit, and lights are placed by them. */
const rounded = (thing: MapObject): MapObject =>
  thing.kind === "trafficlight" ? { ...thing, x: Number(thing.x.toFixed(9)), y: Number(thing.y.toFixed(9)) } : thing;

test.each(cases)("$file: $text $base64", (one) => {
  if (one.refused !== undefined) {
    expect(() => open(one)).toThrow(FileError);
    expect(() => open(one)).toThrow(one.file);
    expect(() => open(one)).toThrow(one.refused);
    return;
  }
  const { grid, objects, fixed, maps } = open(one);
  const rows = rowsOf(grid).map((row) => row.map((code) => code.toString(16)).join(""));
  expect(rows.join("/")).toBe(one.rows);
  const known = objects.map(({ tag, static: still, ...others }) => ({
    ...others,
    ...(tag !== undefined && { tag }),
    ...(still === false && { static: still }),
  }));
  expect(known.map(rounded)).toEqual(one.objects!.map(rounded));
  expect([fixed, maps]).toEqual([null, one.maps]);
});

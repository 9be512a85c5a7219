/**
 * JSON as Python reads it.
 *
 * `JSON.parse` does not tell 3 from 3.0, rounds long whole numbers, reads 1e400 as infinity, and takes the last of two
 * equal keys. Map files differ in all of these: a code is a whole number, and a file with a key twice is refused.
 */
import { check, FileError } from "./errors";

/** A number that is written with a point or an exponent. */
export class Real {
  constructor(readonly value: number) {}
}

/** Whole numbers are numbers, and big integers beyond 2⁵³. */
export type Json = null | boolean | string | number | bigint | Real | readonly Json[] | JsonTable;
export type JsonTable = ReadonlyMap<string, Json>;

export const isTable = (value: Json | undefined): value is JsonTable => value instanceof Map;
export const isList = (value: Json | undefined): value is readonly Json[] => Array.isArray(value);
export const isWhole = (value: Json | undefined): value is number | bigint =>
  typeof value === "number" || typeof value === "bigint";

/** Returns whether a value is a number that a float can hold. */
export function isReal(value: Json | undefined): value is number | bigint | Real {
  if (typeof value === "bigint") return value <= LARGEST && value >= -LARGEST;
  return typeof value === "number" || value instanceof Real;
}

/** Returns a value as JavaScript has it. */
export function plain(value: Json): unknown {
  if (value instanceof Real) return value.value;
  if (typeof value === "bigint") return Number(value);
  if (isList(value)) return value.map(plain);
  if (isTable(value)) return Object.fromEntries([...value].map(([name, item]) => [name, plain(item)]));
  return value;
}

const LARGEST = BigInt(Number.MAX_VALUE);
const DEEPEST = 900; // Python reads somewhat more than 900 levels
const MOST_DIGITS = 4300; // of a whole number in Python
const NUMBER = /(-?)(0|[1-9]\d*)((?:\.\d+)?(?:[eE][-+]?\d+)?)/y;
const WORDS = [
  ["true", true],
  ["false", false],
  ["null", null],
] as const;

/** Parses JSON; throws a `FileError` that says what is wrong. */
export function parseJson(text: string): Json {
  let at = 0;
  let depth = 0;

  function fail(): never {
    const fault = `a fault at character ${Math.min(at, text.length)}`;
    throw new FileError(`expected a map as JSON or Duckietown's YAML, got ${fault}`);
  }

  function skipSpaces(): void {
    while (text[at] === " " || text[at] === "\n" || text[at] === "\r" || text[at] === "\t") at++;
  }

  /** Skips spaces and, if it comes next, a mark. */
  function take(mark: string): boolean {
    skipSpaces();
    if (text[at] !== mark) return false;
    at++;
    return true;
  }

  function expect(mark: string): void {
    if (!take(mark)) fail();
  }

  function readString(): string {
    skipSpaces();
    const start = at;
    if (text[at] !== '"') fail();
    for (at++; text[at] !== '"'; at++) {
      if (text[at] === "\\") at++;
      if (at >= text.length) fail();
    }
    at++;
    try {
      return JSON.parse(text.slice(start, at)) as string;
    } catch {
      return fail();
    }
  }

  function readNumber(): Json {
    NUMBER.lastIndex = at;
    const found = NUMBER.exec(text);
    if (!found) return fail();
    const [written, , digits, fraction] = found;
    at += written.length;
    const value = Number(written);
    if (fraction) {
      check(Number.isFinite(value), `JSON: expected numbers, got ${written.slice(0, 40)}`);
      return new Real(value);
    }
    check(digits.length <= MOST_DIGITS, `JSON: expected numbers of at most ${MOST_DIGITS} digits`);
    return Number.isSafeInteger(value) ? value : BigInt(written);
  }

  function readList(): Json {
    const items: Json[] = [];
    if (take("]")) return items;
    do items.push(readValue());
    while (take(","));
    expect("]");
    return items;
  }

  function readTable(): Json {
    const fields = new Map<string, Json>();
    if (take("}")) return fields;
    do {
      const key = readString();
      check(!fields.has(key), `JSON: expected each key once, got ${key.slice(0, 40)} twice`);
      expect(":");
      fields.set(key, readValue());
    } while (take(","));
    expect("}");
    return fields;
  }

  function readNested(read: () => Json): Json {
    at++;
    depth++;
    check(depth <= DEEPEST, "expected a map, got JSON nested too deeply");
    const value = read();
    depth--;
    return value;
  }

  function readValue(): Json {
    skipSpaces();
    if (text[at] === "[") return readNested(readList);
    if (text[at] === "{") return readNested(readTable);
    if (text[at] === '"') return readString();
    for (const [word, value] of WORDS) {
      if (!text.startsWith(word, at)) continue;
      at += word.length;
      return value;
    }
    return readNumber();
  }

  const value = readValue();
  skipSpaces();
  if (at < text.length) fail();
  return value;
}

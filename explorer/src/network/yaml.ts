/**
 * YAML as plain lists, tables and texts, as Python's `_yaml_tree` reads it.
 *
 * All scalars stay texts, tags have no meaning, an alias is the value that it names, and tables keep the order of their
 * keys.
 */
import { EVENT_ID, getScalarValue, parseEvents, SCALAR_STYLE, YAMLException, type Event } from "js-yaml";
import { check, FileError } from "./errors";
import { hasIndentingTab, relaxed } from "./yaml11";

export type Tree = string | readonly Tree[] | Table;
export type Table = ReadonlyMap<string, Tree>;

export const isTable = (value: Tree | undefined): value is Table => value instanceof Map;
export const isList = (value: Tree | undefined): value is readonly Tree[] => Array.isArray(value);

const DEEPEST = 64;
const MOST_VALUES = 5 * 2 ** 18;
const MOST_DIRECTIVES = 16;
const TOO_DEEP = `expected YAML nested up to ${DEEPEST} levels deep, got more`;
const TOO_LONG = `expected YAML of at most ${MOST_VALUES.toLocaleString("en")} values, got more`;
/** The key of tables whose keys the table has too, unless it has its own. */
const MERGE = "<<";
const DIRECTIVE = /(?:^|\n)%TAG\b/g;

/** The characters that YAML 1.1 forbids. */
const FORBIDDEN = /[^\t\n\r\x20-\x7e\x85\xa0-\ud7ff\ue000-\ufffd\u{10000}-\u{10ffff}]/u;
/** What ends a line in YAML 1.1. */
const BREAKS = /\r\n?|[\x85\u2028\u2029]/g;
/** A surrogate as an escape, such as "\ud800". */
const HALF_OF_A_PAIR = /(?:^|[^\\])(?:\\\\)*\\u[dD][89a-fA-F]/;

/** A list or a table that is being read. The keys and values of a table take turns. */
interface Opened {
  readonly items: Tree[];
  readonly table: Map<string, Tree> | null;
}

/** Reads a YAML document; returns null for an empty one. Throws a `FileError` that says what is wrong. */
export function yamlTree(text: string): Tree | null {
  check(!FORBIDDEN.test(text), "expected readable YAML, got a character that YAML does not allow");
  const source = text.replace(BREAKS, "\n");
  const directives = source.match(DIRECTIVE)?.length ?? 0;
  check(directives < MOST_DIRECTIVES, `expected readable YAML, got ${MOST_DIRECTIVES} directives and more`);
  if (hasIndentingTab(source)) relaxed(source); // throws if the tab is not within brackets or quotes
  const parsed = parse(source);
  if (!(parsed instanceof YAMLException)) return build(parsed, source);
  const changed = relaxed(source);
  const again = parse(changed);
  if (again instanceof YAMLException) throw new FileError(`expected readable YAML, got ${parsed.reason}`);
  return build(again, changed);
}

/** Returns the events of a text, or why it is not YAML 1.2. */
function parse(source: string): Event[] | YAMLException {
  try {
    return parseEvents(source, { maxDepth: 2 * DEEPEST });
  } catch (error) {
    if (error instanceof YAMLException) return error;
    throw error;
  }
}

function build(events: readonly Event[], source: string): Tree | null {
  const documents: Tree[] = [];
  const anchors = new Map<string, Tree>();
  const opened: Opened[] = [{ items: documents, table: null }];
  let count = 0;
  for (const event of events) {
    if (event.type === EVENT_ID.DOCUMENT) continue;
    if (event.type === EVENT_ID.POP) {
      // The end of a document closes nothing.
      if (opened.length === 1) continue;
      const { items, table } = opened.pop()!;
      // A table that is not filled yet contains this one.
      const unfilled = [...opened.map((outer) => outer.table), table];
      if (table) count += fill(table, items, unfilled);
      check(count <= MOST_VALUES, TOO_LONG);
      continue;
    }
    const anchor = event.anchorStart < 0 ? null : source.slice(event.anchorStart, event.anchorEnd);
    const nested = nestedOf(event);
    const value = nested ? (nested.table ?? nested.items) : leafOf(event, anchor, anchors, source);
    check(!documents.length || opened.length > 1, "expected readable YAML of one document, got several");
    check(++count <= MOST_VALUES, TOO_LONG);
    opened[opened.length - 1].items.push(value);
    if (anchor !== null) anchors.set(anchor, value);
    if (nested) opened.push(nested);
    check(opened.length <= DEEPEST + 1, TOO_DEEP);
  }
  return documents[0] ?? null;
}

function nestedOf({ type }: Event): Opened | null {
  if (type === EVENT_ID.SEQUENCE) return { items: [], table: null };
  return type === EVENT_ID.MAPPING ? { items: [], table: new Map() } : null;
}

/** Returns a scalar's text, or the value that an alias names. */
function leafOf(event: Event, anchor: string | null, anchors: ReadonlyMap<string, Tree>, source: string): Tree {
  if (event.type === EVENT_ID.SCALAR) {
    const isEscaped = event.style === SCALAR_STYLE.DOUBLE_QUOTED && !event.fast;
    const hasHalf = isEscaped && HALF_OF_A_PAIR.test(source.slice(event.valueStart, event.valueEnd));
    check(!hasHalf, "expected readable YAML, got an escape of half a character");
    return getScalarValue(source, event);
  }
  const value = anchors.get(anchor!);
  check(value !== undefined, `expected readable YAML, got an alias of nothing, *${anchor!.slice(0, 40)}`);
  return value!;
}

/** Adds keys and values to a table; returns the number of keys of merged tables. */
function fill(table: Map<string, Tree>, items: readonly Tree[], unfilled: readonly (Table | null)[]): number {
  for (let index = 0; index < items.length; index += 2) {
    const key = items[index];
    check(typeof key === "string", "expected readable YAML, its keys texts, got another key");
    check(!table.has(key as string), `YAML: expected each key once, got ${(key as string).slice(0, 40)} twice`);
    table.set(key as string, items[index + 1]);
  }
  const value = table.get(MERGE);
  if (value === undefined) return 0;
  table.delete(MERGE);
  let merged = 0;
  for (const other of isList(value) ? value : [value]) {
    if (!isTable(other) || unfilled.includes(other)) {
      throw new FileError(`expected readable YAML, for the key ${MERGE} a table or a list of tables`);
    }
    for (const [name, item] of other) if (!table.has(name)) table.set(name, item);
    merged += other.size;
  }
  return merged;
}

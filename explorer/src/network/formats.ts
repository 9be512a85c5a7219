/** Map files: `map.json`, rows for `--fix`, and Duckietown's YAML. */
import { mapFromDuckietown } from "./duckietown";
import { FileError } from "./errors";
import { mapFromJson, type MapContent } from "./mapFile";
import type { ObjectKinds } from "./objects";

export { fromDuckietown, stubs, toDuckietown } from "./duckietown";
export { toFix, toMapJson, type MapContent } from "./mapFile";

const IS_YAML = /[^/]\.ya?ml$/i;

/** Reads a file's text. Files `.yaml` and `.yml` are maps of Duckietown, all others are JSON. Messages name the file. */
export function readMap(text: string, name: string, kinds: ObjectKinds): MapContent {
  try {
    if (IS_YAML.test(name)) return { ...mapFromDuckietown(text, kinds), fixed: null, maps: 1 };
    return mapFromJson(text, kinds);
  } catch (error) {
    if (!(error instanceof FileError)) throw error;
    throw new FileError(`${name}: ${error.message}`);
  }
}

/** Files that the page saves and opens. */
import { FileError } from "./network/errors";
import { readMap, type MapContent } from "./network/formats";
import type { ObjectKinds } from "./network/objects";

const MOST_MIB = 64; // as `read_maps`; a drawn map of 1024 x 1024 tiles has 22 MB

/** Reads the first of the files that were dropped or picked. */
export async function readMapFile(files: ArrayLike<File>, kinds: ObjectKinds): Promise<MapContent> {
  if (!files.length) throw new FileError("A map.json or a Duckietown map can be dropped here");
  const file = files[0];
  if (file.size > MOST_MIB * 2 ** 20) throw new FileError(`${file.name}: expected at most ${MOST_MIB} MiB`);
  return readMap(textOf(await file.arrayBuffer(), file.name), file.name, kinds);
}

/** Decodes UTF-8 without a byte order mark. Other bytes are refused, as in Python. */
export function textOf(bytes: ArrayBuffer | Uint8Array<ArrayBuffer>, name: string): string {
  try {
    return new TextDecoder("utf-8", { fatal: true }).decode(bytes);
  } catch {
    throw new FileError(`${name}: expected a text file in UTF-8`);
  }
}

/** Lets the browser save a file. */
export function save(name: string, content: string | Blob, type = "text/plain"): void {
  const blob = typeof content === "string" ? new Blob([content], { type }) : content;
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

export async function savePng(name: string, canvas: HTMLCanvasElement): Promise<void> {
  const blob = await new Promise<Blob | null>((done) => canvas.toBlob(done, "image/png"));
  if (blob) save(name, blob);
}

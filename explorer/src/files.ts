/** Files that the page saves and opens. */
import { FileError } from "./network/errors";
import { readMap, type MapContent } from "./network/formats";
import type { ObjectKinds } from "./network/objects";

const MOST_BYTES = 8 * 2 ** 20; // a map file of 1024 x 1024 tiles has 3 MB

/** Reads the first of the files that were dropped or picked. */
export async function readMapFile(files: ArrayLike<File>, kinds: ObjectKinds): Promise<MapContent> {
  if (!files.length) throw new FileError("A map.json or a Duckietown map can be dropped here");
  const file = files[0];
  if (file.size > MOST_BYTES) throw new FileError(`${file.name}: expected at most 8 MiB`);
  return readMap(await file.text(), file.name, kinds);
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

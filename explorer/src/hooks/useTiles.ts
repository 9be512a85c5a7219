import { useEffect, useState } from "preact/hooks";
import type { Data } from "../data";
import { loadTiles, type TilePictures } from "../tiles";

/** Returns the decoded tile pictures, or null until they are decoded. */
export function useTiles(data: Data, say: (text: string) => void): TilePictures | null {
  const [tiles, setTiles] = useState<TilePictures | null>(null);
  useEffect(() => {
    loadTiles(data).then(setTiles, () => say("The tile pictures cannot be shown"));
  }, [data, say]);
  return tiles;
}

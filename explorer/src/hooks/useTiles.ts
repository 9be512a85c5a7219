import { useEffect, useState } from "preact/hooks";
import type { TileValues } from "../data";
import { loadTiles, type TilePictures } from "../tiles";

/** Returns the decoded tile pictures, or null until they are decoded. */
export function useTiles(values: TileValues, say: (text: string) => void): TilePictures | null {
  const [tiles, setTiles] = useState<TilePictures | null>(null);
  useEffect(() => {
    loadTiles(values).then(setTiles, () => say("The tile pictures cannot be shown"));
  }, [values, say]);
  return tiles;
}

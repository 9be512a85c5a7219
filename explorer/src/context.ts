/** The values that all parts of the page share. */
import { createContext } from "preact";
import { useContext } from "preact/hooks";
import type { Data, Run } from "./data";
import type { Grid } from "./network/codes";
import type { MapObject } from "./network/objects";
import type { View } from "./state";
import type { TilePictures } from "./tiles";

export interface Shared {
  readonly data: Data;
  readonly view: View;
  readonly run: Run;
  readonly tiles: TilePictures | null;
  readonly dark: boolean;
  /** Changes fields of the view. */
  readonly show: (change: Partial<View>) => void;
  /** Opens a map in the editor. */
  readonly draw: (grid: Grid, objects: readonly MapObject[]) => void;
  /** Announces a message to screen readers and, unless it is `unseen`, shows it for some seconds. */
  readonly say: (message: string, unseen?: boolean) => void;
}

export const SharedContext = createContext<Shared | null>(null);

export function useShared(): Shared {
  return useContext(SharedContext)!;
}

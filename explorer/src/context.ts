/** What all parts of the page share. */
import { createContext } from "preact";
import { useContext } from "preact/hooks";
import type { Data, Run } from "./data";
import type { Grid } from "./network/codes";
import type { View } from "./state";
import type { TilePictures } from "./tiles";

export interface Shared {
  readonly data: Data;
  readonly view: View;
  readonly run: Run;
  readonly tiles: TilePictures | null;
  readonly dark: boolean;
  /** Changes what is shown. */
  readonly show: (change: Partial<View>) => void;
  /** Opens a map in the editor. */
  readonly draw: (grid: Grid) => void;
  /** Tells a reader of the screen, and, unless it is for those alone, shows for a moment. */
  readonly say: (message: string, unseen?: boolean) => void;
}

export const SharedContext = createContext<Shared | null>(null);

export function useShared(): Shared {
  return useContext(SharedContext)!;
}

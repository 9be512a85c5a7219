import { useCallback, useState } from "preact/hooks";
import { editorOf, type Editor } from "../editor";
import { readMapFile } from "../files";
import { rowsOf, type Grid } from "../network/codes";
import { FileError } from "../network/formats";
import type { View } from "../state";

interface Callbacks {
  /** Receives the rows of the map after each change. */
  readonly onGrid?: (rows: number[][]) => void;
  readonly show: (change: Partial<View>) => void;
  readonly say: (text: string) => void;
}

interface Drawing {
  /** Null until a map was drawn or opened. */
  readonly editor: Editor | null;
  readonly edit: (editor: Editor) => void;
  /** Opens a map in the editor. */
  readonly draw: (grid: Grid) => void;
  /** Opens the first file in the editor, or says why it cannot be read. */
  readonly openFiles: (files: ArrayLike<File>) => void;
}

/** Returns the map that is drawn and the functions that change it. */
export function useDrawing({ onGrid, show, say }: Callbacks): Drawing {
  const [editor, setEditor] = useState<Editor | null>(null);
  const edit = useCallback(
    (next: Editor) => {
      setEditor(next);
      onGrid?.(rowsOf(next.grid));
    },
    [onGrid],
  );
  const open = useCallback(
    (next: Editor) => {
      edit(next);
      show({ view: "draw" });
    },
    [edit, show],
  );
  const draw = useCallback((grid: Grid) => open(editorOf(grid)), [open]);
  const openFiles = async (files: ArrayLike<File>) => {
    try {
      const { grid, fixed } = await readMapFile(files);
      open(editorOf(grid, fixed ?? undefined));
      const others = files.length > 1 ? `; the first of ${files.length} files` : "";
      say(`${files[0].name}: ${grid.height} × ${grid.width} tiles${others}`);
    } catch (error) {
      say(error instanceof FileError ? error.message : `${files[0].name}: cannot be read`);
    }
  };
  return { editor, edit, draw, openFiles: (files) => void openFiles(files) };
}

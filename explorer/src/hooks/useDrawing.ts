import { useCallback, useState } from "preact/hooks";
import { editorOf, type Editor } from "../editor";
import { readMapFile } from "../files";
import { rowsOf, type Grid } from "../network/codes";
import { FileError } from "../network/errors";
import type { MapObject, ObjectKinds } from "../network/objects";
import type { View } from "../state";

const LARGE = 2 ** 20; // bytes of a file that takes a while

interface Callbacks {
  readonly kinds: ObjectKinds;
  /** Receives the rows and the objects of the map after each change. */
  readonly onMap?: (rows: number[][], objects: readonly MapObject[]) => void;
  readonly show: (change: Partial<View>) => void;
  readonly say: (text: string) => void;
}

interface Drawing {
  /** Null until a map was drawn or opened. */
  readonly editor: Editor | null;
  readonly edit: (editor: Editor) => void;
  /** Opens a map in the editor. */
  readonly draw: (grid: Grid, objects: readonly MapObject[]) => void;
  /** Opens the first file in the editor, or says why it cannot be read. */
  readonly openFiles: (files: ArrayLike<File>) => void;
}

/** Returns the map that is drawn and the functions that change it. */
export function useDrawing({ kinds, onMap, show, say }: Callbacks): Drawing {
  const [editor, setEditor] = useState<Editor | null>(null);
  const edit = useCallback(
    (next: Editor) => {
      setEditor(next);
      onMap?.(rowsOf(next.grid), next.objects);
    },
    [onMap],
  );
  const open = useCallback(
    (next: Editor) => {
      edit(next);
      show({ view: "draw" });
    },
    [edit, show],
  );
  const draw = useCallback<Drawing["draw"]>((grid, objects) => open(editorOf(grid, objects)), [open]);
  const openFiles = async (list: ArrayLike<File>) => {
    const files = Array.from(list); // a picker's list is emptied meanwhile
    try {
      if (files[0]?.size > LARGE) {
        say(`Reading ${files[0].name}`);
        await new Promise((done) => setTimeout(done, 50)); // so that the message is shown before the page is busy
      }
      const { grid, fixed, objects, maps } = await readMapFile(files, kinds);
      open(editorOf(grid, objects, fixed ?? undefined));
      const first = maps > 1 ? `; the first of ${maps} maps` : "";
      const others = files.length > 1 ? `; the first of ${files.length} files` : "";
      say(`${files[0].name}: ${grid.height} × ${grid.width} tiles${first}${others}`);
    } catch (error) {
      say(error instanceof FileError ? error.message : `${files[0].name}: cannot be read`);
    }
  };
  return { editor, edit, draw, openFiles: (files) => void openFiles(files) };
}

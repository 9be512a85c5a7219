import { useState } from "preact/hooks";
import { done, type Editor } from "../editor";
import { FileError } from "../network/errors";
import { moveObject, nextObject, objectAt, type MapObject, type ObjectKinds } from "../network/objects";
import { describeObject } from "../words";

type Position = readonly [x: number, y: number];

interface Drag {
  readonly before: Editor;
  /** From the pointer to the object. */
  readonly offset: Position;
}

interface ObjectTool {
  readonly selected: MapObject | undefined;
  /** The editor before the drag of the moment, or null. */
  readonly before: Editor | null;
  readonly down: (position: Position) => void;
  readonly move: (position: Position) => void;
  readonly up: () => void;
  /** Selects, moves or deletes an object. `step` is the step of an arrow key, or null. */
  readonly press: (event: KeyboardEvent, step: Position | null) => void;
}

/** Returns the object that is selected in the editor, and what pointer and keys do with it. Positions are in tiles. */
export function useObjectTool(
  editor: Editor,
  onEdit: (editor: Editor) => void,
  kinds: ObjectKinds,
  say: (text: string, unseen?: boolean) => void,
): ObjectTool {
  const [index, setIndex] = useState(-1);
  const [drag, setDrag] = useState<Drag | null>(null);
  const { objects } = editor;
  const selected: MapObject | undefined = objects[index];
  const place = (before: Editor, position: Position) => {
    try {
      const next = moveObject(before.objects, index, position, before.grid);
      onEdit(done(before, { ...before, objects: next }));
      say(describeObject(next[index]), true);
    } catch (error) {
      if (!(error instanceof FileError)) throw error;
      say(error.message);
    }
  };
  const press = (event: KeyboardEvent, step: Position | null) => {
    const deletes = event.key === "Delete" || event.key === "Backspace";
    if (!step && !deletes) return;
    event.preventDefault();
    if (step && event.shiftKey && selected) place(editor, [selected.x + step[0] / 20, selected.y + step[1] / 20]);
    else if (step) {
      const next = nextObject(objects, index, step[0] + step[1] > 0 ? 1 : -1);
      setIndex(next);
      if (next >= 0) say(describeObject(objects[next]), true);
    } else if (selected) {
      onEdit(done(editor, { ...editor, objects: objects.filter((thing) => thing !== selected) }));
      setIndex(-1);
      say(`Deleted: ${describeObject(selected)}`);
    }
  };
  return {
    selected,
    before: drag?.before ?? null,
    down: ([x, y]) => {
      const found = objectAt(objects, kinds, x, y);
      setIndex(found);
      if (found >= 0) setDrag({ before: editor, offset: [objects[found].x - x, objects[found].y - y] });
    },
    move: ([x, y]) => drag && place(drag.before, [x + drag.offset[0], y + drag.offset[1]]),
    up: () => setDrag(null),
    press,
  };
}

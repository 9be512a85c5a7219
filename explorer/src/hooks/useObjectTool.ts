import { useState } from "preact/hooks";
import { useShared } from "../context";
import { done, type Editor } from "../editor";
import { FileError } from "../network/errors";
import {
  checkObject,
  degreesOf,
  hundredths,
  newObject,
  nextObject,
  objectAt,
  radiansOf,
  type MapObject,
  type Position,
} from "../network/objects";
import { describeObject } from "../words";

interface Drag {
  readonly before: Editor;
  /** The object that is moved, or null if the drag adds one. */
  readonly old: MapObject | null;
  readonly thing: MapObject;
  /** From the pointer to the object. */
  readonly offset: Position;
}

export interface ObjectTool {
  readonly selected: MapObject | undefined;
  /** The kind of the objects that are added. */
  readonly kind: string;
  readonly setKind: (kind: string) => void;
  /** Changes fields of the selected object. Says what is wrong with them and returns false if they are refused. */
  readonly change: (fields: { readonly [name in keyof MapObject]?: MapObject[name] | undefined }) => boolean;
  readonly remove: () => void;
  /** The editor before the drag of the moment, or null. */
  readonly before: Editor | null;
  readonly down: (position: Position) => void;
  readonly move: (position: Position) => void;
  readonly up: () => void;
  /** Obeys a key. `step` is the step of an arrow key, or null. */
  readonly press: (event: KeyboardEvent, step: Position | null) => void;
}

/** Returns the object that is selected in the editor, and what pointer, keys and fields do with objects. */
export function useObjectTool(editor: Editor, onEdit: (editor: Editor) => void): ObjectTool {
  const { data, say } = useShared();
  const { kinds, tags } = data.objects;
  const { objects, grid } = editor;
  const [kind, setKind] = useState(Object.keys(kinds)[0]);
  const [chosen, choose] = useState<MapObject | undefined>();
  const [drag, setDrag] = useState<Drag | null>(null);
  const selected = chosen && objects.includes(chosen) ? chosen : undefined;
  const put = (before: Editor, old: MapObject | null, next: object): boolean => {
    try {
      const thing = checkObject(next, kinds, before.grid);
      const others = old ? before.objects.map((one) => (one === old ? thing : one)) : [...before.objects, thing];
      onEdit(done(before, { ...before, objects: others }));
      choose(thing);
      say(describeObject(thing), true);
      return true;
    } catch (error) {
      if (!(error instanceof FileError)) throw error;
      say(error.message);
      return false;
    }
  };
  const placed = (thing: MapObject, [x, y]: Position): MapObject => ({ ...thing, x: hundredths(x), y: hundredths(y) });
  const change: ObjectTool["change"] = (fields) => !!selected && put(editor, selected, { ...selected, ...fields });
  const remove = () => {
    if (!selected) return;
    onEdit(done(editor, { ...editor, objects: objects.filter((thing) => thing !== selected) }));
    say(`Deleted: ${describeObject(selected)}`);
  };
  const down = (position: Position) => {
    const found = objectAt(objects, kinds, position);
    const thing = found ?? placed(newObject(kind, position, objects, kinds, tags), position);
    if (found) choose(found);
    else if (!put(editor, null, thing)) return;
    setDrag({ before: editor, old: found ?? null, thing, offset: [thing.x - position[0], thing.y - position[1]] });
  };
  const press = (event: KeyboardEvent, step: Position | null) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (step && event.shiftKey) {
      if (selected) change(placed(selected, [selected.x + step[0] / 20, selected.y + step[1] / 20]));
    } else if (step) {
      const next = nextObject(objects, selected, step[0] + step[1] > 0 ? 1 : -1);
      choose(next);
      if (next) say(describeObject(next), true);
    } else if (event.key === "Enter" || event.key === " ") {
      const { x, y } = selected ?? { x: grid.width / 2, y: grid.height / 2 };
      put(editor, null, newObject(kind, [Math.min(x + (selected ? 0.25 : 0), grid.width), y], objects, kinds, tags));
    } else if (event.key.toLowerCase() === "r") {
      if (selected) change({ angle: radiansOf(degreesOf(selected.angle) + (event.shiftKey ? -15 : 15)) });
    } else if (event.key === "Delete" || event.key === "Backspace") remove();
    else return;
    event.preventDefault();
  };
  return {
    selected,
    kind,
    setKind,
    change,
    remove,
    before: drag?.before ?? null,
    down,
    move: ([x, y]) =>
      drag && void put(drag.before, drag.old, placed(drag.thing, [x + drag.offset[0], y + drag.offset[1]])),
    up: () => setDrag(null),
    press,
  };
}

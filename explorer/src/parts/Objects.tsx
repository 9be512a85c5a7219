/** The kinds of objects on a map: the colour, the name and the number of each. */
import { objectColour } from "../colours";
import { byKind, type MapObject } from "../network/objects";
import { objectName } from "../words";

export function Objects({ objects }: { readonly objects: readonly MapObject[] }) {
  if (!objects.length) return null;
  return (
    <ul class="key objects" aria-label="Objects on the map">
      {byKind(objects).map(([kind, some]) => (
        <li key={kind}>
          <i style={{ background: objectColour(kind) }} />
          {objectName(kind)} <b>{some.length}</b>
        </li>
      ))}
    </ul>
  );
}

/** A warning that the signs of a map do not fit its roads. */
import { useMemo } from "preact/hooks";
import { useShared } from "../context";
import type { Grid } from "../network/codes";
import type { MapObject } from "../network/objects";
import { placeSigns, signFaults, type SignFaults } from "../network/signs";
import { counted } from "../words";

interface Props {
  readonly grid: Grid;
  readonly objects: readonly MapObject[];
  /** Receives the objects after the signs were placed again. Without it the note has no button. */
  readonly onObjects?: (objects: readonly MapObject[]) => void;
}

export function SignNote({ grid, objects, onObjects }: Props) {
  const { data, say } = useShared();
  const faults = useMemo(() => signFaults(grid, objects, data.objects), [grid, objects, data]);
  if (!faults) return null;
  const place = () => {
    const placed = placeSigns(grid, objects, data.objects);
    onObjects!(placed.objects);
    const inTheWay = placed.inTheWay ? `; ${counted(placed.inTheWay, "object is", "objects are")} in the way` : "";
    const room = placed.withoutRoom ? `; ${wordsForRoom(placed.withoutRoom)}` : "";
    say(`Signs placed again${room}${inTheWay}`);
  };
  // Signs cannot be placed at a crossing that has no room for them.
  const canPlace = faults.crossings + faults.streets + faults.wrong > 0;
  return (
    <div class="warning" role="group" aria-label="Signs">
      <p>Signs do not fit the roads: {wordsFor(faults)}.</p>
      {onObjects && canPlace && (
        <button type="button" onClick={place}>
          Place them again
        </button>
      )}
    </div>
  );
}

function wordsFor({ crossings, streets, withoutRoom, wrong }: SignFaults): string {
  const parts = [
    wrong && `${counted(wrong, "sign is", "signs are")} out of place`,
    crossings && `${counted(crossings, "crossing lacks", "crossings lack")} signs`,
    streets && `${counted(streets, "road or turn has", "roads or turns have")} no name`,
    withoutRoom && wordsForRoom(withoutRoom),
  ];
  return parts.filter(Boolean).join(", ");
}

const wordsForRoom = (crossings: number): string =>
  `${counted(crossings, "crossing has", "crossings have")} no room for signs, because a road is at a corner`;

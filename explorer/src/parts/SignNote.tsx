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
    say(`Signs placed again${inTheWay}`);
  };
  return (
    <div class="warning" role="group" aria-label="Signs">
      <p>Signs do not fit the roads: {wordsFor(faults)}.</p>
      {onObjects && (
        <button type="button" onClick={place}>
          Place them again
        </button>
      )}
    </div>
  );
}

function wordsFor({ crossings, streets, wrong }: SignFaults): string {
  const parts = [
    wrong && `${counted(wrong, "sign is", "signs are")} out of place`,
    crossings && `${counted(crossings, "crossing has", "crossings have")} none`,
    streets && `${counted(streets, "road or turn has", "roads or turns have")} no name`,
  ];
  return parts.filter(Boolean).join(", ");
}

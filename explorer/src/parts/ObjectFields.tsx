/** The kind of the objects that are added, and the fields of the selected object. */
import { useShared } from "../context";
import type { ObjectTool } from "../hooks/useObjectTool";
import { degreesOf, hundredths, radiansOf } from "../network/objects";
import { objectName } from "../words";
import { Choice } from "./Controls";

const FIELDS = [
  ["x", "X", 0.05, "tiles east of the map's north-west corner"],
  ["y", "Y", 0.05, "tiles south of the map's north-west corner"],
  ["angle", "Angle", 15, "degrees counter-clockwise from east; the printed side of a sign faces this direction"],
  ["height", "Height", 0.01, "metres"],
  ["tag", "Tag", 1, "the number of its AprilTag, or empty"],
] as const;

export function ObjectFields({ tool: { selected, kind, setKind, change, remove } }: { readonly tool: ObjectTool }) {
  const { kinds } = useShared().data.objects;
  return (
    <div class="bar fields" role="group" aria-label="Object">
      <Choice
        label="Kind to add"
        value={kind}
        options={Object.keys(kinds).map((one) => [one, objectName(one)])}
        onChange={setKind}
      />
      {FIELDS.map(([name, word, step, unit]) => {
        const [value, isAngle] = [selected?.[name], name === "angle"];
        const shown = value === undefined ? "" : `${isAngle ? degreesOf(value) : hundredths(value)}`;
        return (
          <label key={name} class="size" title={unit}>
            {word}{" "}
            <input
              type="number"
              step={step}
              disabled={!selected}
              value={shown}
              onChange={({ currentTarget: input }) => {
                const typed = input.value === "" ? undefined : input.valueAsNumber;
                const next = isAngle && typed !== undefined ? radiansOf(typed) : typed;
                if (!change({ [name]: next })) input.value = shown;
              }}
            />
          </label>
        );
      })}
      <button type="button" disabled={!selected} onClick={remove}>
        Delete
      </button>
    </div>
  );
}

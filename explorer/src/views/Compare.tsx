/** Up to four maps side by side. */
import { useShared } from "../context";
import { FEATURES } from "../network/features";
import { LookSwitches, OverlaySwitches, useBlend } from "../parts/Looks";
import { framed, type Frame } from "../parts/canvas";
import { MapPicture, pictureEdge } from "../parts/MapPicture";
import { objectsOf, picturesOf } from "../record";
import { openRun } from "../state";
import { nameOf, valueText, WORDS } from "../words";

/** Returns the smallest size that holds all sizes. */
const frameOf = (sizes: readonly Frame[]): Frame => ({
  height: Math.max(...sizes.map(({ height }) => height)),
  width: Math.max(...sizes.map(({ width }) => width)),
});

/** The maps have one scale: a tile is as wide in each of them. */
export function Compare() {
  const { data, view, show, draw } = useShared();
  const blend = useBlend();
  if (!view.pins.length) {
    return (
      <section class="panel empty">
        <h2>Nothing to compare yet</h2>
        <p>Open a map in the archive or among the maps, and press Compare. Up to four stand here side by side.</p>
      </section>
    );
  }
  const maps = view.pins.map(([index, elite]) => ({ index, elite, run: data.runs[index] }));
  const frame = frameOf(
    maps.map(({ run, elite }) => {
      const grid = run.grid(elite);
      return framed(grid, pictureEdge(grid, objectsOf(run, elite), view.look));
    }),
  );
  const features = new Set(maps.flatMap(({ run }) => [...run.features.keys()]));
  const rows = ["fitness", ...FEATURES, ...features].map((name) => {
    const values = maps.map(({ run, elite }) => (run.quantities.includes(name) ? run.column(name)[elite] : NaN));
    return { name, values, differs: new Set(values).size > 1 };
  });
  return (
    <section class="panel" aria-label="Maps side by side">
      <div class="bar">
        <LookSwitches />
        <OverlaySwitches />
      </div>
      <div class="scroll" tabIndex={0} role="region" aria-label="Table of the maps">
        <table class="compare" style={{ "--maps": maps.length }}>
          <thead>
            <tr>
              <td />
              {maps.map(({ run, elite, index }) => (
                <th key={`${index}.${elite}`} scope="col">
                  <MapPicture
                    grid={run.grid(elite)}
                    label={`${run.name}, ${run.label(elite)}`}
                    pictures={picturesOf(run, elite)}
                    objects={objectsOf(run, elite)}
                    look={view.look}
                    blend={blend}
                    overlays={view.overlays}
                    frame={frame}
                  />
                  <span>
                    {data.runs.length > 1 && `${run.name}: `}
                    {run.label(elite)}
                  </span>
                  <span class="buttons">
                    <button type="button" onClick={() => show({ view: "archive", ...openRun(view, index, elite) })}>
                      Open
                    </button>
                    <button type="button" onClick={() => draw(run.grid(elite), objectsOf(run, elite))}>
                      Edit
                    </button>
                    <button
                      type="button"
                      aria-label={`Take out ${run.label(elite)}`}
                      title="Take out"
                      onClick={() =>
                        show({ pins: view.pins.filter(([one, other]) => one !== index || other !== elite) })
                      }
                    >
                      ×
                    </button>
                  </span>
                </th>
              ))}
            </tr>
          </thead>
          <tbody>
            {rows.map(({ name, values, differs }) => (
              <tr key={name} class={differs ? "" : "same"} title={WORDS[name]?.meaning}>
                <th scope="row">{nameOf(name)}</th>
                {values.map((value, index) => (
                  <td key={index}>{valueText(name, value)}</td>
                ))}
              </tr>
            ))}
          </tbody>
        </table>
      </div>
    </section>
  );
}

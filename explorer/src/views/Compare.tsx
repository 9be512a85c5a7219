/** Up to four maps side by side. */
import { useShared } from "../context";
import { FEATURES } from "../network/features";
import { LookSwitches, blendOf, OVERLAY_NAMES } from "../parts/Detail";
import { Switch, toggled } from "../parts/Controls";
import { MapPicture } from "../parts/MapPicture";
import { OVERLAY_COLOURS, OVERLAYS } from "../drawing";
import { picturesOf } from "../record";
import { nameOf, valueText, WORDS } from "../words";

export function Compare() {
  const { data, view, show, draw } = useShared();
  if (!view.pins.length) {
    return (
      <section class="panel empty">
        <h2>Nothing to compare yet</h2>
        <p>Open a map in the archive or among the maps, and press Compare. Up to four stand here side by side.</p>
      </section>
    );
  }
  const maps = view.pins.map(([place, elite]) => ({ place, elite, run: data.runs[place] }));
  const extras = new Set(maps.flatMap(({ run }) => [...run.extras.keys()]));
  const rows = ["fitness", ...FEATURES, ...extras].map((name) => {
    const values = maps.map(({ run, elite }) => (run.quantities.includes(name) ? run.column(name)[elite] : NaN));
    return { name, values, differs: new Set(values).size > 1 };
  });
  return (
    <section class="panel" aria-label="Maps side by side">
      <div class="bar">
        <LookSwitches />
        <div class="switches" role="group" aria-label="Laid over the maps">
          {OVERLAYS.map((overlay) => (
            <Switch key={overlay} on={view.overlays.includes(overlay)} colour={OVERLAY_COLOURS[overlay]} onChange={(on) => show({ overlays: toggled(view.overlays, overlay, on) })}>
              {OVERLAY_NAMES[overlay]}
            </Switch>
          ))}
        </div>
      </div>
      <div class="scroll" tabIndex={0} role="region" aria-label="Table of the maps">
        <table class="compare" style={{ "--maps": maps.length }}>
          <thead>
            <tr>
              <td />
              {maps.map(({ run, elite, place }) => (
                <th key={`${place}.${elite}`} scope="col">
                  <MapPicture grid={run.grid(elite)} label={`${run.name}, ${run.label(elite)}`} pictures={picturesOf(run, elite)} look={view.look} blend={blendOf(view)} overlays={view.overlays} />
                  <span>{data.runs.length > 1 && `${run.name}: `}{run.label(elite)}</span>
                  <span class="buttons">
                    <button type="button" onClick={() => show({ view: "archive", run: place, map: elite, niche: null })}>Open</button>
                    <button type="button" onClick={() => draw(run.grid(elite))}>Edit</button>
                    <button type="button" aria-label={`Take out ${run.label(elite)}`} title="Take out" onClick={() => show({ pins: view.pins.filter(([one, other]) => one !== place || other !== elite) })}>×</button>
                  </span>
                </th>
              ))}
            </tr>
          </thead>
          <tbody>
            {rows.map(({ name, values, differs }) => (
              <tr key={name} class={differs ? "" : "same"} title={WORDS[name]?.meaning}>
                <th scope="row">{nameOf(name)}</th>
                {values.map((value, place) => (
                  <td key={place}>{valueText(name, value)}</td>
                ))}
              </tr>
            ))}
          </tbody>
        </table>
      </div>
    </section>
  );
}

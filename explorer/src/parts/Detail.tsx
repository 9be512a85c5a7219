/** One map of a run: its picture, its metrics, files of it. */
import { useShared } from "../context";
import { feature } from "../network/features";
import { mapFields, objectsOf, picturesOf } from "../record";
import { number } from "../words";
import { LookSwitches, OverlaySwitches, useBlend } from "./Looks";
import { MapPicture } from "./MapPicture";
import { Metrics } from "./Metrics";
import { Objects } from "./Objects";
import { SaveButtons } from "./SaveButtons";
import { SignNote } from "./SignNote";

export function Detail({ elite }: { readonly elite: number }) {
  const { data, run, view, show, draw, say } = useShared();
  const blend = useBlend();
  const grid = run.grid(elite);
  const metrics = run.metricsOf(elite);
  const pictures = picturesOf(run, elite);
  const objects = objectsOf(run, elite);
  const floor = run.floor(elite);
  const name = run.label(elite).replace(/[^\w.-]+/g, "-");
  const pinned = view.pins.some(([number, pin]) => number === view.run && pin === elite);
  const pin = () => {
    if (pinned) show({ pins: view.pins.filter(([number, other]) => number !== view.run || other !== elite) });
    else if (view.pins.length >= 4) say("Four maps are compared already; take one out first");
    else {
      show({ pins: [...view.pins, [view.run, elite]] });
      say(`${view.pins.length + 1} of up to 4 maps to compare`);
    }
  };
  const features = Object.fromEntries([...run.features].map(([key, values]) => [key, values[elite]]));
  const label = `Map of ${run.height} by ${run.width} tiles, ${run.label(elite)}, fitness ${number(run.fitness[elite])}, cyclomatic number ${feature("cyclomatic", metrics)}`;
  return (
    <section class="detail" aria-label="The map">
      <header>
        <h2>{run.label(elite)}</h2>
        <p>
          {!run.label(elite).startsWith("niche") && `niche ${run.nicheName(run.niche[elite])} · `}
          {run.height} × {run.width} tiles · fitness <b>{number(run.fitness[elite])}</b>
          {floor !== undefined &&
            (run.fitness[elite] === floor
              ? " · the proven optimum"
              : ` · ${number(run.fitness[elite] - floor)} above the proven floor`)}
        </p>
      </header>
      <MapPicture
        grid={grid}
        label={label}
        pictures={pictures}
        objects={objects}
        look={view.look}
        blend={blend}
        overlays={view.overlays}
      />
      <SignNote grid={grid} objects={objects} />
      <Objects objects={objects} />
      <LookSwitches />
      <OverlaySwitches metrics={metrics} />
      <div class="buttons">
        <button type="button" onClick={() => draw(grid, objects)}>
          Edit
        </button>
        <button type="button" aria-pressed={pinned} onClick={pin}>
          {pinned ? "Compared" : "Compare"}
        </button>
        <SaveButtons
          name={name}
          grid={grid}
          objects={objects}
          fields={() => mapFields(run, elite, data)}
          pictures={pictures}
          blend={view.look === "tiles" ? blend : undefined}
        />
      </div>
      <Metrics
        run={run}
        grid={grid}
        metrics={metrics}
        fitness={run.fitness[elite]}
        above={floor === undefined ? undefined : run.fitness[elite] - floor}
        features={features}
      />
    </section>
  );
}

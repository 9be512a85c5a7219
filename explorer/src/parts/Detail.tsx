/** One map: its picture and layers, what is laid over it, its metrics, and files of it. */
import { useEffect, useMemo, useState } from "preact/hooks";
import { useShared } from "../context";
import { OVERLAY_COLOURS, OVERLAYS, sceneOf, toSvg, type Overlay } from "../drawing";
import { save, savePng } from "../files";
import { FileError, stubs, toDuckietown, toMapJson } from "../network/formats";
import { feature } from "../network/features";
import { LAYERS, paintTiles, type Blend, type Layer } from "../tiles";
import { number } from "../words";
import { mapFields, picturesOf } from "../record";
import { Segments, Switch, toggled } from "./Controls";
import { MapPicture } from "./MapPicture";
import { Metrics } from "./Metrics";
import { Rides, ridingShapes, type Playing } from "./Rides";
import type { View } from "../state";

const LAYER_NAMES: Readonly<Record<Layer, string>> = {
  image: "Picture",
  road: "Road",
  red: "Stop lines",
  yellow: "Lane lines",
  labels: "Labels",
};

export const OVERLAY_NAMES: Readonly<Record<Overlay, string>> = {
  bridges: "Bridges",
  adjacent_crossings: "Adjacent crossings",
  adjacent_turns: "Adjacent turns",
  dead_ends: "Dead ends",
  faces: "Faces",
};

const OVERLAY_NOTES: Readonly<Record<Overlay, string>> = {
  bridges: "A road is a bridge where the same face lies on both its sides.",
  adjacent_crossings: "Crossings that a road links, without a tile between.",
  adjacent_turns: "Turns side by side, linked or not.",
  dead_ends: "Tiles with one connection, or with one that nothing returns.",
  faces: "Areas that roads enclose: as many as the cyclomatic number. All the rest is the outer face.",
};

/** Returns how strongly each layer shows: the picture fully, all others as blended. */
export function blendOf(view: View): Blend {
  return Object.fromEntries(view.layers.map((layer) => [layer, layer === "image" ? 1 : view.blend]));
}

export function overlayCount(overlay: Overlay, counts: ArrayLike<number>): number {
  const value = feature(overlay === "faces" ? "cyclomatic" : overlay, counts);
  return overlay === "adjacent_crossings" ? value / 2 : value;
}

/** The switches of what is laid over a map. */
export function OverlaySwitches({ counts }: { readonly counts: ArrayLike<number> }) {
  const { view, show } = useShared();
  return (
    <>
      <div class="switches" role="group" aria-label="Laid over the map">
        {OVERLAYS.map((overlay) => (
          <Switch
            key={overlay}
            on={view.overlays.includes(overlay)}
            colour={OVERLAY_COLOURS[overlay]}
            count={overlayCount(overlay, counts)}
            title={OVERLAY_NOTES[overlay]}
            onChange={(on) => show({ overlays: toggled(view.overlays, overlay, on) })}
          >
            {OVERLAY_NAMES[overlay]}
          </Switch>
        ))}
      </div>
      {view.overlays.includes("faces") && <p class="note">{OVERLAY_NOTES.faces}</p>}
    </>
  );
}

/** The switches between lines and tile pictures, and of the pictures' layers. */
export function LookSwitches() {
  const { view, show } = useShared();
  const others = view.layers.some((layer) => layer !== "image");
  return (
    <div class="look">
      <Segments
        label="Look"
        value={view.look}
        options={[["lines", "Lines"], ["tiles", "Tiles"]] as const}
        onChange={(look) => show({ look })}
      />
      {view.look === "tiles" && (
        <div class="switches" role="group" aria-label="Layers of the tile pictures">
          {LAYERS.map((layer) => (
            <Switch key={layer} on={view.layers.includes(layer)} onChange={(on) => show({ layers: toggled(view.layers, layer, on) })}>
              {LAYER_NAMES[layer]}
            </Switch>
          ))}
        </div>
      )}
      {view.look === "tiles" && others && (
        <label class="slider">
          <span>Strength of the layers</span>
          <input
            type="range"
            min="0"
            max="1"
            step="0.05"
            value={view.blend}
            onInput={(event) => show({ blend: Number(event.currentTarget.value) })}
          />
        </label>
      )}
    </div>
  );
}

/** The panel of one map of a run. */
export function Detail({ elite }: { readonly elite: number }) {
  const { data, run, view, tiles, show, draw, say } = useShared();
  const [playing, setPlaying] = useState<Playing>({ ride: 0, step: 0 });
  useEffect(() => setPlaying({ ride: 0, step: 0 }), [run, elite]);
  const rides = useMemo(() => run.rides.filter((ride) => ride.place === elite), [run, elite]);
  const above = useMemo(() => ridingShapes(rides, playing), [rides, playing]);
  const grid = run.grid(elite);
  const counts = run.countsOf(elite);
  const pictures = picturesOf(run, elite);
  const floor = run.floor(elite);
  const name = run.label(elite).replace(/[^\w.-]+/g, "-");
  const pinned = view.pins.some(([place, pin]) => place === view.run && pin === elite);
  const saveYaml = () => {
    try {
      save(`${name}.yaml`, toDuckietown(grid));
    } catch (error) {
      if (!(error instanceof FileError)) throw error;
      say(error.message);
    }
  };
  const pin = () => {
    if (pinned) show({ pins: view.pins.filter(([place, other]) => place !== view.run || other !== elite) });
    else if (view.pins.length >= 4) say("Four maps are compared already; take one out first");
    else {
      show({ pins: [...view.pins, [view.run, elite]] });
      say(`${view.pins.length + 1} of up to 4 maps to compare`);
    }
  };
  const extras = Object.fromEntries([...run.extras].map(([key, values]) => [key, values[elite]]));
  const label = `Map of ${run.height} by ${run.width} tiles, ${run.label(elite)}, fitness ${number(run.fitness[elite])}, cyclomatic number ${feature("cyclomatic", counts)}`;
  return (
    <section class="detail" aria-label="The map">
      <header>
        <h2>{run.label(elite)}</h2>
        <p>
          {!run.label(elite).startsWith("niche") && `niche ${run.nicheName(run.niche[elite])} · `}{run.height} × {run.width} tiles · fitness <b>{number(run.fitness[elite])}</b>
          {floor !== undefined && (run.fitness[elite] === floor ? " · the proven optimum" : ` · ${number(run.fitness[elite] - floor)} above the proven floor`)}
        </p>
      </header>
      <MapPicture grid={grid} label={label} pictures={pictures} look={view.look} blend={blendOf(view)} overlays={view.overlays} above={above} />
      {rides.length > 0 && <Rides rides={rides} playing={playing} onPlay={setPlaying} />}
      <LookSwitches />
      <OverlaySwitches counts={counts} />
      <div class="buttons">
        <button type="button" onClick={() => draw(grid)}>Edit</button>
        <button type="button" aria-pressed={pinned} onClick={pin}>{pinned ? "Compared" : "Compare"}</button>
        <span class="saves" role="group" aria-label="Save">
          <span aria-hidden="true">Save</span>
          <button type="button" onClick={() => save(`${name}.json`, toMapJson(grid, mapFields(run, elite, data)), "application/json")}>map.json</button>
          <button type="button" onClick={saveYaml} title={stubs(grid) ? "Duckietown has no dead ends" : "for Duckietown's programs"}>YAML</button>
          <button type="button" onClick={() => save(`${name}.svg`, toSvg(sceneOf(grid, new Set(view.overlays))), "image/svg+xml")}>SVG</button>
          <button
            type="button"
            disabled={!tiles}
            onClick={() => void savePng(`${name}.png`, paintTiles(grid, data, tiles!, pictures, view.look === "tiles" ? blendOf(view) : { image: 1 }))}
          >
            PNG
          </button>
        </span>
      </div>
      <Metrics run={run} grid={grid} counts={counts} fitness={run.fitness[elite]} above={floor === undefined ? undefined : run.fitness[elite] - floor} extras={extras} />
    </section>
  );
}


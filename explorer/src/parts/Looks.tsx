/** The switches of how maps look: lines or tile pictures, layers, overlays. */
import { useMemo } from "preact/hooks";
import { useShared } from "../context";
import { OVERLAY_COLOURS, OVERLAYS, type Overlay } from "../drawing";
import { feature } from "../network/features";
import { LAYERS, type Blend, type Layer } from "../tiles";
import { Segments, Switch, toggled } from "./Controls";

const LAYER_NAMES: Readonly<Record<Layer, string>> = {
  image: "Picture",
  road: "Road",
  red: "Stop lines",
  yellow: "Lane lines",
  labels: "Labels",
};

const OVERLAY_NAMES: Readonly<Record<Overlay, string>> = {
  bridges: "Bridges",
  adjacent_crossings: "Adjacent crossings",
  adjacent_turns: "Adjacent turns",
  dead_ends: "Dead ends",
  shortest_loop: "Shortest loop",
  faces: "Faces",
};

const OVERLAY_NOTES: Readonly<Record<Overlay, string>> = {
  bridges: "A road is a bridge where the same face lies on both its sides.",
  adjacent_crossings: "Crossings that a road links, without a tile between.",
  adjacent_turns: "Turns side by side, linked or not.",
  dead_ends: "Tiles with one connection, or with one that nothing returns.",
  shortest_loop: "The fewest tiles on which robots can block each other for ever. The gridlock number is one less.",
  faces: "Areas that roads enclose: as many as the cyclomatic number. All the rest is the outer face.",
};

/** Returns how strongly each layer shows: the picture fully, all others as the view blends them. */
export function useBlend(): Blend {
  const { layers, blend } = useShared().view;
  return useMemo(
    () => Object.fromEntries(layers.map((layer) => [layer, layer === "image" ? 1 : blend])),
    [layers, blend],
  );
}

function overlayCount(overlay: Overlay, metrics: ArrayLike<number>): number | undefined {
  if (overlay === "shortest_loop") return undefined;
  const value = feature(overlay === "faces" ? "cyclomatic" : overlay, metrics);
  return overlay === "adjacent_crossings" ? value / 2 : value;
}

/** The switches of the overlays, with their counts if the metrics of one map are given. */
export function OverlaySwitches({ metrics }: { readonly metrics?: ArrayLike<number> }) {
  const { view, show } = useShared();
  return (
    <>
      <div class="switches" role="group" aria-label={metrics ? "Laid over the map" : "Laid over the maps"}>
        {OVERLAYS.map((overlay) => (
          <Switch
            key={overlay}
            on={view.overlays.includes(overlay)}
            colour={OVERLAY_COLOURS[overlay]}
            count={metrics && overlayCount(overlay, metrics)}
            title={OVERLAY_NOTES[overlay]}
            onChange={(on) => show({ overlays: toggled(view.overlays, overlay, on) })}
          >
            {OVERLAY_NAMES[overlay]}
          </Switch>
        ))}
      </div>
      {metrics && view.overlays.includes("faces") && <p class="note">{OVERLAY_NOTES.faces}</p>}
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
        options={
          [
            ["lines", "Lines"],
            ["tiles", "Tiles"],
          ] as const
        }
        onChange={(look) => show({ look })}
      />
      {view.look === "tiles" && (
        <div class="switches" role="group" aria-label="Layers of the tile pictures">
          {LAYERS.map((layer) => (
            <Switch
              key={layer}
              on={view.layers.includes(layer)}
              onChange={(on) => show({ layers: toggled(view.layers, layer, on) })}
            >
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

/** Colours: a scale that is uniform to the eye and clear to the colour-blind, and a few distinct ones. */

/** Viridis (van der Walt and Smith, 2015, CC0), in 17 steps. */
const VIRIDIS = [
  [68, 1, 84],
  [72, 20, 103],
  [71, 38, 117],
  [68, 55, 128],
  [62, 73, 137],
  [54, 90, 140],
  [47, 105, 141],
  [40, 120, 142],
  [34, 135, 141],
  [32, 150, 137],
  [41, 165, 130],
  [63, 180, 118],
  [96, 194, 101],
  [136, 205, 79],
  [181, 214, 52],
  [225, 220, 37],
  [253, 231, 37],
] as const;

export type Rgb = readonly [number, number, number];

/** Returns the colour of a position from 0 to 1. */
export function viridis(position: number): Rgb {
  const at = Math.min(Math.max(position, 0), 1) * (VIRIDIS.length - 1);
  const low = Math.min(Math.floor(at), VIRIDIS.length - 2);
  const [one, other] = [VIRIDIS[low], VIRIDIS[low + 1]];
  return [0, 1, 2].map((channel) =>
    Math.round(one[channel] + (other[channel] - one[channel]) * (at - low)),
  ) as unknown as Rgb;
}

export const css = ([red, green, blue]: Rgb): string => `rgb(${red},${green},${blue})`;

/** Distinct colours of Okabe and Ito (2008): apart for the colour-blind too. */
export const DISTINCT = [
  "#0072b2",
  "#e69f00",
  "#009e73",
  "#cc79a7",
  "#56b4e9",
  "#d55e00",
  "#8a7a00",
  "#777777",
] as const;

/** The same, lighter, for dark grounds. */
const DISTINCT_ON_DARK = [
  "#4fb0f0",
  "#f0b030",
  "#2bc495",
  "#e3a0c5",
  "#9ad4f5",
  "#ff8a4a",
  "#cdbb3a",
  "#a8a8a8",
] as const;

/** Returns a distinct colour that can be seen on the ground of a theme. */
export const distinct = (index: number, dark: boolean): string =>
  (dark ? DISTINCT_ON_DARK : DISTINCT)[index % DISTINCT.length];

/** Colours of a map's labels, as the package's overlay has them. */
export const LABEL_COLOURS: Readonly<Record<"background" | "road" | "red" | "yellow", Rgb>> = {
  background: [40, 40, 48],
  road: [110, 150, 180],
  red: [235, 60, 60],
  yellow: [255, 215, 60],
};

const OBJECT_COLOURS: Readonly<Record<string, string>> = {
  duckie: "#f5b301",
  cone: "#f26b1d",
  barrier: "#c2410c",
  duckiebot: "#0f7fb8",
  bus: "#d97706",
  truck: "#7c4fc4",
  tree: "#2f8f3e",
  house: "#a8503c",
  building: "#7d8590",
  trafficlight: "#15803d",
  sign_stop: "#c01722",
};

/** Returns the colour of a kind of object. All signs but the stop sign are blue, as on the plan. */
export const objectColour = (kind: string): string =>
  OBJECT_COLOURS[kind] ?? (kind.startsWith("sign_") ? "#1f5fbf" : "#14181f");

/** Tile pictures and their masks, and maps drawn with them. */
import { paintBlended, turnedPixels, type Pixels, type PixelsOf } from "./blend";
import { css, LABEL_COLOURS, type Rgb } from "./colours";
import { choosePictures, lotOf, type Data } from "./data";
import { objectShapes, paint } from "./drawing";
import type { Grid } from "./network/codes";
import { baseKind, TILE_SIZE, type MapObject } from "./network/objects";

/** The layers of a picture: the image, the masks, and the labels. */
export const LAYERS = ["image", "road", "red", "yellow", "labels"] as const;
export type Layer = (typeof LAYERS)[number];

const MASK_BITS = { road: 1, red: 2, yellow: 4 } as const;

/** The longest side of a picture in pixels, because browsers refuse larger canvases. */
const MOST_PX = 8192;

export interface TilePictures {
  readonly px: number;
  /** Returns a layer's picture of each tile, made at the first call. */
  readonly layerOf: (layer: Layer) => readonly CanvasImageSource[];
  /** The pictures as they are drawn and as their light is compared, or null if light is not matched. */
  readonly blended: {
    readonly drawn: PixelsOf;
    readonly compared: PixelsOf;
    readonly maps: Map<string, HTMLCanvasElement>;
  } | null;
  /** The pictures of objects from above, by kind. */
  readonly objects: ReadonlyMap<string, readonly ObjectPicture[]>;
}

interface ObjectPicture {
  readonly image: CanvasImageSource;
  /** The same in the colour that labels have without a road. */
  readonly silhouette: CanvasImageSource;
  /** In metres. */
  readonly height: number;
  readonly footprint: readonly [length: number, width: number];
}

/** Decodes the pictures of tiles and of objects. */
export async function loadTiles({ tiles: values, objects }: Data): Promise<TilePictures> {
  const decode = async (url: string): Promise<HTMLImageElement> => {
    const image = new Image();
    image.src = url;
    await image.decode();
    return image;
  };
  const { px } = values;
  const images = await Promise.all(values.pictures.map((picture) => decode(picture.image)));
  const masks = await Promise.all(values.pictures.map((picture) => decode(picture.masks)));
  const known: Partial<Record<Layer, readonly CanvasImageSource[]>> = { image: images };
  let read: Uint8ClampedArray[] | null = null;
  const bits = (): Uint8ClampedArray[] => (read ??= masks.map(levelsOf));
  const coloured = (colour: (mask: number) => Rgb | null): HTMLCanvasElement[] =>
    bits().map((mask) => {
      const canvas = canvasOf(px, px);
      const context = canvas.getContext("2d")!;
      const pixels = context.createImageData(px, px);
      for (let byte = 0; byte < pixels.data.length; byte += 4) {
        const rgb = colour(mask[byte]);
        if (rgb) pixels.data.set([...rgb, 255], byte);
      }
      context.putImageData(pixels, 0, 0);
      return canvas;
    });
  const { background, road, red, yellow } = LABEL_COLOURS;
  const colours: Readonly<Record<Layer, (mask: number) => Rgb | null>> = {
    image: () => null,
    road: (mask) => (mask & MASK_BITS.road ? road : null),
    red: (mask) => (mask & MASK_BITS.red ? red : null),
    yellow: (mask) => (mask & MASK_BITS.yellow ? yellow : null),
    labels: (mask) =>
      mask & MASK_BITS.yellow ? yellow : mask & MASK_BITS.red ? red : mask & MASK_BITS.road ? road : background,
  };
  let blended = null;
  if (values.blend) {
    const drawn = turned(images.map((image, index) => pixelsOf(levelsOf(image), bits()[index])));
    const compared = await Promise.all(
      values.pictures.map(
        async ({ compared: small }) =>
          small && pixelsOf(levelsOf(await decode(small.image)), levelsOf(await decode(small.masks))),
      ),
    );
    blended = {
      drawn,
      compared: compared.every((one) => one !== undefined) ? turned(compared) : drawn,
      maps: new Map(),
    };
  }
  const pictured = Object.entries(objects.pictures).map(async ([kind, drawn]) => {
    const decoded = drawn.map(async ({ image: url, ...sizes }) => {
      const image = await decode(url);
      return { ...sizes, image, silhouette: silhouetteOf(image) };
    });
    return [kind, await Promise.all(decoded)] as const;
  });
  return {
    px,
    blended,
    objects: new Map(await Promise.all(pictured)),
    layerOf: (layer) => (known[layer] ??= coloured(colours[layer])),
  };
}

/** Returns the R, G, B and opacity levels of a picture. */
function levelsOf(image: HTMLImageElement): Uint8ClampedArray {
  const { width, height } = image;
  const context = canvasOf(width, height).getContext("2d", { willReadFrequently: true })!;
  context.drawImage(image, 0, 0);
  return context.getImageData(0, 0, width, height).data;
}

function silhouetteOf(image: HTMLImageElement): HTMLCanvasElement {
  const canvas = canvasOf(image.width, image.height);
  const context = canvas.getContext("2d")!;
  context.drawImage(image, 0, 0);
  context.globalCompositeOperation = "source-in";
  context.fillStyle = css(LABEL_COLOURS.background);
  context.fillRect(0, 0, canvas.width, canvas.height);
  return canvas;
}

function pixelsOf(levels: Uint8ClampedArray, bits: Uint8ClampedArray): Pixels {
  const labels = Uint8Array.from({ length: bits.length / 4 }, (_, pixel) => {
    const mask = bits[4 * pixel];
    return mask & MASK_BITS.yellow ? 3 : mask & MASK_BITS.red ? 2 : mask & MASK_BITS.road;
  });
  return { size: Math.sqrt(labels.length), levels: levels.filter((_, byte) => byte % 4 < 3), labels };
}

/** Returns a function that turns pictures and keeps them. */
function turned(upright: readonly Pixels[]): PixelsOf {
  const known = new Map<number, Pixels>();
  return (picture) => {
    if (!known.has(picture)) known.set(picture, turnedPixels(upright[picture >> 2], picture & 3));
    return known.get(picture)!;
  };
}

export function canvasOf(width: number, height: number): HTMLCanvasElement {
  const canvas = document.createElement("canvas");
  canvas.width = width;
  canvas.height = height;
  return canvas;
}

/** The opacity of each layer, from 0 to 1. */
export type Blend = Readonly<Partial<Record<Layer, number>>>;

/** The number of maps with matched tiles that are kept. */
const MOST_KEPT = 8;

/** Draws a map with matched tiles, and keeps it. */
function blendedOf(grid: Grid, chosen: Int32Array, { px, blended }: TilePictures): HTMLCanvasElement {
  const { drawn, compared, maps } = blended!;
  const key = `${grid.width} ${chosen.join()}`;
  const canvas = maps.get(key) ?? canvasOf(grid.width * px, grid.height * px);
  if (!maps.delete(key)) {
    const context = canvas.getContext("2d")!;
    context.fillStyle = css(LABEL_COLOURS.background);
    context.fillRect(0, 0, canvas.width, canvas.height);
    const pixels = context.getImageData(0, 0, canvas.width, canvas.height);
    paintBlended(grid, chosen, compared, drawn, pixels.data);
    context.putImageData(pixels, 0, 0);
  }
  maps.set(key, canvas);
  if (maps.size > MOST_KEPT) maps.delete(maps.keys().next().value!);
  return canvas;
}

/**
 * Draws a map and its objects with pictures. Tiles are matched unless the map is too large. Cells without a picture stay
 * background. Without the image layer objects are silhouettes: where they are, no label of the road is seen.
 */
export function paintTiles(
  grid: Grid,
  data: Data,
  tiles: TilePictures,
  known: readonly number[] | null,
  objects: readonly MapObject[],
  blend: Blend,
): HTMLCanvasElement {
  const chosen = choosePictures(grid, data, known);
  const px = Math.min(tiles.px, Math.floor(MOST_PX / Math.max(grid.height, grid.width)));
  const canvas = canvasOf(grid.width * px, grid.height * px);
  const context = canvas.getContext("2d")!;
  context.imageSmoothingEnabled = px !== tiles.px;
  context.fillStyle = css(LABEL_COLOURS.background);
  context.fillRect(0, 0, canvas.width, canvas.height);
  // Quarter turns counter-clockwise. Whole numbers keep pixels sharp.
  const turned = [
    [1, 0, 0, 1],
    [0, -1, 1, 0],
    [-1, 0, 0, -1],
    [0, 1, -1, 0],
  ] as const;
  for (const layer of LAYERS) {
    const opacity = blend[layer] ?? 0;
    if (opacity <= 0) continue;
    const pictures = tiles.layerOf(layer);
    context.globalAlpha = opacity;
    if (layer === "image" && tiles.blended && px === tiles.px) {
      context.setTransform(1, 0, 0, 1, 0, 0);
      context.drawImage(blendedOf(grid, chosen, tiles), 0, 0);
      continue;
    }
    chosen.forEach((picture, cell) => {
      if (picture < 0) return;
      const [a, b, c, d] = turned[picture & 3];
      const x = ((cell % grid.width) + 0.5) * px;
      const y = (Math.floor(cell / grid.width) + 0.5) * px;
      context.setTransform(a, b, c, d, x, y);
      context.drawImage(pictures[picture >> 2], -px / 2, -px / 2, px, px);
    });
  }
  context.globalAlpha = 1;
  context.imageSmoothingEnabled = true;
  context.imageSmoothingQuality = "high";
  objects
    .map((thing, index) => ({ thing, lot: lotOf(data, index) }))
    .sort((one, other) => one.thing.height - other.thing.height)
    .forEach(({ thing, lot }) => {
      const pictures = tiles.objects.get(baseKind(thing.kind));
      context.setTransform(1, 0, 0, 1, 0, 0);
      if (!pictures) return paint(context, { shapes: objectShapes([thing], data.objects.kinds), texts: [] }, px);
      const { image, silhouette, height, footprint } = pictures[Math.floor(lot * pictures.length)];
      const scale = ((height ? thing.height / height : 1) * px) / TILE_SIZE;
      const [length, width] = footprint.map((side) => side * scale);
      const [cosine, sine] = [Math.cos(thing.angle), Math.sin(thing.angle)];
      context.setTransform(cosine, -sine, sine, cosine, thing.x * px, thing.y * px);
      context.drawImage(blend.image ? image : silhouette, -length / 2, -width / 2, length, width);
    });
  return canvas;
}

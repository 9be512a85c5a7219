// Builds the modules and the style sheets that are in the Python package: `node build.mjs [FOLDER]`.
import { readFileSync } from "node:fs";
import { build } from "esbuild";

const folder = process.argv[2] ?? "../elitelanes_jax/explorer/static";
const read = (file) => readFileSync(new URL(file, import.meta.url), "utf8");

// The licences of what is bundled go along with it.
const { dependencies } = JSON.parse(read("package.json"));
const licences = Object.keys(dependencies).map((name) => `${name}\n\n${read(`node_modules/${name}/LICENSE`).trim()}`);

await build({
  entryPoints: { explorer: "src/index.tsx", hands: "src/hands/index.tsx" },
  outdir: folder,
  bundle: true,
  format: "esm",
  target: "es2022",
  minify: true,
  charset: "ascii",
  legalComments: "none",
  banner: { js: `/*!\n${licences.join("\n\n")}\n*/` },
  jsx: "automatic",
  jsxImportSource: "preact",
});

await build({
  entryPoints: { hands: "src/hands/style.css" },
  outdir: folder,
  target: ["chrome111", "firefox113", "safari16.4"],
  minify: true,
  charset: "ascii",
});

// The chart's styles keep to the explorer's element, as all others do.
await build({
  stdin: {
    contents: `.elx{${read("node_modules/uplot/dist/uPlot.min.css")}}\n${read("src/style.css")}`,
    loader: "css",
  },
  outfile: `${folder}/explorer.css`,
  target: ["chrome111", "firefox113", "safari16.4"],
  minify: true,
  charset: "ascii",
  legalComments: "none",
});

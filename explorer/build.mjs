// Builds the module and the style sheet that lie in the Python package: `node build.mjs [FOLDER]`.
import { build } from "esbuild";

const folder = process.argv[2] ?? "../elitelanes_jax/explorer/static";

await build({
  entryPoints: { explorer: "src/index.tsx" },
  outdir: folder,
  bundle: true,
  format: "esm",
  target: "es2022",
  minify: true,
  charset: "ascii",
  legalComments: "none",
  jsx: "automatic",
  jsxImportSource: "preact",
});
await build({ entryPoints: { explorer: "src/style.css" }, outdir: folder, minify: true, charset: "ascii" });

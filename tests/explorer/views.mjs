// Shows every view of run.html and furnished.html in Chromium, in both themes and two widths, and prints axe's faults and
// what is wider than the screen as JSON: `node views.mjs FOLDER`. With SHOTS, a folder, pictures of all views go there.
import { join } from "node:path";
import { pathToFileURL } from "node:url";
import { browser, require } from "./chromium.mjs";

const folder = process.argv[2];
const axe = require("axe-core").source;

const faults = [];
const overflow = [];

for (const width of [1280, 390]) {
  for (const view of ["archive", "maps", "compare", "draw", "run", "objects"]) {
    const [name, shown] = view === "objects" ? ["furnished.html", "draw"] : ["run.html", view];
    const context = await browser.newContext({ viewport: { width, height: 900 }, bypassCSP: true });
    const page = await context.newPage();
    const address = pathToFileURL(join(folder, name)).href;
    await page.goto(`${address}#view=${shown}&look=tiles&overlays=faces&pins=0.0,0.1`);
    await page.waitForSelector(".elx .body canvas, .elx .body .panel");
    if (view === "objects") await page.getByRole("button", { name: "Objects", exact: true }).click();
    await page.evaluate(axe);
    for (const scheme of ["light", "dark"]) {
      await page.emulateMedia({ colorScheme: scheme });
      // A canvas is drawn anew in the frame after the theme has changed.
      await page.evaluate(() => new Promise((done) => requestAnimationFrame(() => setTimeout(done, 60))));
      if (process.env.SHOTS) await page.screenshot({ path: join(process.env.SHOTS, `${view}-${scheme}-${width}.png`), fullPage: true });
      const wide = await page.evaluate(() => document.documentElement.scrollWidth);
      if (wide > width) overflow.push(`${view} ${width}: ${wide}`);
      // Of axe's rules, a theme changes what the one about contrast finds.
      const rules = scheme === "dark" ? { runOnly: ["color-contrast"] } : {};
      const { violations } = await page.evaluate((rules) => axe.run(document, { ...rules, resultTypes: ["violations"] }), rules);
      for (const fault of violations) {
        const where = fault.nodes.slice(0, 3).map((node) => node.html.slice(0, 160));
        faults.push({ view, scheme, width, id: fault.id, impact: fault.impact, where });
      }
    }
    await context.close();
  }
}

await browser.close();
process.stdout.write(JSON.stringify({ faults, overflow }));

// Opens a marimo notebook with the widget and prints what it saw as JSON: `node marimo.mjs ADDRESS [PICTURE]`.
import { browser } from "./chromium.mjs";
import { drawRoad } from "./draw.mjs";

const [address, picture] = process.argv.slice(2);

const page = await browser.newPage({ viewport: { width: 1400, height: 1000 }, colorScheme: "dark" }); // the notebook is light
const errors = [];
page.on("pageerror", (error) => errors.push(error.message));
page.on("console", (message) => message.type() === "error" && errors.push(message.text()));
await page.goto(address, { timeout: 120_000 });
const widget = page.locator(".elx");
// The editor's cells wait to be run; an app has no such buttons.
const buttons = page.locator("[data-testid=run-button]");
await page.locator(".elx, [data-status] [data-testid=run-button]").first().waitFor({ timeout: 120_000 }); // cells' own
await page.waitForTimeout(3000);
const edits = (await buttons.count()) > 0;
if (edits) await buttons.first().dispatchEvent("click");
await widget.locator(".detail h2").waitFor({ timeout: 240_000 });
if (edits) {
  await page.waitForTimeout(3000);
  await buttons.last().dispatchEvent("click");
}
const map = await widget.locator(".detail h2").textContent();
const heading = await widget.locator(".detail h2").evaluate((title) => getComputedStyle(title).fontWeight);
const theme = [await widget.getAttribute("class")];
await page.evaluate(() => (document.body.dataset.theme = "dark"));
await page.waitForTimeout(300);
theme.push(await widget.getAttribute("class"));
await drawRoad(page, widget);
if (picture) await page.screenshot({ path: picture });
const drawn = page.getByText(/^drawn int8 \[\[0.*4, 5, 1/);
await drawn.waitFor({ timeout: 60_000 });
const grid = (await drawn.textContent()).trim();
process.stdout.write(JSON.stringify({ map, heading, theme, grid, errors }));
await browser.close();

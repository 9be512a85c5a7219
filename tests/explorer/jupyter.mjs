// Opens a notebook with the widget in JupyterLab and prints what it saw as JSON: `node jupyter.mjs ADDRESS PICTURE`.
import { browser } from "./chromium.mjs";
import { drawRoad } from "./draw.mjs";

const [address, picture] = process.argv.slice(2);

const page = await browser.newPage({ viewport: { width: 1400, height: 1000 } });
const errors = [];
page.on("pageerror", (error) => errors.push(error.message));
await page.goto(address, { timeout: 120_000 });
await page.locator(".jp-Notebook").waitFor({ timeout: 120_000 });
await page.locator(".jp-Cell").first().click();
await page.keyboard.press("Control+Home");
const isReady = () => window.jupyterapp.shell.currentWidget.sessionContext.session?.kernel?.status === "idle";
await page.waitForFunction(isReady, null, { timeout: 240_000 }); // what is run before is lost
await page.locator('[data-command="runmenu:run-all"], .lm-MenuBar-item:has-text("Run")').first().click();
await page.locator('.lm-Menu-item[data-command="runmenu:run-all"]').click();
const widget = page.locator(".elx");
await widget.waitFor({ timeout: 240_000 });
const map = await widget.locator(".detail h2").textContent();
await widget.locator(".cells").focus();
await page.keyboard.press("ArrowRight");
await page.waitForTimeout(300);
if (picture) await page.screenshot({ path: picture });
await drawRoad(page, widget);
await page.waitForTimeout(500);
const cell = page.locator(".jp-CodeCell").nth(1);
await cell.locator(".cm-content").click();
await page.keyboard.press("Control+Enter");
await cell.locator(".jp-OutputArea-output").first().waitFor({ timeout: 60_000 });
await page.waitForTimeout(500);
const grid = (await cell.locator(".jp-OutputArea-output").first().textContent()).trim();
process.stdout.write(JSON.stringify({ map, grid, errors }));
await browser.close();

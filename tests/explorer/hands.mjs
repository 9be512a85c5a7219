// Corrects tiles by hand in Chromium and prints what it saw as JSON: `node hands.mjs URL WIDTH ZIP`. SHOTS is a folder for pictures, ZIP the file of the set.
import { join } from "node:path";
import { browser, require } from "./chromium.mjs";

const axe = require("axe-core").source;
const [url, width] = [process.argv[2], Number(process.argv[3] ?? 1280)];
const seen = { console: [], requests: new Set(), axe: [], overflow: [] };
const context = await browser.newContext({ viewport: { width, height: 900 }, bypassCSP: true });
const page = await context.newPage();
page.on("console", (message) => seen.console.push(message.text()));
page.on("pageerror", (error) => seen.console.push(error.message));
page.on("request", (request) => request.url().startsWith("data:") || seen.requests.add(new URL(request.url()).origin));

const button = (name) => page.getByRole("button", { name, exact: true });
const settle = () => page.evaluate(() => new Promise((done) => requestAnimationFrame(() => setTimeout(done))));
const idle = () => page.waitForSelector('.photograph[aria-busy="false"]');
const fits = () => page.textContent(".side > p");
const pixels = () => page.$eval(".masked", (canvas) => canvas.toDataURL());
async function look(name) {
  await settle();
  if (process.env.SHOTS) await page.screenshot({ path: join(process.env.SHOTS, `${name}-${width}.png`), fullPage: true });
  if ((await page.evaluate(() => document.documentElement.scrollWidth)) > width) seen.overflow.push(name);
  await page.evaluate(axe);
  const { violations } = await page.evaluate(() => axe.run(document, { resultTypes: ["violations"] }));
  for (const fault of violations) seen.axe.push([name, fault.id, fault.nodes[0].html.slice(0, 200)]);
}

await page.goto(url);
await page.waitForSelector(".photograph image");

// A corner that is dragged away snaps back to the tiles; without Snap it stays there.
const corner = page.locator(".corner").first();
const position = () => corner.getAttribute("aria-label");
seen.corner = [await position()];
const box = await corner.locator(".point").boundingBox();
await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
await page.mouse.down();
await page.mouse.move(box.x + 14, box.y + 12, { steps: 4 });
await settle();
seen.corner.push(await position());
await Promise.all([page.waitForResponse((answer) => answer.url().endsWith("/fit")), page.mouse.up()]);
await idle();
seen.corner.push(await position());
seen.fits = await fits();
await button("Snap").click();
await corner.focus();
await page.keyboard.press("Shift+ArrowRight");
await page.waitForResponse((answer) => answer.url().endsWith("/fit"));
await idle();
seen.corner.push(await position());
await page.keyboard.press("Control+z");
await settle();
seen.corner.push(await position());
await button("Snap").click();

// Keys go from cell to cell; a kind is set, turned, and undone.
const cell = () => page.getAttribute(".cell.selected", "aria-label");
await page.locator(".cell.selected").focus();
await page.keyboard.press("ArrowRight");
await page.keyboard.press("ArrowDown");
seen.cells = [await cell()];
await page.getByLabel("Kind of B2").selectOption("turn");
await button("Turn").click();
seen.cells.push(await cell(), await page.textContent(".side .bar .note"));
await button("Undo").click();
await button("Undo").click();
await settle();
seen.cells.push(await cell());

// A field refuses what is no number of rows. With fewer rows, another tile is selected.
const rows = page.getByLabel("Rows");
await rows.fill("44444");
await rows.press("Enter");
await settle();
seen.rows = [await page.textContent(".message"), await rows.inputValue()];
await page.locator('[data-cell="2,1"]').focus();
await rows.fill("2");
await Promise.all([page.waitForResponse((answer) => answer.url().endsWith("/fit")), rows.press("Enter")]);
await idle();
seen.rows.push(await cell());
await button("Undo").click();
await page.locator('[data-cell="1,1"]').focus();
await settle();
await look("photograph");
seen.cut = await page.textContent(".main >> nth=1");
await page.locator(".side .main").click();
await page.waitForSelector(".masked");
seen.tiles = await page.locator(".strip li").count();

// A slider changes a mask, the brush adds to it, and undo brings each back.
await page.waitForFunction(() => document.querySelector(".masked").width > 300 || document.querySelector(".masked").width === 128);
await settle();
const looks = [await pixels()];
const value = page.getByLabel("Value to");
await value.fill("20");
await page.waitForFunction((before) => document.querySelector(".masked").toDataURL() !== before, looks[0]);
looks.push(await pixels());
seen.reaches = [await fits()];
await button("Undo").click();
await settle();
looks.push(await pixels());
seen.slider = await value.inputValue();
await button("Lane separators").click();
const easel = await page.locator(".masked").boundingBox();
await settle();
const before = await pixels();
await page.mouse.move(easel.x + easel.width * 0.6, easel.y + easel.height * 0.6);
await page.mouse.down();
await page.mouse.move(easel.x + easel.width * 0.7, easel.y + easel.height * 0.75, { steps: 5 });
await page.mouse.up();
await settle();
const drawn = await pixels();
await page.locator(".masked").focus();
await page.keyboard.press("Shift+ArrowRight");
await settle();
looks.push(before, drawn, await pixels());
await look("masks");
await page.keyboard.press("Control+z");
await page.keyboard.press("Control+z");
await settle();
looks.push(await pixels());
seen.looks = looks.map((one) => looks.indexOf(one));
// One brush stroke is kept, to be found in the file.
await button("Road").click();
await button("Erase").click();
await page.mouse.click(easel.x + easel.width * 0.5, easel.y + easel.height * 0.5);
await settle();

// Save, and finish.
await button("Finish").click();
seen.warned = await page.textContent(".message");
await button("Save").click();
await page.waitForFunction(() => document.querySelector(".message").textContent.startsWith("Saved"));
seen.saved = await page.textContent(".message");
seen.problems = await page.locator(".problems").textContent();
await look("saved");
const [download] = await Promise.all([page.waitForEvent("download"), button("Zip").click()]);
seen.zip = download.suggestedFilename();
await download.saveAs(process.argv[4]);

// Finish warns of each change again.
await button("Leave out").click();
await button("Finish").click();
seen.warnedAgain = await page.textContent(".message");
await button("Undo").click();
await settle();

// A page that is loaded again begins with the saved masks, and says that the one with the stroke is not of the sliders.
const note = page.getByText("This mask was not made from these colours", { exact: false });
seen.notes = [await note.count()];
await page.reload();
await button("Masks (9)").click();
await page.waitForSelector(".masked");
seen.notes.push(await note.count());
await page.getByLabel("Value to").fill("125");
await note.waitFor({ state: "detached" });
await button("Undo").click();
await settle();
seen.notes.push(await note.count());
await button("Finish").click();
await page.waitForSelector(".empty");
await browser.close();
process.stdout.write(JSON.stringify({ ...seen, requests: [...seen.requests] }));

// Clicks through pages in Chromium and prints what it saw as JSON: `node browser.mjs FOLDER`. The folder holds run.html,
// big.html, own.html, float.html, photo64.html, photo32.html, hostile.html, furnished.html, sizes.html, objects.json,
// town.yaml, large.json, large.yaml; saved files go there too.
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { pathToFileURL } from "node:url";
import { browser } from "./chromium.mjs";

const folder = process.argv[2];

const seen = { console: [], requests: [], dialogs: [] };

async function open(name, { hash = "", width = 1280, height = 900, scheme = "light" } = {}) {
  const context = await browser.newContext({ viewport: { width, height }, colorScheme: scheme, bypassCSP: true });
  const page = await context.newPage();
  page.on("console", (message) => seen.console.push(`${name} ${message.type()}: ${message.text()}`));
  page.on("pageerror", (error) => seen.console.push(`${name} error: ${error.message}`));
  page.on("dialog", (dialog) => (seen.dialogs.push(dialog.message()), dialog.dismiss()));
  page.on("request", (request) => {
    if (!/^(data|blob):/.test(request.url())) seen.requests.push(request.url().replace(/[#?].*/, "").replace(/.*\//, ""));
  });
  await page.goto(`${pathToFileURL(join(folder, name)).href}${hash && `#${hash}`}`);
  await page.waitForSelector(".elx .body canvas, .elx .body .panel");
  return page;
}

async function saved(page, press, name) {
  const [download] = await Promise.all([page.waitForEvent("download"), press()]);
  await download.saveAs(join(folder, name));
  return download.suggestedFilename();
}

const heading = (page) => page.textContent(".detail h2");
const hash = (page) => page.evaluate(() => decodeURIComponent(location.hash));
const tab = (page, name) => page.getByRole("tab", { name }).click();
const button = (page, name) => page.getByRole("button", { name, exact: true }).click();
const median = (numbers) => [...numbers].sort((one, other) => one - other)[Math.floor(numbers.length / 2)];
const pixels = (page, selector) => page.$eval(selector, (canvas) => canvas.toDataURL());
/** Waits until what changed is on the screen. */
const settle = (page) => page.evaluate(() => new Promise((done) => requestAnimationFrame(() => setTimeout(done))));

// The policy of the page holds in a browser that keeps it.
{
  const context = await browser.newContext();
  const page = await context.newPage();
  const errors = [];
  page.on("console", (message) => errors.push(message.text()));
  await page.goto(pathToFileURL(join(folder, "run.html")).href);
  await page.waitForSelector(".detail canvas");
  seen.strict = errors.length;
  seen.refused = await page.evaluate(() => fetch("data:text/plain,x").then(() => "sent", () => "refused"));
  await context.close();
}

// In a frame without an origin, as programs that show a page within their own make it.
{
  seen.frames = [];
  const html = readFileSync(join(folder, "run.html"), "utf8");
  for (const kind of ["srcdoc", "sandboxed", "blob", "data"]) {
    const context = await browser.newContext();
    const page = await context.newPage();
    page.on("pageerror", (error) => seen.console.push(`${kind} error: ${error.message}`));
    page.on("console", (message) => seen.console.push(`${kind} ${message.type()}: ${message.text()}`));
    await page.evaluate(([html, kind]) => {
      const frame = document.createElement("iframe");
      frame.width = frame.height = 900;
      if (kind === "blob") frame.src = URL.createObjectURL(new Blob([html], { type: "text/html" }));
      else if (kind === "data") frame.src = `data:text/html;charset=utf-8,${encodeURIComponent(html)}`;
      else frame.srcdoc = html;
      if (kind === "sandboxed") frame.sandbox = "allow-scripts";
      document.body.append(frame);
    }, [html, kind]);
    const frame = page.frameLocator("iframe");
    const names = [];
    for (const view of ["Maps", "Draw", "Run", "Archive"]) {
      await frame.getByRole("tab", { name: view }).click();
      names.push(await frame.locator("[role=tab][aria-selected=true]").textContent());
    }
    await frame.locator(".cells").focus();
    await frame.locator(".cells").press("ArrowRight");
    seen.frames.push([...names, await frame.locator(".detail h2").count()]);
    await context.close();
  }
}

// The archive.
{
  const page = await open("run.html");
  const first = await heading(page);
  const box = await page.locator(".cells").boundingBox();
  await page.mouse.click(box.x + box.width * 0.5, box.y + 4);
  await settle(page);
  const clicked = await hash(page);
  await page.locator(".cells").focus();
  await page.keyboard.press("ArrowRight");
  await page.keyboard.press("ArrowDown");
  await settle(page);
  const walked = await hash(page);
  await page.reload();
  await page.waitForSelector(".detail");
  const before = await pixels(page, ".cells");
  await page.getByLabel("Colour", { exact: true }).selectOption("bridges");
  await settle(page);
  const metric = await pixels(page, ".cells");
  await page.getByLabel("Elites of").selectOption("1");
  await settle(page);
  const seed = await pixels(page, ".cells");
  await page.getByLabel("Elites of").selectOption("count");
  await settle(page);
  const count = await page.textContent(".legend b");
  await page.getByLabel("Across").selectOption("dead_ends");
  await settle(page);
  seen.archive = {
    first, clicked, walked, kept: await hash(page), count,
    changes: new Set([before, metric, seed, await pixels(page, ".cells")]).size,
  };
  await page.context().close();
}

// A niche, its layers and its files: a map that the run wrote.
{
  const page = await open("run.html", { hash: "map=PLACE".replace("PLACE", process.argv[3]) });
  const looks = [await pixels(page, ".detail canvas")];
  for (const overlay of ["Bridges", "Adjacent crossings", "Adjacent turns", "Dead ends", "Faces"]) {
    const chip = page.locator(".detail .switch", { hasText: overlay });
    await chip.click();
    await settle(page);
    looks.push(await pixels(page, ".detail canvas"));
  }
  const svg = await saved(page, () => button(page, "SVG"), "saved.svg");
  await saved(page, () => button(page, "map.json"), "saved.json");
  await saved(page, () => button(page, "YAML"), "saved.yaml");
  await button(page, "Tiles");
  await settle(page);
  await saved(page, () => button(page, "PNG"), "saved.png");
  for (const layer of ["Road", "Stop lines", "Lane lines", "Labels"]) {
    await page.locator(".look .switch", { hasText: layer }).click();
    await settle(page);
    looks.push(await pixels(page, ".detail canvas"));
  }
  await page.getByLabel("Strength of the layers").fill("1");
  await settle(page);
  looks.push(await pixels(page, ".detail canvas"));
  await page.locator(".look .switch", { hasText: "Picture" }).click();
  await settle(page);
  await saved(page, () => button(page, "PNG"), "labels.png");
  seen.niche = { looks: looks.length, different: new Set(looks).size, svg, hash: await hash(page) };
  await page.context().close();
}

// Filtering, sorting, comparing.
{
  const page = await open("run.html", { hash: "view=maps" });
  const handle = page.getByLabel("least Crossings");
  await handle.focus();
  for (let step = 0; step < 3; step++) await page.keyboard.press("ArrowRight");
  await settle(page);
  const kept = await page.textContent(".count b");
  const where = await page.textContent("code.where");
  await page.getByLabel("Sort by").selectOption("crossings");
  await button(page, "Descending");
  await settle(page);
  const sorted = await page.$$eval(".gallery span", (names) => names.slice(0, 12).map((name) => Number(name.textContent.replace(/\D/g, ""))));
  await saved(page, () => button(page, "Save the list"), "selection.json");
  await page.locator(".gallery button").nth(1).click();
  await button(page, "Compare");
  await page.locator(".gallery button").nth(2).click();
  await button(page, "Compare");
  await tab(page, "Compare");
  const compared = await page.locator(".compare canvas").count();
  const rows = await page.locator(".compare tbody tr").count();
  const compareHash = await hash(page);
  await page.getByRole("button", { name: /^Take out/ }).first().click();
  await settle(page);
  seen.maps = { kept, where, sorted, compared, rows, compareHash, left: await page.locator(".compare canvas").count() };
  await tab(page, "Run");
  seen.run = { charts: await page.locator(".chart").count(), settings: await page.textContent(".settings") };
  await page.context().close();
}

// Drawing.
async function drag(page, from, to, steps = 6) {
  await page.mouse.move(...from);
  await page.mouse.down();
  await page.mouse.move(...to, { steps });
  await page.mouse.up();
  await settle(page);
}
{
  const page = await open("run.html", { hash: "view=draw" });
  await button(page, "Clear");
  await page.getByLabel("Rows").fill("6");
  await page.getByLabel("Columns").fill("6");
  await page.keyboard.press("Tab");
  await settle(page);
  const box = await page.locator(".editor").boundingBox();
  const at = (row, column) => [box.x + ((column + 0.5) * box.width) / 6, box.y + ((row + 0.5) * box.height) / 6];
  const value = async (name) => Number((await page.locator(".metrics tr", { hasText: name }).first().locator(".value").textContent()).replace("−", "-"));
  await drag(page, at(1, 1), at(1, 4));
  await drag(page, at(1, 4), at(4, 4));
  const open_ = { deadEnds: await value("Dead ends"), bridges: await value("Bridges") };
  await drag(page, at(4, 4), at(4, 1));
  await drag(page, at(4, 1), at(1, 1));
  const ring = { deadEnds: await value("Dead ends"), cyclomatic: await value("Cyclomatic number"), fitness: await page.textContent(".total b") };
  await saved(page, () => button(page, "map.json"), "drawn.json");
  await button(page, "Undo");
  const undone = await value("Dead ends");
  await button(page, "Redo");
  await button(page, "Fixed");
  await page.mouse.click(...at(1, 1));
  await button(page, "No road");
  await page.mouse.click(...at(2, 2));
  await saved(page, () => button(page, "fix.json"), "fix.json");
  await button(page, "Tile");
  await page.getByLabel("code 15, four-way crossing").click();
  await page.mouse.click(...at(4, 4));
  const mended = await value("Crossings");
  await button(page, "Repair");
  await page.mouse.click(...at(1, 4));
  await page.locator(".metrics summary", { hasText: "All metrics" }).click();
  const mismatches = await value("Mismatches");
  await page.locator(".weights > summary").click();
  await page.locator(".weights details summary").click();
  const total = await page.textContent(".total b");
  await page.locator(".weight", { hasText: /^Crossings/ }).locator("input").fill("500");
  await settle(page);
  const weighted = await page.textContent(".total b");
  const weights = await page.textContent(".weights code");
  await button(page, "Road");
  await page.locator(".editor").focus();
  await page.keyboard.press("Shift+ArrowLeft");
  await page.keyboard.press("Control+z");
  const text = (await import("node:fs")).readFileSync(join(folder, "town.yaml"), "utf8");
  const drop = async (name, content) => {
    const transfer = await page.evaluateHandle(([file, words]) => {
      const data = new DataTransfer();
      data.items.add(new File([words], file));
      return data;
    }, [name, content]);
    await page.dispatchEvent(".split", "drop", { dataTransfer: transfer });
    await page.waitForTimeout(100);
    return page.textContent(".message");
  };
  const dropped = await drop("town.yaml", text);
  await saved(page, () => button(page, "map.json"), "dropped.json");
  const refused = [
    await drop("x.json", '{"codes": [[1, 99]]}'), await drop("x.yaml", "tile_size: 1"), await drop("x.yaml", "tiles:\n- [<b>, {"), await drop("x.png", "\0"),
  ];
  await tab(page, "Archive");
  const elsewhere = await drop("ring.json", "[[6, 3], [12, 9]]");
  const opened = await hash(page);
  seen.draw = { open: open_, ring, undone, mended, mismatches, total, weighted, weights, dropped, refused, elsewhere, opened };
  await page.context().close();
}

// Keys alone: Tab leads to everything that can be pressed, each is marked while it has the focus, and all of it obeys.
async function walk(page) {
  await page.evaluate(() => document.querySelectorAll("details").forEach((part) => (part.open = true)));
  await page.evaluate(() => document.querySelectorAll("[data-walked]").forEach((one) => delete one.dataset.walked));
  const unmarked = [];
  for (let step = 0; step < 120; step++) {
    await page.keyboard.press("Tab");
    const stop = await page.evaluate(() => {
      const now = document.activeElement;
      if (now.dataset.walked) return null;
      if (now === document.body) return { marked: true }; // Tab goes on from the top
      now.dataset.walked = "yes";
      const style = getComputedStyle(now);
      const marked = now.matches(":focus-visible") && (now.matches(".two input") || (style.outlineStyle !== "none" && parseFloat(style.outlineWidth) >= 2));
      return { name: now.outerHTML.slice(0, 80), marked };
    });
    if (!stop) break;
    if (!stop.marked) unmarked.push(stop.name);
  }
  const missed = await page.evaluate(() => [...document.querySelectorAll(".elx :is(button, select, input, summary, a, [tabindex])")]
    .filter((one) => one.checkVisibility() && !one.disabled && one.tabIndex >= 0 && !one.dataset.walked).map((one) => one.outerHTML.slice(0, 80)));
  return [...unmarked, ...missed];
}
{
  const page = await open("run.html", { hash: `look=tiles&layers=image,road&pins=0.0,0.1&map=${process.argv[3]}` });
  const missed = [];
  const press = async (...keys) => {
    for (const key of keys) await page.keyboard.press(key);
    await settle(page);
  };
  const focused = () => page.evaluate(() => document.activeElement.getAttribute("aria-label") ?? document.activeElement.textContent);
  const go = async (element) => element.focus();
  const named = (name, role = "button") => page.getByRole(role, { name, exact: true });
  for (const view of ["archive", "maps", "compare", "draw", "run"]) {
    missed.push(...(await walk(page)));
    if (view === "compare") {
      await go(page.getByRole("button", { name: /^Take out/ }).first());
      await press("Enter");
      missed.push(...((await page.evaluate(() => document.activeElement === document.body)) ? ["what was pressed took the focus along"] : []));
    }
    await go(page.getByRole("tab", { selected: true }));
    await press("ArrowRight");
  }
  await press("ArrowRight");
  await go(page.getByLabel("least Crossings"));
  await press("ArrowRight");
  await go(page.getByLabel("most Crossings"));
  await press("End", "ArrowLeft", "ArrowLeft");
  const where = await page.textContent("code.where");
  await go(page.locator('.gallery [tabindex="0"]'));
  await press("ArrowRight", "ArrowDown", "Enter");
  const opened = await page.locator(".gallery li").evaluateAll((all) => all.findIndex((one) => one.querySelector('[aria-pressed="true"]')));
  await go(named("Compare"));
  await press("Enter");
  const compared = await page.textContent(".tabs b");
  await go(named("Edit"));
  await press("Space");
  await go(named("Clear"));
  await press("Enter");
  await go(page.locator(".editor"));
  await press("Shift+ArrowRight", "Shift+ArrowRight", "Shift+ArrowDown");
  const tiles = () => page.locator(".metrics tr", { hasText: "Coverage" }).first().locator(".value").textContent();
  const drawn = await tiles();
  await press("Control+z");
  const undone = await tiles();
  await press("Control+y");
  await go(named("Fixed"));
  await press("Space");
  await go(page.locator(".editor"));
  await press("Enter");
  const fixed = await named("fix.json").isEnabled();
  await page.locator(".weights > summary").focus();
  await press("Enter");
  await go(page.locator(".weight input").first());
  await press("ArrowRight");
  const weights = await page.textContent(".weights code");
  await tab(page, "Run");
  const end = await page.textContent(".key");
  await go(page.locator(".chart [tabindex]"));
  await press("Home");
  seen.keys = { missed, where, opened, compared, drawn, undone, fixed, weights, read: (await page.textContent(".key")) !== end, chart: await focused() };
  await page.context().close();
}

// Times, on the largest page.
async function strokes(page, tiles, row) {
  await page.evaluate(() => scrollTo(0, 0));
  const box = await page.locator(".editor").boundingBox();
  const at = (row, column) => [box.x + ((column + 0.5) * box.width) / tiles, box.y + ((row + 0.5) * box.height) / tiles];
  for (let stroke = 0; stroke < 4; stroke++) await drag(page, at(row + stroke, 1), at(row + stroke, 8), 7);
  return page.evaluate(() => {
    const times = performance.getEntriesByName("elitelanes-stroke").map((entry) => entry.duration);
    performance.clearMeasures();
    return times;
  });
}
{
  const shown = [];
  for (let time = 0; time < 3; time++) {
    const page = await open("big.html");
    await page.waitForFunction(() => performance.getEntriesByName("elitelanes-shown").length);
    shown.push(await page.evaluate(() => performance.getEntriesByName("elitelanes-shown")[0].startTime));
    if (time < 2) {
      await page.context().close();
      continue;
    }
    const colours = [];
    const names = await page.$$eval('.choice:nth-child(2) option', (options) => options.map((option) => option.value));
    for (let change = 0; change < 20; change++) {
      colours.push(await page.evaluate(async (name) => {
        const list = document.querySelector(".choice:nth-child(2) select");
        const before = performance.now();
        list.value = name;
        list.dispatchEvent(new Event("change", { bubbles: true }));
        await new Promise((done) => requestAnimationFrame(() => setTimeout(done)));
        return performance.now() - before;
      }, names[change % names.length]));
    }
    await tab(page, "Draw");
    const small = await strokes(page, 12, 1);
    await page.getByLabel("Rows").fill("64");
    await page.getByLabel("Columns").fill("64");
    await page.keyboard.press("Tab");
    await button(page, "Fill"); // from the first stroke on every tile has a road
    await button(page, "Tile");
    await page.getByLabel("code 15, four-way crossing").click();
    await settle(page);
    const large = await strokes(page, 64, 30);
    seen.times = {
      shown: median(shown), colour: median(colours), colours: colours.length, small: median(small), smalls: small.length,
      large: median(large), larges: large.length,
    };
    await page.context().close();
  }
}

// Features beside the metrics: of towns, and of a search's own.
{
  const page = await open("own.html", { hash: "view=maps&where=symmetry=600..900,corners=2.." });
  const [kept, where, note] = [await page.textContent(".count b"), await page.textContent("code.where"), await page.textContent(".bar ~ .note")];
  await saved(page, () => button(page, "Save the list"), "own.json");
  await button(page, "Clear");
  await tab(page, "Archive");
  await page.getByLabel("Colour", { exact: true }).selectOption("corners");
  await page.getByLabel("Across").selectOption("corners");
  const legend = await page.textContent(".legend b");
  await page.locator(".metrics summary", { hasText: "As a town" }).click();
  await page.waitForSelector(".metrics details[open] td");
  const values = await page.$$eval(".metrics tr", (rows) => Object.fromEntries(rows.map((row) => [row.children[0].textContent, row.children[1].textContent])));
  await tab(page, "Draw");
  const total = await page.textContent(".total span");
  seen.own = { kept, where, note, legend, values, total, drawn: await page.textContent(".total b"), left: await page.textContent(".total + .note") };
  await page.context().close();
}

// A float fitness of the user's.
{
  const page = await open("float.html", { hash: "view=maps&where=fitness=-2.5..0.25" });
  const kept = await page.textContent(".count b");
  await saved(page, () => button(page, "Save the list"), "float.json");
  await button(page, "Clear");
  const least = page.getByLabel("least Fitness");
  if (!(await least.isVisible())) await page.locator(".filters summary").click();
  await least.focus();
  await page.keyboard.press("ArrowRight");
  await settle(page);
  const narrowed = await page.textContent(".count b");
  const range = /fitness=([^,&]*)/.exec(await hash(page))[1];
  await page.reload();
  await page.waitForSelector(".count b");
  const again = await page.textContent(".count b");
  await tab(page, "Archive");
  await page.getByText("Even", { exact: true }).click();
  await settle(page);
  const marks = await page.$$eval(".legend .ramp span", (spans) => spans.map((span) => span.textContent));
  const head = await page.textContent(".detail header p");
  const quantities = await page.getByLabel("Colour", { exact: true }).locator("option").allTextContents();
  await tab(page, "Draw");
  seen.float = {
    kept, narrowed, range, again, marks, head, quantities,
    total: await page.textContent(".total span"), note: await page.textContent(".total + .note"),
    row: await page.locator(".metrics tr", { hasText: "Fitness" }).locator(".value").textContent(),
  };
  await saved(page, () => button(page, "map.json"), "float-drawn.json");
  await page.context().close();
}

// Objects: their pictures and files, and how the editor changes them.
{
  const page = await open("furnished.html", { hash: "view=maps&look=tiles" });
  const listed = await page.$$eval(".objects li", (kinds) => kinds.map((kind) => kind.textContent));
  for (const [name, file] of [["PNG", "furnished.png"], ["map.json", "furnished.json"], ["YAML", "furnished.yaml"], ["Plan", "plan.svg"], ["Save the list", "list.json"]])
    await saved(page, () => button(page, name), file);
  await page.locator(".look .switch", { hasText: "Labels" }).click();
  await page.getByLabel("Strength of the layers").fill("1");
  await page.locator(".look .switch", { hasText: "Picture" }).click();
  await settle(page);
  await saved(page, () => button(page, "PNG"), "furnished-labels.png");
  await tab(page, "Draw");
  await button(page, "Objects");
  await page.getByLabel("Map file").setInputFiles(join(folder, "objects.json"));
  await page.waitForFunction(() => document.querySelectorAll(".objects li").length === 2);
  const opened = await page.textContent(".message");
  const editor = page.locator(".editor");
  const box = await editor.boundingBox();
  const at = (x, y) => [box.x + ((x + 0.3) * box.width) / 4.6, box.y + ((y + 0.3) * box.height) / 4.6];
  const press = async (...keys) => {
    for (const key of keys) await page.keyboard.press(key);
    await settle(page);
    return page.textContent(".elx [role=status]");
  };
  const fill = async (name, value) => {
    await page.getByLabel(name, { exact: true }).fill(value);
    return press("Tab");
  };
  await drag(page, at(1.5, 1.5), at(2.25, 1.75));
  await page.getByLabel("Kind to add").selectOption("sign_stop");
  await page.mouse.click(...at(3, 3));
  await editor.focus();
  const said = [await press("r", "Shift+ArrowRight"), await press("Enter"), await press("ArrowLeft"), await press("Delete"), await press("ArrowLeft")];
  await fill("Angle", "285");
  await editor.focus();
  await press("Shift+R");
  await fill("Tag", "586");
  const refused = [await fill("X", "99"), await fill("Tag", "587"), await page.getByLabel("X", { exact: true }).inputValue()];
  await button(page, "Undo");
  await button(page, "Redo");
  const missed = await walk(page);
  await saved(page, () => button(page, "map.json"), "moved.json");
  await saved(page, () => button(page, "YAML"), "moved.yaml");
  seen.objects = { listed, opened, said, refused, missed };
  await page.context().close();
}

// Signs that do not fit, and the tiles on the shelf, while roads are drawn.
{
  const page = await open("furnished.html", { hash: "view=maps" });
  const warning = () => page.locator(".warning").allTextContents();
  const fits = [await warning()];
  await button(page, "Edit");
  fits.push(await warning());
  const box = await page.locator(".editor").boundingBox();
  const edge = 0.4; // tiles around a map with signs outside it
  const at = (row, column) => {
    const scale = box.width / (7 + 2 * edge);
    return [box.x + (column + 0.5 + edge) * scale, box.y + (row + 0.5 + edge) * scale];
  };
  const used = () => page.$$eval(".shelf tbody td:nth-child(2)", (cells) => cells.map((cell) => Number(cell.textContent)));
  const left = () => page.$$eval(".shelf tbody td:nth-child(4)", (cells) => cells.map((cell) => cell.textContent));
  const before = await used();
  await page.locator(".shelf summary").click();
  const shelf = { before, unset: await left() };
  for (const [kind, count] of [["straights", 17], ["turns", 4], ["three-way crossings", 6], ["four-way crossings", 1]]) {
    await page.getByLabel(`${kind} on the shelf`).fill(`${count}`);
    await page.keyboard.press("Tab");
  }
  await settle(page);
  shelf.full = [await left(), await page.textContent(".shelf summary span"), await page.textContent(".shelf code"), await hash(page)];
  await button(page, "Erase");
  await page.mouse.click(...at(2, 2));
  await settle(page);
  shelf.drawn = [await used(), await left(), await page.textContent(".shelf summary span")];
  await page.getByLabel("turns on the shelf").fill("1");
  await page.keyboard.press("Tab");
  await settle(page);
  shelf.lacking = [(await left())[1], await page.textContent(".shelf summary span")];
  const stale = await warning();
  await tab(page, "Archive");
  await tab(page, "Draw");
  await button(page, "Place them again");
  await settle(page);
  const said = await page.textContent(".message");
  fits.push(await warning());
  await saved(page, () => button(page, "map.json"), "signs.json");
  await button(page, "Undo");
  const undone = await warning();
  await button(page, "Redo");
  // A road beside the northern street takes the room for signs.
  await button(page, "Road");
  await page.mouse.move(...at(1, 0));
  await page.mouse.down();
  await page.mouse.move(...at(1, 6), { steps: 12 });
  await page.mouse.up();
  await settle(page);
  const crowded = [await warning()];
  await button(page, "Place them again");
  await settle(page);
  crowded.push(await warning(), [await page.textContent(".message")]);
  await button(page, "Undo");
  await button(page, "Undo");
  await button(page, "Repair");
  await button(page, "Cut");
  await button(page, "Tile");
  await page.getByLabel("code 15, four-way crossing").click();
  await page.mouse.click(...at(0, 0));
  await saved(page, () => button(page, "map.json"), "ends.json");
  const ends = await page.textContent(".message");
  await button(page, "Plan");
  await settle(page);
  seen.signs = { fits, stale, said, undone, crowded, ends, plan: await page.textContent(".message"), shelf };
  await page.context().close();
}

// A phone: a tap on a map, or on a niche, shows the map.
{
  const page = await open("run.html", { width: 390, height: 844, hash: "view=maps" });
  const seenMap = async () => {
    await settle(page);
    const { top, bottom } = await page.$eval(".detail canvas", (canvas) => canvas.getBoundingClientRect().toJSON());
    return top >= 0 && bottom <= 844;
  };
  const taps = [];
  const maps = page.locator(".gallery button");
  for (const index of [0, 1, 5, (await maps.count()) - 1]) {
    await maps.nth(index).scrollIntoViewIfNeeded();
    await maps.nth(index).click();
    taps.push(await seenMap());
  }
  await tab(page, "Archive");
  await page.evaluate(() => scrollTo(0, 0));
  const niche = await page.locator(".heat .open").boundingBox();
  await page.mouse.click(niche.x + niche.width / 2, niche.y + niche.height / 2);
  await settle(page);
  seen.phone = { taps, niche: await seenMap() };
  await page.context().close();
}

// A wide window: a click on a map scrolls nothing.
{
  const page = await open("run.html", { hash: "view=maps" });
  await page.locator(".gallery button").nth(1).click();
  await settle(page);
  seen.scrolled = await page.evaluate(() => scrollY);
  await page.context().close();
}

// Maps of two sizes side by side: a tile is as wide in both.
seen.scales = [];
for (const [width, look] of [[1280, "lines"], [1280, "tiles"], [390, "lines"]]) {
  const page = await open("sizes.html", { width, hash: `view=compare&pins=0.0,1.0&look=${look}` });
  await settle(page);
  seen.scales.push(await page.$$eval(".compare canvas", (all) => all.map((canvas) => canvas.getBoundingClientRect().width)));
  await page.context().close();
}

// The largest files that the package writes.
{
  const page = await open("run.html", { hash: "view=draw" });
  seen.large = [];
  for (const name of ["large.json", "large.yaml"]) {
    await page.getByLabel("Map file").setInputFiles(join(folder, name));
    await page.waitForFunction((start) => document.querySelector(".message").textContent.startsWith(start), `${name}: `, { timeout: 120000 });
    seen.large.push(await page.textContent(".message"));
  }
  seen.large.push(await page.locator(".metrics tr", { hasText: "Coverage" }).first().locator(".value").textContent());
  await page.context().close();
}

// Photographed tiles, brought together, in the size in which their light is compared and in another.
for (const px of [64, 32]) {
  const page = await open(`photo${px}.html`, { hash: "view=maps&look=tiles" });
  await saved(page, () => button(page, "PNG"), `photo${px}.png`);
  await page.context().close();
}

// Names that would be HTML.
{
  const page = await open("hostile.html", { hash: "view=maps" });
  seen.hostile = { words: await page.textContent(".gallery span"), scripts: await page.locator("script").count(), bold: await page.locator(".elx i b").count() };
  await page.context().close();
}

await browser.close();
process.stdout.write(JSON.stringify(seen));

// Takes the picture of the documentation: `node picture.mjs PAGE PICTURE`, of a page made of docs/examples/run.
import { pathToFileURL } from "node:url";
import { chromium } from "playwright-core";

const [file, picture] = process.argv.slice(2);
const browser = await chromium.launch({
  executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
  args: ["--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-sync"],
});
const page = await browser.newPage({ viewport: { width: 1280, height: 980 } });
await page.goto(`${pathToFileURL(file).href}#niche=6-0-0-0-0&look=tiles`);
await page.waitForSelector(".detail canvas");
await page.waitForTimeout(500);
await page.screenshot({ path: picture });
await browser.close();

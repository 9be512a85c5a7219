// Starts Chromium, without a screen and without traffic of its own.
import { createRequire } from "node:module";

export const require = createRequire(new URL("../../explorer/package.json", import.meta.url));

export const browser = await require("playwright-core").chromium.launch({
  executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
  args: [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
  ],
});

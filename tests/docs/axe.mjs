// Checks pages of the built site with axe-core in chromium, at widths of 400 and 1400 px:
//
//     npm install --no-save axe-core puppeteer-core
//     node tests/docs/axe.mjs build/site [FOLDER for pictures]
//
// Prints each violation; ends with 1 if there is one. CHROMIUM names another browser.
import { createServer } from "node:http";
import { readFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { extname, join } from "node:path";

const require = createRequire(join(process.cwd(), "package.json"));
const puppeteer = require("puppeteer-core");
const axe = await readFile(require.resolve("axe-core/axe.min.js"), "utf8");
const [site, pictures] = process.argv.slice(2);
const PAGES = [
  "index", "install", "start/integrator", "start/security", "commands", "rs485", "replay",
  "adding-a-device", "comparison", "findings",
];
const TYPES = { ".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml" };

const server = createServer(async (request, response) => {
  const path = new URL(request.url, "http://x").pathname;
  try {
    const body = await readFile(join(site, path));
    response.writeHead(200, { "content-type": TYPES[extname(path)] ?? "application/octet-stream" });
    response.end(body);
  } catch {
    response.writeHead(404).end();
  }
});
await new Promise((ready) => server.listen(0, "127.0.0.1", ready));
const address = `http://127.0.0.1:${server.address().port}`;

const browser = await puppeteer.launch({
  executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
  args: ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync"],
});
let violations = 0;
for (const width of [400, 1400]) {
  for (const name of PAGES) {
    const page = await browser.newPage();
    page.on("request", (one) => {
      if (!one.url().startsWith(address) && !one.url().startsWith("data:")) {
        violations += 1;
        console.log(`${name}: loads ${one.url()}`);
      }
    });
    await page.setViewport({ width, height: 900 });
    await page.goto(`${address}/${name}.html`, { waitUntil: "networkidle0" });
    await page.evaluate(axe);
    const found = await page.evaluate(() => axe.run());
    const wide = await page.evaluate(() => document.documentElement.scrollWidth > innerWidth);
    if (wide) console.log(`${name} at ${width} px: wider than the window`);
    violations += found.violations.length + (wide ? 1 : 0);
    for (const one of found.violations) {
      console.log(`${name} at ${width} px: ${one.id} (${one.impact}), ${one.nodes.length} times: ${one.help}`);
      for (const node of one.nodes.slice(0, 3)) console.log(`    ${node.target}  ${node.failureSummary.split("\n")[1]}`);
    }
    if (pictures) await page.screenshot({ path: join(pictures, `${name.replace("/", "-")}-${width}.png`) });
    await page.close();
  }
}
console.log(`${PAGES.length} pages at 400 and 1400 px: ${violations} violations`);
await browser.close();
server.close();
process.exit(violations ? 1 : 0);

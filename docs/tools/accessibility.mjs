// Checks built pages by axe against WCAG 2, levels A and AA, in Chromium:
//
//   npm install --no-save axe-core puppeteer-core     (PUPPETEER_SKIP_DOWNLOAD=1)
//   node docs/tools/accessibility.mjs /usr/bin/chromium out/docs/*.html
import fs from "fs";
import path from "path";
import { createRequire } from "module";

const require = createRequire(path.join(process.cwd(), "node_modules", "_"));
const puppeteer = require("puppeteer-core");
const axe = fs.readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");
const [executablePath, ...pages] = process.argv.slice(2);
const browser = await puppeteer.launch({ executablePath, args: ["--no-sandbox"] });
let wrong = 0;
for (const file of pages) {
  const page = await browser.newPage();
  await page.goto("file://" + path.resolve(file));
  await page.setViewport({ width: 1280, height: 20000 }); // all in view: the theme finishes what is seen
  await new Promise((resolve) => setTimeout(resolve, 1500));
  await page.evaluate(axe);
  const found = await page.evaluate(() => window.axe.run({ runOnly: ["wcag2a", "wcag2aa"] }));
  for (const { id, nodes } of found.violations)
    console.log(`${file}: ${id}, ${nodes.length} times: ${nodes[0].html.slice(0, 120)}`);
  wrong += found.violations.length;
  await page.close();
}
await browser.close();
console.log(`${pages.length} pages, ${wrong} violations`);
process.exit(wrong ? 1 : 0);

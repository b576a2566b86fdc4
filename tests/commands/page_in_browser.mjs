// Opens pages in a real browser as readers do, and prints what is wrong with each as JSON:
//   node page_in_browser.mjs NODE_MODULES CHROMIUM FILE.html...
// At two widths by day and by night, and on paper. What is folded on paper is a longer form of what is there.

import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { join, resolve } from "node:path";
import { pathToFileURL } from "node:url";

const [modules, executablePath, ...files] = process.argv.slice(2);
const require = createRequire(join(resolve(modules), "package.json"));
const { chromium } = require("playwright-core");
const axe = readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");
const A4 = 688; // px between margins of 14 mm

const flags = ["--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update"];
const browser = await chromium.launch({ executablePath, args: flags });

async function opened(file, options, said) {
  const page = await (await browser.newContext(options)).newPage();
  page.on("console", (message) => said.push(message.text()));
  page.on("pageerror", (error) => said.push(error.message));
  await page.goto(pathToFileURL(file).href);
  return page;
}

// What an accessibility checker finds that is serious; run past the page's own policy, which lets no other script in.
async function inaccessible(page, options) {
  const session = await page.context().newCDPSession(page);
  await session.send("Runtime.evaluate", { expression: `${axe};undefined`, allowUnsafeEvalBlockedByCSP: true });
  const { violations } = await page.evaluate((more) => axe.run(document, { resultTypes: ["violations"], ...more }), options);
  return violations.map((one) => `${one.impact} ${one.id}: ${one.nodes[0].target} (${one.nodes.length})`);
}

// What does not fit: the page in its width, a figure's words in the figure, a word beside another.
function unfit() {
  const found = [];
  const { scrollWidth, clientWidth } = document.documentElement;
  if (scrollWidth > clientWidth) found.push(`the page is ${scrollWidth} wide`);
  for (const plot of document.querySelectorAll("svg.plot")) {
    const whole = plot.getBoundingClientRect();
    const words = [...plot.querySelectorAll("text")].map((text) => [text.textContent, text.getBoundingClientRect()]);
    for (const [i, [text, box]] of words.entries()) {
      const out = Math.max(whole.left - box.left, box.right - whole.right, whole.top - box.top, box.bottom - whole.bottom);
      if (out > 1) found.push(`${plot.id}: ${text} is ${out.toFixed(1)} out of its figure`);
      for (const [other, near] of words.slice(i + 1)) {
        const across = Math.min(box.right, near.right) - Math.max(box.left, near.left);
        const down = Math.min(box.bottom, near.bottom) - Math.max(box.top, near.top);
        if (across > 1 && down > 0.3 * box.height) found.push(`${plot.id}: ${text} lies over ${other}`);
      }
    }
  }
  return found;
}

const results = [];
for (const file of files) {
  const found = {};
  for (const width of [360, 1400]) {
    for (const colorScheme of ["light", "dark"]) {
      const said = [];
      const page = await opened(file, { viewport: { width, height: 900 }, colorScheme }, said);
      const only = colorScheme === "dark" ? { runOnly: ["color-contrast"] } : {}; // nothing but colours differs by night
      found[`${width} ${colorScheme}`] = [...said, ...(await inaccessible(page, only)), ...(await page.evaluate(unfit))];
      await page.context().close();
    }
  }
  const said = [];
  const page = await opened(file, { viewport: { width: A4, height: 900 }, colorScheme: "dark" }, said);
  await page.emulateMedia({ media: "print" });
  found.print = await page.evaluate(unfit);
  const hidden = await page.evaluate(() => [...document.querySelectorAll(".plot, table, figcaption")].filter((one) => !one.closest(".all") && !one.getClientRects().length).length);
  if (hidden) found.print.push(`${hidden} are not printed`);
  const ground = await page.evaluate(() => getComputedStyle(document.body).backgroundColor);
  if (ground !== "rgb(255, 255, 255)") found.print.push(`printed on ${ground}`);
  results.push(found);
}
await browser.close();
console.log(JSON.stringify(results));

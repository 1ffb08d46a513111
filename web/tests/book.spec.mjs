// The skin on the book's first page, as a reader sees it: first a picture, then a skin that shows presses in the right
// place. BOOK names the built book, including the output of scripts/wasm-demo.

import assert from "node:assert/strict";
import { readdir, stat } from "node:fs/promises";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { keepPicture, serveFiles, startBrowser, touchRows, windowFromSkin } from "./browser.mjs";

const book = process.env.BOOK;
/** Largest total size of the page. */
const MOST_BYTES = 4_000_000;
/** The indenter's radius. */
const NEAR_MM = 10;

let browser;
let server;

async function open(address, options = {}) {
  const page = await browser.newPage({ viewport: { width: 1280, height: 900 }, ...options });
  const requests = [];
  const complaints = [];
  page.on("request", (request) => requests.push(request.url()));
  page.on("console", (message) => ["error", "warning"].includes(message.type()) && complaints.push(`${message.text()} (${message.location().url})`));
  page.on("pageerror", (error) => complaints.push(String(error)));
  await page.goto(address);
  return { page, requests, complaints };
}

/** Waits until the skin in a page or frame can be pressed. */
async function ready(skin) {
  await skin.waitForSelector("[data-connection='live']", { timeout: 120_000 });
  await skin.waitForSelector("#wait", { state: "hidden" });
  await skin.waitForFunction(() => document.querySelector("#tare-state").textContent.startsWith("baseline"), null, { timeout: 120_000 });
}

/** Starts and returns the frame on the first page. */
async function poke(page) {
  await page.click("#poke-start");
  const frame = await (await page.waitForSelector("#poke iframe")).contentFrame();
  await ready(frame);
  return frame;
}

async function pressInFrame(page, frame, x_mm, y_mm) {
  const box = await page.locator("#poke iframe").boundingBox();
  const { x, y } = await windowFromSkin(frame, x_mm, y_mm);
  // The frame's border is one pixel.
  await page.mouse.move(box.x + 1 + x, box.y + 1 + y);
  await page.mouse.down();
}

const distance_mm = (row, x_mm, y_mm) => Math.hypot(row.x_mm - x_mm, row.y_mm - y_mm);

async function waitForTouch(frame, x_mm, y_mm, limit_ms = 30_000) {
  const begun = performance.now();
  let rows = [];
  while (performance.now() - begun < limit_ms) {
    rows = await touchRows(frame);
    if (rows.some((row) => distance_mm(row, x_mm, y_mm) < NEAR_MM)) return performance.now() - begun;
    await new Promise((resolve) => setTimeout(resolve, 20));
  }
  throw new Error(`no touch near (${x_mm}, ${y_mm}) mm within ${limit_ms} ms; there were ${JSON.stringify(rows)}`);
}

before(async () => {
  assert.ok(book, "BOOK names the folder of the built book");
  [server, browser] = await Promise.all([serveFiles(book), startBrowser()]);
});
after(async () => {
  await browser?.close();
  await server?.stop();
});

test("the page loads at most 4 MB", async (t) => {
  let sum = 0;
  for (const name of await readdir(join(book, "poke"))) sum += (await stat(join(book, "poke", name))).size;
  t.diagnostic(`${sum} bytes`);
  assert.ok(sum <= MOST_BYTES, `${sum} bytes`);
});

test("the first page loads no skin until it is asked to, and then shows a press where it is made", async (t) => {
  const { page, requests, complaints } = await open(server.address);
  await page.locator("#poke-start img").scrollIntoViewIfNeeded();
  assert.deepEqual(requests.filter((url) => url.includes("/poke/")), []);
  assert.ok(await page.locator("#poke-start img").evaluate((image) => image.complete && image.naturalWidth > 0), "the picture is there");
  const begun = performance.now();
  const frame = await poke(page);
  t.diagnostic(`ready after ${((performance.now() - begun) / 1000).toFixed(1)} s`);
  assert.equal(await frame.locator("#skin-name").textContent(), "ionic-disc");
  for (const [x_mm, y_mm] of [[30, -20], [-40, 15]]) {
    await pressInFrame(page, frame, x_mm, y_mm);
    t.diagnostic(`touch after ${(await waitForTouch(frame, x_mm, y_mm)).toFixed(0)} ms`);
    await keepPicture(page, `book-press-${x_mm}`);
    await page.mouse.up();
  }
  await page.mouse.move(2, 2);
  await frame.waitForFunction(() => Number(document.querySelector("#fps").textContent) > 0);
  await page.waitForTimeout(3000);
  const [fps, shown] = await Promise.all(["#fps", "#shown"].map((id) => frame.locator(id).textContent().then(Number)));
  t.diagnostic(`${fps} frames/s, ${shown} shown/s`);
  // The frame rate depends on the machine, but frames must arrive.
  assert.ok(fps > 2 && shown > 1, `${fps} frames/s, ${shown} shown/s`);
  const foreign = requests.filter((url) => !url.startsWith(server.address) && !url.startsWith("data:") && !url.startsWith("blob:"));
  // Formulas are typeset by MathJax, which the book loads from the address set by mdbook.
  assert.deepEqual(foreign.filter((url) => !url.includes("mathjax") && !url.includes("MathJax")), []);
  assert.deepEqual(complaints.filter((text) => !/mathjax/i.test(text)), []);
  await page.close();
});

test("the whole page opens on its own, and says what this skin cannot do", async () => {
  const { page, complaints } = await open(`${server.address}/poke/index.html`);
  await ready(page);
  assert.equal(await page.locator("#record").isVisible(), false);
  for (const id of ["#noise", "#latency", "#traces", "#messages"]) assert.ok(await page.locator(id).isVisible(), id);
  await page.click("#tare");
  await page.waitForFunction(() => document.querySelector("#messages").textContent.includes("tar"));
  // The keyboard: the shortcut of a missing button is refused with the reason.
  await page.keyboard.press("r");
  await page.waitForFunction(() => document.querySelector("#messages").textContent.includes("no disk"));
  await page.waitForFunction(() => [...document.querySelectorAll("#latency tr")].some((row) => Number(row.cells[1].textContent) > 0));
  await keepPicture(page, "book-whole-page");
  assert.deepEqual(complaints, []);
  await page.close();
});

test("a book without the skin says how to build it", async () => {
  const bare = await serveFiles(book, "/poke/");
  const { page } = await open(bare.address);
  await page.click("#poke-start");
  await page.waitForFunction(() => document.querySelector("#poke-note").textContent.includes("scripts/wasm-demo"));
  assert.equal(await page.locator("#poke iframe").count(), 0);
  await page.close();
  await bare.stop();
});
